"""How far luck moves an estimate: the Monte Carlo variance of a weighted mean, from one run alone.

Had a filter drawn other random numbers on the same data, its estimate would be another one.  How far apart such
estimates lie is seen in one run, too: particles of different descent were drawn independently of each other, so that
what their families differ by tells how much the draw of a family counts (H. P. Chan, T. L. Lai, "A general theory of
particle filters in hidden Markov models and some applications", Ann. Statist. 41, 2013; A. Lee, N. Whiteley, "Variance
estimation in the particle filter", Biometrika 105, 2018).

Luck that all have shared can't be seen so.  With one family nothing is left to compare, and long before that the
variance is too small; so it is NaN where too few pairs of particles are of different families (`APART`).  A filter that
forgets its past may take families of a more recent ancestor instead, a fixed number of steps back (J. Olsson, R. Douc,
"Numerically stable online estimation of variance in particle filters", Bernoulli 25, 2019): with too few steps luck
that still counts is left out, with too many hardly any family is left.  SLAM has no such number of steps: a map keeps
for ever what luck made of it.  How near both come to the truth is measured by `tests/benchmarks/luck.py`, with the
result in README.md; hence founders, and no guess when they can't tell any more.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slam._jit import kernel
from slam.geometry import wrap
from slam.types import Floats, Ints, Particles

APART = 0.8
"""Share of all pairs of particles, by weight, that must be of different families: five equal ones are just enough.
With more of them the variance is nearer the truth, and is told for fewer steps (`tests/benchmarks/luck.py`)."""


def ancestry_variance(deviations: Floats, w: Floats, families: Ints, apart: float = APART) -> Floats:
    """(d,) Monte Carlo variance of the mean f = sum_i w_i f_i, from the deviations f_i - f (K, d) of its particles.

        V = sum_e (sum_{i in e} w_i (f_i - f))^2 / (1 - sum_e (sum_{i in e} w_i)^2)

    over the families e: families (K,) has a number from 0 for each, the index of the founder or of a later ancestor; w
    (K,) are normalised weights.  The sum is that of Chan and Lai.  Lee and Whiteley multiply it by
    (K / (K - 1))^(n + 1): one over the probability that two particles, drawn at random, have different founders after n
    resamplings, if these are multinomial, from equal weights, and to as many as before.  What stands here is the share
    of pairs, by weight, that do have different ones.  So it does not matter when and how it was resampled, nor whether
    K has changed; the weights of steps without a resampling are in w.  NaN where that share is less than `apart`, and
    for one family.
    """
    sums = np.zeros((1 + deviations.shape[1], int(families.max()) + 1))
    _add_to_families(deviations, w, families, sums)
    together, *squares = np.sum(sums**2, axis=1)
    if together >= 1.0 or 1.0 - together < apart:
        return np.full(len(squares), np.nan)
    return np.array(squares) / (1.0 - together)


def luck_of_pose(weighted: Particles, estimate: Floats) -> Floats:
    """(3,) [m^2, m^2, rad^2] of x, y and heading of the `estimate` (3,), the mean of weighted particles."""
    away = np.empty_like(weighted.s)
    _subtract(weighted.s, estimate, away)
    return ancestry_variance(away, np.exp(weighted.log_w), weighted.lineage)


@kernel
def _subtract(s: Any, estimate: Any, away: Any) -> None:
    for i in range(len(s)):
        away[i, 0], away[i, 1] = s[i, 0] - estimate[0], s[i, 1] - estimate[1]
        away[i, 2] = wrap(s[i, 2] - estimate[2])


@kernel
def _add_to_families(deviations: Any, w: Any, families: Any, sums: Any) -> None:
    """Into sums (1 + d, families), which come as zeros: the weight of each, and the weighted deviations."""
    for i in range(len(w)):
        sums[0, families[i]] += w[i]
        for a in range(deviations.shape[1]):
            sums[1 + a, families[i]] += w[i] * deviations[i, a]
