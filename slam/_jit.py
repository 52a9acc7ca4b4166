"""`kernel`: the one way in which this package compiles a function."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


@functools.cache
def _package_stamp() -> str:
    """A digest of all sources of this package.

    Not of their times: those of an installed package are all the same, and the caches of the version before are still
    there.
    """
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _stamp(file: Path) -> str:
    """What the compiled form of a kernel in `file` depends on."""
    if file.is_relative_to(Path(__file__).parent):
        return _package_stamp()
    return _package_stamp() + hashlib.sha256(file.read_bytes()).hexdigest()


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
"""IEEE arithmetic (no fastmath), without the GIL, and without Numba's run-time: so compiled code can't allocate
arrays, and does not count references to those it is given, which costs several times what the small loops here do (a
copied path of the map store: 0.65 us with, 0.11 us without)."""


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with `_OPTIONS`, cached on disk.  Work space is an argument.

    Numba trusts a cached kernel until the *file it stands in* changes; but most kernels inline functions of other files
    (a feature's innovation, the small-matrix algebra).  An edit there would leave old mathematics in the cache, so the
    stamp of a kernel is made that of the whole package, and of its own file if that stands elsewhere.
    """
    dispatcher: Any = numba.njit(cache=True, **_OPTIONS)(function)
    cache_file = getattr(dispatcher._cache, "_cache_file", None)
    if cache_file is not None:
        cache_file._source_stamp = _stamp(Path(function.__code__.co_filename))
    return dispatcher


inline = numba.njit(**_OPTIONS)
"""For the small functions that kernels are made of."""
