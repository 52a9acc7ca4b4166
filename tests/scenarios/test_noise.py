"""Noise: honest statistics, and streams that do not depend on its level."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from scenarios.noise import add_noise
from scenarios.registry import build
from scenarios.sensors import BLIND
from slam.features import Point
from slam.motion import Ackermann, Odometry, Unicycle, deviation
from slam.types import Frame, Noise

NOISE = Noise(speed=0.2, turn=0.1, range=0.05, bearing=0.02, odometry=0.3)

UNICYCLE = Unicycle()


def frame(ticks: int, observations: int, motion: Any = UNICYCLE, distance: float = 8.0) -> Frame:
    u = np.full((ticks, motion.controls), 0.4)
    z = np.tile([distance, math.pi - 0.001], (observations, 1))  # bearings that noise carries past pi
    tags = np.arange(observations)
    return Frame(1.0, motion, u, np.full(ticks, 0.1), Point(), z, tags)


@pytest.mark.parametrize("motion", [Unicycle(), Ackermann(), Odometry()])
def test_deviations_and_means(motion: Any) -> None:
    """40000 samples: a mean within 4 sigma / 200, a deviation within 4 sigma / sqrt(80000)."""
    n = 40_000
    exact = frame(n, n, motion)
    noisy = add_noise(np.random.default_rng(1), exact, NOISE)
    bearing = np.mod(noisy.z[:, 1] - exact.z[:, 1] + math.pi, 2 * math.pi) - math.pi
    errors = np.column_stack([noisy.u - exact.u, noisy.z[:, 0] - exact.z[:, 0], bearing])
    sigma = np.array([*deviation(motion, exact.u, NOISE)[0], NOISE.range, NOISE.bearing])
    assert (np.abs(errors.mean(axis=0)) < 4 * sigma / 200).all()
    assert (np.abs(errors.std(axis=0) / sigma - 1) < 4 / math.sqrt(2 * n)).all()
    assert np.abs(np.corrcoef(errors.T) - np.eye(errors.shape[1])).max() < 4 / 200
    assert (noisy.z[:, 1] >= -math.pi).all()
    assert (noisy.z[:, 1] < math.pi).all()


def test_the_level_scales_the_same_draws() -> None:
    exact = frame(9, 3)
    one = add_noise(np.random.default_rng(5), exact, NOISE)
    for change in ("speed", "turn", "range", "bearing"):
        twice = dataclasses.replace(NOISE, **{change: 2 * getattr(NOISE, change)})
        two = add_noise(np.random.default_rng(5), exact, twice)
        scale_u = [2 if change == "speed" else 1, 2 if change == "turn" else 1]
        np.testing.assert_allclose(two.u - exact.u, (one.u - exact.u) * scale_u, atol=1e-12)
        factor = 2 if change == "range" else 1
        np.testing.assert_allclose(two.z[:, 0] - 8.0, (one.z[:, 0] - 8.0) * factor, atol=1e-12)


def test_the_same_number_of_draws_whatever_the_level() -> None:
    after = []
    for noise in (NOISE, Noise(0, 0, 0, 0, 0)):
        rng = np.random.default_rng(5)
        add_noise(rng, frame(9, 3), noise)
        after.append(rng.standard_normal())
    assert after[0] == after[1]


def test_no_noise_changes_nothing() -> None:
    for step in build("loop", laps=0.1).steps:
        noisy = add_noise(np.random.default_rng(0), step.frame, Noise(0, 0, 0, 0, 0))
        np.testing.assert_array_equal(noisy.u, step.frame.u)
        np.testing.assert_array_equal(noisy.z, step.frame.z)


def test_exact_frames_are_not_written_into() -> None:
    exact = frame(9, 3)
    before = exact.u.copy(), exact.z.copy()
    add_noise(np.random.default_rng(0), exact, NOISE)
    np.testing.assert_array_equal(exact.u, before[0])
    np.testing.assert_array_equal(exact.z, before[1])


def test_ranges_stay_positive() -> None:
    noisy = add_noise(np.random.default_rng(0), frame(1, 1000, distance=0.05), NOISE)
    assert noisy.z[:, 0].min() == BLIND


def test_a_frame_without_observations() -> None:
    noisy = add_noise(np.random.default_rng(0), frame(5, 0), NOISE)
    assert noisy.z.shape == (0, 2)
    assert noisy.u.shape == (5, 2)
