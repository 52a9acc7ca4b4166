"""Doing what takes long so seldom that it takes no more than a share of the time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic


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
        """While it is done."""
        began = monotonic()
        try:
            yield
        finally:
            now = monotonic()
            self._next = now + (now - began) * (1.0 / self._share - 1.0)
