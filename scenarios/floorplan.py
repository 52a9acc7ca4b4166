"""Floor plans: corridors with doors, rooms behind them, and the landmarks that stand there.

Walls are where a laser would find them, faces of thick walls; a landmark is the hinge post of a door.  Only one post of
each door counts, since two posts a door's width apart could hardly be told from one another.

The face of a wall is drawn as an outline, in coordinates of its own: metres along it and metres behind it.  Whoever
looks at a piece of it has it on the right hand of the outline's direction or on the left, the same for all pieces; they
are turned so that he is to the left of every one, as `slam.features.wall` has it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from scenarios.types import SourceError
from scenarios.world import MAX_LANDMARKS, SHORTEST
from slam.types import Floats

Place = tuple[float, float]

DoorKind = Literal["closed", "open", "rooms", "none"]
"""A leaf set back in its frame, a doorway with nothing behind, one with a room behind, no door at all."""

ROOM_DEPTH = 4.0
"""[m] of the rooms behind doors, where there is place for it."""


@dataclass(frozen=True)
class Doors:
    """The doors of a corridor."""

    spacing: float
    """[m] between the doors of one side."""
    width: float
    """[m]"""
    kind: DoorKind = "none"
    recess: float = 0.3
    """[m] that the leaf is set back, and the thickness of the wall around a doorway."""


class Room(NamedTuple):
    """A room behind a wall: from `begin` to `end` along it, down to `depth` behind its face."""

    begin: float
    end: float
    depth: float


class Door(NamedTuple):
    """A door from `begin` to `end` along a wall."""

    begin: float
    end: float
    kind: DoorKind
    room: Room | None = None
    """Of kind `rooms`."""


class Plan(NamedTuple):
    """A corridor."""

    walls: Floats
    """(n, 4) x0 y0 x1 y1 [m]"""
    posts: Floats
    """(d, 2) x y [m] where each door begins, if it has doors of any kind or none."""


def door_places(length: float, spacing: float, first: float, door_width: float) -> Floats:
    """(d,) [m] along a wall of `length` where doors begin: at `first`, then every `spacing` while they fit.

    Raises `SourceError` for doors that overlap and for absurdly many.
    """
    if not door_width < spacing:
        raise SourceError(f"door_width is {door_width:g}; expected less than the door_spacing of {spacing:g} m")
    if length / spacing > MAX_LANDMARKS:
        raise SourceError(f"door_spacing is {spacing:g}; expected at most {MAX_LANDMARKS} doors in {length:g} m")
    return np.arange(first, length - door_width, spacing)


def hinge_posts(start: Place, end: Place, doors: Floats) -> Floats:
    """(d, 2) [m] the posts at which doors (d,) [m] of the wall from `start` to `end` begin."""
    a, b = np.array(start, float), np.array(end, float)
    return a + doors[:, None] * (b - a) / float(np.hypot(*(b - a)))


def face(start: Place, end: Place, doors: Sequence[Door], recess: float, left: bool) -> Floats:
    """(n, 4) [m] the face of a wall from `start` to `end`, with its doors in order, and what is seen through these.

    The wall is to the `left` of somebody who goes from `start` to `end` in the corridor, or to the right.
    """
    a, b = np.array(start, float), np.array(end, float)
    length = float(np.hypot(*(b - a)))
    lines: list[list[Place]] = [[(0.0, 0.0)]]
    for door in doors:
        p, q, r = door.begin, door.end, recess
        if door.kind == "closed":
            lines[-1] += [(p, 0.0), (p, r), (q, r), (q, 0.0)]
        elif door.kind == "open":
            lines[-1] += [(p, 0.0), (p, r)]
            lines.append([(q, r), (q, 0.0)])
        elif door.kind == "rooms" and door.room is not None:
            low, high, depth = door.room
            inside = [(p, r), (low, r), (low, depth), (high, depth), (high, r), (q, r)]
            lines[-1] += [(p, 0.0), *inside, (q, 0.0)]
    lines[-1].append((length, 0.0))
    along = (b - a) / length
    back = np.array([-along[1], along[0]]) * (1.0 if left else -1.0)
    pieces = [(*p, *q) for line in lines for p, q in pairwise(line) if math.dist(p, q) >= SHORTEST]
    s0, o0, s1, o1 = np.array(pieces).reshape(-1, 4).T[:, :, None]
    ends = (a + s0 * along + o0 * back, a + s1 * along + o1 * back)
    return np.concatenate(ends[::-1] if left else ends, axis=1)


def outline(corners: Sequence[Place]) -> Floats:
    """(n, 4) [m] the closed polygon through `corners`: counter-clockwise for a room, clockwise for a pillar."""
    return np.array([(*p, *q) for p, q in zip(corners, [*corners[1:], corners[0]], strict=True)], float)


def straight_corridor(start: float, length: float, width: float, doors: Doors) -> Plan:
    """A corridor along +x from `start`, doors left and right in turn; both its ends are open."""
    half = 0.5 * width
    walls, posts = [], []
    for y, first, left in ((half, 0.5 * doors.spacing, True), (-half, doors.spacing, False)):
        ends = ((start, y), (start + length, y))
        at = door_places(length, doors.spacing, first, doors.width)
        posts.append(hinge_posts(*ends, at))
        walls.append(face(*ends, _doors(at, length, doors, ROOM_DEPTH, 0.0), doors.recess, left))
    return Plan(np.concatenate(walls), np.concatenate(posts))


def ring_corridor(length: float, depth: float, width: float, doors: Doors) -> Plan:
    """A corridor around a rectangle.

    Its centre line, `length` by `depth`, starts at the origin in the middle of one long side and runs along +x and
    then counter-clockwise.  Inner and outer doors alternate.
    """
    walls, posts = [], []
    room = min(ROOM_DEPTH, 0.4 * (min(length, depth) - width))  # in the block, where they must not meet
    for grow, shift, inner in ((0.5 * width, 0.0, False), (-0.5 * width, 0.5, True)):
        corners = ring_corners(length, depth, grow)
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            wall = abs(b[0] - a[0]) + abs(b[1] - a[1])
            count = max(0, int((wall - doors.spacing) // doors.spacing) + 1)  # symmetric about the middle of the wall
            first = 0.5 * (wall - (count - 1) * doors.spacing) + (shift - 0.5) * 0.5 * doors.spacing
            at = door_places(wall, doors.spacing, first, doors.width)[:count]
            posts.append(hinge_posts(a, b, at))
            rooms = _doors(at, wall, doors, room if inner else ROOM_DEPTH, room if inner else 0.0)
            walls.append(face(a, b, rooms, doors.recess, left=inner))
    return Plan(np.concatenate(walls), np.concatenate(posts))


def ring_corners(length: float, depth: float, grow: float) -> list[Place]:
    """The corners, counter-clockwise, of a rectangle `grow` [m] outside the centre line of a `ring_corridor`."""
    x, low, high = 0.5 * length + grow, -grow, depth + grow
    return [(-x, low), (x, low), (x, high), (-x, high)]


def _doors(at: Floats, length: float, doors: Doors, depth: float, corner: float) -> list[Door]:
    """Doors beginning `at` (d,) along a wall of `length`; rooms behind them are `depth` deep and keep `corner` away
    from its ends."""
    made = []
    for p in at.tolist() if doors.kind != "none" else ():
        q = p + doors.width
        middle, half = 0.5 * (p + q), 0.45 * doors.spacing
        low, high = max(middle - half, corner), min(middle + half, length - corner)
        room = Room(min(low, p), max(high, q), max(depth, doors.recess + SHORTEST))
        made.append(Door(p, q, doors.kind, room))
    return made
