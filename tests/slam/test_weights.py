"""Why weights differ: against sums that are made anew, and cases where the answer is plain."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from slam.estimators import ESTIMATORS
from slam.features import Point
from slam.linalg import LOG_TWO_PI
from slam.phases import unweighed
from slam.types import IGNORED, NEW, Floats, Innovations, Ints, Params, Particles, Trace
from slam.weights import innovation_statistics, innovation_widths, mixtures, parents, weight_variance, weights_before
from tests.slam import plain

SIBLINGS = ["fs1", "fs2", "dfs"]
START = np.diag([0.1, 0.1, 0.02]) ** 2


def traces_of(key: str, seed: int = 3, **changes: Any) -> list[Trace]:
    """A run in which nothing is resampled, so that weights differ before a step, too."""
    choice = {"particles": 40, "believed": plain.WORLD_NOISE, "association": "known", "resample_below": 0.0} | changes
    params, rng, traces = Params(**choice), np.random.default_rng(4), []
    state = ESTIMATORS[key].init(Point(), np.zeros(3), START, params)
    for frame in plain.simulate(seed=seed, steps=12).frames:
        state, trace = ESTIMATORS[key].step(rng, state, frame, params)
        traces.append(trace)
    return traces


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


def made(log_p: Floats, prior: Floats, n: Ints, innovations: Innovations) -> Trace:
    """A step of which only what weights differ by is there."""
    K, index = len(log_p), np.arange(len(log_p))
    maps: Any = None
    particles = Particles(np.zeros((K, 3)), np.zeros((K, 3, 3)), np.log(prior), index, maps)
    return Trace(particles, particles, particles, n, log_p, 1.0, innovations, float(K), False, index, index)


@pytest.mark.parametrize("key", SIBLINGS)
@pytest.mark.parametrize(
    "changes", [{}, {"temper": 0.2}, {"weighting": "joint"}, {"association": "jcbb"}, {"proposal_weight": "drawn"}]
)
def test_shares_are_covariances_with_the_sum(key: str, changes: dict) -> None:
    parted = drawn = 0
    for trace in traces_of(key, **changes):
        found = weight_variance(trace)
        log_p, w = trace.log_likelihood, np.exp(trace.predicted.log_w)
        away = log_p - w @ log_p
        C = (w[:, None] * away).T @ away
        if not C.sum() > 1e-9:
            continue
        parted += 1
        assert found.deviation == pytest.approx(math.sqrt(C.sum()))
        np.testing.assert_allclose(found.observations, C.sum(axis=1) / C.sum(), rtol=1e-6, atol=1e-9)
        assert found.first + found.second + found.unmatched + found.drawn == pytest.approx(1.0)
        missed = np.where(trace.n >= 0, 0.0, log_p).sum(axis=1)
        assert found.unmatched == pytest.approx((w * missed) @ away.sum(axis=1) / C.sum(), abs=1e-9)
        drawn += abs(found.drawn) > 1e-6
    assert parted > 5
    assert (drawn > 3) == (key == "fs2" and "proposal_weight" in changes)


def test_temper_takes_from_the_deviation_and_leaves_the_shares() -> None:
    full, part = (traces_of("dfs", temper=temper)[1] for temper in (1.0, 0.2))
    a, b = weight_variance(full), weight_variance(part)
    assert b.deviation == pytest.approx(0.2 * a.deviation)
    assert a.deviation > 0.1
    np.testing.assert_allclose([a.first, a.second, *a.observations], [b.first, b.second, *b.observations])


def test_components_sum_to_the_density_and_have_their_shares() -> None:
    for trace in traces_of("dfs")[1:]:
        first, second = log_density_by_component(trace.innovations)
        matched, w = trace.n >= 0, np.exp(trace.predicted.log_w)
        np.testing.assert_allclose((first + second)[matched], trace.log_likelihood[matched], rtol=1e-9)
        found, L = weight_variance(trace), trace.log_likelihood.sum(axis=1)
        if found.deviation > 1e-6:
            parts = [np.where(matched, part, 0.0).sum(axis=1) for part in (first, second)]
            shares = [w @ ((part - w @ part) * (L - w @ L)) / found.deviation**2 for part in parts]
            assert (found.first, found.second) == pytest.approx(tuple(shares), abs=1e-9)


def test_one_observation_decides_and_one_speaks_against_it() -> None:
    """By hand: L is -2 or 0, so Var(L) = 1, and the covariances of the three with L are 1.5, -0.5 and 0."""
    log_p = np.array([[0.0, 0.0, -2.0], [3.0, -1.0, -2.0]])
    n = np.full((2, 3), IGNORED)
    found = weight_variance(made(log_p, np.array([0.5, 0.5]), n, unweighed(n).innovations))
    assert found.deviation == pytest.approx(1.0)
    np.testing.assert_allclose(found.observations, [1.5, -0.5, 0.0])
    assert (found.first, found.second, found.unmatched, found.drawn) == pytest.approx((0.0, 0.0, 1.0, 0.0))
    assert math.isnan(found.inside)
    heavy = weight_variance(made(log_p, np.array([0.9, 0.1]), n, unweighed(n).innovations))
    assert heavy.deviation == pytest.approx(2.0 * math.sqrt(0.9 * 0.1))


@pytest.mark.parametrize("component", [0, 1])
def test_the_component_in_which_particles_differ_has_the_share(component: int) -> None:
    v, V = np.zeros((4, 1, 2)), np.tile(np.eye(2), (4, 1, 1, 1))
    v[:, 0, component] = [-3.0, -1.0, 1.0, 2.0]
    innovations = Innovations(v, V)
    first, second = log_density_by_component(innovations)
    found = weight_variance(made(first + second, np.full(4, 0.25), np.zeros((4, 1), int), innovations))
    assert (found.first, found.second) == pytest.approx((1.0, 0.0) if component == 0 else (0.0, 1.0))
    assert found.wide[component] == pytest.approx(np.std(v[:, 0, component]))
    assert found.wide[1 - component] == 0.0
    assert found.inside == 1.0  # 9.0 is below 9.21


def test_the_second_component_is_given_the_first() -> None:
    """Two errors that are nearly the same thing: what the first says already, the second says no more."""
    v = np.array([[[-1.0, -1.0]], [[2.0, 2.0]]])
    V = np.tile([[1.0, 0.999], [0.999, 1.0]], (2, 1, 1, 1))
    innovations = Innovations(v, V)
    first, second = log_density_by_component(innovations)
    found = weight_variance(made(first + second, np.full(2, 0.5), np.zeros((2, 1), int), innovations))
    assert found.first > 0.99
    assert found.second < 0.01


def test_particles_outside_the_likelihood_are_counted() -> None:
    """Together: two distances of 6 are 12, below the gate of two pairs, 13.3; 9.5 is beyond that of one, 9.2."""
    v = np.zeros((3, 2, 2))
    v[0, :, 0], v[1, 0, 0], v[2, 0, 1] = math.sqrt(6.0), math.sqrt(9.5), 0.1
    n = np.array([[0, 1], [0, NEW], [0, NEW]])
    V = np.tile(np.eye(2), (3, 2, 1, 1))
    trace = made(np.arange(6.0).reshape(3, 2), np.full(3, 1 / 3), n, Innovations(v, V))
    assert weight_variance(trace).inside == pytest.approx(2 / 3)
    assert weight_variance(trace._replace(temper=0.9)).inside == 1.0  # a flatter likelihood reaches further


def test_the_spread_between_particles_beside_what_each_expects() -> None:
    trace = traces_of("fs1", particles=200)[3]
    w, (v, V) = np.exp(trace.predicted.log_w), trace.innovations
    squares, total = np.zeros(2), 0.0
    for i in range(trace.n.shape[1]):
        of = trace.n[:, i] >= 0
        if of.sum() < 2:
            continue
        for a in range(2):
            mean = np.average(v[of, i, a], weights=w[of])
            between = np.average((v[of, i, a] - mean) ** 2, weights=w[of])
            squares[a] += w[of].sum() * between / np.average(V[of, i, a, a], weights=w[of])
        total += w[of].sum()
    assert total > 0.0
    np.testing.assert_allclose(weight_variance(trace).wide, np.sqrt(squares / total), rtol=1e-9)


def test_a_proposal_that_is_wider_than_the_sensor() -> None:
    """FastSLAM 1.0 draws its poses before it looks, and more of them are in vain than of Dual FastSLAM."""
    late = {
        key: [weight_variance(trace) for trace in traces_of(key, particles=200, resample_below=0.5)[3:]]
        for key in ("fs1", "dfs")
    }
    wide = {key: np.median([max(found.wide) for found in founds]) for key, founds in late.items()}
    inside = {key: np.mean([found.inside for found in founds]) for key, founds in late.items()}
    assert wide["fs1"] > 3.0 * wide["dfs"]
    assert inside["fs1"] < 0.8 * inside["dfs"]


def test_nothing_to_tell() -> None:
    n = np.zeros((3, 0), int)
    empty = weight_variance(made(np.zeros((3, 0)), np.full(3, 1 / 3), n, unweighed(n).innovations))
    assert empty.deviation == 0.0
    assert math.isnan(empty.first)
    n = np.array([[0], [0]])
    impossible = weight_variance(made(np.full((2, 1), -np.inf), np.full(2, 0.5), n, unweighed(n).innovations))
    assert math.isnan(impossible.deviation)
    assert impossible.observations.shape == (1,)
    new = np.full((2, 1), NEW)
    same = made(np.full((2, 1), -3.3), np.full(2, 0.5), new, unweighed(new).innovations)
    assert weight_variance(same).deviation == 0.0
    assert math.isnan(innovation_statistics(mixtures(same)).first)
    assert innovation_statistics(mixtures(same)).matched == 0.0


def test_innovations_of_a_consistent_filter_are_as_expected() -> None:
    """EKF-SLAM in the plain world, 60 runs."""
    found = [innovation_statistics(mixtures(t)) for seed in range(60) for t in traces_of("ekf", seed=seed)]
    assert np.nanmean([f.first for f in found]) == pytest.approx(1.0, abs=0.15)
    assert np.nanmean([f.second for f in found]) == pytest.approx(1.0, abs=0.15)


def test_innovations_of_particles_together_by_hand() -> None:
    """Two observations; the first is matched by three particles, the second by one."""
    rng = np.random.default_rng(5)
    v, w = rng.normal(size=(3, 2, 2)), np.array([0.2, 0.3, 0.5])
    V = np.tile([[2.0, 0.5], [0.5, 1.0]], (3, 2, 1, 1)) * np.array([1.0, 2.0, 3.0])[:, None, None, None]
    n = np.array([[0, NEW], [0, IGNORED], [0, 1]])
    mixed = mixtures(made(np.zeros((3, 2)), w, n, Innovations(v, V)))
    found = innovation_statistics(mixed)
    C = np.einsum("k,kab->ab", w, V[:, 0]) + np.cov(v[:, 0].T, aweights=w, ddof=0)
    means, covariances = [w @ v[:, 0], v[2, 1]], [C, V[2, 1]]
    nis = [m @ np.linalg.solve(c, m) for m, c in zip(means, covariances, strict=True)]
    assert found.matched == pytest.approx(1.5)
    assert found.first + found.second == pytest.approx((nis[0] + 0.5 * nis[1]) / 1.5)
    first = [m[0] ** 2 / c[0, 0] for m, c in zip(means, covariances, strict=True)]
    assert found.first == pytest.approx((first[0] + 0.5 * first[1]) / 1.5)
    expected = np.einsum("k,kab->ab", w, V[:, 0]), V[2, 1]
    R = np.array([np.eye(2), np.diag([0.5, 8.0])])
    widths = [(np.linalg.det(m) / np.linalg.det(r)) ** 0.25 for m, r in zip(expected, R, strict=True)]
    np.testing.assert_allclose(innovation_widths(mixed, R), widths)


def test_what_nobody_has_matched_has_no_width() -> None:
    n = np.array([[0, NEW], [1, IGNORED]])
    v, V = np.ones((2, 2, 2)), np.tile(np.eye(2), (2, 2, 1, 1))
    mixed = mixtures(made(np.zeros((2, 2)), np.array([0.5, 0.5]), n, Innovations(v, V)))
    np.testing.assert_array_equal(innovation_widths(mixed, np.tile(np.eye(2), (2, 1, 1))), [1.0, np.nan])
    assert innovation_statistics(mixed).matched == 1.0


def test_an_impossible_particle_has_no_part_in_the_weights() -> None:
    """It is left out, with what it has matched; the innovations of all together have it."""
    trace, others = traces_of("fs1")[1], np.delete(np.arange(40), 7)
    log_p, seen = trace.log_likelihood.copy(), Innovations(*(part[others] for part in trace.innovations))
    log_p[7, 0] = -np.inf
    prior = np.exp(trace.predicted.log_w)[others]
    left = made(log_p[others], prior / prior.sum(), trace.n[others], seen)
    found, expected = (weight_variance(t, mixtures(t)) for t in (trace._replace(log_likelihood=log_p), left))
    np.testing.assert_allclose(np.hstack(found), np.hstack(expected), rtol=1e-9)
    whole = weight_variance(trace)
    assert whole.deviation != found.deviation
    np.testing.assert_allclose(np.hstack(whole), np.hstack(weight_variance(trace, mixtures(trace))), rtol=1e-9)


def test_what_was_before_and_whose_children_are_left() -> None:
    w, n = np.array([0.5, 0.25, 0.25]), np.array([[NEW, 0], [NEW, NEW], [IGNORED, 3]])
    n_eff, new = weights_before(made(np.zeros((3, 2)), w, n, unweighed(n).innovations))
    assert n_eff == pytest.approx(1.0 / 0.375)
    assert new == pytest.approx(1.0)
    assert parents(np.array([4, 0, 4, 4, 2])) == (3, pytest.approx(3 * 2 / (5 * 4)))
    assert parents(np.arange(6)) == (6, 0.0)
    assert math.isnan(parents(np.array([3]))[1])
