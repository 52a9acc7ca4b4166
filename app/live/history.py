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

SNAPSHOT_BYTES = 120e6
"""Of all snapshots of a branch, about: with many particles and large maps there are fewer of them."""

PARTICLE_BYTES, FEATURE_BYTES = 200, 120
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

    def __len__(self) -> int:
        return len(self._kept)

    def keep(self, snapshot: Snapshot, first: bool = False) -> None:
        """Keep it if it is its turn; the first one always."""
        index = snapshot.state.done
        if not (first or index % self._stride == 0):
            return
        self._kept[index] = snapshot._replace(watch=copy.deepcopy(snapshot.watch))
        size = sum(_bytes(key, _particles(state)) for key, (state, _) in snapshot.state.filters.items())
        most = max(FEWEST, min(SNAPSHOTS, int(SNAPSHOT_BYTES / max(size, 1.0))))
        begin = min(self._kept)
        while len(self._kept) > most:
            self._stride *= 2
            self._kept = {i: kept for i, kept in self._kept.items() if i % self._stride == 0 or i == begin}

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

    def __init__(self, info: SessionInfo, settings: Settings) -> None:
        self.info = info
        self.branches = [Branch("", None, 0, 0, [(1, settings)])]
        self.branch = self.branches[0]
        self._now = Snapshot(self._start(settings.filters), self._fresh_watch())
        self.branch.snapshots.keep(self._now, first=True)

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
        before = branch.settings(max(self.done, 1))
        sentences = described(before, settings)
        if settings != branch.settings(index):
            if branch.changes[-1][0] == index:
                branch.changes.pop()
            branch.changes.append((index, settings))
            if self.done == 0:  # nothing has happened yet: as if it had begun with these
                self._now = self._now._replace(state=self._start(settings.filters))
                branch.snapshots.keep(self._now, first=True)
        state = self._with_filters(self._now.state, settings.filters)
        state, step = self._step(state, settings)
        taken = self._take(state, dataclasses.replace(step, changes=sentences))
        branch.done = index
        branch.digest = digest_of(branch.digest, step, settings.filters)
        branch.snapshots.keep(self._now)
        return taken

    def go(self, index: int, progress: Callable[[int], None] = lambda _: None) -> Taken | None:
        """Stand after `index` steps of the branch, or of what it came from; the step there, None for the beginning."""
        index = min(max(index, 0), self.branch.done)
        if index == 0:
            keys = self.branch.settings(1).filters
            self._now = Snapshot(self._start(keys), self._fresh_watch())
            return None
        keys = self.branch.settings(index).filters
        if not (self.done == index - 1 and set(keys) <= set(self._now.state.filters)):
            state = self._state(index - 1, keys, progress)
            found = self.branch.snapshot(index - 1, ())
            watch = copy.deepcopy(found.watch) if found and found.state.done == index - 1 else self._fresh_watch()
            self._now = Snapshot(state, watch)
        settings = self.branch.settings(index)
        state, step = self._step(self._with_filters(self._now.state, settings.filters), settings)
        sentences = described(self.branch.settings(index - 1), settings) if index > 1 else ()
        return self._take(state, dataclasses.replace(step, changes=sentences))

    def fork(self, name: str, settings: Settings) -> Branch:
        """A branch that leaves where the session stands, and is where it goes on."""
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
        made.snapshots.keep(self._now, first=True)
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
        filters = tuple(ESTIMATORS[key] for key in settings.filters)
        return self.info._replace(filters=filters, params=settings.params, noise=settings.noise)

    def _start(self, keys: Iterable[str]) -> State:
        first = self.branch.settings(1)
        return session.start(self._info(dataclasses.replace(first, filters=tuple(keys))))

    def _fresh_watch(self) -> Watch:
        return Watch({key: estimator.title for key, estimator in ESTIMATORS.items()})

    def _step(self, state: State, settings: Settings) -> tuple[State, SessionStep]:
        return session.advance(self._info(settings), state, settings.params)

    def _take(self, state: State, step: SessionStep) -> Taken:
        self._now = self._now._replace(state=state)
        return Taken(step, tuple(self._now.watch.step(step)))

    def _with_filters(self, state: State, keys: tuple[str, ...]) -> State:
        """With these filters and no others; one that was off catches up, as if it had never been."""
        missing = [key for key in keys if key not in state.filters]
        filters = {key: state.filters[key] for key in keys if key in state.filters}
        for key in missing:
            filters[key] = self._state(state.done, (key,)).filters[key]
        return state._replace(filters=filters)

    def _state(self, index: int, keys: Iterable[str], progress: Callable[[int], None] = lambda _: None) -> State:
        """After `index` steps of the branch, with these filters, as if they had always been on."""
        keys = tuple(keys)
        found = self.branch.snapshot(index, keys)
        if found is None and len(keys) > 1:  # never all of them at once
            parts = [self._state(index, (key,), progress) for key in keys]
            return parts[0]._replace(filters={key: part.filters[key] for key, part in zip(keys, parts, strict=True)})
        state = found.state if found else self._start(keys)
        state = state._replace(filters={key: state.filters[key] for key in keys})
        for i in range(state.done + 1, index + 1):
            settings = dataclasses.replace(self.branch.settings(i), filters=keys)
            state, _ = self._step(state, settings)
            progress(i)
        return state


def digest_of(before: str, step: SessionStep, keys: Iterable[str]) -> str:
    """A number that tells whether two runs are the same, bit for bit: of all steps up to this one, by these filters."""
    digest = hashlib.blake2b(before.encode(), digest_size=16)
    for key in keys:
        digest.update(key.encode())
        weighted = step.filters[key].trace.weighted
        for array in (weighted.s, weighted.P, weighted.log_w):
            digest.update(array.tobytes())
    return digest.hexdigest()
