"""Wall segments: Jacobians against central differences, ends, the longitudinal test, the region of the search."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from slam._jit import inline
from slam.features import Wall, compatible, draw, extend, extent, innovation, inverse, observable, region, spread, total
from slam.features.wall import CORNER, EDGE, HIDDEN, OUT_OF_REACH, ends
from slam.geometry import compose, invert, wrap
from slam.motion import Odometry
from slam.phases import draw_features, initial
from slam.types import NEW, Floats, Frame, ObservationNoise, Params
from tests.slam.test_features import flat

PI = math.pi
WALL = Wall()
MODEL = ((1e-4, 0.0), (0.0, 4e-6))


def piece(x: float, y: float, phi: float, half: float = 1.0, end_a: int = HIDDEN, end_b: int = HIDDEN) -> Floats:
    """An observation that reaches `half` to both sides of its centroid."""
    return np.array([x, y, phi, -half, half, 1e-6, 1e-6, end_a, end_b, 20.0, phi])


def wall(x: float, y: float, phi: float, half: float = 1.0, end_a: float = 0.0, end_b: float = 0.0) -> Floats:
    return np.array([x, y, phi, -half, half, end_a, end_b, 1.0])


def situations() -> Iterator[tuple[Floats, Floats, Floats]]:
    """Poses, walls and pieces of them, at random and where heading, wall or piece point to +-pi."""
    rng = np.random.default_rng(1)
    for heading in (0.0, 1.2, PI - 1e-6, -PI, -PI / 2):
        for angle in (0.0, -0.4, PI - 1e-6, -PI, PI / 2, rng.uniform(-PI, PI)):
            s = np.array([*rng.normal(0, 20, 2), heading])
            theta = wall(*(s[:2] + rng.normal(0, 5, 2)), wrap(heading + angle), rng.uniform(0.3, 8))
            yield s, theta, piece(*rng.normal(0, 5, 2), wrap(angle + rng.normal(0, 0.2)), rng.uniform(0.3, 4))


def difference(a: Floats, b: Floats) -> Floats:
    return np.array([a[0] - b[0], math.remainder(a[1] - b[1], 2 * PI)])


def derivative(f: Callable[[Floats], Floats], x: Floats) -> Floats:
    """Central differences of (lateral, angle)."""
    return np.stack([difference(f(x + h), f(x - h)) / 2e-5 for h in 1e-5 * np.eye(len(x))], axis=1)


def test_innovation_is_the_piece_seen_from_the_wall() -> None:
    """v = -B ((-) x_F (+) s (+) x_E), with the composition of `slam.geometry`; B takes lateral offset and angle."""
    for s, theta, z in situations():
        v, _, _ = innovation(WALL, theta, s, z)
        _, lateral, angle = compose(invert(theta[:3]), compose(s, z[:3]))
        np.testing.assert_allclose(difference(np.array(v), -np.array([lateral, angle])), 0.0, atol=1e-12)
        assert -PI <= v[1] < PI


def test_jacobians_of_the_innovation() -> None:
    for s, theta, z in situations():
        _, G_s, G_theta = innovation(WALL, theta, s, z)
        by_pose = derivative(lambda x, theta=theta, z=z: np.array(innovation(WALL, theta, x, z)[0]), s)
        np.testing.assert_allclose(G_s, -by_pose, atol=1e-7)
        by_wall = derivative(
            lambda d, theta=theta, s=s, z=z: np.array(innovation(WALL, draw(WALL, theta, d), s, z)[0]), np.zeros(2)
        )
        np.testing.assert_allclose(G_theta, -by_wall, atol=1e-7)


def test_jacobians_of_the_new_wall() -> None:
    """Its lateral offset and angle, in the frame in which it is made."""
    for s, _, z in situations():
        made, F_s, F_z = inverse(WALL, s, z)
        theta = np.array(made)

        def offset(made: Floats, theta: Floats = theta) -> Floats:
            return compose(invert(theta[:3]), made[:3])[1:]

        by_pose = derivative(lambda x, z=z, offset=offset: offset(np.array(inverse(WALL, x, z)[0])), s)
        np.testing.assert_allclose(F_s, by_pose, atol=1e-7)

        def sideways(d: Floats, s: Floats = s, z: Floats = z, offset: Callable[[Floats], Floats] = offset) -> Floats:
            moved = z.copy()
            moved[:3] = compose(z[:3], np.array([0.0, d[0], d[1]]))
            return offset(np.array(inverse(WALL, s, moved)[0]))

        np.testing.assert_allclose(F_z, derivative(sideways, np.zeros(2)), atol=1e-7)


def test_the_inverse_is_the_inverse() -> None:
    for s, _, z in situations():
        theta, F_s, F_z = inverse(WALL, s, z)
        v, G_s, G_theta = innovation(WALL, theta, s, z)
        np.testing.assert_allclose(difference(np.array(v), np.zeros(2)), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.array(G_s) + np.array(G_theta) @ np.array(F_s), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.array(G_theta) @ np.array(F_z), -np.eye(2), atol=1e-12)
        np.testing.assert_allclose(theta[3:5], z[3:5])


def test_nothing_is_said_along_a_wall() -> None:
    """A pose that moves along the wall sees the same; so does one whose wall is drawn anew by the filter."""
    for s, theta, z in situations():
        _, G_s, _ = innovation(WALL, theta, s, z)
        along = np.array([math.cos(theta[2]), math.sin(theta[2]), 0.0])
        np.testing.assert_allclose(np.array(G_s) @ along, 0.0, atol=1e-12)


def test_what_cannot_be_observed_gains_no_information() -> None:
    """All pieces of one direction leave the same direction of the pose free, however their walls are turned."""
    for s, theta, z in situations():
        z[10] += 0.01
        for P22, var in ((0.0, 1e-4), (4e-4, 1e-4), (4e-4, 1e-16), (0.0, 0.0)):
            for turned in (0.0, 0.03, -0.1):
                wrong = theta + np.array([0, 0, turned, 0, 0, 0, 0, 0])
                v, G_s, _ = innovation(WALL, wrong, s, z)
                row, turn = observable(WALL, s, np.diag([1.0, 1.0, P22]), z, v, G_s, np.diag([1e-4, var]))
                known = P22 / (P22 + var) if P22 else 0.0
                heading = s[2] + known * math.remainder(wrong[2] - s[2] - z[2], 2 * PI)
                free = np.array([math.cos(heading + z[10]), math.sin(heading + z[10]), 0.0])
                np.testing.assert_allclose(np.array(row) @ free, 0.0, atol=1e-12)
                np.testing.assert_allclose(turn, G_s[1])


def test_it_is_the_jacobian_where_walls_are_where_they_are_seen() -> None:
    """The wall turned to the piece, and the direction of the piece alone."""
    for s, theta, z in situations():
        turned = np.array([*theta[:2], wrap(s[2] + z[2]), *theta[3:]])
        v, G_s, _ = innovation(WALL, turned, s, z)
        for P22 in (0.0, 0.01):
            row, _ = observable(WALL, s, np.diag([1.0, 1.0, P22]), z, v, G_s, np.diag([1e-4, 1e-4]))
            np.testing.assert_allclose(row, G_s[0], atol=1e-9)


def test_a_new_wall_changes_nothing_of_what_is_known() -> None:
    """Drawn and then believed by each particle, the mixture of many is what it was before: the sides of a corridor,
    and a door whose direction is told by the walls beside it."""

    def seen(x: float, y: float, phi: float, axis: float) -> Floats:
        return np.array([x, y, phi, -0.5, 0.5, 5e-6, 9e-6, HIDDEN, HIDDEN, 20.0, axis])

    corridor = [seen(3, 1, 0, 0), seen(3, -1, PI, PI), seen(-3, 1, 0, 0), seen(-3, -1, PI, PI)]
    cases = [((1.0, 0.01, 0.02), corridor), ((1.0, 0.01, 0.05), corridor), ((2.0, 0.02, 0.002), [seen(3, 1, 0.02, 0)])]
    K = 20_000
    for deviations, rows in cases:
        z = np.array(rows)
        before = initial(WALL, np.zeros(3), np.diag(deviations) ** 2, Params(particles=K))
        frame = Frame(0.0, Odometry(), np.zeros((0, 3)), np.zeros(0), WALL, z, np.arange(len(z)))
        noise = ObservationNoise(np.stack([np.diag(row[5:7]) for row in z]), np.diag([2.5e-5, 7.6e-7]))
        after = draw_features(np.random.default_rng(0), before, frame, np.full((K, len(z)), NEW), noise)
        mixture = np.cov(after.s.T) + after.P.mean(axis=0)
        np.testing.assert_allclose(np.sqrt(mixture.diagonal()), deviations, rtol=0.02)  # 1 / sqrt(2 K) is 0.5 %


def test_a_known_heading_or_a_known_wall() -> None:
    """Where the heading is not known at all the wall has the last word; its row is the exact one."""
    for s, theta, z in situations():
        v, G_s, _ = innovation(WALL, theta, s, z)
        row, _ = observable(WALL, s, np.diag([1.0, 1.0, 1e9]), z, v, G_s, np.diag([1e-4, 1e-4]))
        np.testing.assert_allclose(row, G_s[0], atol=1e-6)


def test_the_floor_grows_with_the_distance_along_the_wall() -> None:
    """As a deviation of the wall itself would, up to 20 m."""
    params = Params(floor_lateral=0.01, floor_angle=0.002)
    noise = Wall.of_known(Wall.believed(np.stack([piece(1, 2, 0.3)]), params), params)
    np.testing.assert_allclose(noise.sensor[0], np.diag([1e-6, 1e-6]))
    theta = wall(0.0, 0.0, 0.0, 50.0)
    for t in (0.0, 5.0, -15.0, 40.0):
        _, _, G_theta = innovation(WALL, theta, np.zeros(3), piece(t, 0.0, 0.0))
        lever = min(t, 20.0)
        G = np.array([[1.0, lever], [0.0, 1.0]])
        expected = noise.sensor[0] + G @ np.diag([1e-4, 4e-6]) @ G.T
        np.testing.assert_allclose(total(WALL, noise.sensor[0], G_theta, noise.model), expected, atol=1e-12)


# Which piece may be of which wall -----------------------------------------------------------------------------------

ORIGIN, CERTAIN = np.zeros(3), np.zeros((3, 3))


def test_a_new_wall_is_drawn_with_less_than_a_known_one_is_allowed() -> None:
    z = np.stack([piece(1, 2, 0.3)])
    params = Params(floor_lateral=0.04, floor_angle=0.01, inflate_r=9.0)
    honest = Wall.believed(z, params)
    np.testing.assert_allclose(honest.model, np.diag([0.005**2, math.radians(0.05) ** 2]))
    known = Wall.of_known(honest, params)
    np.testing.assert_allclose(known.sensor, 9.0 * honest.sensor)
    np.testing.assert_allclose(known.model, np.diag([0.12**2, 0.03**2]))
    tight = Wall.believed(z, Params(floor_lateral=0.001, floor_angle=1e-5))
    np.testing.assert_allclose(tight.model, np.diag([1e-6, 1e-10]))


def may_be(theta: Floats, z: Floats, P: Floats = CERTAIN, s: Floats = ORIGIN) -> bool:
    return bool(compatible(WALL, theta, s, P, z))


def test_the_wall_beyond_a_door_is_another_one() -> None:
    """A wall along +x from -1 to 1 m; pieces 2 m long, farther and farther along it."""
    theta = wall(5.0, -2.0, 0.0)
    assert may_be(theta, piece(5.0, -2.0, 0.0))
    for side in (1.0, -1.0):
        assert may_be(theta, piece(5.0 + side * 2.4, -2.0, 0.0))
        assert not may_be(theta, piece(5.0 + side * 2.6, -2.0, 0.0))


def test_beyond_an_end_that_is_known_there_is_no_slack() -> None:
    theta = wall(5.0, -2.0, 0.0, end_a=0.0, end_b=1.0)
    assert not may_be(theta, piece(7.1, -2.0, 0.0))
    assert may_be(theta, piece(6.9, -2.0, 0.0))
    assert may_be(theta, piece(2.6, -2.0, 0.0))


def test_a_pose_that_is_uncertain_along_the_wall_gives_room() -> None:
    """Two deviations of it, but no more than the ends of walls are known to: else doors would not divide walls."""
    theta = wall(5.0, -2.0, 0.0)
    for deviation, room in ((0.05, 0.1), (0.1, 0.2), (0.2, 0.3), (5.0, 0.3)):
        P = np.diag([deviation, 9.0, 0.0]) ** 2  # across does not count
        assert may_be(theta, piece(7.5 + room - 0.01, -2.0, 0.0), P)
        assert not may_be(theta, piece(7.5 + room + 0.01, -2.0, 0.0), P)
    ends = wall(5.0, -2.0, 0.0, 1.0, 1.0, 1.0)
    assert not may_be(ends, piece(8.0, -2.0, 0.0), np.diag([9.0, 9.0, 0.1]) ** 2)


def test_the_two_faces_of_a_thin_wall_are_two() -> None:
    front = wall(5.0, 0.0, PI / 2)
    assert may_be(front, piece(5.0, 0.0, PI / 2))
    assert not may_be(front, piece(5.0, 0.0, -PI / 2))
    assert not may_be(front, piece(5.0, 0.0, PI / 2 + 0.7))


# How far a wall reaches ---------------------------------------------------------------------------------------------


def test_pieces_extend_a_wall() -> None:
    theta = wall(5.0, -2.0, 0.0)
    longer = np.array(extend(WALL, theta, ORIGIN, piece(6.5, -2.01, 0.001, 1.0)))
    np.testing.assert_allclose(longer[:3], theta[:3], atol=0)
    np.testing.assert_allclose(longer[3:5], [-1.0, 2.5], atol=1e-5)
    assert longer[7] == 2.0
    shorter = np.array(extend(WALL, longer, ORIGIN, piece(5.0, -2.0, 0.0, 0.2)))
    np.testing.assert_allclose(shorter[3:5], longer[3:5])


@pytest.mark.parametrize("s", [(1.0, 2.0, 3.0), (-4.0, 0.5, -PI)])
def test_pieces_extend_a_wall_wherever_the_robot_stands(s: tuple[float, float, float]) -> None:
    world = np.array([5.0, -2.0, 0.7])
    theta = wall(*world)
    seen = compose(invert(np.array(s)), compose(world, np.array([-1.5, 0.0, 0.0])))
    longer = extend(WALL, theta, np.array(s), piece(*seen))
    np.testing.assert_allclose(longer[3:5], [-2.5, 1.0], atol=1e-12)


@pytest.mark.parametrize("kind", [EDGE, CORNER])
def test_an_end_that_was_seen_bounds_the_wall(kind: int) -> None:
    theta = np.array(extend(WALL, wall(5.0, -2.0, 0.0), ORIGIN, piece(6.0, -2.0, 0.0, end_b=kind)))
    np.testing.assert_allclose(theta[3:7], [-1.0, 2.0, 0.0, 1.0])
    beyond = np.array(extend(WALL, theta, ORIGIN, piece(7.5, -2.0, 0.0)))
    np.testing.assert_allclose(beyond[3:7], [-1.0, 2.0, 0.0, 1.0])
    before = np.array(extend(WALL, theta, ORIGIN, piece(3.5, -2.0, 0.0, end_a=kind)))
    np.testing.assert_allclose(before[3:7], [-2.5, 2.0, 1.0, 1.0])


@pytest.mark.parametrize("kind", [HIDDEN, OUT_OF_REACH])
def test_an_end_of_the_view_is_no_end_of_the_wall(kind: int) -> None:
    theta = np.array(extend(WALL, wall(5.0, -2.0, 0.0), ORIGIN, piece(6.0, -2.0, 0.0, end_a=kind, end_b=kind)))
    np.testing.assert_allclose(theta[3:7], [-1.0, 2.0, 0.0, 0.0])
    made, _, _ = inverse(WALL, ORIGIN, piece(6.0, -2.0, 0.0, end_a=kind, end_b=EDGE))
    assert made[5:7] == (0.0, 1.0)


def test_an_edge_in_the_middle_of_a_wall_is_not_its_end() -> None:
    """The wall is known 3 m farther: what ends here is a gap that pieces were joined across."""
    theta = np.array(extend(WALL, wall(5.0, -2.0, 0.0, 4.0), ORIGIN, piece(5.0, -2.0, 0.0, end_b=EDGE)))
    np.testing.assert_allclose(theta[3:7], [-4.0, 4.0, 0.0, 0.0])


def test_ends_and_extent_are_in_the_world() -> None:
    theta = np.stack([wall(5.0, -2.0, 0.7, 2.0), wall(1.0, 1.0, -PI, 1.0)])
    for row, (a, b) in zip(theta, ends(theta), strict=True):
        np.testing.assert_allclose(a, compose(row[:3], np.array([row[3], 0.0, 0.0]))[:2])
        np.testing.assert_allclose(b, compose(row[:3], np.array([row[4], 0.0, 0.0]))[:2])
        box = np.array(extent(WALL, row))
        np.testing.assert_allclose(box, [*np.minimum(a, b), *np.maximum(a, b)])


# The search ---------------------------------------------------------------------------------------------------------


def test_nothing_outside_the_region_is_within_reach() -> None:
    """Walls that are compatible and at most `reach` away (25), found by trying, touch the box, as Sigma allows."""
    rng = np.random.default_rng(4)
    within, near_the_edge = 0, 0
    for s, _, z in [triple for _ in range(20) for triple in situations()]:
        root = rng.normal(size=(3, 3)) * (10.0 ** rng.uniform(-3, [0.5, 0.5, -0.5]))[:, None]
        P = root @ root.T * rng.choice([0.0, 1.0])
        Sigma = np.diag(10.0 ** rng.uniform(-3, [0.0, -1.0])) ** 2 * rng.choice([0.0, 1.0])
        R, reach = np.diag(10.0 ** rng.uniform([-3.0, -3.0], [-0.5, -1.0])) ** 2, rng.uniform(1.0, 5.3)
        model = np.diag(10.0 ** rng.uniform(-3.5, [-1.5, -2.0])) ** 2
        box, beyond = region(WALL, s, P, z, R, model, reach)
        made = np.array(inverse(WALL, s, z)[0])
        scale = 10.0 ** rng.uniform(-2, 1.3)
        for _ in range(60):
            theta = made.copy()
            along, aside, turned = rng.normal(size=3) * [3 * scale, scale, 0.3]
            theta[:3] = compose(made[:3], np.array([along, aside, turned]))
            theta[3:5] = np.sort(rng.normal(0, 3 * scale, 2))
            theta[5:7] = rng.integers(0, 2, 2)
            if not compatible(WALL, theta, s, P, z):
                continue
            v, G_s, G_theta = (np.array(a) for a in innovation(WALL, theta, s, z))
            V = G_s @ P @ G_s.T + G_theta @ Sigma @ G_theta.T + np.array(total(WALL, R, G_theta, model))
            if v @ np.linalg.solve(V, v) > reach**2:
                continue
            slack = beyond * spread(WALL, theta, Sigma) + 1e-9
            x0, y0, x1, y1 = extent(WALL, theta)
            assert x0 <= box[2] + slack
            assert x1 >= box[0] - slack
            assert y0 <= box[3] + slack
            assert y1 >= box[1] - slack
            within += 1
            if not Sigma.any():
                size = np.array(box[2:]) - box[:2]
                near_the_edge += (np.abs(np.array([x1, y1]) - box[:2]) < 0.3 * size).any()
    assert within > 2000
    assert near_the_edge > 5  # it is no box around everything


def test_the_region_of_a_certain_pose_is_small() -> None:
    """5 mm, 0.1 degrees and a piece of 2 m: little more than the slack around it."""
    R = np.diag([0.005, math.radians(0.1)]) ** 2
    box, _ = region(WALL, np.array([100.0, -50.0, 2.0]), CERTAIN, piece(3.0, 1.0, 0.4), R, np.zeros((2, 2)), 3.0)
    assert max(box[2] - box[0], box[3] - box[1]) < 2.0 + 2 * 0.5 + 0.1


def test_compiled_code_is_the_same_code() -> None:
    compiled = inline(
        lambda feature, theta, s, z, P, R, Sigma, delta: (
            innovation(feature, theta, s, z),
            inverse(feature, s, z),
            draw(feature, theta, delta),
            extend(feature, theta, s, z),
            extent(feature, theta),
            1.0 if compatible(feature, theta, s, P, z) else 0.0,
            spread(feature, theta, Sigma),
            region(feature, s, P, z, R, MODEL, 3.0),
        )
    )
    plain = compiled.py_func
    P, R, Sigma = np.diag([0.3, 0.2, 0.1]) ** 2, np.diag([0.1, 0.01]) ** 2, np.diag([0.05, 0.02]) ** 2
    for s, theta, z in situations():
        delta = np.array([0.1, 0.02])
        arguments = (WALL, theta, s, z, P, R, Sigma, delta)
        for a, b in zip(flat(compiled(*arguments)), flat(plain(*arguments)), strict=True):
            assert a == pytest.approx(b, rel=1e-12, abs=1e-12) or abs(wrap(a - b)) < 1e-12
