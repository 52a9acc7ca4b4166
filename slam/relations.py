"""How well a path fits relations between pairs of its poses (Kuemmerle et al., Autonomous Robots 27, 2009).

No frame of reference is needed, and an error that was made once counts once, however far the rest of the path is moved
by it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam.geometry import compose, invert
from slam.types import Bools, Floats, Ints

SAME_STAMP = 1e-4
"""[s] within which two time stamps are those of one scan: logs have scans 0.6 ms apart, and files five decimals."""


class Spread(NamedTuple):
    """Of the errors of many relations."""

    mean: float
    std: float
    median: float
    p95: float
    max: float


class RelationErrors(NamedTuple):
    """Of one path."""

    used: int
    """Relations between poses of the path."""
    left_out: int
    """Others."""
    translation_m: Spread | None
    """None where no relation was used."""
    rotation_rad: Spread | None


def relation_errors(stamps: Floats, path: Floats, times: Floats, relations: Floats) -> RelationErrors:
    """Errors of a path (N, 3) with time stamps (N,) [s], in any order, against relations (R, 3) between `times` (R, 2).

    Of each the distance and the absolute angle between the second pose, seen from the first, and the relation.
    """
    scan, used = _scans_at(times, stamps)
    first, second = path[scan[used, 0]], path[scan[used, 1]]
    off = compose(invert(relations[used]), compose(invert(first), second))
    count = int(used.sum())
    if not count:
        return RelationErrors(0, len(times), None, None)
    return RelationErrors(
        count, len(times) - count, _spread(np.hypot(off[:, 0], off[:, 1])), _spread(np.abs(off[:, 2]))
    )


def _spread(errors: Floats) -> Spread:
    """Of the errors (n,)."""
    return Spread(
        float(errors.mean()),
        float(errors.std()),
        float(np.median(errors)),
        float(np.quantile(errors, 0.95)),
        float(errors.max()),
    )


def belongs(times: Floats, stamps: Floats) -> Bools:
    """(R,) whether there is a scan at both of the times (R, 2), of scans with stamps (N,) [s]."""
    return _scans_at(times, stamps)[1]


def within(times: Floats, stamps: Floats) -> Bools:
    """(R,) whether both of the times (R, 2) lie between the first and the last of the stamps (N,) [s]."""
    early, late = stamps.min() - SAME_STAMP, stamps.max() + SAME_STAMP
    return ((times >= early) & (times <= late)).all(axis=1)


def _scans_at(times: Floats, stamps: Floats) -> tuple[Ints, Bools]:
    """(R, 2) the scan nearest to each time, and (R,) whether both are at their times."""
    order = np.argsort(stamps, kind="stable")
    ordered = stamps[order]
    after = np.clip(np.searchsorted(ordered, times), 0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(np.abs(ordered[before] - times) <= np.abs(ordered[after] - times), before, after)
    there = np.abs(ordered[nearer] - times) <= SAME_STAMP
    return order[nearer], there[:, 0] & there[:, 1]
