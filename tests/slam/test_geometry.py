"""SE(2) by its axioms, angles on the circle, ellipses against an eigendecomposition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slam.geometry import circular_mean, compose, ellipse_axes, invert, wrap, wrap_all
from slam.types import Floats

PI = math.pi
BELOW_PI = math.nextafter(PI, 0.0)
EDGES = np.array([-PI, math.nextafter(-PI, 0.0), -PI + 1e-9, -PI / 2, -0.0, 0.0, PI / 2, PI - 1e-9, BELOW_PI])
"""Headings where a sign or a comparison goes wrong first; all in [-pi, pi)."""


def poses(rng: np.random.Generator, size: int = 3000) -> Floats:
    """Random poses, a third of them with a heading from `EDGES`."""
    headings = np.where(rng.random(size) < 1 / 3, rng.choice(EDGES, size), rng.uniform(-PI, PI, size))
    return np.column_stack([rng.normal(0, 50, (size, 2)), headings])


def assert_same_pose(a: Floats, b: Floats, atol: float = 1e-12) -> None:
    """Equal as poses: a heading of -pi is one of pi."""
    np.testing.assert_allclose(a[..., :2], b[..., :2], rtol=0, atol=atol)
    turn = a[..., 2] - b[..., 2]
    np.testing.assert_allclose(np.arctan2(np.sin(turn), np.cos(turn)), 0.0, atol=atol)


def matrix(pose: Floats) -> Floats:
    """The homogeneous (3, 3) matrix, an independent representation of the same group."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = [[c, -s, pose[..., 0]], [s, c, pose[..., 1]], [zero, zero, one]]
    return np.moveaxis(np.array(rows), [0, 1], [-2, -1])


# Poses --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_group_axioms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = poses(rng), poses(rng), poses(rng)
    origin = np.zeros(3)
    for closed in (compose(a, b), invert(a)):
        assert (closed[:, 2] >= -PI).all()
        assert (closed[:, 2] < PI).all()
    assert_same_pose(compose(a, origin), a)
    assert_same_pose(compose(origin, a), a)
    assert_same_pose(compose(a, invert(a)), np.zeros_like(a))
    assert_same_pose(compose(invert(a), a), np.zeros_like(a))
    assert_same_pose(compose(compose(a, b), c), compose(a, compose(b, c)), atol=1e-11)
    assert_same_pose(invert(compose(a, b)), compose(invert(b), invert(a)), atol=1e-11)
    assert np.abs(compose(a, b)[:, :2] - compose(b, a)[:, :2]).max() > 1.0  # and not a commutative one


def test_compose_and_invert_are_matrix_products() -> None:
    rng = np.random.default_rng(4)
    a, b = poses(rng), poses(rng)
    np.testing.assert_allclose(matrix(compose(a, b)), matrix(a) @ matrix(b), atol=1e-12)
    np.testing.assert_allclose(matrix(invert(a)), np.linalg.inv(matrix(a)), atol=1e-11)


def test_leading_axes_broadcast() -> None:
    rng = np.random.default_rng(5)
    a, b = poses(rng, 6), poses(rng, 4)
    every = compose(a[:, None], b[None])
    assert every.shape == (6, 4, 3)
    np.testing.assert_array_equal(every[2, 3], compose(a[2], b[3]))
    np.testing.assert_array_equal(invert(every)[5, 1], invert(every[5, 1]))


# Angles -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [*EDGES, 1e-300, -1e-17, 1.0])
def test_wrap_leaves_alone_what_is_in_range(angle: float) -> None:
    """To the bit: an innovation of 1e-17 rad must not become the rounding error of pi."""
    assert wrap(angle) == angle
    assert math.copysign(1.0, wrap(angle)) == math.copysign(1.0, angle)
    assert wrap_all(np.array([angle]))[0] == angle


@pytest.mark.parametrize("turns", [-3, -1, 1, 2, 1000])
def test_wrap_takes_off_whole_turns(turns: int) -> None:
    angles = np.random.default_rng(6).uniform(-PI, PI, 200)
    for angle in angles:
        assert wrap(angle + turns * 2 * PI) == pytest.approx(angle, abs=1e-12)
    np.testing.assert_allclose(wrap_all(angles + turns * 2 * PI), angles, atol=1e-12)


def test_the_range_is_closed_below_and_open_above() -> None:
    assert wrap(PI) == -PI
    assert wrap(-PI) == -PI
    assert wrap(3 * PI) == -PI
    assert wrap(math.nextafter(-PI, -4.0)) == pytest.approx(BELOW_PI, abs=1e-15)
    np.testing.assert_array_equal(wrap_all(np.array([PI, -PI])), [-PI, -PI])


def test_wrap_is_exact_next_to_its_ends() -> None:
    """One turn off, and no rounding error from it."""
    above, below = np.nextafter(PI, 4.0), np.nextafter(-PI, -4.0)
    assert wrap(above) == above - 2 * PI
    assert wrap(below) == below + 2 * PI == BELOW_PI


def many_angles() -> Floats:
    """All magnitudes up to where one step of a float is more than a turn, and the neighbours of odd multiples of pi."""
    rng = np.random.default_rng(7)
    odd = PI * (2 * rng.integers(-10_000, 10_000, 2000) + 1)
    scales = 10.0 ** rng.uniform(-20, 18, 4000) * rng.choice([-1, 1], 4000)
    ends = np.nextafter([-PI, PI], [-4.0, 4.0])
    return np.concatenate([odd, np.nextafter(odd, np.inf), np.nextafter(odd, -np.inf), scales, ends, EDGES])


def test_wrap_never_leaves_its_range() -> None:
    angles = many_angles()
    for wrapped in (np.array([wrap(a) for a in angles]), wrap_all(angles)):
        assert (wrapped >= -PI).all()
        assert (wrapped < PI).all()


def test_wrap_all_is_wrap() -> None:
    """On the circle and up to the rounding of the angle itself: at an odd multiple of pi either end is right."""
    angles = many_angles()
    difference = wrap_all(angles) - np.array([wrap(a) for a in angles])
    error = np.abs(np.arctan2(np.sin(difference), np.cos(difference)))
    assert (error[np.abs(angles) < 1e9] <= 1e-15 * np.maximum(np.abs(angles), 4.0)[np.abs(angles) < 1e9]).all()
    shaped = angles[:12].reshape(3, 4)
    assert wrap_all(shaped).shape == (3, 4)
    assert wrap_all(np.array(7.0)).shape == ()


@pytest.mark.parametrize("centre", [0.0, 2.0, PI - 1e-3, -PI])
def test_circular_mean_across_the_cut(centre: float) -> None:
    rng = np.random.default_rng(8)
    offsets = rng.normal(0, 0.2, 500)
    w = rng.dirichlet(np.ones(500))
    mean = circular_mean(wrap_all(centre + offsets), w)
    assert -PI <= mean <= PI
    # for a spread of 0.2 rad the mean of the offsets differs from the mean direction by a third moment, about 1e-3
    assert wrap(mean - centre) == pytest.approx(np.sum(w * offsets), abs=3e-3)
    assert wrap(circular_mean(wrap_all(centre + 1.0 + offsets), w) - mean) == pytest.approx(1.0, abs=1e-12)


def test_circular_mean_obeys_its_weights() -> None:
    angles = np.array([0.0, PI / 2])
    assert circular_mean(angles, np.array([1.0, 0.0])) == 0.0
    assert circular_mean(angles, np.array([3.0, 3.0])) == pytest.approx(PI / 4)
    assert circular_mean(angles, np.array([3.0, 1.0])) == pytest.approx(math.atan2(1, 3))


# Ellipses -----------------------------------------------------------------------------------------------------------


def test_ellipse_axes_are_the_eigenvectors() -> None:
    rng = np.random.default_rng(9)
    A = rng.normal(size=(500, 2, 2)) * 10.0 ** rng.uniform(-4, 2, (500, 1, 1))
    covariance = A @ A.swapaxes(1, 2)
    half, direction = ellipse_axes(covariance)
    values, vectors = np.linalg.eigh(covariance)
    assert (half[:, 0] >= half[:, 1]).all()
    # the short axis is what cancels: right to the rounding of the long one
    np.testing.assert_allclose(half**2, np.maximum(values[:, ::-1], 0), rtol=1e-9, atol=1e-15 * values.max())
    along = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    np.testing.assert_allclose(np.abs(np.sum(along * vectors[:, :, 1], axis=1)), 1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("covariance", "half", "direction"),
    [
        ([[0, 0], [0, 0]], [0, 0], None),
        ([[4, 0], [0, 4]], [2, 2], None),
        ([[9, 0], [0, 4]], [3, 2], 0.0),
        ([[4, 0], [0, 9]], [3, 2], PI / 2),
        ([[9, 0], [0, 0]], [3, 0], 0.0),
        ([[0, 0], [0, 9]], [3, 0], PI / 2),
        ([[2, 2], [2, 2]], [2, 0], PI / 4),
        ([[2, -2], [-2, 2]], [2, 0], -PI / 4),
        ([[1, 0], [0, -1e-18]], [1, 0], 0.0),  # rounding has made it a little negative
    ],
)
def test_degenerate_ellipses(covariance: list, half: list, direction: float | None) -> None:
    axes, angle = ellipse_axes(np.array(covariance, float))
    np.testing.assert_allclose(axes, half, atol=1e-15)
    assert np.isfinite(angle)
    if direction is not None:
        assert abs(wrap(2 * (angle - direction))) < 1e-12  # an axis has no sign


def test_ellipse_axes_take_any_leading_shape() -> None:
    half, direction = ellipse_axes(np.broadcast_to(np.diag([4.0, 1.0]), (3, 5, 2, 2)))
    assert half.shape == (3, 5, 2)
    assert direction.shape == (3, 5)
