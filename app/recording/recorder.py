"""The observer that writes a session to a Rerun recording, as `app.recording` describes it."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from app.recording.stream import FileStream, check_path
from app.types import SessionInfo, SessionStep

if TYPE_CHECKING:
    from app.recording.writer import Judge, Writer


class Recorder:
    """Records a session to the file `path`.

    Raises `RecordingError` here or from `begin` if that is impossible; `RecordingLost`, once, from `step` or `end` if
    the file cannot be written any further (a full disk): what it held until then is kept.
    """

    def __init__(self, path: str | Path, judge: Judge | None = None) -> None:
        """`judge`, which sees every step first, knows where paths break relations."""
        self.path = Path(path)
        self._judge = judge
        check_path(self.path)
        self._writer: Writer | None = None

    def begin(self, info: SessionInfo) -> None:
        """Open the file and write what does not change."""
        os.environ.setdefault("RUST_LOG", "off")  # Rerun says on stderr what is raised here as `RecordingLost`
        from app.recording.writer import Writer  # importing Rerun takes a second: only who records pays for it

        self._writer = Writer(info, partial(FileStream, self.path), judge=self._judge)

    def step(self, step: SessionStep) -> None:
        """Write one observing step."""
        if self._writer is not None:
            self._writer.step(step)

    def fork(self, info: SessionInfo, name: str) -> Callable[[SessionStep], None]:
        """A branch of the session, in the same file: what is to be told of its steps."""
        if self._writer is None:
            raise ValueError("a branch needs a session that has begun and not ended")
        return self._writer.fork(info, name).step

    def end(self) -> None:
        """Complete the file."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()
