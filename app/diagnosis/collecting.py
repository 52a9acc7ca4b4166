"""The evidence of a session that runs, step by step."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from app.diagnosis.evidence import NAMES, Evidence, record_of
from app.diagnosis.findings import Case
from app.types import SessionInfo, SessionStep
from slam.estimators import ESTIMATORS
from slam.features import Wall
from slam.types import Params


class Row(NamedTuple):
    """A step of one filter."""

    step: int
    evidence: Evidence
    params: Params
    """That it was made with."""


class Collector:
    """An `Observer` that keeps what a diagnosis is made of: some 0.5 kB for each step and filter."""

    def __init__(self) -> None:
        self._rows: dict[str, list[Row]] = {}
        self._walls = self._log = False

    def begin(self, info: SessionInfo) -> None:
        """A session begins."""
        self.start(info)

    def start(self, info: SessionInfo, before: Collector | None = None, until: int = 0) -> None:
        """The same, of a branch of what another one has collected, up to a step."""
        self._walls, self._log = isinstance(info.source.feature, Wall), info.source.kind == "log"
        rows = {} if before is None else before._rows
        self._rows = {key: [row for row in found if row.step <= until] for key, found in rows.items()}

    def step(self, step: SessionStep) -> None:
        """A step, or once more one that is there."""
        for key, update in step.filters.items():
            rows = self._rows.setdefault(key, [])
            if not rows or rows[-1].step < step.index:
                rows.append(Row(step.index, update.evidence, step.params))

    def end(self) -> None:
        """Nothing to do."""

    def cases(self, until: float = math.inf) -> list[Case]:
        """The filters that have made a step, in the usual order, up to a step; parameters are those of their last."""
        found = {key: [row for row in self._rows.get(key, ()) if row.step <= until] for key in ESTIMATORS}
        return [self._case(key, rows) for key, rows in found.items() if rows]

    def _case(self, key: str, rows: list[Row]) -> Case:
        steps = np.array([row.step for row in rows])
        numbers = np.array([row.evidence.row for row in rows], float)
        record = record_of(steps, NAMES, numbers, [row.evidence.observations for row in rows])
        return Case(key, ESTIMATORS[key].title, self._walls, dataclasses.asdict(rows[-1].params), record, self._log)
