"""How many particles close a corridor loop seen by a laser: filters x particles, over seeds."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from rich.table import Table

from app import session, values
from app.loops import right_matches
from app.options import FILTERS
from app.study.jobs import run_all
from app.study.output import MEDIANS, TITLES, RunsOption, begin, empty_table, finish, unseen
from app.study.statistics import spread
from app.study.walls import WallStudy, settings, tuned
from app.types import FilterUpdate, SessionInfo, SessionStep
from scenarios.registry import build
from scenarios.types import Source
from slam.geometry import compose, invert, wrap
from slam.limits import PARAMS
from slam.types import Ints

LAPS = 1.1
"""Enough to come to the first corner again."""

SHARE, NEAR = 0.8, 0.5
"""Closed: at least this share of matches with walls of the first pass, and [m] no farther than that from the truth."""

NOTE = (
    "old walls: of the matches in the second pass over the start, those with a wall that the particle had after half a "
    f"lap, and that is the one which was seen\n{MEDIANS}"
)

STRAIGHT = 0.01
"""[m, rad] A robot that is farther from the line on which it started, or turned farther from it, is in a corner."""


class Task(NamedTuple):
    """One filter, one number of particles, one seed."""

    study: LoopClosure
    filter: str
    particles: int
    seed: int


class Outcome(NamedTuple):
    """What it came to.  The pass is the second one over the start."""

    closed: bool
    share: float
    """Of the walls that the best particle matched in the pass, those of the first pass that it matched rightly."""
    matches: int
    """How many it matched there."""
    observed: int
    """Walls seen in all steps."""
    position_median_m: float
    """Of the pass."""
    position_worst_m: float
    """Of the second half of the pass."""
    heading_error_rad: float
    """At the end of the pass, as all below."""
    odometry_error_m: float
    odometry_heading_error_rad: float
    features: float
    duplicates: float
    resamplings: int
    """Since the start."""
    update_ms: float
    """Median step."""


@dataclass(frozen=True)
class LoopClosure(WallStudy):
    """Who closes the loop of walls, with how many particles.

    The second pass over the start is the way from the start to the first corner, once round.  A wall is one of the
    first pass if the particle had it after half a lap.  Closed: in the second pass at least 80 % of the walls that the
    best particle matches are walls of the first pass, and those that were seen; and in its second half the position is
    within 0.5 m of the truth at every step.

    Example: dualslam study loop-closure --filters dfs fs2 fs1 --particles 10 30 100 300
    """

    runs: RunsOption = 25
    """Independent runs, with seeds from --seed on."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = ("dfs",)
    """Some of dfs, fs2, fs1, ekf."""
    particles: Annotated[tuple[int, ...], values.wholes("--particles", "K ...", PARAMS["particles"])] = (30,)
    """Numbers of particles."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        tuned(_source(self.doors), self.tuning, 1, self.noise)  # complain now of what does not apply
        tasks = [
            Task(self, key, particles, seed)
            for seed in range(self.seed, self.seed + self.runs)
            for key, particles in settings(self.filters, self.particles)
        ]
        found, stopped = run_all(one_run, tasks, jobs, "loop-closure")
        cells: dict[tuple[str, int], list[Outcome]] = {}
        for task, outcome in zip(tasks, found, strict=False):
            cells.setdefault((task.filter, task.particles), []).append(outcome)
        fewest = min((len(outcomes) for outcomes in cells.values()), default=0)
        tables = [self._table(cells)] if cells else []
        results = {
            "cells": [_result(*cell, outcomes) for cell, outcomes in cells.items()],
            "fewest": {key: fewest_closing(key, cells) for key in dict.fromkeys(key for key, _ in cells)},
        }
        blind = unseen([outcome.observed for outcome in next(iter(cells.values()), [])])  # alike for all filters
        return finish(
            self, "loop-closure", command, results, tables, (fewest, self.runs), stopped, NOTE, warnings=blind
        )

    def _table(self, cells: dict[tuple[str, int], list[Outcome]]) -> Table:
        columns = ("K", "closed", "old walls [%]", "error [m]", "worst [m]", "heading [°]", "features", "duplicates")
        table = empty_table(f"loop, doors {self.doors}", "", *columns, "resamplings", "ms/step")
        for (key, particles), outcomes in cells.items():
            of = {name: [getattr(outcome, name) for outcome in outcomes] for name in Outcome._fields}
            table.add_row(
                TITLES[key],
                str(particles),
                f"{sum(of['closed'])} of {len(outcomes)}",
                spread([100 * share for share in of["share"]], ".0f"),
                spread(of["position_median_m"], ".2f"),
                spread(of["position_worst_m"], ".2f"),
                spread([math.degrees(error) for error in of["heading_error_rad"]], ".2f"),
                spread(of["features"], ".0f"),
                spread(of["duplicates"], ".0f"),
                spread(of["resamplings"], ".0f"),
                f"{np.median(of['update_ms']):.2g}",
            )
        runs = next(iter(cells.values()))  # odometry is the same for all
        odometry = [outcome.odometry_error_m for outcome in runs]
        turned = [math.degrees(outcome.odometry_heading_error_rad) for outcome in runs]
        table.add_row("dead reckoning", "", "", "", spread(odometry, ".2f"), "", spread(turned, ".2f"))
        table.caption = "\n".join(_sentence(key, cells) for key in dict.fromkeys(key for key, _ in cells))
        table.caption_justify = "left"
        return table


def one_run(task: Task) -> Outcome:
    """One filter with one number of particles on one seed, up to the end of the second pass."""
    from slam.estimators import ESTIMATORS

    study, source = task.study, _source(task.study.doors)
    half, second = second_pass(source)
    noise, params = tuned(source, study.tuning, task.particles, study.noise)
    watch = _Watch(task.filter, half, set(second))
    session.run(
        session.make_info(source, [ESTIMATORS[task.filter]], params, noise, task.seed, int(second[-1]) + 1), [watch]
    )
    return watch.outcome()


def second_pass(source: Source) -> tuple[int, Ints]:
    """Index of the last step of the first half lap, and (n,) those of the second pass: from the start to a corner."""
    truth = np.array([step.truth for step in source.steps])
    before = np.vstack([source.start, truth[:-1]])
    driven = np.cumsum(np.hypot(*(truth - before)[:, :2].T))
    lap = 2.0 * (source.options["length"] + source.options["depth"])
    half = int(np.flatnonzero(driven <= 0.5 * lap)[-1])
    x, y, turn = compose(np.broadcast_to(invert(source.start), truth.shape), truth).T
    straight = (np.abs(y) < STRAIGHT) & (np.abs(turn) < STRAIGHT)
    return half, np.flatnonzero(straight & (x >= 0.0) & (np.arange(len(truth)) > half))


class _Watch:
    """An observer that takes what an `Outcome` needs."""

    def __init__(self, key: str, half: int, second: set[int]) -> None:
        self.key, self.half, self.second = key, half, second
        self.first: Ints = np.empty(0, np.int64)
        """(K,) how many features, those of lower index, the ancestor of each particle had after half a lap."""
        self.old = self.matches = self.observed = self.resamplings = 0
        self.errors: list[float] = []
        self.seconds: list[float] = []

    def begin(self, info: SessionInfo) -> None:
        pass

    def step(self, step: SessionStep) -> None:
        update = step.filters[self.key]
        trace, index = update.trace, step.index - 1
        self.seconds.append(update.seconds)
        self.observed += len(step.frame.z)
        self.resamplings += trace.did_resample
        if index == self.half:
            self.first = trace.resampled.maps.counts.copy()
        elif index > self.half:
            self.first = self.first[trace.resized]
            if index in self.second:
                self._second(step, update)
            self.first = self.first[trace.selected]

    def _second(self, step: SessionStep, update: FilterUpdate) -> None:
        best = update.measures.best
        n = update.trace.n[best]
        self.matches += int((n >= 0).sum())
        right = right_matches(update.trace, step.frame.tags, best)
        self.old += int((right & (n[n >= 0] < self.first[best])).sum())
        self.errors.append(update.measures.position_error_m)
        self.last = step

    def end(self) -> None:
        pass

    def outcome(self) -> Outcome:
        """After the second pass."""
        step, measures = self.last, self.last.filters[self.key].measures
        assert step.truth is not None
        share = self.old / max(self.matches, 1)
        worst = max(self.errors[len(self.errors) // 2 :])
        return Outcome(
            closed=share >= SHARE and worst < NEAR,
            share=share,
            matches=self.matches,
            observed=self.observed,
            position_median_m=float(np.median(self.errors)),
            position_worst_m=worst,
            heading_error_rad=measures.heading_error_rad,
            odometry_error_m=math.dist(step.odometry[:2], step.truth[:2]),
            odometry_heading_error_rad=abs(wrap(float(step.odometry[2] - step.truth[2]))),
            features=measures.features,
            duplicates=measures.duplicates,
            resamplings=self.resamplings,
            update_ms=1e3 * float(np.median(self.seconds)),
        )


@functools.lru_cache(maxsize=1)  # every run of a process drives the same way
def _source(doors: str) -> Source:
    return build("loop", features="walls", doors=doors, laps=LAPS)


def fewest_closing(key: str, cells: dict[tuple[str, int], list[Outcome]]) -> int | None:
    """The smallest number of particles with which this filter closed every run; None if there is none."""
    closing = [K for (k, K), outcomes in cells.items() if k == key and all(outcome.closed for outcome in outcomes)]
    return min(closing, default=None)


def _sentence(key: str, cells: dict[tuple[str, int], list[Outcome]]) -> str:
    fewest = fewest_closing(key, cells)
    if fewest is None:
        return f"{TITLES[key]} does not close all"
    return f"{TITLES[key]} closes all with {fewest} particle{'s' if fewest > 1 else ''}"


def _result(key: str, particles: int, outcomes: list[Outcome]) -> dict[str, Any]:
    return {
        "filter": key,
        "particles": particles,
        "closed": sum(outcome.closed for outcome in outcomes),
        "median": {name: float(np.median([getattr(o, name) for o in outcomes])) for name in Outcome._fields[1:]},
        "runs": [outcome._asdict() for outcome in outcomes],
    }
