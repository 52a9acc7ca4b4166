"""Whether the deviation that a filter reports in a corridor is that of its errors, along it and across, over seeds."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
from rich.table import Table

from app import session, values
from app.errors import UsageError
from app.options import FILTERS
from app.study.jobs import run_all
from app.study.output import TITLES, RunsOption, begin, empty_table, finish, unseen
from app.study.statistics import Mean
from app.study.walls import WallStudy, tuned
from app.types import SessionInfo, SessionStep
from scenarios.registry import build
from scenarios.types import Source
from slam.limits import PARAMS, Interval
from slam.metrics import pose_error, rms
from slam.types import Floats

DISTANCES = (5.0, 10.0, 20.0, 40.0, 80.0)

NOTE = "± is the standard error"

EndName = Literal["wall", "open"]


class Task(NamedTuple):
    """All filters on one seed."""

    study: CorridorSpread
    seed: int


class Outcome(NamedTuple):
    """One filter after one of the distances, along and across the corridor."""

    error_m: tuple[float, float]
    """Estimate minus truth."""
    variance_m2: tuple[float, float]
    """Of the mixture, within and between particles."""
    observed: int
    """Walls seen so far, in all steps."""


class Spread(NamedTuple):
    """One direction after one of the distances."""

    reported_m: float
    """Root of the mean of the variances that the runs report."""
    true_m: float
    """Root of the mean of their squared errors."""
    ratio: Mean
    """Reported by true."""


@dataclass(frozen=True)
class CorridorSpread(WallStudy):
    """What a filter says of its error in a corridor, beside what it is, over seeds.

    Nothing tells how far along the corridor the robot is before the far wall is in view, 8 m from it: no distance may
    be beyond that.  Example: dualslam study corridor-spread --filters dfs fs2 --runs 200 --particles 1
    """

    runs: RunsOption = 200
    """Independent runs, with seeds from --seed on."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = ("dfs", "fs2")
    """Some of dfs, fs2, fs1, ekf."""
    particles: Annotated[int, values.whole("--particles", "K", PARAMS["particles"])] = 1
    """Number of particles."""
    distances: Annotated[tuple[float, ...], values.reals("--distances", "M ...", Interval(0, open_low=True))] = (
        DISTANCES
    )
    """[m] driven; deviations are taken at the first step that has come so far."""
    far_end: Annotated[str, values.choice("--far-end", get_args(EndName))] = "wall"
    """What it ends in; an open one is never seen."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        source = _source(self)
        tuned(source, self.tuning, 1, self.noise)  # complain now of what does not apply
        _check_distances(self, source)
        tasks = [Task(self, seed) for seed in range(self.seed, self.seed + self.runs)]
        found, stopped = run_all(one_run, tasks, jobs, "corridor-spread")
        tables, results = [], {}
        for key in self.filters if found else ():
            spreads = [spreads_of([run[key][at] for run in found]) for at in range(len(self.distances))]
            tables.append(self._table(key, spreads, len(found)))
            results[key] = [
                {"distance_m": distance, "along": saved_spread(along), "across": saved_spread(across)}
                | {"runs": [run[key][at]._asdict() for run in found]}
                for at, (distance, (along, across)) in enumerate(zip(self.distances, spreads, strict=True))
            ]
        blind = unseen([run[self.filters[0]][-1].observed for run in found])
        runs = (len(found), self.runs)
        return finish(
            self, "corridor-spread", command, {"filters": results}, tables, runs, stopped, NOTE, warnings=blind
        )

    def _table(self, key: str, spreads: list[tuple[Spread, Spread]], runs: int) -> Table:
        particles = 1 if key == "ekf" else self.particles
        title = f"{TITLES[key]}, {particles} particle{'s' if particles > 1 else ''}, doors {self.doors}, {runs} runs"
        columns = [name for axis in ("along", "across") for name in (f"{axis} [m]", "rms error [m]", "ratio")]
        table = empty_table(title, "driven", *columns)
        for distance, directions in zip(self.distances, spreads, strict=True):
            cells = [(f"{of.reported_m:.3g}", f"{of.true_m:.3g}", of.ratio.rounded(2)) for of in directions]
            table.add_row(f"{distance:g} m", *cells[0], *cells[1])
        return table


def one_run(task: Task) -> dict[str, list[Outcome]]:
    """All filters on one seed: what each reports after each of the distances."""
    from slam.estimators import ESTIMATORS

    study, source = task.study, _source(task.study)
    noise, params = tuned(source, study.tuning, study.particles, study.noise)
    at = steps_at(source, study.distances)
    watch = DeviationWatch(at)
    filters = [ESTIMATORS[key] for key in study.filters]
    session.run(session.make_info(source, filters, params, noise, task.seed, max(at)), [watch])
    return {key: [watch.found[key, step] for step in at] for key in study.filters}


class DeviationWatch:
    """An observer that takes errors and variances after some steps, in a corridor along the x axis."""

    def __init__(self, at: list[int]) -> None:
        self.at = set(at)
        self.observed = 0
        self.found: dict[tuple[str, int], Outcome] = {}
        """By filter and number of steps."""

    def begin(self, info: SessionInfo) -> None:
        """Nothing to do."""

    def step(self, step: SessionStep) -> None:
        """Take what is asked for of this step."""
        self.observed += len(step.frame.z)
        if step.index not in self.at or step.truth is None:
            return
        for key, update in step.filters.items():
            error = pose_error(update.measures.estimate, step.truth)
            variance = np.diag(update.measures.covariance)
            self.found[key, step.index] = Outcome(
                (float(error[0]), float(error[1])), (float(variance[0]), float(variance[1])), self.observed
            )

    def end(self) -> None:
        """Nothing to do."""


def spreads_of(outcomes: list[Outcome]) -> tuple[Spread, Spread]:
    """Along and across, over runs."""
    errors = np.array([outcome.error_m for outcome in outcomes])  # (N, 2)
    variances = np.array([outcome.variance_m2 for outcome in outcomes])
    return _spread(errors[:, 0], variances[:, 0]), _spread(errors[:, 1], variances[:, 1])


def _spread(errors: Floats, variances: Floats) -> Spread:
    """The standard error of the ratio is that of a deviation from N normal errors, 1 / sqrt(2 N) of it."""
    reported, true = math.sqrt(float(np.mean(variances))), rms(errors)
    ratio = reported / true if true > 0 else math.nan
    return Spread(reported, true, Mean(ratio, ratio / math.sqrt(2 * len(errors)) if len(errors) > 1 else math.nan))


def steps_at(source: Source, distances: tuple[float, ...]) -> list[int]:
    """How many steps it takes to come so far from the start."""
    away = np.array([math.dist(step.truth[:2], source.start[:2]) for step in source.steps if step.truth is not None])
    return [int(np.argmax(away >= distance - 1e-9)) + 1 for distance in distances]


def _check_distances(study: CorridorSpread, source: Source) -> None:
    """Raise `UsageError` for a distance at which the far wall is in view, or that the robot never drives."""
    most = math.dist(source.steps[-1].truth[:2], source.start[:2])  # type: ignore[index]
    if study.far_end == "wall":
        most = min(most, source.options["length"] - source.max_range - source.start[0])
    wrong = next((distance for distance in study.distances if distance > most), None)
    if wrong is not None:
        why = "the far wall is in view" if study.far_end == "wall" else "the robot stops"
        raise UsageError(f"--distances is {wrong:g}; expected at most {most:g} m, where {why}")


def saved_spread(spread: Spread) -> dict[str, Any]:
    """What is written of it."""
    return {**spread._asdict(), "ratio": spread.ratio._asdict()}


def _source(study: CorridorSpread) -> Source:
    return _build(study.doors, study.far_end)


@functools.lru_cache(maxsize=1)  # every run of a process drives the same way
def _build(doors: str, far_end: str) -> Source:
    return build("corridor", features="walls", doors=doors, far_end=far_end)
