"""The diagnosis of a session that runs, at any step of any branch."""

from __future__ import annotations

import threading
from typing import NamedTuple

from app.diagnosis.collecting import Collector
from app.diagnosis.diagnose import diagnose
from app.diagnosis.words import markdown
from app.live.engine import Begun, Forked, Stepped
from app.pace import Pace

DUTY = 0.05
"""Share of the time that it may take while steps are made."""

NOTHING = "*Nothing to tell before the first step.*"


class Told(NamedTuple):
    """What can be said up to a step."""

    branch: str
    step: int
    text: str
    """Markdown."""
    steps: tuple[int, ...]
    """Those that it names, in order."""


class Diagnoses:
    """A `Listener`: keeps the evidence of every branch.  Whoever wants to know asks from another thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._branches: dict[str, Collector] = {}
        self._pace = Pace(DUTY)
        self._told = Told("", -1, NOTHING, ())

    def begun(self, begun: Begun) -> None:
        """A session has begun."""
        collector = Collector()
        collector.begin(begun.info)
        with self._lock:
            self._branches = {"": collector}
            self._told = Told("", -1, NOTHING, ())

    def forked(self, forked: Forked) -> None:
        """A branch has in common with its parent what was before it."""
        collector = Collector()
        with self._lock:
            collector.start(forked.info, self._branches.get(forked.parent), forked.at)
            self._branches[forked.name] = collector

    def stepped(self, stepped: Stepped) -> None:
        """A branch has a new step."""
        with self._lock:
            if stepped.branch in self._branches:
                self._branches[stepped.branch].step(stepped.step)

    def closed(self) -> None:
        """Nothing to do."""

    def of(self, branch: str, until: int, now: bool = True) -> Told:
        """What can be said of a branch up to a step.  While steps are made (not `now`) it may be some seconds old, but
        never of another branch, of a later step or of the session before."""
        with self._lock:
            told, collector = self._told, self._branches.get(branch)
            recent = 0 <= told.step < until and not (now or self._pace.due)
            if told.branch == branch and (told.step == until or recent):
                return told
            cases = [] if collector is None else collector.cases(until)
        with self._pace.kept():
            found = [diagnose(case) for case in cases]
            steps = {step for one in found for finding in one.findings for step in finding.steps}
            text = f"*Up to step {until}.*\n\n{markdown(found)}" if found else NOTHING
        told = Told(branch, until, text, tuple(sorted(steps)))
        with self._lock:
            if self._branches.get(branch) is not collector:  # another session has begun
                return Told(branch, -1, NOTHING, ())
            self._told = told
            return told
