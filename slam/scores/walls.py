"""Walls, seen in part: one wall may rightly become several features, side by side (`slam.scores.Scores`).

Because it is seen in two pieces that nothing joins, or because it continues as a new feature far from where the first
one was made.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slam._jit import inline, kernel
from slam.alignment import align_to_lines
from slam.features.wall import ends, stretch
from slam.geometry import compose
from slam.scores.tags import known_pairs
from slam.types import UNKNOWN_TAG, Bools, Floats, Ints

COVERED = 0.5
"""Share of a wall that others must cover to make it a duplicate."""


def map_errors(theta: Floats, tags: Ints, true_tags: Ints, true_theta: Floats) -> tuple[float, float]:
    """[m] RMS distance of the ends of the walls theta (n, 8) from the lines of the true ones (m, 4), x0 y0 x1 y1.

    Aligned and as they lie.  How far along its line a wall was seen is no error.
    """
    which, at = known_pairs(tags, true_tags)
    if len(which) == 0:
        return math.nan, math.nan
    walls, start, along = theta[which], true_theta[at, :2], true_theta[at, 2:] - true_theta[at, :2]
    heading = np.arctan2(along[:, 1], along[:, 0])
    turn = heading - walls[:, 2]
    angle = math.atan2(np.sin(turn).sum(), np.cos(turn).sum())
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=1).repeat(2, axis=0)
    p, q = ends(walls).reshape(-1, 2), start.repeat(2, axis=0)
    R, t = align_to_lines(p, q, normal, angle)
    return _rms_offset(p @ R.T + t - q, normal), _rms_offset(p - q, normal)


def duplicates(theta: Floats, tags: Ints) -> float:
    """How many features (n, 8) show again what earlier ones of the same known tag show; NaN if no tag is known.

    Such a one has at least half of the shorter of the two in common with one of them, or at least half of itself with
    all of them together.
    """
    if len(tags) > 0 and (tags == UNKNOWN_TAG).all():
        return math.nan
    return float(_covered(theta, tags, np.argsort(tags, kind="stable"), np.empty((len(tags), 2))))


def held(feature: Any, theta: Floats, map_tags: Ints, s: Floats, z: Floats, tags: Ints) -> Bools:
    """(Z,) whether a feature (n, 8) of the tag lies where the piece z (Z, 11) is, or ends less than the slack away.

    The first sight of another part of a long wall is something new.  How far to the side the feature lies is no matter:
    who is lost, and does not know a wall again that his map has metres away, has missed it.
    """
    found = np.zeros(len(tags), np.bool_)
    _held(theta, map_tags, compose(s, z[:, :3]), z, tags, float(feature.slack), found)
    return found


def _rms_offset(from_line: Floats, normal: Floats) -> float:
    return math.sqrt(float(np.mean(np.sum(from_line * normal, axis=1) ** 2)))


@kernel
def _covered(theta: Any, tags: Any, order: Any, reaches: Any) -> Any:
    """`order` (n,) brings equal tags together, earlier features first; `reaches` (n, 2) is work space."""
    count = 0
    for j in range(len(order)):
        wall, M = theta[order[j]], 0
        length, found = wall[4] - wall[3], False
        for i in range(j - 1, -1, -1):
            other = theta[order[i]]
            if tags[order[i]] != tags[order[j]] or tags[order[j]] == UNKNOWN_TAG:
                break
            low, high = stretch(wall, other, other[3], other[4])
            reaches[M, 0], reaches[M, 1] = max(low, wall[3]), min(high, wall[4])
            if reaches[M, 1] - reaches[M, 0] >= COVERED * min(length, other[4] - other[3]):
                found = True
                break
            M += 1
        if found or (M > 1 and _union(reaches, M, wall[3]) >= COVERED * length):
            count += 1
    return count


@inline
def _union(reaches: Any, M: Any, start: Any) -> Any:
    """[m] that the first M intervals (low, high) cover together; those with low > high are empty, none is before
    `start`."""
    covered, at = 0.0, start
    while True:
        first, to = math.inf, at
        for i in range(M):
            low, high = reaches[i, 0], reaches[i, 1]
            if low <= at:
                to = max(to, high)
            elif low <= high:
                first = min(first, low)
        if to > at:
            covered += to - at
            at = to
        elif first < math.inf:
            at = first
        else:
            return covered


@kernel
def _held(theta: Any, map_tags: Any, places: Any, z: Any, tags: Any, slack: Any, found: Any) -> None:
    """Into `found` (Z,); `places` (Z, 3) are the frames of the pieces in the world."""
    for i in range(len(tags)):
        for j in range(len(map_tags)):
            if map_tags[j] == tags[i]:
                low, high = stretch(theta[j], places[i], z[i, 3], z[i, 4])
                if low - theta[j, 4] <= slack and theta[j, 3] - high <= slack:
                    found[i] = True
                    break
