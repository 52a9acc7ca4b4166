"""How often unknown association is right, and how many landmarks end up twice in the map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_args

from app import session, values
from app.options import FILTERS, default
from app.study.jobs import run_all
from app.study.output import MEANS, TITLES, JobsOption, OutOption, RunsOption, SeedOption, begin, empty_table, finish
from app.study.statistics import mean
from app.summary import Summary
from scenarios.registry import build, landmark_options, worlds
from slam.limits import PARAMS, Interval
from slam.types import AssociationName

LANDMARK_WORLDS = tuple(name for name, entry in worlds().items() if "landmarks" in entry.features)


class Task(NamedTuple):
    """All filters on one seed."""

    study: AssociationStudy
    seed: int


class Outcome(NamedTuple):
    """What one filter came to in one run."""

    correct: float
    """Share of the observations that the best particle paired rightly."""
    wrong: float
    missed: float
    duplicates: float
    """Share of the features in the best particle's map at the end that are there already."""
    features: float
    position_end_m: float


@dataclass(frozen=True)
class AssociationStudy:
    """Unknown association in a world: how many pairings are right, how many landmarks are mapped twice."""

    runs: RunsOption = 10
    """Independent runs, with seeds from --seed on."""
    world: Annotated[str, values.choice("--world", LANDMARK_WORLDS)] = "loop"
    """The world, with landmarks."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = ("fs2", "dfs")
    """Some of dfs, fs2, fs1, ekf."""
    particles: Annotated[int, values.whole("--particles", "K", PARAMS["particles"])] = 100
    """Number of particles."""
    association: Annotated[str, values.choice("--association", get_args(AssociationName))] = "jcbb"
    """How observations are paired with landmarks."""
    inflate_r: Annotated[
        float | None, values.real("--inflate-r", "X", PARAMS["inflate_r"]), default("the world's own")
    ] = None
    """Factor on R for known landmarks."""
    gate_new: Annotated[
        float | None, values.real("--gate-new", "P", PARAMS["gate_new"]), default("the world's own")
    ] = None
    """Within this gate of a landmark an unmatched observation is ignored; 0 takes all of them for new."""
    steps: Annotated[int | None, values.whole("--steps", "N", Interval(1)), default("all")] = None
    """Stop after N observing steps."""
    seed: SeedOption = 0
    """The first seed."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Means, errors and every single run."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        tasks = [Task(self, seed) for seed in range(self.seed, self.seed + self.runs)]
        found, stopped = run_all(one_run, tasks, jobs, "association")
        table = empty_table(
            f"{self.world}, {self.association}, {self.particles} particles, {len(found)} runs",
            "",
            "correct [%]",
            "worst",
            "wrong [%]",
            "missed [%]",
            "duplicates [%]",
            "worst",
            "features",
            "error, end, m",
        )
        results: dict[str, Any] = {}
        for key in self.filters if found else ():
            runs = [run[key] for run in found]
            of = {name: [getattr(run, name) for run in runs] for name in Outcome._fields}
            percent = {
                name: [100 * value for value in of[name]] for name in ("correct", "wrong", "missed", "duplicates")
            }
            table.add_row(
                TITLES[key],
                str(mean(percent["correct"])),
                f"{min(percent['correct']):.1f}",
                str(mean(percent["wrong"])),
                str(mean(percent["missed"])),
                str(mean(percent["duplicates"])),
                f"{max(percent['duplicates']):.1f}",
                str(mean(of["features"])),
                str(mean(of["position_end_m"])),
            )
            results[key] = {
                **{name: mean(values)._asdict() for name, values in of.items()},
                "runs": [run._asdict() for run in runs],
            }
        tables = [table] if found else []
        return finish(
            self, "association", command, {"filters": results}, tables, (len(found), self.runs), stopped, MEANS
        )


def one_run(task: Task) -> dict[str, Outcome]:
    """All filters on one seed."""
    from slam.estimators import ESTIMATORS

    study = task.study
    source = build(study.world, **landmark_options(study.world))
    given = {"inflate_r": study.inflate_r, "gate_new": study.gate_new}
    changes = {name: value for name, value in given.items() if value is not None}
    params = source.params(particles=study.particles, association=study.association, **changes)
    summary = Summary()
    filters = [ESTIMATORS[key] for key in study.filters]
    session.run(session.make_info(source, filters, params, None, task.seed, study.steps), [summary])
    outcomes = {}
    for key, series in summary.filters.items():
        counts = series.association or {}
        total = max(sum(counts.values()), 1)
        features = series.array("features")[-1]
        outcomes[key] = Outcome(
            **{name: counts.get(name, 0) / total for name in ("correct", "wrong", "missed")},
            duplicates=series.array("duplicates_so_far")[-1] / max(features, 1.0),
            features=features,
            position_end_m=series.array("position_error_m")[-1],
        )
    return outcomes
