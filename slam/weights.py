"""Why weights differ: which observations part the particles, and what of them; and whether innovations are as expected.

Nothing here is seen by a filter.  All is of one step of one filter, and made for every step: so sums run over the
particles once, and what several functions need is an argument, `Mixtures`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from slam._jit import kernel
from slam.association.jcbb import chi_square_gates
from slam.linalg import LOG_TWO_PI, determinant22, load22
from slam.types import NEW, Floats, Ints, Trace


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
    """Share of the particles for which all they matched, together, lies within the 99 % gate, wider by what `temper`
    makes of it: the likelihood reaches them.  NaN where none has matched anything.

    Squared distances (25) of a chain of updates sum to chi-square with two degrees of freedom for each observation.
    Where all are taken at the predicted pose they share its error, and fewer than 99 % of a consistent filter's
    particles are inside: 97 to 90 % with two to six observations."""
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


class Mixtures(NamedTuple):
    """The innovations of each observation over the particles that have matched it, weighted as before the step.

    Zeros, and NaN for means, where no particle has.
    """

    weight: Floats
    """(Z,) of these particles."""
    members: Floats
    """(Z,) how many they are."""
    v: Floats
    """(Z, 2) mean."""
    V: Floats
    """(Z, 3) mean of what each expects: its elements 11, 12, 22."""
    between: Floats
    """(Z, 3) the same of the covariance of the innovations between them."""


def mixtures(trace: Trace) -> Mixtures:
    """Of one step."""
    return _mixtures(trace, np.exp(trace.predicted.log_w))


def _mixtures(trace: Trace, w: Floats) -> Mixtures:
    Z = trace.n.shape[1]
    mixed = Mixtures(np.zeros(Z), np.zeros(Z), np.zeros((Z, 2)), np.zeros((Z, 3)), np.zeros((Z, 3)))
    _mix(w, trace.n, *trace.innovations, mixed)
    return mixed


@kernel
def _mix(w: Any, n: Any, v: Any, V: Any, mixed: Any) -> None:
    """Adds to `mixed`, which is zero."""
    weight, members, mean, expected, between = mixed
    for k in range(len(w)):
        for i in range(len(weight)):
            if n[k, i] >= 0 and w[k] > 0.0:
                weight[i] += w[k]
                members[i] += 1.0
                mean[i, 0] += w[k] * v[k, i, 0]
                mean[i, 1] += w[k] * v[k, i, 1]
                expected[i, 0] += w[k] * V[k, i, 0, 0]
                expected[i, 1] += w[k] * V[k, i, 0, 1]
                expected[i, 2] += w[k] * V[k, i, 1, 1]
    for i in range(len(weight)):
        for a in range(2):
            mean[i, a] /= weight[i]
        for a in range(3):
            expected[i, a] /= weight[i]
    for k in range(len(w)):
        for i in range(len(weight)):
            if n[k, i] >= 0 and w[k] > 0.0:
                share, off_0, off_1 = w[k] / weight[i], v[k, i, 0] - mean[i, 0], v[k, i, 1] - mean[i, 1]
                between[i, 0] += share * off_0 * off_0
                between[i, 1] += share * off_0 * off_1
                between[i, 2] += share * off_1 * off_1


# Weights --------------------------------------------------------------------------------------------------------------


def weight_variance(trace: Trace, mixed: Mixtures | None = None) -> WeightVariance:
    """The parts of the variance of the log weights of one step, and what it says of the proposal.

    `mixed` are the mixtures of the step, if they are there already.
    """
    prior, (K, Z), nan = np.exp(trace.predicted.log_w), trace.n.shape, math.nan
    w, sums, shares = np.empty(K), np.zeros((5, K)), np.zeros(Z)
    possible = _possible(prior, trace.log_likelihood, w)
    if not possible:
        return WeightVariance(nan, np.full(Z, nan), nan, nan, nan, nan, nan, (nan, nan))
    some, inside = _sum_over_observations(
        w, trace.log_likelihood, trace.n, *trace.innovations, trace.temper, chi_square_gates(0.99, Z), sums
    )
    variance, first, second, unmatched, drawn = _covariances(w, trace.log_likelihood, sums, shares)
    if mixed is None or possible < K:
        mixed = _mixtures(trace, w)
    reached = inside / some if some else nan
    return WeightVariance(math.sqrt(variance), shares, first, second, unmatched, drawn, reached, _wide(mixed))


ROUNDING = 1e-20
"""Of the mean square of a sum of logarithms, the variance that rounding alone leaves."""


@kernel
def _possible(prior: Any, log_p: Any, w: Any) -> Any:
    """Into w (K,) the weights of the particles that are possible, normalised; returns how many they are."""
    count, total = 0, 0.0
    for k in range(len(prior)):
        possible = prior[k] > 0.0
        for i in range(log_p.shape[1]):
            possible &= np.isfinite(log_p[k, i])
        w[k] = prior[k] if possible else 0.0
        count += possible
        total += w[k]
    for k in range(len(prior)):
        w[k] /= total
    return count


@kernel
def _sum_over_observations(
    w: Any, log_p: Any, n: Any, v: Any, V: Any, temper: Any, gates: Any, sums: Any
) -> tuple[int, int]:
    """Of each particle that counts: L, what the first and the second component of what it matched have in it,
    log N(v; 0, V) = log N(v_1; 0, V_11) + log N(v_2 | v_1), and what it did not match.

    Returns how many have matched anything, and how many of these have all of it within the gate together.
    """
    some, inside = 0, 0
    for k in range(len(w)):
        if w[k] > 0.0:
            matched, distance = 0, 0.0
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
                matched += 1
                distance += near + given
            some += matched > 0
            inside += matched > 0 and temper * distance <= gates[matched]
    return some, inside


@kernel
def _covariances(w: Any, log_p: Any, sums: Any, shares: Any) -> Any:
    """Var(L), and the shares in it of the four sums that L has; into `shares` (Z,) those of observations."""
    mean, square, rest = 0.0, 0.0, 0.0
    for k in range(len(w)):
        mean += w[k] * sums[0, k]
        square += w[k] * sums[0, k] ** 2
    for k in range(len(w)):
        rest += w[k] * (sums[0, k] - mean)
    variance, first, second, unmatched, drawn = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(w)):
        if w[k] > 0.0:
            away = sums[0, k] - mean - rest  # twice: the sum may be large beside what it varies by
            weight = w[k] * away
            variance += weight * away
            first += weight * sums[1, k]
            second += weight * sums[2, k]
            unmatched += weight * sums[3, k]
            drawn += weight * (sums[0, k] - sums[1, k] - sums[2, k] - sums[3, k])
            for i in range(len(shares)):
                shares[i] += weight * log_p[k, i]
    whole = variance if variance > ROUNDING * square else np.nan
    for i in range(len(shares)):
        shares[i] /= whole
    return (
        (variance if variance > ROUNDING * square else 0.0),
        first / whole,
        second / whole,
        unmatched / whole,
        drawn / whole,
    )


@kernel
def _wide(mixed: Any) -> tuple[float, float]:
    """`WeightVariance.wide`: each observation counts by the weight of the particles that have matched it, if they are
    two at least."""
    total, first, second = 0.0, 0.0, 0.0
    for i in range(len(mixed.weight)):
        if mixed.members[i] > 1.0:
            total += mixed.weight[i]
            first += mixed.weight[i] * mixed.between[i, 0] / mixed.V[i, 0]
            second += mixed.weight[i] * mixed.between[i, 2] / mixed.V[i, 2]
    if total == 0.0:
        return np.nan, np.nan
    return math.sqrt(first / total), math.sqrt(second / total)


# Innovations ----------------------------------------------------------------------------------------------------------


def innovation_statistics(mixed: Mixtures) -> InnovationStatistics:
    """Predicted against actual innovations of the particles together."""
    return InnovationStatistics(*_innovation_statistics(mixed))


@kernel
def _innovation_statistics(mixed: Any) -> tuple[float, float, float]:
    first, second, count = 0.0, 0.0, 0.0
    for i in range(len(mixed.weight)):
        weight, (v_0, v_1) = mixed.weight[i], (mixed.v[i, 0], mixed.v[i, 1])
        if weight > 0.0:
            C_00 = mixed.V[i, 0] + mixed.between[i, 0]
            C_01 = mixed.V[i, 1] + mixed.between[i, 1]
            C_11 = mixed.V[i, 2] + mixed.between[i, 2]
            cross = C_01 / C_00
            first += weight * v_0**2 / C_00
            second += weight * (v_1 - cross * v_0) ** 2 / (C_11 - cross * C_01)
            count += weight
    return first / count, second / count, count


def innovation_widths(mixed: Mixtures, R: Floats) -> Floats:
    """(Z,) deviation that the particles that matched an observation expect of it, over that of the sensor alone.

    The geometric mean of both components, (det V / det R)^1/4, with R (Z, 2, 2) as it is believed for known features: 1
    where pose and map add nothing, large where the pose is uncertain; NaN where nothing was matched, or V is as good as
    singular.
    """
    widths = np.full(len(R), np.nan)
    _innovation_widths(mixed, R, widths)
    return widths


@kernel
def _innovation_widths(mixed: Any, R: Any, widths: Any) -> None:
    for i in range(len(widths)):
        if mixed.weight[i] > 0.0:
            V = ((mixed.V[i, 0], mixed.V[i, 1]), (mixed.V[i, 1], mixed.V[i, 2]))
            widths[i] = (determinant22(V) / determinant22(load22(R[i]))) ** 0.25


# What was before, and what was left -----------------------------------------------------------------------------------


def weights_before(trace: Trace) -> tuple[float, float]:
    """N_eff (44) of the weights that the step began with, and how many observations were new, a particle's on the
    average."""
    return _weights_before(np.exp(trace.predicted.log_w), trace.n)


@kernel
def _weights_before(w: Any, n: Any) -> tuple[float, float]:
    square, new = 0.0, 0.0
    for k in range(len(w)):
        square += w[k] * w[k]
        for i in range(n.shape[1]):
            new += w[k] * (n[k, i] == NEW)
    return 1.0 / square, new


def parents(ancestors: Ints) -> tuple[int, float]:
    """How many particles of before have a descendant, and of all pairs of the particles after the step (K',) the share
    that has one parent: sum N (N - 1) / (K' (K' - 1))."""
    count = len(ancestors)
    survivors, pairs = _parents(ancestors, np.zeros(int(ancestors.max()) + 1, np.int64))
    return survivors, pairs / (count * (count - 1.0)) if count > 1 else math.nan


@kernel
def _parents(ancestors: Any, children: Any) -> Any:
    """children (K,) is zero."""
    survivors, pairs = 0, 0
    for k in ancestors:
        survivors += children[k] == 0
        pairs += 2 * children[k]
        children[k] += 1
    return survivors, pairs
