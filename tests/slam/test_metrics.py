"""Measures against brute force, chi-square theory and tables made by hand."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

from slam.features import Point, Wall
from slam.genealogy import Genealogy
from slam.metrics import (
    Measures,
    measure,
    mixture_moments,
    nees,
    nees_interval,
    nees_of_components,
    pose_error,
    rms,
)
from slam.motion import Odometry
from slam.phases import unweighed
from slam.types import NEW, UNKNOWN_TAG, Frame, Particles, Trace

PI = math.pi


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def random_covariance(rng, deviations):
    """A covariance with these deviations along axes turned at random."""
    axes = np.linalg.qr(rng.normal(size=(len(deviations), len(deviations))))[0]
    return axes @ np.diag(np.square(deviations)) @ axes.T


# --- Mixture moments ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("heading", [0.3, PI - 0.02, -PI + 0.01])
def test_moments_agree_with_a_sample_of_the_mixture(heading):
    """200 000 draws; mean and covariance within 5 standard errors, the heading spread across +-pi."""
    rng = np.random.default_rng(11)
    K, N = 6, 200_000
    s = rng.normal([40.0, -30.0, heading], [0.5, 2.0, 0.2], size=(K, 3))
    s[:, 2] = wrapped(s[:, 2])
    # One heading deviation for all: the circular mean of a Gaussian cloud weighs clouds by exp(-variance / 2).
    scale = np.diag([1.0, 1.0, 0.1])
    base = np.array([[1.0, 0.3, 0.2], [0.3, 1.0, -0.4], [0.2, -0.4, 1.0]])
    P = np.array([np.diag([a, b, 1.0]) @ scale @ base @ scale @ np.diag([a, b, 1.0]) for a, b in rng.random((K, 2))])
    w = rng.dirichlet(np.ones(K))

    which = rng.choice(K, size=N, p=w)
    draws = s[which] + np.einsum("nij,nj->ni", np.linalg.cholesky(P)[which], rng.normal(size=(N, 3)))
    centre = np.append(draws[:, :2].mean(axis=0), np.angle(np.mean(np.exp(1j * draws[:, 2]))))
    d = draws - centre
    d[:, 2] = wrapped(d[:, 2])
    products = d[:, :, None] * d[:, None, :]

    mean, covariance = mixture_moments(s, P, w)
    error = mean - centre
    error[2] = wrapped(error[2])
    assert -PI <= mean[2] < PI
    assert np.all(np.abs(error) < 5.0 * d.std(axis=0) / math.sqrt(N))
    assert np.all(np.abs(covariance - products.mean(axis=0)) < 5.0 * products.std(axis=0) / math.sqrt(N))
    np.testing.assert_array_equal(covariance, covariance.T)


def test_moments_of_one_particle_are_its_own():
    s, P = np.array([[1.0, -2.0, 3.1]]), random_covariance(np.random.default_rng(1), [1.0, 0.1, 1e-4])
    mean, covariance = mixture_moments(s, P[None], np.ones(1))
    np.testing.assert_allclose(mean, s[0], rtol=1e-15)
    np.testing.assert_allclose(covariance, P, rtol=1e-15, atol=1e-20)


def test_moments_by_hand_across_pi():
    """Headings of 179 and -179 degrees: the mean is 180, each 1 degree away; x is -1 and 3 with weights 3/4 and 1/4."""
    s = np.array([[-1.0, 0.0, math.radians(179.0)], [3.0, 0.0, math.radians(-179.0)]])
    mean, covariance = mixture_moments(s, np.zeros((2, 3, 3)), np.array([0.5, 0.5]))
    np.testing.assert_allclose([mean[0], abs(mean[2])], [1.0, PI])
    np.testing.assert_allclose(covariance[0], [4.0, 0.0, 2.0 * math.radians(1.0)], atol=1e-12)
    mean, covariance = mixture_moments(s, np.zeros((2, 3, 3)), np.array([0.75, 0.25]))
    np.testing.assert_allclose([mean[0], covariance[0, 0]], [0.0, 3.0])
    assert mean[2] == pytest.approx(math.radians(179.5), abs=1e-6)


def test_the_mean_heading_is_the_mean_direction():
    """Of widely spread headings, about +-pi: not the mean of the numbers, not that of the differences."""
    rng = np.random.default_rng(9)
    for _ in range(20):
        s = np.zeros((5, 3))
        s[:, 2] = wrapped(PI + rng.normal(0.0, 1.0, size=5))
        w = rng.dirichlet(np.ones(5))
        mean, covariance = mixture_moments(s, np.zeros((5, 3, 3)), w)
        direction = np.angle(w @ np.exp(1j * s[:, 2]))
        assert wrapped(mean[2] - direction) == pytest.approx(0.0, abs=1e-12)
        assert covariance[2, 2] == pytest.approx(w @ wrapped(s[:, 2] - direction) ** 2)


def test_particles_in_one_place_have_no_covariance_at_all():
    s = np.tile([40.123, -31.7, 3.0], (100, 1))
    mean, covariance = mixture_moments(s, np.zeros((100, 3, 3)), np.full(100, 0.01))
    np.testing.assert_array_equal(mean, s[0])
    np.testing.assert_array_equal(covariance, 0.0)


def test_moments_leave_their_input_alone():
    rng = np.random.default_rng(0)
    s, P, w = rng.normal(size=(5, 3)), np.zeros((5, 3, 3)), np.full(5, 0.2)
    copies = s.copy(), P.copy(), w.copy()
    mixture_moments(s, P, w)
    for now, before in zip((s, P, w), copies, strict=True):
        np.testing.assert_array_equal(now, before)


# --- NEES ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dof", [2, 3])
def test_nees_of_consistent_errors_is_chi_square(dof):
    """2000 runs: the mean in its 99.9 % interval, single runs in their 95 % interval within 4 standard errors."""
    rng = np.random.default_rng(21)
    C = random_covariance(rng, [2.0, 3e-4, 0.05][:dof])
    errors = rng.multivariate_normal(np.zeros(dof), C, size=2000)
    values = np.array([nees(e, C) for e in errors])
    low, high = nees_interval(dof, runs=2000, confidence=0.999)
    assert low < values.mean() < high
    low, high = nees_interval(dof)
    inside = np.mean((values > low) & (values < high))
    assert abs(inside - 0.95) < 4.0 * math.sqrt(0.95 * 0.05 / 2000)
    # A filter twice as sure of itself as it should be is found out.
    assert np.mean([nees(e, C / 4.0) for e in errors]) > nees_interval(dof, runs=2000, confidence=0.999)[1]


def test_nees_of_a_mixture_whose_truth_is_one_of_it():
    """Truth drawn from the mixture, near +-pi: the mean NEES is the number of dimensions; 3000 draws, 5 errors."""
    rng = np.random.default_rng(5)
    s = rng.normal([3.0, 9.0, PI], [0.1, 0.4, 0.05], size=(200, 3))
    s[:, 2] = wrapped(s[:, 2])
    P = np.tile(random_covariance(rng, [0.1, 0.2, 0.03]), (200, 1, 1))
    w = rng.dirichlet(np.ones(200))
    mean, C = mixture_moments(s, P, w)
    truth = s[rng.choice(200, size=3000, p=w)] + rng.multivariate_normal(np.zeros(3), P[0], size=3000)
    errors = pose_error(mean, truth)
    assert np.all(np.abs(errors[:, 2]) < 1.0)
    for dof in (2, 3):
        values = np.array([nees(e[:dof], C[:dof, :dof]) for e in errors])
        assert abs(values.mean() - dof) < 5.0 * values.std() / math.sqrt(3000)


def test_nees_equals_the_plain_formula():
    rng = np.random.default_rng(2)
    for _ in range(50):
        C = random_covariance(rng, 10.0 ** rng.uniform(-1.5, 1.5, size=3))
        e = rng.normal(size=3)
        assert nees(e, C) == pytest.approx(e @ np.linalg.solve(C, e), rel=1e-9)


def test_small_or_mixed_units_are_not_singular():
    """Deviations of 1 m and 3e-4 m at 45 degrees, and of 1e-9 throughout: regular, and computed as such."""
    R = np.array([[1.0, -1.0], [1.0, 1.0]]) / math.sqrt(2.0)
    C = R @ np.diag([1.0, 9e-8]) @ R.T
    assert nees(R @ np.array([2.0, 6e-4]), C) == pytest.approx(8.0, rel=1e-6)
    assert nees(np.array([1e-9, 2e-9]), 1e-18 * np.eye(2)) == pytest.approx(5.0)
    assert nees(np.array([1.0, 1e-6]), np.diag([1.0, 1e-12])) == pytest.approx(2.0)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e4])
def test_collapsed_mixtures_are_infinite_off_their_range(scale):
    rng = np.random.default_rng(13)
    for _ in range(50):
        direction = scale * rng.normal(size=3)
        s = np.array([direction, -direction]) + scale * rng.normal(size=3)  # two particles: a line
        s[:, 2] = 0.1 * wrapped(s[:, 2])
        mean, C = mixture_moments(s, np.zeros((2, 3, 3)), np.array([0.5, 0.5]))
        along = s[0] - mean
        assert nees(2.0 * along, C) == pytest.approx(4.0, rel=1e-6)
        assert nees(2.0 * along + 1e-3 * np.linalg.norm(along) * rng.normal(size=3), C) == math.inf
        assert nees(along[:2], C[:2, :2]) == pytest.approx(1.0, rel=1e-6)


def test_nees_edges():
    assert nees(np.zeros(3), np.zeros((3, 3))) == 0.0
    assert nees(np.array([1e-12, 0.0]), np.zeros((2, 2))) == math.inf
    assert nees(np.array([3.0, 0.0]), np.diag([1.0, 0.0])) == pytest.approx(9.0)
    assert nees(np.array([3.0, 1e-9]), np.diag([1.0, 0.0])) == math.inf
    assert math.isnan(nees(np.array([0.0, math.nan]), np.eye(2)))
    assert math.isnan(nees(np.zeros(2), np.diag([1.0, math.inf])))


def test_nees_of_components_are_those_of_each_alone():
    rng = np.random.default_rng(5)
    C, e = random_covariance(rng, [2.0, 0.1, 0.01]), rng.normal(size=3)
    found = nees_of_components(e, C)
    assert found == pytest.approx([nees(e[[i]], C[np.ix_([i], [i])]) for i in range(3)])
    assert nees_of_components(np.array([0.0, 1e-12, 3.0]), np.diag([0.0, 0.0, 4.0])).tolist() == [0.0, math.inf, 2.25]
    unknown = nees_of_components(np.array([math.nan, math.nan, 1.0]), np.diag([1.0, 0.0, math.inf]))
    assert np.isnan(unknown).all()


def test_nees_interval_is_the_chi_square_one():
    assert nees_interval(2) == pytest.approx(chi2.ppf([0.025, 0.975], 2))
    assert nees_interval(3, 50, 0.99) == pytest.approx(chi2.ppf([0.005, 0.995], 150) / 50)


# --- Errors -------------------------------------------------------------------------------------------------


def test_pose_error_goes_the_short_way_round():
    error = pose_error(np.array([1.0, 2.0, PI - 0.1]), np.array([0.0, 4.0, -PI + 0.1]))
    np.testing.assert_allclose(error, [1.0, -2.0, -0.2])
    error = pose_error(np.zeros(3), np.array([1.0, 1.0, math.nan]))
    np.testing.assert_array_equal(error, [-1.0, -1.0, math.nan])


def test_rms_ignores_what_is_unknown():
    assert rms(np.array([3.0, math.nan, -4.0])) == pytest.approx(math.sqrt(12.5))
    assert math.isnan(rms(np.array([math.nan])))
    assert math.isnan(rms(np.array([])))


# --- One step -----------------------------------------------------------------------------------------------


TRUE_TAGS = np.array([30, 10, 20])
TRUE_THETA = np.array([[3.0, 3.0], [1.0, 1.0], [2.0, 5.0]])


class StandInMaps(NamedTuple):
    """Maps of two particles, of which only the best one's is asked for."""

    best: int
    counts: np.ndarray
    theta: np.ndarray
    of_index: np.ndarray
    removed: tuple[int, ...] = ()

    def indices(self, k):
        assert k == self.best
        return np.setdiff1d(np.arange(self.counts[k]), self.removed)

    def tags(self, k):
        tags = self.of_index[: self.counts[k]].copy()
        tags[list(self.removed)] = UNKNOWN_TAG
        return tags

    def features(self, k):
        n = self.indices(k)
        return self.theta[n], np.zeros((len(n), 2, 2)), self.of_index[n]


class TrueMap(NamedTuple):
    tags: np.ndarray
    theta: np.ndarray


def one_step():
    """The best map holds the things 30, 10, 10 again, and once the step is over 20 and 30."""
    theta = np.array([[3.0, 3.5], [1.0, 1.0], [1.0, 1.5], [2.0, 5.0], [3.0, 3.0]])
    tags = np.array([30, 10, 10, 20, 30])
    s = np.array([[1.0, 2.0, PI - 0.1], [1.4, 2.0, -PI + 0.1]])
    P = np.tile(np.diag([0.04, 0.09, 0.01]), (2, 1, 1))
    log_w = np.log([0.4, 0.6])
    before, after = (StandInMaps(1, np.array(counts), theta, tags) for counts in ([2, 3], [6, 5]))
    predicted = Particles(s + 9.0, P, np.log([0.9, 0.1]), np.array([5, 3]), before)  # type: ignore[arg-type]
    weighted = Particles(s, P, log_w, np.array([5, 3]), after)  # type: ignore[arg-type]
    resampled = weighted._replace(log_w=np.log([0.5, 0.5]), lineage=np.array([3, 3]))
    n = np.array([[NEW, NEW, NEW, NEW], [1, 0, NEW, NEW]])
    log_p, innovations = unweighed(n)
    selected = np.array([1, 1])
    trace = Trace(predicted, weighted, resampled, n, log_p, 1.0, innovations, 1.9, True, np.arange(2), selected)
    frame = Frame(1.0, Odometry(), np.zeros((1, 3)), np.ones(1), Point(), np.zeros((4, 2)), np.array([10, 10, 20, 30]))
    return trace, frame


def test_measure_by_hand():
    trace, frame = one_step()
    truth = np.array([1.24, 2.3, PI])
    genealogy = Genealogy.start(np.zeros((2, 3))).grow(np.array([1, 1]), trace.resampled.s)
    m = measure(trace, frame, truth, TrueMap(TRUE_TAGS, TRUE_THETA), genealogy)
    np.testing.assert_allclose(m.estimate[:2], [1.24, 2.0])
    assert m.best == 1
    assert m.position_error_m == pytest.approx(0.3)
    assert m.best_position_error_m == pytest.approx(math.hypot(0.16, 0.3))
    assert m.heading_error_rad == pytest.approx(0.02, abs=1e-4)  # circular mean of -0.1 and 0.1 about pi
    np.testing.assert_allclose(np.diag(m.covariance)[:2], [0.04 + 0.0384, 0.09])
    assert m.nees_position == pytest.approx(1.0)
    assert m.nees_pose > m.nees_position
    assert (m.n_eff, m.diversity, m.common_ancestor_age) == (1.9, 0.5, 1.0)
    assert (m.features, m.duplicates) == (5, 2.0)
    assert (m.correct, m.wrong, m.missed) == (2, 1, 1)
    assert m.map_error_unaligned_m == pytest.approx(math.sqrt((0.25 + 0.25) / 5))
    assert m.map_error_m < m.map_error_unaligned_m


def test_what_was_removed_counts_for_nothing():
    """Without the second 10, which was there before the step: no duplicate, and correspondences as they were."""
    trace, frame = one_step()
    maps = trace.weighted.maps._replace(removed=(2,))
    m = measure(
        trace._replace(weighted=trace.weighted._replace(maps=maps)), frame, None, TrueMap(TRUE_TAGS, TRUE_THETA)
    )
    assert (m.features, m.duplicates) == (4, 1.0)
    assert (m.correct, m.wrong, m.missed) == (2, 1, 1)
    assert m.map_error_unaligned_m == pytest.approx(math.sqrt(0.25 / 4))


def test_measure_of_walls():
    """Walls along x, as the best particle at (3, 0) sees them: one again, another part of one, one as if new."""
    trace, frame = one_step()
    at = [(5.0, -1.0, 30), (5.0, 1.0, 20), (5.0, 2.0, 10), (25.0, 1.0, 20), (5.1, 2.1, 10)]  # the last two by this step
    theta = np.array([[x, y, 0.0, -1.0, 1.0, 0.0, 0.0, 1.0] for x, y, _ in at])
    tags = np.array([tag for _, _, tag in at])
    z = np.array([[x - 3.0, y, 0.0, -1.0, 1.0, 1e-6, 1e-6, 0, 0, 20] for x, y in [(6, -1), (25, 1), (5.1, 2.1)]])
    n, poses = np.array([[1, 1, 1], [0, NEW, NEW]]), np.array([[-40.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    maps = [StandInMaps(1, np.array(counts), theta, tags) for counts in ([2, 3], [6, 5])]
    trace = trace._replace(
        predicted=trace.predicted._replace(maps=maps[0]), weighted=trace.weighted._replace(s=poses, maps=maps[1]), n=n
    )
    true_map = TrueMap(np.array([30, 20, 10]), np.array([[0, -1.5, 9, -1.5], [0, 0.5, 9, 0.5], [0, 1.6, 9, 1.6]]))
    m = measure(trace, frame._replace(feature=Wall(), z=z, tags=np.array([30, 20, 10])), None, true_map)
    assert (m.features, m.duplicates) == (5, 1.0)
    assert (m.correct, m.wrong, m.missed) == (2, 0, 1)
    assert m.map_error_unaligned_m == pytest.approx(math.sqrt((3 * 0.25 + 0.4**2 + 0.5**2) / 5))
    assert m.map_error_m < 0.1


def test_measure_without_truth():
    trace, frame = one_step()
    m = measure(trace, frame._replace(tags=np.full(4, UNKNOWN_TAG)))
    unknown = [name for name, value in m._asdict().items() if np.ndim(value) == 0 and np.isnan(value)]
    assert unknown == [
        "position_error_m",
        "heading_error_rad",
        "best_position_error_m",
        "nees_position",
        "nees_pose",
        "common_ancestor_age",
        "map_error_m",
        "map_error_unaligned_m",
    ]
    assert (m.correct, m.wrong, m.missed) == (0, 0, 0)
    assert set(Measures._fields) == set(m._asdict())


def test_measure_without_true_heading():
    trace, frame = one_step()
    m = measure(trace, frame, np.array([1.24, 2.3, math.nan]))
    assert m.position_error_m == pytest.approx(0.3)
    assert m.nees_position == pytest.approx(1.0)
    assert math.isnan(m.heading_error_rad)
    assert math.isnan(m.nees_pose)
    assert np.isnan(m.nees_components).tolist() == [False, False, True]
