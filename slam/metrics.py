"""How good an estimate is: errors, consistency, and with `slam.scores` what the map is worth.

One function, one measure.  `measure` puts them together for one step of one filter.  Whatever needs a truth
that nobody knows is NaN.  Nothing here is seen by a filter.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from scipy.special import gammaincinv

from slam.genealogy import Genealogy, diversity
from slam.geometry import circular_mean, wrap, wrap_all
from slam.scores import association_score, scores_of
from slam.types import Floats, Frame, Ints, Trace

ROUNDING = 1e-13
"""Relative: smaller eigenvalues of a covariance are rounding errors.  1 m against 0.3 micrometres."""


class MapTruth(Protocol):
    """The landmarks or walls as they are; `scenarios.types.TrueMap` is one."""

    @property
    def tags(self) -> Ints:
        """(n,)"""
        ...

    @property
    def theta(self) -> Floats:
        """(n, 2) x y, or (n, 4) x0 y0 x1 y1 [m]"""
        ...


class Measures(NamedTuple):
    """One filter after one step."""

    estimate: Floats
    """(3,) [m, m, rad] mean of the mixture of `Trace.weighted`."""
    covariance: Floats
    """(3, 3) of that mixture, between and within particles."""
    best: int
    """Index in `Trace.weighted` of the heaviest particle."""
    position_error_m: float
    """Distance of the estimate from the truth."""
    heading_error_rad: float
    """Absolute difference on the circle; NaN also where only the true heading is unknown."""
    best_position_error_m: float
    """Distance of the best particle from the truth."""
    nees_position: float
    """NEES of (x, y), 2 degrees of freedom; inf for a collapsed mixture."""
    nees_pose: float
    """NEES of (x, y, heading), 3 degrees of freedom; inf for a collapsed mixture."""
    nees_components: Floats
    """(3,) NEES of x, of y and of the heading alone, 1 degree of freedom each."""
    n_eff: float
    """(44), before resampling."""
    diversity: float
    """Distinct ancestors at time zero as a fraction of the particles that the step returned."""
    common_ancestor_age: float
    """Steps back to the most recent common ancestor of those; NaN while there is none."""
    features: int
    """Features of the best particle, with those that this step added."""
    duplicates: float
    """How many of these show again what another one shows already; NaN where no tag is known."""
    correct: int
    """Observations of this step that the best particle paired rightly.  0, 0, 0 where no tag is known."""
    wrong: int
    """Those that it paired with another thing's feature."""
    missed: int
    """Those that it did not pair although its map holds the thing, or ignored although it is new."""
    map_error_m: float
    """RMS distance of its map in `Trace.weighted` from the true one, after rigid alignment: of the points, or of the
    ends of the walls from the lines of the true ones."""
    map_error_unaligned_m: float
    """The same as the map lies."""


def measure(
    trace: Trace,
    frame: Frame,
    truth: Floats | None = None,
    true_map: MapTruth | None = None,
    genealogy: Genealogy | None = None,
) -> Measures:
    """All measures of one step.

    `truth` (3,) [m, m, rad] is the pose at the time of the frame; its heading may be NaN.  `genealogy` is
    that after the step.  Estimate, NEES and best particle are of `trace.weighted`: with the new weights,
    before FastSLAM 2.0 draws its pose and before resampling.
    """
    weighted = trace.weighted
    best = int(np.argmax(weighted.log_w))
    estimate, covariance = mixture_moments(weighted.s, weighted.P, np.exp(weighted.log_w))
    truth = np.full(3, np.nan) if truth is None else np.asarray(truth, float)
    error, best_error = pose_error(estimate, truth), pose_error(weighted.s[best], truth)

    scores = scores_of(frame.feature)
    theta, _, map_tags = weighted.maps.features(best)
    before = int(trace.predicted.maps.counts[best])
    old = weighted.maps.indices(best) < before  # features that this step did not add
    held = scores.held(frame.feature, theta[old], map_tags[old], weighted.s[best], frame.z, frame.tags)
    correct, wrong, missed = association_score(trace.n[best], frame.tags, weighted.maps.tags(best)[:before], held)
    aligned = unaligned = math.nan
    if true_map is not None:
        aligned, unaligned = scores.map_errors(theta, map_tags, true_map.tags, true_map.theta)

    age = None if genealogy is None else genealogy.common_ancestor_age()
    return Measures(
        estimate=estimate,
        covariance=covariance,
        best=best,
        position_error_m=math.hypot(error[0], error[1]),
        heading_error_rad=abs(float(error[2])),
        best_position_error_m=math.hypot(best_error[0], best_error[1]),
        nees_position=nees(error[:2], covariance[:2, :2]),
        nees_pose=nees(error, covariance),
        nees_components=nees_of_components(error, covariance),
        n_eff=trace.n_eff,
        diversity=diversity(trace.resampled.lineage),
        common_ancestor_age=math.nan if age is None else float(age),
        features=len(map_tags),
        duplicates=scores.duplicates(theta, map_tags),
        correct=correct,
        wrong=wrong,
        missed=missed,
        map_error_m=aligned,
        map_error_unaligned_m=unaligned,
    )


def mixture_moments(s: Floats, P: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Mean (3,) and covariance (3, 3) of pose Gaussians s (K, 3), P (K, 3, 3) of normalised weights w (K,).

    The covariance is the mean of those within the particles plus that of their means; the mean heading is the
    mean direction, and differences of headings are taken on the circle.  Everything is measured from the
    heaviest particle, so that particles in one place have a covariance between them of exactly zero, not of a
    rounding error squared.
    """
    reference = s[np.argmax(w)]
    d = s - reference
    offset = w @ d
    offset[2] = circular_mean(d[:, 2], w)
    d -= offset
    d[:, 2] = wrap_all(d[:, 2])
    mean = reference + offset
    mean[2] = wrap(float(mean[2]))
    covariance = (w @ P.reshape(len(w), 9)).reshape(3, 3) + (w[:, None] * d).T @ d
    return mean, 0.5 * (covariance + covariance.T)


def pose_error(estimate: Floats, truth: Floats) -> Floats:
    """(..., 3) estimate minus truth [m, m, rad], the heading on the circle; NaN where the truth is."""
    error = np.asarray(estimate, float) - truth
    error[..., 2] = wrap_all(error[..., 2])
    return error


def nees(error: Floats, covariance: Floats) -> float:
    """Normalised estimation error squared, e^T C^-1 e, for e (d,) and C (d, d).

    A singular C is taken at its word: infinite for an error with a part where C has no spread, and otherwise
    the value on the range of C.  Metres and radians, or a spread of 1 m along and 1 mm across, do not make C
    singular: it is scaled to unit diagonal, and an eigenvalue counts as zero only if it is no larger than what
    rounding leaves in a sum over thousands of particles.  NaN if the error or C is not finite.
    """
    if not (np.isfinite(error).all() and np.isfinite(covariance).all()):
        return math.nan
    variance = np.diag(covariance)
    known = variance <= 0.0  # no spread at all: no error is allowed
    if (error[known] != 0.0).any():
        return math.inf
    deviation = np.sqrt(variance[~known])
    if len(deviation) == 0:
        return 0.0
    if deviation.min() < 1e-100:  # no spread either: squares would overflow
        return math.inf
    e = error[~known] / deviation
    values, vectors = np.linalg.eigh(covariance[np.ix_(~known, ~known)] / np.outer(deviation, deviation))
    along = e @ vectors
    rounding = ROUNDING * values[-1]
    flat = values <= rounding
    # A smaller part would add less than |e|^2 even with all the spread that rounding may hide.
    if (np.abs(along[flat]) > math.sqrt(rounding) * np.linalg.norm(e)).any():
        return math.inf
    return float(np.sum(along[~flat] ** 2 / values[~flat]))


def nees_of_components(error: Floats, covariance: Floats) -> Floats:
    """(d,) the NEES of each component of error (d,) alone, e_i^2 / C_ii, with the same zeros and infinities."""
    return np.array([_nees_of_one(e, v) for e, v in zip(error.tolist(), np.diag(covariance).tolist(), strict=True)])


def _nees_of_one(error: float, variance: float) -> float:
    if not (math.isfinite(error) and math.isfinite(variance)):
        return math.nan
    if variance < 1e-200:
        return math.inf if error else 0.0
    return error * error / variance


def nees_interval(dof: int, runs: int = 1, confidence: float = 0.95) -> tuple[float, float]:
    """The two-sided interval in which the NEES of a consistent filter lies with this confidence.

    For the mean over `runs` independent runs: chi-square with runs * dof degrees of freedom, divided by runs.
    """
    tails = np.array([0.5 * (1.0 - confidence), 0.5 * (1.0 + confidence)])
    low, high = 2.0 * gammaincinv(0.5 * dof * runs, tails) / runs
    return float(low), float(high)


def rms(values: Floats) -> float:
    """Root of the mean square of the values (any shape) that are not NaN; NaN if there are none."""
    values = np.asarray(values, float)
    values = values[~np.isnan(values)]
    return math.sqrt(float(np.mean(values**2))) if len(values) else math.nan
