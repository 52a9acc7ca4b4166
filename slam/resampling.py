"""Weights and resampling: effective sample size (44), and four unbiased ways to choose who lives on.

A scheme is a function `scheme(rng, w, size) -> ancestors`:

    w (K,)              weights, not negative, with a positive and finite sum (need not be 1)
    ancestors (size,)   int64 indices of particles in ascending order

In every scheme particle k is expected size * w[k] times, whatever its place, and a particle of weight zero
never occurs.  `size` may differ from K: a change of the particle count is a resampling to another size.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from slam.types import Floats, Ints, ResamplerName

BELOW_ONE = math.nextafter(1.0, 0.0)

ROUNDING = 1e-12
"""Relative: what is this close below a whole number of copies, as 1000 * exp(-log(1000)) is, counts as whole."""


class Scheme(Protocol):
    """What all resampling schemes look like; see the module for the arguments."""

    def __call__(self, rng: np.random.Generator, w: Floats, size: int) -> Ints:
        """Ancestors (size,) drawn for weights w (K,)."""
        ...


def normalise(log_w: Floats) -> tuple[Floats, bool]:
    """Log weights (K,) that sum to one, and whether that was possible.

    The maximum is subtracted first, so that relative weights survive where all densities underflow.  A NaN
    counts as impossible (-inf).  If nothing is possible the weights come back equal and the flag False: the
    particles are all there is, and the caller reports the event.  If some are +inf they share everything.
    """
    log_w = np.where(np.isnan(log_w), -np.inf, log_w)
    highest = log_w.max()
    if highest == -np.inf:
        return np.full(len(log_w), -math.log(len(log_w))), False
    if highest == np.inf:
        log_w, highest = np.where(log_w == np.inf, 0.0, -np.inf), 0.0
    with np.errstate(over="ignore"):  # the distance of two huge log weights is -inf, as it should be
        shifted = log_w - highest
    return shifted - math.log(np.exp(shifted).sum()), True


def effective_sample_size(log_w: Floats) -> float:
    """N_eff = 1 / sum w^2 (44) of log weights (K,), normalised or not; K if all are impossible."""
    w = np.exp(normalise(log_w)[0])
    return float(1.0 / (w @ w))


def wants_resampling(n_eff: float, K: int, below: float) -> bool:
    """Whether N_eff < below * K (44); `below` 0 never resamples, 1 or more always does."""
    if below <= 0.0:
        return False
    return below >= 1.0 or n_eff < below * K


def systematic(rng: np.random.Generator, w: Floats, size: int) -> Ints:
    """One random offset, then equal strides: particle k occurs floor or ceil of size * w[k] times."""
    return _pick(w, (np.arange(size) + rng.random()) / size)


def stratified(rng: np.random.Generator, w: Floats, size: int) -> Ints:
    """One independent draw in each of `size` equal strides."""
    return _pick(w, (np.arange(size) + rng.random(size)) / size)


def multinomial(rng: np.random.Generator, w: Floats, size: int) -> Ints:
    """Independent draws; the most random scheme, for comparison."""
    return _pick(w, np.sort(rng.random(size)))


def residual(rng: np.random.Generator, w: Floats, size: int) -> Ints:
    """floor(size * w[k]) copies for certain; the rest is drawn independently from the fractions left over."""
    expected = size * (w / w.sum())
    copies = np.floor(expected * (1.0 + ROUNDING)).astype(np.int64)
    left = size - int(copies.sum())
    if left > 0:
        copies += np.bincount(_pick(np.maximum(expected - copies, 0.0), rng.random(left)), minlength=len(w))
    return np.repeat(np.arange(len(w)), copies)


SCHEMES: dict[ResamplerName, Scheme] = {
    "systematic": systematic,
    "stratified": stratified,
    "residual": residual,
    "multinomial": multinomial,
}
"""The schemes by the name that `Params.resampler` has."""


def resample(rng: np.random.Generator, log_w: Floats, size: int, scheme: ResamplerName = "systematic") -> Ints:
    """Ancestors (size,) for log weights (K,), normalised or not; equal if all are impossible."""
    return SCHEMES[scheme](rng, np.exp(normalise(log_w)[0]), size)


def _pick(w: Floats, u: Floats) -> Ints:
    """For each u in [0, 1) the particle in whose share it lies: the first whose cumulative weight exceeds u.

    Divided by its last entry, the cumulative sum is exactly 1 from the last particle of positive weight on,
    so that rounding can neither run past the end nor wake a particle of weight zero.  A stride's u may round
    up to 1.
    """
    cumulative = np.cumsum(w)
    cumulative /= cumulative[-1]
    return np.searchsorted(cumulative, np.minimum(u, BELOW_ONE), side="right").astype(np.int64, copy=False)
