"""From a live session to a recording: sessions begin, branch, and end; viewers and files take the same."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import monotonic

from app.live.engine import Begun, Forked, Stepped
from app.recording.blueprint import MAP_ASPECT, PAGE_ASPECT
from app.recording.stream import FileStream, OpenStream
from app.recording.writer import Detail, Writer
from app.types import SessionInfo
from slam.estimators import ESTIMATORS

PICTURES = 8.0
"""[1/s]"""

TRUNK = "the first run"
"""What people call the branch without a name, where another one was there first."""


class SessionWriter:
    """A `Listener` that writes.  The branch that it sees first is the run itself; all others lie beside it."""

    def __init__(self, open_stream: Callable[[int], OpenStream], live: bool = False) -> None:
        """`open_stream` is asked for the stream of every session, by its number.

        `live`, for viewers: numbers and events of every step, pictures `PICTURES` times a second.  A picture takes
        longer than a step, and nobody sees more of them.
        """
        self._open = open_stream
        self._live = live
        self._aspect = PAGE_ASPECT if live else MAP_ASPECT
        self._pictured_at = -math.inf
        self._writers: dict[str, Writer] = {}
        self._first: Writer | None = None
        self._info: SessionInfo | None = None

    def begun(self, begun: Begun) -> None:
        """Another recording."""
        self.closed()
        os.environ.setdefault("RUST_LOG", "off")  # Rerun says on stderr what is raised as `RecordingLost`
        filters = tuple(ESTIMATORS[key] for key in begun.settings.filters)
        self._info = begun.info._replace(filters=filters, params=begun.settings.params, noise=begun.settings.noise)
        self._first = Writer(self._info, self._open(begun.number), self._aspect)

    def forked(self, forked: Forked) -> None:
        """A tree of its own."""
        if self._first is not None and self._writers:  # else the branch is what is recorded from here on
            self._writers[forked.name] = self._beside(forked.name)

    def stepped(self, stepped: Stepped) -> None:
        """One more step."""
        if self._first is None:
            return
        if not self._writers:
            self._writers[stepped.branch] = self._first
        if stepped.branch not in self._writers:
            self._writers[stepped.branch] = self._beside(stepped.branch or TRUNK)
        self._writers[stepped.branch].step(stepped.step, self._detail())

    def _detail(self) -> Detail:
        if not self._live:
            return "usual"
        if monotonic() - self._pictured_at < 1.0 / PICTURES:
            return "numbers"
        self._pictured_at = monotonic()
        return "all"

    def closed(self) -> None:
        """Complete it."""
        writer, self._first, self._writers = self._first, None, {}
        if writer is not None:
            writer.close()

    def _beside(self, name: str) -> Writer:
        assert self._first is not None
        assert self._info is not None
        return self._first.fork(self._info, name)


def file_streams(path: Path) -> Callable[[int], OpenStream]:
    """FILE.rrd for the first session, FILE-2.rrd, FILE-3.rrd ... for those after a reset; none is overwritten."""
    first: list[int] = []

    def stream(number: int) -> OpenStream:
        first.append(number)
        if number == first[0]:
            return partial(FileStream, path)
        names = (path.with_name(f"{path.stem}-{i}.rrd") for i in range(number - first[0] + 1, 10_000))
        return partial(FileStream, next(other for other in names if not other.exists()))

    return stream
