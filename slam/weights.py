"""Why weights differ: which observations part the particles, and what of them; and whether innovations are as expected.

Nothing here is seen by a filter.  `weight_variance` and `innovation_statistics` are of one step of one filter.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from slam._jit import kernel
from slam.association.jcbb import chi_square_gates
from slam.linalg import LOG_TWO_PI
from slam.types import Bools, Floats, Ints, Trace


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


class InnovationStatistics(NamedTuple):
    """What was seen of known features, beside what the particles together expected of it.

    For each observation the innovations of the particles that have matched it are a mixture with the mean v and the
    covariance C = mean V + covariance of v between particles, weighted as before the step.  Of a consistent filter
    v^T C^-1 v (the NIS) is chi-square with two degrees of freedom, and each of its two parts with one.  Where all
    observations of a step are taken at the predicted pose they share its error: the mean is right, but they are not
    independent.
    """

    first: float
    """Mean of v_1^2 / C_11 over the observations: 1 is expected.  NaN where nothing was matched."""
    second: float
    """That of the second component given the first, v_2 - C_21 v_1 / C_11: 1 is expected."""
    matched: float
    """How many observations were matched: a particle's, on the average."""


def weight_variance(trace: Trace) -> WeightVariance:
    """The parts of the variance of the log weights of one step, and what it says of the proposal."""
    prior, log_p = np.exp(trace.predicted.log_w), trace.log_likelihood
    Z, nan = log_p.shape[1], math.nan
    possible = np.isfinite(log_p).all(axis=1) & (prior > 0.0)
    if not possible.any():
        return WeightVariance(nan, np.full(Z, nan), nan, nan, nan, nan, nan, (nan, nan))
    w = np.where(possible, prior, 0.0)
    w /= w.sum()
    L, first, second, unmatched, distance = sums = np.zeros((5, len(w)))
    _sum_over_observations(w, log_p, trace.n, *trace.innovations, trace.temper, sums)

    away = np.where(possible, L - w @ L, 0.0)
    away -= np.where(possible, w @ away, 0.0)  # twice: the sum may be large beside what it varies by
    variance = float(w @ away**2)
    if variance <= ROUNDING * float(w @ L**2):
        variance = 0.0
    observations = np.zeros(Z)
    _covariances(w * away, log_p, observations)
    observations = observations / variance if variance > 0.0 else np.full(Z, nan)

    def share(part: Floats) -> float:
        return float((w * away) @ part) / variance if variance > 0.0 else nan

    return WeightVariance(
        deviation=math.sqrt(variance),
        observations=observations,
        first=share(first),
        second=share(second),
        unmatched=share(unmatched),
        drawn=share(L - first - second - unmatched),
        inside=_inside(distance, trace.n >= 0, possible),
        wide=_wide(_mixtures(trace, w)),
    )


ROUNDING = 1e-20
"""Of the mean square of a sum of logarithms, the variance that rounding alone leaves."""


def innovation_statistics(trace: Trace) -> InnovationStatistics:
    """Predicted against actual innovations of the particles together."""
    m = _mixtures(trace, np.exp(trace.predicted.log_w))
    if not len(m.weight):
        return InnovationStatistics(math.nan, math.nan, 0.0)
    C = m.V + m.between
    cross = C[:, 0, 1] / C[:, 0, 0]
    first = m.v[:, 0] ** 2 / C[:, 0, 0]
    second = (m.v[:, 1] - cross * m.v[:, 0]) ** 2 / (C[:, 1, 1] - cross * C[:, 0, 1])
    count = float(m.weight.sum())
    return InnovationStatistics(float(m.weight @ first) / count, float(m.weight @ second) / count, count)


def innovation_widths(trace: Trace, R: Floats) -> Floats:
    """(Z,) deviation that the particles that matched an observation expect of it, over that of the sensor alone.

    The geometric mean of both components, (det V / det R)^1/4, with R (Z, 2, 2) as it is believed for known features: 1
    where pose and map add nothing, large where the pose is uncertain; NaN where nothing was matched.
    """
    m = _mixtures(trace, np.exp(trace.predicted.log_w))
    widths = np.full(len(R), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):  # NaN where V is as good as singular, and R may be
        widths[m.observation] = (np.linalg.det(m.V) / np.linalg.det(R[m.observation])) ** 0.25
    return widths


@kernel
def _sum_over_observations(w: Any, log_p: Any, n: Any, v: Any, V: Any, temper: Any, sums: Any) -> None:
    """Of each particle that counts: L, what the first and the second component of what it matched have in it,
    log N(v; 0, V) = log N(v_1; 0, V_11) + log N(v_2 | v_1), what it did not match, and its squared distances (25)."""
    for k in range(len(w)):
        if w[k] > 0.0:
            for i in range(log_p.shape[1]):
                sums[0, k] += log_p[k, i]
                if n[k, i] < 0:
                    sums[3, k] += log_p[k, i]
                    continue
                cross = V[k, i, 0, 1] / V[k, i, 0, 0]
                rest = V[k, i, 1, 1] - cross * V[k, i, 0, 1]
                near = v[k, i, 0] ** 2 / V[k, i, 0, 0]
                given = (v[k, i, 1] - cross * v[k, i, 0]) ** 2 / rest
                sums[1, k] -= 0.5 * temper * (LOG_TWO_PI + np.log(V[k, i, 0, 0]) + near)
                sums[2, k] -= 0.5 * temper * (LOG_TWO_PI + np.log(rest) + given)
                sums[4, k] += near + given


@kernel
def _covariances(weights: Any, parts: Any, out: Any) -> None:
    """Add `weights` (K,) times `parts` (K, Z), without those of weight zero, whose parts may be infinite."""
    for k in range(len(weights)):
        if weights[k] != 0.0:
            for i in range(len(out)):
                out[i] += weights[k] * parts[k, i]


def _inside(distance: Floats, matched: Bools, possible: Bools) -> float:
    """Squared distances (25) of a chain of updates sum to that of all of them together."""
    counts = matched.sum(axis=1)
    some = possible & (counts > 0)
    if not some.any():
        return math.nan
    gates = chi_square_gates(0.99, matched.shape[1])
    return float((distance <= gates[counts])[some].mean())


class Mixtures(NamedTuple):
    """The innovations of each observation that any particle has matched, over these particles."""

    observation: Ints
    """(m,) which observations these are."""
    weight: Floats
    """(m,) of them."""
    members: Floats
    """(m,) how many they are."""
    v: Floats
    """(m, 2) mean."""
    V: Floats
    """(m, 2, 2) mean of what each expects."""
    between: Floats
    """(m, 2, 2) covariance of the innovations between them."""


def _mixtures(trace: Trace, w: Floats) -> Mixtures:
    Z = trace.n.shape[1]
    weight, members, v, V, between = (
        np.zeros(Z),
        np.zeros(Z),
        np.zeros((Z, 2)),
        np.zeros((Z, 2, 2)),
        np.zeros((Z, 2, 2)),
    )
    _mix(w, trace.n, *trace.innovations, weight, members, v, V, between)
    matched = np.flatnonzero(weight)
    return Mixtures(matched, *(part[matched] for part in (weight, members, v, V, between)))


@kernel
def _mix(w: Any, n: Any, v: Any, V: Any, weight: Any, members: Any, mean: Any, expected: Any, between: Any) -> None:
    for i in range(len(weight)):
        for k in range(len(w)):
            if n[k, i] >= 0 and w[k] > 0.0:
                weight[i] += w[k]
                members[i] += 1.0
                for a in range(2):
                    mean[i, a] += w[k] * v[k, i, a]
                    for b in range(2):
                        expected[i, a, b] += w[k] * V[k, i, a, b]
        for a in range(2):
            mean[i, a] /= weight[i]
            for b in range(2):
                expected[i, a, b] /= weight[i]
        for k in range(len(w)):
            if n[k, i] >= 0 and w[k] > 0.0:
                for a in range(2):
                    for b in range(2):
                        off = (v[k, i, a] - mean[i, a]) * (v[k, i, b] - mean[i, b])
                        between[i, a, b] += w[k] * off / weight[i]


def _wide(mixed: Mixtures) -> tuple[float, float]:
    """Each observation counts by the weight of the particles that have matched it, if they are two at least."""
    several = mixed.members > 1
    if not several.any():
        return math.nan, math.nan
    between, expected = (np.diagonal(part[several], axis1=1, axis2=2) for part in (mixed.between, mixed.V))
    first, second = np.sqrt(np.average(between / expected, axis=0, weights=mixed.weight[several])).tolist()
    return first, second
