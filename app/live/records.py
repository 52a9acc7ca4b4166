"""Recording a live session to files, started and stopped while it runs."""

from __future__ import annotations

import queue
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

from app.errors import UsageError, sentence
from app.files import write_whole
from app.live.engine import Engine, Listener
from app.live.history import History
from app.live.publisher import FILE_STEPS, Publisher
from app.live.script import script_of
from app.summary import dump
from scenarios.words import counted

KEEP_EVERY = 5.0
"""[s] after which the script of a session is saved again, while it is recorded."""

PATIENCE = 60.0
"""[s] that the end of a recording may take."""

LONGEST = 64
"""Letters of a name."""

MakeListener = Callable[[Path], Listener]


class Records:
    """The recordings of a session, one at a time: FILE.rrd, and FILE.json to replay it with."""

    def __init__(self, engine: Engine, directory: Path, make: MakeListener, check: Callable[[Path], None]) -> None:
        """`make` opens what writes a recording to a path, `check` complains of a path that cannot be written."""
        self._engine = engine
        self._directory = directory
        self._make = make
        self._check = check
        self._lock = threading.RLock()
        self._publisher: Publisher | None = None
        self._path: Path | None = None
        self._former: list[tuple[Publisher, Path]] = []
        """Of sessions before a reset: they may be at work still."""
        self._told = ""
        self._saved_at = 0.0
        engine.before_reset = self._before_reset

    @property
    def running(self) -> bool:
        """Whether something is being recorded."""
        return self._publisher is not None

    def start(self, name: str) -> str:
        """Record from the next step on; a sentence on where.  The name may come from anybody."""
        return self.start_at(self._free(safe_name(name)))

    def start_at(self, path: Path) -> str:
        """The same, at a path that the user of the command line has chosen."""
        with self._lock:
            if self._publisher is not None:
                return f"{self._path} is being recorded already"
            self._check(path)
            _check_replaceable(path.with_suffix(".json"))
            publisher = Publisher(self._make(path), "wait", FILE_STEPS)
            self._engine.add(publisher)
            self._publisher, self._path = publisher, path
            self._told, self._saved_at = "", monotonic()
        return f"recording to {path}"

    def stop(self) -> str:
        """Complete the file; a sentence on what is where."""
        with self._lock:
            publisher, path = self._publisher, self._path
            if publisher is None or path is None:
                return "nothing is being recorded"
            publisher.release()
            self._engine.remove(publisher)
            former = [_completed(*one) for one in self._former]
            told = _completed(publisher, path)
            self._publisher, self._former = None, []
            self._save(path)
            self._told = "; ".join([*(text for text in former if not text.startswith("saved")), told])
            return self._told

    def keep(self) -> None:
        """Save the script now and then; called by whoever has the time."""
        if self._path is not None and self.running and monotonic() - self._saved_at > KEEP_EVERY:
            self._saved_at = monotonic()
            self._save(self._path)

    def describe(self) -> str:
        """Markdown: what is recorded, how large it is, what went wrong."""
        publisher, path = self._publisher, self._path
        if publisher is None or path is None:
            return self._told and f"{self._told}\n\nOpen it with `rerun {path}`; `dualslam run --replay` runs it again."
        if publisher.error:
            return f"**{path} is lost from here on**: {publisher.error}"
        size = path.stat().st_size / 1e6 if path.exists() else 0.0
        return f"recording {path}: {counted(publisher.published, 'step')}, {size:.1f} MB, {publisher.waiting} waiting"

    def _save(self, path: Path) -> None:
        """Write the script of the session beside its recording; not that of another one, after a reset meanwhile."""
        number = self._engine.status.number
        taken: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._engine.call(lambda history: taken.put(script_of(history) if history.number == number else None))
        with suppress(queue.Empty):
            script = taken.get(timeout=PATIENCE if self._engine.alive else 0.0)
            if script is not None:
                self._write(path, script)

    def _write(self, path: Path, script: dict[str, Any]) -> None:
        try:
            write_whole(path.with_suffix(".json"), dump(script))
        except OSError as error:
            self._told = f"the script of the session cannot be saved: {sentence(error)}"

    def _before_reset(self, history: History) -> None:
        """A file has one session: the next one goes into another.  In the thread of the session, so it must not wait
        for `stop`, which waits for that."""
        old, path = self._publisher, self._path
        if old is None or path is None:
            return
        self._write(path, script_of(history))
        if not self._lock.acquire(blocking=False):
            return
        try:
            self._path = self._free(path.stem, path.parent)
            self._publisher = Publisher(self._make(self._path), "wait", FILE_STEPS)
            self._engine.replace(old, self._publisher)
            self._former.append((old, path))
        finally:
            self._lock.release()

    def _free(self, name: str, directory: Path | None = None) -> Path:
        """A path that is not taken, in the directory of this session."""
        for number in range(1, 1000):
            path = (directory or self._directory) / (f"{name}.rrd" if number == 1 else f"{name}-{number}.rrd")
            if not path.exists() and not path.with_suffix(".json").exists():
                return path
        raise UsageError(f"there are a thousand recordings called {name}; expected another name")


def _completed(publisher: Publisher, path: Path) -> str:
    """Wait until a file has everything; what has become of it."""
    done, steps = publisher.join(PATIENCE), counted(publisher.published, "step")
    if publisher.error:
        return f"**lost**: {publisher.error} ({steps} of {path})"
    if not done:
        return f"**{path} could not be completed in {PATIENCE:g} s**; it has what was written until then"
    size = path.stat().st_size / 1e6 if path.exists() else 0.0
    return f"saved {path}: {steps}, {size:.1f} MB"


def _check_replaceable(path: Path) -> None:
    """A script may be written over; anything else that bears its name is not ours to destroy."""
    try:
        with path.open("rb") as file:
            start = file.read(1 << 16)
    except FileNotFoundError:
        return
    if b'"branches"' not in start:
        raise UsageError(f"{path} exists and is no session of ours; it is not overwritten, so record to another name")


def safe_name(name: str) -> str:
    """Letters, digits, dots, dashes and underscores of a name; nothing that could lead out of a directory."""
    kept = re.sub(r"[^A-Za-z0-9._-]+", "-", name)[:LONGEST].strip(".-_")
    return kept.removesuffix(".rrd").strip(".-_") or "session"
