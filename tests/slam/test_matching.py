"""Scans laid on scans of known worlds: what is recovered, how wrong it is and how wrong it claims to be."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from slam.geometry import compose, invert, wrap
from slam.perception.matching import (
    STANDARD,
    START,
    Match,
    Matcher,
    Track,
    _linearise,
    _submap,
    match,
    surface_points,
)
from slam.perception.odometry import GOOD_HEADING
from slam.perception.odometry_noise import OdometryNoise, odometry_noise
from slam.types import Floats, Scan
from tests.slam.rays import Laser, box, look, path, room

ROOM = np.vstack([path((-4, -3), (5, -3), (5, 2), (1, 2), (1, 3.5), (-4, 3.5), (-4, -3)), box(3, -1, 0.8, 0.5, 0.4)])
"""With an alcove, and a box in it: every direction is shown well."""

HALL = path((-60, -1), (60, -1), (60, 1), (-60, 1), (-60, -1))
"""A corridor whose ends are out of reach."""

EXACT = Laser(361, 360.0, sigma=0.0)
WIDE = np.diag([0.1, 0.1, 0.1]) ** 2
STILL = np.zeros(3)


def begin(walls: Floats, pose: Floats, laser: Laser, seed: int = 0, settings: Matcher | None = None) -> Track:
    """After the first scan, taken at a pose."""
    return match(START, look(np.random.default_rng(seed), walls, pose, laser), STILL, WIDE, settings or Matcher())[0]


def between(a: Floats, b: Floats) -> Floats:
    """The increment from pose a to pose b."""
    return compose(invert(a), b)


def difference(a: Floats, b: Floats) -> Floats:
    """(3,) of two increments."""
    return np.array([a[0] - b[0], a[1] - b[1], wrap(a[2] - b[2])])


def step(
    walls: Floats, a: Floats, b: Floats, error: Floats, laser: Laser, Q: Floats = WIDE, seed: int = 0
) -> tuple[Match, Floats]:
    """The match of a scan at b with one at a, where odometry has an error (3,), and how wrong it is (3,)."""
    rng = np.random.default_rng(seed)
    u = between(a, b)
    track, _ = match(START, look(rng, walls, a, laser), STILL, WIDE)
    _, found = match(track, look(rng, walls, b, laser), u + error, Q)
    return found, difference(found.u, u)


def follow(walls: Floats, poses: Floats, increments: Floats, laser: Laser, noise: OdometryNoise) -> list[Match]:
    """The matches along a way, the first scan left out."""
    rng = np.random.default_rng(4)
    track, found = match(START, look(rng, walls, poses[0], laser), STILL, WIDE)[0], []
    for pose, u in zip(poses[1:], increments, strict=True):
        track, one = match(track, look(rng, walls, pose, laser), u, noise.covariance(u))
        found.append(one)
    return found


def circle(laps: float, radius: float = 1.2, spacing: float = 0.12) -> Floats:
    """Poses (n, 3) round and round in the room."""
    angle = np.arange(0.0, laps * 2 * math.pi, spacing / radius)
    return np.column_stack([radius * np.cos(angle) - 0.5, radius * np.sin(angle), angle + math.pi / 2])


# What is recovered ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (0.3, -0.1, 0.0), (-0.2, 0.1, 2.0)])
@pytest.mark.parametrize("view", [180.0, 360.0])
def test_without_noise_the_motion_is_recovered(origin: tuple[float, float, float], view: float) -> None:
    """Whatever the odometry says, wherever the laser stands on the robot, and whatever frame the way began in."""
    rng = np.random.default_rng(1)
    laser = Laser(361, view, sigma=0.0, origin=origin)
    for _ in range(15):
        a = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-3, 3)])
        b = compose(a, [*rng.uniform(-0.2, 0.2, 2), rng.uniform(-0.15, 0.15)])
        found, error = step(ROOM, a, b, rng.normal(0, [0.07, 0.07, 0.05]), laser)
        assert found.used, found.reason
        assert np.hypot(*error[:2]) < 2e-3
        assert abs(error[2]) < math.radians(0.06)


def test_a_wrong_heading_is_found_again() -> None:
    """15 and 25 degrees, in random rooms, where one start alone, from where odometry has it, now and then misses."""
    laser, Q = Laser(181, 180.0, reach=30.0), np.diag([0.1, 0.1, math.radians(20)]) ** 2
    alone = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        walls, place = room(rng)
        a = np.array([*place, rng.uniform(-3, 3)])
        b = compose(a, [0.1, 0.0, 0.05])
        track, scan = begin(walls, a, laser, seed), look(rng, walls, b, laser)
        wrong = between(a, b) + np.array([0.02, -0.02, math.radians((15, -15, 25, -25)[seed % 4])])
        error = difference(match(track, scan, wrong, Q)[1].u, between(a, b))
        assert np.hypot(*error[:2]) < 0.03
        assert abs(error[2]) < 0.02
        alone.append(abs(match(track, scan, wrong, Q, Matcher(restarts=()))[1].u[2] - 0.05) < 0.02)
    assert np.mean(alone) < 0.97


@pytest.mark.parametrize("share", [0.0, -1.0])
def test_wheels_that_slip_and_odometers_that_count_back_as_ahead(share: float) -> None:
    """In random rooms; 0.9 m from where odometry has it, one start alone misses more often."""
    laser, Q = Laser(181, 180.0, reach=30.0), np.diag([0.1, 0.05, 0.05]) ** 2
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        walls, place = room(rng)
        a, told = np.array([*place, rng.uniform(-3, 3)]), np.array([0.45, 0.0, 0.1])
        b = compose(a, told * [share, share, 1.0])
        track, scan = begin(walls, a, laser, seed), look(rng, walls, b, laser)
        errors = [
            difference(match(track, scan, told, Q, settings)[1].u, between(a, b))
            for settings in (STANDARD, Matcher(shares=()))
        ]
        found.append([math.hypot(*error[:2]) < 0.03 and abs(error[2]) < 0.02 for error in errors])
    standard, alone = np.mean(found, axis=0)
    assert standard == 1.0 if share == 0.0 else standard > max(0.9, alone)


@pytest.mark.parametrize("beams", [90, 181, 541, 1081])
def test_any_number_of_beams(beams: int) -> None:
    found, error = step(ROOM, STILL, np.array([0.2, 0.1, 0.1]), np.array([0.05, -0.03, 0.04]), Laser(beams, 270.0))
    assert found.used
    assert np.hypot(*error[:2]) < 0.01
    assert abs(error[2]) < math.radians(0.4)
    points = surface_points(look(np.random.default_rng(0), ROOM, STILL, Laser(beams, 270.0)))
    assert 0.85 * beams / math.ceil(beams / 400) < len(points) <= 400


def test_normals_are_those_of_the_walls_and_point_to_the_laser() -> None:
    square = path((-3, -2), (3, -2), (3, 2), (-3, 2), (-3, -2))
    for turn in (0.0, 1.0, 2.5):
        scan = look(np.random.default_rng(0), square, np.array([0.5, 0.3, turn]), EXACT)
        points = surface_points(scan)
        place = np.array([0.5, 0.3]) + points[:, :2] @ [
            [math.cos(turn), math.sin(turn)],
            [-math.sin(turn), math.cos(turn)],
        ]
        normal = points[:, 2:] @ [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
        assert (np.sum(points[:, :2] * points[:, 2:], axis=1) < 0.0).all()
        flat = np.min(np.abs(np.abs(place) - [3, 2]), axis=1) < 1e-6
        assert flat.all()
        inner = (np.abs(place[:, 0]) < 2.6) & (np.abs(place[:, 1]) > 1.99)
        assert inner.sum() > 100
        np.testing.assert_allclose(
            normal[inner], np.stack([0 * place[inner, 0], -np.sign(place[inner, 1])], 1), atol=1e-6
        )


def test_round_walls_and_ranges_in_steps_of_5_cm() -> None:
    """A hall in the form of an egg, once round: the way closes although odometry is 20 degrees off."""
    turn = np.linspace(0, 2 * math.pi, 61)
    walls = path(*zip(5 * np.cos(turn) + 0.4 * np.cos(2 * turn), 3.5 * np.sin(turn), strict=True))
    poses = circle(1.0, 1.5, 0.2)
    u = between(poses[:-1], poses[1:])
    wrong = u + np.abs(u) * [0.03, 0.0, 0.055]
    found = follow(walls, poses, wrong, Laser(180, 180.0, sigma=0.005, quantum=0.05), OdometryNoise())
    ends = [poses[0], poses[0]]
    for one, odometry in zip(found, wrong, strict=True):
        ends = [compose(ends[0], one.u), compose(ends[1], odometry)]
    matched, dead_reckoned = (between(end, poses[-1]) for end in ends)
    assert abs(dead_reckoned[2]) > math.radians(15)
    assert np.hypot(*matched[:2]) < 0.04
    assert abs(matched[2]) < math.radians(1.0)


def test_somebody_who_walks_does_not_matter() -> None:
    """Legs, and a cart 0.7 m wide, that move by 12 cm: too little not to be paired.  Huber's limit makes up for it."""
    rng, laser, errors = np.random.default_rng(5), Laser(181, 180.0), []
    a, b = np.array([-1.0, 0.0, 0.1]), np.array([-0.8, 0.05, 0.15])
    for _ in range(60):
        cart, legs = rng.uniform(-1.5, 1.5), rng.uniform(-1.0, 1.0)
        before, after = (
            np.vstack([ROOM, box(2.0 + d, cart, 0.4, 0.7, 0.0), box(1.2, legs + d, 0.15, 0.15, 0.0)])
            for d in (0.0, 0.12)
        )
        track, scan = begin(before, a, laser, int(rng.integers(1000))), look(rng, after, b, laser)
        u = between(a, b) + rng.normal(0, [0.03, 0.03, 0.02])
        found = [match(track, scan, u, WIDE, Matcher(huber=huber))[1] for huber in (Matcher().huber, 1.0)]
        assert found[0].used
        errors.append([difference(one.u, between(a, b)) for one in found])
    robust, squares = np.median(np.abs(errors), axis=0)
    assert (robust < [0.015, 0.006, math.radians(0.25)]).all()
    assert robust[0] < 0.5 * squares[0]


# How wrong it is ------------------------------------------------------------------------------------------------------


def test_unbiased_and_as_wrong_as_it_claims() -> None:
    """With the deviation that points really have as `reported`: 1 cm in either scan.

    800 draws of two poses each, so a mean has a standard error of 0.035 deviations and a variance one of 0.05.  The
    surface is the mean of several points, so that less is wrong than is claimed; 0.1 m, the default, claims some fifty
    times the variance, on purpose (`Matcher.reported`).
    """
    rng, laser, normalised, wide = np.random.default_rng(6), Laser(181, 270.0, sigma=0.01), [], []
    settings = Matcher(reported=0.01 * math.sqrt(2.0))
    for _ in range(800):
        a = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-3, 3)])
        b = compose(a, [*rng.uniform(-0.15, 0.15, 2), rng.uniform(-0.1, 0.1)])
        track = match(START, look(rng, ROOM, a, laser), STILL, WIDE, settings)[0]
        scan, u = look(rng, ROOM, b, laser), between(a, b) + rng.normal(0, [0.05, 0.05, 0.05])
        found = match(track, scan, u, WIDE, settings)[1]
        error = difference(found.u, between(a, b))
        normalised.append(error / np.sqrt(np.diag(found.covariance)))
        wide.append(np.diag(match(track, scan, u, WIDE)[1].covariance / found.covariance))
    e = np.array(normalised)
    assert (np.abs(np.mean(e, axis=0)) < 4 * 0.035).all()
    assert (np.var(e, axis=0) > 0.5).all()
    assert (np.var(e, axis=0) < 1.2).all()
    assert 40 < np.median(wide) < 55


def test_along_a_corridor_odometry_decides_and_the_covariance_says_so() -> None:
    """Whatever the heading of the robot, and of the way when it began."""
    rng, laser = np.random.default_rng(7), Laser(181, 180.0, reach=8.0)
    Q, errors = np.diag([0.06, 0.04, 0.1]) ** 2, []
    for first in (0.0, 0.5, -2.0):
        a = np.array([0.0, 0.2, first])
        track = begin(HALL, a, laser)
        for k in range(24):
            b = a + np.array([0.05, 0.0, 0.05 if k < 12 else 0.0])
            odometry = between(a, b) + np.array([0.04, 0.04, 0.03]) * rng.normal(size=3)
            track, found = match(track, look(rng, HALL, b, laser), odometry, Q)
            assert found.used
            c, s = math.cos(a[2]), math.sin(a[2])
            turn = np.array([[c, -s], [s, c]])  # out of the robot's frame: x is along the corridor
            claimed, believed = (turn @ V[:2, :2] @ turn.T for V in (found.covariance, Q))
            moved, wrong = turn @ difference(found.u, odometry)[:2], difference(found.u, between(a, b))
            share = believed[0, 1] / believed[1, 1]  # what is known across says of what is along, by Q alone
            errors.append([moved[0] - share * moved[1], (turn @ wrong[:2])[1], wrong[2]])
            alone = believed[0, 0] - share * believed[0, 1]
            assert 0.9 * alone < claimed[0, 0] < 1.1 * believed[0, 0]
            assert claimed[1, 1] < 0.1 * believed[1, 1]
            assert found.covariance[2, 2] < 0.01 * Q[2, 2]
            a = b
    assert (np.abs(errors) < [0.01, 0.01, math.radians(0.3)]).all()
    assert (np.abs(np.mean(errors, axis=0)) < [0.002, 0.002, math.radians(0.05)]).all()


def test_somebody_who_walks_ahead_along_a_corridor_is_not_its_end() -> None:
    """Nothing else shows how far along it the robot is: the odometry is believed more than one who keeps ahead."""
    laser, noise, errors = Laser(181, 180.0, reach=8.0), OdometryNoise(*[0.04] * 5), []
    angle, poses = np.linspace(0, 2 * math.pi, 13), np.column_stack([np.arange(0, 4, 0.2), np.zeros(20), np.zeros(20)])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        tracks = [START, START]
        for k, pose in enumerate(poses):
            x = 2.5 + 0.28 * k + rng.normal(0, 0.02)
            person = path(*zip(x + 0.25 * np.cos(angle), 0.2 + 0.25 * np.sin(angle), strict=True))
            scan, u = look(rng, np.vstack([HALL, person]), pose, laser), between(poses[max(k - 1, 0)], pose)
            Q = noise.covariance(u)
            u = u + np.linalg.cholesky(Q) @ rng.normal(size=3)
            tracks = [
                match(track, scan, u, Q, Matcher(caution=caution))[0]
                for track, caution in zip(tracks, (Matcher().caution, 1.0), strict=True)
            ]
        errors.append([track.pose[0] - poses[-1, 0] for track in tracks])
    cautious, naive = np.sqrt(np.mean(np.square(errors), axis=0))
    assert cautious < 2.0 * 0.04 * math.sqrt(3.8)  # of the odometry alone
    assert naive > 1.7 * cautious


def test_the_end_of_a_corridor_shows_how_far_along_it_the_robot_is() -> None:
    walls = path((-60, -1), (5, -1), (5, 1), (-60, 1))
    Q = np.diag([0.1, 0.05, 0.1]) ** 2
    found, error = step(walls, STILL, np.array([0.2, 0.0, 0.0]), np.array([0.1, 0.0, 0.0]), Laser(361, 180.0), Q)
    assert abs(error[0]) < 0.01
    assert found.covariance[0, 0] < 0.1 * Q[0, 0]


def test_curvature_and_slope_are_those_of_the_misfit() -> None:
    """Against differences of the misfit, at poses where no distance is beyond Huber's limit."""
    settings, h = Matcher(huber=1.0), 1e-5
    a = np.array([0.3, 0.2, 0.5])
    square = path((-3, -2), (3, -2), (3, 2), (-3, 2), (-3, -2))
    track, q = begin(square, a, EXACT), surface_points(look(np.random.default_rng(0), square, a, EXACT), settings)
    q = q[np.max(np.abs(q[:, 2:] @ [[math.cos(0.5), math.sin(0.5)], [-math.sin(0.5), math.cos(0.5)]]), axis=1) > 0.9999]
    points, start = _submap(track, STILL, 10.0, settings)

    def at(pose: Floats) -> tuple[float, Floats]:
        system = np.empty((5, 3))
        everywhere = (1.0, 0.0, 0.0)
        fit = _linearise(q, points, start, pose, 0.5, everywhere, settings, system)
        assert fit[0] == 1.0
        return fit[2] * len(q), system

    for pose in np.array([[0.02, -0.01, 0.01], [-0.03, 0.02, -0.004], [0.001, 0.03, 0.012]]):
        system = at(pose)[1]
        for i, unit in enumerate(np.eye(3)):
            (up, rise), (down, fall) = at(pose + h * unit), at(pose - h * unit)
            np.testing.assert_allclose(system[3, i], (up - down) / (2 * h), rtol=2e-3, atol=2e-3)
            # The second derivatives of the distances are left out (Gauss-Newton); there are some of a turn alone.
            slopes = (rise[3] - fall[3]) / (2 * h)
            np.testing.assert_allclose(system[i, :2], slopes[:2], rtol=0.03, atol=0.5)


# What is not used -----------------------------------------------------------------------------------------------------


def test_what_says_nothing_leaves_the_odometry_as_it_is() -> None:
    """For minutes, and then the robot goes on where it was."""
    laser, u, Q = Laser(181, 180.0), np.array([0.01, 0.0, 0.02]), np.diag([0.01, 0.01, 0.01]) ** 2
    track, pose = begin(ROOM, STILL, laser), np.zeros(3)
    nothing = Scan(np.full(181, np.inf), laser.bearings, np.zeros(3), 8.0)
    few = nothing._replace(ranges=np.where(np.arange(181) < 12, 2.0, np.inf))
    for k in range(300):
        scan = (nothing, few, nothing._replace(ranges=np.empty(0), bearings=np.empty(0)))[k % 3]
        u = u * [1.0, 1.0, -1.0]
        track, found = match(track, scan, u, Q)
        pose = compose(pose, u)
        assert found.u is u
        assert found.covariance is Q
        assert (found.used, found.reason) == (False, "too few points")
    np.testing.assert_allclose(track.pose, pose, atol=1e-9)
    assert len(track.scans) == 1
    assert match(START, nothing, u, Q)[0].scans == ()


def test_another_place_is_no_match() -> None:
    laser, Q = Laser(181, 180.0), np.diag([0.02, 0.02, 0.02]) ** 2
    track, elsewhere = begin(ROOM, STILL, laser), path((1.2, -9), (1.2, 0.1), (9, 0.1), (9, 9), (-9, 9))
    u = np.array([0.1, 0.0, 0.0])
    _, found = match(track, look(np.random.default_rng(1), elsewhere, STILL, laser), u, Q)
    assert (found.used, found.reason) == (False, "too little overlap")
    assert found.u is u


def test_what_is_far_from_the_odometry_must_fit_much_better() -> None:
    """Two walls of a room are screens, and stand 10 cm further on now: 12 deviations of a very good odometry."""
    before = np.array([[-2, -2, 3, -2], [3, -2, 3, 2], [3, 2, -2, 2], [-2, 2, -2, -2]], float)
    after, laser, u = before.copy(), Laser(181, 180.0), np.array([0.2, 0.0, 0.0])
    after[:2] += [0.1, 0.0, 0.1, 0.0]
    track, scan = begin(before, STILL, laser), look(np.random.default_rng(2), after, u, laser)
    good, bad = OdometryNoise(*[0.01] * 5).covariance(u), OdometryNoise(*[0.1] * 5).covariance(u)
    found = match(track, scan, u, good)[1]
    assert (found.used, found.reason) == (False, "far from an odometry that fits as well")
    assert found.u is u
    assert match(track, scan, u, good, Matcher(surprise=15.0))[1].used
    assert match(track, scan, u, bad)[1].used
    # What fits that much better is believed: here the robot did move, and the wheels slipped.
    slipped = look(np.random.default_rng(3), before, np.array([0.3, 0.0, 0.15]), laser)
    found = match(track, slipped, u, OdometryNoise(*[0.03] * 5).covariance(u))[1]
    assert found.used
    np.testing.assert_allclose(found.u, [0.3, 0.0, 0.15], atol=0.02)  # 11 deviations off


def test_good_odometry_is_not_spoilt_in_a_thicket() -> None:
    """Where nothing stays in its place, 10 m of way: hardly worse than dead reckoning, most scans not used."""
    laser, noise, rng = Laser(181, 180.0), OdometryNoise(*[0.01] * 5), np.random.default_rng(1)
    stems = rng.uniform((-3, -6, 0.1, 0.1, 0), (13, 6, 0.5, 0.5, 3), (200, 5))
    stems = stems[np.abs(stems[:, 1]) > 0.8]

    def swaying() -> Floats:
        moved = stems + np.pad(rng.normal(0, 0.2, (len(stems), 2)), ((0, 0), (0, 3)))
        return np.vstack([box(*map(float, stem)) for stem in moved])

    poses = np.column_stack([np.arange(0, 10, 0.2), np.zeros(50), np.zeros(50)])
    track, unused, dead = begin(swaying(), poses[0], laser), 0, poses[0]
    for a, b in pairwise(poses):
        u = between(a, b)
        u = u + np.linalg.cholesky(noise.covariance(u)) @ rng.normal(size=3)
        track, found = match(track, look(rng, swaying(), b, laser), u, noise.covariance(u))
        unused, dead = unused + (not found.used), compose(dead, u)
    assert unused > 24
    assert np.hypot(*(track.pose - poses[-1])[:2]) < np.hypot(*(dead - poses[-1])[:2]) + 0.1


def test_lost_and_found_again() -> None:
    """After a jump that no odometry tells of, what follows is laid on the submap from before as soon as it can be."""
    laser, noise = Laser(181, 180.0), OdometryNoise()
    poses = circle(1.0)
    u = between(poses[:-1], poses[1:])
    nothing = Scan(np.full(181, np.inf), laser.bearings, np.zeros(3), 8.0)
    rng, track = np.random.default_rng(3), begin(ROOM, poses[0], laser)
    for k, pose in enumerate(poses[1:40]):
        blind = 20 <= k < 23
        wrong = u[k] + [0.0, 0.0, 0.12] if blind else u[k]
        track, found = match(track, nothing if blind else look(rng, ROOM, pose, laser), wrong, noise.covariance(wrong))
        if blind:
            assert not found.used
        elif k == 23:  # what had gone wrong is in this increment, and its covariance covers it
            error = difference(found.u, u[k])
            assert found.used
            assert 0.2 < abs(error[2]) < 0.5
            assert abs(error[2]) < 3.0 * math.sqrt(found.covariance[2, 2])
    error = difference(track.pose, between(poses[0], poses[39]))
    assert np.hypot(*error[:2]) < 0.03
    assert abs(error[2]) < math.radians(0.7)


def test_a_scan_at_a_place_that_only_odometry_tells_is_added_late() -> None:
    laser, Q = Laser(181, 180.0), np.diag([0.02, 0.02, 0.02]) ** 2
    track, elsewhere = begin(ROOM, STILL, laser), path((1.2, -9), (1.2, 0.1), (9, 0.1), (9, 9), (-9, 9))
    scan, settings, kept = (
        look(np.random.default_rng(1), elsewhere, STILL, laser),
        Matcher(spacing=0.25, patience=4.0),
        [],
    )
    for k in range(12):
        track, found = match(track, scan, np.array([0.1, 0.0, 0.0]), Q, settings)
        kept.append(len(track.scans))
        if k == 9:
            np.testing.assert_allclose(track.doubt[0, 0], 10 * Q[0, 0])
    assert kept[:10] == [1] * 10
    assert kept[10] == 2
    assert found.used  # it is laid on itself now: a robot that does not move
    assert abs(found.u[0]) < 0.01


# A track is a value ---------------------------------------------------------------------------------------------------


def test_a_track_is_never_written_to_and_may_be_gone_on_from_again() -> None:
    laser, noise = Laser(181, 180.0), OdometryNoise()
    poses = circle(1.0)
    u, rng = between(poses[:-1], poses[1:]), np.random.default_rng(8)
    scans = [look(rng, ROOM, pose, laser) for pose in poses]
    settings = Matcher(keyframes=6)

    def run(track: Track, first: int, last: int) -> list[tuple[Track, Match]]:
        out = []
        for k in range(first, last):
            increment = u[k - 1] if k else STILL
            track, found = match(track, scans[k], increment, noise.covariance(increment), settings)
            for array in (track.pose, track.doubt, track.newest, *track.scans):
                array.flags.writeable = False
            out.append((track, found))
        return out

    whole = run(START, 0, 40)
    again = run(whole[19][0], 20, 40)
    for (track, found), (other, repeated) in zip(whole[20:], again, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(found[:2], repeated[:2], strict=True))
        assert np.array_equal(track.pose, other.pose)
    assert max(len(track.scans) for track, _ in whole) == 6
    shared = {id(scan) for scan in whole[30][0].scans} & {id(scan) for scan in whole[31][0].scans}
    assert len(shared) >= 5
    assert START.scans == ()
    assert not START.pose.any()


def test_a_robot_that_stands_still_does_not_creep() -> None:
    rng, laser = np.random.default_rng(9), Laser(181, 180.0)
    track, Q = begin(ROOM, STILL, laser), OdometryNoise().covariance(STILL)
    for _ in range(150):
        track, found = match(track, look(rng, ROOM, STILL, laser), STILL, Q)
        assert found.used
    assert np.abs(track.pose).max() < 0.01
    assert len(track.scans) == 1


# The noise of an odometry ---------------------------------------------------------------------------------------------


def test_variances_of_an_increment_do_not_depend_on_how_it_is_cut() -> None:
    noise = OdometryNoise(0.1, 0.05, 0.08, 0.15, 0.2)
    floor = noise.covariance(STILL)
    whole = noise.covariance(np.array([3.0, 4.0, -0.6])) - floor
    np.testing.assert_allclose(whole, 10 * (noise.covariance(np.array([0.3, 0.4, -0.06])) - floor), rtol=1e-9)
    direction = np.array([0.6, 0.8])
    np.testing.assert_allclose(direction @ whole[:2, :2] @ direction, 5 * 0.1**2 + 0.6 * 0.08**2)
    np.testing.assert_allclose([-0.8, 0.6] @ whole[:2, :2] @ [-0.8, 0.6], 5 * 0.05**2 + 0.6 * 0.08**2)
    np.testing.assert_allclose(whole[2, 2], 5 * 0.15**2 + 0.6 * 0.2**2)


def driven(laser: Laser, noise: OdometryNoise, bias: float) -> tuple[list[Scan], Floats]:
    """Scans of eight laps in the room, half of them the other way round, and the increments of an odometry."""
    rng = np.random.default_rng(10)
    there = circle(4.0)
    back = compose(there[::-1], np.array([0.0, 0.0, math.pi]))
    poses = np.vstack([there, back])
    u = np.vstack([STILL, between(poses[:-1], poses[1:])])
    scans = [look(rng, ROOM, pose, laser) for pose in poses]
    for one in u[1:]:
        one += np.linalg.cholesky(noise.covariance(one)) @ rng.normal(size=3)
        one[2] += bias * math.hypot(one[0], one[1])
    return scans, u


def test_the_noise_of_an_odometry_is_learned_from_its_log() -> None:
    """Some 25 stretches of 2.5 m and two radians: a deviation is known to a fifth."""
    laser = Laser(181, 270.0)
    good = odometry_noise(*driven(laser, OdometryNoise(0.01, 0.01, 0.01, 0.01, 0.01), 0.0))
    bad = odometry_noise(*driven(laser, OdometryNoise(0.1, 0.05, 0.01, 0.1, 0.05), 0.0))
    biased = odometry_noise(*driven(laser, OdometryNoise(0.01, 0.01, 0.01, 0.01, 0.01), 0.08))
    u = np.array([0.5, 0.0, 0.2])
    expected = OdometryNoise(0.1, 0.05, 0.01, 0.1, 0.05).covariance(u)
    np.testing.assert_allclose(np.sqrt(np.diag(bad.covariance(u))), np.sqrt(np.diag(expected)), rtol=0.5)
    for i, least in enumerate((2.5, 1.5, 2.5)):
        assert bad.covariance(u)[i, i] > least**2 * good.covariance(u)[i, i]
    assert biased.covariance(u)[2, 2] > (0.08 * math.sqrt(2.0 * 0.5)) ** 2  # 0.08 rad/m over more than two metres


def test_a_corridor_does_not_teach_what_it_does_not_show() -> None:
    rng, laser = np.random.default_rng(11), Laser(181, 180.0, reach=8.0)
    poses = np.column_stack([np.arange(0.0, 40.0, 0.2), np.zeros(200), np.zeros(200)])
    u = np.vstack([STILL, between(poses[:-1], poses[1:])])
    scans = [look(rng, HALL, pose, laser) for pose in poses]
    learned = odometry_noise(scans, u + np.array([0.02, 0.0, 0.004]))
    np.testing.assert_allclose(learned.along, OdometryNoise().along, rtol=0.1)
    assert 0.02 < learned.turn_per_metre < 0.08  # 0.02 rad/m, over 5 m
    assert odometry_noise(scans, u).turn_per_metre < GOOD_HEADING < 0.5 * learned.turn_per_metre


def test_a_log_that_shows_nothing_teaches_nothing() -> None:
    nothing = Scan(np.full(181, np.inf), Laser().bearings, np.zeros(3), 8.0)
    learned = odometry_noise([nothing] * 50, np.tile([0.1, 0.0, 0.01], (50, 1)))
    np.testing.assert_allclose(learned, OdometryNoise(), rtol=0.1)
    np.testing.assert_allclose(odometry_noise([], np.empty((0, 3))), OdometryNoise(), rtol=0.1)
    np.testing.assert_allclose(odometry_noise([nothing] * 9, np.zeros((9, 3))), OdometryNoise(), rtol=0.1)
