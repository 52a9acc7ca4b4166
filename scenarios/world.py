"""What stands still: the landmarks of a world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from scenarios.checks import LARGEST
from scenarios.types import SourceError, TrueMap

MAX_LANDMARKS = 1_000_000


@dataclass(frozen=True, eq=False)
class World:
    """The things a sensor can see, where they truly are."""

    landmarks: TrueMap


def world_of_points(points: ArrayLike, tags: ArrayLike | None = None) -> World:
    """Point landmarks at (n, 2) [m, m], tagged 0, 1, 2 ... in this order unless `tags` (n,) are given."""
    theta = np.array(points, float).reshape(-1, 2)
    return World(TrueMap(np.arange(len(theta)) if tags is None else np.array(tags, np.int64), theta))


def check_world(world: World) -> None:
    """Raise `SourceError` unless there are landmarks, at finite places, each with a tag of its own."""
    tags, theta = world.landmarks
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
