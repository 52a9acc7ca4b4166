"""How good an estimate is: errors, consistency, map and association scores.

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
from slam.types import NEW, UNKNOWN_TAG, Floats, Frame, Ints, Trace

ROUNDING = 1e-13
"""Relative: smaller eigenvalues of a covariance are rounding errors.  1 m against 0.3 micrometres."""


class MapTruth(Protocol):
    """The landmarks as they are; `scenarios.types.TrueMap` is one."""

    @property
    def tags(self) -> Ints:
        """(n,)"""
        ...

    @property
    def theta(self) -> Floats:
        """(n, 2) [m, m]"""
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
    n_eff: float
    """(44), before resampling."""
    diversity: float
    """Distinct ancestors at time zero as a fraction of the particles that the step returned."""
    common_ancestor_age: float
    """Steps back to the most recent common ancestor of those; NaN while there is none."""
    features: int
    """Features of the best particle, with those that this step added."""
    duplicates: float
    """How many of these are beyond one for each tag; NaN where no tag is known."""
    correct: int
    """Observations of this step that the best particle paired rightly.  0, 0, 0 where no tag is known."""
    wrong: int
    """Those that it paired with another thing's feature."""
    missed: int
    """Those that it did not pair although its map holds the thing, or ignored although it is new."""
    map_error_m: float
    """RMS distance of its map in `Trace.weighted` from the true one, after rigid alignment."""
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

    theta, _, map_tags = weighted.maps.features(best)
    held = map_tags[: trace.predicted.maps.counts[best]]  # before this step added features
    correct, wrong, missed = association_score(trace.n[best], frame.tags, held)
    aligned = unaligned = math.nan
    if true_map is not None:
        pairs = map_pairs(theta, map_tags, true_map.tags, true_map.theta)
        aligned, unaligned = rms_distance(*pairs, align=True), rms_distance(*pairs)

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
        n_eff=trace.n_eff,
        diversity=diversity(trace.resampled.lineage),
        common_ancestor_age=math.nan if age is None else float(age),
        features=len(map_tags),
        duplicates=duplicates(map_tags),
        correct=correct,
        wrong=wrong,
        missed=missed,
        map_error_m=aligned,
        map_error_unaligned_m=unaligned,
    )


# --- The pose -----------------------------------------------------------------------------------------------


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


# --- Alignment, and the map ---------------------------------------------------------------------------------


def align_rigid(p: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Rotation R (2, 2) and translation t (2,) with the least sum of |R p + t - q|^2; p, q (n, 2), n >= 1.

    S. Umeyama, IEEE Trans. PAMI 13 (1991), without scale: in the plane the best turn is the direction of the
    summed dot and cross products, never a reflection.  One point, or points all in one place, are only
    translated.
    """
    p_mean, q_mean = p.mean(axis=0), q.mean(axis=0)
    a, b = p - p_mean, q - q_mean
    dot = float(np.sum(a * b))
    cross = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    # Points in one place leave differences that are rounding errors, and their turn means nothing.
    rounding = len(p) * np.finfo(float).eps * float(np.abs(p).max() * np.abs(b).sum())
    angle = math.atan2(cross, dot) if math.hypot(dot, cross) > rounding else 0.0
    c, s = math.cos(angle), math.sin(angle)
    R = np.array([[c, -s], [s, c]])
    return R, q_mean - R @ p_mean


def map_pairs(theta: Floats, tags: Ints, true_tags: Ints, true_theta: Floats) -> tuple[Floats, Floats]:
    """(m, 2) places of those features theta (n, >= 2) whose tag is in the truth, and (m, 2) where they should be.

    Every duplicate counts.  A tag should occur once in the truth.
    """
    order = np.argsort(true_tags, kind="stable")
    order = order[true_tags[order] != UNKNOWN_TAG]
    if len(tags) == 0 or len(order) == 0:
        return np.empty((0, 2)), np.empty((0, 2))
    at = order[np.minimum(np.searchsorted(true_tags[order], tags), len(order) - 1)]
    found = true_tags[at] == tags
    return theta[found, :2], true_theta[at[found], :2]


def rms_distance(p: Floats, q: Floats, align: bool = False) -> float:
    """RMS distance [m] of p from q, (n, 2) each, after rigid alignment if asked for; NaN for none."""
    if len(p) == 0:
        return math.nan
    if align:
        R, t = align_rigid(p, q)
        p = p @ R.T + t
    return math.sqrt(float(np.sum((p - q) ** 2)) / len(p))


def map_error(theta: Floats, tags: Ints, true_tags: Ints, true_theta: Floats, align: bool = True) -> float:
    """RMS distance [m] of the features theta (n, >= 2) from the true ones (m, 2) of the same tag.

    After rigid alignment unless told otherwise: a map that is right but for where it lies has no error.  Features
    whose tag is unknown or not in the truth are left out; NaN if that leaves none.
    """
    return rms_distance(*map_pairs(theta, tags, true_tags, true_theta), align=align)


# --- Data association ---------------------------------------------------------------------------------------


def duplicates(tags: Ints) -> float:
    """How many features of tags (n,) there are beyond one for each known tag; NaN if none is known."""
    known = tags[tags != UNKNOWN_TAG]
    if len(known) == 0 and len(tags) > 0:
        return math.nan
    return float(len(known) - len(np.unique(known)))


def association_score(n: Ints, tags: Ints, map_tags: Ints) -> tuple[int, int, int]:
    """(correct, wrong, missed) for the correspondences n (Z,) of things with tags (Z,).

    `map_tags` are those of the map's features before the step.  Correct: paired with a feature born of the
    same thing, or NEW when the map holds none of it.  Wrong: paired with one born of something else.  Missed: all
    else, that is NEW or IGNORED although the map holds one, and IGNORED although it holds none.  Not counted: things of
    unknown tag, and pairs with a feature of unknown tag.
    """
    known = tags != UNKNOWN_TAG
    unpaired = n < 0
    held = (tags[:, None] == map_tags).any(axis=1)
    partner = np.full(len(n), UNKNOWN_TAG)
    partner[~unpaired] = map_tags[n[~unpaired]]
    right = (partner == tags) | ((n == NEW) & ~held)
    wrong = (partner != tags) & (partner != UNKNOWN_TAG)
    missed = unpaired & ~right
    return (
        int(np.count_nonzero(known & right)),
        int(np.count_nonzero(known & wrong)),
        int(np.count_nonzero(known & missed)),
    )
