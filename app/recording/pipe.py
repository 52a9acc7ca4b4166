"""Between Rerun and the disk.

Rerun's own file writer never says that a disk is full: logging goes on as if nothing had happened, asking it to flush
in that moment blocks for ever in about half of the cases, and then the process cannot even end.  So Rerun writes to a
pipe, which is always emptied, and this end of the pipe writes the file, and knows what went wrong.  Wants `/dev/fd`,
which Linux and macOS have.
"""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path

try:
    import fcntl
except ImportError:  # not on Windows, which has no /dev/fd either
    fcntl = None

CHUNK = 1 << 20
"""[bytes]"""


def _lock(file: int) -> None:
    """Two writers would destroy each other's work.  Some network drives know no locks, and go without."""
    if fcntl is None:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OSError(errno.EBUSY, "another run is recording to it") from None
    except OSError:
        pass


class Pipe:
    """Takes bytes at `entrance`, a path that somebody else may open for writing, and puts them into the file `path`.

    Opening fails with an `OSError`; what goes wrong later is in `error`, and the rest is thrown away.
    """

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self._path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT, 0o666)
        try:
            _lock(self._file)
            os.ftruncate(self._file, 0)
        except OSError:
            os.close(self._file)
            raise
        self._outlet, self._inlet = os.pipe()
        # A daemon: at the exit of an interpreter that did not end the recording, Rerun still writes what is left.
        self._thread = threading.Thread(target=self._pump, name="recording", daemon=True)
        self._thread.start()

    @property
    def entrance(self) -> str:
        """Valid until it is closed, by `seal`."""
        return f"/dev/fd/{self._inlet}"

    def seal(self) -> None:
        """Nobody else will open the entrance; when those who have are done, so is the pipe."""
        os.close(self._inlet)

    def join(self) -> None:
        """Wait until all is written."""
        self._thread.join()

    def _pump(self) -> None:
        while data := os.read(self._outlet, CHUNK):
            if self.error is None:
                self._write(memoryview(data))
        os.close(self._outlet)
        if self.error is None and not self._is_there():
            self.error = OSError(errno.ENOENT, "it was deleted or replaced meanwhile")
        try:
            os.close(self._file)
        except OSError as error:  # a network drive may find out here
            self.error = self.error or error

    def _is_there(self) -> bool:
        """Whether what was written is what bears the name."""
        try:
            return os.path.samestat(os.fstat(self._file), os.stat(self._path))
        except OSError:
            return False

    def _write(self, data: memoryview) -> None:
        try:
            while data:
                data = data[os.write(self._file, data) :]
        except OSError as error:
            self.error = error
