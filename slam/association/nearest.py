"""Nearest neighbour within the gate (25-27)."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam._jit import inline


@inline
def slot_for(d2: Any, first: Any, M: Any, most: Any, distance: Any) -> Any:
    """Where a pair goes among those of its observation, d2[first:M], of which only the `most` nearest are kept.

    M for one more, the place of the farthest where there is no room, -1 if that is nearer still.
    """
    if M - first < most:
        return M
    farthest = first + np.argmax(d2[first:M])
    return farthest if distance < d2[farthest] else -1


@inline
def nearest_first(obs: Any, feat: Any, d2: Any, free: Any, out: Any) -> None:
    """Pair greedily by distance: the nearest pair of all, then the nearest of what is left.

    obs, feat, d2 (M,): the pairs that passed the gate; free (M,) bool: work space.  out (Z,) receives features; what
    finds none is left as it is.  Taking the nearest pair first, rather than the observations in their order, makes the
    result independent of that order.
    """
    free[:] = True
    while True:
        best = -1
        for p in range(len(obs)):
            if free[p] and (best < 0 or d2[p] < d2[best]):
                best = p
        if best < 0:
            return
        out[obs[best]] = feat[best]
        for p in range(len(obs)):
            if obs[p] == obs[best] or feat[p] == feat[best]:
                free[p] = False
