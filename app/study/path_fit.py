"""How well a path through a laser log fits what is known of it: relations, true poses, places that it comes back to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.errors import UsageError
from scenarios.types import Source
from slam.alignment import align_rigid
from slam.geometry import compose, invert
from slam.metrics import rms
from slam.relations import RelationErrors
from slam.types import Floats

NEAR = 0.5
"""[m] A loop is closed if the robot is no farther than that from where it truly is, as seen from its earlier pose."""


class Closure(NamedTuple):
    """Two scans of the log, and what is known of the way between them."""

    first: int
    second: int
    between: Floats
    """(3,) the second true pose, as seen from the first."""


class Fit(NamedTuple):
    """How well one path fits what is known; NaN where nothing is."""

    relations: int
    """How many relations are between scans of the path."""
    mean_m: float
    """Of their errors, as all down to `rotation_rad`."""
    median_m: float
    p95_m: float
    max_m: float
    rotation_rad: float
    """The mean."""
    aligned_rms_m: float
    """Of the positions, after the best rigid motion of the path onto the truth."""
    closures_m: tuple[float, ...]
    """How far the robot is off at the second scan of each closure, as seen from the first."""


def closures_of(pairs: Sequence[tuple[int, int]], source: Source, whole: Source) -> tuple[Closure, ...]:
    """Pairs of scans that a source covers, with what `whole`, every scan of the same log, knows of them.

    Raises `UsageError` for scans beyond the source and for those whose true poses nobody knows.
    """
    assert source.scans is not None
    low, high = int(source.scans.kept[0]), int(source.scans.kept[-1])
    if all(step.truth is None for step in whole.steps):
        raise UsageError(
            f"--closures needs true poses, and {source.name} has none; expected --reference FILE beside it"
        )
    found = []
    for first, second in pairs:
        pair = f"--closures is {first}:{second}"
        if not (low <= first <= high and low <= second <= high) or first == second:
            raise UsageError(f"{pair}; expected two of the scans {low} to {high}, the part of the log that is run")
        a, b = whole.steps[first].truth, whole.steps[second].truth
        if a is None or b is None:
            unknown = first if a is None else second
            raise UsageError(
                f"{pair}, but nobody knows the true pose of scan {unknown}; expected scans where it is known"
            )
        found.append(Closure(first, second, compose(invert(a), b)))
    return tuple(found)


def fit(source: Source, path: Floats, errors: RelationErrors | None, closures: Sequence[Closure]) -> Fit:
    """How well a path (M, 3) fits: the poses of all scans of the log from the first step of the source to its last."""
    assert source.scans is not None
    steps = path[source.scans.kept - source.scans.kept[0]]
    off = []
    for first, second, between in closures:
        a, b = path[[first, second] - source.scans.kept[0]]
        off.append(math.dist(compose(invert(a), b)[:2], between[:2]))
    used, translation, rotation = 0, (math.nan,) * 5, math.nan
    if errors is not None and errors.translation_m is not None and errors.rotation_rad is not None:
        used, translation, rotation = errors.used, errors.translation_m, errors.rotation_rad.mean
    mean, _, median, p95, largest = translation
    return Fit(used, mean, median, p95, largest, rotation, aligned_rms(source, steps), tuple(off))


def aligned_rms(source: Source, poses: Floats) -> float:
    """[m] of the positions of all steps, poses (T, 3), moved rigidly onto the truth; NaN where that is not known."""
    known = np.array([step.truth is not None for step in source.steps])
    if known.sum() < 2:
        return math.nan
    truth = np.array([step.truth for step in source.steps if step.truth is not None])[:, :2]
    R, t = align_rigid(poses[known, :2], truth)
    return rms(np.linalg.norm(poses[known, :2] @ R.T + t - truth, axis=1))
