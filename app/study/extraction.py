"""How many walls are found in scans of the worlds, how many segments are false, and how honest their covariance is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np

from app import values
from app.session import stream
from app.study.jobs import run_all
from app.study.output import MEANS, JobsOption, OutOption, SeedOption, begin, empty_table, finish
from app.study.statistics import Mean, mean
from scenarios.laser import MAX_BEAMS
from scenarios.noise import add_noise
from scenarios.registry import build, wall_worlds
from slam.limits import BELIEVED_SENSOR, Interval
from slam.perception import extract
from slam.perception.score import FEWEST, OFF, Score, score, total

TOTAL = "all"


class Task(NamedTuple):
    """One world, seen by one laser."""

    study: ExtractionStudy
    beams: int
    range_noise: float
    world: str


@dataclass(frozen=True)
class ExtractionStudy:
    """Walls in scans, against the truth: how many are found, how many are false, how honest their covariance is.

    The poses are spread evenly over the route of each world; a variance is that of error / reported deviation, 1 where
    what is reported is true.
    """

    worlds: Annotated[tuple[str, ...], values.choices("--worlds", "|".join(wall_worlds()), wall_worlds())] = (
        wall_worlds()
    )
    """Some of the worlds of walls."""
    poses: Annotated[int, values.whole("--poses", "N", Interval(1))] = 300
    """Scans of each world."""
    beams: Annotated[tuple[int, ...], values.wholes("--beams", "N ...", Interval(1, MAX_BEAMS))] = (181, 361)
    """Of the laser, over 180 degrees."""
    range_noise: Annotated[tuple[float, ...], values.reals("--range-noise", "M ...", BELIEVED_SENSOR)] = (0.01, 0.05)
    """Deviation of a range, as it is and as it is believed."""
    seed: SeedOption = 0
    """Of the noise."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Shares, variances and counts."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        tasks = [
            Task(self, beams, sigma, world)
            for beams in self.beams
            for sigma in self.range_noise
            for world in self.worlds
        ]
        found, stopped = run_all(one_world, tasks, jobs, "extraction")
        settings: dict[tuple[int, float], dict[str, Score]] = {}
        for task, scored in zip(tasks, found, strict=False):
            settings.setdefault((task.beams, task.range_noise), {})[task.world] = scored
        tables, results, warnings = [], [], []
        for (beams, sigma), scores in settings.items():
            table = empty_table(
                f"{beams} beams, deviation {sigma:g} m, {self.poses} scans of each world",
                "",
                "found [%]",
                "of walls",
                "too short",
                "false [%]",
                "of segments",
                "off",
                "variance, lateral",
                "angle",
            )
            everything = total(list(scores.values()))
            if not everything.segments:
                warnings.append(f"no wall was ever seen with {beams} beams and a deviation of {sigma:g} m")
            rows = {name: _row(scored) for name, scored in {**scores, TOTAL: everything}.items()}
            for name, row in rows.items():
                table.add_row(name, *("-" if cell is None else str(cell) for cell in row.values()))
            results.append({"beams": beams, "range_noise_m": sigma, "worlds": {k: _plain(r) for k, r in rows.items()}})
            tables.append(table)
        note = (
            f"found: of the walls that {FEWEST} beams meet, without those too short for a segment; false: of no wall, "
            f"or more than {OFF:g} deviations off\n{MEANS}"
        )
        runs = (len(found), len(tasks))
        lasers = {"lasers": results}
        return finish(self, "extraction", command, lasers, tables, runs, stopped, note, "worlds", warnings)


def one_world(task: Task) -> Score:
    """All scans of one world."""
    study = task.study
    source = build(task.world, beams=task.beams)
    noise = replace(source.noise, range=task.range_noise)
    assert source.true_map is not None
    scores = []
    for i, at in enumerate(np.linspace(0, len(source.steps) - 1, study.poses).round().astype(int)):
        frame, truth = source.steps[at]
        scan = add_noise(stream(study.seed, task.world, i), frame, noise).scan
        assert frame.scan is not None
        assert scan is not None
        assert truth is not None
        scores.append(score(extract(scan, task.range_noise), scan, frame.scan.ranges, *source.true_map, truth))
    return total(scores)


def _row(scored: Score) -> dict[str, Any]:
    """What stands in the table, by the names of the results."""
    return {
        "found_percent": _percent(scored.found, scored.walls),
        "walls": scored.walls,
        "short": scored.short,
        "false_percent": _percent(scored.false, scored.segments),
        "segments": scored.segments,
        "off": scored.off,
        "lateral_variance": mean(scored.lateral**2) if len(scored.lateral) else None,
        "angle_variance": mean(scored.angle**2) if len(scored.angle) else None,
    }


def _percent(count: int, of: int) -> Mean | None:
    """With the standard error of a share; None of nothing."""
    return mean(np.repeat([100.0, 0.0], [count, of - count])) if of else None


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    return {name: cell._asdict() if isinstance(cell, Mean) else cell for name, cell in row.items()}
