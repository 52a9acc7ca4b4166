"""Walls out of laser scans of known worlds: what is found, how wrong it is and how wrong it claims to be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slam.features import Wall
from slam.features.wall import CORNER, EDGE, HIDDEN, OUT_OF_REACH, STRAIGHT
from slam.geometry import compose
from slam.motion import Unicycle
from slam.perception import Extraction, Segments, extract, perceive, tags_of
from slam.perception.score import errors
from slam.perception.segments import shared_directions
from slam.types import UNKNOWN_TAG, Floats, Frame, Noise, Params, Scan
from tests.slam.rays import Laser, World, box, corridor, look, path, room, score

ORIGIN = np.zeros(3)
ALL_ROUND = Laser(360, 360.0)


def seen(walls: Floats, laser: Laser = ALL_ROUND, pose: Floats = ORIGIN, seed: int = 0) -> tuple[Segments, Scan]:
    scan = look(np.random.default_rng(seed), walls, pose, laser)
    return extract(scan, laser.sigma, Extraction(quantum=laser.quantum)), scan


def of_wall(segments: Segments, scan: Scan, tag: int) -> list[int]:
    """The segments made of beams that met a wall, for the greater part."""
    assert scan.walls is not None
    return [i for i in range(len(segments.z)) if 2 * np.mean(scan.walls[segments.label == i] == tag) > 1]


# What is found, and how honest it is ----------------------------------------------------------------------------------


@pytest.mark.parametrize("world", [room, corridor])
@pytest.mark.parametrize(
    "laser",
    [
        Laser(181, 180.0),
        Laser(361, 180.0),
        Laser(360, 360.0),
        Laser(361, 360.0),
        Laser(181, 180.0, reach=30.0, quantum=0.01, missing=0.03),
        Laser(180, 180.0, quantum=0.05),
    ],
    ids=lambda laser: f"{laser.beams}-beams-{laser.view:.0f}-degrees-{laser.quantum}",
)
def test_walls_are_found_and_errors_are_as_large_as_they_claim(world: World, laser: Laser) -> None:
    """The targets: 95 % of the walls that 12 beams meet, 2 % false, normalised errors of variance 0.8 to 1.25.

    Some 450 to 900 segments, so a variance has a standard error of 0.07 to 0.05.
    """
    s = score(world, laser, scans=120, seed=1)
    assert s.walls > 300
    assert s.found >= 0.95 * s.walls
    assert s.false <= 0.02 * s.segments
    for normalised in (s.lateral, s.angle):
        assert 0.8 < np.mean(normalised**2) < 1.25
        assert abs(np.mean(normalised)) < 4.0 / math.sqrt(len(normalised))


def test_few_beams_are_as_honest_as_many() -> None:
    """Pieces of 7 to 14 beams: about 750, a variance of 1 with a standard error of 0.05."""
    s = score(corridor, Laser(361, 360.0), scans=350, seed=2)
    few = s.beams < 15
    assert few.sum() > 500
    for normalised in (s.lateral[few], s.angle[few]):
        assert 0.8 < np.mean(normalised**2) < 1.25


def test_rounding_must_be_told() -> None:
    """Ranges in steps of 5 cm, of which the extraction knows nothing, make it overconfident."""
    laser = Laser(180, 180.0, sigma=0.003, quantum=0.05)
    told, untold = (score(room, laser, 120, 1, Extraction(quantum=quantum)) for quantum in (0.05, 0.0))
    assert np.mean(told.lateral**2) < 1.6
    assert np.mean(untold.lateral**2) > 2.0 * np.mean(told.lateral**2)


def test_residuals_speak_where_the_belief_is_wrong() -> None:
    """A laser twice as bad as believed: not four times the variance that is claimed."""
    rng = np.random.default_rng(3)
    walls, pose, ratio = path((-3, 2), (3, 2)), np.array([0, 0, math.pi / 2]), []
    for _ in range(200):
        z, _ = extract(look(rng, walls, pose, Laser(sigma=0.02)), 0.01)
        ratio.append(errors(z[0], walls[0], pose)[0] / math.sqrt(z[0, 5]))
    assert 0.8 < np.mean(np.square(ratio)) < 1.6


def test_beams_that_are_off_do_not_count() -> None:
    """One in twenty is 6 cm too short: not enough to split the wall there, too much to be noise."""
    rng, pose = np.random.default_rng(13), np.array([0, 0, math.pi / 2])
    walls, ratio = path((-3, 2), (3, 2)), []
    for _ in range(200):
        scan = look(rng, walls, pose, Laser(121, 90.0))
        z, _ = extract(scan._replace(ranges=scan.ranges - 0.06 * (rng.random(121) < 0.05)), 0.01)
        ratio.append(errors(z[0], walls[0], pose)[0] / math.sqrt(z[0, 5]))
    assert np.mean(np.square(ratio)) < 1.4


def test_variances_of_a_wall_in_front() -> None:
    """sigma^2 / n and sigma^2 / sum t^2, where all beams meet the wall at nearly a right angle."""
    bearings = np.radians(np.linspace(-5, 5, 101))
    scan = Scan(8.0 / np.cos(bearings), bearings, ORIGIN, 20.0)
    z, _ = extract(scan, 0.01, Extraction(prior=1e9))  # so that the residuals, which are none, do not count
    t = 8.0 * np.tan(bearings[1:-1]) if z[0, 7] == CORNER else 8.0 * np.tan(bearings)
    np.testing.assert_allclose(z[0, 5], 1e-4 / len(t), rtol=0.01)
    np.testing.assert_allclose(z[0, 6], 1e-4 / np.sum(t**2), rtol=0.01)


def test_without_noise_walls_and_corners_are_exact() -> None:
    walls = path((3, -2), (3, 2), (-1, 2), (-1, -2), (3, -2))
    segments, scan = seen(walls, Laser(360, 360.0, sigma=0.0))
    assert len(segments.z) == 4
    for i, z in enumerate(segments.z):
        (tag,) = np.unique(np.asarray(scan.walls)[segments.label == i])
        np.testing.assert_allclose(errors(z, walls[tag], ORIGIN), 0.0, atol=1e-9)
        axis = np.array([math.cos(z[2]), math.sin(z[2])])
        np.testing.assert_allclose(z[:2] + z[3] * axis, walls[tag, :2], atol=1e-9)
        np.testing.assert_allclose(z[:2] + z[4] * axis, walls[tag, 2:], atol=1e-9)
        assert list(z[7:9]) == [CORNER, CORNER]


def test_the_robot_is_to_the_left_and_the_longest_comes_first() -> None:
    rng = np.random.default_rng(4)
    for _ in range(40):
        walls, place = room(rng)
        (z, label), _ = seen(walls, pose=np.array([*place, rng.uniform(-3, 3)]), seed=int(rng.integers(1000)))
        assert np.all(z[:, 0] * np.sin(z[:, 2]) - z[:, 1] * np.cos(z[:, 2]) > 0.0)
        assert np.all((z[:, 3] <= 0.0) & (z[:, 4] >= 0.0))
        assert np.all(np.diff(z[:, 4] - z[:, 3]) <= 0.0)
        np.testing.assert_array_equal(z[:, 9], np.bincount(label[label >= 0], minlength=len(z)))


# Ends -----------------------------------------------------------------------------------------------------------------


def test_why_a_wall_ends() -> None:
    """Ahead, from right to left: a free end, then what a box hides; to the left a corner, and the scan's own end."""
    wall, far, side = path((3, -1.5), (3, 2)), path((5, -4), (5, 4)), path((3, 2), (-2, 2))
    segments, scan = seen(np.vstack([wall, far, side]), Laser(181, 180.0))
    (front,), (left,) = of_wall(segments, scan, 0), of_wall(segments, scan, 2)
    assert list(segments.z[front, 7:9]) == [EDGE, CORNER]
    assert list(segments.z[left, 7:9]) == [CORNER, OUT_OF_REACH]
    (behind,) = of_wall(segments, scan, 1)
    assert segments.z[behind, 8] == HIDDEN


def test_an_end_that_a_box_hides_is_none() -> None:
    walls = np.vstack([path((3, -3), (3, 3)), box(1.5, 1.2, 0.4, 0.4, 0.3)])
    segments, scan = seen(walls, Laser(91, 90.0))
    before = min(of_wall(segments, scan, 0), key=lambda i: np.flatnonzero(segments.label == i)[0])
    assert segments.z[before, 8] != EDGE
    assert segments.z[before, 7] == OUT_OF_REACH


def test_where_the_range_ends_no_wall_does() -> None:
    (z, _), _ = seen(path((-20, 1), (20, 1)))
    assert len(z) == 1
    assert list(z[0, 7:9]) == [OUT_OF_REACH, OUT_OF_REACH]
    assert z[0, 4] - z[0, 3] > 8.0


def test_beyond_the_range_nothing_hides_a_wall() -> None:
    """5 m of range end where, from the next beam on, something nearer stands before a part that is too far anyway."""
    walls = np.vstack([path((-1, 2), (20, 2)), path((3, -1), (3, 1.32))])
    segments, scan = seen(walls, Laser(361, 180.0, reach=5.0))
    (wall,) = of_wall(segments, scan, 0)
    on = np.flatnonzero(segments.label == wall)
    assert np.isfinite(scan.ranges[on[0] - 1])
    assert segments.z[wall, 7] == OUT_OF_REACH


def test_an_end_beyond_which_returns_are_missing_is_none() -> None:
    walls = np.vstack([path((3, -2), (3, 0)), path((5, -4), (5, 4))])
    segments, scan = seen(walls, Laser(361, 180.0))
    (wall,) = of_wall(segments, scan, 0)
    assert segments.z[wall, 8] == EDGE
    ranges, last = scan.ranges.copy(), np.flatnonzero(segments.label == wall)[-1]
    ranges[last + 1 : last + 6] = np.inf
    segments = extract(scan._replace(ranges=ranges), 0.01)
    (wall,) = of_wall(segments, scan, 0)
    assert segments.z[wall, 8] == OUT_OF_REACH


def test_a_box_has_a_corner_in_front_and_edges_at_the_sides() -> None:
    walls = np.vstack([box(3, 0, 1.2, 1.2, math.pi / 4), path((6, -6), (6, 6))])
    segments, scan = seen(walls, Laser(361, 180.0, reach=20.0))
    faces = [i for i in range(len(segments.z)) if segments.z[i, 0] < 4]
    assert sorted(tuple(segments.z[i, 7:9]) for i in faces) == [(EDGE, CORNER), (CORNER, EDGE)]
    (back,) = of_wall(segments, scan, 4)  # one wall, on both sides of the box
    assert list(segments.z[back, 7:9]) == [OUT_OF_REACH, OUT_OF_REACH]


# Beams: all round, missing, and what stands for no return -------------------------------------------------------------


@pytest.mark.parametrize("beams", [360, 361, 720])
def test_a_wall_across_the_seam_is_one(beams: int) -> None:
    """Wherever the scan begins, the same four walls, and of the same quality."""
    walls = path((3, -2), (3, 2), (-2, 2), (-2, -2), (3, -2))
    for turn in np.linspace(0, 2 * math.pi, 17):
        (z, label), scan = seen(walls, Laser(beams, 360.0), np.array([0, 0, turn]), seed=5)
        assert len(z) == 4
        assert np.all(z[:, 7:9] == CORNER)
        np.testing.assert_allclose(z[:, 4] - z[:, 3], [5, 5, 4, 4], atol=0.05)
        assert np.sum(label < 0) <= 4 + beams % 2
        assert set(tags_of(Segments(z, label), scan.walls)) == {0, 1, 2, 3}


def test_no_direction_counts_twice() -> None:
    """A quarter of a turn more than all round."""
    walls = path((3, -2), (3, 2), (-2, 2), (-2, -2), (3, -2))
    once, more = seen(walls, Laser(360, 360.0))[0], seen(walls, Laser(451, 450.0))[0]
    assert len(more.z) == len(once.z) == 4
    assert np.all(more.label[360:] == -1)
    assert more.z[:, 9].sum() <= 360


def test_a_scan_that_is_not_closed_has_two_ends() -> None:
    walls = path((3, -2), (3, 2), (-2, 2), (-2, -2), (3, -2))
    segments, scan = seen(walls, Laser(341, 340.0))
    pieces = [segments.z[i] for i in of_wall(segments, scan, 2)]
    assert len(pieces) == 2
    assert sorted(int(kind) for piece in pieces for kind in piece[7:9]) == [OUT_OF_REACH, OUT_OF_REACH, CORNER, CORNER]


def test_missing_returns_do_not_break_a_wall() -> None:
    walls = path((-4, 2), (4, 2))
    pose = np.array([0, 0, math.pi / 2])
    rng = np.random.default_rng(6)
    for _ in range(20):
        (z, _), _ = seen(walls, Laser(missing=0.2), pose, seed=int(rng.integers(10**6)))
        assert np.sum(z[:, 4] - z[:, 3] > 3.0) == 1
    _, scan = seen(walls, Laser(), pose)
    ranges = scan.ranges.copy()
    ranges[88:93] = np.inf  # 0.2 m
    assert len(extract(scan._replace(ranges=ranges), 0.01).z) == 1
    ranges[78:103] = np.inf  # 0.9 m: a door with nothing behind
    z, _ = extract(scan._replace(ranges=ranges), 0.01)
    assert len(z) == 2
    assert np.all(z[:, 7:9] == OUT_OF_REACH)


def test_whatever_stands_for_no_return() -> None:
    rng = np.random.default_rng(7)
    walls, place = room(rng)
    laser = Laser(missing=0.1, reach=5.0)
    scan = look(rng, walls, np.array([*place, 0.3]), laser)
    expected = extract(scan, 0.01)
    assert len(expected.z)
    for value in (5.0, 5.0001, 81.91, np.nan, 0.0, -1.0):
        z, label = extract(scan._replace(ranges=np.where(np.isinf(scan.ranges), value, scan.ranges)), 0.01)
        np.testing.assert_array_equal(z, expected.z)
        np.testing.assert_array_equal(label, expected.label)


# One wall or two ------------------------------------------------------------------------------------------------------


def gap(stands: float | None, behind: float | None) -> tuple[Segments, Scan]:
    """A wall 3 m ahead with 1 m of it open: to a wall `behind` it; or the whole of it, and something that `stands`
    before it."""
    walls = [path((3, -3), (3, -0.5)), path((3, 0.5), (3, 3))]
    if stands is not None:
        walls = [path((3, -3), (3, 3)), path((stands, -0.2), (stands, 0.2))]
    if behind is not None:
        walls.append(path((3, -0.5), (3 + behind, -0.5), (3 + behind, 0.5), (3, 0.5)))
    return seen(np.vstack(walls), Laser(181, 90.0))


def crossing(segments: Segments) -> int:
    """Segments that go past both sides of the gap."""
    z = segments.z
    ends = z[:, None, 1] + z[:, 3:5] * np.sin(z[:, 2:3])
    return int(np.sum((ends.min(axis=1) < -1.0) & (ends.max(axis=1) > 1.0)))


def test_a_wall_behind_something_is_one() -> None:
    segments, scan = gap(stands=1.5, behind=None)
    assert crossing(segments) == 1
    assert len(of_wall(segments, scan, 0)) == 1


@pytest.mark.parametrize("behind", [0.12, 0.5, 3.0, None])
def test_walls_on_both_sides_of_a_door_are_two(behind: float | None) -> None:
    """It stands back by 0.12 m, or is open, to a near room, a far one, or one that is out of reach."""
    segments, scan = gap(stands=None, behind=behind)
    assert crossing(segments) == 0
    assert len(of_wall(segments, scan, 0)) == len(of_wall(segments, scan, 1)) == 1


def test_a_door_far_down_the_corridor_with_nothing_behind() -> None:
    """A few missing beams only, but 0.9 m of wall."""
    walls = np.vstack([path((-1, 1), (3, 1)), path((3.9, 1), (9, 1))])
    segments, scan = seen(walls, Laser(721, 180.0))
    assert len(of_wall(segments, scan, 0)) == len(of_wall(segments, scan, 1)) == 1
    assert len(segments.z) == 2


def test_the_backs_of_two_recesses_are_two() -> None:
    """On one line, and the wall between them is nearer; but it hides nothing."""
    walls = path(
        (3, -3), (3, -1.5), (3.12, -1.5), (3.12, -0.5), (3, -0.5), (3, 0.5), (3.12, 0.5), (3.12, 1.5), (3, 1.5), (3, 3)
    )
    segments, scan = seen(walls, Laser(361, 90.0))
    assert len(of_wall(segments, scan, 2)) == len(of_wall(segments, scan, 6)) == 1
    assert of_wall(segments, scan, 2) != of_wall(segments, scan, 6)


# Frames ---------------------------------------------------------------------------------------------------------------


def frame(scan: Scan | None) -> Frame:
    z, tags = np.zeros((1, 11)), np.array([7])
    return Frame(0.0, Unicycle(), np.zeros((0, 2)), np.zeros(0), Wall(), z, tags, scan)


def test_a_frame_without_a_scan_is_left_alone() -> None:
    before = frame(None)
    assert perceive(before, Params()) is before


def test_a_frame_gets_what_its_scan_shows() -> None:
    _, scan = seen(path((3, -2), (3, 2), (-1, 2), (-1, -2), (3, -2)))
    after = perceive(frame(scan), Params(believed=Noise(range=0.01)))
    np.testing.assert_array_equal(after.z, extract(scan, 0.01).z)
    assert sorted(after.tags) == [0, 1, 2, 3]
    assert after.tags.dtype == np.int64
    assert perceive(frame(scan), Params(believed=Noise(range=0.02))).z[0, 5] > 1.5 * after.z[0, 5]
    nothing = perceive(frame(scan._replace(ranges=np.full(360, np.inf))), Params())
    assert nothing.z.shape == (0, 11)
    assert nothing.tags.shape == (0,)


def test_the_laser_stands_on_the_robot() -> None:
    rng = np.random.default_rng(8)
    origin = np.array([0.2, -0.1, 2.9])
    for _ in range(20):
        walls, place = room(rng)
        scan = look(rng, walls, np.array([*place, 1.0]), Laser(origin=(0.2, -0.1, 2.9)))
        at_laser = extract(scan._replace(origin=ORIGIN), 0.01).z
        z, label = extract(scan, 0.01)
        np.testing.assert_allclose(z[:, :3], compose(origin, at_laser[:, :3]), atol=1e-12)
        np.testing.assert_array_equal(z[:, 3:10], at_laser[:, 3:10])
        np.testing.assert_allclose(np.sin(z[:, 10] - at_laser[:, 10] - origin[2]), 0.0, atol=1e-12)
        tags = tags_of(Segments(z, label), scan.walls)
        for row in np.flatnonzero(tags != UNKNOWN_TAG):
            lateral, angle = errors(z[row], walls[tags[row]], np.array([*place, 1.0]))
            assert abs(lateral) < 5.0 * math.sqrt(z[row, 5])
            assert abs(angle) < 5.0 * math.sqrt(z[row, 6])


def test_tags_are_those_of_most_beams_and_no_two_alike() -> None:
    label = np.array([0] * 5 + [1] * 7 + [2] * 4 + [3] * 4 + [-1] * 3)
    walls = np.array([9] * 5 + [9] * 6 + [4] + [4, 4, 5, 5] + [UNKNOWN_TAG] * 3 + [6] + [8] * 3)
    segments = Segments(np.zeros((4, 11)), label)
    # 0 and 1 are both of wall 9, and 1 has more beams; of 2 half the beams are of one wall; 3 is of nothing known.
    assert list(tags_of(segments, walls)) == [UNKNOWN_TAG, 9, UNKNOWN_TAG, UNKNOWN_TAG]
    assert list(tags_of(segments, np.where(label == 0, 2**53, walls))) == [2**53, 9, UNKNOWN_TAG, UNKNOWN_TAG]
    assert list(tags_of(segments, None)) == [UNKNOWN_TAG] * 4


def test_what_is_short_or_of_few_beams_is_no_observation() -> None:
    walls = np.vstack([path((2, -0.2), (2, 0.2)), path((6, 2), (6, 4))])
    segments, scan = seen(walls, Laser(361, 360.0))
    assert not of_wall(segments, scan, 0)
    assert len(of_wall(segments, scan, 1)) == 1
    assert len(extract(scan, 0.01, Extraction(shortest=0.2)).z) == 2
    assert len(extract(scan, 0.01, Extraction(fewest=40)).z) == 0


def test_what_is_round_is_not_much_of_a_wall() -> None:
    """A pillar 0.6 m wide gives nothing."""
    bearings = np.radians(np.linspace(-90, 90, 361))
    half, d = 0.3, 2.0
    inside = half**2 - (d * np.sin(bearings)) ** 2
    ranges = np.where(inside > 0, d * np.cos(bearings) - np.sqrt(np.maximum(inside, 0.0)), np.inf)
    noise = np.random.default_rng(9).normal(0, 0.01, 361)
    assert len(extract(Scan(ranges + noise, bearings, ORIGIN, 8.0), 0.01).z) == 0


# Bad input ------------------------------------------------------------------------------------------------------------


def test_scans_of_nothing_show_nothing() -> None:
    """Warnings are errors, so there are none."""
    b = np.radians(np.arange(-90.0, 91.0))
    few = np.full(181, np.inf)
    few[[3, 90, 91]] = 2.0
    nothing = {
        "empty": (np.zeros(0), np.zeros(0)),
        "one beam": (np.ones(1), np.zeros(1)),
        "two beams": (np.ones(2), np.array([0.0, 0.1])),
        "three beams": (np.ones(3), np.array([0.0, 0.1, 0.2])),
        "none returned": (np.full(181, np.inf), b),
        "three returned": (few, b),
        "zeros": (np.zeros(181), b),
        "hardly more": (np.full(181, 1e-300), b),
        "not numbers": (np.full(181, np.nan), b),
        "negative": (np.full(181, -1.0), b),
        "at the maximum": (np.full(181, 8.0), b),
        "one direction": (np.linspace(1, 5, 181), np.zeros(181)),
        "hardly another": (np.linspace(1, 5, 181), np.linspace(0, 1e-15, 181)),
        "one point": (np.full(181, 2.0), np.linspace(0, 1e-9, 181)),
        "no bearings": (np.full(181, 2.0), np.full(181, np.nan)),
        "bearings the wrong way": (np.full(181, 2.0), b[::-1]),
        "noise": (np.random.default_rng(10).uniform(0, 8, 181), b),
    }
    for name, (ranges, bearings) in nothing.items():
        z, label = extract(Scan(ranges, bearings, ORIGIN, 8.0), 0.01)
        assert z.shape == (0, 11), name
        assert np.array_equal(label, np.full(len(ranges), -1)), name


def test_a_wild_scan_gives_finite_walls_or_none() -> None:
    """Anything but NaN: noise of all sizes, a deviation of zero, no maximum, ranges beyond reason."""
    rng = np.random.default_rng(11)
    for _ in range(100):
        beams = int(rng.integers(1, 400))
        bearings = np.sort(rng.uniform(-math.pi, math.pi, beams))
        ranges = rng.uniform(0.5, 3) + 10.0 ** rng.uniform(-9, 1) * rng.normal(size=beams)
        ranges[rng.random(beams) < 0.1] = rng.choice([np.nan, np.inf, 0.0, -1.0, 1e-300, 1e300])
        z, label = extract(Scan(ranges, bearings, ORIGIN, np.inf), float(rng.choice([0.0, 0.01, 10.0])))
        assert np.isfinite(z).all()
        assert np.all(z[:, 5:7] > 0.0)
        assert label.max(initial=-1) == len(z) - 1


def test_the_scan_is_only_read_and_the_same_scan_gives_the_same_bits() -> None:
    walls, place = room(np.random.default_rng(12))
    _, scan = seen(walls, pose=np.array([*place, 0.0]))
    for array in (scan.ranges, scan.bearings, scan.origin):
        array.setflags(write=False)
    one, other = extract(scan, 0.01), extract(scan, 0.01)
    assert one.z.tobytes() == other.z.tobytes()
    assert one.label.tobytes() == other.label.tobytes()


def test_parallel_pieces_share_their_direction() -> None:
    """Both sides of a corridor and a door that is hardly seen; the wall across it, and one that leans, keep theirs."""
    phi = np.array([0.1, 0.1 - math.pi + 0.001, 0.11, 0.1 + 0.5 * math.pi, 0.15])
    deviation = np.array([0.001, 0.002, 0.008, 0.003, 0.001])
    shared = shared_directions(phi, deviation**2)
    weight = 1.0 / (deviation[:3] ** 2 + STRAIGHT[1] ** 2)
    mean = 0.1 + weight @ [0.0, 0.001, 0.01] / weight.sum()
    np.testing.assert_allclose(shared, [mean, mean - math.pi, mean, phi[3], phi[4]], atol=1e-12)
    np.testing.assert_allclose(shared_directions(phi + 3.0, deviation**2), shared + 3.0, atol=1e-12)
    assert shared_directions(np.zeros(0), np.zeros(0)).shape == (0,)
