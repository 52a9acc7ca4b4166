"""An open field of random landmarks, of any size, for scaling."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from scenarios.checks import check_number, check_positive
from scenarios.indoor import INDOOR_NOISE
from scenarios.route import Route, Waypoints, shorten
from scenarios.scatter import landmark_count, scatter
from scenarios.sensors import Sensor
from scenarios.simulate import Scenario
from scenarios.types import SourceError
from scenarios.world import world_of_points
from slam.motion import Unicycle

TITLE = "an open field of random landmarks, of any size: for scaling"

CORNER_RADIUS = 1.5  # [m]


@dataclass(frozen=True)
class Field:
    """Options of `field`."""

    length: float = 200.0
    """[m] of the route, which goes up and down the field in lanes."""
    lane: float = 40.0
    """[m] of one lane."""
    lane_gap: float = 8.0
    """[m] from lane to lane."""
    density: float = 0.03
    """[1/m^2] of landmarks in the field, which reaches `margin` beyond the lanes."""
    landmarks: int | None = None
    """How many landmarks; by default as many as the density gives."""
    spacing: float | None = None
    """[m] between any two landmarks, at least; by default 2, less where so many would not fit."""
    margin: float = 8.0
    """[m]"""
    layout_seed: int = 0
    """Of the places of the landmarks; the noise has a seed of its own."""
    speed: float = 1.0
    """[m/s]"""
    max_range: float = 10.0
    """[m] of the sensor."""


def field(options: Field) -> Scenario:
    """Lanes along x, the first at y = 0; observed every 0.5 s."""
    check_positive(options, "length", "lane", "lane_gap", "speed", "max_range")
    check_number("margin", options.margin, "m", least=0)
    if min(options.lane, options.lane_gap) < 2 * CORNER_RADIUS:
        raise SourceError(
            f"lane and lane_gap are {options.lane:g} and {options.lane_gap:g}; expected at least "
            f"{2 * CORNER_RADIUS:g} m each, room to turn"
        )
    waypoints = shorten(_lanes(options), options.length, shortest=CORNER_RADIUS)
    xs, ys = zip(*waypoints, strict=True)
    m = options.margin
    area = (min(xs) - m, min(ys) - m, max(xs) + m, max(ys) + m)
    number = landmark_count(area, options.density) if options.landmarks is None else options.landmarks
    spacing = options.spacing
    if spacing is None:
        room = (area[2] - area[0]) * (area[3] - area[1]) / max(1, number)  # [m^2] for each
        spacing = min(2.0, 0.5 * math.sqrt(room))
    return Scenario(
        name="field",
        title=TITLE,
        world=world_of_points(scatter(area, number, spacing, options.layout_seed)),
        motion=Unicycle(),
        route=Route(waypoints=waypoints, speed=options.speed, corner_radius=CORNER_RADIUS),
        sensor=Sensor(max_range=options.max_range),
        noise=INDOOR_NOISE,
        defaults={"inflate_r": 4.0},
        options=asdict(options),
    )


def _lanes(options: Field) -> Waypoints:
    """Up one lane, down the next, for at least `length`."""
    count = int(options.length / (options.lane + options.lane_gap)) + 1
    lanes: list[tuple[float, float]] = []
    for i in range(count):
        ends = [(0.0, i * options.lane_gap), (options.lane, i * options.lane_gap)]
        lanes += ends if i % 2 == 0 else ends[::-1]
    return tuple(lanes)
