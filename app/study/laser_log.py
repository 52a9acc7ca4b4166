"""How well filters map a real laser log, over seeds: filters x particles, beside odometry and scan matching alone."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro
from rich.table import Table
from tyro.conf import OmitArgPrefixes, Positional

from app import session, values
from app.colours import of_filter
from app.drawing import NO_TRUTH, draw_map, map_layer
from app.errors import UsageError
from app.files import check_directory, write_whole
from app.options import FILTERS, BelievedNoise, FilterOptions, LogOptions, WorldNoise, default, parameters
from app.paths import MATCHED, ODOMETRY, Paths
from app.relations import PathErrors, relations_of
from app.scans import all_returns
from app.sources import LogParts, load
from app.study.jobs import run_all
from app.study.output import MEDIANS, TITLES, JobsOption, OutOption, SeedOption, begin, empty_table, finish, unseen
from app.study.path_fit import NEAR, Closure, Fit, closures_of, fit
from app.study.statistics import spread
from app.study.walls import settings
from app.summary import Summary
from app.types import best_descendant, best_path
from scenarios.logs.relations import Relations
from scenarios.types import Source
from slam.limits import PARAMS, Interval
from slam.types import Params

ALONE = {ODOMETRY: "odometry alone", MATCHED: "matching alone"}
"""What needs no filter, by the key of its path."""


@dataclass(frozen=True)
class _Tuning(FilterOptions):
    """What the filters do; of their particles there are several numbers, and right angles have a study of their own."""

    particles: tyro.conf.Suppress[None] = None
    orthogonal: tyro.conf.Suppress[bool] = False


class Task(NamedTuple):
    """One filter, one number of particles, one seed."""

    study: LaserLog
    closures: tuple[Closure, ...]
    filter: str
    particles: int
    seed: int


class Outcome(NamedTuple):
    """What one run came to."""

    fits: dict[str, Fit]
    """Of the filter by its key, and by those of `ALONE`."""
    observed: int
    """Walls seen in all steps."""
    features: float
    resamplings: float
    update_ms: float
    """Median step of the filter."""
    filter_s: float
    """All its steps."""
    real_time_factor: float
    """Seconds of the log for each of these; NaN for a log without time stamps."""


Cells = dict[tuple[str, int], list[Outcome]]


@dataclass(frozen=True)
class LaserLog:
    """Relations, closures, features and time on a log of a laser: the median over seeds, for filters x particles.

    Judged is the path of the best particle's lineage, as it is known at the end, at every scan of the log.

    Example: dualslam study laser-log csail.log.gz --relations csail.relations.gz --reference csail.ref-graph.txt.gz
    --closures 739:994 302:1855 --particles 30 100 --picture pictures/
    """

    source: Annotated[Positional[str], values.word("LOG"), tyro.conf.arg(help_behavior_hint="")] = ""
    """A log of a laser."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = ("dfs",)
    """Some of dfs, fs2, fs1, ekf."""
    particles: Annotated[tuple[int, ...], values.wholes("--particles", "K ...", PARAMS["particles"])] = (30, 100, 300)
    """Numbers of particles."""
    relations: Annotated[Path | None, values.path("--relations", "FILE"), default("none")] = None
    """Relations between two scans (Kuemmerle et al., 2009), by which to judge the paths."""
    closures: Annotated[
        tuple[tuple[int, int], ...], values.spans("--closures", "A:B ...", Interval(0)), default("none")
    ] = ()
    """Pairs of scans, by their numbers in the whole log, at which the robot is in one place; needs true poses."""
    seeds: Annotated[int, values.whole("--seeds", "N", Interval(1))] = 10
    """How many seeds."""
    seed: SeedOption = 0
    """The first seed."""
    picture: Annotated[Path | None, values.path("--picture", "DIR"), default("not written")] = None
    """Maps of the first seed, over what the laser saw: <log>-<filter>-<K>.svg."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """What the tables show, and every single run."""
    tuning: OmitArgPrefixes[_Tuning] = field(default_factory=_Tuning)
    believed: BelievedNoise = field(default_factory=BelievedNoise)
    log: OmitArgPrefixes[LogOptions] = field(default_factory=LogOptions)

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        if self.picture is not None:
            check_directory("--picture", self.picture)
        if not self.source:
            raise UsageError("study laser-log needs a log of a laser, such as: dualslam study laser-log intel.log.gz")
        source, relations = _load(self)
        _tuned(self, source, 1)  # complain now of what does not apply
        closures = self._closures(source)
        tasks = [
            Task(self, closures, key, particles, seed)
            for seed in range(self.seed, self.seed + self.seeds)
            for key, particles in settings(self.filters, self.particles)
        ]
        found, stopped = run_all(one_run, tasks, jobs, "laser-log")
        cells: Cells = {}
        for task, outcome in zip(tasks, found, strict=False):
            cells.setdefault((task.filter, task.particles), []).append(outcome)
        fewest = min((len(outcomes) for outcomes in cells.values()), default=0)
        alone = {key: fit for key, fit in found[0].fits.items() if key in ALONE} if found else {}
        warnings = [*source.warnings, *(relations.warnings if relations else ())]
        if relations and alone and not alone[ODOMETRY].relations:
            warnings.append(f"none of the {len(relations.times)} relations is between two of the {_part(source)}")
        warnings += [*unseen([outcome.observed for outcome in found[:1]]), *worse(alone, cells)]
        return finish(
            self,
            "laser-log",
            command,
            _results(source, closures, alone, cells),
            _tables(closures, alone, cells),
            (fewest, self.seeds),
            stopped,
            f"{source.title}; {_part(source)}, {len(source.steps)} steps\n{MEDIANS}",
            warnings=warnings,
        )

    def _closures(self, source: Source) -> tuple[Closure, ...]:
        """With their true relative poses, from the whole log.  Raises `UsageError`."""
        if not self.closures:
            return ()
        whole = load(self.source, {}, LogParts(self.log.robot, keyframe=(0.0, 0.0), reference=self.log.reference))
        return closures_of(self.closures, source, whole)


def one_run(task: Task) -> Outcome:
    """One filter with one number of particles on one seed."""
    from slam.estimators import ESTIMATORS

    study = task.study
    source, relations = _load(study)
    judge = None if relations is None else PathErrors(relations)
    summary, paths = Summary(paths=judge), Paths()
    params = _tuned(study, source, task.particles)
    session.run(session.make_info(source, [ESTIMATORS[task.filter]], params, None, task.seed), [summary, paths])
    if study.picture is not None and task.seed == study.seed:
        _draw(study.picture, source, task, paths)
    series = summary.filters[task.filter]
    errors = judge.found() if judge else {}
    seconds = float(np.sum(series.seconds))
    return Outcome(
        {key: fit(source, path, errors.get(key), task.closures) for key, (_, path) in paths.found().items()},
        observed=summary.observed,
        features=float(series.array("features")[-1]),
        resamplings=float(series.array("resampled").sum()),
        update_ms=1e3 * float(np.median(series.seconds)),
        filter_s=seconds,
        real_time_factor=summary.seconds() / seconds if source.has_clock else math.nan,
    )


def worse(alone: Mapping[str, Fit], cells: Cells) -> list[str]:
    """A sentence for each filter and number of particles, as often as the log is mapped better without it."""
    told = []
    for (key, particles), outcomes in cells.items():
        errors = [_error(outcome.fits[key]) for outcome in outcomes]
        for name, without in alone.items():
            median, limit = float(np.median(errors)), _error(without)
            if median > limit:
                seeds = f"{sum(error > limit for error in errors)} of {len(errors)} seeds"
                told.append(
                    f"{TITLES[key]} with {_particles(particles)} is worse than {ALONE[name]}: {median:.3g} m against "
                    f"{limit:.3g} m, on {seeds}"
                )
    return told


def _error(path: Fit) -> float:
    """[m] what paths are compared by: the mean error of relations, or without any that after alignment."""
    return path.mean_m if path.relations else path.aligned_rms_m


def _particles(number: int) -> str:
    return f"{number} particle{'s' if number > 1 else ''}"


# -- what is shown and saved ----------------------------------------------------------------------------------------


def _tables(closures: Sequence[Closure], alone: Mapping[str, Fit], cells: Cells) -> list[Table]:
    """Errors and closures, if anything is known to compare with, and what it took."""
    if not cells:
        return []
    rows = [(ALONE[key], "", [path]) for key, path in alone.items()]
    rows += [(TITLES[key], str(K), [outcome.fits[key] for outcome in run]) for (key, K), run in cells.items()]
    some = rows[0][2][0]
    tables = []
    if not math.isnan(_error(some)):
        tables.append(_errors_table(rows, some))
    if closures:
        tables.append(_closures_table(rows, closures))
    tables.append(_work_table(cells))
    return tables


def _errors_table(rows: Sequence[tuple[str, str, list[Fit]]], some: Fit) -> Table:
    with_relations, with_truth = some.relations > 0, not math.isnan(some.aligned_rms_m)
    columns = ["mean [m]", "median [m]", "95 % [m]", "max [m]", "rotation [°]"] if with_relations else []
    columns += ["aligned rms [m]"] if with_truth else []
    name = (
        f"errors of {some.relations} relation{'s' if some.relations > 1 else ''}"
        if with_relations
        else "errors of position"
    )
    table = empty_table(name, "", "K", *columns)
    for title, K, paths in rows:
        of = {name: [getattr(path, name) for path in paths] for name in Fit._fields}
        cells = []
        if with_relations:
            cells += [spread(of["mean_m"])]
            cells += [f"{np.median(of[name]):.3g}" for name in ("median_m", "p95_m", "max_m")]
            cells += [spread([math.degrees(angle) for angle in of["rotation_rad"]])]
        if with_truth:
            cells += [spread(of["aligned_rms_m"])]
        table.add_row(title, K, *cells)
    return table


def _closures_table(rows: Sequence[tuple[str, str, list[Fit]]], closures: Sequence[Closure]) -> Table:
    columns = [name for first, second, _ in closures for name in (f"{first}:{second} [m]", "closed")]
    table = empty_table("closures", "", "K", *columns, "all closed")
    for title, K, paths in rows:
        off = np.array([path.closures_m for path in paths])  # (N, C)
        cells = [cell for column in off.T for cell in (f"{np.median(column):.3g}", _share(column <= NEAR))]
        table.add_row(title, K, *cells, _share((off <= NEAR).all(axis=1)))
    table.caption = f"closed: within {NEAR:g} m, as seen from the first scan"
    table.caption_justify = "left"
    return table


def _share(closed: Any) -> str:
    """Of (N,) how many."""
    return f"{int(np.sum(closed))} of {len(closed)}"


def _work_table(cells: Cells) -> Table:
    table = empty_table("what it took", "", "K", "features", "resamplings", "ms/step", "filter [s]", "real time")
    for (key, K), outcomes in cells.items():
        of = {name: [getattr(outcome, name) for outcome in outcomes] for name in Outcome._fields}
        factor = float(np.median(of["real_time_factor"]))
        table.add_row(
            TITLES[key],
            str(K),
            spread(of["features"], ".0f"),
            spread(of["resamplings"], ".0f"),
            f"{np.median(of['update_ms']):.2g}",
            spread(of["filter_s"]),
            "-" if math.isnan(factor) else f"{factor:.3g}x",
        )
    table.caption = "real time: seconds of the log for one of the filter"
    table.caption_justify = "left"
    return table


def _results(source: Source, closures: Sequence[Closure], alone: Mapping[str, Fit], cells: Cells) -> dict[str, Any]:
    assert source.scans is not None
    kept = source.scans.kept
    return {
        "log": {"title": source.title, "scans": [kept[0], kept[-1]], "steps": len(kept)},
        "closures": [[first, second] for first, second, _ in closures],
        "alone": {key: path._asdict() for key, path in alone.items()},
        "cells": [_result(key, particles, alone, outcomes) for (key, particles), outcomes in cells.items()],
    }


def _result(key: str, particles: int, alone: Mapping[str, Fit], outcomes: list[Outcome]) -> dict[str, Any]:
    runs = [
        {**outcome.fits[key]._asdict(), **{name: getattr(outcome, name) for name in Outcome._fields[1:]}}
        for outcome in outcomes
    ]
    off = np.array([outcome.fits[key].closures_m for outcome in outcomes])
    single = [name for name in runs[0] if name != "closures_m"]
    return {
        "filter": key,
        "particles": particles,
        "closed": (off <= NEAR).sum(axis=0),
        "closed_all": int((off <= NEAR).all(axis=1).sum()) if off.size else None,
        "worse_than": {
            name: sum(_error(outcome.fits[key]) > _error(path) for outcome in outcomes) for name, path in alone.items()
        },
        "median": {name: float(np.median([run[name] for run in runs])) for name in single}
        | {"closures_m": np.median(off, axis=0)},
        "runs": runs,
    }


def _draw(directory: Path, source: Source, task: Task, paths: Paths) -> None:
    """The map of the best particle's lineage, over the scans as its path places them."""
    assert paths.last is not None
    update = paths.last.filters[task.filter]
    path = best_path(update)
    theta, Sigma, _ = update.trace.resampled.maps.features(best_descendant(update))
    name = f"{TITLES[task.filter]}, {_particles(task.particles)}"
    layer = map_layer(name, of_filter(task.filter), path, source.feature, theta, Sigma)
    title = f"{source.name}, {_part(source)}, seed {task.seed}"
    directory.mkdir(parents=True, exist_ok=True)
    picture = draw_map(title, NO_TRUTH, [layer], all_returns(source, path))
    write_whole(directory / f"{source.name}-{task.filter}-{task.particles}.svg", picture)


# -- the log, and what is known of it -------------------------------------------------------------------------------


def _tuned(study: LaserLog, source: Source, particles: int) -> Params:
    given = FilterOptions(**{**vars(study.tuning), "particles": particles})
    return parameters(source, given, WorldNoise(), study.believed)[1]


def _part(source: Source) -> str:
    assert source.scans is not None
    return f"scans {source.scans.kept[0]} to {source.scans.kept[-1]}"


def _source(study: LaserLog) -> Source:
    return _load(study)[0]


def _load(study: LaserLog) -> tuple[Source, Relations | None]:
    return _read(study.source, LogParts(*vars(study.log).values()), study.relations)


@functools.lru_cache(maxsize=1)  # every run of a process reads the same log
def _read(name: str, parts: LogParts, relations: Path | None) -> tuple[Source, Relations | None]:
    source = load(name, {}, parts)
    if source.scans is None:
        raise UsageError(f"study laser-log does not apply to {name}: it is for logs of a laser")
    return source, None if relations is None else relations_of(relations, source)
