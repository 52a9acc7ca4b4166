"""Limits in which the filters must coincide, and association that must not matter where it is easy."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest

from slam.association import associate
from slam.ekf_slam import EkfState
from slam.estimators import ESTIMATORS
from slam.features import Point
from slam.geometry import wrap_all
from slam.map_store import MapStore
from slam.motion import Unicycle
from slam.phases import UNWEIGHED, matched_features, observation_noise, update_features
from slam.types import IGNORED, NEW, Floats, Frame, Noise, Params, Particles, Trace
from tests.slam import plain

SIBLINGS = ["fs1", "fs2", "dfs"]
ALL = [*SIBLINGS, "ekf"]
START = np.array([0.1, -0.1, 0.05])
P0 = np.array([[0.01, 0.002, 0.001], [0.002, 0.02, -0.001], [0.001, -0.001, 0.001]])


def particles_of(state: Any) -> Particles:
    return state.particles if isinstance(state, EkfState) else state


def with_map(
    K: int, landmarks: Floats, Sigma: Floats, start: Floats = START, P: Floats | float = 0.0, spread: float = 0.0
) -> Particles:
    """K particles that all know the landmarks with covariance Sigma, each with its own error of deviation `spread`."""
    rng = np.random.default_rng(11)
    number = len(landmarks)
    theta = landmarks + spread * rng.standard_normal((K, number, 2))
    maps = MapStore(Point()).empty(K)
    maps = maps.append(np.ones((K, number), bool), theta, np.tile(Sigma, (K, number, 1, 1)), np.arange(number))
    s = start + spread * rng.standard_normal((K, 3))
    return Particles(s, np.tile(np.zeros((3, 3)) + P, (K, 1, 1)), np.full(K, -math.log(K)), np.arange(K), maps)


def known_frame(seed: int = 6) -> tuple[Frame, Floats]:
    """A frame in which the robot sees some landmarks, and all there are."""
    world = plain.simulate(seed, steps=1)
    assert len(world.frames[0].z) >= 4
    return world.frames[0], world.landmarks


def parameters(**changes: Any) -> Params:
    settings = {"believed": plain.WORLD_NOISE, "association": "known", "resample_below": 0.0, "particles": 7}
    return Params(**(settings | changes))


def one_step(key: str, particles: Particles, frame: Frame, params: Params, seed: int = 1) -> Trace:
    return ESTIMATORS[key].step(np.random.default_rng(seed), particles, frame, params)[1]


# One innovation, three ways to spend it -------------------------------------------------------------------------------


def test_in_a_perfect_map_fastslam2_proposes_what_dual_fastslam_holds() -> None:
    """With Sigma = 0 one equation is left; FastSLAM 2.0 then draws from the pose Gaussian, Dual FastSLAM keeps it."""
    frame, landmarks = known_frame()
    particles = with_map(7, landmarks, np.zeros((2, 2)), P=P0, spread=0.05)
    dual = one_step("dfs", particles, frame, parameters(weighting="joint"))
    fast2 = one_step("fs2", particles, frame, parameters())
    np.testing.assert_array_equal(dual.weighted.s, fast2.weighted.s)
    np.testing.assert_array_equal(dual.weighted.P, fast2.weighted.P)
    np.testing.assert_array_equal(dual.weighted.log_w, fast2.weighted.log_w)
    assert np.ptp(dual.weighted.log_w) > 0.1
    np.testing.assert_array_equal(dual.resampled.P, dual.weighted.P)
    assert (fast2.resampled.s != fast2.weighted.s).all()
    assert not fast2.resampled.P.any()


def test_in_a_perfect_map_ekf_slam_is_dual_fastslam() -> None:
    world = plain.simulate(seed=7, everything=True)
    number = len(world.landmarks)
    one = with_map(1, world.landmarks, np.zeros((2, 2)), P=P0)
    covariance = np.zeros((3 + 2 * number, 3 + 2 * number))
    covariance[:3, :3] = P0
    dual, ekf = one, EkfState(one, covariance)
    params, rng = parameters(particles=1), np.random.default_rng(0)
    for frame in world.frames:
        dual, _ = ESTIMATORS["dfs"].step(rng, dual, frame, params)
        ekf, _ = ESTIMATORS["ekf"].step(rng, ekf, frame, params)
        np.testing.assert_allclose(wrap_all(ekf.particles.s - dual.s), 0.0, atol=1e-9)
        np.testing.assert_allclose(ekf.covariance[:3, :3], dual.P[0], atol=1e-9)
        assert not ekf.covariance[3:].any()


@pytest.mark.parametrize("proposal_weight", ["integrated", "drawn"])
def test_without_motion_noise_fastslam2_is_fastslam1(proposal_weight: Any) -> None:
    """P = 0 leaves nothing to draw and nothing to correct in the pose."""
    world = plain.simulate(seed=8)
    believed = Noise(speed=0.0, turn=0.0, range=0.1, bearing=0.02)
    params = parameters(believed=believed, proposal_weight=proposal_weight)
    runs = {key: ESTIMATORS[key].init(Point(), START, np.zeros((3, 3)), params) for key in ("fs1", "fs2")}
    for frame in world.frames:
        for key, state in runs.items():
            runs[key], _ = ESTIMATORS[key].step(np.random.default_rng(0), state, frame, params)
        np.testing.assert_allclose(wrap_all(runs["fs1"].s - runs["fs2"].s), 0.0, atol=1e-12)
        np.testing.assert_allclose(runs["fs1"].log_w, runs["fs2"].log_w, atol=1e-9)
        for one, other in zip(runs["fs1"].maps.features(0), runs["fs2"].maps.features(0), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)


def test_with_certain_pose_and_map_all_weigh_alike() -> None:
    """P = 0 and Sigma = 0: V = R for everyone, chained or not."""
    frame, landmarks = known_frame()
    frame = frame._replace(u=frame.u[:0], dt=frame.dt[:0])
    particles = with_map(7, landmarks, np.zeros((2, 2)), spread=0.05)
    log_w = [
        one_step(key, particles, frame, parameters(weighting=weighting, proposal_weight=proposal)).weighted.log_w
        for key, weighting, proposal in [
            ("fs1", "joint", "integrated"),
            ("fs2", "joint", "integrated"),
            ("fs2", "joint", "drawn"),
            ("dfs", "joint", "integrated"),
            ("dfs", "marginal", "integrated"),
        ]
    ]
    assert np.ptp(log_w[0]) > 1.0
    for other in log_w[1:]:
        np.testing.assert_allclose(other, log_w[0], rtol=0.0, atol=1e-10)


def test_for_one_observation_marginal_is_joint() -> None:
    frame, landmarks = known_frame()
    particles = with_map(7, landmarks, np.zeros((2, 2)), P=P0, spread=0.05)
    one = frame._replace(z=frame.z[:1], tags=frame.tags[:1])
    for several, same in ((one, True), (frame, False)):
        log_w = [
            one_step("dfs", particles, several, parameters(weighting=weighting)).weighted.log_w
            for weighting in ("marginal", "joint")
        ]
        assert np.allclose(log_w[0], log_w[1], rtol=0.0, atol=1e-12) == same


@pytest.mark.parametrize("key", ALL)
def test_without_noise_all_track_the_truth(key: str) -> None:
    """Exact data, noise of a micrometre believed: whatever is drawn and however often, no one may be further off."""
    nothing = Noise(speed=0.0, turn=0.0, range=0.0, bearing=0.0)
    believed = Noise(speed=1e-6, turn=1e-6, range=1e-6, bearing=1e-6)
    world = plain.simulate(seed=9, noise=nothing)
    params = parameters(believed=believed, resample_below=0.75)
    state, rng = ESTIMATORS[key].init(Point(), np.zeros(3), np.zeros((3, 3)), params), np.random.default_rng(10)
    for frame, truth in zip(world.frames, world.truth[1:], strict=True):
        state, trace = ESTIMATORS[key].step(rng, state, frame, params)
        for particles in (trace.predicted, trace.weighted, trace.resampled):
            away = particles.s - truth
            away[:, 2] = wrap_all(away[:, 2])
            np.testing.assert_allclose(away, 0.0, atol=3e-5)
    particles = particles_of(state)
    for k in range(len(particles.s)):
        theta, _, tags = particles.maps.features(k)
        assert sorted(tags) == list(range(len(world.landmarks)))
        np.testing.assert_allclose(theta, world.landmarks[tags], atol=5e-5)


def test_one_particle_always_weighs_one() -> None:
    world = plain.simulate(seed=12)
    for key in SIBLINGS:
        state, rng = ESTIMATORS[key].init(Point(), START, P0, parameters(particles=1)), np.random.default_rng(2)
        for frame in world.frames:
            state, trace = ESTIMATORS[key].step(rng, state, frame, parameters(particles=1, resample_below=0.75))
            assert state.log_w == [0.0]
            assert trace.n_eff == pytest.approx(1.0)
            assert not trace.did_resample
        assert np.hypot(*(state.s[0, :2] - world.truth[-1, :2])) < 2.0


# Particles do not know of each other ----------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ["known", "nearest", "jcbb"])
def test_permuted_particles_give_permuted_results(association: Any) -> None:
    frame, landmarks = known_frame()
    particles = with_map(9, landmarks, 0.01 * np.eye(2), P=P0, spread=0.05)
    frozen = with_map(9, landmarks, np.zeros((2, 2)), P=P0, spread=0.05)
    order = np.random.default_rng(3).permutation(9)
    assert list(order) != list(range(9))

    def permuted(given: Particles) -> Particles:
        s, P, log_w, lineage, maps = given
        return Particles(s[order], P[order], log_w[order], lineage[order], maps.select(order))

    params = parameters(particles=9, association=association, gate=0.999)
    # Dual FastSLAM where nothing is new, and all of FastSLAM that is not drawn
    a, b = one_step("dfs", frozen, frame, params), one_step("dfs", permuted(frozen), frame, params)
    assert (a.n != NEW).all()
    for of_a, of_b in zip(a.resampled[:4], b.resampled[:4], strict=True):
        if of_a.dtype == float:
            np.testing.assert_allclose(of_b, of_a[order], rtol=0.0, atol=1e-14)
        else:
            np.testing.assert_array_equal(of_b, of_a[order])
    a, b = one_step("fs2", particles, frame, params), one_step("fs2", permuted(particles), frame, params)
    np.testing.assert_array_equal(b.n, a.n[order])
    np.testing.assert_array_equal(b.weighted.s, a.weighted.s[order])
    np.testing.assert_array_equal(b.log_likelihood, a.log_likelihood[order])
    R = observation_noise(frame, Params(believed=plain.WORLD_NOISE))
    updated, weighed = update_features(particles, frame, matched_features(particles.maps, a.n), R, UNWEIGHED)
    turned = permuted(particles)
    updated_b, weighed_b = update_features(turned, frame, matched_features(turned.maps, b.n), R, UNWEIGHED)
    np.testing.assert_array_equal(weighed_b.log_p, weighed.log_p[order])
    for k in range(9):
        np.testing.assert_array_equal(updated_b.maps.features(k)[0], updated.maps.features(order[k])[0])


# Association that is easy ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ["nearest", "jcbb"])
@pytest.mark.parametrize("key", ALL)
def test_easy_association_changes_no_number(key: str, association: Any) -> None:
    """Landmarks metres apart, a sensor of centimetres: what the filter finds is what the tags say.

    The weight of a miss counts only where particles may disagree on it, so numbers are compared while nothing is new.
    """
    precise = Noise(speed=0.05, turn=0.02, range=0.1, bearing=0.02)
    world = plain.simulate(seed=13, noise=precise, steps=30)
    known = parameters(believed=precise, particles=12, inflate_r=4.0, gate=1.0 - 1e-9, resample_below=0.75)
    found = dataclasses.replace(known, association=association)
    state, compared = ESTIMATORS[key].init(Point(), np.zeros(3), np.zeros((3, 3)), known), 0
    for number, frame in enumerate(world.frames):
        other, other_trace = ESTIMATORS[key].step(np.random.default_rng(number), state, frame, found)
        state, trace = ESTIMATORS[key].step(np.random.default_rng(number), state, frame, known)
        np.testing.assert_array_equal(other_trace.n, trace.n)
        if (trace.n >= 0).all():
            compared += 1
            for a, b in zip(particles_of(state)[:4], particles_of(other)[:4], strict=True):
                np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(other_trace.log_likelihood, trace.log_likelihood)
            for a, b in zip(particles_of(state).maps.features(0), particles_of(other).maps.features(0), strict=True):
                np.testing.assert_array_equal(a, b)
            if isinstance(state, EkfState):
                np.testing.assert_array_equal(state.covariance, other.covariance)
    assert compared > 15


def test_the_order_of_observations_does_not_change_nearest() -> None:
    """Crowded landmarks and a vague pose: pairs compete, and the winner is not the one that came first."""
    rng = np.random.default_rng(14)
    landmarks = np.array([5.0, 0.0]) + rng.uniform(-1.0, 1.0, (8, 2))
    particles = with_map(30, landmarks, 0.02 * np.eye(2), start=np.zeros(3), P=0.3 * P0, spread=0.05)
    z = np.array([plain.observe(np.zeros(3), theta) for theta in landmarks[:5]]) + 0.1 * rng.standard_normal((5, 2))
    frame = Frame(0.0, Unicycle(), np.empty((0, 2)), np.empty(0), Point(), z, np.full(5, -1))
    params = parameters(particles=30, association="nearest")
    R = observation_noise(frame, Params(believed=plain.WORLD_NOISE))
    n = associate(particles, frame, R, params)
    assert {NEW, IGNORED} & set(n.ravel()), "pairs compete: some observation comes away empty-handed"
    assert len({tuple(row) for row in n}) > 3, "and not the same in all particles"
    for order in itertools.permutations(range(5)):
        R_turned = R._replace(sensor=R.sensor[list(order)])
        turned = associate(particles, frame._replace(z=z[list(order)]), R_turned, params)
        np.testing.assert_array_equal(turned, n[:, list(order)])
