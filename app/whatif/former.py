"""The recording that `--record` writes over: kept beside the new one until that is known to be of use."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path


class Former:
    """What was at a path before.  Either `restore` or `forget` ends it."""

    def __init__(self, path: Path) -> None:
        """A copy: the file itself may be one that another program writes at present, which must stay in its place."""
        self._path = path.resolve()  # a link stays a link
        self._copy: Path | None = None
        if self._path.exists():
            descriptor, name = tempfile.mkstemp(dir=self._path.parent, prefix=f".{self._path.name}.")
            os.close(descriptor)
            self._copy = Path(name)
            try:
                shutil.copy2(self._path, self._copy)
            except BaseException:
                self.forget()
                raise

    def restore(self) -> None:
        """Put it back in place of what is there now; or nothing, if there was nothing."""
        if self._copy is None:
            self._path.unlink(missing_ok=True)
        else:
            os.replace(self._copy, self._path)
            self._copy = None

    def forget(self) -> None:
        """It is replaced for good."""
        if self._copy is not None:
            self._copy.unlink(missing_ok=True)
            self._copy = None
