"""The thread that runs a session under somebody's hands."""

from __future__ import annotations

import dataclasses
import queue
import shlex
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from time import monotonic
from typing import Any, NamedTuple, Protocol

from app import session
from app.compiling import CompileClock
from app.errors import sentence
from app.events import Event
from app.live.history import History, Taken
from app.live.settings import Desk, Settings, described, first_settings
from app.types import SessionInfo, SessionStep, heaviest_descendant
from scenarios.types import Source

TOLD = 200
"""Events that the page can show."""

COMPILING = "compiling the filters, for this and all later runs: half a minute or so ..."

RECENT = 32
"""Steps within which somebody has clicked on what was shown."""

RATE_OVER = 2.0
"""[s] over which the number of steps in a second is taken."""

FASTEST = 1000.0
"""[1/s] Nobody sees more steps in a second, and slower ones are held back for as long as they have to."""


class Begun(NamedTuple):
    """A session has begun: the first one, or another after a reset."""

    info: SessionInfo
    settings: Settings
    number: int
    """How many there have been before."""


class Forked(NamedTuple):
    """A branch has begun."""

    name: str
    parent: str
    at: int
    """After how many steps."""
    info: SessionInfo
    settings: Settings


class Stepped(NamedTuple):
    """A branch has a new step."""

    branch: str
    step: SessionStep
    settings: Settings
    events: tuple[Event, ...]


class Listener(Protocol):
    """Watches a session; called from its thread, which must not be made to wait."""

    def begun(self, begun: Begun) -> None:
        """A session has begun."""

    def forked(self, forked: Forked) -> None:
        """It goes on as another branch."""

    def stepped(self, stepped: Stepped) -> None:
        """It has made a new step."""

    def closed(self) -> None:
        """It is over."""


class Status(NamedTuple):
    """How things stand; a value that any thread may read."""

    playing: bool
    step: int
    """Where the session stands, which may be in the past."""
    newest: int
    """The last step of its branch."""
    total: int
    """Steps that the world or log has."""
    branch: str
    branches: tuple[tuple[str, str, int, int], ...]
    """Name, parent, the step after which it left that, its last step."""
    settings: Settings
    """That hold from the next step on."""
    taken: Taken | None
    """The step where it stands."""
    told: tuple[tuple[int, str, Event], ...]
    """Step, branch and event, the latest last; those of every moment (DEBUG) are not among them."""
    rate: float
    """[1/s] steps made, lately."""
    message: str
    """What the person is to know: why it does not go on, what it waits for."""
    info: SessionInfo
    number: int
    """Which session since the beginning."""
    changed: int
    """Grows with every change of anything here."""


Command = Callable[[], None]


class Abandoned(Exception):
    """Something that took long was given up."""


class Engine:
    """A session in a thread of its own.

    All methods may be called from any thread.  They return at once, and what they ask for happens between two steps.
    """

    def __init__(self, info: SessionInfo, listeners: Sequence[Listener] = (), playing: bool = False) -> None:
        keys = tuple(estimator.key for estimator in info.filters)
        settings = first_settings(info.source, keys, info.params, info.noise)
        self.desk = Desk(settings)
        self._listeners = list(listeners)
        self._commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="engine", daemon=True)
        self.before_reset: Callable[[History], None] = lambda history: None
        """Called in the thread of the session while it still is what it was."""
        self._closing = self._leaving = False
        self._wanted: int | None = None
        self._begun = False
        self._playing = playing
        self._due = 0
        """Steps to be made although it is paused."""
        self._until: frozenset[str] = frozenset()
        self._period = 0.0
        self._next_at = 0.0
        self._message = ""
        self._told: deque[tuple[int, str, Event]] = deque(maxlen=TOLD)
        self._times: deque[float] = deque(maxlen=512)
        self._taken: Taken | None = None
        self._pick: tuple[str, int] | None = None
        self._recent: deque[SessionStep] = deque(maxlen=RECENT)
        """The last steps of the branch, for picks that come late."""
        self._number = 0
        self._history = History(info, settings)
        self._history.tell = self._tell
        self._changed = 0
        self._status = self._read_status()
        self._status_changed = threading.Condition()

    # --- What one can ask for ---------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin; call it once."""
        self._thread.start()

    def put(self, changes: Mapping[str, Any]) -> Settings:
        """Settings by dotted name, from the next step on (`app.live.settings.changed`)."""
        settings = self.desk.change(changes)
        self._commands.put(lambda: None)  # wakes it, so that the status tells
        return settings

    def play(self, until: Sequence[str] = ()) -> None:
        """Go on and on; or until an event of one of these kinds (`Event.kind`)."""
        self._commands.put(lambda: self._play(until))

    def pause(self) -> None:
        """Stop after the step that is being made."""
        self._commands.put(self._pause)

    def step(self, count: int = 1) -> None:
        """Make so many steps."""
        self._commands.put(lambda: self._step(count))

    def speed(self, per_second: float | None) -> None:
        """Steps in a second; None for as many as there can be."""
        self._commands.put(lambda: self._speed(per_second))

    def go(self, index: int) -> None:
        """Pause, and stand after `index` steps; of several that wait only the last one counts."""
        self._wanted = int(index)
        self._commands.put(self._go_wanted)

    def go_newest(self) -> None:
        """Stand at the end of the branch again."""
        self.go(sys.maxsize)

    def fork(self, name: str = "") -> None:
        """From where it stands go on as a branch, with the settings of the desk; its name tells what is different."""
        self._commands.put(lambda: self._fork(name))

    def to_branch(self, name: str) -> None:
        """Stand at the end of another branch."""
        self._commands.put(lambda: self._to_branch(name))

    def pick(self, key: str, particle: int, step: int) -> None:
        """Look at a particle of `Trace.weighted` of a step, and at its descendants: the recording shows it."""
        self._commands.put(lambda: self._set_pick(key, particle, step))

    def unpick(self) -> None:
        """Look at none."""
        self._commands.put(lambda: self._set_pick("", -1, 0))

    def reset(self, seed: int | None = None, source: Source | None = None, mistake: str | None = None) -> None:
        """Begin again: with the settings of the desk, or in another world with its own; with a mistake in the filters,
        an empty one for none, or with that of before."""
        self._commands.put(lambda: self._reset(seed, source, mistake))

    def begin(self, info: SessionInfo) -> None:
        """Begin another session, with its own filters, parameters and seed."""
        self._commands.put(lambda: self._reset(None, None, None, info))

    def replace(self, old: Listener, new: Listener) -> None:
        """One listener for another, before a reset and from there: the old one's session is over."""
        self._remove(old)
        self._listeners.append(new)

    def call(self, what: Callable[[History], None]) -> None:
        """Between two steps, in the thread of the session."""
        self._commands.put(lambda: what(self._history))

    def add(self, listener: Listener) -> None:
        """From now on it watches, too: it is told that the session began, and of the steps to come."""
        self._commands.put(lambda: self._add(listener))

    def remove(self, listener: Listener) -> None:
        """It is told that the session is over, and no more."""
        self._commands.put(lambda: self._remove(listener))

    def close(self, patience: float | None = None) -> None:
        """End the session and wait until everything is done."""
        self._leaving = True
        self._commands.put(self._close)
        if self._thread.is_alive():
            self._thread.join(patience)

    @property
    def alive(self) -> bool:
        """Whether commands are still carried out."""
        return self._thread.is_alive()

    @property
    def status(self) -> Status:
        """How things stand."""
        return self._status

    def wait(self, condition: Callable[[Status], bool], patience: float = 60.0) -> Status:
        """Until the status is as wanted; `TimeoutError` if that takes too long."""
        with self._status_changed:
            if not self._status_changed.wait_for(lambda: condition(self._status), patience):
                raise TimeoutError(f"not within {patience:g} s: {self._status.message or self._status[:5]}")
            return self._status

    # --- The thread -------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        with CompileClock(self._compiling):
            self._begin()
            while not self._closing:
                self._obey()
                if self._closing or not self._may_step():
                    continue
                try:
                    self._make_step()
                except Exception as error:  # such as numbers beyond what can be computed: the page must live on
                    self._halt(f"step {self._history.done + 1} failed: {sentence(error)}")
                self._publish()
            self._obey_all()
        for listener in list(self._listeners):
            self._told_safely(listener, lambda one: one.closed())
        self._publish()

    def _compiling(self, now: bool) -> None:
        """Some kernel of a filter is being compiled, which takes seconds, once."""
        if threading.current_thread() is self._thread:
            self._message = COMPILING if now else ""
            self._publish()

    def _obey_all(self) -> None:
        """What was asked for before the end."""
        while not self._commands.empty():
            self._obey_one(self._commands.get())

    def _obey_one(self, command: Command) -> None:
        try:
            command()
        except Exception as error:
            self._halt(sentence(error))
        self._publish()

    def _obey(self) -> None:
        """Carry out commands; wait for some where there is nothing else to do, or the next step is not due."""
        wait = self._wait()
        while True:
            try:
                command = self._commands.get(timeout=wait) if wait != 0.0 else self._commands.get_nowait()
            except queue.Empty:
                return
            self._obey_one(command)
            wait = 0.0

    def _wait(self) -> float | None:
        """[s] that commands may take their time; None for ever."""
        if not (self._playing or self._due):
            return None
        return max(self._next_at - monotonic(), 0.0)

    def _may_step(self) -> bool:
        if not (self._playing or self._due) or monotonic() < self._next_at:
            return False
        total = len(self._history.info.source.steps[: self._history.info.steps])
        if self._history.newest and self._history.done >= total:
            self._halt(f"{self._history.info.source.name} ends here; reset it, or go back and branch")
            self._publish()
            return False
        return True

    def _make_step(self) -> None:
        self._next_at = max(self._next_at + self._period, monotonic() - self._period) if self._period else 0.0
        settings, history = self.desk.read(), self._history
        self._message = ""
        if not history.newest and settings != history.branch.settings(history.done + 1):
            self._fork("")
        if history.newest:
            taken = history.advance(settings)
            self._follow(taken.step)
            self._taken = taken._replace(step=dataclasses.replace(taken.step, picked=self._pick))
            self._recent.append(self._taken.step)
            self._times.append(monotonic())
            stepped = Stepped(history.branch.name, self._taken.step, settings, self._taken.events)
            for listener in self._listeners:
                self._told_safely(listener, lambda one: one.stepped(stepped))
            self._told += [
                (history.done, history.branch.name, event) for event in self._taken.events if event.level != "DEBUG"
            ]
        else:  # through what has been
            self._taken = history.go(history.done + 1)
            self._stands()
        self._due = max(self._due - 1, 0)
        kinds = {event.kind for event in self._taken.events} if self._taken else set()
        if self._until & kinds:
            event = next(event for event in self._taken.events if event.kind in self._until)  # type: ignore[union-attr]
            self._halt(f"step {history.done}: {event.text}")

    def _set_pick(self, key: str, particle: int, step: int) -> None:
        """Of a step that may be a few steps ago by now."""
        since = [recent for recent in self._recent if recent.index >= step]
        self._pick = None
        if key and since and since[0].index == step and key in since[0].filters:
            self._pick = (key, particle)
            for before, after in pairwise(since):
                self._pick = _followed(self._pick, before, after)

    def _follow(self, step: SessionStep) -> None:
        if self._pick is not None and self._recent:
            self._pick = _followed(self._pick, self._recent[-1], step)

    def _told_safely(self, listener: Listener, tell: Callable[[Listener], None]) -> None:
        """A listener that fails is told no more; the session goes on."""
        try:
            tell(listener)
        except Exception as error:
            if listener in self._listeners:
                self._listeners.remove(listener)
            self._message = sentence(error)

    def _begin(self) -> None:
        self._begun = True
        history = self._history
        begun = Begun(history.info, history.branch.settings(1), self._number)
        for listener in list(self._listeners):
            self._told_safely(listener, lambda one: one.begun(begun))
        self._publish()

    # --- Commands, in the thread ------------------------------------------------------------------------------------

    def _play(self, until: Sequence[str]) -> None:
        self._playing, self._due, self._until = True, 0, frozenset(until)
        self._next_at, self._message = monotonic(), ""

    def _pause(self) -> None:
        self._playing, self._due, self._until = False, 0, frozenset()

    def _halt(self, message: str) -> None:
        self._pause()
        self._message = message

    def _step(self, count: int) -> None:
        self._playing, self._until = False, frozenset()
        self._due, self._next_at = self._due + min(max(int(count), 1), 10_000), monotonic()

    def _speed(self, per_second: float | None) -> None:
        self._period = 0.0 if per_second is None else 1.0 / min(max(float(per_second), 0.01), FASTEST)
        self._next_at = monotonic()

    def _go_wanted(self) -> None:
        index, self._wanted = self._wanted, None
        if index is None:
            return
        self._pause()
        self._tell(f"going to step {min(max(index, 0), self._history.branch.done)} ...")
        try:
            self._taken = self._history.go(index, self._hurry)
        except Abandoned:
            return
        self._stands()
        self._message = ""
        self.desk.put(self._history.branch.settings(self._history.done + 1))

    def _fork(self, name: str) -> None:
        history, settings = self._history, self.desk.read()
        parent, before = history.branch.name, history.branch.settings(history.done + 1)
        made = history.fork(name or named_after(history.done, before, settings), settings)
        forked = Forked(made.name, parent, made.at, history.info, settings)
        for listener in list(self._listeners):
            self._told_safely(listener, lambda one: one.forked(forked))

    def _tell(self, text: str) -> None:
        """What takes long, before it does."""
        self._message = text
        self._publish()

    def _hurry(self, index: int) -> None:
        """Give up what takes long, if somebody wants something else by now."""
        if self._wanted is not None or self._leaving:
            raise Abandoned

    def _stands(self) -> None:
        """Elsewhere than a step later: the particles are others."""
        self._pick = None
        self._recent.clear()
        if self._taken is not None:
            self._recent.append(self._taken.step)

    def _to_branch(self, name: str) -> None:
        self._pause()
        self._taken = self._history.to_branch(name)
        self._stands()
        self.desk.put(self._history.branch.settings(self._history.done + 1))

    def _reset(
        self, seed: int | None, source: Source | None, mistake: str | None, other: SessionInfo | None = None
    ) -> None:
        self._pause()
        self.before_reset(self._history)
        info, settings = self._history.info, self.desk.read()
        if other is not None:
            keys = tuple(estimator.key for estimator in other.filters)
            info, settings = other, first_settings(other.source, keys, other.params, other.noise)
        mistake = info.mistake if mistake is None else mistake
        if source is not None:
            settings = first_settings(source, settings.filters, source.params(), source.noise)
            command = shlex.join(["dualslam", "live", source.name])
            filters = session.estimators(f.key for f in info.filters)  # mistakes are not taken along
            info = session.make_info(source, filters, command=command, seed=info.seed)
        if seed is not None:
            info = info._replace(seed=int(seed))
        filters = session.estimators(settings.filters, mistake)
        info = info._replace(filters=filters, params=settings.params, noise=settings.noise, mistake=mistake)
        self.desk.put(settings)
        self._number += 1
        self._history = History(info, settings, self._number)
        self._history.tell = self._tell
        self._taken, self._message = None, ""
        self._stands()
        self._told.clear()
        self._times.clear()
        self._begin()

    def _add(self, listener: Listener) -> None:
        history = self._history
        self._listeners.append(listener)
        if not self._begun:
            return  # it will be told with the others
        begun = Begun(history.info, history.branch.settings(history.done + 1), self._number)
        self._told_safely(listener, lambda one: one.begun(begun))

    def _remove(self, listener: Listener) -> None:
        if listener in self._listeners:
            self._listeners.remove(listener)
            listener.closed()

    def _close(self) -> None:
        self._pause()
        self._closing = True

    def _publish(self) -> None:
        self._changed += 1
        with self._status_changed:
            self._status = self._read_status()
            self._status_changed.notify_all()

    def _read_status(self) -> Status:
        history, now = self._history, monotonic()
        recent = [time for time in self._times if now - time <= RATE_OVER]
        branches = [(b.name, b.parent.name if b.parent else "", b.at, b.done) for b in history.branches]
        return Status(
            playing=self._playing,
            step=history.done,
            newest=history.branch.done,
            total=history.info.steps,
            branch=history.branch.name,
            branches=tuple(branches),
            settings=self.desk.read(),
            taken=self._taken,
            told=tuple(self._told),
            rate=len(recent) / RATE_OVER if len(recent) > 1 else 0.0,
            message=self._message,
            info=history.info,
            number=self._number,
            changed=self._changed,
        )


def _followed(pick: tuple[str, int] | None, before: SessionStep, after: SessionStep) -> tuple[str, int] | None:
    """The pick one step later; None if it died, or its filter is off."""
    if pick is None or before.index + 1 != after.index or not {pick[0]} <= before.filters.keys() & after.filters.keys():
        return None
    key, particle = pick
    found = heaviest_descendant(before.filters[key], after.filters[key], particle)
    return None if found is None else (key, found)


def named_after(at: int, before: Settings, after: Settings) -> str:
    """The name of a branch: the step that it leaves after, and what is different from there on."""
    different = [word.replace(": ", " ").split(" -> ") for word in described(before, after)]
    words = [f"{old.split(' ')[0].rpartition('.')[2]}-{new}" for old, new in different]
    if not words:
        return f"{at}-again"
    name = "-".join([str(at), *words[:2], *(["more"] if len(words) > 2 else [])])
    return "".join(c if c.isalnum() or c in "-." else "-" for c in name)[:60]
