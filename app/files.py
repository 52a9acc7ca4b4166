"""Writing files: checked before the work begins, complete or not at all."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from app.errors import UsageError


def is_stdout(path: Path | None) -> bool:
    """Whether a file is where the program prints."""
    return str(path) in ("/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")


def check_file(option: str, path: Path) -> None:
    """Fail now, with a sentence, if a file could not be written at `path` later."""
    if path.is_dir():
        raise UsageError(f"{option} {path} is a directory; expected a file name")
    if path.exists() and not os.access(path, os.W_OK):
        raise UsageError(f"{option} {path} cannot be written: permission denied")
    if is_stdout(path) or (path.exists() and not path.is_file()):
        return  # a pipe: nothing is put beside it
    folder = path.resolve().parent
    if not folder.is_dir():
        what = "is no directory" if folder.exists() else "does not exist"
        raise UsageError(f"{option} {path} cannot be written: the directory {folder} {what}")
    _probe(option, path, folder)


def check_directory(option: str, path: Path) -> None:
    """Fail now, with a sentence, if files could not be written in the directory `path` later; it need not exist yet."""
    if path.exists() and not path.is_dir():
        raise UsageError(f"{option} {path} is a file; expected a directory")
    there = next(folder for folder in (path, *path.absolute().parents) if os.path.lexists(folder))
    if not there.is_dir():
        raise UsageError(f"{option} {path} cannot be made: {there} is no directory")
    _probe(option, path, there)


def _probe(option: str, path: Path, folder: Path) -> None:
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"{option} {path} cannot be written: {os.strerror(error.errno or 0).lower()}") from None


def write_whole(path: Path, text: str) -> None:
    """Write a text file so that a reader, and a crash, sees the old content or the new, never a part."""
    if is_stdout(path):
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    path = path.resolve()  # a link stays a link
    if path.exists() and not path.is_file():  # a pipe: nothing to replace
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            error.filename = str(path)
            raise
        return
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, _mode(path))
        os.replace(name, path)
    except BaseException as error:
        os.unlink(name)
        if isinstance(error, OSError):
            error.filename = str(path)  # not the temporary one
        raise


def _mode(path: Path) -> int:
    """The permissions of the file that is replaced, or those of any new file."""
    if path.exists():
        return path.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
