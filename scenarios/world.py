"""What a sensor can see of a world: landmarks, or walls and the people that hide them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from scenarios.checks import LARGEST
from scenarios.movers import NOBODY, Movers, check_movers
from scenarios.types import SourceError, TrueMap
from slam.types import Floats

MAX_LANDMARKS = 1_000_000
MAX_WALLS = 100_000

SHORTEST = 1e-6
"""[m] A wall below this has no direction."""


def _no_landmarks() -> TrueMap:
    return TrueMap(np.empty(0, np.int64), np.empty((0, 2)))


@dataclass(frozen=True, eq=False)
class World:
    """The things that are there, where they truly are: landmarks for a `Sensor`, walls for a `Laser`."""

    landmarks: TrueMap
    walls: TrueMap
    """A wall's tag is its index."""
    movers: Movers = NOBODY


def world_of_points(points: ArrayLike, tags: ArrayLike | None = None) -> World:
    """Point landmarks at (n, 2) [m, m], tagged 0, 1, 2 ... in this order unless `tags` (n,) are given."""
    theta = np.array(points, float).reshape(-1, 2)
    landmarks = TrueMap(np.arange(len(theta)) if tags is None else np.array(tags, np.int64), theta)
    return World(landmarks, TrueMap(np.empty(0, np.int64), np.empty((0, 4))))


def world_of_walls(segments: ArrayLike, movers: Movers = NOBODY) -> World:
    """Walls (n, 4) x0 y0 x1 y1 [m], tagged 0, 1, 2 ... in this order.

    A wall has no thickness and is seen from both sides.  Where a robot may see both, let each face be a wall: they are
    two features of its map.
    """
    theta = np.array(segments, float).reshape(-1, 4)
    return World(_no_landmarks(), TrueMap(np.arange(len(theta)), theta), movers)


def check_landmarks(landmarks: TrueMap) -> None:
    """Raise `SourceError` unless there are landmarks, at finite places, each with a tag of its own."""
    tags, theta = landmarks
    if not 1 <= len(theta) <= MAX_LANDMARKS:
        raise SourceError(f"landmarks: there are {len(theta)}; expected 1 to {MAX_LANDMARKS}")
    if len(tags) != len(theta):
        raise SourceError(f"landmarks.tags: there are {len(tags)}; expected one for each of the {len(theta)} points")
    odd = ~(np.abs(theta) <= LARGEST).all(axis=1)  # written so that NaN is odd
    if odd.any():
        at = int(np.argmax(odd))
        place = ", ".join(f"{c:g}" for c in theta[at])
        raise SourceError(f"landmarks: landmark {at + 1} is at ({place}); expected finite metres, at most {LARGEST:g}")
    if tags.min() < 0:
        raise SourceError(f"landmarks.tags: {tags.min()} is negative; expected whole numbers from 0 up")
    if tags.max() >= 2**53:  # maps keep tags beside coordinates, as floats
        raise SourceError(f"landmarks.tags: {tags.max()} is too large; expected whole numbers below 2^53")
    unique, count = np.unique(tags, return_counts=True)
    if len(unique) < len(tags):
        twice = unique[np.argmax(count > 1)]
        raise SourceError(f"landmarks.tags: {twice} is there {count.max()} times; expected each tag once")


def check_walls(world: World) -> None:
    """Raise `SourceError` unless there are walls, at finite places and with a length, and people as they should be."""
    theta = world.walls.theta
    if not 1 <= len(theta) <= MAX_WALLS:
        raise SourceError(f"walls.segments: there are {len(theta)}; expected 1 to {MAX_WALLS}")
    odd = ~(np.abs(theta) <= LARGEST).all(axis=1)
    if odd.any():
        at = int(np.argmax(odd))
        raise SourceError(f"walls.segments[{at}] is {_row(theta[at])}; expected finite metres, at most {LARGEST:g}")
    short = lengths(theta) < SHORTEST
    if short.any():
        at = int(np.argmax(short))
        raise SourceError(
            f"walls.segments[{at}] is {_row(theta[at])}, a wall of no length; expected two ends that differ"
        )
    check_movers(world.movers)


def lengths(walls: Floats) -> Floats:
    """(n,) [m] of the walls (n, 4)."""
    return np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1])


def _row(wall: Floats) -> str:
    return f"[{', '.join(f'{c:g}' for c in wall)}]"
