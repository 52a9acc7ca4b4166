"""Scan matching, in rooms and corridors whose walls are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slam.geometry import compose, invert, wrap
from slam.perception.matching import (
    STANDARD,
    START,
    Match,
    OdometryNoise,
    Track,
    _linearise,
    _placed,
    _submap,
    match,
    odometry_noise,
    surface_points,
)
from slam.types import Floats, Scan
from tests.slam.rays import Laser, look

LASER = Laser(sigma=0.0)
ROOM = np.array(
    [
        (-3.0, -2.5, 3.5, -2.5),
        (3.5, -2.5, 3.5, 1.0),
        (3.5, 1.0, 2.0, 1.0),
        (2.0, 1.0, 2.0, 3.0),
        (2.0, 3.0, -3.0, 3.0),
        (-3.0, 3.0, -3.0, -2.5),
        (0.5, 1.2, 1.0, 1.7),
    ]
)
CORRIDOR = np.array([(-50.0, 1.0, 50.0, 1.0), (-50.0, -1.0, 50.0, -1.0)])
Q = np.diag([0.05, 0.03, 0.05]) ** 2
"""Of odometry that is 5 cm, 3 cm and 3 degrees off."""

WAY = [np.array(step) for step in ([0.3, 0.0, 0.1], [0.3, 0.02, 0.15], [0.2, -0.01, -0.3], [0.3, 0.0, 0.0])]


def drive(
    walls: Floats,
    start: Floats,
    laser: Laser = LASER,
    error: Floats | None = None,
    rng: np.random.Generator | None = None,
) -> tuple[Floats, Floats, list[Match], Track]:
    """True poses and those that matches lead to, after `WAY`; odometry is off by `error` (3,) in each step."""
    rng = rng or np.random.default_rng(0)
    error = np.zeros(3) if error is None else error
    track, first = match(START, look(rng, walls, start, laser), np.zeros(3), np.zeros((3, 3)))
    assert (first.used, first.reason) == (False, "first scan")
    true, found, matches = [start], [start], []
    for u in WAY:
        true.append(compose(true[-1], u))
        track, step = match(track, look(rng, walls, true[-1], laser), u + error, Q)
        matches.append(step)
        found.append(compose(found[-1], step.u))
    return np.array(true), np.array(found), matches, track


@pytest.mark.parametrize(
    "laser",
    [LASER, Laser(361, 180.0, sigma=0.0), Laser(720, 360.0, sigma=0.0), Laser(sigma=0.0, origin=(0.25, -0.1, 0.2))],
)
def test_it_finds_the_motion_whatever_odometry_says(laser: Laser) -> None:
    error = np.array([0.06, -0.04, 0.05])
    true, found, matches, _ = drive(ROOM, np.array([-1.0, -0.8, 0.2]), laser, error)
    assert all(step.used and step.overlap > 0.8 and step.residual < 0.01 for step in matches)
    off = found - true
    assert np.abs(off[-1, :2]).max() < 0.01
    assert abs(wrap(off[-1, 2])) < 0.005


def test_errors_of_noisy_scans_are_small_and_no_larger_than_said() -> None:
    """The reported deviation covers errors that beams have in common, so it is well above that of noise alone."""
    u, start, errors, matches = WAY[0], np.array([-1.0, -0.8, 0.2]), [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        track, _ = match(START, look(rng, ROOM, start, Laser()), np.zeros(3), np.zeros((3, 3)))
        reported = u + np.sqrt(np.diag(Q)) * rng.normal(size=3)
        _, step = match(track, look(rng, ROOM, compose(start, u), Laser()), reported, Q)
        matches.append(step)
        errors.append(step.u - u)
    off, deviation = np.array(errors), np.sqrt(np.diag(matches[0].covariance))
    assert all(step.used for step in matches)
    spread = off.std(axis=0)
    assert (spread < deviation).all()
    assert (spread < 0.2 * np.sqrt(np.diag(Q))).all()
    assert (np.abs(off.mean(axis=0)) < 4.0 * spread / math.sqrt(60) + 1e-3).all()


@pytest.mark.parametrize("heading", [0.0, 0.4, math.pi - 0.1, -math.pi / 3])
def test_along_a_corridor_it_is_the_odometry_that_tells(heading: float) -> None:
    """It says so in the covariance, whichever way the robot looks; across the corridor and of the heading it knows."""
    along = np.array([math.cos(heading), -math.sin(heading)])
    rng = np.random.default_rng(2)
    start = np.array([0.0, 0.2, heading])
    track, _ = match(START, look(rng, CORRIDOR, start, Laser()), np.zeros(3), np.zeros((3, 3)))
    u, wrong = np.array([0.3, 0.05, 0.1]), 0.08
    reported = u + np.array([*(wrong * along), 0.04])
    isotropic = np.diag([0.05, 0.05, 0.05]) ** 2
    _, step = match(track, look(rng, CORRIDOR, compose(start, u), Laser()), reported, isotropic)
    assert step.used
    off = step.u - u
    assert off[:2] @ along == pytest.approx(wrong, abs=0.02)
    assert abs(off[:2] @ [along[1], -along[0]]) < 0.015
    assert abs(off[2]) < 0.01
    variance = along @ step.covariance[:2, :2] @ along
    across = np.array([-along[1], along[0]]) @ step.covariance[:2, :2] @ [-along[1], along[0]]
    assert variance > 0.8 * 0.05**2
    assert across < 0.25 * 0.05**2
    assert step.covariance[2, 2] < 0.25 * 0.05**2


@pytest.mark.parametrize("turn", [15.0, -15.0])
def test_a_turn_that_odometry_missed(turn: float) -> None:
    start, u = np.array([-1.0, -0.8, 0.2]), np.array([0.2, 0.0, math.radians(turn)])
    rng = np.random.default_rng(0)
    track, _ = match(START, look(rng, ROOM, start, LASER), np.zeros(3), np.zeros((3, 3)))
    wide = np.diag([0.1, 0.1, 0.3]) ** 2
    _, step = match(track, look(rng, ROOM, compose(start, u), LASER), np.array([0.2, 0.0, 0.0]), wide)
    assert step.used
    assert step.u == pytest.approx(u, abs=0.01)


def test_somebody_who_walks_by_does_not_matter() -> None:
    start, rng = np.array([-1.0, -0.8, 0.2]), np.random.default_rng(0)
    person = [(0.6, -0.9, 0.6, -0.5), (0.6, -0.5, 0.9, -0.5)]
    track, _ = match(START, look(rng, np.array([*ROOM, *person]), start, Laser()), np.zeros(3), np.zeros((3, 3)))
    moved = [(x0, y0 + 0.5, x1, y1 + 0.5) for x0, y0, x1, y1 in person]
    _, step = match(
        track, look(rng, np.array([*ROOM, *moved]), compose(start, WAY[0]), Laser()), WAY[0] + [0.03, 0.02, 0.02], Q
    )
    assert step.used
    assert step.u == pytest.approx(WAY[0], abs=0.015)


def blind(scan: Scan) -> Scan:
    return scan._replace(ranges=np.full_like(scan.ranges, np.inf))


def test_without_points_it_is_odometry() -> None:
    start, rng = np.array([-1.0, -0.8, 0.2]), np.random.default_rng(0)
    scan = look(rng, ROOM, start, Laser())
    track, _ = match(START, scan, np.zeros(3), np.zeros((3, 3)))
    for _ in range(200):  # minutes of it
        track, step = match(track, blind(scan), np.array([0.001, 0.0, 0.001]), Q)
        assert (step.used, step.reason) == (False, "too few points")
        assert step.u.tolist() == [0.001, 0.0, 0.001]
        assert step.covariance is Q
    assert len(track.scans) == 1
    for odd in (scan._replace(ranges=scan.ranges[:1], bearings=scan.bearings[:1]), blind(scan)):
        track, first = match(START, odd, np.zeros(3), Q)
        assert (first.used, track.scans) == (False, ())


def test_what_does_not_fit_is_not_used() -> None:
    start, rng = np.array([-1.0, -0.8, 0.2]), np.random.default_rng(0)
    track, _ = match(START, look(rng, ROOM, start, Laser()), np.zeros(3), np.zeros((3, 3)))
    elsewhere = look(rng, 7.0 * ROOM, np.zeros(3), Laser(reach=40.0))
    _, step = match(track, elsewhere, WAY[0], Q)
    assert not step.used
    assert step.reason in ("too little overlap", "does not fit")
    assert step.u is WAY[0]


def test_good_odometry_is_not_left_for_a_match_that_is_no_better() -> None:
    """Far along a corridor with one post seen twice: what fits as well as odometry does, and is far off, is refused."""
    start, rng = np.array([-1.0, -0.8, 0.2]), np.random.default_rng(0)
    track, _ = match(START, look(rng, ROOM, start, LASER), np.zeros(3), np.zeros((3, 3)))
    sure = np.diag([1e-4, 1e-4, 1e-4]) ** 2
    u = WAY[0]
    scan = look(rng, ROOM, compose(start, u), Laser(sigma=0.05))
    _, cautious = match(track, scan, u, sure)
    assert cautious.u == pytest.approx(u, abs=1e-3)


def test_at_rest_nothing_moves_and_nothing_grows() -> None:
    start = np.array([-1.0, -0.8, 0.2])
    track, pose = START, np.zeros(3)
    for seed in range(100):
        rng = np.random.default_rng(seed)
        track, step = match(track, look(rng, ROOM, start, Laser()), np.zeros(3), 1e-6 * np.eye(3))
        pose = compose(pose, step.u)
    assert len(track.scans) == 1
    assert np.abs(pose).max() < 0.01


def test_a_track_is_a_value() -> None:
    """One may go on from it twice, and what was seen before is shared."""
    start, rng = np.array([-1.0, -0.8, 0.2]), np.random.default_rng(0)
    track, _ = match(START, look(rng, ROOM, start, Laser()), np.zeros(3), np.zeros((3, 3)))
    kept = [scan.copy() for scan in track.scans]
    scan = look(rng, ROOM, compose(start, WAY[0]), Laser())
    one, first = match(track, scan, WAY[0], Q)
    other, second = match(track, scan, WAY[0], Q)
    assert first.u.tolist() == second.u.tolist()
    assert one.scans[0] is track.scans[0] is other.scans[0]
    assert all((a == b).all() for a, b in zip(track.scans, kept, strict=True))


def test_the_submap_forgets() -> None:
    settings = STANDARD._replace(keyframes=3)
    track, pose, rng = START, np.array([-40.0, 0.0, 0.0]), np.random.default_rng(1)
    for _ in range(12):
        pose = compose(pose, np.array([0.5, 0.0, 0.0]))
        track, _ = match(track, look(rng, CORRIDOR, pose, Laser()), np.array([0.5, 0.0, 0.0]), Q, settings)
    assert len(track.scans) == 3


def test_the_slope_is_that_of_the_misfit() -> None:
    """Against central differences, with the pairs and the surface as they are near the end of the way."""
    start, rng = np.array([-1.0, -0.8, 0.2]), np.random.default_rng(4)
    track, _ = match(START, look(rng, ROOM, start, LASER), np.zeros(3), np.zeros((3, 3)))
    q = surface_points(look(rng, ROOM, start, LASER))
    points, first = _submap(track, np.zeros(3), 20.0, STANDARD)
    pose, system = np.array([0.004, -0.003, 0.002]), np.empty((5, 3))
    everywhere = (1.0, 0.0, 0.0)

    def misfit(x: Floats) -> float:
        return _linearise(q, points, first, x, 0.15, everywhere, STANDARD, np.empty((5, 3)))[2]

    _linearise(q, points, first, pose, 0.15, everywhere, STANDARD, system)
    for axis in range(3):
        h = np.zeros(3)
        h[axis] = 1e-5
        slope = (misfit(pose + h) - misfit(pose - h)) / 2e-5
        assert system[3, axis] / len(q) == pytest.approx(slope, rel=0.02, abs=2e-5)


def test_normals_point_to_where_the_surface_was_seen_from() -> None:
    for origin in ((0.0, 0.0, 0.0), (0.3, 0.1, 0.5)):
        q = surface_points(look(np.random.default_rng(0), ROOM, np.array([-1.0, -0.8, 0.2]), Laser(origin=origin)))
        assert len(q) > 150
        np.testing.assert_allclose(np.hypot(q[:, 2], q[:, 3]), 1.0)
        assert (((q[:, :2] - origin[:2]) * q[:, 2:]).sum(axis=1) <= 0.0).all()
    moved = _placed(q, np.array([1.0, 2.0, 0.5]))
    back = _placed(moved, invert(np.array([1.0, 2.0, 0.5])))
    np.testing.assert_allclose(back, q, atol=1e-12)


def test_the_noise_of_an_odometry_is_learnt() -> None:
    """What is drawn is found again within a factor of two, from a drive to and fro in a room."""
    drawn = OdometryNoise(along=0.15, lateral=0.05, slip=0.02, turn_per_metre=0.1, turn_per_radian=0.1)
    rng = np.random.default_rng(7)
    pose, scans, reported = np.array([-1.0, -0.8, 0.0]), [], []
    for k in range(400):
        u = np.array([0.25, 0.0, 0.1]) if k % 40 < 20 else np.array([0.02, 0.0, 0.2])
        ahead = compose(pose, u)
        if not (-2.0 < ahead[0] < 1.5 and -1.8 < ahead[1] < 0.5):
            u = np.array([0.0, 0.0, 0.3])
            ahead = compose(pose, u)
        pose = ahead
        scans.append(look(rng, ROOM, pose, Laser()))
        reported.append(u + np.linalg.cholesky(drawn.covariance(u)) @ rng.normal(size=3))
    found = odometry_noise(scans, np.array(reported))
    assert found.turn_per_metre**2 + found.turn_per_radian**2 < 4.0 * 0.1**2 * 2
    assert found.turn_per_radian == pytest.approx(0.1, rel=0.6)
    assert found.along == pytest.approx(0.15, rel=0.6)
    quiet = odometry_noise(scans, np.array([u * 0.0 for u in reported]))
    assert np.isfinite(quiet).all()


def test_the_covariance_of_odometry_does_not_depend_on_how_often_it_is_read() -> None:
    noise, u = OdometryNoise(), np.array([0.8, 0.0, 0.0])
    np.testing.assert_allclose(noise.covariance(u), 4.0 * noise.covariance(u / 4.0), atol=1e-5)
    turned = noise.covariance(np.array([0.0, 0.8, 0.0]))
    assert turned[1, 1] == pytest.approx(noise.covariance(u)[0, 0])
