"""The world of the paper's simulations (section 5.1): 40 m straight at 3 m/s past a few landmarks.

The paper's Fig. 3 with the landmarks is a picture; the places here are ours and an option.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal, NamedTuple

import numpy as np

from scenarios.checks import check_positive
from scenarios.route import Route, Waypoints
from scenarios.sensors import Sensor
from scenarios.simulate import Scenario
from scenarios.world import world_of_points
from slam.motion import Ackermann, Unicycle
from slam.types import Noise

TITLE = "40 m straight at 3 m/s past five landmarks: the simulation of the paper"

LayoutName = Literal["alternating", "sparse", "one-far", "two-far", "two-rows"]


class Layout(NamedTuple):
    """Landmarks, and how far the sensor must reach for what the layout is meant to show."""

    points: Waypoints
    """(x, y) [m, m]"""
    max_range: float
    """[m]"""


def _rows(places: np.ndarray, offset: float) -> Waypoints:
    return tuple((float(x), side * offset) for x in places for side in (1.0, -1.0))


_ALTERNATING = ((5.0, 6.0), (15.0, -6.0), (25.0, 6.0), (35.0, -6.0), (45.0, 6.0))

LAYOUTS: dict[str, Layout] = {
    "alternating": Layout(_ALTERNATING, 30.0),  # three visible, fewer at the end: over-determined
    "sparse": Layout(_ALTERNATING, 12.0),  # one visible at a time, now and then two
    "one-far": Layout(((60.0, 20.0),), 100.0),  # two rows against three unknowns: never over-determined
    "two-far": Layout(((60.0, 20.0), (60.0, -20.0)), 100.0),  # four rows: just over-determined
    "two-rows": Layout(_rows(np.arange(5.0, 70.0, 5.0), 6.0), 30.0),  # about ten visible: strongly so
}


@dataclass(frozen=True)
class PaperLine:
    """Options of `paper-line`."""

    vehicle: Literal["unicycle", "ackermann"] = "unicycle"
    """Turn noise acts on a turn rate, or on the steering of a car (wheelbase 4 m) as in the paper's baseline code."""
    period: Literal["nine-ticks", "0.2"] = "nine-ticks"
    """Observe every nine control ticks (0.225 s, 59 updates, as the paper's code does) or every 0.2 s (66)."""
    layout: LayoutName = "alternating"
    """Where the landmarks stand, hence how many are visible at once: 3, 1, 1, 2 or about 10."""
    max_range: float | None = None
    """[m] of the sensor; by default what the layout was made for (30, 12, 100, 100, 30)."""


def paper_line(options: PaperLine) -> Scenario:
    """Control every 0.025 s; the sensor sees the frontal half circle."""
    layout = LAYOUTS[options.layout]
    if options.max_range is not None:
        check_positive(options, "max_range")
    return Scenario(
        name="paper-line",
        title=TITLE,
        world=world_of_points(layout.points),
        motion=Ackermann() if options.vehicle == "ackermann" else Unicycle(),
        route=Route(waypoints=((0.0, 0.0), (40.0, 0.0)), speed=3.0, tick=0.025),
        sensor=Sensor(
            max_range=layout.max_range if options.max_range is None else float(options.max_range),
            every=9 if options.period == "nine-ticks" else 8,
        ),
        noise=Noise(),
        # As the paper's baseline code has it (section 5.1); the general defaults differ.
        defaults={
            "association": "known",
            "particles": 25,
            "resampler": "stratified",
            "proposal_weight": "drawn",
        },
        options=asdict(options),
    )
