"""Paths through all the scans of a log, from the poses at the steps."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from app.types import SessionInfo, SessionStep, best_path
from scenarios.logs.keyframes import every_scan
from slam.geometry import compose
from slam.types import Floats

ODOMETRY, MATCHED = "odometry", "matching"
"""What needs no filter: the odometry of the steps, and what scan matching alone makes of it."""


class Row(NamedTuple):
    """Of a step."""

    odometry: Floats
    """(3,)"""
    matched: Floats | None
    """(3,) by matching alone; None where the scan was not matched."""
    passed: Floats
    """(n, 3) the scans before it that were matched on the way."""


class Paths:
    """An observer that keeps where odometry, and matching alone, have the robot, and what was matched on the way."""

    last: SessionStep | None = None

    def __init__(self) -> None:
        self._rows: list[Row] = []

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self._source = info.source

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        self.last = step
        matched, passed = None, np.zeros((0, 3))
        if step.matched is not None:
            before = self._rows[-1].matched if self._rows else np.asarray(self._source.start, float)
            matched = step.matched
            if step.match is not None and before is not None:
                passed = compose(before, step.match.passed)
        self._rows.append(Row(step.odometry, matched, passed))

    def until(self, step: SessionStep) -> Paths:
        """The same as it was after an earlier step."""
        earlier = self.first(step.index)
        earlier.last = step
        return earlier

    def first(self, count: int) -> Paths:
        """What is known of so many steps, to which others may be added than have followed."""
        earlier = Paths()
        earlier._source, earlier._rows = self._source, self._rows[:count]
        return earlier

    def end(self) -> None:
        """There is nothing to complete."""

    @property
    def steps(self) -> int:
        """How many were seen."""
        return len(self._rows)

    @property
    def first_scan(self) -> int:
        """Number in the log of the scan with which the paths through all scans begin."""
        return 0 if self._source.scans is None else int(self._source.scans.kept[0])

    def alone(self) -> dict[str, Floats]:
        """The poses (T, 3) at the steps by `ODOMETRY`, and by `MATCHED` if all of them were matched."""
        columns = {ODOMETRY: [row.odometry for row in self._rows], MATCHED: [row.matched for row in self._rows]}
        return {key: np.array(poses) for key, poses in columns.items() if poses and not any(p is None for p in poses)}

    def found(self) -> dict[str, tuple[Floats, Floats]]:
        """Stamps (M,) [s] and poses (M, 3) of all scans of a log, or else of all steps: by `ODOMETRY`, by `MATCHED` if
        there is that, and of the best particle's lineage of each filter by its key."""
        if self.last is None:
            return {}
        alone, between = self.alone(), self._matched_odometry()
        ways = {ODOMETRY: every_scan(self._source, alone.pop(ODOMETRY))}
        alone |= {key: best_path(update) for key, update in self.last.filters.items()}
        return ways | {key: every_scan(self._source, poses, True, between) for key, poses in alone.items()}

    def every_scan(self, poses: Floats, fit: bool = True) -> tuple[Floats, Floats]:
        """Stamps (M,) [s] and poses (M, 3) of all scans of a log, from those (T, 3) of all steps (`every_scan`): on the
        way from one to the next by the scans that were matched there, or else by odometry."""
        return every_scan(self._source, poses, fit, self._matched_odometry())

    def _matched_odometry(self) -> Floats | None:
        """(M, 3) what takes the place of the log's odometry, if anything does."""
        scans, matched = self._source.scans, self.alone().get(MATCHED)
        if scans is None or matched is None or not scans.between:
            return None
        known = [np.zeros(0, np.int64), *scans.between[: len(matched)]]
        passed = [row.passed for row in self._rows]
        at, poses = np.concatenate([scans.kept[: len(matched)], *known]), np.concatenate([matched, *passed])
        if len(at) != len(poses):  # a step without a scan, or ticks that are not those of the scans on the way
            return None
        order = np.argsort(at)
        finer = replace(self._source, scans=scans._replace(kept=at[order]))
        return every_scan(finer, poses[order])[1]
