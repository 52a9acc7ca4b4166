"""Rerun streams: opened with care, told the time, and watched while they write."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.errors import UsageError, sentence
from app.files import check_file
from app.recording.errors import MAGIC, RecordingError, RecordingLost
from app.recording.pipe import Pipe

if TYPE_CHECKING:
    import rerun.blueprint as rrb
    from rerun.chunk import Chunk

APPLICATION = "dual-fastslam"
FLUSH_EVERY = 0.5
"""[s] after which what was logged is in the file, however slow the steps are: what a kill may cost."""

FLUSH_LIVE = 0.1
"""[s] after which a viewer gets it."""

PATIENCE = 20.0
"""[s] that a slow disk is given."""


def check_path(path: Path, option: str = "--record") -> None:
    """Fail now, with a sentence, if no recording could be written at `path` later."""
    if path.suffix != ".rrd":
        raise RecordingError(f"{option} {path} has the wrong ending; expected a name that ends in .rrd")
    try:
        check_file(option, path)
        if path.exists():
            _check_replaceable(path, option)
    except RecordingError:
        raise
    except (UsageError, OSError) as error:
        raise RecordingError(sentence(error)) from None


def _check_replaceable(path: Path, option: str) -> None:
    """A recording may be recorded over; anything else that bears its name is not ours to destroy."""
    if not path.is_file():
        raise RecordingError(f"{option} {path} is no ordinary file; expected a file name")
    with path.open("rb") as file:
        start = file.read(len(MAGIC))
    if start and start != MAGIC:
        raise RecordingError(f"{option} {path} exists and is no recording; it is not overwritten")


class Stream(ABC):
    """Log here, from one thread.  Where it goes is a matter of the kinds of streams below."""

    def __init__(
        self, blueprint: rrb.Blueprint, name: str, flush_every: float = FLUSH_EVERY, application: str = APPLICATION
    ) -> None:
        import rerun as rr

        self._rec = rr.RecordingStream(application, batcher_config=rr.ChunkBatcherConfig(flush_tick=flush_every))
        if not rr.is_enabled(self._rec):
            raise RecordingError(
                f"the environment variable RERUN={os.environ.get('RERUN', '')} turns recording off; unset it to record"
            )
        self._rec.set_log_time_enabled(False)  # when it was computed is of no interest
        self._connect(blueprint)
        self._rec.send_recording_name(name)

    def begun(self) -> None:
        """Make sure, before the run begins, that what does not change has arrived."""
        self._rec.flush(timeout_sec=PATIENCE)

    def log(self, entity: str, *what: Any) -> None:
        """At the present time."""
        self._rec.log(entity, *what)

    def log_static(self, entity: str, *what: Any) -> None:
        """True at all times."""
        self._rec.log(entity, *what, static=True)

    def send(self, chunks: Iterable[Chunk]) -> None:
        """What another recording has, with its times."""
        self._rec.send_chunks(chunks)

    def property(self, name: str, what: Any) -> None:
        """Of the recording as a whole."""
        self._rec.send_property(name, what)

    def show(self, blueprint: rrb.Blueprint) -> None:
        """Lay out anew every window that shows the recording."""
        self._rec.send_blueprint(blueprint)

    def set_time(self, stage: int, step: int | None = None, sim_time: float | None = None) -> None:
        """What is logged next belongs to this moment, on the timelines for which a time is given."""
        self._rec.reset_time()
        self._rec.set_time("stage", sequence=stage)
        if step is not None:
            self._rec.set_time("step", sequence=step)
        if sim_time is not None:
            self._rec.set_time("sim_time", duration=sim_time)

    @abstractmethod
    def check(self) -> None:
        """`RecordingLost` if what was logged does not arrive any more; once."""

    def close(self) -> None:
        """Send what is left.  After that, nothing can be logged."""
        self._end()
        self.check()

    def _end(self) -> None:
        """Rerun keeps what a stream had, threads and memory, until nobody knows it and somebody asks.

        Of every layout that was shown it keeps two threads and some two megabytes until the process ends.
        """
        import rerun_bindings

        self._rec.disconnect()
        del self._rec
        rerun_bindings.flush_and_cleanup_orphaned_recordings()

    @abstractmethod
    def _connect(self, blueprint: rrb.Blueprint) -> None:
        """To where it goes."""


OpenStream = Callable[["rrb.Blueprint", str], Stream]
"""Opens a stream, with the layout that a window gets and the name of the recording."""


class FileStream(Stream):
    """Writes a file, and sends nothing anywhere else.

    With an `index` at its end some programs find their way about it faster; but until then Rerun keeps it in memory,
    some 2 kB for each entity in each half of a second.
    """

    def __init__(
        self,
        path: Path,
        blueprint: rrb.Blueprint,
        name: str,
        index: bool = True,
        option: str = "--record",
        application: str = APPLICATION,
    ) -> None:
        """`option` is what told of the path; windows that show one `application` share a layout."""
        check_path(path, option)
        self.path = path
        self._option = option
        self._index = index
        self._told = False
        super().__init__(blueprint, name, application=application)

    def begun(self) -> None:
        """Make sure, before the run begins, that what does not change is in the file."""
        super().begun()
        if self._pipe.error is not None:
            self._told = True
            raise RecordingError(f"{self._option} {self.path} cannot be written: {_reason(self._pipe.error)}")

    def check(self) -> None:
        """`RecordingLost` if the file could not be written; once."""
        if self._pipe.error is not None and not self._told:
            self._told = True
            raise RecordingLost(
                f"the recording {self.path} could not be written any further: {_reason(self._pipe.error)}; "
                "what it held until then is kept"
            )

    def close(self) -> None:
        """Write what is left."""
        self._end()
        self._pipe.join()
        self.check()

    def _connect(self, blueprint: rrb.Blueprint) -> None:
        try:
            self._pipe = Pipe(self.path)
        except OSError as error:
            raise RecordingError(f"{self._option} {self.path} cannot be written: {sentence(error)}") from None
        self._rec.save(self._pipe.entrance, default_blueprint=blueprint, write_footer=self._index)
        self._pipe.seal()


class BranchStream(Stream):
    """A part of an open stream, with everything below `/branch/<name>`; closing it leaves the other one open."""

    def __init__(self, trunk: Stream, name: str) -> None:
        self._trunk = trunk
        self._prefix = f"branch/{name}/"
        self._name = name

    def begun(self) -> None:
        """The other one has."""

    def log(self, entity: str, *what: Any) -> None:
        """At the present time."""
        self._trunk.log(self._prefix + entity, *what)

    def log_static(self, entity: str, *what: Any) -> None:
        """True at all times."""
        self._trunk.log_static(self._prefix + entity, *what)

    def property(self, name: str, what: Any) -> None:
        """Of the branch as a whole."""
        self._trunk.property(f"{name}-{self._name}", what)

    def show(self, blueprint: rrb.Blueprint) -> None:
        """Lay out anew every window that shows the recording."""
        self._trunk.show(blueprint)

    def set_time(self, stage: int, step: int | None = None, sim_time: float | None = None) -> None:
        """What is logged next belongs to this moment; also in the other one, until it says otherwise."""
        self._trunk.set_time(stage, step, sim_time)

    def check(self) -> None:
        """`RecordingLost` if what was logged does not arrive any more; once."""
        self._trunk.check()

    def close(self) -> None:
        """Nothing: whoever opened the other one closes it."""

    def _connect(self, blueprint: rrb.Blueprint) -> None:
        """It is."""


def _reason(error: OSError) -> str:
    return sentence(OSError(error.errno, error.strerror))  # without a file name: the sentence has it already
