"""What a laser log shows of its own noise: that of its ranges, and that of its odometry."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from scenarios.logs import learning, part, read_log
from scenarios.logs.keyframes import keyframes
from scenarios.logs.laser_log import LEAST_RANGE_NOISE, NEARBY, Beams, range_noise
from scenarios.logs.learning import with_learned_odometry
from scenarios.logs.odometry import increments
from scenarios.registry import build
from scenarios.types import Source
from slam.geometry import compose
from slam.motion import Odometry, deviation
from slam.perception.odometry_noise import OdometryNoise
from slam.types import Floats, Noise, Scan
from tests.scenarios.laser_logs import arc, flaser, plain_log, write
from tests.slam.rays import Laser
from tests.slam.test_matching import driven


def beams(ranges: Floats, limit: float = math.inf) -> Beams:
    return Beams(np.arange(len(ranges)), np.zeros(ranges.shape[1]), ranges, limit)


def walls(scans: int = 40, n: int = 181) -> Floats:
    """(scans, n) [m] ranges to walls that begin and end, every thirty beams, and are steep."""
    k = np.arange(n)
    return np.array([2.0 + 0.5 * (k // 30) + 0.03 * (k % 30) + 0.013 * scan for scan in range(scans)])


# Ranges ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0.015, 0.04, 0.2])
def test_the_noise_of_ranges_is_found(sigma: float) -> None:
    """Although walls begin and end, some beams return nothing, and far away there is more of it."""
    rng = np.random.default_rng(1)
    noisy = walls() + rng.normal(0.0, sigma, (40, 181))
    noisy[:, 40::50] = np.inf
    noisy[:, 150:] += NEARBY + rng.normal(0.0, 1.0, (40, 31))
    assert range_noise([beams(noisy)]) == pytest.approx(sigma, rel=0.07)
    parts = [beams(noisy[:10, :90]), beams(noisy[10:]), beams(np.zeros((3, 0))), beams(np.zeros((1, 2)))]
    assert range_noise(parts) == pytest.approx(sigma, rel=0.07)


def test_what_a_scanner_rounds_to_is_noise() -> None:
    """Steps of 5 cm are 1.4 cm; told from second differences, which come in steps as well, within a half."""
    noisy = walls() + np.random.default_rng(2).normal(0.0, 0.02, (40, 181))
    expected = math.hypot(0.02, 0.05 / math.sqrt(12.0))
    assert expected / 1.5 < range_noise([beams(np.round(noisy / 0.05) * 0.05)]) < 1.5 * expected


@pytest.mark.parametrize(
    "ranges", [walls(), np.full((2, 50), np.inf), np.zeros((0, 181)), np.full((3, 2), 1.0), np.full((3, 9), NEARBY)]
)
def test_no_range_is_believed_to_be_exact(ranges: Floats) -> None:
    assert range_noise([beams(ranges)]) == LEAST_RANGE_NOISE
    assert range_noise([]) == LEAST_RANGE_NOISE


# Odometry -------------------------------------------------------------------------------------------------------------


def log_of(folder: Path, scans: list[Scan], u: Floats) -> Source:
    """Scans of 181 beams, and the increments that lead to them, written and read again."""
    pose, lines = np.zeros(3), []
    for k, (scan, moved) in enumerate(zip(scans, u, strict=True)):
        pose = compose(pose, moved)
        lines.append(flaser(np.where(np.isfinite(scan.ranges), scan.ranges, 81.91), pose, pose, 0.2 * k))
    return read_log(write(folder, "".join(lines)))


def test_the_noise_of_an_odometry_is_found(tmp_path: Path) -> None:
    """Within a half, of deviations that differ by a factor of five; and before a robot's way is cut into keyframes."""
    true = OdometryNoise(0.1, 0.05, 0.01, 0.1, 0.05)
    source = log_of(tmp_path, *driven(Laser(181, 180.0), true, 0.0))
    assert source.noise.range == pytest.approx(0.01, abs=0.003)
    learned = with_learned_odometry(source)
    u = np.array([[0.5, 0.0, 0.2]])
    for frame in (learned.steps[0].frame, learned.steps[300].frame, keyframes(learned, 0.5, 0.3).steps[4].frame):
        assert frame.motion == learned.motion
        found = deviation(frame.motion, u, learned.noise)[0]
        np.testing.assert_allclose(found, np.sqrt(np.diag(true.covariance(u[0]))), rtol=0.5)
    assert learned.noise.odometry < 0.7 * source.noise.odometry
    assert (learned.noise.range, learned.start.tolist()) == (source.noise.range, source.start.tolist())
    for before, after in zip(source.steps, learned.steps, strict=True):
        assert before.frame.u is after.frame.u
        assert before.frame.scan is after.frame.scan


def test_what_is_learned_is_what_the_filters_believe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The deviation ahead after one metre, and the others as parts of it; of the scans that are steps."""
    asked = []

    def told(scans: list[Scan], moved: Floats) -> OdometryNoise:
        asked.append((scans, moved))
        return OdometryNoise(along=0.2, lateral=0.1, slip=0.05, turn_per_metre=0.04, turn_per_radian=0.06)

    monkeypatch.setattr(learning, "odometry_noise", told)
    source = part(read_log(write(tmp_path, plain_log(arc(30)))), 4, 24, 3)
    learned = with_learned_odometry(source)
    assert learned.noise == Noise(range=source.noise.range, odometry=0.2)
    assert learned.params().believed.odometry == 0.2
    assert isinstance(learned.motion, Odometry)
    assert learned.motion == pytest.approx(
        Odometry(turn_per_metre=0.2, turn_per_radian=0.3, lateral=0.5, slip=0.25, walk=True)
    )
    assert {step.frame.motion for step in learned.steps} == {learned.motion}
    ((scans, moved),) = asked
    assert [id(scan) for scan in scans] == [id(step.frame.scan) for step in source.steps]
    np.testing.assert_allclose(moved, increments(arc(30)[4:25:3]), atol=1e-5)


@pytest.mark.parametrize(("turn", "told"), [(0.005, True), (0.05, False)])
def test_very_good_odometry_is_told_in_words_that_hold_whatever_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turn: float, told: bool
) -> None:
    """Nobody knows there how scans will be matched."""
    monkeypatch.setattr(learning, "odometry_noise", lambda *_: OdometryNoise(turn_per_metre=turn))
    warnings = with_learned_odometry(read_log(write(tmp_path, plain_log(arc(30))))).warnings
    assert any("--matching auto does not match scans; --matching on does" in text for text in warnings) == told


def test_of_what_is_no_log_of_a_laser_nothing_is_learned(tmp_path: Path) -> None:
    alone = read_log(write(tmp_path, plain_log(arc(1))))
    park = tmp_path / "park"
    park.mkdir()
    rows = {"dead_reckoning": "{t:.3f} 1.0 0.01", "trees": "{t:.3f} 5.0 1.5 0.4", "gps": "{t:.3f} 1.0 2.0"}
    for name, row in rows.items():
        write(park, "".join(row.format(t=0.025 * k) + "\n" for k in range(200)), f"{name}.txt")
    for source in (alone, read_log(park), build("corridor"), build("paper-line")):
        assert with_learned_odometry(source) is source
