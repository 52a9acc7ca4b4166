"""Whether filters know how wrong they are: NEES averaged over runs, beside the band of a consistent filter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args

import numpy as np
from rich.console import Console

from app import session, values
from app.files import check_directory
from app.options import FILTERS, default
from app.study.jobs import run_all
from app.study.output import MEANS, TITLES, JobsOption, OutOption, RunsOption, SeedOption, begin, empty_table, finish
from app.study.statistics import Mean, mean
from scenarios.registry import build, worlds
from slam.limits import PARAMS, Interval
from slam.metrics import nees_interval
from slam.types import Floats, WeightingName

DEGREES = {"position": 2, "x": 1, "y": 1, "heading": 1, "pose": 3}
"""Of freedom."""

SHOWN = ("position", "heading", "pose")
"""In the table; the picture has all but the pose."""


class Task(NamedTuple):
    """All filters on one seed."""

    study: ConsistencyStudy
    seed: int


class Outcome(NamedTuple):
    """One filter in one run, by step (T,)."""

    nees: dict[str, Floats]
    """By what it is of, as in `DEGREES`."""
    nis: tuple[float, float]
    """Mean squared innovation over its expectation, first and second components; NaN where nothing was matched."""
    diversity: float
    """Share of the founders that are left at the end."""


@dataclass(frozen=True)
class ConsistencyStudy:
    """Whether filters are consistent: NEES averaged over runs, by component; innovations beside their expectation."""

    runs: RunsOption = 20
    """Independent runs, with seeds from --seed on."""
    world: Annotated[str, values.choice("--world", tuple(worlds()))] = "paper-line"
    """The world."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = (
        "dfs",
        "fs2",
        "fs1",
        "ekf",
    )
    """Some of dfs, fs2, fs1, ekf."""
    particles: Annotated[int, values.whole("--particles", "K", PARAMS["particles"])] = 100
    """Number of particles."""
    weighting: Annotated[
        str | None, values.choice("--weighting", get_args(WeightingName)), default("the world's own")
    ] = None
    """Of Dual FastSLAM."""
    inflate_r: Annotated[
        float | None, values.real("--inflate-r", "X", PARAMS["inflate_r"]), default("the world's own")
    ] = None
    """Factor on R for known features."""
    steps: Annotated[int | None, values.whole("--steps", "N", Interval(1)), default("all")] = None
    """Stop after N observing steps."""
    seed: SeedOption = 0
    """The first seed."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Averages of every step, with their band."""
    picture: Annotated[Path | None, values.path("--picture", "DIR"), default("not drawn")] = None
    """The same as plots, consistency-WORLD.png and .svg: position, x, y and heading, a line for each filter."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        if self.picture is not None:
            check_directory("--picture", self.picture)
        tasks = [Task(self, seed) for seed in range(self.seed, self.seed + self.runs)]
        found, stopped = run_all(one_run, tasks, jobs, "consistency")
        heads = [f"NEES {name} ({DEGREES[name]})" for name in SHOWN]
        table = empty_table(
            f"{self.world}, {self.particles} particles, {len(found)} runs: median over steps of the mean over runs",
            "",
            *(text for head in heads for text in (head, "in band")),
            "NIS 1st (1)",
            "NIS 2nd (1)",
            "share of founders left",
        )
        results: dict[str, Any] = {}
        for key in self.filters if found else ():
            row, results[key] = _of_filter([run[key] for run in found])
            table.add_row(TITLES[key], *row)
        tables = [table] if found else []
        note = f"in band: share of the steps within the 95 % band of a mean of so many runs; of the last three {MEANS}"
        code = finish(
            self, "consistency", command, {"filters": results}, tables, (len(found), self.runs), stopped, note
        )
        if self.picture is not None and found:
            from app.study.consistency_plot import draw  # and Matplotlib

            averages = {key: {name: told[name]["mean_by_step"] for name in DEGREES} for key, told in results.items()}
            name = draw(averages, self.world, self.particles, len(found), self.picture)
            Console(highlight=False).print(f"plots: {self.picture / name}.{{png,svg}}", soft_wrap=True, markup=False)
        return code


def _of_filter(runs: Sequence[Outcome]) -> tuple[list[str], dict[str, Any]]:
    row, told = [], {}
    for name, freedom in DEGREES.items():
        averages = np.mean([run.nees[name] for run in runs], axis=0)
        low, high = nees_interval(freedom, len(runs))
        inside = float(((averages >= low) & (averages <= high)).mean())
        if name in SHOWN:
            row += [f"{np.median(averages):.3g}", f"{inside:.0%}"]
        told[name] = {"mean_by_step": averages, "band": (low, high), "share_in_band": inside}
    nis = [_mean_of_known([run.nis[i] for run in runs]) for i in range(2)]
    left = mean([run.diversity for run in runs])
    row += ["" if one is None else str(one) for one in nis]
    return [*row, str(left)], told | {
        "nis": [None if one is None else one._asdict() for one in nis],
        "diversity": left._asdict(),
    }


def _mean_of_known(found: Sequence[float]) -> Mean | None:
    """Over the runs in which anything was matched."""
    known = [value for value in found if not math.isnan(value)]
    return mean(known) if known else None


def one_run(task: Task) -> dict[str, Outcome]:
    """All filters on one seed."""
    from app.diagnosis.collecting import Collector
    from slam.estimators import ESTIMATORS

    study, source, collector = task.study, build(task.study.world), Collector()
    given = {"weighting": study.weighting, "inflate_r": study.inflate_r}
    changes = {name: value for name, value in given.items() if value is not None}
    params = source.params(particles=study.particles, **changes)
    filters = [ESTIMATORS[key] for key in study.filters]
    session.run(session.make_info(source, filters, params, None, task.seed, study.steps), [collector])
    outcomes = {}
    for case in collector.cases():
        record = case.record
        nees = {name: record[f"nees_{name}"] for name in DEGREES}
        nis = (_within_run(record["nis_first"]), _within_run(record["nis_second"]))
        outcomes[case.key] = Outcome(nees, nis, float(record["diversity"][-1]))
    return outcomes


def _within_run(ratios: Floats) -> float:
    """Mean over the steps (T,) in which anything was matched; NaN without one."""
    there = ratios[~np.isnan(ratios)]
    return float(there.mean()) if len(there) else math.nan
