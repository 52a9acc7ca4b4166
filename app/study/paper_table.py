"""The paper's comparison (Figs. 4-6) on its own line of landmarks, with standard errors."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_args

import numpy as np
from rich.table import Table

from app import session, values
from app.study.jobs import run_all
from app.study.output import JobsOption, OutOption, RunsOption, SeedOption, begin, empty_table, finish
from app.study.statistics import mean
from app.summary import Summary
from scenarios.paper_line import LayoutName
from scenarios.registry import build
from slam.limits import PARAMS
from slam.types import ProposalWeightName, ResamplerName

CHECKPOINTS = (5, 10, 20, 59)
"""Updates at which the diversity is taken; 59 is the end with an observation every nine ticks."""

LEVELS = {"3 mm, 0.003°": (0.003, 0.003), "0.3 mm, 0.0003°": (0.0003, 0.0003)}
"""Deviations of range [m] and bearing [degrees], of the sensor and as believed."""

ROWS = {
    "fs1": "FastSLAM 1.0",
    "fs2": "FastSLAM 2.0",
    "dfs": "Dual, marginal",
    "dfs-joint": "Dual, joint",
    "ekf": "EKF-SLAM",
}


class Task(NamedTuple):
    """One run of all filters."""

    study: PaperTable
    level: str
    seed: int


class Outcome(NamedTuple):
    """What one filter came to in one run."""

    squared_error: float
    """[m^2] of the position after the last update."""
    diversity: tuple[float, ...]
    """At `CHECKPOINTS`."""


@dataclass(frozen=True)
class PaperTable:
    """The paper's comparison on paper-line: final MSE and diversity of every filter, on the same seeds.

    Known association, 59 updates; sensors of 3 mm and of 0.3 mm.
    """

    runs: RunsOption = 100
    """Independent runs, with seeds from --seed on."""
    particles: Annotated[int, values.whole("--particles", "K", PARAMS["particles"])] = 25
    """Number of particles."""
    vehicle: Annotated[str, values.choice("--vehicle", ("ackermann", "unicycle"))] = "ackermann"
    """The vehicle; the paper's baseline code has ackermann."""
    layout: Annotated[str, values.choice("--layout", get_args(LayoutName))] = "alternating"
    """Where the landmarks stand."""
    resampler: Annotated[str, values.choice("--resampler", get_args(ResamplerName))] = "stratified"
    """Resampling scheme; stratified is that of the paper's baseline code."""
    proposal_weight: Annotated[str, values.choice("--proposal-weight", get_args(ProposalWeightName))] = "drawn"
    """How FastSLAM 2.0 weighs its proposal; as drawn is what the paper's baseline code does."""
    seed: SeedOption = 0
    """The first seed."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Means, errors and every single run."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        seeds = range(self.seed, self.seed + self.runs)
        tasks = [Task(self, level, seed) for seed in seeds for level in LEVELS]
        found, stopped = run_all(one_run, tasks, jobs, "paper-table")
        whole = len(found) // len(LEVELS)  # seeds of which every level was run
        by_level = {level: found[at :: len(LEVELS)][:whole] for at, level in enumerate(LEVELS)}
        tables = [self._table(level, runs) for level, runs in by_level.items()] if whole else []
        results = {"levels": {level: _results(runs) for level, runs in by_level.items()}}
        return finish(self, "paper-table", command, results, tables, (whole, self.runs), stopped)

    def _table(self, level: str, runs: list[dict[str, Outcome]]) -> Table:
        title = f"{level}; {self.particles} particles, {self.vehicle}, landmarks {self.layout}, {len(runs)} runs"
        columns = [f"at {at}" for at in CHECKPOINTS]
        columns[0] = "diversity " + columns[0]
        table = empty_table(title, "", "final MSE, m²", *columns)
        for key, name in ROWS.items():
            outcomes = [run[key] for run in runs]
            shares = np.array([outcome.diversity for outcome in outcomes])
            # A filter of one particle has no diversity to speak of.
            cells = ["-"] * len(CHECKPOINTS) if key == "ekf" else [mean(column).rounded(2) for column in shares.T]
            table.add_row(name, str(mean([outcome.squared_error for outcome in outcomes])), *cells)
        difference = mean([run["dfs"].squared_error - run["fs2"].squared_error for run in runs])
        table.caption = f"Dual, marginal, minus FastSLAM 2.0 on the same seeds: {difference} m²"
        table.caption_justify = "left"
        return table


def one_run(task: Task) -> dict[str, Outcome]:
    """All filters on one seed: what each came to, by the keys of `ROWS`."""
    from slam.estimators import ESTIMATORS

    study = task.study
    source = build("paper-line", vehicle=study.vehicle, period="nine-ticks", layout=study.layout)
    metres, degrees = LEVELS[task.level]
    noise = dataclasses.replace(source.noise, range=metres, bearing=math.radians(degrees))
    params = source.params(
        believed=noise,
        association="known",
        particles=study.particles,
        resampler=study.resampler,
        proposal_weight=study.proposal_weight,
        weighting="marginal",
    )
    outcomes: dict[str, Outcome] = {}
    joint = dataclasses.replace(params, weighting="joint")
    for chosen, keys, suffix in ((params, ("fs1", "fs2", "dfs", "ekf"), ""), (joint, ("dfs",), "-joint")):
        summary = Summary()
        filters = [ESTIMATORS[key] for key in keys]
        session.run(session.make_info(source, filters, chosen, noise, task.seed), [summary])
        for key, series in summary.filters.items():
            diversity = series.array("diversity")[np.array(CHECKPOINTS) - 1]
            outcomes[key + suffix] = Outcome(series.array("position_error_m")[-1] ** 2, tuple(diversity))
    return outcomes


def _results(runs: list[dict[str, Outcome]]) -> dict[str, Any]:
    if not runs:
        return {}
    return {
        key: {
            "final_mse_m2": mean([run[key].squared_error for run in runs])._asdict(),
            "diversity": {
                f"at {at}": mean([run[key].diversity[i] for run in runs])._asdict() for i, at in enumerate(CHECKPOINTS)
            },
            "squared_errors_m2": [run[key].squared_error for run in runs],
            "diversities_at_end": [run[key].diversity[-1] for run in runs],
        }
        for key in ROWS
    }
