"""The plain C observation update (`update.c`), and a world in which to compare it with the filters."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam.features import Point
from slam.geometry import wrap_all
from slam.map_store import MapStore
from slam.motion import Unicycle
from slam.types import Floats, Frame, Ints, Noise, Params, Particles

SOURCE = Path(__file__).with_name("update.c")
FLAGS = ("-O3", "-march=native", "-ffp-contract=off")
"""Strict floating point: no -ffast-math, and no contraction of a*b + c, which numba does not do either."""


class State(NamedTuple):
    """Particles as the C functions want them; they write into everything but `n`.  N points in every map."""

    n: Ints
    """(K, Z) index of the feature that each observation is of."""
    s: Floats
    P: Floats
    map: Floats
    """(K, N, 5) x, y, Sigma_xx, Sigma_xy, Sigma_yy of every point."""
    log_w: Floats
    """(K,) log weights, not normalised."""

    def copy(self) -> State:
        """Another state to write into."""
        return State(*(array.copy() for array in self))


class World(NamedTuple):
    """Particles that know N points, a frame in which they see Z of them, and which these are in each map."""

    particles: Particles
    frame: Frame
    params: Params
    n: Ints


def make_world(
    key: str,
    K: int = 1000,
    features: int = 100,
    seen: int = 5,
    ticks: int = 0,
    heading: float = 0.1,
    orders: int = 1,
    seed: int = 0,
) -> World:
    """A robot among points on both sides of a road; every particle of the filter `key` has its own pose and map.

    FastSLAM 1 has P = 0, Dual FastSLAM has Sigma = 0.  `ticks` control ticks of a robot that stands still come before
    the observation.  `orders`: in how many different orders particles met the points, so that n differs.  What is not
    seen is shared, as it is after resampling.
    """
    rng = np.random.default_rng(seed)
    noise = Noise(range=0.02, bearing=0.002)
    points = np.stack([np.arange(features) // 2 * 5.0, np.where(np.arange(features) % 2, -6.0, 6.0)], axis=1)
    first = max(0, (features - seen) // 2)
    tags = np.arange(first, first + seen)
    start = np.array([points[first, 0] + 0.7, 0.3, heading])

    factor = np.array([[0.1, 0, 0], [0.02, 0.08, 0], [0.002, -0.004, 0.008]])
    P = np.zeros((K, 3, 3)) if key == "fs1" else np.tile(factor @ factor.T, (K, 1, 1))
    s = start + 0.5 * rng.standard_normal((K, 3)) @ factor.T
    s[:, 2] = wrap_all(s[:, 2])

    feature = Point()
    maps = MapStore(feature).empty(orders)
    frozen = 0.0 if key == "dfs" else 1.0
    place = np.empty((orders, features), np.int64)
    for group in range(orders):
        order = np.arange(features) if group == 0 else rng.permutation(features)
        place[group, order] = np.arange(features)
        for block in np.array_split(order, -(-features // 16)):
            theta = np.tile(points[block], (orders, 1, 1))
            Sigma = np.tile(frozen * 0.01 * np.eye(2), (orders, len(block), 1, 1))
            new = np.repeat(np.arange(orders)[:, None] == group, len(block), axis=1)
            maps = maps.append(new, theta, Sigma, block)
    group = np.arange(K) % orders
    n = place[group][:, tags]
    wide = 0.05 * (np.eye(2) + 0.3 * rng.standard_normal((K, seen, 2, 2)))
    theta = points[tags] + 0.05 * rng.standard_normal((K, seen, 2))
    maps = maps.select(group).replace(n, theta, frozen * wide @ wide.swapaxes(-1, -2))

    dx, dy = (points[tags] - start[:2]).T
    z = np.stack([np.hypot(dx, dy), wrap_all(np.arctan2(dy, dx) - heading)], axis=1)
    z += [noise.range, noise.bearing] * rng.standard_normal(z.shape)
    frame = Frame(0.2, Unicycle(), np.zeros((ticks, 2)), np.full(ticks, 0.025), feature, z, tags)
    params = Params(particles=K, believed=noise, association="known", resample_below=0.0)
    return World(Particles(s, P, np.full(K, -np.log(K)), np.arange(K), maps), frame, params, n)


def as_arrays(particles: Particles, n: Ints) -> State:
    """The particles for C; all maps must have the same number of points."""
    s, P, log_w, _, maps = particles
    everything = np.tile(np.arange(maps.counts[0]), (len(s), 1))
    theta, Sigma = maps.take(everything)
    features = np.concatenate([theta, Sigma.reshape(*everything.shape, 4)[..., [0, 1, 3]]], axis=-1)
    return State(n, s, P, features, log_w).copy()


def has_compiler() -> bool:
    """Whether there is a gcc to compile the reference with."""
    return shutil.which("gcc") is not None


def compile_reference(folder: Path) -> Callable[[str, Frame, Params, State, Floats], None]:
    """Compile `update.c` into `folder`; returns `run(key, frame, params, state, normal)`.

    It updates the state in place.  normal (K, 3): standard normal draws for FastSLAM 2.
    """
    library = folder / "update.so"
    subprocess.run(["gcc", *FLAGS, "-shared", "-fPIC", "-o", str(library), str(SOURCE), "-lm"], check=True)
    dll = ctypes.CDLL(str(library))

    def address(array: np.ndarray) -> ctypes.c_void_p:
        assert array.flags.c_contiguous
        return ctypes.c_void_p(array.ctypes.data)

    def run(key: str, frame: Frame, params: Params, state: State, normal: Floats) -> None:
        n, s, P, features, log_w = state
        z, believed = frame.z, params.believed
        R = np.tile([believed.range**2, 0.0, believed.bearing**2], (len(z), 1))
        sizes = [ctypes.c_int64(size) for size in (len(s), features.shape[1], len(z))]
        arrays = {
            "fs1": (dll.fastslam1, n, z, R, s, features, log_w),
            "fs2": (dll.fastslam2, n, z, R, normal, s, P, features, log_w),
            "dfs": (dll.dual_fastslam, n, z, R, s, P, features, log_w),
        }
        function, *rest = arrays[key]
        function(*sizes, *(address(array) for array in rest))

    return run
