"""`--relations FILE`: how well the paths of the filters, and odometry alone, fit relations between scans of a log."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.errors import UsageError
from app.types import SessionInfo, SessionStep, best_path
from scenarios.logs.keyframes import every_scan
from scenarios.logs.relations import Relations, read_relations
from scenarios.types import Source
from slam.relations import RelationErrors, relation_errors
from slam.types import Floats

ODOMETRY, MATCHED = "odometry", "matching"


def relations_of(path: Path, source: Source) -> Relations:
    """The relations in a file, for a source.  Raises `UsageError`, `SourceError`."""
    if source.scans is None:
        raise UsageError(f"--relations does not apply to {source.name}: it is for logs of a laser")
    return read_relations(path, source.scans.stamps)


class PathErrors:
    """Keeps what it takes to judge the paths of a session, whenever somebody asks."""

    def __init__(self, relations: Relations) -> None:
        self.relations = relations
        self._matched: list[Floats] = []
        self._last: SessionStep | None = None

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self._source = info.source

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        if step.matched is not None:
            self._matched.append(step.matched)
        self._last = step

    def found(self) -> dict[str, RelationErrors]:
        """Of odometry, of what scan matching alone makes of it, and of the best particle's lineage of each filter by
        its key; empty before the first step."""
        if self._last is None:
            return {}
        scans, last = self._source.scans, self._last
        assert scans is not None
        ran = slice(scans.kept[0], scans.kept[last.index - 1] + 1)
        paths = {ODOMETRY: (scans.stamps[ran], scans.odometry[ran])}
        if len(self._matched) == last.index:  # it was on all the time
            paths[MATCHED] = every_scan(self._source, np.array(self._matched))
        paths |= {key: every_scan(self._source, best_path(update)) for key, update in last.filters.items()}
        _, times, poses, _ = self.relations
        return {key: relation_errors(stamps, path, times, poses) for key, (stamps, path) in paths.items()}
