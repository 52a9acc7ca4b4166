"""`--relations FILE`: how well the paths of the filters, and odometry alone, fit relations between scans of a log."""

from __future__ import annotations

from pathlib import Path

from app.errors import UsageError
from app.paths import Paths
from app.types import SessionInfo, SessionStep
from scenarios.logs.keyframes import every_scan
from scenarios.logs.relations import Relations, read_relations
from scenarios.types import Source
from slam.relations import RelationErrors, relation_errors


def relations_of(path: Path, source: Source) -> Relations:
    """The relations in a file, for a source.  Raises `UsageError`, `SourceError`."""
    if source.scans is None:
        raise UsageError(f"--relations does not apply to {source.name}: it is for logs of a laser")
    return read_relations(path, source.scans.stamps)


class PathErrors:
    """Keeps what it takes to judge the paths of a session, whenever somebody asks."""

    def __init__(self, relations: Relations) -> None:
        self.relations = relations
        self._paths = Paths()

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self._source = info.source

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        self._paths.step(step)

    def found(self) -> dict[str, RelationErrors]:
        """Of all `Paths`, with the scans between the steps; empty before the first step."""
        _, times, poses, _ = self.relations
        paths = {key: every_scan(self._source, path) for key, path in self._paths.found().items()}
        return {key: relation_errors(stamps, path, times, poses) for key, (stamps, path) in paths.items()}
