"""Marks that a filter leaves in the numbers of a step if it does not do what it should.

Each is a statement that holds for a right filter by construction, or an outcome with its chance; none asks how the
filter was made.  Only what a step reports is read: `signatures` says what they mean.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam.association import associate
from slam.features import innovation, inverse
from slam.geometry import wrap
from slam.phases import noise_of_known, observation_noise, predict
from slam.resampling import effective_sample_size, wants_resampling
from slam.types import NEW, Floats, Frame, Ints, Params, Particles, Trace

SAMPLE = 2
"""Particles that are looked at one by one, evenly spread over all."""

NOTICED = 1e-5
"""[standard deviations] What is more is no rounding."""

MANY = 256
"""Particles among which copies are looked for."""

ROUNDING = 1e-9
"""[m, rad, standard deviations] Two computations of one number differ by less."""


class Marks(NamedTuple):
    """Of one step of one filter.  All are floats, and NaN where there is nothing to tell."""

    unequal: float
    """After a resampling: how far log weights are from those of equal weights."""
    contradicted: float
    """How far log weight after - log weight before - log likelihood is from being the same for all particles, as a
    share of the largest log likelihood; inf for a weight of zero that was not zero and whose likelihood is not."""
    exponent: float
    """Natural logarithm of the largest product of all densities of a particle."""
    angle: float
    """[rad] largest angle of an innovation."""
    otherwise: float
    """Observations that a particle has paired although they are not within the gates, or has not although they are;
    of all in a sample of particles."""
    early: float
    """Share of a sample of particles whose first innovation is that of a feature as the step leaves it, and not as the
    step found it."""
    undrawn: float
    """Share of the draws of this step that are exactly their mean: of poses, of Dual FastSLAM's new features."""
    gained: float
    """How many features a map gained that were not new to its particle, or did not gain that were; the most."""
    twins: float
    """By how many the distinct poses that have corrected a feature exceed the distinct results, or 0."""
    needless: float
    """Whether it was resampled although N_eff was not below the threshold; 1 or 0."""
    first_lived: float
    """Whether the first particle outlived a resampling; 1 or 0."""
    first_expected: float
    """How many copies of it were to be expected: at least the chance of that."""
    misplaced: float
    """Whether the first particle is in a place that the resampling scheme cannot but have given to another one, by all
    the other places; 1 or 0, and NaN where the scheme allows it."""


def marks_of(trace: Trace, frame: Frame, params: Params) -> Marks:
    """The marks of one step; frame and parameters are those that the filter was given."""
    weighted, after = trace.weighted, trace.resampled
    log_p = trace.log_likelihood.sum(axis=1)
    K, n_eff = len(weighted.log_w), effective_sample_size(weighted.log_w)
    sample = np.unique(np.linspace(0, K - 1, SAMPLE).astype(int))
    angles = np.abs(trace.innovations.v[..., 1])
    did, first_lived, first_expected = trace.did_resample, math.nan, math.nan
    if did and K > 1:
        first_lived = float((trace.selected == 0).any())
        first_expected = float(len(trace.selected) * np.exp(weighted.log_w[0]))
    gained = weighted.maps.counts - trace.predicted.maps.counts - (trace.n == NEW).sum(axis=1)
    return Marks(
        unequal=float(np.abs(after.log_w + math.log(len(after.log_w))).max()) if did else math.nan,
        contradicted=_contradicted(trace.predicted.log_w, weighted.log_w, log_p),
        exponent=float(log_p.max(initial=-math.inf)),
        angle=float(np.nanmax(angles)) if np.isfinite(angles).any() else math.nan,
        otherwise=_otherwise(trace, frame, params, sample),
        early=_early(trace, frame, sample),
        undrawn=_undrawn(trace, frame, params, sample),
        gained=float(np.abs(gained).max()),
        twins=_twins(trace),
        needless=float(not wants_resampling(n_eff, K, params.resample_below)) if did else math.nan,
        first_lived=first_lived,
        first_expected=first_expected,
        misplaced=misplaced_first(np.exp(weighted.log_w), trace.selected, params) if did and K > 1 else math.nan,
    )


def _contradicted(before: Floats, after: Floats, log_p: Floats) -> float:
    """`Marks.contradicted`; particles without a weight before, or for which something is impossible, say nothing."""
    told = np.isfinite(before) & np.isfinite(log_p)
    if told.sum() < 2 or (log_p == np.inf).any():
        return math.nan
    if not np.isfinite(after[told]).all():
        return math.inf
    off = after[told] - before[told] - log_p[told]
    return float((off.max() - off.min()) / (1.0 + np.abs(log_p[told]).max()))


def misplaced_first(w: Floats, selected: Ints, params: Params) -> float:
    """`Marks.misplaced`.  Systematic resampling has one random number u, and place j is given to the particle in whose
    share of the weights (j + u) / K lies: so each place says from where to where u is.  Residual resampling makes the
    whole part of the expected number of copies for certain."""
    K = len(selected)
    if params.resampler == "systematic":
        ends = K * np.concatenate([[0.0], np.cumsum(w) / w.sum()])
        low, high = ends[selected] - np.arange(K), ends[selected + 1] - np.arange(K)
        from_others = low[1:].max(initial=0.0), high[1:].min(initial=1.0)
        possible = from_others[0] <= from_others[1] + K * ROUNDING
        return float(selected[0] == 0 and possible and from_others[0] > high[0] + K * ROUNDING)
    if params.resampler == "residual":
        certain = np.floor(K * w - K * ROUNDING)
        return float(selected[0] == 0 and (np.bincount(selected, minlength=len(w)) < certain).any())
    return math.nan


def _some(particles: Particles, sample: Ints) -> Particles:
    s, P, log_w, lineage, maps = particles
    return Particles(s[sample], P[sample], log_w[sample], lineage[sample], maps.select(sample))


def _is_joint(trace: Trace) -> bool:
    """EKF-SLAM: one particle with a pose Gaussian whose features have Gaussians as well."""
    maps = trace.weighted.maps
    return len(maps) == 1 and bool(trace.resampled.P.any()) and bool(maps.features(0)[1].any())


def _otherwise(trace: Trace, frame: Frame, params: Params, sample: Ints) -> float:
    """Beside what pairing by the gates (27) says of the same poses and maps; which of the features is not compared."""
    if not trace.n.size or _is_joint(trace):
        return math.nan
    R = noise_of_known(frame, observation_noise(frame, params), params)
    expected = associate(_some(trace.predicted, sample), frame, R, params)
    return float((np.minimum(expected, 0) != np.minimum(trace.n[sample], 0)).sum())


def _early(trace: Trace, frame: Frame, sample: Ints) -> float:
    """The first observation that a particle has matched is weighed at the predicted pose, in all filters."""
    looked = early = 0
    for k in sample:
        matched = np.flatnonzero(trace.n[k] >= 0)
        if not len(matched) or (trace.merged is not None and (trace.merged[k] >= 0).any()):
            continue
        i = int(matched[0])
        (v, V), n = (part[k, i] for part in trace.innovations), trace.n[k : k + 1, i : i + 1]
        off = []
        for maps in (trace.predicted.maps, trace.weighted.maps):
            theta = maps.select(np.array([k])).take(n)[0][0, 0]
            expected, _, _ = innovation(frame.feature, theta, trace.predicted.s[k], frame.z[i])
            error = (v[0] - expected[0]) / math.sqrt(V[0, 0]), wrap(v[1] - expected[1]) / math.sqrt(V[1, 1])
            off.append(max(map(abs, error)))
        looked += 1
        early += off[0] > NOTICED and off[1] < ROUNDING
    return early / looked if looked else math.nan


def _undrawn(trace: Trace, frame: Frame, params: Params, sample: Ints) -> float:
    weighted, after = trace.weighted, trace.resampled
    if after.P.any():
        return _undrawn_features(trace, frame, sample)
    if weighted.P.any():
        means, uncertain = weighted.s[trace.selected], weighted.P[trace.selected].any(axis=(1, 2))
        return float((after.s == means).all(axis=1)[uncertain].mean())
    K = len(weighted.s)
    one = _some(after, np.zeros(1, int))
    if K == 1 or not predict(one, frame, params.believed).P.any():
        return math.nan  # the controls are exact, or there is nobody to differ from
    return (K - _distinct(trace.predicted.s)) / (K - 1)


def _undrawn_features(trace: Trace, frame: Frame, sample: Ints) -> float:
    """Of the first new feature of each particle: the pose is that of `Trace.weighted` still."""
    looked = undrawn = 0
    for k in sample:
        new = np.flatnonzero(trace.n[k] == NEW)
        before = int(trace.predicted.maps.counts[k])
        if not len(new) or trace.weighted.maps.counts[k] <= before:
            continue
        theta, Sigma = trace.weighted.maps.select(np.array([k])).take(np.array([[before]]))
        if Sigma.any():
            continue  # what keeps its covariance is not drawn
        mean, _, _ = inverse(frame.feature, trace.weighted.s[k], frame.z[new[0]])
        looked += 1
        undrawn += bool(np.abs(theta[0, 0] - mean).max() < ROUNDING)
    return undrawn / looked if looked else math.nan


def _twins(trace: Trace) -> float:
    """Of the observation that most particles have matched, where features are corrected at all."""
    matched = trace.n >= 0
    if not matched.any():
        return math.nan
    i = int(matched.sum(axis=0).argmax())
    some = np.flatnonzero(matched[:, i])[:MANY]
    theta, Sigma = trace.weighted.maps.select(some).take(trace.n[some, i : i + 1])
    if not Sigma.any():
        return math.nan
    return float(max(_distinct(trace.weighted.s[some]) - _distinct(theta[:, 0, :3]), 0))


def _distinct(rows: Floats) -> int:
    """How many of the rows (n, m), m up to 3, differ; told apart by a sum with factors that no symmetry has."""
    sums = np.sort(rows @ np.array([1.0, 0.7548776662466927, 0.5698402909980532])[: rows.shape[1]])
    return 1 + int(np.count_nonzero(np.diff(sums)))
