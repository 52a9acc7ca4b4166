"""Rigid motions onto places and onto lines: the least of all, and none where nothing asks for one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from slam.alignment import align_rigid, align_to_lines
from slam.types import Floats

PI = math.pi


def rotation(angle: float) -> Floats:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


# --- Onto places --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.4, PI / 2, PI, -3.0])
@pytest.mark.parametrize("collinear", [False, True])
def test_alignment_recovers_a_known_transform(angle, collinear):
    rng = np.random.default_rng(3)
    p = rng.normal([50.0, -80.0], 10.0, size=(20, 2))
    if collinear:
        p[:, 1] = 0.5 * p[:, 0] + 3.0
    c, s = math.cos(angle), math.sin(angle)
    R, t = np.array([[c, -s], [s, c]]), np.array([7.0, -2.0])
    found_R, found_t = align_rigid(p, p @ R.T + t)
    np.testing.assert_allclose(found_R, R, atol=1e-12)
    np.testing.assert_allclose(found_t, t, atol=1e-10)


def test_alignment_is_the_least_of_all():
    """No small turn or shift of the found transform is better, on noisy and mirrored points."""
    rng = np.random.default_rng(4)
    p = rng.normal(size=(12, 2))
    for q in (p + 0.3 * rng.normal(size=p.shape), p * [1.0, -1.0]):
        R, t = align_rigid(p, q)
        assert np.linalg.det(R) == pytest.approx(1.0)
        least = np.sum((p @ R.T + t - q) ** 2)
        for turn, dx, dy in np.vstack([1e-3 * np.eye(3), -1e-3 * np.eye(3)]):
            c, s = math.cos(turn), math.sin(turn)
            moved = p @ (np.array([[c, -s], [s, c]]) @ R).T + t + [dx, dy]
            assert np.sum((moved - q) ** 2) > least


def test_alignment_of_points_in_one_place_only_shifts():
    place = np.array([40.1, -30.7])
    for n in (1, 2, 7):
        R, t = align_rigid(np.tile(place, (n, 1)), np.tile([1.3, 2.9], (n, 1)))
        np.testing.assert_array_equal(R, np.eye(2))
        np.testing.assert_allclose(place + t, [1.3, 2.9])
    spread = np.array([[0.0, 0.0], [1.0, 3.0]])
    np.testing.assert_array_equal(align_rigid(np.tile(place, (2, 1)), spread)[0], np.eye(2))


# --- Onto lines ---------------------------------------------------------------------------------------------


def lines(directions: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Two places on each of some lines in these directions [rad], a place of each line, their normals."""
    normal = np.stack([-np.sin(directions), np.cos(directions)], axis=1)
    along = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    q = rng.normal([60.0, -20.0], 15.0, size=(len(directions), 2))
    p = q[:, None] + rng.uniform(-8, 8, size=(len(directions), 2, 1)) * along[:, None]
    return p.reshape(-1, 2), np.repeat(q, 2, axis=0), np.repeat(normal, 2, axis=0)


def squares(p: Floats, q: Floats, normal: Floats, R: Floats, t: Floats) -> float:
    return float(np.sum(np.sum((p @ R.T + t - q) * normal, axis=1) ** 2))


@pytest.mark.parametrize("angle", [0.0, 0.3, -1.2, PI, -3.0])
@pytest.mark.parametrize("off", [0.0, 0.2, -0.4])
def test_lines_recover_a_known_transform(angle: float, off: float) -> None:
    """From a first guess that is up to 0.4 rad off."""
    rng = np.random.default_rng(8)
    p, q, normal = lines(rng.uniform(-PI, PI, 20), rng)
    R, t = rotation(angle), np.array([7.0, -2.0])
    found_R, found_t = align_to_lines((p - t) @ R, q, normal, angle + off)
    np.testing.assert_allclose(found_R, R, atol=1e-10)
    np.testing.assert_allclose(found_t, t, atol=1e-8)


@pytest.mark.parametrize("noise", [1e-3, 0.1, 3.0])
def test_no_motion_onto_lines_is_better(noise: float) -> None:
    """Against a general minimiser that starts from many turns; corridors, so that few directions occur."""
    rng = np.random.default_rng(12)
    for _ in range(10):
        p, q, normal = lines(rng.integers(0, 4, 12) * PI / 2, rng)
        p = p @ rotation(0.2) + [1.0, -3.0] + noise * rng.normal(size=p.shape)
        R, t = align_to_lines(p, q, normal)

        def cost(x: Floats, p: Floats = p, q: Floats = q, normal: Floats = normal) -> float:
            return squares(p, q, normal, rotation(x[2]), x[:2])

        least = min(minimize(cost, [0.0, 0.0, angle]).fun for angle in np.linspace(-3, 3, 9))
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert squares(p, q, normal, R, t) <= least * (1 + 1e-6) + 1e-9


def test_along_a_straight_corridor_nothing_is_shifted() -> None:
    """All lines are parallel, in two opposite directions: the turn and the shift across are found, none along."""
    rng = np.random.default_rng(2)
    heading = 0.7
    p, q, normal = lines(heading + PI * np.array([0, 1, 0, 0, 1]), rng)
    axis = np.array([math.cos(heading), math.sin(heading)])
    moved = (p - p.mean(axis=0)) @ rotation(0.1) + p.mean(axis=0) + 0.5 * normal[0] + 3.0 * axis
    R, t = align_to_lines(moved, q, normal)
    assert squares(moved, q, normal, R, t) < 1e-16
    np.testing.assert_allclose(R, rotation(0.1), atol=1e-9)
    shift = (moved @ R.T + t - moved).mean(axis=0)
    np.testing.assert_allclose(shift @ axis, 0.0, atol=1e-9)
    np.testing.assert_allclose(shift @ normal[0], -0.5, atol=1e-9)


def test_one_place_is_only_shifted_and_only_across() -> None:
    R, t = align_to_lines(np.array([[3.0, 4.0]]), np.array([[100.0, 1.0]]), np.array([[0.0, 1.0]]))
    np.testing.assert_array_equal(R, np.eye(2))
    np.testing.assert_allclose(t, [0.0, -3.0])
