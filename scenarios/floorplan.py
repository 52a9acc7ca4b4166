"""Floor plans of corridors: straight walls with doors, and the landmarks that stand on them.

Walls are computed with their true ends, as a laser will see them; a landmark is the hinge post of a door.  Only one
post of each door counts, since two posts a door's width apart could hardly be told from one another.
"""

from __future__ import annotations

import numpy as np

from scenarios.types import SourceError
from scenarios.world import MAX_LANDMARKS
from slam.types import Floats

Place = tuple[float, float]


def door_places(length: float, spacing: float, first: float, door_width: float) -> Floats:
    """(d,) [m] along a wall of `length` where doors begin: at `first`, then every `spacing` while they fit.

    Raises `SourceError` for doors that overlap and for absurdly many.
    """
    if not door_width < spacing:
        raise SourceError(f"door_width is {door_width:g}; expected less than the door_spacing of {spacing:g} m")
    if length / spacing > MAX_LANDMARKS:
        raise SourceError(f"door_spacing is {spacing:g}; expected at most {MAX_LANDMARKS} doors in {length:g} m")
    return np.arange(first, length - door_width, spacing)


def wall_with_doors(start: Place, end: Place, doors: Floats, door_width: float) -> Floats:
    """(d + 1, 2, 2) [m] ends of the pieces of wall that d doors leave standing between `start` and `end`."""
    a, b = np.array(start, float), np.array(end, float)
    length = float(np.hypot(*(b - a)))
    borders = np.concatenate([[0.0], np.stack([doors, doors + door_width], axis=1).ravel(), [length]])
    return (a + borders[:, None] * (b - a) / length).reshape(-1, 2, 2)


def hinge_posts(pieces: Floats) -> Floats:
    """(d, 2) [m] the post at which each door of `wall_with_doors` begins."""
    return pieces[:-1, 1]


def straight_corridor(
    start: float, length: float, width: float, spacing: float, door_width: float
) -> tuple[Floats, Floats]:
    """Walls (n, 2, 2) and posts (d, 2) [m] of a corridor along +x from `start`, doors left and right in turn."""
    half = 0.5 * width
    sides = []
    for y, first in ((half, 0.5 * spacing), (-half, spacing)):
        doors = door_places(length, spacing, first, door_width)
        sides.append(wall_with_doors((start, y), (start + length, y), doors, door_width))
    return np.concatenate(sides), np.concatenate([hinge_posts(side) for side in sides])


def ring_corridor(
    length: float, depth: float, width: float, spacing: float, door_width: float
) -> tuple[Floats, Floats]:
    """Walls (n, 2, 2) and posts (d, 2) [m] of a corridor around a rectangle.

    Its centre line, `length` by `depth`, starts at the origin in the middle of one long side and runs along +x and
    then counter-clockwise.  Inner and outer doors alternate.
    """
    sides = []
    for grow, shift in ((0.5 * width, 0.0), (-0.5 * width, 0.5)):
        x, low, high = 0.5 * length + grow, -grow, depth + grow
        corners = [(-x, low), (x, low), (x, high), (-x, high)]
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            wall = abs(b[0] - a[0]) + abs(b[1] - a[1])
            count = max(0, int((wall - spacing) // spacing) + 1)  # symmetric about the middle of the wall
            first = 0.5 * (wall - (count - 1) * spacing) + (shift - 0.5) * 0.5 * spacing
            sides.append(wall_with_doors(a, b, door_places(wall, spacing, first, door_width)[:count], door_width))
    return np.concatenate(sides), np.concatenate([hinge_posts(side) for side in sides])
