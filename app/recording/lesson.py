"""The runs of a lesson as one recording: the first is the run itself, the others lie beside it like branches."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from app.recording.stream import FileStream, check_path
from app.types import SessionInfo, SessionStep

if TYPE_CHECKING:
    from app.recording.writer import Writer


class LessonRecorder:
    """An observer of one run after the other.  Raises what a `Recorder` does."""

    def __init__(self, path: Path, text: str) -> None:
        """`text` is Markdown, the page `/lesson` of the recording."""
        self.path = path
        self._text = text
        check_path(path)
        self._name = ""
        self._first: Writer | None = None
        self._now: Writer | None = None

    def next(self, name: str) -> None:
        """What the run is called that begins next."""
        self._name = name

    def begin(self, info: SessionInfo) -> None:
        """Open the file, or begin the tree of one more run in it."""
        if self._first is not None:
            self._now = self._first.fork(info, self._name)
            return
        os.environ.setdefault("RUST_LOG", "off")  # Rerun says on stderr what is raised here as `RecordingLost`
        from app.recording.writer import Writer  # importing Rerun takes a second: only who records pays for it

        self._first = self._now = Writer(info, partial(FileStream, self.path), lesson=(self._name, self._text))

    def step(self, step: SessionStep) -> None:
        """Write one observing step."""
        if self._now is not None:
            self._now.step(step)

    def end(self) -> None:
        """The run is over; the file is not."""

    def close(self, text: str) -> None:
        """Complete the file, with the text as it is now that something came out."""
        writer, self._first, self._now = self._first, None, None
        if writer is not None:
            writer.teach(text)
            writer.close()
