"""All filters on walls: limits in which the answer is known, and a loop of corridors that must close.

The pieces of wall are made here from the true walls, without a laser: whatever of a wall lies within reach of a robot
on its left, with errors of its lateral offset and its angle.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from slam.estimators import ESTIMATORS
from slam.features import Wall
from slam.features.wall import CORNER, LEVER, OUT_OF_REACH
from slam.geometry import compose, invert, wrap
from slam.metrics import mixture_moments
from slam.motion import Odometry
from slam.perception.segments import shared_directions
from slam.types import Floats, Frame, Noise, Params, Trace

ALL = ["dfs", "fs2", "fs1", "ekf"]
START = np.zeros(3)
REACH = 6.0
SIGMA = np.array([0.01, math.radians(0.2)])


def ring(x: float, y: float, width: float) -> Floats:
    """(8, 2, 2) walls of a corridor around a rectangle of x by y metres, the robot to the left of each.

    Its centre line begins at the origin, in the middle of the lower side, and runs along +x.
    """
    walls = []
    for grow, outer in ((0.5 * width, True), (-0.5 * width, False)):
        corners = np.array(
            [(-x / 2 - grow, -grow), (x / 2 + grow, -grow), (x / 2 + grow, y + grow), (-x / 2 - grow, y + grow)]
        )
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            walls.append((a, b) if outer else (b, a))
    return np.array(walls)


def seen_from(s: Floats, walls: Floats) -> tuple[Floats, list[int]]:
    """z (Z, 11) of the pieces within reach, exact, and which walls they are of."""
    rows, which = [], []
    for i, (a, b) in enumerate(walls):
        length = math.dist(a, b)
        frame = np.array([*a, math.atan2(*(b - a)[::-1])])
        along, lateral, _ = compose(invert(frame), s)
        if not 0.0 < lateral < REACH:
            continue
        half = math.sqrt(REACH**2 - lateral**2)
        begin, end = max(0.0, along - half), min(length, along + half)
        if end - begin < 0.5:
            continue
        middle = compose(frame, np.array([0.5 * (begin + end), 0.0, 0.0]))
        kinds = (CORNER if begin == 0.0 else OUT_OF_REACH, CORNER if end == length else OUT_OF_REACH)
        ends = (0.5 * (begin - end), 0.5 * (end - begin))
        place = compose(invert(s), middle)
        rows.append([*place, *ends, *SIGMA**2, *kinds, 20.0, place[2]])
        which.append(i)
    return np.array(rows).reshape(-1, 11), which


def blur(rng: np.random.Generator, z: Floats) -> None:
    """Gives pieces z (Z, 11) errors of `SIGMA`, in place."""
    for row in z:
        row[:3] = compose(row[:3], np.array([0.0, *(SIGMA * rng.standard_normal(2))]))
    z[:, 10] = shared_directions(z[:, 2], z[:, 6])


def drive(walls: Floats, x: float, y: float, laps: float, seed: int, noise: float) -> tuple[list[Frame], Floats]:
    """Frames and true poses (T, 3) along the centre line, on arcs of 1 m round the corners.

    `noise` is the deviation of the odometry as a fraction of the motion; with it the pieces have errors of `SIGMA`.
    """
    rng = np.random.default_rng(seed)
    arc = [np.array([math.sin(0.4) / 1.0, 1 - math.cos(0.4), 0.4])] * 3 + [
        np.array([math.sin(math.pi / 2 - 1.2), 1 - math.cos(math.pi / 2 - 1.2), math.pi / 2 - 1.2])
    ]
    ahead = [np.array([0.5, 0.0, 0.0])]
    lap = [*ahead * round(2 * (x / 2 - 1)), *arc]
    for side in (y, x, y):
        lap += [*ahead * round(2 * (side - 2)), *arc]
    lap += ahead * round(2 * (x / 2 - 1))
    s, frames, truth = START, [], []
    for k in range(round(laps * len(lap))):
        u = lap[k % len(lap)]
        s = compose(s, u)
        z, which = seen_from(s, walls)
        travel = math.hypot(u[0], u[1])
        spread = noise * np.array([travel, travel, math.hypot(u[2], 0.1 * travel)])
        reported = u + spread * rng.standard_normal(3)
        if noise:
            blur(rng, z)
        frames.append(Frame(k + 1.0, Odometry(), reported[None], np.ones(1), Wall(), z, np.array(which, np.int64)))
        truth.append(s)
    return frames, np.array(truth)


def parameters(**changes: Any) -> Params:
    usual = {"believed": Noise(odometry=0.1), "particles": 30, "floor_lateral": 0.002, "floor_angle": 0.0005}
    return Params(**(usual | changes))


def run(key: str, frames: list[Frame], params: Params, seed: int = 1, P0: Floats | None = None) -> list[Trace]:
    state = ESTIMATORS[key].init(Wall(), START, np.zeros((3, 3)) if P0 is None else P0, params)
    rng, traces = np.random.default_rng([seed, 1]), []  # not the stream of the world
    for frame in frames:
        state, trace = ESTIMATORS[key].step(rng, state, frame, params)
        traces.append(trace)
    return traces


def estimate(trace: Trace) -> tuple[Floats, Floats]:
    weighted = trace.weighted
    return mixture_moments(weighted.s, weighted.P, np.exp(weighted.log_w))


@pytest.mark.parametrize("association", ["jcbb", "nearest", "known"])
@pytest.mark.parametrize("key", ALL)
def test_without_noise_every_filter_is_right(key: str, association: str) -> None:
    """Twice round: eight walls, the true ones from corner to corner, and the true pose."""
    walls = ring(12.0, 8.0, 2.0)
    frames, truth = drive(walls, 12.0, 8.0, 2.0, seed=0, noise=0.0)
    exact = parameters(believed=Noise(odometry=1e-6), particles=3, association=association, inflate_r=100.0)
    for frame in frames:
        frame.z[:, 5:7] = 1e-14
    traces = run(key, frames, dataclasses.replace(exact, floor_lateral=1e-6, floor_angle=1e-6))
    mean, _ = estimate(traces[-1])
    assert math.dist(mean[:2], truth[-1, :2]) < 1e-3
    assert abs(wrap(mean[2] - truth[-1, 2])) < 1e-4
    theta, _, tags = traces[-1].weighted.maps.features(0)
    assert sorted(tags) == list(range(8))
    for row, tag in zip(theta, tags, strict=True):
        a, b = walls[tag]
        np.testing.assert_allclose(wrap(row[2] - math.atan2(*(b - a)[::-1])), 0.0, atol=1e-4)
        np.testing.assert_allclose(row[4] - row[3], math.dist(a, b), atol=0.01)
        assert row[5] == row[6] == 1.0  # both corners were seen
        assert row[7] > 5


@pytest.mark.parametrize(("key", "particles"), [("dfs", 30), ("fs2", 100), ("ekf", 1)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_loop_of_corridors_closes(key: str, particles: int, seed: int) -> None:
    walls = ring(26.0, 18.0, 2.0)
    frames, truth = drive(walls, 26.0, 18.0, 1.3, seed, noise=0.1)
    traces = run(key, frames, parameters(particles=particles, inflate_r=9.0), seed)
    mean, _ = estimate(traces[-1])
    assert math.dist(mean[:2], truth[-1, :2]) < 0.8
    features = int(traces[-1].weighted.maps.counts[traces[-1].weighted.log_w.argmax()])
    assert 8 <= features <= 12


class Localisation:
    """An EKF on a map of walls that is known, as plainly as it can be written: v = -B ((-) x_F (+) s (+) x_E)."""

    def __init__(self, s: Floats, P: Floats) -> None:
        self.s, self.P = s, P

    def step(self, frame: Frame, theta: Floats, params: Params) -> None:
        for u in frame.u:
            c, q = math.cos(self.s[2]), math.sin(self.s[2])
            travel = math.hypot(u[0], u[1])
            deviation = params.believed.odometry * np.array([travel, travel, math.hypot(u[2], 0.1 * travel)])
            J = np.array([[c, -q, 0.0], [q, c, 0.0], [0.0, 0.0, 1.0]])
            after = compose(self.s, u)
            H = np.eye(3)
            H[:2, 2] = [-(after - self.s)[1], (after - self.s)[0]]
            self.s, self.P = after, H @ self.P @ H.T + J @ np.diag(deviation**2) @ J.T
        for z, n in zip(frame.z, frame.tags, strict=True):
            placed = compose(self.s, z[:3])
            t, lateral, angle = compose(invert(theta[n][:3]), placed)
            lever = np.array([[1.0, np.clip(t, -LEVER, LEVER)], [0.0, 1.0]])
            model = np.diag([params.floor_lateral**2, params.floor_angle**2])
            R = np.diag(z[5:7]) + lever @ model @ lever.T
            heading = self.s[2] - self.P[2, 2] / (self.P[2, 2] + R[1, 1]) * wrap(angle)
            c, q = math.cos(heading + z[10]), math.sin(heading + z[10])
            arm = placed[:2] - self.s[:2]
            G = np.array([[-q, c, q * arm[1] + c * arm[0]], [0.0, 0.0, 1.0]])
            V = G @ self.P @ G.T + R
            K = self.P @ G.T @ np.linalg.inv(V)
            self.s = self.s - K @ np.array([lateral, wrap(angle)])
            self.s[2] = wrap(self.s[2])
            self.P = (np.eye(3) - K @ G) @ self.P


def test_on_a_known_map_dual_fastslam_is_an_ekf_localisation() -> None:
    """Nothing new, no resampling: equal to 1e-9, and not one random number is drawn."""
    walls = ring(12.0, 8.0, 2.0)
    frames, _ = drive(walls, 12.0, 8.0, 1.0, seed=5, noise=0.1)
    theta = np.array(
        [
            [*(0.5 * (a + b)), math.atan2(*(b - a)[::-1]), *(0.5 * math.dist(a, b) * np.array([-1, 1])), 1, 1, 1]
            for a, b in walls
        ]
    )
    params = parameters(association="known", resample_below=0.0)
    particles = ESTIMATORS["dfs"].init(Wall(), START, np.diag([0.1, 0.1, 0.02]) ** 2, params)
    K, n = params.particles, len(theta)
    maps = particles.maps.append(np.ones((K, n), bool), np.tile(theta, (K, 1, 1)), np.zeros((K, n, 2, 2)), np.arange(n))
    particles = particles._replace(maps=maps)
    plain = Localisation(START.copy(), np.diag([0.1, 0.1, 0.02]) ** 2)

    class NoLuck:
        def __getattr__(self, name: str) -> Any:
            raise AssertionError(f"a random number was drawn: {name}")

    for frame in frames:
        particles, _ = ESTIMATORS["dfs"].step(NoLuck(), particles, frame, params)  # type: ignore[arg-type]
        plain.step(frame, theta, params)
        np.testing.assert_allclose(particles.s, np.tile(plain.s, (K, 1)), atol=1e-9)
        np.testing.assert_allclose(particles.P, np.tile(plain.P, (K, 1, 1)), atol=1e-9)


@pytest.mark.parametrize("length", [65.0, 2.5])
def test_a_corridor_says_nothing_of_the_way_along_it(length: float) -> None:
    """One particle: the deviation along walls of `length` is that of the odometry, across it stays that of the walls.

    The walls are drawn at slightly different angles, and two lines that are not parallel do fix a point; a particle
    that believes in that point reports too small a deviation, and moves to where it is not.
    """
    begin = np.arange(-10.0, 55.0, length)
    right = np.stack([begin, np.full(len(begin), -1.0), begin + length, np.full(len(begin), -1.0)], axis=1)
    walls = np.concatenate([right, -right]).reshape(-1, 2, 2)
    params = parameters(particles=1, inflate_r=9.0, floor_lateral=SIGMA[0], floor_angle=SIGMA[1], association="known")
    along, reported, steps = [], [], 80
    for seed in range(60):
        rng = np.random.default_rng(seed)
        s, frames = START, []
        for k in range(steps):
            s = compose(s, np.array([0.5, 0.0, 0.0]))
            z, which = seen_from(s, walls)
            blur(rng, z)
            u = np.array([[0.5, 0.0, 0.0]]) + np.array([0.05, 0.05, 0.005]) * rng.standard_normal((1, 3))
            frames.append(Frame(k + 1.0, Odometry(), u, np.ones(1), Wall(), z, np.array(which, np.int64)))
        trace = run("dfs", frames, params, seed)[-1]
        along.append(trace.weighted.s[0, 0] - s[0])
        reported.append(trace.weighted.P[0, :2, :2])
    deviation = math.sqrt(np.mean(np.square(along)))  # known to 1 / sqrt(2 x 60) = 9 %
    said = np.sqrt(np.mean(reported, axis=0).diagonal())
    odometry = 0.05 * math.sqrt(steps)
    assert 0.8 < said[0] / deviation < 1.25
    assert 0.9 < said[0] / odometry < 1.05
    assert said[1] < 0.3 * odometry


@pytest.mark.parametrize("orthogonal", [False, True])
def test_angle_constraints_of_ekf_slam(orthogonal: bool) -> None:
    """With them the walls of a ring are at right angles; without them they are where the sensor saw them."""
    walls = ring(26.0, 18.0, 2.0)
    frames, truth = drive(walls, 26.0, 18.0, 0.9, seed=4, noise=0.1)
    trace = run("ekf", frames, parameters(association="known", orthogonal=orthogonal))[-1]
    theta, _, _ = trace.weighted.maps.features(0)
    turned = theta[:, 2] - theta[0, 2]
    worst = np.abs(turned - 0.5 * math.pi * np.round(turned / (0.5 * math.pi))).max()
    assert (worst < math.radians(0.15)) == orthogonal
    mean, covariance = estimate(trace)
    assert math.dist(mean[:2], truth[-1, :2]) < (0.3 if orthogonal else 1.5)
    np.testing.assert_allclose(covariance, covariance.T, atol=0)
    assert np.linalg.eigvalsh(covariance).min() > 0
