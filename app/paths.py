"""Paths through all the scans of a log, from the poses at the steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.types import SessionInfo, SessionStep, best_path
from scenarios.logs.keyframes import every_scan
from slam.geometry import compose
from slam.types import Floats

ODOMETRY, MATCHED = "odometry", "matching"
"""What needs no filter: the odometry of the steps, and what scan matching alone makes of it."""


class Paths:
    """An observer that keeps where odometry, and matching alone, have the robot, and what was matched on the way."""

    last: SessionStep | None = None

    def __init__(self) -> None:
        self._alone: dict[str, list[Floats]] = {ODOMETRY: [], MATCHED: []}
        self._between: list[Floats] = []

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self._source = info.source

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        self.last = step
        self._alone[ODOMETRY].append(step.odometry)
        if step.matched is None:
            return
        before = self._alone[MATCHED][-1] if self._alone[MATCHED] else np.asarray(self._source.start, float)
        self._between.append(compose(before, step.match.passed if step.match else np.zeros((0, 3))))
        self._alone[MATCHED].append(step.matched)

    def end(self) -> None:
        """There is nothing to complete."""

    def alone(self) -> dict[str, Floats]:
        """The poses (T, 3) at the steps by `ODOMETRY`, and by `MATCHED` if all of them were matched."""
        steps = len(self._alone[ODOMETRY])
        return {key: np.array(poses) for key, poses in self._alone.items() if len(poses) == steps > 0}

    def found(self) -> dict[str, tuple[Floats, Floats]]:
        """Stamps (M,) [s] and poses (M, 3) of all scans of a log, or else of all steps: by `ODOMETRY`, by `MATCHED` if
        there is that, and of the best particle's lineage of each filter by its key."""
        if self.last is None:
            return {}
        alone = self.alone()
        ways = {ODOMETRY: every_scan(self._source, alone.pop(ODOMETRY))}
        alone |= {key: best_path(update) for key, update in self.last.filters.items()}
        return ways | {key: self.every_scan(poses) for key, poses in alone.items()}

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
        at, poses = np.concatenate([scans.kept[: len(matched)], *known]), np.concatenate([matched, *self._between])
        if len(at) != len(poses):  # a step without a scan, or ticks that are not those of the scans on the way
            return None
        order = np.argsort(at)
        finer = replace(self._source, scans=scans._replace(kept=at[order]))
        return every_scan(finer, poses[order])[1]
