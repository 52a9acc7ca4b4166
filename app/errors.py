"""What goes wrong between a person and the program, in one sentence each."""

from __future__ import annotations

import difflib
import errno
import os
from collections.abc import Iterable


class UsageError(Exception):
    """Arguments that cannot be used; one sentence that names the option, the value and what was expected."""


def nearest(wrong: str, names: Iterable[str]) -> str | None:
    """The name that was probably meant, or None."""
    lower = {name.lower(): name for name in names}
    close = difflib.get_close_matches(wrong.lower(), lower, n=1, cutoff=0.55)
    if not close:
        close = [
            name for name in lower if len(wrong) >= 3 and (name.startswith(wrong.lower()) or wrong.lower() in name)
        ][:1]
    return lower[close[0]] if close else None


def suggestion(wrong: str, names: Iterable[str]) -> str:
    """` (did you mean loop?)`, or nothing."""
    meant = nearest(wrong, names)
    return f" (did you mean {meant}?)" if meant else ""


def listed(names: Iterable[object]) -> str:
    """`a, b or c`."""
    *first, last = [str(name) for name in names]
    return f"{', '.join(first)} or {last}" if first else last


def sentence(error: BaseException) -> str:
    """One line for a person: the message of an error, the system's own words for an `OSError`."""
    if isinstance(error, MemoryError):
        return "not enough memory; fewer particles, or fewer steps, need less"
    if isinstance(error, OSError) and error.errno is not None:
        reason = "the disk is full" if error.errno == errno.ENOSPC else os.strerror(error.errno).lower()
        return f"{error.filename}: {reason}" if error.filename else reason
    text = " ".join(str(error).split())
    return text or type(error).__name__
