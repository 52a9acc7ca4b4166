"""The paths of a session: by odometry alone, as scan matching alone corrects it, and of each filter."""

from __future__ import annotations

import numpy as np

from app.types import SessionInfo, SessionStep, best_path
from slam.types import Floats

ODOMETRY, MATCHED = "odometry", "matching"


class Paths:
    """An observer that keeps what it takes to tell them, whenever somebody asks."""

    def __init__(self) -> None:
        self.last: SessionStep | None = None
        self._alone: dict[str, list[Floats]] = {ODOMETRY: [], MATCHED: []}

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        self.last = step
        for key, pose in ((ODOMETRY, step.odometry), (MATCHED, step.matched)):
            if pose is not None:
                self._alone[key].append(pose)

    def end(self) -> None:
        """After the last one."""

    def alone(self) -> dict[str, Floats]:
        """(T, 3) at the steps so far of what needs no filter; of scan matching only if it was on all the time."""
        steps = len(self._alone[ODOMETRY])
        return {key: np.array(poses) for key, poses in self._alone.items() if poses and len(poses) == steps}

    def found(self) -> dict[str, Floats]:
        """The same, and of the best particle's lineage of each filter by its key; empty before the first step."""
        filters = self.last.filters if self.last else {}
        return self.alone() | {key: best_path(update) for key, update in filters.items()}
