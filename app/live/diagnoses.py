"""The diagnosis of a session that runs, at any step of any branch."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import NamedTuple, Protocol

from app.diagnosis.collecting import Collector
from app.diagnosis.diagnose import diagnose
from app.diagnosis.words import markdown
from app.errors import sentence
from app.live.engine import Begun, Forked, Stepped
from app.pace import Pace

DUTY = 0.05
"""Share of the time that it may take while steps are made."""

SOON = 0.15
"""[s] that whoever wants to show it waits for it, so that a page does not flicker; of a thousand steps it is enough."""

NOTHING = "*Nothing to tell before the first step.*"
AWAITED = "*The diagnosis of this step is being made ...*"


class Place(NamedTuple):
    """A step that a session has made, of all sessions and branches."""

    number: int
    """How many sessions there were before."""
    branch: str
    step: int


class Told(NamedTuple):
    """What can be said up to a step."""

    of: Place
    text: str
    """Markdown."""
    steps: tuple[int, ...]
    """Those that it names, in order."""

    def holds(self, place: Place, older: bool) -> bool:
        """Whether it is of a place; or, if `older` is enough, of an earlier step of the same branch."""
        of = self.of
        return of == place or (older and of[:2] == place[:2] and 0 < of.step < place.step)


class Diagnoses:
    """A `Listener`: keeps the evidence of every branch.  Whoever wants to know asks from another thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number = -1
        self._branches: dict[str, Collector] = {}

    def begun(self, begun: Begun) -> None:
        """A session has begun."""
        collector = Collector()
        collector.begin(begun.info)
        with self._lock:
            self._number, self._branches = begun.number, {"": collector}

    def forked(self, forked: Forked) -> None:
        """A branch has in common with its parent what was before it."""
        with self._lock:
            if forked.parent in self._branches:
                self._branches[forked.name] = self._branches[forked.parent].part(forked.at)

    def stepped(self, stepped: Stepped) -> None:
        """A branch has a new step."""
        with self._lock:
            if stepped.branch in self._branches:
                self._branches[stepped.branch].step(stepped.step)

    def closed(self) -> None:
        """Nothing to do."""

    def of(self, place: Place) -> Told | None:
        """What can be said up to a step; None of another session than the present one."""
        with self._lock:
            collector = self._branches.get(place.branch) if place.number == self._number else None
            if collector is None:
                return None
            collected = collector.part(place.step)
        found = [diagnose(case) for case in collected.cases()]
        steps = {step for one in found for finding in one.findings for step in finding.steps}
        text = f"*Up to step {place.step}.*\n\n{markdown(found)}" if found else NOTHING
        return Told(place, text, tuple(sorted(steps)))


class Source(Protocol):
    """What makes diagnoses."""

    def of(self, place: Place) -> Told | None:
        """What can be said up to a step; it may take its time."""
        ...


class Teller:
    """Has diagnoses made in a thread of its own, the last that was wanted first and no other."""

    def __init__(self, diagnoses: Source, ready: Callable[[], None] = lambda: None) -> None:
        """`ready` is called when one is there that somebody has asked for."""
        self._diagnoses = diagnoses
        self._ready = ready
        self._pace = Pace(DUTY)
        self._changed = threading.Condition()
        self._told = Told(Place(-1, "", 0), NOTHING, ())
        self._wanted: Place | None = None
        self._asked: Place | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="diagnoses", daemon=True)
        self._thread.start()

    def told(self, place: Place, playing: bool) -> Told:
        """What can be said of the place where a session stands, or that it is being made.

        While steps are made (`playing`) it may be of some steps ago; never of another branch, a later step or another
        session.
        """
        with self._changed:
            enough = self._told.holds(place, older=playing)
            if self._told.of != place and (not enough or self._pace.due):
                first, self._asked = self._asked != place, place
                self._wanted = place
                self._changed.notify_all()
                if first and not enough:
                    self._changed.wait_for(lambda: self._told.of == place or self._closed, SOON)
            return self._told if self._told.holds(place, older=playing) else Told(place, AWAITED, ())

    def close(self) -> None:
        """Make no more of them."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(5.0)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._wanted is not None)
                place, self._wanted = self._wanted, None
                if self._closed or place is None:
                    return
            with self._pace.kept():
                told = self._made(place)
            if told is None:
                continue
            with self._changed:
                self._told = told
                self._changed.notify_all()
            self._ready()

    def _made(self, place: Place) -> Told | None:
        try:
            return self._diagnoses.of(place)
        except Exception as error:  # the next step may have one again
            return Told(place, f"*No diagnosis of this step: {sentence(error)}*", ())
