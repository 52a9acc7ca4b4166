"""Routes become controls, and controls become poses that the motion model agrees with."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from scenarios.route import Route, controls, drive, legs, shorten, start_pose
from scenarios.types import SourceError
from slam.motion import Ackermann, Unicycle

UNICYCLE = Unicycle()
CAR = Ackermann(wheelbase=2.0, ahead=2.0)


def driven(route: Route, motion: Any = UNICYCLE) -> tuple[np.ndarray, np.ndarray]:
    u, dt = controls(route, motion)
    return u, drive(motion, start_pose(route), u, dt)


def test_straight_at_constant_speed_reaches_the_end() -> None:
    u, poses = driven(Route(((1.0, 2.0), (4.0, 6.0)), speed=0.7, tick=0.1))
    np.testing.assert_allclose(poses[-1], [4.0, 6.0, math.atan2(4, 3)], atol=1e-9)
    assert (u[:-1, 0] == 0.7).all()
    assert 0 < u[-1, 0] <= 0.7  # 5 m are no whole number of ticks
    assert (u[:, 1] == 0.0).all()


def test_turns_on_the_spot_at_corners() -> None:
    u, poses = driven(Route(((0, 0), (2, 0), (2, 3)), speed=1.0, tick=0.1, turn_rate=1.0))
    np.testing.assert_allclose(poses[-1], [2, 3, math.pi / 2], atol=1e-9)
    turning = u[:, 1] != 0
    assert (u[turning, 0] == 0).all()
    assert np.abs(u[:, 1]).max() <= 1.0
    assert turning.sum() == math.ceil(math.pi / 2 / 0.1)


@pytest.mark.parametrize("degrees", [360.0, -90.0, 720.0])
def test_start_turn_ends_in_the_direction_of_the_route(degrees: float) -> None:
    route = Route(((0, 0), (1, 1)), start_turn=math.radians(degrees))
    u, poses = driven(route)
    assert math.isclose(float(np.sum(u[:, 1]) * route.tick), math.radians(degrees), rel_tol=1e-12)
    np.testing.assert_allclose(poses[-1], [1, 1, math.pi / 4], atol=1e-9)


@pytest.mark.parametrize(("motion", "tolerance"), [(Unicycle(), 0.01), (CAR, 0.01)])
def test_rounded_corners_keep_to_the_arcs(motion: Any, tolerance: float) -> None:
    route = Route(((0, 0), (10, 0), (10, 10), (0, 10)), speed=0.5, tick=0.05, corner_radius=3.0)
    _, poses = driven(route, motion)
    x, y = poses[:, 0], poses[:, 1]
    first, second = (x > 7) & (y < 3), (x > 7) & (y > 7)
    np.testing.assert_allclose(np.hypot(x - 7, y - 3)[first], 3.0, atol=tolerance)
    np.testing.assert_allclose(np.hypot(x - 7, y - 7)[second], 3.0, atol=tolerance)
    np.testing.assert_allclose(poses[-1, :2], [0, 10], atol=tolerance)
    assert sum(leg.length for leg in legs(route)) == pytest.approx(7 + 4 + 7 + 3 * math.pi, abs=1e-9)


def test_a_car_on_a_long_arc_steers_as_geometry_says() -> None:
    """The front wheel on a circle of radius r: sin(G) = wheelbase / r."""
    u, _ = driven(Route(((0, 0), (40, 0), (40, 40)), speed=1.0, tick=0.05, corner_radius=30.0), CAR)
    assert u[:, 1].max() == pytest.approx(math.asin(2.0 / 30.0), abs=2e-3)


def test_waiting_comes_before_all_else() -> None:
    route = Route(((0, 0), (2, 0)), start_turn=1.0, tick=0.1)
    u, _ = controls(route, UNICYCLE)
    waited, dt = controls(replace(route, wait=3.05), UNICYCLE)
    assert (waited[:31] == 0).all()
    np.testing.assert_array_equal(waited[31:], u)
    assert (dt == 0.1).all()
    steered, _ = controls(Route(((0, 0), (2, 0)), wait=1.0), CAR)
    assert (steered[:10] == 0).all()


def test_repeated_waypoints_are_one() -> None:
    a, b = Route(((0, 0), (0, 0), (3, 0), (3, 0))), Route(((0, 0), (3, 0)))
    np.testing.assert_array_equal(controls(a, Unicycle())[0], controls(b, Unicycle())[0])


@pytest.mark.parametrize(
    ("route", "motion", "message"),
    [
        (Route(((0, 0), (2, 0), (2, 9)), corner_radius=3.0), Unicycle(), r"no room .* between \(0, 0\) and \(2, 0\)"),
        (Route(((0, 0), (5, 0), (0, 0)), corner_radius=1.0), Unicycle(), "less sharp corners"),
        (Route(((0, 0), (9, 0), (9, 9))), CAR, "cannot turn on the spot"),
        (Route(((0, 0), (9, 0)), start_turn=1.0), CAR, "cannot turn on the spot"),
        (Route(((0, 0), (9, 0), (9, 9)), corner_radius=1.0), CAR, "wheelbase of 2 m"),
        (Route(((0, 0), (1000, 0)), speed=1e-5), Unicycle(), "at most 2000000"),
        (Route(((0, 0), (1, 0)), wait=900_000.0), Unicycle(), "at most 2000000"),
    ],
)
def test_impossible_routes(route: Route, motion: Any, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        controls(route, motion)


def test_shorten() -> None:
    square = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0))
    assert shorten(square, 6.0) == ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0))
    assert shorten(square, 4.0) == square[:2]
    assert shorten(square, 4.5, shortest=1.0) == square[:2]
    assert shorten(square, 99.0) == square
