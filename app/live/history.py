"""What a session under somebody's hands has been: branches of steps, and how to be at any of them again.

Every step follows from the seed, its number and its settings (`app.session`), so a past step is a snapshot and a few
steps more.  Snapshots share their maps, and are thinned out as they become many; being anywhere costs at most the steps
between two of them.
"""

from __future__ import annotations

import copy
import dataclasses
import hashlib
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from app import session
from app.events import Event, Watch
from app.live.settings import Settings, described
from app.session import State
from app.types import SessionInfo, SessionStep
from slam.estimators import ESTIMATORS
from slam.types import Particles

SNAPSHOTS = 96
"""Of a branch, at most."""

FEWEST = 8
"""However large they are."""

SNAPSHOT_BYTES = 160e6
"""Of all snapshots of all branches, about: fewer, with many particles, long ancestries, and scans to match with."""

MOST_BRANCHES = 32
"""Every one has a tree of its own in the recording."""

PINNED = 8
"""Snapshots at which filters were switched, that are kept: who is switched on catches up from there."""

PARTICLE_BYTES, FEATURE_BYTES = 400, 120
"""That a particle takes in a snapshot, and a feature of its map that changes all the time: those of a Dual FastSLAM
particle are frozen, and shared by all snapshots."""


class Snapshot(NamedTuple):
    """A session between two steps."""

    state: State
    watch: Watch


class Snapshots:
    """The states of a branch by number of steps; few enough, evenly spread."""

    def __init__(self) -> None:
        self._stride = 1
        self._kept: dict[int, Snapshot] = {}
        self._pinned: deque[int] = deque(maxlen=PINNED)

    def __len__(self) -> int:
        return len(self._kept)

    def keep(self, snapshot: Snapshot, always: bool = False, share: float = 1.0) -> None:
        """Keep it if it is its turn, or `always`; `share` is that of all memory for snapshots."""
        index = snapshot.state.done
        if not (always or index % self._stride == 0):
            return
        if always:
            self._pinned.append(index)
        self._kept[index] = snapshot._replace(watch=copy.deepcopy(snapshot.watch))
        filters = snapshot.state.filters.items()
        size = sum(_bytes(key, _particles(state)) + genealogy.nbytes for key, (state, genealogy) in filters)
        track = snapshot.state.track
        size += 0 if track is None else sum(scan.nbytes for scan in track.scans)
        most = max(FEWEST, min(SNAPSHOTS, int(share * SNAPSHOT_BYTES / max(size, 1.0))))
        begin = min(self._kept)
        while len(self._kept) > most + len(self._pinned):
            self._stride *= 2
            kept = {begin, *self._pinned}
            self._kept = {i: one for i, one in self._kept.items() if i % self._stride == 0 or i in kept}

    def before(self, index: int, keys: Iterable[str]) -> Snapshot | None:
        """The latest, up to `index` steps, that has these filters."""
        wanted = set(keys)
        for i in sorted(self._kept, reverse=True):
            if i <= index and wanted <= set(self._kept[i].state.filters):
                return self._kept[i]
        return None


def _bytes(key: str, particles: Particles) -> float:
    """That a snapshot of a filter takes, about."""
    own = 0 if key == "dfs" else int(particles.maps.counts.sum())
    return PARTICLE_BYTES * len(particles.s) + FEATURE_BYTES * own


def _particles(state: Any) -> Particles:
    return getattr(state, "particles", state)  # an `EkfState` has them inside


@dataclass
class Branch:
    """A way that the session took.  The first one begins at zero; every other one left its parent after `at` steps."""

    name: str
    """Empty for the first one."""
    parent: Branch | None
    at: int
    done: int
    """Steps that were made, counted from the very beginning."""
    changes: list[tuple[int, Settings]]
    """From which step on which settings hold; the first entry is for step at + 1."""
    snapshots: Snapshots = field(default_factory=Snapshots)
    digest: str = ""
    """Of all poses, covariances and weights since the branch began."""

    def settings(self, index: int) -> Settings:
        """Those of step `index`, a step of the past or the next one."""
        if index <= self.at and self.parent is not None:
            return self.parent.settings(index)
        where = bisect_right([first for first, _ in self.changes], index)
        return self.changes[max(where - 1, 0)][1]

    def owner(self, index: int) -> Branch:
        """The branch that made step `index`: this one, or one that it came from."""
        return self if index > self.at or self.parent is None else self.parent.owner(index)

    def snapshot(self, index: int, keys: Iterable[str]) -> Snapshot | None:
        """The latest, up to `index` steps, that has these filters, here or where this came from."""
        found = self.snapshots.before(index, keys)
        if found is not None or self.parent is None:
            return found
        return self.parent.snapshot(min(index, self.at), keys)


class Taken(NamedTuple):
    """One step, and what is worth telling about it."""

    step: SessionStep
    events: tuple[Event, ...]


class History:
    """The branches of a session, and where it stands."""

    def __init__(self, info: SessionInfo, settings: Settings, number: int = 0) -> None:
        self.info = info
        self.number = number
        """How many sessions there were before, in the same engine."""
        self.branches = [Branch("", None, 0, 0, [(1, settings)])]
        self.branch = self.branches[0]
        self.tell: Callable[[str], None] = lambda text: None
        """Told what takes long."""
        self._now = Snapshot(self._start(settings.filters), self._fresh_watch())
        self._of = self.branch
        """The branch that `_now` is of."""
        self.branch.snapshots.keep(self._now, always=True)

    @property
    def done(self) -> int:
        """Steps up to where the session stands."""
        return self._now.state.done

    @property
    def newest(self) -> bool:
        """Whether it stands at the end of its branch."""
        return self.done == self.branch.done

    def advance(self, settings: Settings) -> Taken:
        """One new step at the end of the branch."""
        if not self.newest:
            raise ValueError(f"step {self.done} of {self.branch.done}: only the end of a branch can grow")
        index, branch = self.done + 1, self.branch
        origin = branch.parent if self.done == 0 and branch.parent else branch
        before = origin.settings(max(self.done, 1))
        sentences = described(before, settings)
        if settings != branch.settings(index):
            if branch.changes[-1][0] == index:
                branch.changes.pop()
            branch.changes.append((index, settings))
            if self.done == 0:  # nothing has happened yet: as if it had begun with these
                self._now = self._now._replace(state=self._start(settings.filters))
                branch.snapshots.keep(self._now, always=True)
        state = self._with_filters(self._now.state, settings.filters)
        state, step = self._step(state, settings)
        taken = self._take(state, dataclasses.replace(step, changes=sentences))
        branch.done = index
        branch.digest = digest_of(branch.digest, step, settings.filters)
        branch.snapshots.keep(self._now, before.filters != settings.filters, 1.0 / len(self.branches))
        return taken

    def go(self, index: int, progress: Callable[[int], None] = lambda _: None) -> Taken | None:
        """Stand after `index` steps of the branch, or of what it came from; the step there, None for the beginning.

        `progress` may raise: then the session stands where it did.
        """
        index = min(max(index, 0), self.branch.done)
        if index == 0:
            keys = self.branch.settings(1).filters
            self._now, self._of = Snapshot(self._start(keys), self._fresh_watch()), self.branch
            return None
        keys = self.branch.settings(index).filters
        now = self._now
        if not (self._of is self.branch and self.done == index - 1 and set(keys) <= set(now.state.filters)):
            now = self._state(index - 1, keys, progress)
        settings = self.branch.settings(index)
        state, step = self._step(self._with_filters(now.state, settings.filters), settings)
        self._now, self._of = now, self.branch
        sentences = described(self.branch.settings(index - 1), settings) if index > 1 else ()
        return self._take(state, dataclasses.replace(step, changes=sentences))

    def fork(self, name: str, settings: Settings) -> Branch:
        """A branch that leaves where the session stands, and is where it goes on; ValueError if there are too many."""
        if len(self.branches) >= MOST_BRANCHES:
            raise ValueError(f"there are {MOST_BRANCHES} branches already; reset the session to begin again")
        names = {branch.name for branch in self.branches}
        unique, number = name, 2
        while unique in names:
            unique, number = f"{name}-{number}", number + 1
        owner = self.branch.owner(self.done)
        made = Branch(unique, owner, self.done, self.done, [(self.done + 1, settings)])
        self.branches.append(made)
        self.branch = made
        if self.done == 0:
            self._now = self._now._replace(state=self._start(settings.filters))
        self._of = made
        made.snapshots.keep(self._now, always=True)
        return made

    def to_branch(self, name: str) -> Taken | None:
        """Stand at the end of the branch of that name; ValueError if there is none."""
        found = next((branch for branch in self.branches if branch.name == name), None)
        if found is None:
            raise ValueError(f"no branch {name!r}")
        self.branch = found
        return self.go(found.done)

    # ------------------------------------------------------------------------------------------------------------

    def _info(self, settings: Settings) -> SessionInfo:
        filters = session.estimators(settings.filters, self.info.mistake)
        return self.info._replace(filters=filters, params=settings.params, noise=settings.noise)

    def _start(self, keys: Iterable[str]) -> State:
        first = self.branch.settings(1)
        return session.start(self._info(dataclasses.replace(first, filters=tuple(keys))))

    def _fresh_watch(self) -> Watch:
        titles = {key: estimator.title for key, estimator in ESTIMATORS.items()}
        return Watch(titles, self.info.source.has_clock)

    def _step(self, state: State, settings: Settings) -> tuple[State, SessionStep]:
        return session.advance(self._info(settings), state, settings.params)

    def _take(self, state: State, step: SessionStep) -> Taken:
        self._now = self._now._replace(state=state)
        return Taken(step, tuple(self._now.watch.step(step)))

    def _with_filters(self, state: State, keys: tuple[str, ...]) -> State:
        """With these filters and no others; one that was off catches up, as if it had never been."""
        filters = {key: state.filters[key] for key in keys if key in state.filters}
        for key in keys:
            if key not in filters:
                self.tell(f"{ESTIMATORS[key].title} catches up with {state.done} steps ...")
                filters[key] = self._state(state.done, (key,)).state.filters[key]
        return state._replace(filters={key: filters[key] for key in keys})

    def _state(self, index: int, keys: Iterable[str], progress: Callable[[int], None] = lambda _: None) -> Snapshot:
        """After `index` steps of the branch, with these filters, as if they had always been on."""
        keys = tuple(keys)
        found = self.branch.snapshot(index, keys)
        if found is None and len(keys) > 1:  # never all of them at once
            parts = [self._state(index, (key,), progress) for key in keys]
            filters = {key: part.state.filters[key] for key, part in zip(keys, parts, strict=True)}
            return parts[0]._replace(state=parts[0].state._replace(filters=filters))
        state = found.state if found else self._start(keys)
        watch = copy.deepcopy(found.watch) if found else self._fresh_watch()
        state = state._replace(filters={key: state.filters[key] for key in keys})
        for i in range(state.done + 1, index + 1):
            settings = dataclasses.replace(self.branch.settings(i), filters=keys)
            state, step = self._step(state, settings)
            watch.step(step)
            progress(i)
        return Snapshot(state, watch)


def digest_of(before: str, step: SessionStep, keys: Iterable[str]) -> str:
    """A number that tells whether two runs are the same, bit for bit: of all steps up to this one, by these filters."""
    digest = hashlib.blake2b(before.encode(), digest_size=16)
    for key in keys:
        digest.update(key.encode())
        weighted = step.filters[key].trace.weighted
        for array in (weighted.s, weighted.P, weighted.log_w):
            digest.update(array.tobytes())
    return digest.hexdigest()
