"""Each mistake does what it says, on a case made by hand, and the filters stay what they are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from slam import phases
from slam.estimators import ESTIMATORS
from slam.features import Point
from slam.map_store import MapStore
from slam.mistakes import MISTAKES, pieces, with_mistake
from slam.mistakes.unwrapped import unwrapped
from slam.phases import UNWEIGHED, initial, matched_features, observation_noise
from slam.types import NEW, Floats, Frame, Ints, Params, Particles, Trace
from tests.slam import plain

PAIRS = [(name, key) for name, mistake in MISTAKES.items() for key in mistake.phases]


def run(step: Any, steps: int = 8, **changes: Any) -> list[Trace]:
    choice = {"particles": 20, "believed": plain.WORLD_NOISE, "association": "known"} | changes
    params, traces = Params(**choice), []
    state = initial(Point(), np.zeros(3), np.diag([0.1, 0.1, 0.02]) ** 2, params)
    for number, frame in enumerate(plain.simulate(seed=3, steps=steps).frames):
        state, trace = step(np.random.default_rng(number), state, frame, params)
        traces.append(trace)
    return traces


def with_weights(w: list[float], lineage: list[int] | None = None, s: Floats | None = None) -> Particles:
    K = len(w)
    with np.errstate(divide="ignore"):
        log_w = np.log(w)
    poses = np.zeros((K, 3)) if s is None else s
    ancestors = np.arange(K) if lineage is None else np.array(lineage)
    return Particles(poses, np.zeros((K, 3, 3)), log_w, ancestors, MapStore(Point()).empty(K))


def seen(z: list[list[float]]) -> Frame:
    frame = plain.simulate(seed=3, steps=1).frames[0]
    return frame._replace(z=np.array(z), tags=np.arange(len(z)))


def noise_of(frame: Frame) -> Any:
    return observation_noise(frame, Params(believed=plain.WORLD_NOISE))


def test_each_is_told_in_sentences() -> None:
    assert all(mistake.what.endswith(".") and mistake.signature.endswith(".") for mistake in MISTAKES.values())


@pytest.mark.parametrize(("name", "key"), PAIRS)
def test_the_filter_itself_stays_what_it_is(name: str, key: str) -> None:
    before = run(ESTIMATORS[key].step)
    wrong = with_mistake(ESTIMATORS[key], name)
    assert name in wrong.title
    assert wrong.key == key
    run(wrong.step)
    for a, b in zip(before, run(ESTIMATORS[key].step), strict=True):
        np.testing.assert_array_equal(a.weighted.log_w, b.weighted.log_w)
        np.testing.assert_array_equal(a.resampled.s, b.resampled.s)


@pytest.mark.parametrize("name", MISTAKES)
def test_what_is_exchanged_has_the_name_of_a_phase(name: str) -> None:
    for exchanged in MISTAKES[name].phases.values():
        assert all(callable(getattr(phases, phase)) for phase in exchanged)


def test_a_mistake_that_a_filter_cannot_make() -> None:
    with pytest.raises(ValueError, match="features-first is no mistake of Dual FastSLAM"):
        with_mistake(ESTIMATORS["dfs"], "features-first")
    assert all("ekf" not in mistake.phases for mistake in MISTAKES.values())


# Maps -----------------------------------------------------------------------------------------------------------------


def test_who_writes_when() -> None:
    of, rows = pieces.turns(np.array([7, 2, 7, 7, 5]))
    np.testing.assert_array_equal(of, [2, 0, 2, 2, 1])
    np.testing.assert_array_equal(rows, [[1, 4, 0], [-1, -1, 2], [-1, -1, 3]])


def test_copies_correct_one_and_the_same_feature_in_turn() -> None:
    """Three copies see a feature, one stranger does: its covariance shrinks thrice, and once."""
    frame, s = seen([[2.0, 0.1]]), np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.2, 0.0, 0.0]])
    particles = with_weights([0.25] * 4, [0, 0, 0, 3], s)
    one = np.ones((4, 1), bool)
    maps = particles.maps.append(one, np.tile([2.0, 0.2], (4, 1, 1)), np.tile(np.eye(2), (4, 1, 1, 1)), np.array([0]))
    particles, n, R = particles._replace(maps=maps), np.zeros((4, 1), int), noise_of(frame)
    wrong, weighed = pieces.update_shared_features(particles, frame, matched_features(maps, n), R, UNWEIGHED)
    theta, Sigma = wrong.maps.take(n)
    np.testing.assert_array_equal(theta[0], theta[1])
    np.testing.assert_array_equal(Sigma[0], Sigma[2])
    np.testing.assert_array_equal(wrong.s, s)

    alone = particles
    for k in (0, 1, 2):  # one particle that stands where each copy does, after the other
        at = particles._replace(s=np.tile(s[k], (4, 1)), maps=alone.maps)
        alone, expected = phases.update_features(at, frame, matched_features(at.maps, n), R, UNWEIGHED)
        np.testing.assert_allclose(weighed.log_p[k], expected.log_p[k])
    np.testing.assert_allclose(theta[0], alone.maps.take(n)[0][0])
    np.testing.assert_allclose(Sigma[0], alone.maps.take(n)[1][0])
    right, _ = phases.update_features(particles, frame, matched_features(maps, n), R, UNWEIGHED)
    np.testing.assert_allclose(theta[3], right.maps.take(n)[0][3])


@pytest.mark.parametrize("key", ["dfs", "fs1"])
def test_copies_add_to_one_and_the_same_map(key: str) -> None:
    frame = seen([[2.0, 0.1], [3.0, -0.5]])
    particles, n = with_weights([0.25] * 4, [0, 0, 0, 3]), np.array([[NEW, NEW], [NEW, 0], [NEW, 0], [NEW, 0]])
    if key == "dfs":
        wrong = pieces.draw_shared_features(np.random.default_rng(0), particles, frame, n, noise_of(frame))
    else:
        wrong = pieces.add_shared_features(particles, frame, n, noise_of(frame))
    np.testing.assert_array_equal(wrong.maps.counts, [4, 4, 4, 1])
    np.testing.assert_array_equal(wrong.maps.features(0)[0], wrong.maps.features(2)[0])


# Weights and resampling -----------------------------------------------------------------------------------------------


def test_copies_keep_their_weight() -> None:
    particles, params = with_weights([0.7, 0.1, 0.1, 0.1]), Params(particles=4)
    wrong, ancestors, _, did = pieces.keep_weights(np.random.default_rng(0), particles, params)
    assert did
    w = np.exp(particles.log_w)[ancestors]
    np.testing.assert_allclose(np.exp(wrong.log_w), w / w.sum())
    resized, ancestors = pieces.resize_and_keep_weights(np.random.default_rng(0), particles, Params(particles=9))
    assert len(ancestors) == 9
    assert np.ptp(resized.log_w) == pytest.approx(math.log(7.0))


def test_products_of_densities_underflow() -> None:
    particles = with_weights([0.5, 0.5])
    fine = np.array([[-1.0, -2.0], [-1.0, -3.0]])
    right, _ = phases.reweigh(particles, fine)
    np.testing.assert_allclose(pieces.multiply_densities(particles, fine)[0].log_w, right.log_w)
    lost, events = pieces.multiply_densities(particles, np.array([[-400.0, -400.0], [-500.0, -400.0]]))
    np.testing.assert_allclose(np.exp(lost.log_w), 0.5)
    assert not events
    one, _ = pieces.multiply_densities(particles, np.array([[-300.0, -400.0], [-400.0, -400.0]]))
    np.testing.assert_array_equal(np.exp(one.log_w), [1.0, 0.0])


def test_resampled_at_every_step() -> None:
    traces = run(with_mistake(ESTIMATORS["fs2"], "resample-always").step, resample_below=0.0)
    assert all(trace.did_resample for trace in traces)
    assert not any(trace.did_resample for trace in run(ESTIMATORS["fs2"].step, resample_below=0.0))


def test_the_first_particle_lives_for_ever() -> None:
    particles, params = with_weights([0.0, 0.5, 0.5, 0.0]), Params(particles=4)
    for seed in range(5):
        wrong, ancestors, _, did = pieces.resample_and_keep_first(np.random.default_rng(seed), particles, params)
        _, right, _, _ = phases.resample_if_needed(np.random.default_rng(seed), particles, params)
        assert did
        np.testing.assert_array_equal(ancestors, [0, *right[1:]])
        np.testing.assert_array_equal(wrong.lineage, ancestors)
    equal = with_weights([0.25] * 4)
    assert not pieces.resample_and_keep_first(np.random.default_rng(0), equal, params)[3]


# Proposals, order, angles ---------------------------------------------------------------------------------------------


def distinct(rows: Floats | Ints) -> int:
    return len(np.unique(rows, axis=0))


@pytest.mark.parametrize("key", ["dfs", "fs2", "fs1"])
def test_nothing_is_drawn(key: str) -> None:
    for trace in run(with_mistake(ESTIMATORS[key], "unsampled-proposal").step):
        assert distinct(trace.resampled.s) == 1
        assert len({trace.weighted.maps.features(k)[0].tobytes() for k in range(20)}) == 1
        assert trace.n_eff == pytest.approx(20.0)
    assert distinct(run(ESTIMATORS[key].step)[-1].resampled.s) > 1


def test_the_numbers_that_are_not_drawn_are_taken_all_the_same() -> None:
    """So that a run with the mistake resamples by the same numbers as the right one."""
    one, other = np.random.default_rng(0), np.random.default_rng(0)
    particles = with_weights([0.5, 0.5])
    pieces.take_mean_pose(one, particles)
    phases.draw_pose(other, particles)
    assert one.random() == other.random()


def test_features_are_corrected_before_the_pose() -> None:
    """The first innovation is what is left of it after the feature was corrected at the predicted pose."""
    trace = run(with_mistake(ESTIMATORS["fs2"], "features-first").step)[3]
    k, i = 0, int(np.flatnonzero(trace.n[0] >= 0)[0])
    frame = plain.simulate(seed=3, steps=8).frames[3]
    for maps, same in ((trace.weighted.maps, True), (trace.predicted.maps, False)):
        theta = maps.features(k)[0][trace.n[k, i]]
        v = plain.innovation(frame.z[i], trace.predicted.s[k], theta)
        assert np.allclose(v, trace.innovations.v[k, i], atol=1e-12) == same


def test_a_difference_of_angles_is_a_turn_off() -> None:
    theta, s, z = (-5.0, -0.1), (0.0, 0.0, math.pi - 0.01), (5.0, 0.01)
    point, wrong = Point(), unwrapped(Point())
    v, *right = Point.innovation(point, theta, s, z)
    wrong_v, *Jacobians = wrong.innovation(wrong, theta, s, z)
    assert wrong_v[1] - v[1] == pytest.approx(2.0 * math.pi)
    assert (wrong_v[0], *Jacobians) == (v[0], *right)


@pytest.mark.parametrize("key", ["dfs", "fs2", "fs1"])
def test_the_filter_weighs_by_the_unwrapped_angle(key: str) -> None:
    """A robot that looks back across -180 degrees, at a feature that it knows."""
    s = np.array([[0.0, 0.0, math.pi - 0.01]])
    theta = np.array([[[-5.0, -0.1]]])
    maps = MapStore(Point()).empty(1).append(np.ones((1, 1), bool), theta, np.zeros((1, 1, 2, 2)), np.array([0]))
    P = np.diag([0.01, 0.01, 0.01])[None] if key != "fs1" else np.zeros((1, 3, 3))
    particles = Particles(s, P, np.zeros(1), np.zeros(1, int), maps)
    frame = seen([plain.observe(s[0], theta[0, 0]).tolist()])
    frame = frame._replace(u=frame.u[:0], dt=frame.dt[:0])
    params = Params(particles=1, believed=plain.WORLD_NOISE, association="known")
    for step, far in ((ESTIMATORS[key].step, False), (with_mistake(ESTIMATORS[key], "unwrapped-angles").step, True)):
        _, trace = step(np.random.default_rng(0), particles, frame, params)
        assert (abs(trace.innovations.v[0, 0, 1]) > 6.0) == far
