"""Marks that a filter leaves in the numbers of a step if it does not do what it should.

Each is a statement that holds for a right filter by construction, or an outcome with its chance; none asks how the
filter was made.  Only what a step reports is read: `signatures` says what they mean.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam.association import associate
from slam.checks import corrected_before, twins, undrawn
from slam.map_store import Maps
from slam.phases import noise_of_known, observation_noise
from slam.resampling import wants_resampling
from slam.types import NEW, Floats, Frame, Ints, ObservationNoise, Params, Particles, Trace

SAMPLE = 2
"""Particles that are looked at one by one, evenly spread over all."""

ROUNDING = 1e-9
"""Relative, or [rad]: two computations of one number differ by less."""


class Marks(NamedTuple):
    """Of one step of one filter.  All are floats, and NaN where there is nothing to tell."""

    unequal: float
    """After a resampling: how far log weights are from those of equal weights."""
    contradicted: float
    """How far log weight after - log weight before - log likelihood is from being the same for all particles, as a
    share of the largest number that is in it; inf for a weight of zero that was not zero and whose likelihood is
    not."""
    exponent: float
    """Natural logarithm of the largest product of all densities of a particle."""
    angle: float
    """[rad] largest angle of an innovation."""
    otherwise: float
    """Observations that a particle has paired although they are not within the gates, or has not although they are;
    of all in a sample of particles.  NaN of a single particle whose features have Gaussians: EKF-SLAM may be that."""
    early: float
    """Share of a sample of particles whose first innovation is that of a feature as the step leaves it, and not as the
    step found it."""
    undrawn: float
    """Share of the draws of this step that are exactly their mean, or exactly another one: of poses, of Dual FastSLAM's
    new features.  Only draws that floating point tells apart are counted (`slam.checks`)."""
    gained: float
    """How many features a map gained that were not new to its particle, or did not gain that were; the most."""
    twins: float
    """How many particles came to the corrected feature of another one, bit for bit, although it is not the correction
    of what they had before for the pose at which they are."""
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
    K, log_p = len(weighted.log_w), trace.log_likelihood.sum(axis=1)
    R = observation_noise(frame, params)
    R_known = noise_of_known(frame, R, params)
    sample = np.unique(np.linspace(0, K - 1, SAMPLE).astype(int))
    angles = np.abs(trace.innovations.v[..., 1])
    did, first_lived, first_expected = trace.did_resample, math.nan, math.nan
    if did and K > 1:
        first_lived = float((trace.selected == 0).any())
        first_expected = float(len(trace.selected) * np.exp(weighted.log_w[0]))
    gained = weighted.maps.counts - trace.predicted.maps.counts - (trace.n == NEW).sum(axis=1)
    return Marks(
        unequal=float(np.abs(after.log_w + math.log(len(after.log_w))).max()) if did else math.nan,
        contradicted=contradicted(trace.predicted.log_w, weighted.log_w, trace.log_likelihood),
        exponent=float(np.fmax.reduce(log_p)),
        angle=float(np.nanmax(angles)) if np.isfinite(angles).any() else math.nan,
        otherwise=_otherwise(trace, frame, R_known, params, sample),
        early=corrected_before(trace, frame, sample),
        undrawn=undrawn(trace, frame, R, params.believed),
        gained=float(np.abs(gained).max()),
        twins=twins(trace, frame, R_known),
        needless=float(not wants_resampling(trace.n_eff, K, params.resample_below)) if did else math.nan,
        first_lived=first_lived,
        first_expected=first_expected,
        misplaced=misplaced_first(np.exp(weighted.log_w), trace.selected, params) if did and K > 1 else math.nan,
    )


def contradicted(before: Floats, after: Floats, log_p: Floats) -> float:
    """`Marks.contradicted` of log weights (K,) and log likelihoods (K, Z); particles without a weight before, for which
    something is impossible, or that are impossible beside others, say nothing."""
    added = log_p.sum(axis=1)
    if (added == np.inf).any():
        return math.nan
    with np.errstate(over="ignore", invalid="ignore"):
        expected = before + added
        told = np.isfinite(expected - np.fmax.reduce(expected))
    if told.sum() < 2:
        return math.nan
    if not np.isfinite(after[told]).all():
        return math.inf
    off = after[told] - expected[told]
    parts = (np.abs(log_p[told]).sum(axis=1), np.abs(before[told]), np.abs(after[told]))
    return float((off.max() - off.min()) / (1.0 + sum(float(part.max()) for part in parts)))


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


def _may_be_joint(maps: Maps) -> bool:
    """EKF-SLAM pairs with all that features have to do with each other, which no particle knows: of one particle whose
    features have Gaussians nothing is said."""
    return len(maps) == 1 and bool(maps.features(0)[1].any())


def _otherwise(trace: Trace, frame: Frame, R: ObservationNoise, params: Params, sample: Ints) -> float:
    """Beside what pairing by the gates (27) says of the same poses and maps; which of the features is not compared."""
    if not trace.n.size or _may_be_joint(trace.predicted.maps):
        return math.nan
    expected = associate(_some(trace.predicted, sample), frame, R, params)
    return float((np.minimum(expected, 0) != np.minimum(trace.n[sample], 0)).sum())
