"""A linear-Gaussian world, where the posterior over pose and map is known exactly.

The heading is zero and stays zero: with `Odometry(turn_per_metre=0.0)` and increments that do not turn, the motion is
s + u with noise on x and y only.  The feature kind below is seen as theta - (x, y).
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numba.core.dispatcher import Dispatcher

from slam.linalg import factor22, times22
from slam.motion import Odometry
from slam.types import Floats, Frame, Noise, ObservationNoise, Params


class Linear(NamedTuple):
    """A point seen by its displacement from the robot: z = theta - (x, y) [m, m], whatever the heading.

    Its noise is `Noise.range` in x and `Noise.bearing` in y [m].
    """

    dim = 2
    observation = 2
    grows = False

    @staticmethod
    def believed(z: Floats, params: Params) -> ObservationNoise:
        variance = np.array([params.believed.range, params.believed.bearing]) ** 2
        return ObservationNoise(np.tile(np.diag(variance), (len(z), 1, 1)), np.zeros((2, 2)))

    @staticmethod
    def of_known(R: ObservationNoise, params: Params) -> ObservationNoise:
        return ObservationNoise(params.inflate_r * R.sensor, R.model)

    @staticmethod
    def total(feature: Any, R: Any, G_theta: Any, model: Any) -> Any:
        return R

    @staticmethod
    def innovation(feature: Any, theta: Any, s: Any, z: Any) -> Any:
        v = (z[0] - theta[0] + s[0], z[1] - theta[1] + s[1])
        return v, ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)), ((1.0, 0.0), (0.0, 1.0))

    @staticmethod
    def observable(feature: Any, s: Any, P: Any, z: Any, v: Any, G_s: Any, R: Any) -> Any:
        return G_s

    @staticmethod
    def displacement(feature: Any, s: Any, P: Any, z: Any, V: Any, R: Any, normal: Any) -> Any:
        return times22(factor22(V), normal)

    @staticmethod
    def inverse(feature: Any, s: Any, z: Any) -> Any:
        return (s[0] + z[0], s[1] + z[1]), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((1.0, 0.0), (0.0, 1.0))

    @staticmethod
    def draw(feature: Any, theta: Any, delta: Any) -> Any:
        return (theta[0] + delta[0], theta[1] + delta[1])

    @staticmethod
    def spread(feature: Any, theta: Any, Sigma: Any) -> Any:
        return np.sqrt(Sigma[0][0] + Sigma[1][1])

    @staticmethod
    def extent(feature: Any, theta: Any) -> Any:
        return theta[0], theta[1], theta[0], theta[1]


@contextlib.contextmanager
def uncached_kernels() -> Iterator[None]:
    """Compile for `Linear` without the disk cache.

    A cached kernel names the classes of its arguments.  Where this file can't be imported, as by an installed program,
    an index that names `Linear` could not even be read; and the cache would not notice a change in this file.
    """
    kernels = {
        id(value): value
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] == "slam"
        for value in vars(module).values()
        if isinstance(value, Dispatcher)
    }
    caches = [kernel._cache for kernel in kernels.values() if hasattr(kernel._cache, "disable")]
    assert caches
    for cache in caches:
        cache.disable()
    try:
        yield
    finally:
        for cache in caches:
            cache.enable()


NOISE = Noise(odometry=0.3, range=0.25, bearing=0.2)
"""As large as the motion between observations, so that a few hundred particles represent the posterior."""

LANDMARKS = np.array([[2.0, 1.0], [3.0, -2.0], [6.0, 2.0]])


def simulate_linear(seed: int, steps: int = 6) -> list[Frame]:
    """The robot goes along x and sees two landmarks at first, the third from the second step on."""
    rng = np.random.default_rng(seed)
    frames, position = [], np.zeros(2)
    for k in range(steps):
        u = np.tile([0.5, 0.1, 0.0], (2, 1))
        travel = np.hypot(u[:, 0], u[:, 1])[:, None]
        position = position + (u[:, :2] + NOISE.odometry * travel * rng.standard_normal((2, 2))).sum(axis=0)
        tags = np.array([1, 0]) if k == 0 else np.array([0, 1, 2])
        z = LANDMARKS[tags] - position + [NOISE.range, NOISE.bearing] * rng.standard_normal((len(tags), 2))
        frames.append(Frame(k + 1.0, Odometry(turn_per_metre=0.0), u, np.full(2, 0.1), Linear(), z, tags))
    return frames


class Exact(NamedTuple):
    """The joint posterior over x, y and all landmarks seen so far, two by two in the order in which they were seen."""

    mean: Floats
    covariance: Floats
    order: list[int]
    """Their tags."""
    log_evidence: float
    """log p(z) of the observations of known landmarks in the last frame, all stacked."""


def joint_kalman(frames: list[Frame], noise: Noise = NOISE) -> list[Exact]:
    """The exact posterior after each frame: a Kalman filter over position and landmarks, the start known exactly."""
    mean, C, order, history = np.zeros(2), np.zeros((2, 2)), [], []
    R = np.diag([noise.range**2, noise.bearing**2])
    for frame in frames:
        mean[:2] += frame.u[:, :2].sum(axis=0)
        C[:2, :2] += np.eye(2) * (noise.odometry**2 * (frame.u[:, :2] ** 2).sum())
        seen = [(order.index(tag), z) for tag, z in zip(frame.tags, frame.z, strict=True) if tag in order]
        log_evidence = 0.0
        if seen:
            H = np.zeros((2 * len(seen), len(mean)))
            for row, (j, _) in enumerate(seen):
                H[2 * row : 2 * row + 2, :2] = -np.eye(2)
                H[2 * row : 2 * row + 2, 2 + 2 * j : 4 + 2 * j] = np.eye(2)
            v = np.concatenate([z for _, z in seen]) - H @ mean
            V = H @ C @ H.T + np.kron(np.eye(len(seen)), R)
            K = C @ H.T @ np.linalg.inv(V)
            log_evidence = -0.5 * (v @ np.linalg.inv(V) @ v + np.linalg.slogdet(2.0 * np.pi * V)[1])
            mean, C = mean + K @ v, C - K @ V @ K.T
        for tag, z in zip(frame.tags, frame.z, strict=True):
            if tag not in order:
                order.append(int(tag))
                J = np.vstack([np.eye(len(mean)), np.eye(2, len(mean))])  # a flat prior: theta = (x, y) + z + noise
                mean, C = np.concatenate([mean, mean[:2] + z]), J @ C @ J.T
                C[-2:, -2:] += R
        history.append(Exact(mean.copy(), C.copy(), list(order), float(log_evidence)))
    return history


def limit_of_dual_fastslam(frames: list[Frame], weighting: str, noise: Noise = NOISE) -> Floats:
    """Mean of position and map (as `Exact.mean`) after the last frame, of Dual FastSLAM with infinitely many particles.

    In a linear world the position mean of every particle is the same affine function of its map, s = A theta + b, and
    P is the same for all.  So the weighted maps remain one Gaussian N(m, C): a drawn feature extends it, and a weight
    N(v; 0, V), with v affine in theta, conditions it as an observation does.
    """
    A, b, P = np.zeros((2, 0)), np.zeros(2), np.zeros((2, 2))
    m, C, order = np.zeros(0), np.zeros((0, 0)), []
    R = np.diag([noise.range**2, noise.bearing**2])
    for frame in frames:
        b = b + frame.u[:, :2].sum(axis=0)
        P = P + np.eye(2) * (noise.odometry**2 * (frame.u[:, :2] ** 2).sum())
        before = (A, b, P)
        pseudo = []
        for tag, z in zip(frame.tags, frame.z, strict=True):
            if tag not in order:
                continue
            E = np.zeros((2, len(m)))
            E[:, 2 * order.index(tag) : 2 * order.index(tag) + 2] = np.eye(2)
            A0, b0, P0 = before if weighting == "marginal" else (A, b, P)
            pseudo.append((A0 - E, b0 + z, P0 + R))  # v = (A0 - E) theta + b0 + z, V
            K = -P @ np.linalg.inv(P + R)
            A, b, P = A + K @ (A - E), b + K @ (b + z), P + K @ P
        for H, offset, V in pseudo:
            gain = C @ H.T @ np.linalg.inv(H @ C @ H.T + V)
            m, C = m - gain @ (H @ m + offset), C - gain @ H @ C
        for tag, z in zip(frame.tags, frame.z, strict=True):
            if tag not in order:
                order.append(int(tag))
                m = np.concatenate([m, A @ m + b + z])
                C = np.block([[C, C @ A.T], [A @ C, A @ C @ A.T + P + R]])
                E = np.eye(2, len(m), len(m) - 2)
                K = -P @ np.linalg.inv(P + R)
                A = np.hstack([A, np.zeros((2, 2))])
                A, b, P = A + K @ (A - E), b + K @ (b + z), P + K @ P
    return np.concatenate([A @ m + b, m])
