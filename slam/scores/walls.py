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
from slam.features.wall import ends
from slam.geometry import compose
from slam.scores.tags import known_pairs
from slam.types import UNKNOWN_TAG, Bools, Floats, Ints

COVERED = 0.5
"""Share of a wall that another feature must cover to make it a duplicate."""


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
    """How many features (n, 8) are covered, for at least half of their length, by an earlier one of the same known tag;
    NaN if no tag is known."""
    if len(tags) > 0 and (tags == UNKNOWN_TAG).all():
        return math.nan
    return float(_covered(theta, tags, np.argsort(tags, kind="stable")))


def held(feature: Any, theta: Floats, map_tags: Ints, s: Floats, z: Floats, tags: Ints) -> Bools:
    """(Z,) whether a feature (n, 8) of the tag lies where the piece z (Z, 11) is, or ends less than the slack away.

    The first sight of another part of a long wall is something new.
    """
    found = np.zeros(len(tags), np.bool_)
    _held(theta, map_tags, compose(s, z[:, :3]), z, tags, float(feature.slack), found)
    return found


def _rms_offset(from_line: Floats, normal: Floats) -> float:
    return math.sqrt(float(np.mean(np.sum(from_line * normal, axis=1) ** 2)))


@inline
def _reach(theta: Any, place: Any, a: Any, b: Any) -> Any:
    """From where to where [m] along the axis of a wall a piece reaches that has its ends a, b in the frame `place`."""
    middle = math.cos(theta[2]) * (place[0] - theta[0]) + math.sin(theta[2]) * (place[1] - theta[1])
    turned = math.cos(place[2] - theta[2])
    return middle + min(turned * a, turned * b), middle + max(turned * a, turned * b)


@kernel
def _covered(theta: Any, tags: Any, order: Any) -> Any:
    """How many are covered by an earlier one; `order` (n,) brings equal tags together, earlier features first."""
    count = 0
    for j in range(len(order)):
        wall = theta[order[j]]
        for i in range(j - 1, -1, -1):
            other = theta[order[i]]
            if tags[order[i]] != tags[order[j]] or tags[order[j]] == UNKNOWN_TAG:
                break
            low, high = _reach(other, wall, wall[3], wall[4])
            if min(high, other[4]) - max(low, other[3]) >= COVERED * (wall[4] - wall[3]):
                count += 1
                break
    return count


@kernel
def _held(theta: Any, map_tags: Any, places: Any, z: Any, tags: Any, slack: Any, found: Any) -> None:
    """Into `found` (Z,); `places` (Z, 3) are the frames of the pieces in the world."""
    for i in range(len(tags)):
        for j in range(len(map_tags)):
            if map_tags[j] == tags[i]:
                low, high = _reach(theta[j], places[i], z[i, 3], z[i, 4])
                if low - theta[j, 4] <= slack and theta[j, 3] - high <= slack:
                    found[i] = True
                    break
