"""How far filters stray on a log (or a world), over seeds: filters x particles x inflate_r."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple, get_args

import numpy as np
import tyro
from rich.table import Table
from tyro.conf import OmitArgPrefixes, Positional

from app import session, values
from app.errors import UsageError
from app.options import FILTERS, BelievedNoise, FilterOptions, LogOptions, WorldNoise, default, parameters
from app.sources import LogParts, load
from app.study.jobs import run_all
from app.study.output import MEDIANS, TITLES, JobsOption, OutOption, SeedOption, begin, empty_table, finish
from app.study.statistics import spread
from app.summary import Summary
from app.types import SessionInfo, SessionStep
from scenarios.types import Source
from slam.limits import PARAMS, Interval
from slam.metrics import rms
from slam.types import AssociationName, WeightingName


class Task(NamedTuple):
    """One filter, one setting, one seed."""

    study: LogError
    filter: str
    particles: int
    inflate_r: float
    seed: int


class Outcome(NamedTuple):
    """What it came to."""

    position_rmse_m: float
    position_end_m: float
    features: float
    duplicates: float
    path_m: float
    """Length of the estimated path."""
    update_ms: float
    odometry_rmse_m: float
    """Of dead reckoning, the same for every filter."""


@dataclass(frozen=True)
class LogError:
    """Position error on a log: the median over seeds, for filters x particles x inflate_r.

    Example: dualslam study log-error MRCLAM_Dataset6 --robot 3 --association known --inflate-r 1 4 16
    """

    source: Annotated[Positional[str], values.word("LOG|WORLD"), tyro.conf.arg(help_behavior_hint="")] = ""
    """A log, or a world (whose noise then differs from seed to seed)."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = ("fs2", "dfs")
    """Some of dfs, fs2, fs1, ekf."""
    particles: Annotated[tuple[int, ...], values.wholes("--particles", "K ...", PARAMS["particles"])] = (100,)
    """Numbers of particles."""
    inflate_r: Annotated[tuple[float, ...], values.reals("--inflate-r", "X ...", PARAMS["inflate_r"])] = (1.0,)
    """Factors on R for known landmarks."""
    association: Annotated[
        str | None, values.choice("--association", get_args(AssociationName)), default("the log's own")
    ] = None
    """Which landmark is it: told by its tag, the nearest, or jointly compatible."""
    weighting: Annotated[
        str | None, values.choice("--weighting", get_args(WeightingName)), default("the log's own")
    ] = None
    """Dual FastSLAM: how several observations weigh."""
    temper: Annotated[float | None, values.real("--temper", "X", PARAMS["temper"]), default("the log's own")] = None
    """Exponent on the likelihood of an observation."""
    log_p_new: Annotated[
        float | None, values.real("--log-p-new", "X", PARAMS["log_p_new"]), default("the log's own")
    ] = None
    """Added to the log weight for every observation taken for a new landmark."""
    steps: Annotated[int | None, values.whole("--steps", "N", Interval(1)), default("all")] = None
    """Stop after N observing steps."""
    align: bool = False
    """Move the whole path rigidly onto the truth before errors are taken."""
    seeds: Annotated[int, values.whole("--seeds", "N", Interval(1))] = 5
    """How many seeds."""
    seed: SeedOption = 0
    """The first seed."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Medians and every single run."""
    believed: BelievedNoise = field(default_factory=BelievedNoise)
    log: OmitArgPrefixes[LogOptions] = field(default_factory=LogOptions)

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        if not self.source:
            raise UsageError("study log-error needs a log or a world, such as: dualslam study log-error loop")
        source = _source(self)
        if not any(step.truth is not None for step in source.steps[: self.steps]):
            raise UsageError(f"{source.name} has no truth to compare with; expected a log with ground truth")
        tasks = [
            Task(self, key, particles, inflate_r, seed)
            for seed in range(self.seed, self.seed + self.seeds)
            for key in self.filters
            for particles in (self.particles if key != "ekf" else (1,))
            for inflate_r in self.inflate_r
        ]
        found, stopped = run_all(one_run, tasks, jobs, "log-error")
        cells: dict[tuple[str, int, float], list[Outcome]] = {}
        for task, outcome in zip(tasks, found, strict=False):
            cells.setdefault((task.filter, task.particles, task.inflate_r), []).append(outcome)
        fewest = min((len(outcomes) for outcomes in cells.values()), default=0)
        tables = [self._table(source, cells)] if cells else []
        results = {"cells": [_result(*cell, outcomes) for cell, outcomes in cells.items()]}
        return finish(self, "log-error", command, results, tables, (fewest, self.seeds), stopped, MEDIANS)

    def _table(self, source: Source, cells: dict[tuple[str, int, float], list[Outcome]]) -> Table:
        steps = min(len(source.steps), self.steps or len(source.steps))
        columns = ("K", "inflate R", "RMSE [m]", "at the end [m]", "path [m]", "features", "ms/step")
        table = empty_table(f"{source.title}, {steps} steps", "", *columns)
        for (key, particles, inflate_r), outcomes in cells.items():
            of = {name: [getattr(outcome, name) for outcome in outcomes] for name in Outcome._fields}
            table.add_row(
                TITLES[key],
                str(particles),
                f"{inflate_r:g}",
                spread(of["position_rmse_m"]),
                spread(of["position_end_m"]),
                f"{np.median(of['path_m']):.0f}",
                spread(of["features"], ".0f"),
                f"{np.median(of['update_ms']):.2g}",
            )
        odometry = [outcome.odometry_rmse_m for outcomes in cells.values() for outcome in outcomes]
        table.add_row("dead reckoning", "", "", f"{np.median(odometry):.3g}", "", "", "", "")
        return table


def one_run(task: Task) -> Outcome:
    """One filter with one setting on one seed."""
    from slam.estimators import ESTIMATORS

    study, source = task.study, _source(task.study)
    given = FilterOptions(
        particles=task.particles,
        inflate_r=task.inflate_r,
        association=study.association,
        weighting=study.weighting,
        temper=study.temper,
        log_p_new=study.log_p_new,
    )
    noise, params = parameters(source, given, WorldNoise(), study.believed)
    summary, odometry = Summary(align=study.align), _Odometry()
    session.run(
        session.make_info(source, [ESTIMATORS[task.filter]], params, noise, task.seed, study.steps),
        [summary, odometry],
    )
    series = summary.filters[task.filter]
    errors = summary.errors(series)["position_error_m"]
    known = errors[~np.isnan(errors)]
    return Outcome(
        position_rmse_m=rms(errors),
        position_end_m=float(known[-1]),
        features=float(series.array("features")[-1]),
        duplicates=float(series.array("duplicates_so_far")[-1]),
        path_m=float(np.linalg.norm(np.diff(np.array(series.estimate)[:, :2], axis=0), axis=1).sum()),
        update_ms=1e3 * float(np.median(series.seconds)),
        odometry_rmse_m=rms(np.array(odometry.errors)),
    )


class _Odometry:
    """An observer that takes the error of dead reckoning."""

    def __init__(self) -> None:
        self.errors: list[float] = []

    def begin(self, info: SessionInfo) -> None:
        pass

    def step(self, step: SessionStep) -> None:
        if step.truth is not None:
            self.errors.append(math.dist(step.odometry[:2], step.truth[:2]))

    def end(self) -> None:
        pass


def _source(study: LogError) -> Source:
    return _load(study.source, LogParts(*vars(study.log).values()))


@functools.lru_cache(maxsize=1)  # every run of a process reads the same log
def _load(name: str, parts: LogParts) -> Source:
    return load(name, {}, parts)


def _result(key: str, particles: int, inflate_r: float, outcomes: list[Outcome]) -> dict[str, Any]:
    return {
        "filter": key,
        "particles": particles,
        "inflate_r": inflate_r,
        "median": {name: float(np.median([getattr(o, name) for o in outcomes])) for name in Outcome._fields},
        "runs": [outcome._asdict() for outcome in outcomes],
    }
