"""`--relations FILE`: how well the paths of the filters, and odometry alone, fit relations between scans of a log, and
where they break them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from app.errors import UsageError
from app.paths import Paths
from app.types import SessionInfo, SessionStep
from scenarios.logs.relations import Relations, read_relations
from scenarios.types import Source
from slam.geometry import compose
from slam.relations import SAME_STAMP, RelationErrors, belongs, relation_errors
from slam.types import Floats, Ints

LEAST = 0.1
"""[m] that a relation is broken by before that is drawn."""

MOST = 2000
"""Of broken relations that are drawn."""


def relations_of(path: Path, source: Source) -> Relations:
    """The relations in a file, for a source.  Raises `UsageError`, `SourceError`."""
    if source.scans is None:
        raise UsageError(f"--relations does not apply to {source.name}: it is for logs of a laser")
    return read_relations(path, source.scans.stamps)


class Breaks(NamedTuple):
    """Where a path breaks relations: those of which it has both scans."""

    segments: Floats
    """(n, 2, 2) [m] from where the path has the robot at the second scan to where the relation has it, seen from the
    first."""
    off: Floats
    """(n,) [m] their lengths."""
    scans: Ints
    """(n, 2) numbers of both scans in the log, from 0."""

    def shown(self) -> Floats:
        """(m, 2, 2) [m] what is worth drawing: nothing that is shorter than `LEAST`, and not more than `MOST`."""
        longest = np.argsort(-self.off, kind="stable")[:MOST]
        return self.segments[longest[self.off[longest] > LEAST]]

    def told(self) -> str:
        """In words."""
        count = len(self.off)
        if not count:
            return "none of them so far"
        mean, p95, worst = self.off.mean(), np.quantile(self.off, 0.95), int(np.argmax(self.off))
        one, other = self.scans[worst]
        between = f"worst {metres(self.off[worst])} m between scans {one} and {other}"
        return f"mean {metres(mean)} m, 95 % {metres(p95)} m, {between}, of {count} so far"


def metres(length: float) -> str:
    """Three digits of a length [m]."""
    return f"{length:.3g}" if length < 1000.0 else f"{length:.0f}"


class PathErrors:
    """An observer that keeps what it takes to judge the paths of a session, whenever somebody asks."""

    def __init__(self, relations: Relations) -> None:
        self.relations = relations
        self._paths = Paths()

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self._paths.begin(info)

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        self._paths.step(step)

    def end(self) -> None:
        """There is nothing to complete."""

    def found(self) -> dict[str, RelationErrors]:
        """Of odometry, of what scan matching alone makes of it, and of the best particle's lineage of each filter by
        its key; empty before the first step."""
        _, times, poses, _ = self.relations
        return {key: relation_errors(stamps, path, times, poses) for key, (stamps, path) in self._paths.found().items()}

    def breaks(self, step: SessionStep) -> dict[str, Breaks]:
        """The same in detail, as it was after a step that was seen; empty if it was not."""
        if step.index > self._paths.steps:
            return {}
        found = self._paths.until(step).found()
        return {key: self._breaks(stamps, path) for key, (stamps, path) in found.items()}

    def forked(self, steps: int) -> PathErrors:
        """For a branch that has so many steps in common with this session."""
        branch = PathErrors(self.relations)
        branch._paths = self._paths.first(steps)
        return branch

    def _breaks(self, stamps: Floats, path: Floats) -> Breaks:
        """Of a path (M, 3) with all scans between its first and its last."""
        _, times, poses, _ = self.relations
        used = belongs(times, stamps)
        order = np.argsort(stamps, kind="stable")
        at = order[np.searchsorted(stamps, times[used] - SAME_STAMP, sorter=order)]
        here, there = path[at[:, 1], :2], compose(path[at[:, 0]], poses[used])[:, :2]
        return Breaks(np.stack([here, there], axis=1), np.hypot(*(there - here).T), at + self._paths.first_scan)
