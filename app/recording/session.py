"""From a live session to a recording: sessions begin, branch, and end; viewers and files take the same."""

from __future__ import annotations

import math
import os
from functools import partial
from time import monotonic

from app.live.engine import Begun, Forked, Stepped
from app.live.judge import Judge
from app.recording.blueprint import MAP_ASPECT, PAGE_ASPECT
from app.recording.stream import OpenStream
from app.recording.writer import Writer
from app.relations import Breaks
from app.session import estimators
from app.types import SessionInfo, SessionStep

PICTURES = 8.0
"""[1/s] at most, for viewers."""

DUTY, FILE_DUTY = 0.2, 0.1
"""Share of the time that pictures may take for viewers, and whole ones in a file, beyond which they wait: filters want
the interpreter, too."""

TRUNK = "the first run"
"""What people call the branch without a name, where another one was there first."""


class SessionWriter:
    """A `Listener` that writes.  The branch that it sees first is the run itself; all others lie beside it."""

    def __init__(self, open_stream: OpenStream, live: bool = False, judge: Judge | None = None) -> None:
        """`live`, for viewers: every session after a reset; of every step numbers and events, pictures `PICTURES` times
        a second.  A picture takes longer than a step, and nobody sees more of them.  `judge`, which is told of every
        step first, knows where paths break relations.
        """
        self._judge = judge
        self._number = 0
        self._first_branch = ""
        """That `_first` is of."""
        self._open = open_stream
        self._live = live
        self._aspect = PAGE_ASPECT if live else MAP_ASPECT
        self._picture_at = -math.inf
        """[s] when there may be another one."""
        self._over = False
        """Whether nothing more is to be written: a file has one session."""
        self._writers: dict[str, Writer] = {}
        self._forks: dict[str, Forked] = {}
        self._first: Writer | None = None
        self._info: SessionInfo | None = None

    def begun(self, begun: Begun) -> None:
        """Another recording; for a file that has one already the end."""
        self.closed()
        if self._over:
            return
        self._over = not self._live
        os.environ.setdefault("RUST_LOG", "off")  # Rerun says on stderr what is raised as `RecordingLost`
        filters = estimators(begun.settings.filters, begun.info.mistake)
        self._info = begun.info._replace(filters=filters, params=begun.settings.params, noise=begun.settings.noise)
        self._number = begun.number
        judged = self._judge is not None and self._judge.knows(begun.info)
        self._first = Writer(self._info, self._open, self._aspect, judge=self._breaks_of_first if judged else None)

    def forked(self, forked: Forked) -> None:
        """A tree of its own, once it has a step."""
        self._forks[forked.name] = forked

    def stepped(self, stepped: Stepped) -> None:
        """One more step."""
        if self._first is None:
            return
        if not self._writers:
            self._writers[stepped.branch], self._first_branch = self._first, stepped.branch
        if stepped.branch not in self._writers:
            self._writers[stepped.branch] = self._beside(stepped.branch)
        self._write(self._writers[stepped.branch], stepped.step)

    def _write(self, writer: Writer, step: SessionStep) -> None:
        """With pictures, if that leaves time for the filters; in a file, those of the step as it is weighted always."""
        began = monotonic()
        if began < self._picture_at:
            writer.step(step, "numbers" if self._live else "present")
            return
        writer.step(step, "all" if self._live else "usual")
        now, duty = monotonic(), DUTY if self._live else FILE_DUTY
        self._picture_at = now + max((now - began) * (1.0 / duty - 1.0), 1.0 / PICTURES if self._live else 0.0)

    def closed(self) -> None:
        """Complete it."""
        writer, self._first, self._writers = self._first, None, {}
        self._forks.clear()
        if writer is not None:
            writer.close()

    def _beside(self, branch: str) -> Writer:
        assert self._first is not None
        assert self._info is not None
        info, forked = self._info, self._forks.get(branch)
        if forked is not None:
            filters = estimators(forked.settings.filters, info.mistake)
            info = info._replace(filters=filters, params=forked.settings.params, noise=forked.settings.noise)
        judged = self._judge is not None and self._judge.knows(info)
        left = self._first if forked is None else self._writers.get(forked.parent, self._first)
        return left.fork(info, branch or TRUNK, partial(self._breaks, branch) if judged else None)

    def _breaks_of_first(self, step: SessionStep) -> dict[str, Breaks]:
        return self._breaks(self._first_branch, step)

    def _breaks(self, branch: str, step: SessionStep) -> dict[str, Breaks]:
        return {} if self._judge is None else self._judge.breaks(self._number, branch, step)
