"""Point landmarks: a feature is where it is, and one of a thing is enough (`slam.scores.Scores`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slam.alignment import align_rigid
from slam.scores.tags import known_pairs
from slam.types import UNKNOWN_TAG, Bools, Floats, Ints


def map_errors(theta: Floats, tags: Ints, true_tags: Ints, true_theta: Floats) -> tuple[float, float]:
    """[m] RMS distance of the features theta (n, 2) from the true ones (m, 2), aligned and as they lie."""
    which, at = known_pairs(tags, true_tags)
    if len(which) == 0:
        return math.nan, math.nan
    p, q = theta[which], true_theta[at]
    R, t = align_rigid(p, q)
    return _rms_distance(p @ R.T + t, q), _rms_distance(p, q)


def duplicates(theta: Floats, tags: Ints) -> float:
    """How many features there are beyond one for each known tag; NaN if none is known."""
    known = tags[tags != UNKNOWN_TAG]
    if len(known) == 0 and len(tags) > 0:
        return math.nan
    return float(len(known) - len(np.unique(known)))


def held(feature: Any, theta: Floats, map_tags: Ints, s: Floats, z: Floats, tags: Ints) -> Bools:
    """(Z,) whether a feature has the tag."""
    return (tags[:, None] == map_tags).any(axis=1)


def _rms_distance(p: Floats, q: Floats) -> float:
    return math.sqrt(float(np.sum((p - q) ** 2)) / len(p))
