"""What is reported at the end of a corridor that a robot enters with an uncertain heading, against many particles."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple, get_args

import numpy as np
from rich.table import Table
from tyro.conf import OmitArgPrefixes

from app import session, values
from app.options import FILTERS, WorldNoise
from app.study.corridor_spread import DeviationWatch, Outcome
from app.study.jobs import run_all
from app.study.output import MEDIANS, TITLES, JobsOption, OutOption, RunsOption, SeedOption, begin, empty_table, finish
from app.study.statistics import spread
from app.study.tuning import Tuning, tuned
from scenarios.floorplan import DoorKind
from scenarios.registry import build
from scenarios.types import Source
from slam.limits import PARAMS, Interval
from slam.metrics import rms
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
class RotationSpread:
    """Deviations at the end of rotation-then-corridor, along and across the true corridor, against a reference.

    The reference is Dual FastSLAM with very many particles, on the first few of the seeds: the root of the mean of its
    variances.  Every run of the others is divided by that.  Example: dualslam study rotation-spread --runs 20
    """

    runs: RunsOption = 20
    """Independent runs, with seeds from --seed on."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = ("dfs", "fs2")
    """Some of dfs, fs2, fs1, ekf."""
    particles: Annotated[tuple[int, ...], values.wholes("--particles", "K ...", PARAMS["particles"])] = (30, 300)
    """Numbers of particles."""
    reference: Annotated[int, values.whole("--reference", "K", PARAMS["particles"])] = 10000
    """Particles of the reference."""
    reference_runs: Annotated[int, values.whole("--reference-runs", "N", Interval(1))] = 3
    """Runs of the reference."""
    doors: Annotated[str, values.choice("--doors", get_args(DoorKind))] = "closed"
    """The doors of the corridor."""
    seed: SeedOption = 0
    """The first seed."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Deviations, ratios and every single run."""
    tuning: OmitArgPrefixes[Tuning] = field(default_factory=Tuning)
    noise: WorldNoise = field(default_factory=WorldNoise)

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        tuned(_source(self.doors), self.tuning, 1, self.noise)  # complain now of what does not apply
        seeds = range(self.seed, self.seed + self.runs)
        # The longest first: without the reference there is nothing to show.
        tasks = [Task(self, REFERENCE, self.reference, self.seed + at) for at in range(self.reference_runs)] + [
            Task(self, key, particles, seed)
            for seed in seeds
            for key in self.filters
            for particles in (dict.fromkeys(self.particles) if key != "ekf" else (1,))
        ]
        found, stopped = run_all(one_run, tasks, jobs, "rotation-spread")
        reference, cells = found[: self.reference_runs], {}
        for task, outcome in list(zip(tasks, found, strict=False))[self.reference_runs :]:
            cells.setdefault((task.filter, task.particles), []).append(outcome)
        fewest = min((len(outcomes) for outcomes in cells.values()), default=0)
        tables = [self._table(reference, cells)] if cells else []
        results = {
            "reference": {"deviation_m": reported(reference), "runs": [outcome._asdict() for outcome in reference]},
            "cells": [_result(*cell, outcomes, reference) for cell, outcomes in cells.items()],
        }
        return finish(self, "rotation-spread", command, results, tables, (fewest, self.runs), stopped, MEDIANS)

    def _table(self, reference: list[Outcome], cells: dict[tuple[str, int], list[Outcome]]) -> Table:
        columns = [name for axis in ("along", "across") for name in (f"{axis} [m]", "ratio", "rms error [m]")]
        table = empty_table(f"end of {WORLD}, doors {self.doors}", "", "K", "runs", *columns)
        many = len(reference)
        for (key, particles), outcomes in {(REFERENCE, self.reference): reference, **cells}.items():
            name = TITLES[key] if outcomes is not reference else f"{TITLES[key]}, reference"
            ratio, deviation = ratios(outcomes, reference), deviations(outcomes)
            row: list[str] = []
            for axis in (0, 1):
                true = rms(np.array([outcome.error_m[axis] for outcome in outcomes]))
                row += [spread(list(deviation[:, axis])), spread(list(ratio[:, axis]), ".2f"), f"{true:.3g}"]
            table.add_row(name, str(particles), str(len(outcomes)), *row)
        table.caption = (
            f"ratio: to the reference, the root of the mean of the variances of its {many} run{'s' if many > 1 else ''}"
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


def reported(outcomes: list[Outcome]) -> Floats:
    """(2,) [m] Root of the mean of the variances, along and across."""
    return np.sqrt(np.mean([outcome.variance_m2 for outcome in outcomes], axis=0))


def ratios(outcomes: list[Outcome], reference: list[Outcome]) -> Floats:
    """(N, 2) deviation of every run by that of the reference, along and across."""
    return deviations(outcomes) / reported(reference)


def _result(key: str, particles: int, outcomes: list[Outcome], reference: list[Outcome]) -> dict[str, Any]:
    ratio = ratios(outcomes, reference)
    return {
        "filter": key,
        "particles": particles,
        "median_ratio": {"along": float(np.median(ratio[:, 0])), "across": float(np.median(ratio[:, 1]))},
        "ratios": ratio,
        "runs": [outcome._asdict() for outcome in outcomes],
    }


@functools.lru_cache(maxsize=1)  # every run of a process drives the same way
def _source(doors: str) -> Source:
    return build(WORLD, features="walls", doors=doors)
