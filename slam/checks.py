"""Parts of a step done again from what its `Trace` has, and copies among what should differ.

Nothing is known of the filter but what it reports.  All of it is bit for bit what the phases compute (`slam.phases`),
and where numbers may be alike because floating point knows no others in between, nothing is said.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slam._jit import inline, kernel
from slam.features import draw, innovation, inverse, total
from slam.geometry import wrap
from slam.linalg import (
    add22,
    add_outer_scaled,
    kalman_feature,
    load3,
    load22,
    load33,
    log_density,
    sandwich22,
    sandwich23,
    sandwich33,
)
from slam.map_store import LEAF, leaf_of
from slam.motion import deviation, propagate
from slam.types import NEW, Floats, Frame, Ints, Noise, ObservationNoise, ResamplerName, Trace

ULP = 2.0**-52
"""Relative: the distance of two neighbouring numbers."""

COARSE = 1e6
"""Units in the last place.  Numbers that differ by less, or draws that have a smaller deviation, may be alike by
rounding, or because there are no others in between."""

NOTICED = 1e-5
"""[standard deviations] What is more is no rounding."""

ROUNDING = 1e-9
"""Relative, [rad], or [standard deviations]: two computations of one number differ by less."""

MANY = 128
"""Particles among which copies are looked for."""

SEVERAL = 8
"""Particles of which the draw of a new feature is looked at."""

LEAST = 2
"""Draws from which on something is said: one may be alike by chance, once in a long run."""

_NOBODY = np.zeros((0, 0), np.int64)


# Weights --------------------------------------------------------------------------------------------------------------


@kernel
def inequality(log_w: Any) -> float:
    """How far log weights (K,) are from those of equal weights, at the most."""
    equal, most = -math.log(len(log_w)), 0.0
    for k in range(len(log_w)):
        most = max(most, abs(log_w[k] - equal))
    return most


def contradiction(before: Floats, after: Floats, log_p: Floats) -> tuple[float, float]:
    """How far log weights (K,) after a step are from those before and the log likelihoods (K, Z), but for a constant,
    as a share of the largest number that is in them; and the largest sum of log likelihoods.

    Particles without a weight before, for which something is impossible, or that are impossible beside others, say
    nothing.  NaN where less than two say anything; infinite for a weight of zero that should be none.
    """
    return _contradiction(before, after, log_p, np.empty(len(before)))


@kernel
def _contradiction(before: Any, after: Any, log_p: Any, expected: Any) -> tuple[float, float]:
    exponent, likeliest, certain = -np.inf, -np.inf, False
    for k in range(len(before)):
        total = 0.0
        for i in range(log_p.shape[1]):
            total += log_p[k, i]
        exponent = total if total > exponent else exponent
        expected[k] = before[k] + total
        certain |= total == np.inf or expected[k] == np.inf
        if np.isfinite(expected[k]) and expected[k] > likeliest:
            likeliest = expected[k]
    told, lost, low, high, added, earlier, later = 0, False, np.inf, -np.inf, 0.0, 0.0, 0.0
    for k in range(len(before)):
        if np.isfinite(expected[k] - likeliest):
            parts = 0.0
            for i in range(log_p.shape[1]):
                parts += abs(log_p[k, i])
            told += 1
            lost |= not np.isfinite(after[k])
            low, high = min(low, after[k] - expected[k]), max(high, after[k] - expected[k])
            added, earlier, later = max(added, parts), max(earlier, abs(before[k])), max(later, abs(after[k]))
    if told < 2 or certain:
        return np.nan, exponent
    return (np.inf if lost else (high - low) / (1.0 + added + earlier + later)), exponent


def misplaced_first(w: Floats, selected: Ints, resampler: ResamplerName) -> float:
    """Whether the first particle is in a place that the scheme gives to another one, by weights (K,) and the particles
    (K',) in all other places; 1 or 0, and NaN for a scheme that may always give it to the first.

    Systematic resampling has one random number u, and place j is given to the particle in whose share of the weights
    (j + u) / K lies: so each place says from where to where u is.  Residual resampling makes the whole part of the
    expected number of copies for certain.
    """
    if resampler not in ("systematic", "residual"):
        return math.nan
    if selected[0] != 0:
        return 0.0
    if resampler == "systematic":
        return float(_misplaced_by_stride(w, selected, np.empty(len(w) + 1)))
    return float(_misplaced_by_count(w, selected, np.zeros(len(w), np.int64)))


@kernel
def _misplaced_by_stride(w: Any, selected: Any, ends: Any) -> bool:
    K = len(selected)
    ends[0] = 0.0
    for k in range(len(w)):
        ends[k + 1] = ends[k] + w[k]
    for k in range(len(ends)):
        ends[k] *= K / ends[-1]
    low, high = 0.0, 1.0
    for j in range(1, K):
        low, high = max(low, ends[selected[j]] - j), min(high, ends[selected[j] + 1] - j)
    return low <= high + K * ROUNDING and low > ends[1] + K * ROUNDING


@kernel
def _misplaced_by_count(w: Any, selected: Any, copies: Any) -> bool:
    few = False
    for k in selected:
        copies[k] += 1
    for k in range(len(w)):
        few |= copies[k] < math.floor(len(selected) * w[k] - len(selected) * ROUNDING)
    return few


# Innovations ----------------------------------------------------------------------------------------------------------


@kernel
def largest_angle(v: Any) -> float:
    """[rad] of the second components of innovations (K, Z, 2); NaN where there is none."""
    most, found = -1.0, False
    for k in range(v.shape[0]):
        for i in range(v.shape[1]):
            angle = abs(v[k, i, 1])
            found |= np.isfinite(angle)
            most = angle if angle > most else most
    return most if found else np.nan


@kernel
def disagreement(n: Any, sample: Any, expected: Any) -> int:
    """How many observations a sample (m,) of particles has paired, of n (K, Z), where others (m, Z) are expected not to
    be, and the other way round; new and ignored are two things, and which feature it is does not matter."""
    count = 0
    for m in range(len(sample)):
        for i in range(n.shape[1]):
            count += min(n[sample[m], i], 0) != min(expected[m, i], 0)
    return count


def corrected_before(trace: Trace, frame: Frame, sample: Ints) -> float:
    """Share of a sample (m,) of particles whose first innovation is that of a feature as the step leaves it.

    The first observation that a particle has matched is weighed at the predicted pose, in all filters, and so its
    innovation is that of the feature as the step found it.  NaN where none of them has matched anything.
    """
    if not trace.n.size:
        return math.nan
    found, left = trace.predicted.maps, trace.weighted.maps
    told, early = _corrected_before(
        frame.feature, found.store.pool, found.roots, found.depth, left.roots, left.depth, trace.predicted.s, frame.z,
        trace.n, _merged(trace), *trace.innovations, sample,
    )  # fmt: skip
    return early / told if told else math.nan


def _merged(trace: Trace) -> Ints:
    return _NOBODY if trace.merged is None else trace.merged


@inline
def _entry(pool: Any, root: Any, depth: Any, j: Any) -> Any:
    """theta and more in a row of the pool, and Sigma, of feature j."""
    row, dim = pool.data[leaf_of(pool, root, depth, j), j & (LEAF - 1)], pool.data.shape[2] - 4
    return row, ((row[dim], row[dim + 1]), (row[dim + 1], row[dim + 2]))


@inline
def _has_merged(merged: Any, k: Any) -> Any:
    """Whether particle k has made one feature of two; merged is empty where nobody ever does."""
    found = False
    if len(merged):
        for other in merged[k]:
            found |= other >= 0
    return found


@kernel
def _corrected_before(
    feature: Any, pool: Any, found: Any, found_depth: Any, left: Any, left_depth: Any, s: Any, z: Any, n: Any,
    merged: Any, v: Any, V: Any, sample: Any,
) -> Any:  # fmt: skip
    """How many tell something, and how many of them were corrected before."""
    told, early = 0, 0
    for k in sample:
        i = 0
        while i < len(z) and n[k, i] < 0:
            i += 1
        if i == len(z) or _has_merged(merged, k):
            continue
        sk, there = load3(s[k]), n[k, i]
        before, _ = _entry(pool, found[k], found_depth, there)
        after, _ = _entry(pool, left[k], left_depth, there)
        (a0, a1), _, _ = innovation(feature, before, sk, z[i])
        (b0, b1), _, _ = innovation(feature, after, sk, z[i])
        a0, a1, b0, b1 = abs(v[k, i, 0] - a0), abs(wrap(v[k, i, 1] - a1)), v[k, i, 0] - b0, wrap(v[k, i, 1] - b1)
        d0, d1 = math.sqrt(V[k, i, 0, 0]), math.sqrt(V[k, i, 1, 1])
        size = max(abs(sk[0]), abs(sk[1]), abs(before[0]), abs(before[1]), abs(z[i, 0]), math.pi)
        told += 1
        apart = (a0 > NOTICED * d0 or a1 > NOTICED * d1) and max(a0, a1) > COARSE * ULP * size
        early += apart and abs(b0) < ROUNDING * d0 and abs(b1) < ROUNDING * d1
    return told, early


# Draws ----------------------------------------------------------------------------------------------------------------


def undrawn(trace: Trace, frame: Frame, R: ObservationNoise, believed: Noise) -> float:
    """Share of the draws of this step that are exactly their mean, or exactly another one.

    R is the honest one.  Of poses; of new features, where a pose keeps its Gaussian.  NaN where less than `LEAST` were
    drawn from something that floating point can tell apart from its mean: exact controls, for one thing.
    """
    predicted, weighted, after = trace.predicted, trace.weighted, trace.resampled
    if uncertain(after.P):
        found, left = predicted.maps, weighted.maps
        told, alike = _undrawn_features(
            frame.feature, left.store.pool, left.roots, left.depth, found.counts, left.counts, weighted.s, weighted.P,
            trace.n, frame.z, R,
        )  # fmt: skip
    elif uncertain(predicted.P):
        told, alike = _undrawn_poses(weighted.s, weighted.P, after.s, trace.selected)
    else:
        sigma = deviation(frame.motion, frame.u, believed)
        fine = np.where(sigma > COARSE * ULP * np.abs(frame.u), sigma, 0.0)
        told, alike = _copied_poses(frame.motion, frame.u, frame.dt, fine, predicted.s)
    return alike / told if told >= LEAST else math.nan


@kernel
def uncertain(P: Any) -> bool:
    """Whether any of the covariances (K, 3, 3) is not zero."""
    k = 0
    while k < len(P) and P[k, 0, 0] == 0.0 and P[k, 1, 1] == 0.0 and P[k, 2, 2] == 0.0:
        k += 1
    return k < len(P)


@kernel
def _undrawn_features(
    feature: Any, pool: Any, roots: Any, depth: Any, found: Any, left: Any, s: Any, P: Any, n: Any, z: Any, R: Any
) -> Any:
    """Of the first new feature of each particle: the pose is that of `Trace.weighted` still."""
    told, alike, model = 0, 0, load22(R.model)
    for k in range(len(s)):
        i = 0
        while i < len(z) and n[k, i] != NEW:
            i += 1
        if i == len(z) or left[k] <= found[k]:
            continue
        theta, Sigma = _entry(pool, roots[k], depth, found[k])
        if Sigma[0][0] != 0.0 or Sigma[1][1] != 0.0:
            continue  # what keeps its covariance is not drawn
        sk, Pk = load3(s[k]), load33(P[k])
        mean, F_s, F_z = inverse(feature, sk, z[i])
        _, _, G_theta = innovation(feature, mean, sk, z[i])
        Ri = total(feature, load22(R.sensor[i]), G_theta, model)
        V = add22(sandwich23(F_s, Pk), sandwich22(F_z, Ri))
        one = draw(feature, mean, (math.sqrt(max(V[0][0], 0.0)), 0.0))
        other = draw(feature, mean, (0.0, math.sqrt(max(V[1][1], 0.0))))
        wide, same = False, True
        for m in range(len(mean)):
            off = max(abs(one[m] - mean[m]), abs(other[m] - mean[m]))
            wide |= off > COARSE * ULP * max(abs(mean[m]), abs(sk[m]) if m < 3 else 0.0)
            same &= theta[m] == mean[m]
        told += wide
        alike += wide and same
        if told == SEVERAL:
            break
    return told, alike


@kernel
def _undrawn_poses(mean: Any, P: Any, s: Any, selected: Any) -> Any:
    """Of the poses of those that live on; copies have the draw of the one that they are copies of."""
    told, alike = 0, 0
    for j in range(len(selected)):
        k = selected[j]
        if j > 0 and selected[j - 1] == k:
            continue
        wide, same = False, True
        for m in range(3):
            wide |= math.sqrt(max(P[k, m, m], 0.0)) > COARSE * ULP * abs(mean[k, m])
            same &= s[j, m] == mean[k, m]
        told += wide
        alike += wide and same
        if told == MANY:
            break
    return told, alike


@kernel
def _copied_poses(motion: Any, u: Any, dt: Any, sigma: Any, s: Any) -> Any:
    """Of poses that the controls were drawn for: how many there are beside the first, and are like one before.

    The deviation, without what controls of that size cannot show, is that of one particle: a turn of the world does not
    change it.
    """
    K, P, end = min(len(s), MANY), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), load3(s[0])
    for t in range(len(dt)):
        end, H_s, H_u = propagate(motion, end, u[t], dt[t])
        P = add_outer_scaled(sandwich33(H_s, P), H_u, sigma[t])
    size = max(abs(end[0]), abs(end[1]))
    for k in range(K):
        size = max(size, abs(s[k, 0]), abs(s[k, 1]))
    if not (math.sqrt(P[0][0] + P[1][1]) > COARSE * ULP * size or math.sqrt(P[2][2]) > COARSE * ULP * math.pi):
        return 0, 0
    alike = 0
    for b in range(1, K):
        for a in range(b):
            if _same(s[a], s[b]):
                alike += 1
                break
    return K - 1, alike


@inline
def _same(a: Any, b: Any) -> Any:
    """Whether two rows of numbers are equal."""
    m = 0
    while m < len(a) and a[m] == b[m]:
        m += 1
    return m == len(a)


# Maps -----------------------------------------------------------------------------------------------------------------


@kernel
def miscount(found: Any, left: Any, n: Any) -> int:
    """By how much the features that a map gained, from found (K,) to left (K,), differ from what was new to its
    particle; n (K, Z)."""
    most = 0
    for k in range(len(n)):
        gained = left[k] - found[k]
        for i in range(n.shape[1]):
            gained -= n[k, i] == NEW
        most = max(most, abs(gained))
    return most


def twins(trace: Trace, frame: Frame, R: ObservationNoise) -> float:
    """How many particles came to the corrected feature of another one that they should not have come to.

    R is that of known features.  Looked at is the observation that most have matched.  Two that have the same numbers
    are counted where the correction of what each of them had before, for its own pose, gives others: at the pose that
    they were predicted at, and at the one that they have now.  NaN where features are not corrected.
    """
    predicted, after, n = trace.predicted, trace.resampled, trace.n
    if not n.size or uncertain(after.P):
        return math.nan
    before, left = predicted.maps, trace.weighted.maps
    who, there = np.empty(MANY, np.int64), np.empty((MANY, min(left.store.dim, 3)))
    matched, pool = np.zeros(n.shape[1], np.int64), left.store.pool
    i, count = _correctors(pool, left.roots, left.depth, n, _merged(trace), trace.selected, matched, who, there)
    if not count:
        return math.nan
    return float(
        _twins(
            frame.feature, pool, before.roots, before.depth, n, predicted.s, after.s, trace.selected, i, frame.z, R,
            who[:count], there,
        )
    )  # fmt: skip


@kernel
def _correctors(
    pool: Any, roots: Any, depth: Any, n: Any, merged: Any, selected: Any, matched: Any, who: Any, there: Any
) -> tuple[int, int]:
    """The observation i that most have matched, and how many particles are looked at that have corrected its feature.

    Into `who` their places, one of each, and into `there` what the feature is now in what a correction changes, or
    turns; matched (Z,) is zero.
    """
    count = 0
    for k in range(len(n)):
        for i in range(len(matched)):
            matched[i] += n[k, i] >= 0
    i = int(np.argmax(matched))
    for j in range(len(selected)):
        k = selected[j]
        if count == len(who) or (j > 0 and selected[j - 1] == k) or n[k, i] < 0 or _has_merged(merged, k):
            continue
        row, _ = _entry(pool, roots[k], depth, n[k, i])
        for m in range(there.shape[1]):
            there[count, m] = row[m]
        who[count] = j
        count += 1
    return i, count


@kernel
def _twins(
    feature: Any, pool: Any, roots: Any, depth: Any, n: Any, predicted: Any, after: Any, selected: Any, i: Any, z: Any,
    R: Any, who: Any, there: Any,
) -> Any:  # fmt: skip
    count, sensor, model = 0, load22(R.sensor[i]), load22(R.model)
    for b in range(1, len(who)):
        for a in range(b):
            k, its = selected[who[b]], selected[who[a]]
            if not _same(there[a], there[b]) or k == its:
                continue
            theta, Sigma = _entry(pool, roots[k], depth, n[k, i])
            other, Sigma_other = _entry(pool, roots[its], depth, n[its, i])
            apart = True
            for s, s_other in ((predicted[k], predicted[its]), (after[who[b]], after[who[a]])):
                one = _corrected(feature, theta, Sigma, load3(s), z[i], sensor, model)
                two = _corrected(feature, other, Sigma_other, load3(s_other), z[i], sensor, model)
                apart &= _differ(one, two)
            count += apart
            break
    return count


@inline
def _corrected(feature: Any, theta: Any, Sigma: Any, s: Any, z: Any, R: Any, model: Any) -> Any:
    """theta after the EKF of a feature, given the pose s (`slam.phases.update_features`)."""
    v, _, G_theta = innovation(feature, theta, s, z)
    R = total(feature, R, G_theta, model)
    V = add22(sandwich22(G_theta, Sigma), R)
    delta = (0.0, 0.0)
    if log_density(v, V) > -np.inf:
        delta, _ = kalman_feature(Sigma, v, G_theta, R, V)
    return draw(feature, theta, delta)


@inline
def _differ(a: Any, b: Any) -> Any:
    """Whether two features differ by more than rounding makes them."""
    apart = False
    for m in range(min(len(a), 3)):
        apart |= abs(a[m] - b[m]) > COARSE * ULP * max(abs(a[m]), abs(b[m]))
    return apart
