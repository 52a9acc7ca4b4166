"""The filters against what is known to be right: a plain second implementation, EKF localisation, exact Kalman
posteriors.

Measured in the linear world below, rms error [m] of a coordinate of the mean position against the exact posterior, 40
runs each:

    particles          100    400    1600   6400   slope
    FastSLAM 1         .116   .070   .030   .015   -.503 +- .026
    FastSLAM 2         .041   .019   .011   .0057  -.471
    Dual, joint        .118   .057   .033   .015   -.490
    Dual, marginal     .069   .040   .027   .020   -.294

The marginal weights of (43) converge as fast, but to a mean 0.026 m off.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from slam.estimators import ESTIMATORS
from slam.features import Point
from slam.geometry import wrap_all
from slam.map_store import MapStore
from slam.phases import (
    UNWEIGHED,
    Matched,
    Weighed,
    add_features,
    draw_features,
    predict,
    unweighed,
    update_features,
    update_pose,
)
from slam.types import NEW, Floats, ObservationNoise, Params, Particles
from tests.slam import linear, plain
from tests.slam.linear import LANDMARKS, Linear, joint_kalman, limit_of_dual_fastslam, simulate_linear, uncached_kernels

SIBLINGS = ["fs1", "fs2", "dfs"]
K = 10
START, START_COVARIANCE = np.array([0.1, -0.1, 0.05]), np.diag([0.1, 0.1, 0.02]) ** 2


# A plain second implementation ----------------------------------------------------------------------------------------


def largest_difference(key: str, steps: int = 24, **changes: Any) -> float:
    """Between this project's filter and the plain one, over all steps, poses, covariances, features, weights and
    parents."""
    world = plain.simulate(seed=3, steps=steps)
    params = Params(particles=K, believed=plain.WORLD_NOISE, association="known", **changes)
    ours, theirs = np.random.default_rng(4), np.random.default_rng(4)
    particles = ESTIMATORS[key].init(Point(), START, START_COVARIANCE, params)
    plain_particles = plain.start(START, START_COVARIANCE, K)
    worst, resamplings, news = 0.0, 0, 0
    for frame in world.frames:
        particles, trace = ESTIMATORS[key].step(ours, particles, frame, params)
        plain_particles, parents = plain.step(key, theirs, plain_particles, frame, params)
        worst = max(worst, difference(particles, plain_particles, trace.selected, parents))
        resamplings += trace.did_resample
        news += bool((trace.n == NEW).any())
        if not worst < 1e-3:
            return worst  # they have parted
    assert resamplings > 1
    assert news > 3, "a world in which little happens proves little"
    return worst


def difference(particles: Particles, expected: list[plain.Particle], found_parents: Any, parents: Any) -> float:
    if list(found_parents) != list(parents):
        return math.inf
    parts = [wrap_all(particles.s - np.array([p.s for p in expected])), particles.P - np.array([p.P for p in expected])]
    parts.append(particles.log_w - np.array([p.log_w for p in expected]))
    for k, particle in enumerate(expected):
        theta, Sigma, tags = particles.maps.features(k)
        if list(tags) != list(particle.features):
            return math.inf
        parts.append(theta - np.array([mean for mean, _ in particle.features.values()]))
        parts.append(Sigma - np.array([covariance for _, covariance in particle.features.values()]))
    return max(float(np.abs(part).max()) for part in parts)


@pytest.mark.parametrize(("inflate_r", "temper"), [(1.0, 1.0), (4.0, 0.3)])
@pytest.mark.parametrize(
    ("key", "choice"),
    [
        ("fs1", {}),
        ("fs2", {"proposal_weight": "integrated"}),
        ("fs2", {"proposal_weight": "drawn"}),
        ("dfs", {"weighting": "marginal"}),
        ("dfs", {"weighting": "joint"}),
    ],
)
def test_same_numbers_as_a_plain_implementation(key: str, choice: dict, inflate_r: float, temper: float) -> None:
    assert largest_difference(key, inflate_r=inflate_r, temper=temper, **choice) < 1e-8


def pose_from_before_the_draw() -> tuple[Callable, Callable]:
    """`update_pose` and a `draw_pose` after which features are updated at the mean, before the pose is drawn."""
    held: list[Particles] = []

    def draw_pose(rng: np.random.Generator, particles: Particles) -> Particles:
        normal = rng.standard_normal(particles.s.shape)
        held[:] = [particles._replace(s=particles.s + np.einsum("kij,kj->ki", np.linalg.cholesky(particles.P), normal))]
        return particles._replace(P=np.zeros_like(particles.P))

    def update(particles: Particles, *arguments: Any) -> tuple[Particles, Weighed]:
        updated, weighed = update_features(particles, *arguments)
        return updated._replace(s=held[0].s), weighed

    return draw_pose, update


def draw_features_but_keep_the_pose(rng: np.random.Generator, particles: Particles, *arguments: Any) -> Particles:
    return particles._replace(maps=draw_features(rng, particles, *arguments).maps)


early_draw, early_update = pose_from_before_the_draw()

MISTAKES: dict[str, tuple[str, dict[str, Callable]]] = {
    "no prediction": ("dfs", {"predict": lambda particles, *_: particles}),
    "no pose update": ("dfs", {"update_pose": lambda particles, *a: (particles, update_pose(particles, *a)[1])}),
    "no weights": ("dfs", {"reweigh": lambda particles, _: (particles, ())}),
    "features not drawn": ("dfs", {"draw_features": lambda _, *a: add_features(*a)}),
    "no pose update on new features": ("dfs", {"draw_features": draw_features_but_keep_the_pose}),
    "pose not drawn": ("fs2", {"draw_pose": lambda _, p: p._replace(P=np.zeros_like(p.P))}),
    "P kept after the draw": ("fs2", {"draw_pose": lambda _, p: p}),
    "features before the pose": ("fs2", {"draw_pose": early_draw, "update_features": early_update}),
    "features not updated": ("fs2", {"update_features": lambda p, f, m, *_: (p, unweighed(m.n))}),
    "no new features": ("fs2", {"add_features": lambda particles, *_: particles}),
    "motion not sampled": ("fs1", {"predict_by_sampling": lambda _, *a: predict(*a)}),
    "map not updated": ("fs1", {"update_features": lambda p, *a: (p, update_features(p, *a)[1])}),
    "no resampling": ("fs1", {"resample_if_needed": lambda _, p, __: (p, np.arange(K), 1.0, False)}),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_broken_phase_shows(mistake: str, monkeypatch: pytest.MonkeyPatch) -> None:
    key, replacements = MISTAKES[mistake]
    modules = {"dfs": "slam.dual_fastslam", "fs2": "slam.fastslam2", "fs1": "slam.fastslam1"}
    module = importlib.import_module(modules[key])
    for name, replacement in replacements.items():
        monkeypatch.setattr(module, name, replacement)
    assert largest_difference(key) > 1e-4


@pytest.mark.parametrize("key", SIBLINGS)
def test_an_angle_not_wrapped_shows(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Broken in the plain implementation: compiled code can't be patched."""
    monkeypatch.setattr(plain, "wrap", lambda angle: angle)
    assert largest_difference(key) > 1e-4


# A known map: EKF localisation ----------------------------------------------------------------------------------------


class NoRandomNumbers:
    """A generator that nobody may draw from."""

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"drew random numbers: {name}")


@pytest.mark.parametrize("weighting", ["marginal", "joint"])
def test_dual_fastslam_in_a_known_map_is_localisation(weighting: Any) -> None:
    world = plain.simulate(seed=5, everything=True)
    number = len(world.landmarks)
    start = START + np.array([[0.0, 0.0, 0.0], [0.2, 0.1, -0.1], [-0.2, 0.3, 3.2 - 2.0 * math.pi]])
    maps = MapStore(Point()).empty(3)
    everywhere = np.tile(world.landmarks, (3, 1, 1))
    maps = maps.append(np.ones((3, number), bool), everywhere, np.zeros((3, number, 2, 2)), np.arange(number))
    particles = Particles(start, np.tile(START_COVARIANCE, (3, 1, 1)), np.full(3, -math.log(3)), np.arange(3), maps)
    params = Params(3, plain.WORLD_NOISE, association="known", weighting=weighting, resample_below=0.0)

    localised = [(s, START_COVARIANCE) for s in start]
    log_w = np.zeros(3)
    for frame in world.frames:
        particles, _ = ESTIMATORS["dfs"].step(NoRandomNumbers(), particles, frame, params)  # type: ignore[arg-type]
        for k, (s, P) in enumerate(localised):
            s, P, log_p = plain.localise(s, P, frame, world.landmarks, plain.WORLD_NOISE)
            localised[k], log_w[k] = (s, P), log_w[k] + log_p
        np.testing.assert_allclose(wrap_all(particles.s - [s for s, _ in localised]), 0.0, atol=1e-9)
        np.testing.assert_allclose(particles.P, [P for _, P in localised], atol=1e-9)
        if weighting == "joint":
            np.testing.assert_allclose(np.diff(particles.log_w), np.diff(log_w), rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(particles.maps.take(np.tile(np.arange(number), (3, 1)))[0], everywhere)


# A linear-Gaussian world: the exact posterior -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def linear_kind() -> Iterator[None]:
    """What every test with a `Linear` feature asks for."""
    with uncached_kernels():
        yield


def linear_run(key: str, particles: int, seed: int, **changes: Any) -> tuple[Floats, list[Any]]:
    """Mean of position and map (2 + 2 * 3) after the last frame of the one linear world, and the traces."""
    params = Params(particles, linear.NOISE, association="known", **({"weighting": "joint"} | changes))
    rng = np.random.default_rng([seed, particles])
    state, traces = ESTIMATORS[key].init(Linear(), np.zeros(3), np.zeros((3, 3)), params), []
    for frame in simulate_linear(seed=0):
        state, trace = ESTIMATORS[key].step(rng, state, frame, params)
        traces.append(trace)
    weighted, n = traces[-1].weighted, np.tile(np.arange(len(LANDMARKS)), (particles, 1))
    everything = np.concatenate([weighted.s[:, :2], weighted.maps.take(n)[0].reshape(particles, -1)], axis=1)
    return np.exp(weighted.log_w) @ everything, traces


COUNTS, SEEDS = np.array([100, 400, 1600, 6400]), 40
POSE, MAP = slice(0, 2), slice(2, None)


def errors(key: str, **changes: Any) -> Floats:
    """(counts, SEEDS, 8) of the estimated mean against the exact one."""
    exact = joint_kalman(simulate_linear(seed=0))[-1].mean
    return np.array([[linear_run(key, K, seed, **changes)[0] - exact for seed in range(SEEDS)] for K in COUNTS])


def slope(error: Floats) -> tuple[float, float]:
    """Of log rms (counts, SEEDS, coordinates) against log K, and its standard error.

    The rms over n independent errors has a relative standard error of 1/sqrt(2 n).  Pose and map have two independent
    coordinates each, x and y: those of all landmarks move together, with the pose at which they were seen.
    """
    x = np.log(COUNTS) - np.log(COUNTS).mean()
    rms = np.sqrt((error**2).mean(axis=(1, 2)))
    return float(x @ np.log(rms) / (x @ x)), 1.0 / math.sqrt(2 * 2 * SEEDS * (x @ x))


def bias(error: Floats) -> tuple[Floats, Floats]:
    """Mean error (coordinates,) over the seeds (SEEDS, coordinates), and its standard error."""
    return error.mean(axis=0), error.std(axis=0, ddof=1) / math.sqrt(len(error))


@pytest.mark.usefixtures("linear_kind")
@pytest.mark.parametrize("key", SIBLINGS)
def test_approaches_the_exact_posterior(key: str) -> None:
    """The rms error falls like 1/sqrt(K), and nothing systematic is left."""
    error = errors(key)
    for part in (error[..., POSE], error[..., MAP]):
        found, standard_error = slope(part)
        assert abs(found + 0.5) < 4.0 * standard_error
        mean, standard_error = bias(part[-1])
        assert np.all(np.abs(mean) < 4.0 * standard_error)


@pytest.mark.usefixtures("linear_kind")
def test_marginal_weights_do_not_converge_to_the_posterior() -> None:
    """(43) to the letter converges too, but elsewhere: by a bias that no number of particles removes."""
    frames = simulate_linear(seed=0)
    exact = joint_kalman(frames)[-1].mean
    np.testing.assert_allclose(limit_of_dual_fastslam(frames, "joint"), exact, atol=1e-12)
    limit = limit_of_dual_fastslam(frames, "marginal") - exact
    assert np.hypot(*limit[POSE]) == pytest.approx(0.0263, abs=1e-4)  # [m]; the map's is up to 0.06

    error = errors("dfs", weighting="marginal")
    for part, away in ((error[..., POSE], limit[POSE]), (error[..., MAP], limit[MAP])):
        found, standard_error = slope(part - away)
        assert abs(found + 0.5) < 4.0 * standard_error
        for at_this_count in part[-2:]:
            mean, standard_error = bias(at_this_count)
            assert np.all(np.abs(mean - away) < 4.0 * standard_error)
    # With 6400 particles the bias is well above even the Monte Carlo error of one run (0.012 m).
    mean, standard_error = bias(error[-1][:, POSE])
    assert np.hypot(*mean) > 10.0 * np.hypot(*standard_error)
    assert np.hypot(*mean) > 1.5 * np.hypot(*error[-1][:, POSE].std(axis=0, ddof=1))


@pytest.mark.usefixtures("linear_kind")
def test_both_proposal_weights_agree_where_nothing_is_linearised() -> None:
    """The weight of the optimal proposal does not depend on the draw."""
    _, integrated = linear_run("fs2", 200, seed=1, proposal_weight="integrated")
    _, drawn = linear_run("fs2", 200, seed=1, proposal_weight="drawn")
    for a, b in zip(integrated, drawn, strict=True):
        np.testing.assert_allclose(a.weighted.log_w, b.weighted.log_w, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(a.selected, b.selected)
    assert np.ptp(integrated[-1].log_likelihood) > 1.0
    assert any(trace.did_resample for trace in integrated)


@pytest.mark.usefixtures("linear_kind")
@pytest.mark.parametrize("frozen", [True, False], ids=["Sigma = 0", "Sigma > 0"])
def test_chained_densities_are_the_stacked_one(frozen: bool) -> None:
    """The log densities that `update_pose` gives sum to that of all innovations stacked, which share the pose."""
    rng = np.random.default_rng(2)
    many, frame = 30, simulate_linear(seed=0)[-1]
    Z = len(frame.z)
    factor = 0.3 * rng.standard_normal((many, 3, 3))
    s, P = 0.2 * rng.standard_normal((many, 3)), factor @ factor.swapaxes(1, 2)
    theta = LANDMARKS[frame.tags] - [3.0, 0.0] + 0.2 * rng.standard_normal((many, Z, 2))
    factor = (0.0 if frozen else 0.3) * rng.standard_normal((many, Z, 2, 2))
    matched = Matched(np.tile(np.arange(Z), (many, 1)), theta, factor @ factor.swapaxes(2, 3))
    R = np.tile(np.diag([0.25, 0.2]) ** 2, (Z, 1, 1))
    particles = Particles(s, P, np.zeros(many), np.arange(many), MapStore(Linear()).empty(many))
    _, (log_p, (seen_v, seen_V)) = update_pose(
        particles, frame, matched, ObservationNoise(R, np.zeros((2, 2))), UNWEIGHED
    )

    G = np.tile(np.eye(2, 3), (Z, 1))  # dz/ds, but for its sign
    for k in range(many):
        V = G @ P[k] @ G.T
        for i in range(Z):
            V[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += matched.Sigma[k, i] + R[i]
        v = (frame.z - theta[k] + s[k, :2]).ravel()
        np.testing.assert_allclose(log_p[k].sum(), plain.log_gauss(v, V), rtol=1e-9)
        chain = [plain.log_gauss(seen_v[k, i], seen_V[k, i]) for i in range(Z)]
        np.testing.assert_allclose(chain, log_p[k], rtol=1e-9)
