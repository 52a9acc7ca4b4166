"""Ray casting against a second, slow implementation, and what a laser promises."""

import math
import time

import numpy as np
import pytest

from scenarios.laser import Laser, beam_bearings, check_laser, scan, spacing, walls_in_view
from scenarios.movers import Movers, check_movers, places
from scenarios.sensors import BLIND
from scenarios.types import SourceError
from slam.types import UNKNOWN_TAG


def slow_range(x: float, y: float, angle: float, wall: np.ndarray) -> float:
    """Where a ray meets a wall: the 2 x 2 equations of the ray and the line, solved as such."""
    a, b = wall[:2], wall[2:]
    direction = np.array([math.cos(angle), math.sin(angle)])
    A = np.column_stack([direction, a - b])
    if abs(np.linalg.det(A)) < 1e-13:
        return math.inf
    distance, along = np.linalg.solve(A, a - (x, y))
    return distance if distance > BLIND and 0 <= along <= 1 else math.inf


def slow_disc(x: float, y: float, angle: float, disc: np.ndarray) -> float:
    """The smaller root of |p + t d - c|^2 = r^2."""
    px, py = x - disc[0], y - disc[1]
    b, c = px * math.cos(angle) + py * math.sin(angle), px * px + py * py - disc[2] ** 2
    return -b - math.sqrt(b * b - c) if c > 0 and b < 0 and b * b > c else math.inf


def face(walls: np.ndarray, n: int, x: float, y: float) -> int:
    """The tag of the face of wall n that is turned to (x, y)."""
    x0, y0, x1, y1 = walls[n]
    left = np.linalg.det([[x1 - x0, y1 - y0], [x - x0, y - y0]]) > 0
    return n if left else n + len(walls)


@pytest.mark.parametrize(
    "laser",
    [
        Laser(),
        Laser(beams=361, field_of_view=2 * math.pi, max_range=30.0),
        Laser(beams=50, field_of_view=math.radians(270), max_range=math.inf, origin=(0.3, -0.1, 2.8)),
        Laser(beams=1, max_range=12.0),
        Laser(beams=7, field_of_view=0.01, max_range=12.0),
    ],
    ids=["front", "all round", "turned", "one", "narrow"],
)
def test_against_a_slow_implementation(laser: Laser) -> None:
    rng = np.random.default_rng(7)
    walls = rng.uniform(-10, 10, (40, 4))
    walls[:10, 2:] = walls[:10, :2] + rng.uniform(-0.3, 0.3, (10, 2))  # seen by few beams or none
    poses = np.column_stack([rng.uniform(-9, 9, (12, 2)), rng.uniform(-math.pi, math.pi, 12)])
    discs = np.concatenate([rng.uniform(-9, 9, (12, 3, 2)), np.full((12, 3, 1), 0.4)], axis=2)
    hidden = 0
    for found, pose, people in zip(scan(laser, walls, poses, discs), poses, discs, strict=True):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        ox, oy, turned = laser.origin
        x, y = pose[0] + c * ox - s * oy, pose[1] + s * ox + c * oy
        assert found.walls is not None
        beams = zip(found.bearings, found.ranges, found.walls, strict=True)
        for bearing, reading, tag in list(beams)[:: 1 + laser.beams // 30]:
            angle = pose[2] + turned + bearing
            each = [slow_range(x, y, angle, wall) for wall in walls]
            each += [slow_disc(x, y, angle, disc) for disc in people]
            nearest = int(np.argmin(each))
            if each[nearest] > laser.max_range or math.isinf(each[nearest]):
                assert (reading, tag) == (math.inf, UNKNOWN_TAG)
                continue
            assert reading == pytest.approx(each[nearest], abs=1e-9)
            assert tag == (face(walls, nearest, x, y) if nearest < len(walls) else UNKNOWN_TAG)
            hidden += tag == UNKNOWN_TAG
    assert hidden > 0 or laser.beams < 50


def test_corners_let_nothing_through() -> None:
    """In a closed room, aimed exactly at the corners, and from a place in line with walls."""
    corners = [(-3.0, -2.0), (3.0, -2.0), (3.0, 2.0), (-3.0, 2.0)]
    walls = np.array([(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)])
    rng = np.random.default_rng(0)
    for x, y in rng.uniform((-2.9, -1.9), (2.9, 1.9), (300, 2)):
        angles = [math.atan2(v - y, u - x) for u, v in corners]
        poses = np.array([[x, y, angle] for angle in angles])
        for found in scan(Laser(beams=5, field_of_view=0.1), walls, poses):
            assert np.isfinite(found.ranges).all()
    [found] = scan(Laser(beams=3, max_range=9.0), walls, np.array([[-2.0, -2.0, 0.0]]))  # on the lower wall
    np.testing.assert_allclose(found.ranges[1:], [5.0, 4.0])
    assert math.isinf(found.ranges[0])  # the wall it stands on is no nearer than BLIND


def test_field_of_view() -> None:
    front = beam_bearings(Laser(beams=181))
    np.testing.assert_allclose(np.degrees(front), np.arange(-90, 91), atol=1e-12)
    around = beam_bearings(Laser(beams=360, field_of_view=2 * math.pi))
    np.testing.assert_allclose(np.degrees(around), np.arange(-180, 180), atol=1e-12)
    assert (np.diff(around) > 0).all()
    assert beam_bearings(Laser(beams=1)).tolist() == [0.0]
    assert spacing(Laser(beams=2, field_of_view=0.5)) == 0.5


def test_range_limits() -> None:
    wall = np.array([[4.0, -1.0, 4.0, 1.0]])
    pose = np.zeros((1, 3))
    for reach, seen in ((4.0, True), (3.999, False), (math.inf, True)):
        [found] = scan(Laser(beams=1, max_range=reach), wall, pose)
        assert np.isfinite(found.ranges[0]) == seen
        assert walls_in_view(found).tolist() == ([0] if seen else [])
        assert found.max_range == reach


def test_people_walk_to_and_fro() -> None:
    movers = Movers(np.array([[0.0, 0.0, 3.0, 4.0]]), np.array([1.0]), np.array([2.0]), np.array([0.3]))
    found = places(movers, np.array([0.0, 3.0, 5.0, 8.0, 10.0]))
    walked = np.array([2.0, 5.0, 3.0, 0.0, 2.0])
    np.testing.assert_allclose(found[:, 0, :2], walked[:, None] * [0.6, 0.8], atol=1e-12)
    assert (found[:, 0, 2] == 0.3).all()
    check_movers(movers)


def test_somebody_who_stands_on_the_laser_is_not_seen() -> None:
    walls = np.array([[2.0, -1.0, 2.0, 1.0]])
    [found] = scan(Laser(beams=1), walls, np.zeros((1, 3)), np.array([[[0.1, 0.0, 0.25]]]))
    assert found.ranges.tolist() == [2.0]


@pytest.mark.parametrize(
    ("laser", "message"),
    [
        (Laser(beams=0), "laser.beams is 0; expected a whole number at least 1"),
        (Laser(beams=-5), "laser.beams is -5"),
        (Laser(beams=1_000_000), "at most 100000"),
        (Laser(max_range=0.0), r"laser.max_range is 0.0; expected a number above 0.01 \[m\]"),
        (Laser(max_range=math.nan), "laser.max_range is nan"),
        (Laser(field_of_view=0.0), "laser.field_of_view_deg is 0"),
        (Laser(field_of_view=7.0), "at most 360"),
        (Laser(every=0), "laser.every is 0"),
        (Laser(origin=(math.inf, 0.0, 0.0)), "laser.origin: x is inf"),
        (Laser(origin=(0.0, 0.0, 9.0)), "laser.heading_deg is 515"),
    ],
)
def test_impossible_lasers(laser: Laser, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        check_laser(laser)


def test_too_many_beams_for_the_memory() -> None:
    with pytest.raises(SourceError, match=r"laser\.beams is 100000: 1000 scans of so many"):
        scan(Laser(beams=100_000), np.array([[1.0, 0, 1, 1]]), np.zeros((1000, 3)))


@pytest.mark.parametrize(
    ("movers", "message"),
    [
        (Movers(np.zeros((1, 4)), np.ones(1), np.ones(1), np.ones(1)), r"movers.paths\[0\] is \[0.0, 0.0, 0.0, 0.0\]"),
        (Movers(np.eye(4)[:1], np.ones(2), np.ones(1), np.ones(1)), "movers.speeds: there are 2; expected one for"),
        (Movers(np.eye(4)[:1], -np.ones(1), np.ones(1), np.ones(1)), r"movers.speeds\[0\] is -1.0"),
        (Movers(np.eye(4)[:1], np.ones(1), np.ones(1), np.zeros(1)), r"movers.radii\[0\] is 0.0; .* above 0"),
    ],
)
def test_impossible_people(movers: Movers, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        check_movers(movers)


def test_ray_casting_is_quick() -> None:
    """1000 scans of 361 beams among 500 walls: some 0.05 s; a second leaves room for a busy machine."""
    rng = np.random.default_rng(1)
    start = rng.uniform(-30, 30, (500, 2))
    walls = np.concatenate([start, start + rng.uniform(-3, 3, (500, 2))], axis=1)
    poses = np.column_stack([rng.uniform(-30, 30, (1000, 2)), rng.uniform(-3, 3, 1000)])
    scan(Laser(), walls, poses[:1])  # compiled
    began = time.perf_counter()
    scan(Laser(beams=361, field_of_view=2 * math.pi), walls, poses)
    assert time.perf_counter() - began < 1.0
