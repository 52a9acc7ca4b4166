"""What a map is worth beside the truth.

Each kind of feature has a module of its own with the functions of `Scores`, about the features theta (n, D) of one map,
with tags (n,).
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from slam.features import Wall
from slam.scores import points, walls
from slam.types import NEW, UNKNOWN_TAG, Bools, Floats, Ints

__all__ = ["Scores", "association_score", "points", "scores_of", "walls"]


class Scores(Protocol):
    """What is asked of a map."""

    @staticmethod
    def map_errors(theta: Floats, tags: Ints, true_tags: Ints, true_theta: Floats) -> tuple[float, float]:
        """[m] RMS distance of the features from the truth of the same tag: after the rigid motion that makes it least,
        and as the map lies.

        Every duplicate counts.  Features whose tag is unknown or not in the truth are left out; NaN if that leaves
        none.
        """
        ...

    @staticmethod
    def duplicates(theta: Floats, tags: Ints) -> float:
        """How many features show again what earlier ones show already; NaN if no tag is known."""
        ...

    @staticmethod
    def held(feature: Any, theta: Floats, map_tags: Ints, s: Floats, z: Floats, tags: Ints) -> Bools:
        """(Z,) whether the map holds what is observed as z (Z, d), of tags (Z,), from the pose s (3,)."""
        ...


def scores_of(feature: Any) -> Scores:
    """Those of a kind of feature."""
    return walls if isinstance(feature, Wall) else points


def association_score(n: Ints, tags: Ints, map_tags: Ints, held: Bools) -> tuple[int, int, int]:
    """(correct, wrong, missed) for the correspondences n (Z,) of things with tags (Z,).

    `map_tags` are those of the map's features before the step, and `held` (Z,) says which of the things are in it.
    Correct: paired with a feature born of the same thing, or NEW when the map does not hold it.  Wrong: paired with one
    born of something else.  Missed: all else, that is NEW or IGNORED although the map holds it, and IGNORED although it
    does not.  Not counted: things of unknown tag, and pairs with a feature of unknown tag.
    """
    known = tags != UNKNOWN_TAG
    unpaired = n < 0
    partner = np.full(len(n), UNKNOWN_TAG)
    partner[~unpaired] = map_tags[n[~unpaired]]
    right = (partner == tags) | ((n == NEW) & ~held)
    wrong = (partner != tags) & (partner != UNKNOWN_TAG)
    missed = unpaired & ~right
    return (
        int(np.count_nonzero(known & right)),
        int(np.count_nonzero(known & wrong)),
        int(np.count_nonzero(known & missed)),
    )
