"""The runs that are compared: what a recording, or a branch of a live session, tells of one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from app.errors import UsageError
from app.recording.reading import Recording
from app.recording.texts import means_on_relations
from slam.estimators import ESTIMATORS
from slam.types import Bools, Floats, Ints

BRANCH_MARK = "#"
"""Between the name of a file and that of a branch in it."""

SERIES = {
    "position_error_m": ("position_error", 1.0),
    "heading_error_rad": ("heading_error", math.radians(1.0)),
    "map_error_m": ("map_error", 1.0),
    "nees": ("nees", 1.0),
    "n_eff": ("n_eff", 1.0),
    "diversity": ("diversity", 1.0),
    "common_ancestor_steps": ("common_ancestor", 1.0),
    "features": ("features", 1.0),
    "duplicates_so_far": ("duplicates", 1.0),
    "seconds": ("update_ms", 1e-3),
}
"""By name, what a recording plots, and the factor to SI units and radians."""

CHANGED = "Parameter changed: "
"""How `events` begins what it tells of a change of parameters."""


class Numbers(NamedTuple):
    """One filter in one run."""

    steps: Ints
    """(T,) increasing; of a filter that was switched on and off, not all."""
    series: dict[str, Floats]
    """(T,) each: `SERIES`, in SI units and radians, and `resampled`, 1 or 0; NaN where something is not known."""
    missing: frozenset[str] = frozenset()
    """Those of `SERIES` that the recording does not have: it is damaged, or of another version."""

    def at(self, steps: Ints) -> dict[str, Floats]:
        """The series at those of the steps that it has."""
        chosen = np.isin(self.steps, steps)
        return {name: values[chosen] for name, values in self.series.items()}


class Seen(NamedTuple):
    """What no filter had a hand in, by step: whoever has the same has the same data.  Rounded as recordings are."""

    truth: dict[int, Floats]
    """(1, 2) [m] where the robot was."""
    odometry: dict[int, Floats]
    """(1, 2) [m] where dead reckoning was."""
    observations: dict[int, Floats]
    """(n, 2) [m] where things were seen; nothing where that depends on a filter."""


class Place(NamedTuple):
    """What is drawn on a map [m], each a list of arrays (n, 2)."""

    truth: list[Floats]
    true_walls: list[Floats]
    true_landmarks: list[Floats]
    odometry: list[Floats]
    paths: dict[str, list[Floats]]
    """Of the best particle, by filter."""

    def points(self) -> list[Floats]:
        """All that a map must hold: dead reckoning may leave it."""
        ways = [line for path in self.paths.values() for line in path]
        return [*self.truth, *self.true_walls, *self.true_landmarks, *ways]


class Run(NamedTuple):
    """One of those that are compared."""

    name: str
    """Unique among them."""
    path: Path
    branch: str
    """The name that it has in the recording; empty for the run itself."""
    told: dict[str, Any]
    """What it was made with (`recording.texts.description`)."""
    filters: dict[str, Numbers]
    changes: list[tuple[int, str]]
    """Parameters that changed while it ran, from which step on."""
    times: dict[int, float]
    """[s] of each step, from the beginning."""
    seen: Seen
    drawn: dict[int, dict[str, list[Floats]]]
    """Paths by step and entity, as often as they were drawn."""
    true_walls: list[Floats]
    true_landmarks: list[Floats]
    branches: list[str]
    """Others in the same recording."""
    damaged: bool
    walls: bool
    """Whether the features are walls, or else landmarks."""
    relations: tuple[int, dict[str, str]] | None = None
    """Where paths were judged by relations: the last step of it, and the mean error [m] of each path by its title."""

    @property
    def steps(self) -> Ints:
        """(T,) that any filter has."""
        return reduce(np.union1d, [numbers.steps for numbers in self.filters.values()])

    def place(self, until: int) -> Place:
        """As it was drawn last, up to a step."""

        def last(entity: str) -> list[Floats]:
            drawn = [i for i, found in self.drawn.items() if i <= until and entity in found]
            return self.drawn[max(drawn)][entity] if drawn else []

        paths = {key: last(f"{key}/path") for key in self.filters}
        return Place(last("truth/path"), self.true_walls, self.true_landmarks, last("odometry/path"), paths)


def split_branch(name: str) -> tuple[Path, str]:
    """`FILE.rrd#BRANCH` as file and branch; the latter is empty for the run itself."""
    path, _, branch = name.rpartition(BRANCH_MARK)
    if not path or Path(name).exists():
        return Path(name).expanduser(), ""
    return Path(path).expanduser(), branch


def read_runs(names: Sequence[str]) -> list[Run]:
    """All runs, in this order.  Raises `UsageError` of what is no recording, or has nothing to compare."""
    parts = [split_branch(name) for name in names]
    return [read_run(path, branch, title) for (path, branch), title in zip(parts, titles(parts), strict=True)]


def titles(parts: Sequence[tuple[Path, str]]) -> list[str]:
    """A short name for each file and branch, no two alike: the file's, with its folder's or a number if it must be."""
    plain = [f"{path.stem}{BRANCH_MARK}{branch}" if branch else path.stem for path, branch in parts]
    longer = [
        name if plain.count(name) == 1 else f"{path.absolute().parent.name}/{name}"
        for (path, _), name in zip(parts, plain, strict=True)
    ]
    return [
        name if longer.count(name) == 1 else f"{name} ({longer[: i + 1].count(name)})" for i, name in enumerate(longer)
    ]


def read_run(path: Path, branch: str, name: str) -> Run:
    """One run; what only Rerun needs of its recording is forgotten."""
    recording = Recording(path)
    branches = recording.branches()
    if branch and branch not in branches:
        has = f"it has {', '.join(branches)}" if branches else "it has none"
        raise UsageError(f"{path} has no branch {branch!r}; {has}")
    root = root_of(branch)
    told = recording.params(branch)
    filters = _filters(recording, root)
    if not filters:
        raise UsageError(f"{path} has no step of any filter; nothing can be compared")
    return Run(
        name,
        path,
        branch,
        told,
        filters,
        _changes(recording, root),
        _times(recording, root, filters),
        _seen(recording, root),
        _drawn(recording, root, filters),
        recording.points(f"{root}world/truth/map", "LineStrips3D:strips").get(0, []),
        recording.points(f"{root}world/truth/map", "Points3D:positions").get(0, []),
        [other for other in branches if other != branch],
        recording.damaged,
        any(entity.startswith(root) and entity.endswith("/segments") for entity in recording.entities),
        _relations(recording, root),
    )


def root_of(branch: str) -> str:
    """Of the entities of a branch in a recording, or of the run itself; ends in a slash."""
    return f"/branch/{branch}/" if branch else "/"


def common_steps(runs: Iterable[Run], key: str = "") -> Ints:
    """Those that all runs have; of a filter, those at which all that have it at all had it."""
    runs = list(runs)
    steps = [run.steps for run in runs]
    steps += [run.filters[key].steps for run in runs if key in run.filters]
    return reduce(np.intersect1d, steps)


def _filters(recording: Recording, root: str) -> dict[str, Numbers]:
    found = {key: _numbers(recording, root, key) for key in ESTIMATORS}
    return {key: numbers for key, numbers in found.items() if len(numbers.steps)}


def _numbers(recording: Recording, root: str, key: str) -> Numbers:
    series = {name: _series(recording, f"{root}plots/{plot}/{key}") for name, (plot, _) in SERIES.items()}
    # All are written at every step; at the end of a damaged file some may lack what others have.
    steps = reduce(np.intersect1d, [there for there, _ in series.values() if len(there)] or [np.zeros(0)]).astype(
        np.int64
    )
    said = f" {ESTIMATORS[key].title} resampled: "
    resampled = [event.step for event in recording.events(f"{root}events") if said in event.text]
    aligned = {name: SERIES[name][1] * _aligned(steps, *found) for name, found in series.items()}
    missing = frozenset(name for name, (there, _) in series.items() if not len(there))
    return Numbers(steps, {**aligned, "resampled": np.isin(steps, resampled).astype(float)}, missing)


def _series(recording: Recording, entity: str, timeline: str = "step") -> tuple[Ints | Floats, Floats]:
    """Nothing, if there is no such thing: of a run that was killed before its first step."""
    if timeline not in recording.timelines(entity):
        return np.zeros(0, np.int64), np.zeros(0)
    return recording.series(entity, timeline)


def _aligned(wanted: Ints, steps: Ints | Floats, values: Floats) -> Floats:
    """A series at the wanted steps; all NaN if there is no such thing."""
    return values[np.isin(steps, wanted)] if len(steps) else np.full(len(wanted), np.nan)


def _changes(recording: Recording, root: str) -> list[tuple[int, str]]:
    events = recording.events(f"{root}events")
    return [(e.step, e.text.partition(CHANGED)[2]) for e in events if CHANGED in e.text]


def _times(recording: Recording, root: str, keys: Iterable[str]) -> dict[int, float]:
    found: dict[int, float] = {}
    for entity in (f"{root}plots/n_eff/{key}" for key in keys):
        steps, seconds = _series(recording, entity)[0], _series(recording, entity, "sim_time")[0]
        found |= dict(zip(steps.tolist(), seconds.tolist(), strict=False))
    return found


def _seen(recording: Recording, root: str) -> Seen:
    truth = {i: found[0] for i, found in recording.points(f"{root}world/truth/robot", "Points3D:positions").items()}
    paths = recording.points(f"{root}world/odometry/path", "LineStrips3D:strips")
    headed = recording.points(f"{root}world/truth/robot", "Arrows3D:origins")
    observed = recording.points(f"{root}world/scan", "Points3D:positions")
    return Seen(
        truth,
        {i: found[-1][-1:] for i, found in paths.items() if found and len(found[-1])},
        {i: found[0] for i, found in observed.items() if i in headed and len(headed[i][0])},
    )


def _drawn(recording: Recording, root: str, keys: Iterable[str]) -> dict[int, dict[str, list[Floats]]]:
    found: dict[int, dict[str, list[Floats]]] = {}
    for entity in ("truth/path", "odometry/path", *(f"{key}/path" for key in keys)):
        for step, lines in recording.points(f"{root}world/{entity}", "LineStrips3D:strips").items():
            found.setdefault(step, {})[entity] = lines
    return found


def _relations(recording: Recording, root: str) -> tuple[int, dict[str, str]] | None:
    pages = recording.rows(f"{root}relations", "TextDocument:text", "step")
    if not pages:
        return None
    step, (page,) = max(pages, key=lambda row: row[0])
    return step, means_on_relations(page)


def same_bits(a: Floats, b: Floats) -> Bools:
    """(T,) where two series have the same value, or both none."""
    return (a == b) | (np.isnan(a) & np.isnan(b))
