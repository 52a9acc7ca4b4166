"""The last numbers of every filter, for the small plots of the panel."""

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


class Trends(NamedTuple):
    """The last steps of a branch: steps (T,), and for every filter (T,) each; NaN where it was off."""

    steps: Floats
    n_eff: dict[str, Floats]
    """As a share of the particles."""
    error: dict[str, Floats]
    """[m] of the position."""


class Trend:
    """A `Listener`: takes numbers, and nothing that lasts."""

    def __init__(self, length: int = LENGTH) -> None:
        self._lock = threading.Lock()
        self._length = length
        self._branches: dict[str, deque[tuple[int, dict[str, tuple[float, float]]]]] = {}

    def begun(self, begun: Begun) -> None:
        """A session has begun."""
        with self._lock:
            self._branches = {"": deque(maxlen=self._length)}

    def forked(self, forked: Forked) -> None:
        """A branch has in common with its parent what was before it."""
        with self._lock:
            rows = (row for row in self._branches.get(forked.parent, ()) if row[0] <= forked.at)
            self._branches[forked.name] = deque(rows, maxlen=self._length)

    def stepped(self, stepped: Stepped) -> None:
        """A branch has a new step."""
        numbers = {
            key: (
                update.measures.n_eff / len(update.trace.weighted.log_w),
                update.measures.position_error_m,
            )
            for key, update in stepped.step.filters.items()
        }
        with self._lock:
            self._branches.setdefault(stepped.branch, deque(maxlen=self._length)).append((stepped.step.index, numbers))

    def closed(self) -> None:
        """Nothing to do."""

    def of(self, branch: str, until: int) -> Trends:
        """Those of a branch up to a step."""
        with self._lock:
            rows = [row for row in self._branches.get(branch, ()) if row[0] <= until]
        keys = sorted({key for _, numbers in rows for key in numbers})
        nothing = (math.nan, math.nan)
        series = {key: np.array([numbers.get(key, nothing) for _, numbers in rows]).reshape(-1, 2) for key in keys}
        return Trends(
            np.array([index for index, _ in rows], float),
            {key: values[:, 0] for key, values in series.items()},
            {key: values[:, 1] for key, values in series.items()},
        )
