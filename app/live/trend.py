"""The last numbers of every filter, for the small plots of the panel, and for a branch beside what it left."""

from __future__ import annotations

import math
import threading
from collections import deque
from typing import NamedTuple

import numpy as np

from app.live.engine import Begun, Forked, Stepped
from slam.types import Floats

LENGTH = 300
"""Steps that are shown."""

KEPT = 10_000
"""Steps of a branch that another one may be compared with."""


class Now(NamedTuple):
    """What a filter did in one step; NaN for what is not known."""

    n_eff: float
    """As a share of the particles."""
    error: float
    """[m] of the position."""
    diversity: float


class Trends(NamedTuple):
    """The last steps of a branch: steps (T,), and for every filter (T,) each; NaN where it was off."""

    steps: Floats
    n_eff: dict[str, Floats]
    """As a share of the particles."""
    error: dict[str, Floats]
    """[m] of the position."""


class Trend:
    """A `Listener`: takes numbers, and nothing that lasts."""

    def __init__(self, length: int = LENGTH, kept: int = KEPT) -> None:
        self._lock = threading.Lock()
        self._length = length
        self._kept = kept
        self._branches: dict[str, deque[tuple[int, dict[str, Now]]]] = {}

    def begun(self, begun: Begun) -> None:
        """A session has begun."""
        with self._lock:
            self._branches = {"": deque(maxlen=self._kept)}

    def forked(self, forked: Forked) -> None:
        """A branch has in common with its parent what was before it."""
        with self._lock:
            rows = (row for row in self._branches.get(forked.parent, ()) if row[0] <= forked.at)
            self._branches[forked.name] = deque(rows, maxlen=self._kept)

    def stepped(self, stepped: Stepped) -> None:
        """A branch has a new step."""
        numbers = {
            key: Now(
                update.measures.n_eff / len(update.trace.weighted.log_w),
                update.measures.position_error_m,
                update.measures.diversity,
            )
            for key, update in stepped.step.filters.items()
        }
        with self._lock:
            self._branches.setdefault(stepped.branch, deque(maxlen=self._kept)).append((stepped.step.index, numbers))

    def closed(self) -> None:
        """Nothing to do."""

    def of(self, branch: str, until: int) -> Trends:
        """Those of a branch up to a step."""
        with self._lock:
            rows = [row for row in self._branches.get(branch, ()) if row[0] <= until][-self._length :]
        keys = sorted({key for _, numbers in rows for key in numbers})
        nothing = Now(math.nan, math.nan, math.nan)
        series = {key: np.array([numbers.get(key, nothing) for _, numbers in rows]).reshape(-1, 3) for key in keys}
        return Trends(
            np.array([index for index, _ in rows], float),
            {key: values[:, 0] for key, values in series.items()},
            {key: values[:, 1] for key, values in series.items()},
        )

    def at(self, branch: str, step: int) -> dict[str, Now]:
        """What the filters of a branch did in a step; empty where that is not known any more, or not yet."""
        with self._lock:
            return next((numbers for index, numbers in self._branches.get(branch, ()) if index == step), {})
