"""A Rerun stream that writes one file: opened with care, told the time, and watched while it writes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.errors import UsageError, sentence
from app.files import check_file
from app.recording.errors import MAGIC, RecordingError, RecordingLost
from app.recording.pipe import Pipe

if TYPE_CHECKING:
    import rerun.blueprint as rrb

APPLICATION = "dual-fastslam"
FLUSH_EVERY = 0.5
"""[s] after which what was logged is in the file, however slow the steps are: what a kill may cost."""

PATIENCE = 20.0
"""[s] that a slow disk is given."""


def check_path(path: Path) -> None:
    """Fail now, with a sentence, if no recording could be written at `path` later."""
    if path.suffix != ".rrd":
        raise RecordingError(f"--record {path} has the wrong ending; expected a name that ends in .rrd")
    try:
        check_file("--record", path)
        if path.exists():
            _check_replaceable(path)
    except RecordingError:
        raise
    except (UsageError, OSError) as error:
        raise RecordingError(sentence(error)) from None


def _check_replaceable(path: Path) -> None:
    """A recording may be recorded over; anything else that bears its name is not ours to destroy."""
    if not path.is_file():
        raise RecordingError(f"--record {path} is no ordinary file; expected a file name")
    with path.open("rb") as file:
        start = file.read(len(MAGIC))
    if start and start != MAGIC:
        raise RecordingError(f"--record {path} exists and is no recording; it is not overwritten")


class Stream:
    """Log here.  Nothing is sent anywhere but to the file."""

    def __init__(self, path: Path, blueprint: rrb.Blueprint, name: str) -> None:
        check_path(path)
        import rerun as rr

        self.path = path
        self._rec = rr.RecordingStream(APPLICATION, batcher_config=rr.ChunkBatcherConfig(flush_tick=FLUSH_EVERY))
        if not rr.is_enabled(self._rec):
            raise RecordingError(
                f"the environment variable RERUN={os.environ.get('RERUN', '')} turns recording off; unset it to record"
            )
        self._rec.set_log_time_enabled(False)  # when it was computed is of no interest
        try:
            self._pipe = Pipe(path)
        except OSError as error:
            raise RecordingError(f"--record {path} cannot be written: {sentence(error)}") from None
        self._rec.save(self._pipe.entrance, default_blueprint=blueprint)
        self._pipe.seal()
        self._rec.send_recording_name(name)
        self._told = False

    def begun(self) -> None:
        """Make sure, before the run begins, that what does not change is in the file."""
        self._rec.flush(timeout_sec=PATIENCE)
        if self._pipe.error is not None:
            self._told = True
            raise RecordingError(f"--record {self.path} cannot be written: {_reason(self._pipe.error)}")

    def log(self, entity: str, *what: Any) -> None:
        """At the present time."""
        self._rec.log(entity, *what)

    def log_static(self, entity: str, *what: Any) -> None:
        """True at all times."""
        self._rec.log(entity, *what, static=True)

    def property(self, name: str, what: Any) -> None:
        """Of the recording as a whole."""
        self._rec.send_property(name, what)

    def set_time(self, stage: int, step: int | None = None, sim_time: float | None = None) -> None:
        """What is logged next belongs to this moment, on the timelines for which a time is given."""
        self._rec.reset_time()
        self._rec.set_time("stage", sequence=stage)
        if step is not None:
            self._rec.set_time("step", sequence=step)
        if sim_time is not None:
            self._rec.set_time("sim_time", duration=sim_time)

    def check(self) -> None:
        """`RecordingLost` if the file could not be written; once."""
        if self._pipe.error is not None and not self._told:
            self._told = True
            raise RecordingLost(
                f"the recording {self.path} could not be written any further: {_reason(self._pipe.error)}; "
                "what it held until then is kept"
            )

    def close(self) -> None:
        """Write what is left, and the index at the end of the file."""
        self._rec.disconnect()
        self._pipe.join()
        self.check()


def _reason(error: OSError) -> str:
    return sentence(OSError(error.errno, error.strerror))  # without a file name: the sentence has it already
