"""What the indoor worlds have in common: a small robot with poor odometry and a fair sensor.

Chosen so that dead reckoning is metres off after 100 m, and so that landmarks can be told apart.  What each world sets
of `inflate_r` is said there, with the reason.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from scenarios.checks import Limits, check_number
from scenarios.floorplan import Doors
from scenarios.laser import MAX_BEAMS, Laser
from scenarios.sensors import BLIND, Sensor
from slam.types import Noise

Features = Literal["walls", "landmarks"]

WALLS_ONLY = ("doors", "recess", "far_end", "lobby_walls", "beams")
"""Options that say nothing of landmarks."""

Laps = Annotated[float, Limits(above=0, most=1000)]
Beams = Annotated[int, Limits(least=1, most=MAX_BEAMS)]
Seed = Annotated[int, Limits(least=0, most=2**63)]
View = Annotated[float | None, Limits(above=0, most=360, unit="degrees")]

INDOOR_NOISE = Noise(speed=0.2, turn=math.radians(4.0), range=0.02, bearing=math.radians(0.3))
"""With control every 0.1 s: 0.6 m and 13 degrees after 100 s, so that odometry is metres off after a loop."""

LASER_NOISE = Noise(range=0.01, odometry=0.10)
"""An increment every 0.4 m: once round the loop dead reckoning is 1 to 4 m and some 8 degrees off (10 seeds; median
2.9 m)."""

LASER_RANGE = 8.0
"""[m]"""


def check_doors(options: Any) -> None:
    """Raise `SourceError` unless doors can be like that; `options` have `door_spacing`, `door_width` and `recess`."""
    for name in ("door_spacing", "door_width"):
        check_number(name, getattr(options, name), above=0)
    check_number("recess", options.recess, "m", least=0)


def doors(options: Any) -> Doors:
    """The doors of a corridor with such options; a landmark stands where one would be, whatever they are."""
    kind = options.doors if options.features == "walls" else "none"
    return Doors(options.door_spacing, options.door_width, kind, options.recess)


def laser(options: Any) -> Laser:
    """A scan every 0.5 s; `options` have `beams`, `view_deg` and `max_range`, the last two None for what is usual."""
    return Laser(
        beams=options.beams,
        field_of_view=_view(options.view_deg, 180.0),
        max_range=_reach(options.max_range, LASER_RANGE),
    )


def sensor(options: Any, max_range: float, view_deg: float = 180.0) -> Sensor:
    """For the landmarks of a world that offers walls too, with what is usual there."""
    return Sensor(max_range=_reach(options.max_range, max_range), field_of_view=_view(options.view_deg, view_deg))


def _view(degrees: float | None, usual: float) -> float:
    """[rad]"""
    return math.radians(usual if degrees is None else degrees)


def _reach(max_range: float | None, usual: float) -> float:
    """[m]"""
    if max_range is not None:
        check_number("max_range", max_range, above=BLIND)
    return usual if max_range is None else max_range
