"""A hospital wing (like Fig. 10): corridors around a block, open rooms on both sides, a visit to some of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np

from scenarios.checks import Limits, check_positive
from scenarios.floorplan import Door, Place, Room, face, ring_corners
from scenarios.indoor import LASER_NOISE, Beams, Laps, Seed, View, laser
from scenarios.route import Route, shorten
from scenarios.simulate import Scenario
from scenarios.types import SourceError
from scenarios.world import world_of_walls
from slam.motion import Unicycle
from slam.types import Floats

TITLE = "a hospital wing: a 100 m loop of corridors past open rooms, some of which the robot enters"

THICKNESS = 0.15
"""[m] of the walls between rooms, and between rooms and corridor."""

LEAST_ROOM = 2.0
"""[m] wide, and deep."""

BEHIND_DOOR = 2.0
"""[m] that the robot drives into a room, at most; where it turns there is as much again before it."""


@dataclass(frozen=True)
class Hospital:
    """Options of `hospital`."""

    length: float = 36.0
    """[m] of the longer side of the centre line of the corridors; the robot starts in its middle."""
    depth: float = 14.0
    """[m] of the shorter side; the rooms in the block are as deep as two rows of them can be."""
    width: float = 2.4
    """[m] of the corridors."""
    room_width: float = 4.0
    """[m] of a room, on average."""
    room_depth: float = 5.0
    """[m] of the rooms outside the loop."""
    door_width: float = 1.2
    """[m]"""
    laps: Laps = 1.3
    """How often the robot goes round."""
    visits: Annotated[int, Limits(least=0)] = 2
    """How many rooms the robot enters in its first lap."""
    layout_seed: Seed = 0
    """Of the rooms' widths and the places of their doors; the noise has a seed of its own."""
    speed: float = 0.8
    """[m/s]"""
    beams: Beams = 181
    """Of the laser."""
    view_deg: View = None
    """[degrees] the whole opening of the laser; by default 180, the frontal half circle."""
    max_range: float | None = None
    """[m] of the laser; by default 8."""


class Visit(NamedTuple):
    """A room that may be entered."""

    travelled: float
    """[m] along the centre line from the start."""
    before: Place
    """(m, m) on the centre line before the door."""
    inside: Place
    """(m, m) where the robot turns round."""


def hospital(options: Hospital) -> Scenario:
    """The robot turns on the spot; observed every 0.5 s."""
    check_positive(options, "length", "depth", "width", "room_width", "room_depth", "door_width", "speed")
    least = max(LEAST_ROOM, options.door_width + 4 * THICKNESS)
    for name in ("room_width", "room_depth"):
        if getattr(options, name) < least:
            raise SourceError(f"{name} is {getattr(options, name):g}; expected at least {least:g} m, room for a door")
    block = min(options.length, options.depth) - options.width  # what the corridors leave in the middle
    if block < 2 * (least + THICKNESS):
        raise SourceError(
            f"length and depth are {options.length:g} and {options.depth:g}; expected at least "
            f"{options.width + 2 * (least + THICKNESS):g} m each, room for a corridor around two rows of rooms"
        )
    walls, visits = _wing(options)
    return Scenario(
        name="hospital",
        title=TITLE,
        world=world_of_walls(walls),
        motion=Unicycle(),
        route=Route(waypoints=_route(options, visits), speed=options.speed),
        sensor=laser(options),
        noise=LASER_NOISE,
        options=asdict(options),
    )


def _wing(options: Hospital) -> tuple[Floats, list[Visit]]:
    """Walls (n, 4) [m], and the rooms along the two long corridors."""
    rng = np.random.default_rng(options.layout_seed)
    walls, visits = [], []
    inner_depth = 0.5 * (options.depth - options.width - THICKNESS)
    for grow, inner in ((0.5 * options.width, False), (-0.5 * options.width, True)):
        corners = ring_corners(options.length, options.depth, grow)
        for i, (a, b) in enumerate(zip(corners, [*corners[1:], corners[0]], strict=True)):
            long = i % 2 == 0
            doors: list[Door] = []
            if long or not inner:  # the short sides of the block are the end walls of its rows of rooms
                length = abs(b[0] - a[0]) + abs(b[1] - a[1])
                doors = _rooms(rng, length, inner_depth if inner else options.room_depth, options)
            if long:
                visits += [
                    _visit(options, door, a[0], y=0.0 if i == 0 else options.depth, inner=inner) for door in doors
                ]
            walls.append(face(a, b, doors, THICKNESS, left=inner))
    return np.concatenate(walls), visits


def _rooms(rng: np.random.Generator, length: float, depth: float, options: Hospital) -> list[Door]:
    """A row of rooms behind a wall of `length`, each with a door somewhere."""
    least = max(LEAST_ROOM, options.door_width + 4 * THICKNESS)
    count = max(1, min(round(length / options.room_width), int(length / least)))
    spare = length - count * least  # what is left when all are as narrow as can be
    widths = least + spare * rng.dirichlet(np.full(count, 20.0))
    borders = np.concatenate([[0.0], np.cumsum(widths)])
    doors = []
    for low, high in pairwise(borders.tolist()):
        room = Room(low + 0.5 * THICKNESS, high - 0.5 * THICKNESS, depth)
        play = room.end - room.begin - options.door_width - 2 * THICKNESS
        begin = room.begin + THICKNESS + play * rng.uniform()
        doors.append(Door(begin, begin + options.door_width, "rooms", room))
    return doors


def _visit(options: Hospital, door: Door, corner: float, y: float, inner: bool) -> Visit:
    """Of a room on a long corridor at `y`, whose wall begins at x = `corner`."""
    assert door.room is not None
    south = y == 0.0
    middle = 0.5 * (door.begin + door.end)
    x = corner + middle if south else corner - middle
    outwards = -1.0 if south else 1.0
    into = 0.5 * options.width + THICKNESS + min(BEHIND_DOOR, 0.5 * (door.room.depth - THICKNESS))
    half, lap = 0.5 * options.length, 2 * (options.length + options.depth)
    travelled = (x if x > 0 else lap + x) if south else half + options.depth + (half - x)
    return Visit(travelled, (x, y), (x, y + (-outwards if inner else outwards) * into))


def _route(options: Hospital, visits: list[Visit]) -> tuple[Place, ...]:
    """Round and round, with detours into rooms spread over the first lap."""
    half, y = 0.5 * options.length, options.depth
    lap = 2 * (options.length + y)
    # Not in a corner, where there is the other corridor, and not where the route ends anyway.
    able = sorted(
        v
        for v in visits
        if abs(v.before[0]) < half - options.width and v.travelled < min(1.0, options.laps) * lap - 1.0
    )
    if options.visits > len(able):
        raise SourceError(f"visits is {options.visits}; expected at most {len(able)}, as many rooms as are passed")
    chosen = [able[round((i + 0.5) * len(able) / options.visits - 0.5)] for i in range(options.visits)]
    stops: list[tuple[float, list[Place]]] = [(v.travelled, [v.before, v.inside, v.before]) for v in chosen]
    corners = [(half, (half, 0.0)), (half + y, (half, y)), (3 * half + y, (-half, y)), (3 * half + 2 * y, (-half, 0.0))]
    stops += [(travelled, [place]) for travelled, place in corners]
    places: list[Place] = [(0.0, 0.0)]
    for _, there in sorted(stops):
        places += there
    places.append((0.0, 0.0))
    for _ in range(int(options.laps)):
        places += [place for _, place in corners] + [(0.0, 0.0)]
    detours = sum(2 * abs(v.inside[1] - v.before[1]) for v in chosen)
    return shorten(tuple(places), options.laps * lap + detours)
