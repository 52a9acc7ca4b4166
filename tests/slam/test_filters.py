"""What every filter must keep to, whatever it is given: reproducible, immutable, finite, calibrated."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from slam.association import associate
from slam.association.jcbb import chi_square_gates
from slam.ekf_slam import EkfState
from slam.estimators import ESTIMATORS
from slam.features import Point
from slam.map_store import Maps, MapStore
from slam.motion import Odometry, Unicycle
from slam.phases import (
    Matched,
    Miss,
    miss_density,
    observation_noise,
    select,
    update_features,
    update_pose,
    weigh_marginal,
)
from slam.resampling import SCHEMES
from slam.types import IGNORED, NEW, Floats, Frame, Noise, ObservationNoise, Params, Particles, Trace
from tests.slam import plain
from tests.slam.linear import Linear, uncached_kernels

SIBLINGS = ["fs1", "fs2", "dfs"]
ALL = [*SIBLINGS, "ekf"]
ASSOCIATIONS = ["known", "nearest", "jcbb"]
START = np.array([0.1, -0.1, 0.05])
P0 = np.diag([0.1, 0.1, 0.02]) ** 2


def parameters(**changes: Any) -> Params:
    return Params(**({"believed": plain.WORLD_NOISE, "association": "known", "particles": 20} | changes))


def begin(key: str, params: Params) -> Any:
    return ESTIMATORS[key].init(Point(), START, P0, params)


def run(key: str, params: Params, frames: list[Frame], seed: int = 1) -> tuple[Any, list[Trace]]:
    state, rng, traces = begin(key, params), np.random.default_rng(seed), []
    for frame in frames:
        state, trace = ESTIMATORS[key].step(rng, state, frame, params)
        traces.append(trace)
    return state, traces


def arrays(value: Any) -> Iterator[np.ndarray]:
    """All arrays in a state, a trace or a frame, the features of every map included."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Maps):
        yield value.counts
        for k in range(len(value)):
            yield from value.features(k)
    elif isinstance(value, tuple):
        for part in value:
            yield from arrays(part)


def contents(value: Any) -> list[bytes]:
    return [array.tobytes() for array in arrays(value)]


def assert_sound(value: Any) -> None:
    """Finite; headings in [-pi, pi); covariances symmetric and positive semidefinite."""
    known = value._replace(innovations=()) if isinstance(value, Trace) else value  # NaN where nothing is matched
    for array in arrays(known):
        assert not np.isnan(array).any()
    for particles in (value.predicted, value.weighted, value.resampled) if isinstance(value, Trace) else (value,):
        assert np.isfinite(particles.s).all()
        assert (-math.pi <= particles.s[:, 2]).all()
        assert (particles.s[:, 2] < math.pi).all()
        assert np.log(np.exp(particles.log_w).sum()) == pytest.approx(0.0, abs=1e-9)
        covariances = [particles.P, *(particles.maps.features(k)[1] for k in range(len(particles.s)))]
        for C in covariances:
            np.testing.assert_array_equal(C, C.swapaxes(-1, -2))
            largest = np.abs(C).max(initial=0.0)
            assert np.linalg.eigvalsh(C).min(initial=0.0) >= -1e-12 * largest


# Reproducible ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ASSOCIATIONS)
@pytest.mark.parametrize("key", ALL)
def test_same_seed_same_bits(key: str, association: Any) -> None:
    frames, params = plain.simulate(seed=1).frames, parameters(association=association)
    (state, traces), (again, traces_again) = run(key, params, frames), run(key, params, frames)
    assert contents(state) == contents(again)
    assert [contents(trace) for trace in traces] == [contents(trace) for trace in traces_again]
    for trace in traces:
        assert_sound(trace)
    if key in SIBLINGS:
        assert contents(run(key, params, frames, seed=2)[0]) != contents(state)


# Immutable ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ASSOCIATIONS)
@pytest.mark.parametrize("key", ALL)
def test_a_step_writes_to_nothing_that_it_was_given(key: str, association: Any) -> None:
    """Nor to what earlier steps gave: all states and traces of a run still hold what they held."""
    world, params = plain.simulate(seed=2), parameters(association=association, resample_below=0.9)
    state, rng, held, before = begin(key, params), np.random.default_rng(3), [], []
    for frame in world.frames:
        given = (state, frame)
        held.append(given)
        before.append(contents(given))
        state, trace = ESTIMATORS[key].step(rng, state, frame, params)
        held.append(trace)
        before.append(contents(trace))
    assert [contents(value) for value in held] == before


@pytest.mark.parametrize("key", ALL)
def test_a_step_takes_arrays_that_cannot_be_written(key: str) -> None:
    frames, params = plain.simulate(seed=2).frames, parameters()
    state, _ = run(key, params, frames[:2])
    expected = contents(ESTIMATORS[key].step(np.random.default_rng(5), state, frames[2], params)[0])
    particles = state.particles if isinstance(state, EkfState) else state
    given = [*particles[:4], particles.maps.roots, particles.maps.counts, frames[2].u, frames[2].dt, frames[2].z]
    given += [frames[2].tags, *([state.covariance] if isinstance(state, EkfState) else [])]
    for array in given:
        array.flags.writeable = False
    assert contents(ESTIMATORS[key].step(np.random.default_rng(5), state, frames[2], params)[0]) == expected


@pytest.mark.parametrize("key", SIBLINGS)
def test_maps_are_no_aliases_after_resampling(key: str) -> None:
    """Copies of one particle share their map until one of them changes, and then only that one changes."""
    state, _ = run(key, parameters(), plain.simulate(seed=4).frames[:3])
    copies = select(state, np.zeros(5, np.int64)).maps
    before = [copies.features(k)[0] for k in range(5)]
    n = np.full((5, 1), NEW)
    n[2] = 1
    changed = copies.replace(n, np.full((5, 1, 2), 99.0), np.full((5, 1, 2, 2), 7.0))
    for k in range(5):
        theta, Sigma, _ = changed.features(k)
        assert (theta[1] == 99.0).all() == (k == 2)
        assert (Sigma[1] == 7.0).all() == (k == 2)
        np.testing.assert_array_equal(np.delete(theta, 1, axis=0), np.delete(before[k], 1, axis=0))
        np.testing.assert_array_equal(copies.features(k)[0], before[k])


@pytest.mark.parametrize("key", ALL)
@pytest.mark.parametrize("choice", [{}, {"weighting": "joint"}, {"temper": 0.3}, {"association": "jcbb"}])
def test_innovations_are_those_of_the_weights(key: str, choice: dict) -> None:
    """What was matched is weighed by log N(v; 0, V) of the innovation that is told, and nothing is told of the rest."""
    _, traces = run(key, parameters(**choice), plain.simulate(seed=6).frames[:8])
    known = 0
    for trace in traces:
        v, V = trace.innovations
        matched = trace.n >= 0
        np.testing.assert_array_equal(np.isfinite(v).all(axis=-1), matched)
        np.testing.assert_array_equal(np.isfinite(V).all(axis=(-2, -1)), matched)
        densities = [plain.log_gauss(*pair) for pair in zip(v[matched], V[matched], strict=True)]
        np.testing.assert_allclose(choice.get("temper", 1.0) * np.array(densities), trace.log_likelihood[matched])
        known += int(matched.sum())
    assert known > 50 if key != "ekf" else known > 5


# Any number of particles, any resampling ------------------------------------------------------------------------------


@pytest.mark.parametrize("resampler", SCHEMES)
@pytest.mark.parametrize("key", SIBLINGS)
def test_the_number_of_particles_changes_at_any_step(key: str, resampler: Any) -> None:
    counts = [20, 50, 1, 30, 30, 2, 7]
    state, rng = begin(key, parameters(particles=counts[0])), np.random.default_rng(6)
    for number, frame in zip(counts, plain.simulate(seed=5).frames, strict=False):
        before = state
        state, trace = ESTIMATORS[key].step(rng, before, frame, parameters(particles=number, resampler=resampler))
        assert_sound(trace)
        for particles in (trace.predicted, trace.weighted, trace.resampled, state):
            assert [len(part) for part in particles] == [number] * 5
        assert trace.n.shape == trace.log_likelihood.shape == (number, len(frame.z))
        np.testing.assert_array_equal(trace.predicted.lineage, before.lineage[trace.resized])
        np.testing.assert_array_equal(state.lineage, before.lineage[trace.ancestors])
        np.testing.assert_array_equal(state.maps.roots, trace.weighted.maps.roots[trace.selected])
    assert len(set(state.lineage)) == 1  # there was only one particle for a while


@pytest.mark.parametrize("resampler", SCHEMES)
@pytest.mark.parametrize("key", SIBLINGS)
def test_resampling_never_and_always(key: str, resampler: Any) -> None:
    frames = plain.simulate(seed=6).frames[:8]
    for below, expected in ((0.0, False), (1.0, True)):
        state, traces = run(key, parameters(resample_below=below, resampler=resampler), frames)
        assert [trace.did_resample for trace in traces] == [expected] * len(frames)
        assert (np.ptp(state.log_w) == 0.0) == expected
        assert (len(set(state.lineage)) < 20) == expected
        for trace in traces:
            assert trace.n_eff == pytest.approx(1.0 / (np.exp(trace.weighted.log_w) ** 2).sum())


# Little or nothing to go by -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ASSOCIATIONS)
@pytest.mark.parametrize("key", ALL)
def test_nothing_seen_or_no_control(key: str, association: Any) -> None:
    frames = plain.simulate(seed=7).frames[:6]
    blind = [frame._replace(z=frame.z[:0], tags=frame.tags[:0]) for frame in frames]
    still = [frame._replace(u=frame.u[:0], dt=frame.dt[:0]) for frame in frames]
    neither = blind[0]._replace(u=frames[0].u[:0], dt=frames[0].dt[:0])
    params = parameters(association=association)
    # from the first step on, with an empty map, and with a map
    order = [blind[0], neither, frames[0], still[0], blind[1], neither, frames[2], still[2], frames[3]]
    state, traces = run(key, params, order)
    for frame, trace in zip(order, traces, strict=True):
        assert_sound(trace)
        assert trace.n.shape[1] == len(frame.z)
    blind_again = ESTIMATORS[key].step(np.random.default_rng(0), state, neither, params)[0]
    particles, after = (x.particles if isinstance(x, EkfState) else x for x in (state, blind_again))
    if key in ("dfs", "ekf"):
        np.testing.assert_array_equal(after.P, particles.P)
    np.testing.assert_array_equal(after.s, particles.s)
    np.testing.assert_allclose(after.log_w, particles.log_w, atol=1e-12)


@pytest.mark.parametrize("key", ALL)
def test_heading_goes_round(key: str) -> None:
    """Both ways round several times, with ticks that turn by more than half a circle."""
    for turn in (2.1, -2.1, 35.0, -35.0):
        motion, u = (Unicycle(), [1.0, turn]) if abs(turn) < 3.0 else (Odometry(), [0.1, 0.0, turn])
        dt, nothing = np.full(4, 0.2), np.empty((0, 2))
        empty = Frame(0.0, motion, np.tile(u, (4, 1)), dt, Point(), nothing, np.empty(0, np.int64))
        seen = empty._replace(z=np.array([[3.0, 3.1], [2.0, -3.1]]), tags=np.array([0, 1]))
        _, traces = run(key, parameters(), [seen, *[empty] * 12])
        headings = np.concatenate([trace.weighted.s[:, 2] for trace in traces])
        assert headings.max() - headings.min() > math.pi
        for trace in traces:
            assert_sound(trace)


# Absurd input ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "choice"),
    [
        ("fs1", {}),
        ("fs2", {"proposal_weight": "integrated"}),
        ("fs2", {"proposal_weight": "drawn"}),
        ("dfs", {"weighting": "marginal"}),
        ("dfs", {"weighting": "joint"}),
        ("ekf", {}),
    ],
)
def test_impossible_observations(key: str, choice: dict) -> None:
    """A known landmark seen absurdly far away.  At 100 km the weights stay finite; where the squared distance overflows
    an event says that they can't, and the particles go on as if that landmark had not been seen."""
    frames, params = plain.simulate(seed=8).frames, parameters(resample_below=0.0, **choice)
    state, _ = run(key, params, frames[:2])
    i = int(np.isin(frames[2].tags, frames[1].tags).argmax())
    for distance in (1e5, 1e160):
        z = frames[2].z.copy()
        z[i, 0] = distance
        after, trace = ESTIMATORS[key].step(np.random.default_rng(9), state, frames[2]._replace(z=z), params)
        assert trace.n[0, i] >= 0
        assert_sound(trace)
        assert bool(trace.events) == (distance > 1e5 and key != "ekf")
        assert (trace.log_likelihood[:, i] < -1e9).all()
        if distance > 1e5:
            assert np.ptp(trace.weighted.log_w) == 0.0
            others = np.arange(len(z)) != i
            without = frames[2]._replace(z=z[others], tags=frames[2].tags[others])
            if key in ("fs1", "ekf"):  # the others draw as many numbers only if as much is seen
                alone, _ = ESTIMATORS[key].step(np.random.default_rng(9), state, without, params)
                a, b = (x.particles if isinstance(x, EkfState) else x for x in (alone, after))
                np.testing.assert_array_equal(a.s, b.s)
                np.testing.assert_array_equal(a.maps.features(0)[0], b.maps.features(0)[0])
        ESTIMATORS[key].step(np.random.default_rng(9), after, frames[3], params)


@pytest.mark.parametrize("association", ASSOCIATIONS)
@pytest.mark.parametrize("key", ALL)
def test_tiny_noise_stays_finite(key: str, association: Any) -> None:
    """A micrometre believed, and as much real: entries of 1e-12 beside an uncertain start's 1."""
    tiny = Noise(speed=0.1, turn=0.05, range=1e-6, bearing=1e-6)
    frames = plain.simulate(seed=10, noise=tiny).frames
    params = parameters(believed=tiny, association=association, particles=8)
    start_covariance = np.eye(3) * [1.0, 1.0, 0.01]
    state, rng = ESTIMATORS[key].init(Point(), np.zeros(3), start_covariance, params), np.random.default_rng(2)
    for frame in frames:
        state, trace = ESTIMATORS[key].step(rng, state, frame, params)
        assert_sound(trace)


# Gates ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ["nearest", "jcbb"])
@pytest.mark.parametrize("uncertain", ["map", "pose", "both"])
def test_the_gate_lets_through_what_it_says(uncertain: str, association: Any) -> None:
    """FastSLAM has only the map uncertain, Dual FastSLAM only the pose.  Of all right pairs, a fraction alpha passes.

    Both errors are small beside the distance of 10 m, so that the linearised V is the true one.
    """
    rng, trials = np.random.default_rng(15), 2000
    s, theta = np.array([1.0, 2.0, 3.0]), np.array([-9.0, 3.0])
    factor = np.array([[0.05, 0.0, 0.0], [0.02, 0.04, 0.0], [0.001, -0.002, 0.003]])
    P = factor @ factor.T if uncertain != "map" else np.zeros((3, 3))
    spread = np.array([[0.05, 0.0], [0.03, 0.04]])
    Sigma = spread @ spread.T if uncertain != "pose" else np.zeros((2, 2))
    noise = Noise(range=0.03, bearing=0.005)
    maps = MapStore(Point()).empty(1).append(np.ones((1, 1), bool), theta[None, None], Sigma[None, None], np.array([0]))
    particles = Particles(s[None], P[None], np.zeros(1), np.zeros(1, np.int64), maps)
    empty = Frame(0.0, Unicycle(), np.empty((0, 2)), np.empty(0), Point(), np.empty((1, 2)), np.array([-1]))
    R = observation_noise(empty, Params(believed=noise))
    observations = []
    for _ in range(trials):
        true_s = s + (factor @ rng.standard_normal(3) if uncertain != "map" else 0.0)
        true_theta = theta + (spread @ rng.standard_normal(2) if uncertain != "pose" else 0.0)
        observations.append(plain.observe(true_s, true_theta) + [noise.range, noise.bearing] * rng.standard_normal(2))
    for alpha in (0.5, 0.9, 0.99):
        params = parameters(association=association, gate=alpha)
        n = np.array([associate(particles, empty._replace(z=z[None]), R, params)[0, 0] for z in observations])
        assert set(n) <= {0, NEW, IGNORED}
        standard_error = math.sqrt(alpha * (1.0 - alpha) / trials)
        assert abs((n == 0).mean() - alpha) < 3.0 * standard_error


def test_a_match_never_weighs_less_than_a_miss() -> None:
    """Under the same V: a match at the gate weighs what a miss does, any nearer one more.  `log_p_new` is added."""
    with uncached_kernels():
        directions = np.linspace(0.0, 2.0 * math.pi, 9)
        P = 0.04 * np.eye(3) + 0.01
        s = np.zeros((1, 3))
        for alpha, log_p_new in ((0.9, 0.0), (0.99, 0.0), (0.99, -2.5)):
            params = parameters(association="nearest", gate=alpha, log_p_new=log_p_new)
            gate, log_miss = chi_square_gates(alpha, 1)[1], miss_density(params, np.full((1, 1), NEW))
            R = np.diag([params.believed.range, params.believed.bearing]) ** 2
            for uncertain in (P, np.zeros((3, 3))):
                particles = Particles(
                    s, uncertain[None], np.zeros(1), np.zeros(1, np.int64), MapStore(Linear()).empty(1)
                )
                V = uncertain[:2, :2] + R
                at_gate = np.linalg.cholesky(V) @ [np.cos(directions), np.sin(directions)] * math.sqrt(gate)
                for v in at_gate.T:
                    for scale, sign in ((1.0, 0), (0.9, 1), (0.0, 1)):
                        match, miss = weigh_pair(particles, scale * v, R, log_miss)
                        assert np.ptp(match) == pytest.approx(0.0, abs=1e-12)
                        assert np.ptp(miss) == pytest.approx(0.0, abs=1e-12)
                        gain = match[0] - miss[0] + log_p_new
                        assert gain == pytest.approx(0.5 * gate * (1.0 - scale**2), abs=1e-9)
                        assert (gain > 1e-3) == bool(sign)


def weigh_pair(particles: Particles, v: Floats, R: Floats, log_miss: Miss) -> tuple[list[float], list[float]]:
    """The log density of an observation that is v off a certain feature, matched and missed, in every weighing phase.

    `update_features` is for P = 0 only.
    """
    frame = Frame(0.0, Odometry(), np.empty((0, 3)), np.empty(0), Linear(), np.array([[4.0, 5.0]]) + v, np.array([-1]))
    noise = ObservationNoise(R[None], np.zeros((2, 2)))
    answers: list[list[float]] = []
    for n in (0, NEW):
        matched = Matched(np.array([[n]]), np.array([[[4.0, 5.0]]]), np.zeros((1, 1, 2, 2)))
        marginal = weigh_marginal(particles, frame, matched, noise, log_miss)
        _, joint = update_pose(particles, frame, matched, noise, log_miss)
        densities = [float(marginal.log_p[0, 0]), float(joint.log_p[0, 0])]
        if not particles.P.any():
            known = MapStore(Linear()).empty(1).append(np.ones((1, 1), bool), matched.theta, matched.Sigma, frame.tags)
            _, given_pose = update_features(particles._replace(maps=known), frame, matched, noise, log_miss)
            densities.append(float(given_pose.log_p[0, 0]))
        answers.append(densities)
    return answers[0], answers[1]
