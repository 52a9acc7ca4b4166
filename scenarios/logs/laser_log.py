"""From what a laser log says, scan by scan, to a `Source`: what came back, how the robot moved, what is odd."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenarios.logs.odometry import increments, path_length
from scenarios.types import LogScans, Source, SourceError, Step
from scenarios.words import counted, times
from slam.features import Wall
from slam.geometry import circular_mean, compose, invert, wrap_all
from slam.motion import Odometry
from slam.presets import LOG
from slam.types import Floats, Frame, Ints, Noise, Scan

ODOMETRY = 0.4
"""Deviation of an increment of odometry, as a fraction of the motion.

Real odometry errs in one direction for long, as independent errors do not, and so more is believed of each: with Dual
FastSLAM, K = 100 and seed 0, relations of mit-csail are .28, .11 and .51 m off with .2, .4 and .8, those of intel 4.0,
.26 and .16 m.
"""

LEAST_RANGE_NOISE = 0.01
"""[m] that is believed of a measured range at least: beside the noise from beam to beam there are errors that all beams
of a scan share."""

NEARBY = 8.0
"""[m] within which walls are nearly straight from beam to beam."""

TOP = 0.01
"""The share of the largest range of a log in which the values lie that stand for no return: 81.83 to 81.91 m, 51.05 to
51.22 m, 8.183 to 8.191 m, as scanners have it."""

MARGIN = 0.002
"""As a share of it, how far below a value that stands for no return others may lie that stand for the same."""

CROWD = 10
"""How many times more readings than in the `TOP` below there must be, for these to be no returns."""

NORMAL_MEDIAN = 0.6745
"""The median of the absolute value of a standard normal number."""

FIXED = (0.05, 0.05)
"""[m, rad] within which the laser stays in its place on the robot, for 95 of 100 scans.  Where it does not, its pose is
not that of odometry but one that somebody corrected."""

JUMP_BACK, JUMP_AHEAD = 1.0, 60.0
"""[s] of a time stamp against the one before that deserve a warning; stamps jitter by up to a second."""

LEAP = 5.0
"""[m] between two scans that deserve a warning: odometry that was reset, or a robot that was carried."""

ALMOST = 1.0 + 1e-6
"""Of the largest range that came back, what is taken for the laser's own where nothing tells."""

FIELD_OF_VIEW = {
    180: (-90.0, 1.0),
    181: (-90.0, 1.0),
    360: (-90.0, 0.5),
    361: (-90.0, 0.5),
    400: (-50.0, 0.25),
    401: (-50.0, 0.25),
}
"""[degrees] first beam and spacing of the lasers of old logs, by the number of beams."""


class Beams(NamedTuple):
    """Scans whose beams look the same way."""

    rows: Ints
    """(G,) which scans of the log."""
    bearings: Floats
    """(B,) [rad]"""
    ranges: Floats
    """(G, B) [m] as they were logged."""
    limit: float = float("inf")
    """[m] from which on nothing came back, if the log says it."""


class LaserLog(NamedTuple):
    """What a log says, scan by scan in the order of the file."""

    format: str
    path: Path
    lines: Ints
    """(N,) line of each scan."""
    stamps: Floats
    """(N,) [s]"""
    odometry: Floats
    """(N, 3) [m, m, rad] pose of the robot."""
    laser: Floats
    """(N, 3) pose of the laser, by odometry or corrected."""
    beams: tuple[Beams, ...]
    warnings: tuple[str, ...]

    def place(self, scan: int) -> str:
        """`file:line` of a scan."""
        return f"{self.path}:{self.lines[scan]}"


def spread(path: Path, lines: Ints, groups: Sequence[Beams]) -> tuple[tuple[Beams, ...], list[str]]:
    """The scans of a log that does not say where its beams look, with their bearings by the number of beams.

    `lines` (N,) are those of all scans.  Raises `SourceError` where numbers differ that do not tell it.
    """
    counts = {group.ranges.shape[1] for group in groups} - {0}
    found, warnings = [], []
    for group in groups:
        n, first = group.ranges.shape[1], f"{path}:{lines[group.rows[0]]}"
        if n in FIELD_OF_VIEW:
            start, spacing = FIELD_OF_VIEW[n]
            bearings = np.radians(start + spacing * np.arange(n))
            if len({FIELD_OF_VIEW.get(count) for count in counts}) > 1:
                scans = counted(len(group.rows), "scan")
                warnings.append(
                    f"{first}: the number of readings changes, and nothing tells where the beams look; those of "
                    f"{scans} of {n} are taken to be {spacing:g} degrees apart, from {start:g}"
                )
        else:
            if n and len(counts) > 1:
                others = " or ".join(str(count) for count in sorted(counts - {n}))
                raise SourceError(
                    f"{first}: {n} readings where other scans have {others}, and nothing tells where the beams look; "
                    "expected as many in every scan"
                )
            if n:
                warnings.append(
                    f"{first}: nothing tells where the {n} beams look; they are taken to be spread over 180 degrees"
                )
            bearings = np.linspace(-0.5 * np.pi, 0.5 * np.pi, n)
        found.append(group._replace(bearings=bearings))
    return tuple(found), warnings


def source_of(log: LaserLog) -> Source:
    """Every scan as a step with one increment of odometry since the scan before.

    Where the pose of the laser is not that of odometry, it is the truth, and the laser is taken to be where the robot
    is.  Raises `SourceError`.
    """
    _check_finite(log)
    beams, warnings = _cleaned(log)
    origin, reference = _origin(log)
    return Source(
        name=log.path.name.removesuffix(".gz").rpartition(".")[0] or log.path.name,
        title=_title(log, beams, reference is not None),
        kind="log",
        motion=Odometry(),
        feature=Wall(),
        steps=tuple(_steps(log, beams, origin, reference)),
        start=(log.odometry if reference is None else reference)[0].copy(),
        noise=Noise(range=range_noise(beams), odometry=ODOMETRY),
        max_range=max(group.limit for group in beams),
        defaults=dict(LOG),
        warnings=(*log.warnings, *warnings, *_time_warnings(log), *_leap_warnings(log), *_rest_warnings(log)),
        scans=LogScans(log.stamps, log.odometry, np.arange(len(log.stamps))),
    )


def _title(log: LaserLog, beams: Sequence[Beams], has_truth: bool) -> str:
    counts = [len(group.bearings) for group in beams if len(group.bearings)]
    number = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    return (
        f"{log.format} {log.path.name}: {counted(len(log.stamps), 'scan')} of {number} beams, "
        f"{path_length(log.odometry):.0f} m by odometry{', corrected poses as truth' if has_truth else ''}"
    )


def _steps(log: LaserLog, beams: Sequence[Beams], origin: Floats, reference: Floats | None) -> list[Step]:
    """One for each scan (N,); `reference` (N, 3) is the truth."""
    scans = {
        row: Scan(ranges, group.bearings, origin, group.limit)
        for group in beams
        for row, ranges in zip(group.rows.tolist(), group.ranges, strict=True)
    }
    motion, feature = Odometry(), Wall()
    nothing, no_tags = np.empty((0, Wall.observation)), np.empty(0, np.int64)
    u, dt = increments(log.odometry)[:, None], _durations(log.stamps)[:, None]
    return [
        Step(
            Frame(time, motion, u[k], dt[k], feature, nothing, no_tags, scans[k]),
            None if reference is None else reference[k],
        )
        for k, time in enumerate(log.stamps.tolist())
    ]


def _check_finite(log: LaserLog) -> None:
    for values, what in ((log.stamps[:, None], "time stamp"), (log.odometry, "odometry"), (log.laser, "pose")):
        good = np.isfinite(values).all(axis=1)
        if not good.all():
            row = int(np.argmin(good))
            shown = " ".join(f"{value:g}" for value in values[row])
            raise SourceError(f"{log.place(row)}: {what} {shown}; expected finite numbers")


def _origin(log: LaserLog) -> tuple[Floats, Floats | None]:
    """(3,) where the laser is on the robot, and the corrected poses (N, 3) if its own are not those of odometry."""
    offset = compose(invert(log.odometry), log.laser)
    middle = np.median(offset[:, :2], axis=0)
    origin = np.array([*middle, circular_mean(offset[:, 2], np.ones(len(offset)))])
    away = np.abs(np.stack([np.hypot(*(offset[:, :2] - middle).T), wrap_all(offset[:, 2] - origin[2])], axis=1))
    if (np.quantile(away, 0.95, axis=0) <= FIXED).all():
        return origin.round(4), None
    if not np.ptp(log.odometry, axis=0).any():
        raise SourceError(
            f"{log.path}: no odometry, the pose of the robot is {log.odometry[0].tolist()} in all {len(offset)} scans "
            "while that of the laser changes; expected the pose by odometry last in each line"
        )
    return np.zeros(3), log.laser


def _durations(stamps: Floats) -> Floats:
    """(N,) [s] since the scan before; where stamps jitter no time passes twice, where a clock is set back none."""
    runs = np.split(stamps, np.flatnonzero(np.diff(stamps) < -JUMP_BACK) + 1)
    passed = np.concatenate([np.maximum.accumulate(run) for run in runs])
    return np.maximum(np.diff(passed, prepend=passed[0]), 0.0)


def _time_warnings(log: LaserLog) -> list[str]:
    step = np.diff(log.stamps)
    odd = np.flatnonzero((step < -JUMP_BACK) | (step > JUMP_AHEAD))
    if not len(odd):
        return []
    return [
        f"{log.place(int(odd[0]) + 1)}: {times(len(odd))} the time stamps jump, back by more than {JUMP_BACK:g} s or "
        f"ahead by more than {JUMP_AHEAD:g} s, here by {step[odd[0]]:.3f} s; the order is that of the file"
    ]


def _leap_warnings(log: LaserLog) -> list[str]:
    way = np.hypot(*np.diff(log.odometry[:, :2], axis=0).T)
    odd = np.flatnonzero(way > LEAP)
    if not len(odd):
        return []
    return [
        f"{log.place(int(odd[0]) + 1)}: {times(len(odd))} the odometry leaps by more than {LEAP:g} m between two "
        f"scans, here by {way[odd[0]]:.1f} m"
    ]


def _rest_warnings(log: LaserLog) -> list[str]:
    """That the odometry never changes: of a robot at rest, or of one that has none."""
    if len(log.odometry) < 2 or np.ptp(log.odometry, axis=0).any():
        return []
    return [f"{log.path}: by its odometry the robot never moves, so all scans are taken to be from one place"]


def _cleaned(log: LaserLog) -> tuple[list[Beams], list[str]]:
    """The scans with inf where nothing came back, a finite limit for each, and warnings."""
    told = [np.isfinite(b.ranges) & (b.ranges > 0) | np.isposinf(b.ranges) for b in log.beams]
    bad = sum(int((~good).sum()) for good in told)
    warnings = []
    if bad:
        row = min(int(b.rows[~good.all(axis=1)][0]) for b, good in zip(log.beams, told, strict=True) if not good.all())
        what = "a range is zero, negative or no number; it is taken for a beam that nothing came back to"
        if bad > 1:
            what = (
                f"{bad} ranges are zero, negative or no number, here for the first time; they are taken for beams that "
                "nothing came back to"
            )
        warnings.append(f"{log.place(row)}: {what}")
    measured = [b.ranges[good & np.isfinite(b.ranges)] for b, good in zip(log.beams, told, strict=True)]
    readings = np.concatenate([*measured, np.zeros(0)])
    if not len(readings):
        raise SourceError(f"{log.path}: nothing came back to the laser in any of its {len(log.stamps)} scans")
    silence, largest = no_return(readings), float(readings.max())
    cleaned = []
    for group, good in zip(log.beams, told, strict=True):
        limit = min(group.limit, silence)
        if not np.isfinite(limit):
            limit = largest * ALMOST
        cleaned.append(group._replace(ranges=_silenced(group.ranges, good, limit), limit=limit))
    return cleaned, warnings


def range_noise(groups: Sequence[Beams]) -> float:
    """[m] deviation of a range, as a log shows it itself; the steps that a scanner rounds to are in it.

    Along a wall ranges change evenly from beam to beam.  So the second difference of three neighbours is noise, of six
    times the variance of one, but where something begins or ends: hence its median.
    """
    seen = []
    for group in groups:
        with np.errstate(invalid="ignore"):
            second = group.ranges[:, 2:] - 2.0 * group.ranges[:, 1:-1] + group.ranges[:, :-2]
            seen.append(np.abs(second[np.isfinite(second) & (group.ranges[:, 1:-1] < NEARBY)]))
    values = np.concatenate([*seen, np.zeros(0)])
    found = float(np.median(values)) / NORMAL_MEDIAN / math.sqrt(6.0) if len(values) else 0.0
    return max(found, LEAST_RANGE_NOISE)


def _silenced(ranges: Floats, good: NDArray[np.bool_], limit: float) -> Floats:
    with np.errstate(invalid="ignore"):
        return np.where(good & (ranges < limit), ranges, np.inf)


def no_return(readings: Floats) -> float:
    """[m] from which on the readings (n,) of a log stand for no return; inf where none do.

    Scanners give a number or a few at the very end of their range for it.  A real world has fewer readings the farther
    they are, so many more at the end than just below are no readings.
    """
    largest = float(readings.max())
    top = readings[readings >= (1.0 - TOP) * largest]
    below = np.count_nonzero(readings >= (1.0 - 2.0 * TOP) * largest) - len(top)
    if len(top) < CROWD * max(below, 0.3):
        return float("inf")
    values, counts = np.unique(np.round(top, 3), return_counts=True)
    return (1.0 - MARGIN) * float(values[counts >= 0.01 * len(top)][0])
