"""Motion models: Jacobians against central differences, motion against integration and closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from slam._jit import inline
from slam.geometry import compose, wrap, wrap_all
from slam.motion import Ackermann, Matched, Odometry, Unicycle, deviation, matched, propagate
from slam.types import Floats, Noise

PI = math.pi
DT = 0.2
VEHICLE = Ackermann(wheelbase=2.83, ahead=3.78, left=0.5)  # a laser in front of the front axle, left of the middle
MODELS = [Unicycle(), Ackermann(), VEHICLE, Odometry(), Matched(0.1, 0.2, 0.3, 0.7, -0.2, 0.4)]
HEADINGS = [0.0, 0.7, PI / 2, PI - 1e-4, -PI, -PI + 1e-4]


def moved(motion: Any, s: Floats, u: Floats, dt: float = DT) -> Floats:
    return np.array(propagate(motion, tuple(s), tuple(u), dt)[0])


def jacobian(f: Callable[[Floats], Floats], x: Floats, angles: int, step: float = 1e-5) -> Floats:
    """Central differences; component `angles` of f is an angle, so its difference is taken on the circle."""
    columns = []
    for j in range(len(x)):
        h = np.zeros(len(x))
        h[j] = step
        difference = f(x + h) - f(x - h)
        difference[angles] = math.remainder(difference[angles], 2 * PI)
        columns.append(difference / (2 * step))
    return np.stack(columns, axis=1)


def controls(motion: Any, rng: np.random.Generator) -> list[Floats]:
    """Random controls, and those where a formula changes or a derivative vanishes."""
    if motion.controls == 3:
        return [*rng.normal(0, [0.5, 0.5, 0.3], (20, 3)), np.zeros(3), np.array([0, 0, PI]), np.array([1.0, 0, 0])]
    still = [(0.0, 0.0), (3.0, 0.0), (0.0, 0.5), (-2.0, 0.3)]
    # both sides of where the unicycle goes over to a series: |w dt / 2| = 1e-4
    series = [(3.0, sign * w / DT) for sign in (1, -1) for w in (1e-9, 1.9e-4, 2.1e-4, 1e-3)]
    return [*rng.normal(0, [5.0, 0.4], (20, 2)), *np.array(still), *np.array(series)]


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("motion", MODELS, ids=str)
def test_jacobians(motion: Any, heading: float) -> None:
    rng = np.random.default_rng(1)
    for u in controls(motion, rng):
        s = np.array([*rng.normal(0, 20, 2), heading])
        _, H_s, H_u = propagate(motion, tuple(s), tuple(u), DT)
        np.testing.assert_allclose(H_s, jacobian(lambda x, u=u: moved(motion, x, u), s, 2), atol=2e-8)
        np.testing.assert_allclose(H_u, jacobian(lambda x, s=s: moved(motion, s, x), u, 2), atol=2e-8)


@pytest.mark.parametrize("motion", MODELS, ids=str)
def test_heading_stays_on_the_circle(motion: Any) -> None:
    rng = np.random.default_rng(2)
    for u in controls(motion, rng):
        for heading in HEADINGS:
            assert -PI <= moved(motion, np.array([0.0, 0.0, heading]), u * 20)[2] < PI


@pytest.mark.parametrize("motion", MODELS, ids=str)
def test_the_frame_of_the_world_does_not_matter(motion: Any) -> None:
    """Moving from s is s (+) moving from the origin."""
    rng = np.random.default_rng(3)
    for u in controls(motion, rng):
        s = np.array([*rng.normal(0, 20, 2), rng.uniform(-PI, PI)])
        here, there = moved(motion, s, u), compose(s, moved(motion, np.zeros(3), u))
        np.testing.assert_allclose(here[:2], there[:2], atol=1e-12)
        assert wrap(here[2] - there[2]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("motion", MODELS, ids=str)
def test_no_control_no_motion(motion: Any) -> None:
    s = np.array([3.0, -4.0, 2.5])
    np.testing.assert_array_equal(moved(motion, s, np.zeros(motion.controls)), s)


@pytest.mark.parametrize("motion", MODELS, ids=str)
def test_compiled_code_is_the_same_code(motion: Any) -> None:
    compiled = inline(lambda motion, s, u, dt: propagate(motion, s, u, dt))
    rng = np.random.default_rng(4)
    for u in controls(motion, rng):
        s = np.array([*rng.normal(0, 20, 2), rng.uniform(-PI, PI)])
        for found, expected in zip(compiled(motion, s, u, DT), propagate(motion, s, u, DT), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-14)


# One by one ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("w", [0.0, 1e-12, 1e-5, 0.01, -1.3, 6.0])
def test_unicycle_is_the_limit_of_small_straight_pieces(w: float) -> None:
    v, dt, pieces = 3.0, 0.5, 4000
    heading = 2.9 + w * dt / pieces * (np.arange(pieces) + 0.5)  # midpoint rule
    step = v * dt / pieces
    expected = [1.0 + step * np.cos(heading).sum(), 2.0 + step * np.sin(heading).sum(), wrap(2.9 + w * dt)]
    np.testing.assert_allclose(moved(Unicycle(), np.array([1.0, 2.0, 2.9]), np.array([v, w]), dt), expected, atol=1e-6)


@pytest.mark.parametrize("sign", [-1, 1])
def test_unicycle_has_no_seam_where_the_series_begins(sign: int) -> None:
    """Two turn rates a rounding error apart, one on either side of the threshold."""
    w = sign * 2e-4 / DT
    below, above = w * (1 - 1e-13), w * (1 + 1e-13)
    s = (1.0, -2.0, 0.7)
    one, other = (propagate(Unicycle(), s, (3.0, rate), DT) for rate in (below, above))
    assert abs(0.5 * below * DT) < 1e-4 < abs(0.5 * above * DT)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


@pytest.mark.parametrize("half", [0.0, *10.0 ** np.linspace(-7, 0, 22)])
def test_unicycle_keeps_its_digits(half: float) -> None:
    """Chord and derivative, for turns from nothing to 2 rad, against extended precision."""
    a = np.longdouble(half)
    sinc, slope = (np.sin(a) / a, (np.cos(a) - np.sin(a) / a) / a) if half else (1.0, 0.0)
    # seen along the chord, that is with the heading half way along x
    s_new, _, H_u = propagate(Unicycle(), (0.0, 0.0, -half), (3.0, 2 * half / DT), DT)
    np.testing.assert_allclose(s_new, [float(3.0 * DT * sinc), 0.0, half], atol=2e-15)
    np.testing.assert_allclose(H_u[0], [float(DT * sinc), float(3.0 * DT * DT / 2 * slope)], atol=2e-13)


def test_two_ticks_of_a_unicycle_are_one_of_twice_the_time() -> None:
    s, u = np.array([0.0, 0.0, 3.0]), np.array([2.0, 0.8])
    np.testing.assert_allclose(
        moved(Unicycle(), moved(Unicycle(), s, u, 0.3), u, 0.3), moved(Unicycle(), s, u, 0.6), atol=1e-14
    )


def test_ackermann_at_the_front_axle_is_the_vehicle_of_the_baseline_code() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        (x, y), phi = rng.normal(0, 20, 2), rng.uniform(-PI, PI)
        v, G = rng.normal(0, [5.0, 0.4])
        expected = [
            x + v * DT * math.cos(phi + G),
            y + v * DT * math.sin(phi + G),
            wrap(phi + v * DT * math.sin(G) / 4.0),
        ]
        np.testing.assert_allclose(moved(Ackermann(), np.array([x, y, phi]), np.array([v, G])), expected, atol=1e-13)


def test_a_point_of_the_vehicle_moves_as_a_rigid_body() -> None:
    """Fine ticks of the reference point are fine ticks of the rear axle, carried to that point."""
    u, ticks = np.array([4.0, 0.3]), 20_000
    rear = Ackermann(VEHICLE.wheelbase, ahead=0.0, left=0.0)
    arm = np.array([VEHICLE.ahead, VEHICLE.left, 0.0])
    axle = np.array([1.0, 2.0, 2.5])
    point = compose(axle, arm)
    for _ in range(ticks):
        axle, point = moved(rear, axle, u, 2.0 / ticks), moved(VEHICLE, point, u, 2.0 / ticks)
    assert np.linalg.norm(axle[:2] - [1.0, 2.0]) > 5.0
    np.testing.assert_allclose(
        point, compose(axle, arm), atol=1e-3
    )  # of Euler's rule; 20 times less with 20 times more


def test_a_wheel_at_the_rear_axle_has_its_own_speed() -> None:
    """The rear axle rolls with v cos(G), straight ahead."""
    v, G = 4.0, 0.5
    s_new = moved(Ackermann(3.0, ahead=0.0), np.zeros(3), np.array([v, G]), 0.1)
    np.testing.assert_allclose(s_new, [0.1 * v * math.cos(G), 0.0, 0.1 * v * math.sin(G) / 3.0], atol=1e-15)


def test_odometry_composes() -> None:
    rng = np.random.default_rng(6)
    s = np.column_stack([rng.normal(0, 20, (100, 2)), rng.uniform(-PI, PI, 100)])
    u = np.column_stack([rng.normal(0, 1, (100, 2)), rng.uniform(-PI, PI, 100)])
    found = np.array([moved(Odometry(), a, b, dt=math.nan) for a, b in zip(s, u, strict=True)])  # time does not matter
    expected = compose(s, u)
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=1e-12)
    np.testing.assert_allclose(wrap_all(found[:, 2] - expected[:, 2]), 0.0, atol=1e-12)


# Noise --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [Unicycle(), Ackermann()], ids=str)
@pytest.mark.parametrize("ticks", [0, 1, 5])
def test_deviation_of_speed_and_turn(motion: Any, ticks: int) -> None:
    found = deviation(motion, np.full((ticks, 2), 7.0), Noise(speed=0.3, turn=0.05))
    np.testing.assert_array_equal(found, np.tile([0.3, 0.05], (ticks, 1)))


def test_deviation_of_odometry_grows_with_the_motion() -> None:
    u = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, -0.5], [0.0, 0.0, 0.0], [-3.0, 4.0, 1.2]])
    found = deviation(Odometry(turn_per_metre=0.2), u, Noise(odometry=0.1))
    expected = [[0.5, 0.5, 0.1], [0.0, 0.0, 0.05], [0.0, 0.0, 0.0], [0.5, 0.5, 0.1 * math.hypot(1.2, 1.0)]]
    np.testing.assert_allclose(found, expected, atol=1e-15)
    assert deviation(Odometry(), np.zeros((0, 3)), Noise()).shape == (0, 3)


@pytest.mark.parametrize("rank", [3, 2, 1, 0])
def test_a_matched_increment_has_the_covariance_that_it_is_said_to_have(rank: int) -> None:
    rng = np.random.default_rng(rank)
    half = rng.normal(0, [[0.2], [0.05], [0.01]], (3, rank))
    covariance, u = half @ half.T, np.array([0.5, -0.1, 3.0])
    motion, w = matched(u, covariance)
    s, _, H_u = propagate(motion, (0.0, 0.0, 0.0), tuple(w), DT)
    np.testing.assert_allclose(s, u, atol=1e-12)
    sigma = deviation(motion, w[None], Noise())[0]
    np.testing.assert_allclose(np.array(H_u) * sigma @ (np.array(H_u) * sigma).T, covariance, atol=1e-9)
