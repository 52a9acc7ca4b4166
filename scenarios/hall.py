"""A large hall with little to see and people who walk about (like the trade fair): what is seen is often not mapped."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np

from scenarios.checks import Limits, check_positive
from scenarios.floorplan import Place, outline
from scenarios.indoor import LASER_NOISE, Beams, Laps, Seed, View, laser
from scenarios.movers import MAX_MOVERS, Movers
from scenarios.route import Route, shorten
from scenarios.simulate import Scenario
from scenarios.types import SourceError
from scenarios.world import world_of_walls
from slam.motion import Unicycle
from slam.types import Floats

TITLE = "a large hall: few walls, pillars and booths, and people who walk about and hide them"

CORNER_RADIUS = 1.0  # [m]
CLEARANCE = 1.0
"""[m] between the route, the walls and all that stands in the hall."""
PANEL = 0.1
"""[m] thickness of the walls of a booth."""
PERSON = 0.25
"""[m] radius of a person."""
MOST_THINGS = 10_000


@dataclass(frozen=True)
class Hall:
    """Options of `hall`."""

    length: float = 44.0
    """[m] of the hall, along x."""
    depth: float = 28.0
    """[m] of the hall, along y."""
    margin: float = 6.0
    """[m] from the route to the walls."""
    laps: Laps = 1.3
    """How often the robot goes round."""
    pillars: Annotated[int, Limits(least=0, most=MOST_THINGS)] = 10
    """How many, square."""
    pillar: float = 0.6
    """[m] side of a pillar."""
    booths: Annotated[int, Limits(least=0, most=MOST_THINGS)] = 6
    """How many: three walls around a square, open on one side."""
    booth: float = 3.0
    """[m] side of a booth."""
    people: Annotated[int, Limits(least=0, most=MAX_MOVERS)] = 12
    """How many walk to and fro on straight lines; they hide walls, and stand in nobody's way."""
    layout_seed: Seed = 0
    """Of all that stands and walks about; the noise has a seed of its own."""
    speed: float = 0.8
    """[m/s]"""
    beams: Beams = 181
    """Of the laser."""
    view_deg: View = None
    """[degrees] the whole opening of the laser; by default 180, the frontal half circle."""
    max_range: float | None = None
    """[m] of the laser; by default 8."""


def hall(options: Hall) -> Scenario:
    """The robot goes round in the hall, counter-clockwise; observed every 0.5 s."""
    check_positive(options, "length", "depth", "margin", "pillar", "booth", "speed")
    if options.booth < 4 * PANEL:
        raise SourceError(f"booth is {options.booth:g}; expected at least {4 * PANEL:g} m")
    half, y0, y1 = 0.5 * options.length - options.margin, -options.margin, options.depth - options.margin
    side = options.depth - 2 * options.margin
    if min(2 * half, side) < 2 * CORNER_RADIUS:
        raise SourceError(
            f"margin is {options.margin:g}; expected at most "
            f"{0.5 * min(options.length, options.depth) - CORNER_RADIUS:g} m, room to go round"
        )
    rng = np.random.default_rng(options.layout_seed)
    x = 0.5 * options.length
    lap: list[Place] = [(0.0, 0.0), (half, 0.0), (half, side), (-half, side), (-half, 0.0)]
    things = _things(rng, options, (-x, y0, x, y1), [*lap, lap[0]])
    walls = [outline([(-x, y0), (x, y0), (x, y1), (-x, y1)]), *things]
    corners = (*(lap * (int(options.laps) + 1)), lap[0])
    return Scenario(
        name="hall",
        title=TITLE,
        world=world_of_walls(np.concatenate(walls), _people(rng, options.people, (-x, y0, x, y1))),
        motion=Unicycle(),
        route=Route(
            waypoints=shorten(corners, options.laps * (4 * half + 2 * side), shortest=CORNER_RADIUS),
            speed=options.speed,
            corner_radius=CORNER_RADIUS,
        ),
        sensor=laser(options),
        noise=LASER_NOISE,
        options=asdict(options),
    )


def _things(
    rng: np.random.Generator, options: Hall, area: tuple[float, float, float, float], way: list[Place]
) -> list[Floats]:
    """The outlines of booths and pillars: thrown at random, those too near to something are thrown again."""
    taken = np.empty((0, 3))  # x, y, half a side
    corners = np.array(way)
    made = []
    sizes = [options.booth] * options.booths + [options.pillar] * options.pillars  # the large ones first
    for number, size in enumerate(sizes):
        half = 0.5 * size
        room = half + CLEARANCE
        if area[2] - area[0] <= 2 * room or area[3] - area[1] <= 2 * room:
            raise SourceError(f"a booth or pillar of {size:g} m does not fit into the hall; expected a smaller one")
        for x, y in rng.uniform((area[0] + room, area[1] + room), (area[2] - room, area[3] - room), (1000, 2)).tolist():
            apart = np.maximum(np.abs(taken[:, 0] - x), np.abs(taken[:, 1] - y)) - taken[:, 2]
            if (apart > room).all() and _distance(corners, x, y) > room:
                break
        else:
            raise SourceError(
                f"booths and pillars are {options.booths} and {options.pillars}: so many do not fit into the hall, "
                f"{CLEARANCE:g} m apart; expected fewer or smaller ones"
            )
        taken = np.concatenate([taken, [[x, y, half]]])
        if number < options.booths:
            made.append(_booth(x, y, half, int(rng.integers(4))))
        else:
            made.append(
                outline([(x - half, y - half), (x - half, y + half), (x + half, y + half), (x + half, y - half)])
            )
    return made


def _distance(way: Floats, x: float, y: float) -> float:
    """[m] from (x, y) to the polyline (n, 2) with sides along the axes, the larger of that in x and that in y."""
    low, high = np.minimum(way[:-1], way[1:]), np.maximum(way[:-1], way[1:])
    beyond = np.maximum(np.maximum(low - (x, y), (x, y) - high), 0.0)
    return float(beyond.max(axis=1).min())


def _booth(x: float, y: float, half: float, turns: int) -> Floats:
    """(8, 4) [m] three walls of a square, the fourth side open; turned by so many right angles."""
    a, b = half, half - PANEL
    corners = [(-a, -a), (-a, a), (-b, a), (-b, -b), (b, -b), (b, a), (a, a), (a, -a)]
    for _ in range(turns):
        corners = [(-v, u) for u, v in corners]
    return outline([(x + u, y + v) for u, v in corners])


def _people(rng: np.random.Generator, number: int, area: tuple[float, float, float, float]) -> Movers:
    """They walk 5 to 20 m and back, at a stroll or in a hurry."""
    x0, y0, x1, y1 = area
    start = rng.uniform((x0, y0), (x1, y1), (number, 2))
    length, course = rng.uniform(5.0, 20.0, number), rng.uniform(0.0, 2.0 * math.pi, number)
    end = start + length[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
    end = np.clip(end, (x0, y0), (x1, y1))
    still = np.hypot(*(end - start).T) < 1.0  # in a corner, facing it
    end[still] = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
    return Movers(
        paths=np.concatenate([start, end], axis=1),
        speeds=rng.uniform(0.5, 1.5, number),
        offsets=rng.uniform(0.0, 40.0, number),
        radii=np.full(number, PERSON),
    )
