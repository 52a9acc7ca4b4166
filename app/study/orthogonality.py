"""EKF-SLAM on walls, with and without the knowledge that they are parallel or at right angles: is it consistent?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_args

import numpy as np
from rich.table import Table

from app import session, values
from app.options import default
from app.study.jobs import run_all
from app.study.output import MEANS, JobsOption, OutOption, RunsOption, SeedOption, begin, empty_table, finish
from app.study.statistics import mean
from app.summary import Summary
from scenarios.registry import build, wall_worlds
from slam.limits import PARAMS, Interval
from slam.metrics import nees_interval, rms
from slam.types import AssociationName, Floats

ROWS = {"free": False, "orthogonal": True}

QUARTERS = (0.25, 0.5, 0.75, 1.0)
"""Of the run, at the ends of which the NEES is taken."""


class Task(NamedTuple):
    """One way of association on one seed, with and without constraints."""

    study: OrthogonalityStudy
    association: str
    seed: int


class Outcome(NamedTuple):
    """One run of EKF-SLAM."""

    nees_pose: Floats
    """(T,) 3 degrees of freedom."""
    nees_position: Floats
    """(T,) 2 degrees of freedom."""
    position_error_m: Floats
    """(T,)"""
    heading_error_rad: Floats
    """(T,)"""
    features: float
    """At the end."""
    wrong: float
    """Share of the observations that were paired with another wall."""


@dataclass(frozen=True)
class OrthogonalityStudy:
    """EKF-SLAM on walls, free and with walls made parallel or orthogonal, on the same seeds: NEES and errors.

    NEES is the squared error in units of the filter's own covariance: 3 on average for a pose that is as uncertain as
    the filter says, more if it is overconfident.
    """

    runs: RunsOption = 20
    """Independent runs, with seeds from --seed on."""
    world: Annotated[str, values.choice("--world", wall_worlds())] = "loop"
    """The world, with walls."""
    association: Annotated[
        tuple[str, ...],
        values.choices("--association", "|".join(get_args(AssociationName)), get_args(AssociationName)),
    ] = ("known", "jcbb")
    """How observations are paired with walls; some of known, nearest, jcbb."""
    inflate_r: Annotated[float, values.real("--inflate-r", "X", PARAMS["inflate_r"])] = 1.0
    """Factor on R for known walls; 1 is honest."""
    floor_lateral: Annotated[float, values.real("--floor-lateral", "M", PARAMS["floor_lateral"])] = 0.005
    """Deviation that a known wall is allowed."""
    floor_angle: Annotated[float, values.real("--floor-angle", "DEG", PARAMS["floor_angle"])] = 0.05
    """The same of its angle."""
    steps: Annotated[int | None, values.whole("--steps", "N", Interval(1)), default("all")] = None
    """Stop after N observing steps."""
    seed: SeedOption = 0
    """The first seed."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Means over the runs at every step, and the numbers of every run."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        seeds = range(self.seed, self.seed + self.runs)
        tasks = [Task(self, association, seed) for seed in seeds for association in self.association]
        found, stopped = run_all(one_run, tasks, jobs, "orthogonality")
        ways = len(self.association)
        whole = len(found) // ways  # seeds of which every association was run
        by_way = {way: found[at : whole * ways : ways] for at, way in enumerate(self.association)}
        tables = [self._table(way, runs) for way, runs in by_way.items()] if whole else []
        results = {
            way: {key: _result([run[key] for run in runs]) for key in ROWS} for way, runs in by_way.items() if whole
        }
        return finish(
            self, "orthogonality", command, {"associations": results}, tables, (whole, self.runs), stopped, MEANS
        )

    def _table(self, way: str, runs: list[dict[str, Outcome]]) -> Table:
        low, high = nees_interval(3, len(runs))
        table = empty_table(
            f"EKF-SLAM, {self.world}, {way}, {len(runs)} runs",
            "walls",
            "NEES, pose",
            *(f"at {quarter:.0%}" for quarter in QUARTERS),
            "inside [%]",
            "above [%]",
            "NEES, position",
            "above [%]",
            "position RMSE, m",
            "end, m",
            "heading RMSE [°]",
            "wrong [%]",
            "features",
        )
        for key in ROWS:
            of = _result([run[key] for run in runs])
            per_run = of["runs"]
            table.add_row(
                key,
                str(mean(per_run["nees_pose"])),
                *(f"{of['nees_pose_by_step'][_at(quarter, of)]:.2f}" for quarter in QUARTERS),
                f"{100 * of['inside']:.1f}",
                f"{100 * of['above_pose']:.1f}",
                str(mean(per_run["nees_position"])),
                f"{100 * of['above_position']:.1f}",
                *(str(mean(per_run[name])) for name in ("position_rmse_m", "position_end_m")),
                str(mean(np.degrees(per_run["heading_rmse_rad"]))),
                str(mean(100 * np.array(per_run["wrong"]))),
                str(mean(per_run["features"])),
            )
        table.caption = (
            f"inside: steps at which the mean NEES of the pose over the runs is within its 95 % interval, {low:.2f} to "
            f"{high:.2f};\nabove: steps of single runs above their 95 % interval, {nees_interval(3)[1]:.2f} for the "
            f"pose and {nees_interval(2)[1]:.2f} for the position, where 2.5 % ought to be"
        )
        table.caption_justify = "left"
        return table


def one_run(task: Task) -> dict[str, Outcome]:
    """Free and constrained on one seed, by the keys of `ROWS`."""
    from slam.estimators import ESTIMATORS

    study = task.study
    source = build(study.world)
    outcomes = {}
    for key, orthogonal in ROWS.items():
        params = source.params(
            association=task.association,
            inflate_r=study.inflate_r,
            floor_lateral=study.floor_lateral,
            floor_angle=math.radians(study.floor_angle),
            orthogonal=orthogonal,
        )
        summary = Summary()
        info = session.make_info(source, [ESTIMATORS["ekf"]], params, None, task.seed, study.steps)
        session.run(info, [summary])
        series = summary.filters["ekf"]
        counts = series.association or {}
        outcomes[key] = Outcome(
            nees_pose=series.array("nees_pose"),
            nees_position=series.array("nees"),
            position_error_m=series.array("position_error_m"),
            heading_error_rad=series.array("heading_error_rad"),
            features=series.array("features")[-1],
            wrong=counts.get("wrong", 0) / max(sum(counts.values()), 1),
        )
    return outcomes


def _at(quarter: float, of: dict[str, Any]) -> int:
    """The step at the end of this part of the run."""
    return max(round(quarter * len(of["nees_pose_by_step"])), 1) - 1


def _result(runs: list[Outcome]) -> dict[str, Any]:
    """What is saved of the runs; from this the table is made."""
    pose, position = (np.array([getattr(run, name) for run in runs]) for name in ("nees_pose", "nees_position"))
    low, high = nees_interval(3, len(runs))
    by_step = pose.mean(axis=0)
    return {
        "nees_pose_by_step": by_step,
        "nees_position_by_step": position.mean(axis=0),
        "nees_pose_interval": (low, high),
        "inside": np.mean((by_step >= low) & (by_step <= high)),
        "above_pose": np.mean(pose > nees_interval(3)[1]),
        "above_position": np.mean(position > nees_interval(2)[1]),
        "runs": {
            "nees_pose": pose.mean(axis=1),
            "nees_position": position.mean(axis=1),
            "position_rmse_m": [rms(run.position_error_m) for run in runs],
            "position_end_m": [run.position_error_m[-1] for run in runs],
            "heading_rmse_rad": [rms(run.heading_error_rad) for run in runs],
            "wrong": [run.wrong for run in runs],
            "features": [run.features for run in runs],
        },
    }
