"""Noise: honest statistics, and streams that do not depend on its level."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from scenarios.noise import add_noise, check_noise
from scenarios.registry import build
from scenarios.sensors import BLIND
from scenarios.types import SourceError
from slam.features import Point, Wall
from slam.motion import Ackermann, Odometry, Unicycle, deviation
from slam.types import UNKNOWN_TAG, Frame, Noise, Scan

NOISE = Noise(speed=0.2, turn=0.1, range=0.05, bearing=0.02, odometry=0.3)
SILENT = Noise(0, 0, 0, 0, 0, 0)

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
    for noise in (NOISE, SILENT):
        rng = np.random.default_rng(5)
        add_noise(rng, frame(9, 3), noise)
        after.append(rng.standard_normal())
    assert after[0] == after[1]


def test_no_noise_changes_nothing() -> None:
    for step in build("loop", laps=0.1, features="landmarks").steps:
        noisy = add_noise(np.random.default_rng(0), step.frame, SILENT)
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


def scanned(beams: int, distance: float = 4.0, max_range: float = 8.0) -> Frame:
    """Every third beam meets nothing."""
    walls = np.where(np.arange(beams) % 3 == 0, UNKNOWN_TAG, 7)
    ranges = np.where(walls == 7, distance, np.inf)
    scan = Scan(ranges, np.linspace(-1, 1, beams), np.zeros(3), max_range, walls)
    u = np.array([[0.4, 0.0, 0.1]])
    return Frame(1.0, Odometry(), u, np.array([0.5]), Wall(), np.empty((0, 11)), np.empty(0, np.int64), scan)


def noisy_scan(frame: Frame, noise: Noise, seed: int = 0) -> Scan:
    found = add_noise(np.random.default_rng(seed), frame, noise).scan
    assert found is not None
    return found


def test_noise_of_a_scan() -> None:
    """60000 beams, two thirds of them returns: 4 standard errors of mean, deviation and share."""
    exact = scanned(60_000)
    assert exact.scan is not None
    found = noisy_scan(exact, Noise(range=0.05, missing=0.2))
    back = np.isfinite(found.ranges)
    assert not back[exact.scan.walls == UNKNOWN_TAG].any()
    assert abs(back.sum() / 40_000 - 0.8) < 4 * math.sqrt(0.16 / 40_000)
    errors = found.ranges[back] - 4.0
    assert abs(errors.mean()) < 4 * 0.05 / math.sqrt(32_000)
    assert abs(errors.std() / 0.05 - 1) < 4 / math.sqrt(64_000)
    assert found.walls is not None
    np.testing.assert_array_equal(found.walls == 7, back)  # what did not come back met nothing
    np.testing.assert_array_equal(found.bearings, exact.scan.bearings)


def test_the_level_of_a_scan_scales_the_same_draws() -> None:
    exact = scanned(300)
    one, two = (noisy_scan(exact, Noise(range=sigma)) for sigma in (0.01, 0.02))
    back = np.isfinite(one.ranges)
    np.testing.assert_allclose(two.ranges[back] - 4.0, 2 * (one.ranges[back] - 4.0), atol=1e-12)
    few, many = (noisy_scan(exact, Noise(range=0.01, missing=share)) for share in (0.1, 0.4))
    assert np.isinf(many.ranges[np.isinf(few.ranges)]).all()
    kept = np.isfinite(many.ranges)
    np.testing.assert_array_equal(many.ranges[kept], one.ranges[kept])
    assert np.isinf(noisy_scan(exact, Noise(missing=1.0)).ranges).all()
    after = []
    for noise in (Noise(range=0.3, odometry=0.5, missing=0.7), SILENT):
        rng = np.random.default_rng(5)
        add_noise(rng, exact, noise)
        after.append(rng.standard_normal())
    assert after[0] == after[1]


@pytest.mark.parametrize("name", ["loop", "hall"])
def test_no_noise_changes_no_scan(name: str) -> None:
    for frame, _ in build(name, laps=0.2).steps:
        noisy = add_noise(np.random.default_rng(0), frame, SILENT)
        assert frame.scan is not None
        assert noisy.scan is not None
        np.testing.assert_array_equal(noisy.u, frame.u)
        for a, b in zip(noisy.scan, frame.scan, strict=True):
            np.testing.assert_array_equal(a, b)
        assert noisy.z.shape == (0, 11)


def test_a_reading_is_neither_negative_nor_beyond_the_reach() -> None:
    near = noisy_scan(scanned(999, distance=0.02), NOISE)
    assert near.ranges.min() == BLIND
    far = noisy_scan(scanned(999, distance=7.99), NOISE)
    assert far.walls is not None
    assert 0.3 < np.isinf(far.ranges[far.walls == 7]).mean() + np.isinf(far.ranges).mean() < 0.9
    assert far.ranges[np.isfinite(far.ranges)].max() <= 8.0


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan])
def test_a_share_is_between_0_and_1(share: float) -> None:
    with pytest.raises(SourceError, match=r"noise.missing is .*; expected a number at least 0"):
        check_noise(Noise(missing=share))
