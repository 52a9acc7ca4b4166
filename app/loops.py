"""When a loop closes: a feature that was long out of sight is matched again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.types import UNKNOWN_TAG, Bools, Ints, Trace

Distances = NDArray[np.float32]
"""Single precision: there is one for every particle and feature."""


class Loops:
    """Of one filter: for each feature of each particle's map, how far the robot had travelled when it was last matched.

    Of every particle, since the same index is another feature in the map of another one.
    """

    def __init__(self) -> None:
        self._last = np.empty((0, 0), np.float32)
        """(K, n) [m]"""

    def step(self, trace: Trace, k: int, travelled: float) -> Distances:
        """[m] of travel since each feature that particle k of `trace.weighted` matched was matched before, or made."""
        before, after = trace.predicted.maps.counts, trace.weighted.maps.counts
        if int(trace.resized.max()) >= len(self._last):  # of a filter that was off while its particles became more
            self._last = np.empty((0, 0), np.float32)
        rows = len(self._last) or int(trace.resized.max()) + 1
        last = _with_room(self._last, rows, int(after.max(initial=0)))[trace.resized]
        gaps = travelled - last[k, trace.n[k][trace.n[k] >= 0]]
        owner, which = np.nonzero(trace.n >= 0)
        last[owner, trace.n[owner, which]] = travelled
        for made in range(int((after - before).max(initial=0))):
            owner = np.flatnonzero(before + made < after)
            last[owner, before[owner] + made] = travelled
        self._last = last[trace.selected]
        return gaps


def right_matches(trace: Trace, tags: Ints, k: int) -> Bools:
    """Whether each match of particle k of `trace.weighted` is with a feature of the thing that was seen.

    `tags` (Z,) are those of the frame.  All are right where neither the frame nor the map has one that is known.
    """
    matched = trace.n[k] >= 0
    of_map = trace.weighted.maps.tags(k)
    seen, mapped = tags[matched], of_map[trace.n[k][matched]]
    if (tags == UNKNOWN_TAG).all() and (of_map == UNKNOWN_TAG).all():
        return np.ones(len(seen), np.bool_)
    return (seen == mapped) & (seen != UNKNOWN_TAG)


def _with_room(last: Distances, K: int, n: int) -> Distances:
    """(K, >= n) the same, and zeros where there was nothing."""
    if last.shape[1] >= n and len(last) == K:
        return last
    wider = np.zeros((K, max(n, 2 * last.shape[1], 16)), np.float32)
    wider[: len(last), : last.shape[1]] = last
    return wider
