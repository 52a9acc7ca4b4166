"""A corridor around a rectangle: out, round, back into known ground, and on."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from scenarios.checks import check_number, check_positive
from scenarios.floorplan import ring_corridor
from scenarios.route import Route, shorten
from scenarios.sensors import Sensor
from scenarios.simulate import Scenario
from scenarios.types import SourceError
from scenarios.world import world_of_points
from slam.motion import Unicycle
from slam.types import Noise

TITLE = "a 100 m corridor loop: the robot returns into known ground and goes on"

CORNER_RADIUS = 1.0  # [m]

LOOP_NOISE = Noise(speed=0.1, turn=math.radians(2.0), range=0.05, bearing=math.radians(0.5))
"""Half the drift of the other indoor worlds: once round, dead reckoning is 1.6 m and 5 degrees off (median and
deviation of 20 runs)."""


@dataclass(frozen=True)
class Loop:
    """Options of `loop`."""

    length: float = 30.0
    """[m] of the longer side of the centre line; the robot starts in its middle."""
    depth: float = 20.0
    """[m] of the shorter side."""
    width: float = 2.0
    """[m] of the corridor."""
    laps: float = 1.3
    """How often the robot goes round; 1.3 is once and 30 m more."""
    door_spacing: float = 5.0
    """[m] between the doors of one wall; the doors of the wall across are half a spacing ahead."""
    door_width: float = 1.0
    """[m]"""
    speed: float = 0.8
    """[m/s]"""
    max_range: float = 12.0
    """[m] of the sensor: less than the way across, so that the beginning is out of sight for half of a lap."""
    view_deg: float = 360.0
    """[degrees] the whole opening of the sensor: 360 sees all round, 180 the frontal half circle."""


def loop(options: Loop) -> Scenario:
    """A landmark at the hinge post of every door, seen through walls; observed every 0.5 s."""
    check_positive(options, "length", "depth", "width", "door_spacing", "door_width", "speed", "max_range")
    check_number("laps", options.laps, above=0, most=1000)
    if min(options.length, options.depth) < max(options.width, 2 * CORNER_RADIUS) + options.door_width:
        raise SourceError(
            f"length and depth are {options.length:g} and {options.depth:g}; expected room for a corridor "
            f"of width {options.width:g} around something"
        )
    _, posts = ring_corridor(options.length, options.depth, options.width, options.door_spacing, options.door_width)
    x, y = 0.5 * options.length, options.depth
    lap = [(0.0, 0.0), (x, 0.0), (x, y), (-x, y), (-x, 0.0)]
    distance = options.laps * 2 * (options.length + options.depth)
    corners = (*(lap * (int(options.laps) + 1)), lap[0])
    return Scenario(
        name="loop",
        title=TITLE,
        world=world_of_points(posts),
        motion=Unicycle(),
        route=Route(
            waypoints=shorten(corners, distance, shortest=CORNER_RADIUS),
            speed=options.speed,
            corner_radius=CORNER_RADIUS,
        ),
        sensor=Sensor(max_range=options.max_range, field_of_view=math.radians(options.view_deg)),
        noise=LOOP_NOISE,
        # Once round, the map of a Dual FastSLAM particle is off by more than the honest R of the sensor, and its
        # innovation covariance holds no map error.  Nine times R, three deviations for one, leaves room to know the
        # beginning again.
        defaults={"inflate_r": 9.0},
        options=asdict(options),
    )
