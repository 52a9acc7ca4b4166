"""The evidence of a session that runs, step by step."""

from __future__ import annotations

import dataclasses
from bisect import bisect_right
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
        self._walls, self._log = isinstance(info.source.feature, Wall), info.source.kind == "log"
        self._rows = {}

    def step(self, step: SessionStep) -> None:
        """A step, or once more one that is there."""
        for key, update in step.filters.items():
            rows = self._rows.setdefault(key, [])
            if not rows or rows[-1].step < step.index:
                rows.append(Row(step.index, update.evidence, step.params))

    def end(self) -> None:
        """Nothing to do."""

    def part(self, until: int) -> Collector:
        """What it has up to a step, as another one, which may go on by itself."""
        part = Collector()
        part._walls, part._log = self._walls, self._log
        ends = {key: bisect_right(rows, until, key=lambda row: row.step) for key, rows in self._rows.items()}
        part._rows = {key: self._rows[key][:end] for key, end in ends.items()}
        return part

    def cases(self) -> list[Case]:
        """The filters that have made a step, in the usual order; parameters are those of their last."""
        return [self._case(key, rows) for key in ESTIMATORS if (rows := self._rows.get(key))]

    def _case(self, key: str, rows: list[Row]) -> Case:
        steps = np.array([row.step for row in rows])
        numbers = np.array([row.evidence.row for row in rows], float)
        record = record_of(steps, NAMES, numbers, [row.evidence.observations for row in rows])
        return Case(key, ESTIMATORS[key].title, self._walls, dataclasses.asdict(rows[-1].params), record, self._log)
