"""`dualslam live LOG --relations FILE`: where paths break relations, at any step of any branch."""

from __future__ import annotations

from app.live.engine import Begun, Forked, Stepped
from app.relations import Breaks, PathErrors
from app.types import SessionInfo, SessionStep
from scenarios.logs.relations import Relations
from scenarios.types import Source


class Judge:
    """A `Listener` that keeps what it takes to judge a session on the log that the relations belong to.

    It must be told of every step.
    """

    def __init__(self, relations: Relations, source: Source) -> None:
        self._relations = relations
        self._source = source
        self._sessions: dict[int, dict[str, PathErrors]] = {}
        """The branches of the last session, and of that before: a file may still be busy with it."""
        self._branches: dict[str, PathErrors] = {}

    def knows(self, info: SessionInfo) -> bool:
        """Whether the relations belong to what the session is about."""
        return info.source is self._source

    def begun(self, begun: Begun) -> None:
        """A session has begun, perhaps in another world."""
        errors = PathErrors(self._relations)
        errors.begin(begun.info)
        self._branches = {"": errors} if self.knows(begun.info) else {}
        kept = {number: former for number, former in self._sessions.items() if number == begun.number - 1}
        self._sessions = {**kept, begun.number: self._branches}

    def forked(self, forked: Forked) -> None:
        """What is before a branch is its parent's."""
        if forked.parent in self._branches:
            self._branches[forked.name] = self._branches[forked.parent].forked(forked.at)

    def stepped(self, stepped: Stepped) -> None:
        """One step more."""
        if stepped.branch in self._branches:
            self._branches[stepped.branch].step(stepped.step)

    def closed(self) -> None:
        """Nothing is left to do."""

    def breaks(self, number: int, branch: str, step: SessionStep) -> dict[str, Breaks]:
        """Of odometry, of matching alone and of each filter, as they were after a step of a branch of session `number`;
        empty where nobody can tell."""
        errors = self._sessions.get(number, {}).get(branch)
        return {} if errors is None else errors.breaks(step)
