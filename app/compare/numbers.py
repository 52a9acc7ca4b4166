"""What the filters of several runs did, over the steps that these have in common, and how that differs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.compare.runs import Run, common_steps, same_bits
from app.errors import UsageError
from app.rows import NEES, ROWS, Row, known, nees_text, nees_title
from slam.estimators import ESTIMATORS
from slam.types import Floats, Ints

CLOCK = "seconds"
"""The series that is another one each time."""


class Column(NamedTuple):
    """One filter in one run."""

    run: Run
    particles: int
    """K, to begin with; 1 for EKF-SLAM."""
    series: dict[str, Floats]
    """(T,) each, over the common steps."""
    missing: frozenset[str]
    """Those of them that the recording does not have."""
    values: dict[str, float]
    """By `Row.key`, in SI units and radians; NaN where it is not known."""
    parts_at: int | None
    """The first step at which a number is not that of the first column, bit for bit; None if there is none."""


class Filter(NamedTuple):
    """One filter in all runs that have it."""

    key: str
    title: str
    steps: Ints
    """(T,) that all these have."""
    columns: list[Column]

    @property
    def known_steps(self) -> int:
        """At how many of them, at most, the NEES is known."""
        return max(len(known(column.series["nees"])) for column in self.columns)

    def column(self, run: Run) -> Column | None:
        """That of a run, if it has the filter."""
        return next((column for column in self.columns if column.run is run), None)

    def title_of(self, row: Row) -> str:
        """Of a row of its table."""
        return nees_title(self.known_steps) if row.key == NEES else row.title

    def text(self, row: Row, column: Column) -> str:
        """A number; empty if it is not known."""
        return nees_text(column.series["nees"]) if row.key == NEES else row.text(column.values[row.key])

    def difference(self, row: Row, column: Column) -> float:
        """From the first column, in SI units and radians; NaN where one of the two is not known or infinite, or has a
        NEES that is infinite at some steps, which are in no mean."""
        if row.key == NEES and any(np.isinf(one.series["nees"]).any() for one in (column, self.columns[0])):
            return math.nan
        mine, first = column.values[row.key], self.columns[0].values[row.key]
        return mine - first if math.isfinite(mine) and math.isfinite(first) else math.nan


class Comparison(NamedTuple):
    """Several runs."""

    runs: list[Run]
    steps: Ints
    """(T,) that all of them have."""
    filters: list[Filter]
    """All that any of them has, in the order in which people see them."""


def compare(runs: Sequence[Run]) -> Comparison:
    """Raises `UsageError` if they have no step in common."""
    steps = common_steps(runs)
    if not len(steps):
        spans = ", ".join(f"{run.name} has steps {run.steps[0]} to {run.steps[-1]}" for run in runs)
        raise UsageError(f"the recordings have no step in common, so nothing can be compared: {spans}")
    found = [_filter(key, runs) for key in ESTIMATORS if any(key in run.filters for run in runs)]
    return Comparison(list(runs), steps, [one for one in found if len(one.steps)])


def _filter(key: str, runs: Sequence[Run]) -> Filter:
    steps = common_steps(runs, key)
    columns: list[Column] = []
    for run in runs:
        if key in run.filters:
            series, missing = run.filters[key].at(steps), run.filters[key].missing
            values = {row.key: row.value(series) for row in ROWS}
            particles = 1 if key == "ekf" else int(run.told["params"]["particles"])
            column = Column(run, particles, series, missing, values, None)
            columns.append(column._replace(parts_at=_parts_at(steps, columns[0], column)) if columns else column)
    return Filter(key, ESTIMATORS[key].title, steps, columns)


def _parts_at(steps: Ints, a: Column, b: Column) -> int | None:
    same = np.ones(len(steps), np.bool_)
    for name in set(a.series) - {CLOCK, *a.missing, *b.missing}:
        same &= same_bits(a.series[name], b.series[name])
    return None if same.all() else int(steps[np.argmin(same)])
