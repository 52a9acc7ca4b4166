"""Whether filters know how wrong they are: NEES averaged over runs, beside the band of a consistent filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_args

import numpy as np
from scipy.stats import chi2

from app import session, values
from app.options import FILTERS, default
from app.study.jobs import run_all
from app.study.output import MEANS, TITLES, JobsOption, OutOption, RunsOption, SeedOption, begin, empty_table, finish
from app.study.statistics import mean
from scenarios.registry import build, worlds
from slam.limits import PARAMS, Interval
from slam.types import Floats, WeightingName

DEGREES = {"position": 2, "heading": 1, "pose": 3}
"""Of freedom."""


class Task(NamedTuple):
    """All filters on one seed."""

    study: ConsistencyStudy
    seed: int


class Outcome(NamedTuple):
    """One filter in one run, by step (T,)."""

    position: Floats
    """NEES of x and y."""
    heading: Floats
    """That of the heading."""
    pose: Floats
    """That of all three."""
    nis: tuple[float, float]
    """Mean squared innovation over its expectation, first and second components."""
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

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        tasks = [Task(self, seed) for seed in range(self.seed, self.seed + self.runs)]
        found, stopped = run_all(one_run, tasks, jobs, "consistency")
        heads = [f"NEES {name} ({freedom})" for name, freedom in DEGREES.items()]
        table = empty_table(
            f"{self.world}, {self.particles} particles, {len(found)} runs: median over steps of the mean over runs",
            "",
            *(text for head in heads for text in (head, "in band")),
            "NIS 1st (1)",
            "NIS 2nd (1)",
            "founders left",
        )
        results: dict[str, Any] = {}
        for key in self.filters if found else ():
            row, results[key] = _of_filter([run[key] for run in found])
            table.add_row(TITLES[key], *row)
        tables = [table] if found else []
        note = f"in band: share of the steps within the 95 % band of a mean of so many runs; of the last three {MEANS}"
        return finish(
            self, "consistency", command, {"filters": results}, tables, (len(found), self.runs), stopped, note
        )


def band(runs: int, freedom: int, confidence: float = 0.95) -> tuple[float, float]:
    """That of the mean of so many independent NEES."""
    low, high = chi2.ppf([0.5 - confidence / 2.0, 0.5 + confidence / 2.0], runs * freedom) / runs
    return float(low), float(high)


def _of_filter(runs: list[Outcome]) -> tuple[list[str], dict[str, Any]]:
    row, told = [], {}
    for name, freedom in DEGREES.items():
        averages = np.mean([getattr(run, name) for run in runs], axis=0)
        low, high = band(len(runs), freedom)
        inside = float(((averages >= low) & (averages <= high)).mean())
        row += [f"{np.median(averages):.3g}", f"{inside:.0%}"]
        told[name] = {"mean_by_step": averages, "band": (low, high), "share_in_band": inside}
    nis = [mean([run.nis[i] for run in runs]) for i in range(2)]
    left = mean([run.diversity for run in runs])
    return [*row, *map(str, nis), str(left)], told | {
        "nis": [one._asdict() for one in nis],
        "diversity": left._asdict(),
    }


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
        with np.errstate(divide="ignore", over="ignore"):  # particles that agree on one heading
            heading = (record["heading_error_rad"] / record["spread_rad"]) ** 2
        outcomes[case.key] = Outcome(
            record["nees_position"],
            heading,
            record["nees_pose"],
            (float(np.nanmean(record["nis_first"])), float(np.nanmean(record["nis_second"]))),
            float(record["diversity"][-1]),
        )
    return outcomes
