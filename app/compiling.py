"""Knowing when numba compiles: to say so, to keep it out of the timings, and to let it finish."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from time import perf_counter
from typing import Any

from numba.core import event

from app.interrupt import Interrupts

COMPILES = "numba:compile"
PREPARES = "numba:compiler_lock"
"""Held while a kernel is compiled, and also while one is loaded from the cache."""


class _Brackets(event.Listener):
    """Calls `on_change` as the outermost of nested events begins (True) and ends (False)."""

    def __init__(self, on_change: Callable[[bool], None]) -> None:
        self._depth = 0  # a kernel compiles those that it calls
        self._on_change = on_change

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth == 1:
            self._on_change(True)

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._on_change(False)


@contextmanager
def _listening(kind: str, on_change: Callable[[bool], None]) -> Iterator[None]:
    listener = _Brackets(on_change)
    event.register(kind, listener)
    try:
        yield
    finally:
        event.unregister(kind, listener)


class CompileClock:
    """Counts the seconds in which numba prepared kernels while this was entered: compiled them, or loaded its cache.

    `on_change` is told of compilations only: a cache is loaded in no time worth a word.
    """

    seconds: float

    def __init__(self, on_change: Callable[[bool], None] | None = None) -> None:
        self.seconds = 0.0
        self._began = 0.0
        self._on_change = on_change
        self._stack = ExitStack()

    def __enter__(self) -> CompileClock:
        self._stack.enter_context(_listening(PREPARES, self._count))
        if self._on_change:
            self._stack.enter_context(_listening(COMPILES, self._on_change))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _count(self, begins: bool) -> None:
        if begins:
            self._began = perf_counter()
        else:
            self.seconds += perf_counter() - self._began


@contextmanager
def uninterrupted_compilation(interrupts: Interrupts) -> Iterator[None]:
    """An interruption while numba prepares a kernel takes effect when that is done.

    LLVM calls back into Python, and an exception that is raised there is lost, or leaves LLVM without its result.
    """
    with _listening(PREPARES, lambda begins: interrupts.hold() if begins else interrupts.release()):
        yield
