"""The evidence of a session that runs, step by step."""

from __future__ import annotations

import dataclasses

import numpy as np

from app.diagnosis.evidence import NAMES, Evidence, record_of
from app.diagnosis.findings import Case
from app.types import SessionInfo, SessionStep
from slam.estimators import ESTIMATORS
from slam.features import Wall
from slam.types import Params


class Collector:
    """An `Observer` that keeps what a diagnosis is made of: some 0.5 kB for each step and filter."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[int, Evidence]]] = {}
        self._params = Params()
        self._walls = False

    def begin(self, info: SessionInfo) -> None:
        """A session begins."""
        self.start(info.params, isinstance(info.source.feature, Wall))

    def start(self, params: Params, walls: bool, before: Collector | None = None, until: int = 0) -> None:
        """The same, of a branch of what another one has collected, up to a step."""
        self._params, self._walls = params, walls
        rows = {} if before is None else before._rows
        self._rows = {key: [row for row in found if row[0] <= until] for key, found in rows.items()}

    def step(self, step: SessionStep) -> None:
        """A step, or once more one that is there."""
        self._params = step.params
        for key, update in step.filters.items():
            rows = self._rows.setdefault(key, [])
            if not rows or rows[-1][0] < step.index:
                rows.append((step.index, update.evidence))

    def end(self) -> None:
        """Nothing to do."""

    def cases(self, until: int | None = None) -> list[Case]:
        """The filters that have made a step, in the usual order, up to a step."""
        return [self._case(key, until) for key in ESTIMATORS if self._rows.get(key)]

    def _case(self, key: str, until: int | None) -> Case:
        rows = [row for row in self._rows[key] if until is None or row[0] <= until] or self._rows[key][:1]
        steps = np.array([index for index, _ in rows])
        numbers = np.array([evidence.row for _, evidence in rows], float)
        seen = [evidence.observations for _, evidence in rows]
        record = record_of(steps, NAMES, numbers, seen)
        return Case(key, ESTIMATORS[key].title, self._walls, dataclasses.asdict(self._params), record)
