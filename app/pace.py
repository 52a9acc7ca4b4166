"""Doing what takes long so seldom that it takes no more than a share of the time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic

from app.compiling import CompileClock


class Pace:
    """Of something that may wait."""

    def __init__(self, share: float) -> None:
        self._share = share
        self._next = -math.inf
        """[s] when it may be done again."""

    @property
    def due(self) -> bool:
        """Whether it may be done again."""
        return monotonic() >= self._next

    @contextmanager
    def kept(self) -> Iterator[None]:
        """While it is done.  That kernels are prepared for it happens once, and does not make it wait."""
        began = monotonic()
        with CompileClock() as preparing:
            try:
                yield
            finally:
                now = monotonic()
                self._next = now + max(now - began - preparing.seconds, 0.0) * (1.0 / self._share - 1.0)
