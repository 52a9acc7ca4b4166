"""Where dead reckoning has been, step by step and branch by branch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.live.engine import Begun, Forked, Stepped
from slam.types import Floats

ROOM = 256
"""[steps] that an array has room for at least."""


class OdometryTrail:
    """The path by dead reckoning: nobody keeps it, since no filter needs it.

    As a listener of the engine it knows every step; without, those that were shown.
    """

    def __init__(self) -> None:
        self._number = -1
        self._start = np.zeros(2)
        self._rows: dict[str, Floats] = {}

    def begun(self, begun: Begun) -> None:
        """A session has begun."""
        self.start(begun.number, np.asarray(begun.info.source.start, float))

    def forked(self, forked: Forked) -> None:
        """What is before a branch is its parent's."""

    def stepped(self, stepped: Stepped) -> None:
        """One step more."""
        self.note(stepped.branch, stepped.step.index, stepped.step.odometry)

    def closed(self) -> None:
        """Nothing is left to do."""

    def start(self, number: int, pose: Floats) -> None:
        """Session `number` begins at a pose (3,); nothing happens if that is known."""
        if number > self._number:
            self._number, self._start, self._rows = number, pose[:2].copy(), {}

    def note(self, branch: str, index: int, pose: Floats) -> None:
        """Where it is after step `index`, from 1."""
        rows = self._rows.get(branch)
        if rows is None or index >= len(rows):
            longer = np.full((2 * max(index, ROOM), 2), np.nan)
            if rows is not None:
                longer[: len(rows)] = rows
            rows = self._rows[branch] = longer
        rows[index] = pose[:2]

    def path(self, branches: Sequence[tuple[str, str, int, int]], branch: str, index: int) -> Floats:
        """(n, 2) [m] up to step `index` of a branch; `branches` as in `Status`."""
        parents = {name: (parent, at) for name, parent, at, _ in branches}
        parts, last = [], index
        while True:
            parent, first = parents.get(branch, ("", 0))
            rows = self._rows.get(branch, np.zeros((0, 2)))
            parts.append(rows[max(first, 0) + 1 : last + 1])
            if not branch:
                break
            last, branch = min(last, first), parent
        path = np.concatenate([self._start[None], *reversed(parts)])
        return path[np.isfinite(path[:, 0])]
