"""EKF-SLAM against numeric Jacobians, the exact joint Kalman filter, and its own claim of how good it is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from slam.ekf_slam import EKF_SLAM, EkfState
from slam.features import Point
from slam.geometry import wrap_all
from slam.scores import association_score
from slam.types import Floats, Frame, Noise, Params
from tests.slam import linear, plain
from tests.slam.linear import Linear, joint_kalman, simulate_linear, uncached_kernels

START = np.array([0.1, -0.1, 0.05])
P0 = np.array([[0.01, 0.002, 0.001], [0.002, 0.02, -0.001], [0.001, -0.001, 0.001]])


def begin(params: Params, start: Floats = START, covariance: Floats = P0) -> EkfState:
    return EKF_SLAM.init(Point(), start, covariance, params)


def mean_of(state: EkfState) -> tuple[Floats, list[int]]:
    """(3 + 2n,) pose and features, and their tags."""
    theta, _, tags = state.particles.maps.features(0)
    return np.concatenate([state.particles.s[0], theta.ravel()]), list(tags)


# Another implementation: dense matrices, numeric Jacobians ------------------------------------------------------------


def numeric_jacobian(function: Any, x: Floats, angle: int | None = None) -> Floats:
    """Central differences; the row `angle` of the result is a difference of angles."""
    columns, step = [], 1e-5
    for i in range(len(x)):
        e = np.zeros(len(x))
        e[i] = step
        difference = function(x + e) - function(x - e)
        if angle is not None:
            difference[angle] = plain.wrap(difference[angle])
        columns.append(difference / (2.0 * step))
    return np.stack(columns, axis=1)


def dense_step(
    x: Floats, C: Floats, tags: list[int], frame: Frame, params: Params
) -> tuple[Floats, Floats, list[int], float]:
    """Predict, correct on what is known, one after the other, and append what is new, all on the whole state."""
    believed, log_p = params.believed, 0.0
    Q, R = np.diag([believed.speed, believed.turn]) ** 2, np.diag([believed.range, believed.bearing]) ** 2
    for u, dt in zip(frame.u, frame.dt, strict=True):

        def moved(x: Floats, u: Floats = u, dt: float = dt) -> Floats:
            return np.concatenate([plain.move(x[:3], u, dt), x[3:]])

        F = numeric_jacobian(moved, x, angle=2)
        B = numeric_jacobian(lambda u, x=x, moved=moved: moved(x, u), u, angle=2)
        x, C = moved(x), F @ C @ F.T + B @ Q @ B.T
    known = list(tags)
    for tag, z in zip(frame.tags, frame.z, strict=True):
        if tag in known:
            f = 3 + 2 * known.index(tag)

            def seen(x: Floats, f: int = f) -> Floats:
                return plain.observe(x[:3], x[f : f + 2])

            H, v = numeric_jacobian(seen, x, angle=1), z - seen(x)
            v[1] = plain.wrap(v[1])
            V = H @ C @ H.T + params.inflate_r * R
            log_p += plain.log_gauss(v, V)
            K = C @ H.T @ np.linalg.inv(V)
            x, C = x + K @ v, C - K @ V @ K.T
            x[2] = plain.wrap(x[2])
    for tag, z in zip(frame.tags, frame.z, strict=True):
        if tag not in known:

            def grown(xz: Floats) -> Floats:
                x, z = xz[:-2], xz[-2:]
                return np.concatenate([x, x[:2] + z[0] * np.array([math.cos(x[2] + z[1]), math.sin(x[2] + z[1])])])

            J = numeric_jacobian(grown, np.concatenate([x, z]))
            x = grown(np.concatenate([x, z]))
            C = J @ np.block([[C, np.zeros((len(C), 2))], [np.zeros((2, len(C))), R]]) @ J.T
            tags = [*tags, int(tag)]
    return x, C, tags, log_p


@pytest.mark.parametrize("inflate_r", [1.0, 3.0])
def test_same_numbers_with_numeric_jacobians(inflate_r: float) -> None:
    world = plain.simulate(seed=3)
    params = Params(believed=plain.WORLD_NOISE, association="known", inflate_r=inflate_r)
    state = begin(params)
    x, C, tags = START, P0, []
    cross = 0.0
    for frame in world.frames:
        prediction = plain.predicted(plain.Particle(x[:3], C[:3, :3], 0.0), frame, plain.WORLD_NOISE)
        state, trace = EKF_SLAM.step(np.random.default_rng(0), state, frame, params)
        x, C, tags, log_p = dense_step(x, C, tags, frame, params)
        mean, found_tags = mean_of(state)
        assert found_tags == tags
        difference = mean - x
        difference[2] = plain.wrap(difference[2])
        np.testing.assert_allclose(difference, 0.0, atol=1e-7)
        np.testing.assert_allclose(state.covariance, C, atol=1e-8)
        assert trace.log_likelihood.sum() == pytest.approx(log_p, abs=1e-5)
        np.testing.assert_allclose(state.covariance, state.covariance.T, rtol=0.0, atol=1e-16)
        assert np.linalg.eigvalsh(state.covariance).min() > 0.0
        # The trace keeps the prediction, and the one particle holds the marginals.
        np.testing.assert_allclose(wrap_all(trace.predicted.s[0] - prediction.s), 0.0, atol=1e-7)
        np.testing.assert_allclose(trace.predicted.P[0], prediction.P, atol=1e-8)
        np.testing.assert_array_equal(state.particles.P[0], state.covariance[:3, :3])
        for j, Sigma in enumerate(state.particles.maps.features(0)[1]):
            f = slice(3 + 2 * j, 5 + 2 * j)
            np.testing.assert_allclose(Sigma, state.covariance[f, f], rtol=0.0, atol=1e-16)
        cross = max(cross, np.abs(C[:3, 3:]).max(initial=0.0))
    assert len(tags) == len(world.landmarks)
    assert cross > 1e-3  # what is compared is far from zero


def test_is_the_exact_posterior_in_a_linear_world() -> None:
    frames = simulate_linear(seed=0)
    params = Params(believed=linear.NOISE, association="known")
    with uncached_kernels():
        state = EKF_SLAM.init(Linear(), np.zeros(3), np.zeros((3, 3)), params)
        for frame, exact in zip(frames, joint_kalman(frames), strict=True):
            state, trace = EKF_SLAM.step(np.random.default_rng(0), state, frame, params)
            mean, tags = mean_of(state)
            assert tags == exact.order
            keep = np.delete(np.arange(len(mean)), 2)
            np.testing.assert_allclose(mean[keep], exact.mean, atol=1e-9)
            np.testing.assert_allclose(state.covariance[np.ix_(keep, keep)], exact.covariance, atol=1e-9)
            assert mean[2] == 0.0
            assert not state.covariance[2].any()
            assert trace.log_likelihood.sum() == pytest.approx(exact.log_evidence, abs=1e-9)


# Is it as good as it says? --------------------------------------------------------------------------------------------


def test_consistent_on_a_mild_world() -> None:
    """NEES of the pose and of the landmarks, summed over 50 runs of 10 steps, in their 99.9 % chi-square intervals."""
    mild = Noise(speed=0.05, turn=0.02, range=0.05, bearing=0.01)
    params = Params(believed=mild, association="known")
    runs, nees, map_nees, map_dims = 50, 0.0, 0.0, 0
    for seed in range(runs):
        world = plain.simulate(seed=100 + seed, steps=10, noise=mild)
        state = begin(params, np.zeros(3), np.zeros((3, 3)))
        for frame in world.frames:
            state, _ = EKF_SLAM.step(np.random.default_rng(0), state, frame, params)
        mean, tags = mean_of(state)
        error = mean - np.concatenate([world.truth[-1], world.landmarks[tags].ravel()])
        error[2] = plain.wrap(error[2])
        nees += error[:3] @ np.linalg.solve(state.covariance[:3, :3], error[:3])
        map_nees += error[3:] @ np.linalg.solve(state.covariance[3:, 3:], error[3:])
        map_dims += len(error) - 3
    for found, degrees in ((nees, 3 * runs), (map_nees, map_dims)):
        low, high = chi2.ppf([0.0005, 0.9995], degrees)
        assert low < found < high


@pytest.mark.parametrize("association", ["nearest", "jcbb"])
def test_finds_the_associations_of_an_easy_world(association: Any) -> None:
    mild = Noise(speed=0.05, turn=0.02, range=0.05, bearing=0.01)
    params = Params(believed=mild, association=association, gate=0.999999, gate_new=0.0)
    wrong = missed = correct = 0
    for seed in range(5):
        world = plain.simulate(seed=200 + seed, noise=mild)
        state = begin(params, np.zeros(3), np.zeros((3, 3)))
        for frame in world.frames:
            map_tags = state.particles.maps.features(0)[2]
            state, trace = EKF_SLAM.step(np.random.default_rng(0), state, frame, params)
            held = np.isin(frame.tags, map_tags)
            counts = association_score(trace.n[0], frame.tags, map_tags, held)
            correct, wrong, missed = correct + counts[0], wrong + counts[1], missed + counts[2]
        assert sorted(mean_of(state)[1]) == list(range(len(world.landmarks)))
    assert (wrong, missed) == (0, 0)
    assert correct > 500


def test_draws_nothing_and_keeps_headings_in_range() -> None:
    world, params = plain.simulate(seed=4, steps=40), Params(believed=plain.WORLD_NOISE, association="jcbb")
    state, headings = begin(params), []
    for frame in world.frames:
        state, trace = EKF_SLAM.step(None, state, frame, params)  # type: ignore[arg-type]
        headings += [trace.predicted.s[0, 2], state.particles.s[0, 2]]
    assert np.ptp(headings) > 5.0, "it turned round"
    assert -math.pi <= min(headings)
    assert max(headings) < math.pi
