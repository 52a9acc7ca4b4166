"""Range-bearing points: Jacobians against central differences, and the inverse observation against the observation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from slam._jit import inline
from slam.features import Point, draw, extent, innovation, inverse, region
from slam.geometry import wrap
from slam.types import Floats

PI = math.pi
POINT = Point()
NO_MODEL = ((0.0, 0.0), (0.0, 0.0))


def situations() -> Iterator[tuple[Floats, Floats]]:
    """Poses s and observations z, at random and where heading, bearing or their sum is at +-pi."""
    rng = np.random.default_rng(1)
    for heading in (0.0, 1.2, PI - 1e-6, -PI, -PI / 2):
        for bearing in (0.0, -0.4, PI - 1e-6, -PI, PI / 2, rng.uniform(-PI, PI)):
            yield np.array([*rng.normal(0, 20, 2), heading]), np.array([rng.uniform(0.2, 40.0), bearing])


def bearing_difference(a: Floats, b: Floats) -> Floats:
    return np.array([a[0] - b[0], math.remainder(a[1] - b[1], 2 * PI)])


def jacobian(f: Callable[[Floats], Floats], x: Floats, difference: Callable[[Floats, Floats], Floats]) -> Floats:
    """Central differences."""
    steps = 1e-5 * np.eye(len(x))
    return np.stack([difference(f(x + h), f(x - h)) / 2e-5 for h in steps], axis=1)


def expected_observation(s: Floats, theta: Floats) -> Floats:
    """g, written once more: the landmark in the robot's frame, as range and bearing."""
    c, q = math.cos(s[2]), math.sin(s[2])
    dx, dy = theta - s[:2]
    ahead, left = c * dx + q * dy, -q * dx + c * dy
    return np.array([math.hypot(ahead, left), math.atan2(left, ahead)])


def test_innovation_is_what_was_seen_less_what_was_expected() -> None:
    rng = np.random.default_rng(2)
    for s, z in situations():
        theta = s[:2] + rng.normal(0, 10, 2)
        v, _, _ = innovation(POINT, theta, s, z)
        assert -PI <= v[1] < PI
        np.testing.assert_allclose(bearing_difference(np.array(v), z - expected_observation(s, theta)), 0, atol=1e-12)


def test_jacobians_of_the_observation() -> None:
    """G is of g, and v = z - g: so it is minus the derivative of v."""
    rng = np.random.default_rng(3)
    for s, z in situations():
        theta = s[:2] + rng.normal(0, 10, 2)
        _, G_s, G_theta = innovation(POINT, theta, s, z)

        def v(theta: Floats, s: Floats, z: Floats = z) -> Floats:
            return np.array(innovation(POINT, theta, s, z)[0])

        tolerance = 1e-7 * max(1.0, 1.0 / np.sum((theta - s[:2]) ** 2))
        numeric = -jacobian(lambda x, theta=theta, v=v: v(theta, x), s, bearing_difference)
        np.testing.assert_allclose(G_s, numeric, atol=tolerance)
        numeric = -jacobian(lambda x, s=s, v=v: v(x, s), theta, bearing_difference)
        np.testing.assert_allclose(G_theta, numeric, atol=tolerance)


def test_jacobians_of_the_inverse_observation() -> None:
    for s, z in situations():
        _, F_s, F_z = inverse(POINT, s, z)
        numeric = jacobian(lambda x, z=z: np.array(inverse(POINT, x, z)[0]), s, np.subtract)
        np.testing.assert_allclose(F_s, numeric, atol=1e-7)
        numeric = jacobian(lambda x, s=s: np.array(inverse(POINT, s, x)[0]), z, np.subtract)
        np.testing.assert_allclose(F_z, numeric, atol=1e-7)


def test_the_inverse_is_the_inverse() -> None:
    """v = 0 at the feature that z creates; and by the chain rule G_s + G_theta F_s = 0, G_theta F_z = I there."""
    for s, z in situations():
        theta, F_s, F_z = inverse(POINT, s, z)
        v, G_s, G_theta = innovation(POINT, theta, s, z)
        # at -pi the two ends of the circle are one bearing
        np.testing.assert_allclose(bearing_difference(np.array(v), np.zeros(2)), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.array(G_s) + np.array(G_theta) @ np.array(F_s), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.array(G_theta) @ np.array(F_z), np.eye(2), atol=1e-12)


def test_drawn_features_move_in_their_uncertain_coordinates() -> None:
    """`draw` and the columns of G_theta speak of the same two coordinates."""
    s, z, theta, delta = np.array([1.0, 2.0, 3.0]), np.array([5.0, 0.3]), np.array([4.0, -1.0]), np.array([1e-6, -2e-6])
    v, _, G_theta = innovation(POINT, theta, s, z)
    v_moved, _, _ = innovation(POINT, draw(POINT, theta, delta), s, z)
    np.testing.assert_allclose(np.subtract(v, v_moved), np.array(G_theta) @ delta, atol=1e-11)
    assert draw(POINT, theta, delta) == (4.0 + 1e-6, -1.0 - 2e-6)
    assert extent(POINT, theta) == (4.0, -1.0, 4.0, -1.0)


def covariances(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """P, Sigma and R from fine to so coarse that the linearisation means nothing."""
    root = rng.normal(size=(3, 3)) * (10.0 ** rng.uniform(-3, [0.7, 0.7, 0.0]))[:, None]
    P = root @ root.T * rng.choice([0.0, 1.0])
    root = rng.normal(size=(2, 2)) * 10.0 ** rng.uniform(-3, 0.7)
    R = np.diag(10.0 ** rng.uniform([-3.5, -5.0], [0.0, -0.7])) ** 2
    return P, root @ root.T * rng.choice([0.0, 1.0]), R


def test_nothing_outside_the_region_is_within_reach() -> None:
    """Points where the distance (25) is at most reach^2, found by trying, are in the box, or near it as Sigma allows.

    A box from the linearised inverse observation fails here even with twice the reach: the arc of a heading error is
    not its tangent.
    """
    rng = np.random.default_rng(4)
    near_the_edge, linearised_fails = 0, 0
    for s, z in [pair for _ in range(20) for pair in situations()]:
        P, Sigma, R = covariances(rng)
        reach = rng.uniform(1.0, 5.3)
        box, beyond = region(POINT, s, P, z, R, NO_MODEL, reach)
        # around the robot at all ranges and bearings, half of them close to what was seen
        count = 400
        width = np.where(rng.random(count) < 0.5, 1.0, 10.0 ** rng.uniform(-4, 0, count))
        r = np.abs(z[0] + rng.normal(0, 20, count) * width)
        bearing = s[2] + z[1] + rng.uniform(-PI, PI, count) * width
        theta = s[:2] + r[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
        d = theta - s[:2]
        d2 = np.sum(d**2, axis=1)
        G_theta = np.stack([d / np.sqrt(d2)[:, None], np.column_stack([-d[:, 1], d[:, 0]]) / d2[:, None]], axis=1)
        G_s = np.concatenate([-G_theta, np.broadcast_to([[0.0], [-1.0]], (count, 2, 1))], axis=2)
        V = G_s @ P @ G_s.swapaxes(1, 2) + G_theta @ Sigma @ G_theta.swapaxes(1, 2) + R
        turn = z[1] - np.arctan2(d[:, 1], d[:, 0]) + s[2]
        v = np.column_stack([z[0] - np.sqrt(d2), np.arctan2(np.sin(turn), np.cos(turn))])
        distance = np.sum(v * np.linalg.solve(V, v[..., None])[..., 0], axis=1)
        inside = theta[distance <= reach**2]
        slack = beyond * math.sqrt(np.linalg.eigvalsh(Sigma)[-1]) + 1e-9
        assert (inside >= np.array(box[:2]) - slack).all()
        assert (inside <= np.array(box[2:]) + slack).all()
        if len(inside) and not Sigma.any():
            size = np.array(box[2:]) - box[:2]
            near_the_edge += ((inside - box[:2] < 0.2 * size) | (np.array(box[2:]) - inside < 0.2 * size)).any()
            created, F_s, F_z = (np.array(a) for a in inverse(POINT, s, z))
            half = 2 * reach * np.sqrt((F_s @ P @ F_s.T + F_z @ R @ F_z.T).diagonal())
            linearised_fails += (np.abs(inside - created) > half + 1e-9).any()
    assert near_the_edge > 50  # it is no box around everything
    assert linearised_fails > 10


def test_the_region_of_a_good_sensor_is_small() -> None:
    """A certain pose, 3 mm and 0.003 degrees at 20 m: centimetres, in whatever direction."""
    R = np.diag([0.003, math.radians(0.003)]) ** 2
    for heading in np.linspace(-PI, PI, 17):
        s, z = np.array([100.0, -50.0, heading]), np.array([20.0, 0.4])
        box, beyond = region(POINT, s, np.zeros((3, 3)), z, R, NO_MODEL, 3.0)
        (x, y), _, _ = inverse(POINT, s, z)
        assert box[0] <= x <= box[2]
        assert box[1] <= y <= box[3]
        assert max(box[2] - box[0], box[3] - box[1]) < 0.02
        assert 3.0 <= beyond < 7.0


def test_a_feature_at_the_robot_may_be_seen_in_any_direction() -> None:
    s, z = np.array([1.0, 2.0, 0.5]), np.array([0.5, 0.1])
    box, _ = region(POINT, s, np.diag([0.3, 0.3, 0.01]) ** 2, z, np.diag([0.1, 0.01]) ** 2, NO_MODEL, 3.0)
    for direction in np.linspace(-PI, PI, 9):
        x, y = 1.0 + 0.6 * math.cos(direction), 2.0 + 0.6 * math.sin(direction)
        assert box[0] < x < box[2]
        assert box[1] < y < box[3]


@pytest.mark.parametrize("s", [(1.0, -2.0, 0.3), (1.0, -2.0, PI - 1e-9), (0.0, 0.0, -PI)])
def test_compiled_code_is_the_same_code(s: tuple[float, float, float]) -> None:
    compiled = inline(
        lambda feature, theta, s, z, P, R, delta: (
            innovation(feature, theta, s, z),
            inverse(feature, s, z),
            draw(feature, theta, delta),
            extent(feature, theta),
            region(feature, s, P, z, R, NO_MODEL, 3.0),
        )
    )
    rng = np.random.default_rng(5)
    for _ in range(20):
        theta, delta, z = (
            rng.normal(0, 10, 2),
            rng.normal(size=2),
            np.array([rng.uniform(0.1, 30), rng.uniform(-PI, PI)]),
        )
        P, _, R = covariances(rng)
        found = compiled(POINT, theta, np.array(s), z, P, R, delta)
        expected = (
            innovation(POINT, theta, s, z),
            inverse(POINT, s, z),
            draw(POINT, theta, delta),
            extent(POINT, theta),
            region(POINT, s, P, z, R, NO_MODEL, 3.0),
        )
        for a, b in zip(flat(found), flat(expected), strict=True):
            assert a == pytest.approx(b, rel=1e-12, abs=1e-12) or abs(wrap(a - b)) < 1e-12


def flat(value: object) -> Iterator[float]:
    """The numbers in nested tuples."""
    if isinstance(value, tuple):
        for part in value:
            yield from flat(part)
    else:
        yield float(value)  # type: ignore[arg-type]
