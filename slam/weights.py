"""Why weights differ: which observations part the particles, and what of them.

Nothing here is seen by a filter.  `weight_variance` is one step of one filter.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from slam.association.jcbb import chi_square_gates
from slam.linalg import LOG_TWO_PI
from slam.types import Floats, Innovations, Trace


class WeightVariance(NamedTuple):
    """What the weights of one step differ by.

    With l_i what observation i adds to the log weight of a particle, L = sum_i l_i, and variances over the particles
    (weighted as before the step), Var(L) = sum_i Cov(l_i, L): so the share of i is Cov(l_i, L) / Var(L).  Shares sum to
    one, with all that observations have in common counted half with each; one that speaks against the others has a
    negative share.  All are NaN where weights do not differ.
    """

    deviation: float
    """Of L, natural logarithms: e to this is how much more a typical particle counts than another one."""
    observations: Floats
    """(Z,) the share of each observation."""
    first: float
    """The share of the first components of what was matched: ranges of points, lateral offsets of walls."""
    second: float
    """That of the second, bearings or angles, given the first: log N(v; 0, V) = log N(v_1) + log N(v_2 | v_1)."""
    unmatched: float
    """That of observations where a particle did not match them (`Params.log_p_new`, and the gate)."""
    drawn: float
    """What is left: the pose at which FastSLAM 2.0 weighs, if that is the drawn one."""
    inside: float
    """Share of the particles for which all they matched, together, lies within the 99 % gate: the likelihood reaches
    them.  NaN where none has matched anything."""
    wide: tuple[float, float]
    """Deviation of the innovation between particles over that which each expects, for the first and the second
    component, root mean square over what was matched: far above 1, the proposal is wider than the sensor, and most
    particles are in vain; NaN where less than two particles have matched anything."""


def weight_variance(trace: Trace) -> WeightVariance:
    """The parts of the variance of the log weights of one step, and what it says of the proposal."""
    prior = np.exp(trace.predicted.log_w)
    possible = np.isfinite(trace.log_likelihood).all(axis=1) & (prior > 0.0)
    if not possible.any():
        nan = math.nan
        return WeightVariance(nan, np.full(trace.n.shape[1], nan), nan, nan, nan, nan, nan, (nan, nan))
    w, log_p, matched = prior[possible], trace.log_likelihood[possible], trace.n[possible] >= 0
    w /= w.sum()
    innovations = Innovations(*(part[possible] for part in trace.innovations))
    first, second = (
        np.where(matched, trace.temper * part, 0.0).sum(axis=1) for part in log_density_by_component(innovations)
    )
    unmatched, L = np.where(matched, 0.0, log_p).sum(axis=1), log_p.sum(axis=1)

    away = L - w @ L
    variance = float(w @ away**2)
    if variance <= ROUNDING * float(w @ L**2):
        variance = 0.0

    def share(part: Floats) -> Any:
        return (w * away) @ (part - w @ part) / variance if variance > 0.0 else np.full(part.shape[1:], math.nan)

    return WeightVariance(
        deviation=math.sqrt(variance),
        observations=share(log_p),
        first=float(share(first)),
        second=float(share(second)),
        unmatched=float(share(unmatched)),
        drawn=float(share(L - first - second - unmatched)),
        inside=_inside(innovations, matched),
        wide=_wide(innovations, matched, w),
    )


ROUNDING = 1e-20
"""Of the mean square of a sum of logarithms, the variance that rounding alone leaves."""


def log_density_by_component(innovations: Innovations) -> tuple[Floats, Floats]:
    """log N(v_1; 0, V_11) and log N(v_2 | v_1) (K, Z), which sum to log N(v; 0, V); NaN where nothing was matched."""
    v, V = innovations
    cross = V[..., 0, 1] / V[..., 0, 0]
    means, variances = (0.0, cross * v[..., 0]), (V[..., 0, 0], V[..., 1, 1] - cross * V[..., 0, 1])
    first, second = (
        -0.5 * (LOG_TWO_PI + np.log(variance) + (v[..., a] - mean) ** 2 / variance)
        for a, (mean, variance) in enumerate(zip(means, variances, strict=True))
    )
    return first, second


def normalised_innovation(innovations: Innovations) -> Floats:
    """v^T V^-1 v (K, Z), the NIS: of a filter that is consistent chi-square with two degrees of freedom."""
    v, V = innovations
    (a, b), d = (V[..., 0, 0], V[..., 0, 1]), V[..., 1, 1]
    return (d * v[..., 0] ** 2 - 2.0 * b * v[..., 0] * v[..., 1] + a * v[..., 1] ** 2) / (a * d - b * b)


def mean_nis(trace: Trace) -> float:
    """The mean of `normalised_innovation` over particles, as weighted before the step, and what they matched; NaN for
    nothing."""
    nis = normalised_innovation(trace.innovations)
    w = np.exp(trace.predicted.log_w)[:, None] * np.isfinite(nis)
    return float((w * np.where(w > 0.0, nis, 0.0)).sum() / w.sum()) if w.sum() > 0.0 else math.nan


def _inside(innovations: Innovations, matched: Any) -> float:
    """Squared distances (25) of a chain of updates sum to that of all of them together."""
    some = matched.any(axis=1)
    if not some.any():
        return math.nan
    together = np.where(matched, normalised_innovation(innovations), 0.0).sum(axis=1)
    gates = chi_square_gates(0.99, matched.shape[1])
    return float((together <= gates[matched.sum(axis=1)])[some].mean())


def _wide(innovations: Innovations, matched: Any, w: Floats) -> tuple[float, float]:
    """Each observation counts by the weight of the particles that have matched it, if they are two at least."""
    w = np.where(matched & (matched.sum(axis=0) > 1), w[:, None], 0.0)
    counts = w.sum(axis=0)
    if not counts.any():
        return math.nan, math.nan
    v = np.where(matched[..., None], innovations.v, 0.0)
    expected = np.where(matched[..., None], np.diagonal(innovations.V, axis1=2, axis2=3), 0.0)
    known = counts > 0.0
    w, counts = w[:, known], counts[known]
    mean = np.einsum("ki,kia->ia", w, v[:, known]) / counts[:, None]
    between = np.einsum("ki,kia->ia", w, (v[:, known] - mean) ** 2)
    ratio = between / np.einsum("ki,kia->ia", w, expected[:, known])
    first, second = np.sqrt(counts @ ratio / counts.sum()).tolist()
    return first, second
