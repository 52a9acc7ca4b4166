"""Marks that a filter leaves in the numbers of a step if it does not do what it should.

Each is a statement that holds for a right filter by construction, or an outcome with its chance; none asks how the
filter was made.  Only what a step reports is read: `signatures` says what they mean.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from slam.association import associate
from slam.checks import (
    contradiction,
    corrected_before,
    disagreement,
    inequality,
    largest_angle,
    miscount,
    misplaced_first,
    twins,
    undrawn,
)
from slam.map_store import Maps
from slam.phases import noise_of_known, observation_noise
from slam.resampling import wants_resampling
from slam.types import Frame, Ints, ObservationNoise, Params, Particles, Trace

SAMPLE = 2
"""Particles that are looked at one by one, evenly spread over all."""


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
    predicted, weighted, after, did = trace.predicted, trace.weighted, trace.resampled, trace.did_resample
    K, several = len(weighted.log_w), did and len(weighted.log_w) > 1
    R = observation_noise(frame, params)
    R_known, sample = noise_of_known(frame, R, params), _sample(K)
    contradicted, exponent = contradiction(predicted.log_w, weighted.log_w, trace.log_likelihood)
    w = np.exp(weighted.log_w)
    return Marks(
        unequal=inequality(after.log_w) if did else math.nan,
        contradicted=contradicted,
        exponent=exponent,
        angle=largest_angle(trace.innovations.v),
        otherwise=_otherwise(trace, frame, R_known, params, sample),
        early=corrected_before(trace, frame, sample),
        undrawn=undrawn(trace, frame, R, params.believed),
        gained=float(miscount(predicted.maps.counts, weighted.maps.counts, trace.n)),
        twins=twins(trace, frame, R_known),
        needless=float(not wants_resampling(trace.n_eff, K, params.resample_below)) if did else math.nan,
        first_lived=float((trace.selected == 0).any()) if several else math.nan,
        first_expected=float(len(trace.selected) * w[0]) if several else math.nan,
        misplaced=misplaced_first(w, trace.selected, params.resampler) if several else math.nan,
    )


@functools.cache
def _sample(K: int) -> Ints:
    return np.unique(np.linspace(0, K - 1, SAMPLE).astype(int))


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
    return float(disagreement(trace.n, sample, expected))
