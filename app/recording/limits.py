"""How much of a run is recorded: enough to see what happens, and bounded however long the run and however large K.

What is drawn of the present (particles, their ellipses, the best map) is recorded at every step, as a sample when there
is too much of it.  What is drawn of the past (paths, lineages, ancestry) would grow with the square of the number of
steps if the whole of it were recorded at every step: it is redrawn at a bounded number of moments, with bounded detail.
The numbers in `/plots` and `/events` are never thinned.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from slam.genealogy import Branch
from slam.types import Floats, Ints

LONG_RUN = 500
"""[steps] up to which a recording is as detailed as it gets."""


class Limits(NamedTuple):
    """Of one run."""

    particles: int
    """Particles drawn in each of the three stages of a step."""
    arrows: int
    """Of these, how many show their heading."""
    ellipses: int
    """Of these, how many show their covariance."""
    bars: int
    """Bars of the weight chart."""
    hypotheses: int
    """Features drawn of the maps of all particles together."""
    features: int
    """Features of the best map up to which it is recorded at every step, and not only at the moments of `pictures`."""
    vertices: int
    """Of a path; of all lineages together four times as many."""
    paths: int
    """[steps] between two drawings of paths."""
    pictures: int
    """[steps] between two drawings of lineages, ancestry and all maps."""


def limits_for(steps: int) -> Limits:
    """Limits for a run of so many observing steps."""
    share = min(1.0, LONG_RUN / max(steps, 1))
    return Limits(
        particles=max(100, round(400 * share)),
        arrows=max(50, round(150 * share)),
        ellipses=max(50, round(150 * share)),
        bars=100,
        hypotheses=2000,
        features=200,
        vertices=1024,
        paths=math.ceil(steps / LONG_RUN) or 1,
        pictures=math.ceil(steps / 120) or 1,
    )


def due(index: int, steps: int, every: int) -> bool:
    """Whether step `index`, from 1 to `steps`, is one of the moments: every so many steps, the first and the last."""
    return (index - 1) % every == 0 or index == steps


def sample(count: int, limit: int, keep: int | None = None) -> Ints:
    """At most `limit` indices below `count`, evenly spread; `keep` is among them."""
    chosen = _spread(count, limit)
    if keep is None or count <= limit:
        return chosen
    chosen = chosen.copy()
    chosen[np.abs(chosen - keep).argmin()] = keep
    return chosen


@functools.lru_cache(maxsize=64)
def _spread(count: int, limit: int) -> Ints:
    """Of every step the same; nobody writes into it."""
    chosen = np.arange(count) if count <= limit else np.linspace(0, count - 1, limit).astype(np.int64)
    chosen.flags.writeable = False
    return chosen


def thinned(path: Floats, vertices: int) -> Floats:
    """Every 2^i-th pose of a path (T, d) and the last, so that there are at most about `vertices`.

    A power of two, counted from the beginning: what is kept at one moment is, mostly, kept at the next.
    """
    return thinned_branches([path], [0], _stride(len(path), vertices))[0]


def thinned_tree(branches: list[Branch], steps: int, vertices: int) -> tuple[list[Branch], Floats, list[int]]:
    """The branches that most of the living descend through, as many as `vertices` allow for; thinned like a path, and
    less where there are few.

    Returns these branches, all that is kept of their poses in one array (n, 3), and how much of each.
    """
    stride = _stride(steps, vertices // 16)
    while stride > 1 and sum(2 * len(b.poses) // stride + 2 for b in branches) <= vertices:
        stride //= 2
    spread = np.arange(len(branches)) * 0.618034 % 1.0  # of many equal ones, some here and some there
    order = np.lexsort((spread, np.array([-b.living for b in branches], float)))
    cost = np.cumsum([len(branches[i].poses) // stride + 2 for i in order])
    chosen = [branches[i] for i in order[: np.searchsorted(cost, vertices, side="right")]]
    return chosen, *thinned_branches([b.poses for b in chosen], [b.first_step for b in chosen], stride)


def thinned_branches(poses: list[Floats], first_steps: list[int], stride: int) -> tuple[Floats, list[int]]:
    """Every `stride`-th step of each branch and its ends, so that they still join; lengths as in `thinned_tree`."""
    lengths = np.array([len(p) for p in poses], np.int64)
    rows = np.concatenate(poses) if poses else np.zeros((0, 3))
    if stride == 1 or not poses:
        return rows, lengths.tolist()
    ends = np.cumsum(lengths)
    begins = ends - lengths
    steps = np.arange(len(rows)) + np.repeat(np.array(first_steps) - begins, lengths)
    keep = steps % stride == 0
    keep[begins] = keep[ends - 1] = True
    return rows[keep], np.add.reduceat(keep, begins, dtype=np.int64).tolist()


def _stride(length: int, vertices: int) -> int:
    return 1 << max(0, math.ceil(math.log2(max(length, 1) / vertices)))
