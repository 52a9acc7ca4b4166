"""Ctrl-C and SIGTERM: stop at once, but never in the middle of saving."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Ctrl-C, a polite request to end, and a terminal that was closed (unknown to Windows)."""


class Interrupts:
    """While entered, `SIGNALS` raise `KeyboardInterrupt`, inside `shield()` only at its end.

    A second signal inside a shield does not wait: whoever presses Ctrl-C twice means it.

    An exception that is raised in a callback of a library may get lost there: `received` tells of it all the same.
    """

    def __init__(self) -> None:
        self.received = False
        self._shields = 0
        self._pending = False
        self._former: dict[int, Any] = {}

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is not threading.main_thread():
            return self  # only the main thread may have handlers, and only it is interrupted
        for number in SIGNALS:
            self._former[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self.received = True
        if self._shields and not self._pending:
            self._pending = True
        else:
            raise KeyboardInterrupt

    @contextmanager
    def shield(self) -> Iterator[None]:
        """What happens in here is finished before an interruption takes effect; an error from here goes before it."""
        self.hold()
        try:
            yield
        except BaseException:
            self._shields -= 1
            if not self._shields:
                self._pending = False
            raise
        self.release()

    def hold(self) -> None:
        """Begin a shield that has no block of its own."""
        self._shields += 1

    def release(self) -> None:
        """End such a shield."""
        self._shields -= 1
        if self._pending and not self._shields:
            self._pending = False
            raise KeyboardInterrupt

    def check(self) -> None:
        """Raise `KeyboardInterrupt` if there was a signal, even one that got lost."""
        if self.received:
            raise KeyboardInterrupt
