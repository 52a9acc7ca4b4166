"""What maps of points and of walls are worth, against tables made by hand and plain second implementations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from slam.features import Point, Wall, draw, inverse
from slam.features.wall import ends
from slam.geometry import compose, invert
from slam.scores import association_score, points, scores_of, walls
from slam.types import IGNORED, NEW, UNKNOWN_TAG, Floats

PI = math.pi
WALL = Wall()
ORIGIN = np.zeros(3)


def test_each_kind_has_its_own() -> None:
    assert scores_of(Point()) is points
    assert scores_of(Wall(slack=1.0)) is walls


# --- Points -------------------------------------------------------------------------------------------------

TRUE_TAGS = np.array([30, 10, 20])
TRUE_THETA = np.array([[3.0, 3.0], [1.0, 1.0], [2.0, 5.0]])


def test_map_error_by_hand() -> None:
    theta = np.array([[1.0, 1.3], [2.4, 5.0], [100.0, 100.0], [0.0, 0.0]])
    tags = np.array([10, 20, UNKNOWN_TAG, 99])
    aligned, plain = points.map_errors(theta, tags, TRUE_TAGS, TRUE_THETA)
    assert plain == pytest.approx(math.sqrt((0.3**2 + 0.4**2) / 2))
    assert aligned < plain
    # Two points of the right distance can always be laid upon each other; one needs only a shift.
    turned = np.array([[0.0, 0.0], [0.0, math.hypot(1.0, 4.0)]])
    assert points.map_errors(turned, np.array([10, 20]), TRUE_TAGS, TRUE_THETA)[0] < 1e-12
    assert points.map_errors(turned[:1] + 8.0, np.array([30]), TRUE_TAGS, TRUE_THETA)[0] < 1e-12


def test_map_error_of_a_moved_map_with_duplicates() -> None:
    c, s = math.cos(2.5), math.sin(2.5)
    which = np.array([0, 1, 2, 1])
    theta = TRUE_THETA[which] @ np.array([[c, s], [-s, c]]) + [5.0, -9.0]
    aligned, plain = points.map_errors(theta, TRUE_TAGS[which], TRUE_TAGS, TRUE_THETA)
    assert aligned < 1e-12
    assert plain > 5.0


@pytest.mark.parametrize("scores", [points, walls])
def test_map_error_without_anything_to_compare(scores) -> None:
    theta, true_theta = (TRUE_THETA,) * 2 if scores is points else (np.ones((3, 8)), np.eye(4)[:3])
    none, unknown = np.empty(0, np.int64), np.full(3, UNKNOWN_TAG)
    for tags, true_tags in ((none, TRUE_TAGS), (unknown, TRUE_TAGS), (TRUE_TAGS, none), (TRUE_TAGS + 70, TRUE_TAGS)):
        errors = scores.map_errors(theta[: len(tags)], tags, true_tags, true_theta[: len(true_tags)])
        np.testing.assert_equal(errors, (math.nan, math.nan))
    # A true map may itself hold things that nobody can tell: they match nothing.
    np.testing.assert_equal(scores.map_errors(theta, unknown, unknown, true_theta), (math.nan, math.nan))


@pytest.mark.parametrize(
    ("tags", "count"),
    [([], 0.0), ([4, 5, 6], 0.0), ([4, 4, 5, 4, 5], 3.0), ([4, 4, -1, -1], 1.0), ([-1, -1], math.nan)],
)
@pytest.mark.parametrize("scores", [points, walls])
def test_duplicates(scores, tags: list[int], count: float) -> None:
    """Of walls these are all in one place."""
    theta = np.tile([2.0, 1.0, 0.3, -1.0, 1.0, 0.0, 0.0, 1.0], (len(tags), 1))
    np.testing.assert_equal(scores.duplicates(theta, np.array(tags, np.int64)), count)


@pytest.mark.parametrize(
    ("n", "tag", "score"),
    [
        (0, 10, (1, 0, 0)),  # paired with a feature of the same thing
        (2, 10, (1, 0, 0)),  # ... with the duplicate of it
        (1, 10, (0, 1, 0)),  # paired with another thing's
        (0, 77, (0, 1, 0)),  # paired although the map does not hold it
        (NEW, 77, (1, 0, 0)),  # new, and it is
        (NEW, 20, (0, 0, 1)),  # new, but the map holds it
        (IGNORED, 20, (0, 0, 1)),  # ignored, and the map holds it
        (IGNORED, 77, (0, 0, 1)),  # ignored, and it is new
        (3, 10, (0, 0, 0)),  # paired with a feature that nobody can name
        (0, UNKNOWN_TAG, (0, 0, 0)),  # nobody can say
        (3, UNKNOWN_TAG, (0, 0, 0)),
        (NEW, UNKNOWN_TAG, (0, 0, 0)),
        (IGNORED, UNKNOWN_TAG, (0, 0, 0)),
    ],
)
def test_association_score_by_hand(n: int, tag: int, score: tuple[int, int, int]) -> None:
    map_tags = np.array([10, 20, 10, UNKNOWN_TAG])

    def scored(n: list[int], tags: list[int]) -> tuple[int, int, int]:
        z = np.zeros((len(tags), 2))
        held = points.held(Point(), np.zeros((4, 2)), map_tags, ORIGIN, z, np.array(tags))
        return association_score(np.array(n), np.array(tags), map_tags, held)

    assert scored([n], [tag]) == score
    # Of several observations each is scored by itself.
    assert scored([n, 1], [tag, 20]) == (score[0] + 1, score[1], score[2])


def test_association_score_of_nothing() -> None:
    none, nothing = np.empty(0, np.int64), np.empty(0, np.bool_)
    assert association_score(none, none, np.array([1, 2]), nothing) == (0, 0, 0)
    assert association_score(np.array([NEW, NEW]), np.array([5, 5]), none, np.zeros(2, np.bool_)) == (2, 0, 0)


@pytest.mark.parametrize(("n", "score"), [(NEW, (1, 0, 0)), (IGNORED, (0, 0, 1)), (0, (1, 0, 0))])
def test_of_a_thing_that_the_map_holds_elsewhere(n: int, score: tuple[int, int, int]) -> None:
    """Another part of a wall of tag 10: rightly new, and rightly paired with the part that the map has."""
    assert association_score(np.array([n]), np.array([10]), np.array([10]), np.array([False])) == score


# --- Walls --------------------------------------------------------------------------------------------------


def wall(x: float, y: float, phi: float, a: float = -1.0, b: float = 1.0) -> Floats:
    return np.array([x, y, phi, a, b, 0.0, 0.0, 1.0])


def crooked_room(rng: np.random.Generator, count: int) -> tuple[Floats, Floats, Floats]:
    """Features (count, 8) that lie on the four walls (4, 4) of a room, some 8 by 6 m and askew, and their tags."""
    corners = np.array([[0.0, 0.0], [8.0, 1.5], [7.0, 7.0], [-1.0, 5.0]])
    true = np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1)
    tags = rng.integers(0, 4, count)
    along = true[tags, 2:] - true[tags, :2]
    middle = true[tags, :2] + rng.uniform(0.2, 0.8, (count, 1)) * along
    half = rng.uniform(0.2, 2.0, count)
    theta = np.stack(
        [wall(x, y, math.atan2(dy, dx), -h, h) for (x, y), (dx, dy), h in zip(middle, along, half, strict=True)]
    )
    return theta, tags, true


def test_error_of_a_wall_by_hand() -> None:
    """A wall of 2 m, its origin 0.3 m beside the line of the true one, and turned: one end 0.1 m off, the other 0.5."""
    true = np.array([[0.0, 0.0, 0.0, 9.0], [5.0, 5.0, 6.0, 5.0]])
    theta = np.stack([wall(0.3, 40.0, PI / 2 + math.asin(0.2)), wall(70.0, 70.0, 0.0)])
    aligned, plain = walls.map_errors(theta, np.array([10, 99]), np.array([10, 20]), true)
    assert plain == pytest.approx(math.sqrt((0.1**2 + 0.5**2) / 2))
    assert aligned < 1e-12


def test_error_of_walls_against_a_second_implementation() -> None:
    rng = np.random.default_rng(6)
    for noise in (0.01, 0.5):
        theta, tags, true = crooked_room(rng, 12)
        motion = np.array([3.0, -1.0, 0.4])
        theta[:, :3] = compose(motion, theta[:, :3])
        theta = np.array([draw(WALL, row, noise * rng.normal(size=2)) for row in theta])

        def offsets(pose: Floats, theta: Floats = theta, tags: Floats = tags, true: Floats = true) -> Floats:
            """Of every end of every feature, moved by `pose`, from the line of the true wall."""
            found = []
            for row, tag in zip(theta, tags, strict=True):
                start, end = true[tag, :2], true[tag, 2:]
                line = np.append(start, math.atan2(*(end - start)[::-1]))
                for t in row[3:5]:
                    place = compose(pose, compose(row[:3], np.array([t, 0.0, 0.0])))
                    found.append(compose(invert(line), place)[1])
            return np.array(found)

        aligned, plain = walls.map_errors(theta, tags, np.arange(4), true)
        assert plain == pytest.approx(math.sqrt(np.mean(offsets(ORIGIN) ** 2)))
        least = minimize(lambda pose, f=offsets: np.sum(f(pose) ** 2), invert(motion)).fun
        assert aligned == pytest.approx(math.sqrt(least / (2 * len(theta))), rel=1e-6)


@pytest.mark.parametrize("angle", [0.3, PI / 2, PI, -2.0])
def test_a_map_of_walls_that_only_lies_elsewhere_has_no_error(angle: float) -> None:
    """Even upside down: walls know their direction."""
    theta, tags, true = crooked_room(np.random.default_rng(4), 9)
    theta[:, :3] = compose(np.array([30.0, 5.0, angle]), theta[:, :3])
    aligned, plain = walls.map_errors(theta, tags, np.arange(4), true)
    assert aligned < 1e-9
    assert plain > 1.0


def test_a_corridor_that_lies_upside_down_has_no_error() -> None:
    """Nor has one that lies as it should be: walls know their direction, and so on which side of it they are."""
    true = np.array([[0.0, -1.0, 90.0, -1.0], [90.0, 1.0, 0.0, 1.0]])
    for angle in (0.0, 0.5, PI):
        theta = np.stack([wall(20.0, -1.0, 0.0, -20.0, 70.0), wall(70.0, 1.0, -PI, -20.0, 70.0)])
        theta[:, :3] = compose(np.array([3.0, 4.0, angle]), theta[:, :3])
        assert walls.map_errors(theta, np.array([0, 1]), np.arange(2), true)[0] < 1e-9


def test_a_shift_along_a_straight_corridor_is_no_error() -> None:
    """Nothing says how far along it a map lies, and nothing is divided by."""
    true = np.array([[0.0, -1.0, 90.0, -1.0], [90.0, 1.0, 0.0, 1.0]])
    theta = np.stack([wall(20.0, -0.9, 0.0), wall(20.0, 1.1, -PI), wall(40.0, -0.9, 0.0, -5.0, 9.0)])
    aligned, plain = walls.map_errors(theta, np.array([0, 1, 0]), np.arange(2), true)
    assert plain == pytest.approx(0.1)
    assert aligned < 1e-9
    narrow = theta + np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]) * np.array([[1.0], [0.0], [1.0]])
    aligned, _ = walls.map_errors(narrow, np.array([0, 1, 0]), np.arange(2), true)
    assert 0.02 < aligned <= math.sqrt(0.02 * 8 / 9)  # 0.2 m too narrow: four ends of six, against two


@pytest.mark.parametrize(
    ("second", "count"),
    [
        (wall(0.0, 0.0, 0.0), 1.0),  # the same again
        (wall(0.2, 0.6, 0.1), 1.0),  # from a pose that was off
        (wall(0.0, 0.0, PI), 1.0),
        (wall(0.9, 0.0, 0.0), 1.0),  # 1.1 of 2 m
        (wall(1.1, 0.0, 0.0), 0.0),
        (wall(-1.1, 0.0, 0.0), 0.0),
        (wall(2.0, 0.0, 0.0, -1.5, 1.5), 0.0),  # it continues
        (wall(4.0, 0.0, 0.0), 0.0),  # another piece of it
        (wall(0.0, 0.0, 0.0, -5.0, 5.0), 1.0),  # far more of it, and all that was there already
        (wall(6.1, 0.0, 0.0, -6.0, 6.0), 0.0),  # .9 of its 2 m
        (wall(5.9, 0.0, 0.0, -6.0, 6.0), 1.0),
        (wall(0.0, 0.0, 0.0, 0.0, 0.0), 1.0),  # no length at all
        (wall(4.0, 0.0, 0.0, 0.0, 0.0), 0.0),
    ],
)
def test_which_part_of_a_wall_is_a_duplicate(second: Floats, count: float) -> None:
    """Beside a wall from -1 to 1 m: in whatever frame, and not if it is another wall."""
    for frame in (ORIGIN, np.array([30.0, -20.0, 2.0])):
        theta = np.stack([wall(0.0, 0.0, 0.0), second])
        theta[:, :3] = compose(frame, theta[:, :3])
        assert walls.duplicates(theta, np.array([5, 5])) == count
        assert walls.duplicates(theta[::-1].copy(), np.array([5, 5])) == count  # whichever was there first
        assert walls.duplicates(theta, np.array([5, 6])) == 0.0


def test_duplicates_are_counted_once_and_covered_by_all() -> None:
    piece = wall(0.0, 0.0, 0.0)
    assert walls.duplicates(np.stack([piece] * 4), np.array([5, 5, 5, 5])) == 3.0
    # A piece between two longer ones, of which it has .9 m of 2 m each.
    between = np.stack([wall(-4.1, 0.0, 0.0, -4.0, 4.0), wall(4.1, 0.0, 0.0, -4.0, 4.0), piece])
    for order in ([0, 1, 2], [1, 0, 2]):
        assert walls.duplicates(between[order], np.array([5, 5, 5])) == 1.0
    assert walls.duplicates(between, np.array([5, 6, 5])) == 0.0
    # Two that show the same .9 m of it are no more than one.
    twice = np.stack([wall(-4.1, 0.0, 0.0, -4.0, 4.0), wall(-3.1, 0.0, 0.0, -3.0, 3.0), piece])
    assert walls.duplicates(twice, np.array([5, 5, 5])) == 1.0  # the second of them


def test_duplicates_against_a_second_implementation() -> None:
    rng = np.random.default_rng(3)
    for _ in range(30):
        theta = np.stack(
            [wall(*rng.normal(0, 2, 2), rng.normal(0, 0.3), *np.sort(rng.normal(0, 2, 2))) for _ in range(40)]
        )
        tags = rng.integers(-1, 8, 40)
        count = 0
        for j in range(40):
            a, b = theta[j, 3:5]
            fine = np.linspace(a, b, 20001)
            near, covered = False, np.zeros(len(fine), np.bool_)
            for i in range(j):
                if tags[i] == tags[j] != UNKNOWN_TAG:
                    t = [compose(invert(theta[j, :3]), np.append(end, 0.0))[0] for end in ends(theta[i : i + 1])[0]]
                    common = min(max(t), b) - max(min(t), a)
                    near |= common >= 0.5 * min(b - a, theta[i, 4] - theta[i, 3])
                    covered |= (fine >= min(t)) & (fine <= max(t))
            count += near or covered.mean() >= 0.5
        assert walls.duplicates(theta, tags) == count


def test_what_the_map_holds_of_a_wall() -> None:
    """A wall from 2 to 8 m beside a robot anywhere; pieces farther and farther along it."""
    feature = Wall(slack=0.5)
    for s in (ORIGIN, np.array([10.0, 4.0, 3.0])):
        theta = np.stack([wall(90.0, 0.0, 0.0), wall(5.0, -1.0, 0.0, -3.0, 3.0)])
        theta[:, :3] = compose(s, theta[:, :3])
        map_tags = np.array([6, 5])
        middles = np.array([5.0, 7.0, 9.4, 9.6, 0.6, 0.4, -40.0])
        z = np.stack([np.array([x, -0.8, 0.05, -1.0, 1.0, 1e-6, 1e-6, 0, 0, 20]) for x in middles])
        held = walls.held(feature, theta, map_tags, s, z, np.full(len(z), 5))
        np.testing.assert_array_equal(held, [True, True, True, False, True, False, False])
        for other in (4, 6, UNKNOWN_TAG):
            assert not walls.held(feature, theta, map_tags, s, z, np.full(len(z), other)).any()
        nothing = walls.held(feature, theta[:0], map_tags[:0], s, z, np.full(len(z), 5))
        np.testing.assert_array_equal(nothing, np.zeros(len(z), np.bool_))
        assert walls.held(feature, theta, map_tags, s, z[:0], np.empty(0, np.int64)).shape == (0,)


def test_the_map_holds_a_wall_that_it_has_far_to_the_side() -> None:
    """Who is lost, and makes a second one of it, has missed it."""
    theta, z = wall(5.0, -7.0, 0.0, -3.0, 3.0), np.array([5.0, -1.0, 0.0, -1.0, 1.0, 1e-6, 1e-6, 0, 0, 20])
    assert walls.held(WALL, theta[None], np.array([3]), ORIGIN, z[None], np.array([3])).all()


def test_the_map_holds_what_it_just_made() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        s = np.array([*rng.normal(0, 20, 2), rng.uniform(-PI, PI)])
        z = np.array([*rng.normal(0, 5, 2), rng.uniform(-PI, PI), -1.0, 1.0, 1e-6, 1e-6, 0, 0, 20])
        theta = np.array(inverse(WALL, s, z)[0])
        assert walls.held(WALL, theta[None], np.array([3]), s, z[None], np.array([3])).all()
