"""Whether the robot drives through walls."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from slam._jit import kernel
from slam.types import Floats

BLOCK = 64
"""Ticks that share a bounding box, so that most walls are compared with few of them."""


class Collision(NamedTuple):
    """A wall that is driven through, and the control tick of the first time."""

    wall: int
    tick: int


def collisions(walls: Floats, path: Floats) -> list[Collision]:
    """Which of the walls (n, 4) are touched or crossed by the centre of a robot on `path` (T + 1, 2), first come
    first."""
    starts = np.arange(0, len(path) - 1, BLOCK)
    low = np.minimum(np.minimum.reduceat(path, starts), path[np.minimum(starts + BLOCK, len(path) - 1)])
    high = np.maximum(np.maximum.reduceat(path, starts), path[np.minimum(starts + BLOCK, len(path) - 1)])
    found = np.full(len(walls), -1)
    _collide(np.ascontiguousarray(walls), np.ascontiguousarray(path), low, high, found)
    hits = [Collision(wall, int(tick)) for wall, tick in enumerate(found) if tick >= 0]
    return sorted(hits, key=lambda hit: hit.tick)


@kernel
def _collide(walls: Any, path: Any, low: Any, high: Any, found: Any) -> None:
    """The first tick that meets each wall, into `found` (n,); the blocks of ticks lie between `low` and `high`
    (b, 2)."""
    for n in range(len(walls)):
        x0, y0, x1, y1 = walls[n, 0], walls[n, 1], walls[n, 2], walls[n, 3]
        ex, ey = x1 - x0, y1 - y0
        for block in range(len(low)):
            if found[n] >= 0:
                break
            if max(x0, x1) < low[block, 0] or min(x0, x1) > high[block, 0]:
                continue
            if max(y0, y1) < low[block, 1] or min(y0, y1) > high[block, 1]:
                continue
            for t in range(block * BLOCK, min((block + 1) * BLOCK, len(path) - 1)):
                px, py = path[t, 0] - x0, path[t, 1] - y0
                dx, dy = path[t + 1, 0] - path[t, 0], path[t + 1, 1] - path[t, 1]
                side = px * ey - py * ex  # of the wall's line on which the tick begins, and the other end of it
                other = (px + dx) * ey - (py + dy) * ex
                if side * other > 0.0:
                    continue
                slope = dx * ey - dy * ex
                if slope != 0.0:
                    along = (px * dy - py * dx) / -slope
                    if 0.0 <= along <= 1.0:
                        found[n] = t
                        break
                elif side == 0.0:  # in line with the wall, or standing on that line
                    length = ex * ex + ey * ey
                    a, b = (px * ex + py * ey) / length, ((px + dx) * ex + (py + dy) * ey) / length
                    if max(a, b) >= 0.0 and min(a, b) <= 1.0:
                        found[n] = t
                        break
