"""From a recording back to its session: the source, what held from which step on, and the numbers that it plotted."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from app import session
from app.compare.runs import root_of
from app.errors import UsageError, listed, sentence
from app.recording import texts
from app.recording.metrics import METRICS
from app.recording.reading import Recording
from app.run import SessionOptions, options_of_command
from app.session import Change
from app.sources import LogParts, load
from app.types import SessionInfo, SessionStep
from app.whatif.changes import changes_of, filters_at_end
from app.whatif.settings import Values
from scenarios.registry import build, worlds
from scenarios.types import Source, SourceError
from slam.estimators import ESTIMATORS
from slam.types import Floats

CLOCKS = ("update_ms",)
"""What is another number each time."""

ROBOT = "of the robot"
"""What no filter has a hand in."""

LAST_BITS = 1e-6
"""Relative, and absolute below 1: differences up to here are those of rounding, on another machine."""


class Departure(NamedTuple):
    """Where a run is not what was recorded."""

    step: int
    what: str
    """The number, for people."""
    recorded: float
    computed: float

    @property
    def small(self) -> bool:
        """Whether only the last bits differ."""
        return math.isclose(self.computed, self.recorded, rel_tol=LAST_BITS, abs_tol=LAST_BITS)


class Recorded:
    """The numbers of a run as they were plotted, exactly; and where the robot was, in single precision."""

    def __init__(self) -> None:
        self._plots: dict[tuple[str, str], dict[int, float]] = {}
        self._truth: dict[int, Floats] = {}
        self._whole: dict[str, set[int]] = {}
        """By filter, the steps of which all numbers are there: at the end of a damaged file some may be missing."""
        self._at_end: list[str] = []
        """Filters that were on then."""

    def add(self, recording: Recording, branch: str, first: int, last: float) -> None:
        """Steps `first` to `last` of the run itself, or of a branch; the last one that is added is that of the end."""
        root = root_of(branch)
        for key in ESTIMATORS:
            self._add_plots(recording, root, key, first, last)
        for step, (points, *_) in recording.points(f"{root}world/truth/robot", "Points3D:positions").items():
            if first <= step <= last and len(points):
                self._truth[step] = points[0]
        self._at_end = filters_at_end(recording, branch)

    def _add_plots(self, recording: Recording, root: str, key: str, first: int, last: float) -> None:
        steps: list[set[int]] = []
        for metric in METRICS:
            entity = f"{root}plots/{metric.name}/{key}"
            if "step" not in recording.timelines(entity):
                continue
            found = zip(*map(np.ndarray.tolist, recording.series(entity)), strict=True)
            there = {step: value for step, value in found if first <= step <= last}
            if there:
                steps.append(set(there))
                if metric.name not in CLOCKS:
                    self._plots.setdefault((key, metric.name), {}).update(there)
        if steps:
            self._whole.setdefault(key, set()).update(set.intersection(*steps))

    @property
    def keys(self) -> list[str]:
        """Of the filters that were ever on."""
        return [key for key in ESTIMATORS if self._whole.get(key)]

    @property
    def span(self) -> tuple[int, int]:
        """The first step, and the last that all filters have that were on at the end."""
        first = min(min(self._whole[key]) for key in self.keys)
        at_end = [key for key in self.keys if key in self._at_end] or self.keys
        return first, min(max(self._whole[key]) for key in at_end)

    def departure(self, step: SessionStep) -> Departure | None:
        """What is not as it was recorded: the first difference that is not small, or else the first; None if all is the
        same."""
        found = [*self._moved(step)]
        for (key, name), plot in self._plots.items():
            if step.index in plot and key in step.filters:
                value = float(_METRICS[name].value(step.filters[key]))
                was = plot[step.index]
                if value != was and not (np.isnan(value) and np.isnan(was)):
                    what = f"{name.replace('_', ' ')} of {ESTIMATORS[key].title}"
                    found.append(Departure(step.index, what, was, value))
        return min(found, key=lambda departure: departure.small, default=None)

    def _moved(self, step: SessionStep) -> list[Departure]:
        was = self._truth.get(step.index)
        if was is None or step.truth is None:
            return []
        now = step.truth[:2].astype(np.float32)
        pairs = zip(("x", "y"), was.tolist(), now.tolist(), strict=True)
        return [Departure(step.index, f"{name} {ROBOT}", a, b) for name, a, b in pairs if a != b]


_METRICS = {metric.name: metric for metric in METRICS}


class Origin(NamedTuple):
    """A session that was recorded, from its very first step."""

    path: Path
    branch: str
    info: SessionInfo
    """As it begins."""
    changes: list[Change]
    """All that holds from which step on, in order; the first is for step 1."""
    recorded: Recorded
    versions: dict[str, str]
    """That it was made with."""
    places: list[str]
    """Files that it was made of."""
    damaged: bool
    judged: bool
    """Whether its paths were judged by relations, which no recording has."""

    @property
    def last(self) -> int:
        """The last step that was recorded."""
        return self.recorded.span[1]

    def at(self, step: int) -> Change:
        """What holds in a step."""
        return [change for change in self.changes if change.step <= step][-1]

    def apart(self, departure: Departure) -> str:
        """That this is another run than the one that was recorded, and why that may be."""
        return f"{self.path} cannot be run again: {_told(departure)}; perhaps {listed(self._reasons(departure))}"

    def differs(self, departure: Departure) -> str:
        """The same where it does no harm: of the last bits, or after the fork."""
        if departure.small:
            return f"only the last bits differ from those recorded, but they do: {_told(departure)}"
        return f"{_told(departure)}: both ways are told of as they are computed here"

    def _reasons(self, departure: Departure) -> list[str]:
        if departure.what.endswith(ROBOT) and self.places:
            return [self._changed()]
        here = texts.versions()
        other = [
            f"{name} {was} (here {here.get(name)})" for name, was in self.versions.items() if here.get(name) != was
        ]
        begins = self.recorded.span[0]
        return [
            *([f"something changed before step {begins}, where the recording begins"] if begins > 1 else []),
            *([f"it was made with {', '.join(other)}"] if other else []),
            *([self._changed()] if self.places else []),
            "it was made on another kind of processor",
        ]

    def _changed(self) -> str:
        return f"{' or '.join(self.places)} has changed since"


def _told(departure: Departure) -> str:
    numbers = [f"{value:.6g}" for value in (departure.computed, departure.recorded)]
    if numbers[0] == numbers[1]:
        numbers = [f"{value!r}" for value in (departure.computed, departure.recorded)]
    return (
        f"at step {departure.step} it departs from what was recorded, the {departure.what} is {numbers[0]} instead of "
        f"{numbers[1]}"
    )


def read_origin(path: Path, branch: str, place: Path | None) -> Origin:
    """The session that a recording, or one of its branches, was made by; `place` is where its world file or log is now.

    Raises `RecordingError`, `UsageError`, `SourceError`: each a sentence.
    """
    recording = Recording(path)
    branches = recording.branches()
    if branch and branch not in branches:
        has = f"it has {', '.join(branches)}" if branches else "it has none"
        raise UsageError(f"{path} has no branch {branch!r}; {has}")
    told = recording.params(branch)  # each run of a lesson has its own world and filters
    recorded, changes = _line(recording, branch)
    if not recorded.keys:
        raise UsageError(f"{path} has no step of any filter; nothing can be run again")
    source, places = _source(told, path, place)
    last = recorded.span[1]
    if last > len(source.steps):
        raise UsageError(
            f"{path} has {last} steps, and {source.name} {len(source.steps)}: it is not what was recorded any more"
        )
    mistake = told.get("mistake") or ""
    filters = session.estimators(recorded.keys, mistake)
    first = changes[0]
    steps = min(max(int(told["steps"]), last), len(source.steps))
    info = session.make_info(source, filters, first.params, first.noise, int(told["seed"]), steps, told["command"])
    info = info._replace(mistake=mistake)
    judged = f"{root_of(branch)}relations" in recording.entities
    return Origin(path, branch, info, changes, recorded, told["versions"], places, recording.damaged, judged)


def _line(recording: Recording, branch: str) -> tuple[Recorded, list[Change]]:
    """What was recorded of a branch and of those that it came from, and what held from which step on.

    A branch that begins at step 1 is a run of its own, such as those of a lesson: nothing was before it.
    """
    way = recording.way(branch)
    firsts = [1, *(_first_step(recording, name) for name in way[1:])]
    recorded, changes = Recorded(), []
    for name, first, end in zip(way, firsts, [*firsts[1:], np.inf], strict=True):
        recorded.add(recording, name, first, end - 1)
        changes += [change for change in changes_of(recording, name, first) if change.step < end]
    return recorded, changes


def _first_step(recording: Recording, branch: str) -> int:
    one = Recorded()
    one.add(recording, branch, 1, np.inf)
    if not one.keys:
        raise UsageError(f"{recording.path} has no step of the branch {branch!r}; nothing can be run again")
    return one.span[0]


def _source(told: Values, path: Path, place: Path | None) -> tuple[Source, list[str]]:
    """What the filters saw, and the files that it is made of."""
    options, own = _typed(told)
    name = options.source if options else ""
    if place is None and (not name or name in worlds()):
        if told["kind"] == "world" and told["world"] in worlds():
            return build(told["world"], **told["options"]), []
        raise UsageError(
            f"{path} does not say how {told['world']} was made: its command is {told['command']!r}; expected --source "
            "with the world file or log"
        )
    file = place or _there(name, path)
    parts = LogParts(*vars(options.log).values()) if options else LogParts()
    try:
        source = load(str(file), own, parts)
    except (OSError, SourceError, UsageError) as error:
        raise UsageError(
            f"{path} was made of {name or told['world']}, which cannot be read: {sentence(error)}"
        ) from None
    renamed = source.kind == "world" and source.name != told["world"]  # a log is called like its file
    if renamed or source.kind != told["kind"] or not np.allclose(source.start, told["start"], rtol=0.0, atol=1e-9):
        raise UsageError(f"{file} is not what {path} was made of: it is another world or log, or begins elsewhere")
    return source, [str(file), *(str(part) for part in [parts.reference] if part)]


def _typed(told: Values) -> tuple[SessionOptions | None, dict[str, str]]:
    """What the command line asked for that began the session; None if there was none."""
    try:
        return options_of_command(told["command"])
    except UsageError:
        return None, {}


def _there(name: str, path: Path) -> Path:
    """A file by the name that was typed, from here or beside the recording."""
    for found in (Path(name).expanduser(), path.parent / name):
        if found.exists():
            return found
    raise UsageError(f"{path} was made of {name}, which is not there; expected --source with its new place")
