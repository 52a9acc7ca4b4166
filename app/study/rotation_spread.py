"""What is reported at the end of a corridor that a robot enters with an uncertain heading, against many particles."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from rich.table import Table

from app import session, values
from app.options import FILTERS
from app.study.corridor_spread import DeviationWatch, Outcome, saved_spread, spreads_of
from app.study.jobs import run_all
from app.study.output import MEDIANS, TITLES, RunsOption, begin, empty_table, finish, unseen
from app.study.statistics import spread
from app.study.walls import WallStudy, settings, tuned
from scenarios.registry import build
from scenarios.types import Source
from slam.limits import PARAMS
from slam.types import Floats

WORLD = "rotation-then-corridor"
REFERENCE = "dfs"
"""The filter that many particles are given to."""


class Task(NamedTuple):
    """One filter, one number of particles, one seed."""

    study: RotationSpread
    filter: str
    particles: int
    seed: int


@dataclass(frozen=True)
class RotationSpread(WallStudy):
    """Deviations at the end of rotation-then-corridor, along and across the true corridor, against a reference.

    The reference is Dual FastSLAM with very many particles on the same seed, that is with the same odometry and the
    same scans: by which heading the corridor was entered decides how much of the deviation is along it.

    Example: dualslam study rotation-spread --runs 20 --particles 30 300 --reference 10000
    """

    runs: RunsOption = 20
    """Independent runs, with seeds from --seed on."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = ("dfs", "fs2")
    """Some of dfs, fs2, fs1, ekf."""
    particles: Annotated[tuple[int, ...], values.wholes("--particles", "K ...", PARAMS["particles"])] = (30, 300)
    """Numbers of particles."""
    reference: Annotated[int, values.whole("--reference", "K", PARAMS["particles"])] = 3000
    """Particles of the reference."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        tuned(_source(self.doors), self.tuning, 1, self.noise)  # complain now of what does not apply
        seeds = range(self.seed, self.seed + self.runs)
        asked = settings(self.filters, self.particles)
        each = [(REFERENCE, self.reference), *asked]
        tasks = [Task(self, *setting, seed) for seed in seeds for setting in each]
        found, stopped = run_all(one_run, tasks, jobs, "rotation-spread")
        whole = len(found) // len(each)  # seeds of which everything was run
        reference, *others = (found[at : whole * len(each) : len(each)] for at in range(len(each)))
        cells = dict(zip(asked, others, strict=True)) if whole else {}
        tables = [self._table(reference, cells)] if cells else []
        results = {
            "reference": {"particles": self.reference, **_saved(reference)},
            "cells": [_result(*cell, outcomes, reference) for cell, outcomes in cells.items()],
        }
        blind = unseen([outcome.observed for outcome in reference])  # alike for all filters
        return finish(
            self, "rotation-spread", command, results, tables, (whole, self.runs), stopped, MEDIANS, warnings=blind
        )

    def _table(self, reference: list[Outcome], cells: dict[tuple[str, int], list[Outcome]]) -> Table:
        names = ("ratio", "rms [m]", "rms error [m]", "rms/error")
        columns = [name for axis in ("along", "across") for name in (f"{axis} [m]", *names)]
        table = empty_table(f"end of {WORLD}, doors {self.doors}", "", "K", *columns)
        rows = [(f"{TITLES[REFERENCE]}, reference", self.reference, reference)]
        rows += [(TITLES[key], particles, outcomes) for (key, particles), outcomes in cells.items()]
        for name, particles, outcomes in rows:
            ratio, deviation = ratios(outcomes, reference), deviations(outcomes)
            row: list[str] = []
            for axis, of in enumerate(spreads_of(outcomes)):
                row += [spread(list(deviation[:, axis])), spread(list(ratio[:, axis]), ".2f")]
                row += [f"{of.reported_m:.3g}", f"{of.true_m:.3g}", of.ratio.rounded(2)]
            table.add_row(name, str(particles), *row)
        table.caption = (
            "ratio: to the reference's deviation on the same seed; rms: of the deviations that the runs report, to be "
            "compared with their rms error"
        )
        table.caption_justify = "left"
        return table


def one_run(task: Task) -> Outcome:
    """One filter with one number of particles on one seed, at its end."""
    from slam.estimators import ESTIMATORS

    study, source = task.study, _source(task.study.doors)
    noise, params = tuned(source, study.tuning, task.particles, study.noise)
    last = len(source.steps)
    watch = DeviationWatch([last])
    session.run(session.make_info(source, [ESTIMATORS[task.filter]], params, noise, task.seed), [watch])
    return watch.found[task.filter, last]


def deviations(outcomes: list[Outcome]) -> Floats:
    """(N, 2) [m] along and across."""
    return np.sqrt(np.array([outcome.variance_m2 for outcome in outcomes]))


def ratios(outcomes: list[Outcome], reference: list[Outcome]) -> Floats:
    """(N, 2) deviation of every run by that of the reference on its seed, along and across."""
    return deviations(outcomes) / deviations(reference)


def _result(key: str, particles: int, outcomes: list[Outcome], reference: list[Outcome]) -> dict[str, Any]:
    ratio = ratios(outcomes, reference)
    return {
        "filter": key,
        "particles": particles,
        "median_ratio": {"along": float(np.median(ratio[:, 0])), "across": float(np.median(ratio[:, 1]))},
        "ratios": ratio,
        **_saved(outcomes),
    }


def _saved(outcomes: list[Outcome]) -> dict[str, Any]:
    along, across = (saved_spread(of) for of in spreads_of(outcomes)) if outcomes else (None, None)
    return {"along": along, "across": across, "runs": [outcome._asdict() for outcome in outcomes]}


@functools.lru_cache(maxsize=1)  # every run of a process drives the same way
def _source(doors: str) -> Source:
    return build(WORLD, features="walls", doors=doors)
