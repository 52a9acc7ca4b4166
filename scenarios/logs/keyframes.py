"""Fewer steps: only those between which the robot has moved, and the way back, a pose for every scan of the log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scenarios.checks import check_number
from scenarios.logs.odometry import carried, travelled
from scenarios.types import Source, SourceError, Step
from slam.geometry import wrap_all
from slam.motion import Odometry
from slam.types import Floats, Ints

USUAL = (0.5, math.radians(15.0))
"""[m, rad] of motion between two keyframes of a laser log.

Two looks at one wall from nearly one place have the same errors, and are believed twice: with half of it between two
looks, relations of the first 7000 scans of MIT Killian are half a metre off instead of four centimetres."""

PASSING = (0.25, math.radians(8.0))
"""[m, rad] of motion after which a scan on the way is kept, too: to be matched, which goes the better the nearer
scans are."""


Motion = tuple[float, float, float]

NOWHERE: Motion = (0.0, 0.0, 0.0)


def keyframes(source: Source, distance: float, turn: float) -> Source:
    """The steps until which the robot, by its odometry, has gone `distance` [m] or turned `turn` [rad] since the last.

    The first and the last step are kept.  What lies between two that are is an increment, or several with scans
    `PASSING` from each other between them.  A robot at rest makes no keyframe however long it rests: its scans say
    nothing new.  Raises `SourceError` for a source without odometry in increments, and for distances and turns below
    zero.
    """
    check_number("keyframe distance", distance, "m", least=0)
    check_number("keyframe turn", turn, "rad", least=0)
    if not isinstance(source.motion, Odometry):
        raise SourceError(f"{source.name}: no keyframes without increments of odometry; expected a log of a laser")
    kept: list[Step] = []
    index: list[int] = []
    moved, tick, passed = NOWHERE, NOWHERE, 0.0
    ticks: list[tuple[Motion, float]] = []
    between: list[int] = []
    passed_by: list[Ints] = []
    last = len(source.steps) - 1
    for i, step in enumerate(source.steps):
        for u in step.frame.u.tolist():
            moved, tick = _then(moved, u), _then(tick, u)
        passed += float(step.frame.dt.sum())
        if i in (0, last) or _reaches(moved, distance, turn):
            u, dt = zip(*ticks, (tick, passed), strict=True)
            scans = tuple(scan for j in between if (scan := source.steps[j].frame.scan) is not None)
            frame = step.frame._replace(u=np.array(u), dt=np.array(dt), between=scans)
            kept.append(step._replace(frame=frame))
            index.append(i)
            passed_by.append(np.array(between, np.int64))
            moved, tick, passed, ticks, between = NOWHERE, NOWHERE, 0.0, [], []
        elif step.frame.scan is not None and _reaches(tick, *PASSING):
            ticks.append((tick, passed))
            between.append(i)
            tick, passed = NOWHERE, 0.0
    log = source.scans
    if log is not None:
        log = log._replace(kept=log.kept[index], between=tuple(log.kept[by] for by in passed_by))
    options = {**source.options, "keyframe": [distance, math.degrees(turn)]}
    return replace(source, steps=tuple(kept), scans=log, options=options)


def _reaches(moved: Motion, distance: float, turn: float) -> bool:
    return math.hypot(moved[0], moved[1]) >= distance or abs(moved[2]) >= turn


def _then(moved: Motion, u: Sequence[float]) -> Motion:
    """The motion and then the increment u; the heading counts whole turns."""
    c, s = math.cos(moved[2]), math.sin(moved[2])
    return moved[0] + c * u[0] - s * u[1], moved[1] + s * u[0] + c * u[1], moved[2] + u[2]


def every_scan(
    source: Source, poses: Floats, fit: bool = True, odometry: Floats | None = None
) -> tuple[Floats, Floats]:
    """Stamps (M,) [s] and poses (M, 3) of all scans of a log between its first step and that of the last pose.

    poses (T, 3): those of the first T steps.  Between two steps a pose goes on by odometry, that of the log or a better
    one (M, 3); and with `fit`, what it is off at the second one is spread over the way there, in proportion to what the
    robot has travelled.  Without, nothing is known yet of what comes.
    """
    if source.scans is None:
        return np.array([step.frame.time for step in source.steps[: len(poses)]]), poses
    kept = source.scans.kept[: len(poses)]
    if not len(kept):
        return np.zeros(0), np.zeros((0, 3))
    begin = kept[0]
    if odometry is None:
        odometry = source.scans.odometry[begin : kept[-1] + 1]
    at = kept - begin
    before = np.searchsorted(at, np.arange(len(odometry)), side="right") - 1  # for each scan its last step
    found = carried(poses[before], odometry[at[before]], odometry)
    if fit:
        off = np.zeros_like(poses)
        off[:-1] = poses[1:] - carried(poses[:-1], odometry[at[:-1]], odometry[at[1:]])
        off[:, 2] = wrap_all(off[:, 2])
        found += _share(odometry, at, before)[:, None] * off[before]
        found[:, 2] = wrap_all(found[:, 2])
    return source.scans.stamps[begin : kept[-1] + 1], found


def _share(odometry: Floats, at: Ints, before: Ints) -> Floats:
    """(M,) how much of the way between two steps the robot has travelled; where it rests, of the scans."""
    shares = []
    for way in (travelled(odometry), np.arange(len(odometry), dtype=float)):
        whole = np.diff(way[at], append=way[-1])[before]
        shares.append(np.where(whole > 0, (way - way[at[before]]) / np.where(whole > 0, whole, 1.0), np.nan))
    return np.nan_to_num(np.where(np.isnan(shares[0]), shares[1], shares[0]))
