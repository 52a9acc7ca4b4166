"""Every function of `slam.linalg` against NumPy, with entries of 1e-8 beside 1 too."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from slam import linalg
from slam.geometry import wrap
from slam.types import Floats

CASES = 200


def rows(A: Any) -> Any:
    """An array as the nested tuples of floats that `slam.linalg` computes with."""
    return tuple(rows(a) for a in A) if np.ndim(A) else float(A)


def covariance(rng: np.random.Generator, n: int, condition: float = 1e8) -> Floats:
    """(n, n) with axes turned at random, its eigenvalues from 1 / condition to 1."""
    axes = np.linalg.qr(rng.normal(size=(n, n)))[0]
    values = np.append([1.0, 1.0 / condition], condition ** -rng.random(n))[:n]
    A = axes @ np.diag(values) @ axes.T
    return 0.5 * (A + A.T)


def assert_symmetric(A: Any) -> None:
    """To the bit: asymmetry would grow from step to step."""
    A = np.array(A)
    np.testing.assert_array_equal(A, A.T)


# Loading, products --------------------------------------------------------------------------------------------------


def test_what_is_loaded_is_stored() -> None:
    rng = np.random.default_rng(0)
    for shape, load, store in [
        ((3,), linalg.load3, linalg.store3),
        ((2, 2), linalg.load22, linalg.store22),
        ((3, 3), linalg.load33, linalg.store33),
    ]:
        A, out = rng.normal(size=shape), np.full(shape, np.nan)
        assert load(A) == rows(A)
        store(out, load(A))
        np.testing.assert_array_equal(out, A)


@pytest.mark.parametrize("condition", [10.0, 1e8])
def test_products(condition: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(CASES):
        a2, b2, a3, b3 = (rng.normal(size=n) for n in (2, 2, 3, 3))
        A22, B22, A33, A23, B23 = (rng.normal(size=shape) for shape in [(2, 2), (2, 2), (3, 3), (2, 3), (2, 3)])
        S, P = covariance(rng, 2, condition), covariance(rng, 3, condition)
        h = rng.normal(size=(3, 2)), rng.normal(size=2)
        for found, expected in [
            (linalg.add22(rows(A22), rows(B22)), A22 + B22),
            (linalg.dot2(rows(a2), rows(b2)), a2 @ b2),
            (linalg.dot3(rows(a3), rows(b3)), a3 @ b3),
            (linalg.times22(rows(A22), rows(b2)), A22 @ b2),
            (linalg.times33(rows(A33), rows(b3)), A33 @ b3),
            (linalg.sandwich22(rows(A22), rows(S)), A22 @ S @ A22.T),
            (linalg.sandwich23(rows(A23), rows(P)), A23 @ P @ A23.T),
            (linalg.sandwich33(rows(A33), rows(P)), A33 @ P @ A33.T),
            (linalg.cross23(rows(A23), rows(P), rows(B23)), A23 @ P @ B23.T),
            (linalg.add_outer_scaled(rows(P), rows(h[0]), h[1]), P + h[0] @ np.diag(h[1] ** 2) @ h[0].T),
            (linalg.determinant22(rows(S)), np.linalg.det(S)),
            (linalg.largest_eigenvalue22(rows(S)), np.linalg.eigvalsh(S)[-1]),
        ]:
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
        for found in [
            linalg.sandwich22(rows(A22), rows(S)),
            linalg.sandwich23(rows(A23), rows(P)),
            linalg.sandwich33(rows(A33), rows(P)),
            linalg.add_outer_scaled(rows(P), rows(h[0]), h[1]),
        ]:
            assert_symmetric(found)


@pytest.mark.parametrize("controls", [2, 3])
def test_add_outer_scaled_takes_any_number_of_controls(controls: int) -> None:
    rng = np.random.default_rng(2)
    P, H, deviation = covariance(rng, 3), rng.normal(size=(3, controls)), rng.random(controls)
    expected = P + H @ np.diag(deviation**2) @ H.T
    np.testing.assert_allclose(linalg.add_outer_scaled(rows(P), rows(H), deviation), expected, rtol=1e-12)


# Inverses and densities ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("condition", [10.0, 1e4, 1e8])
def test_inverse_distance_and_density(condition: float) -> None:
    """Right to the condition of the matrix: 8 of 16 digits go where 1e-8 stands beside 1."""
    rng = np.random.default_rng(3)
    rtol = 20 * condition * np.finfo(float).eps
    for _ in range(CASES):
        V = covariance(rng, 2, condition) * 10.0 ** rng.uniform(-8, 1)
        v = np.linalg.cholesky(V) @ rng.normal(0, 2, 2)
        np.testing.assert_allclose(np.array(linalg.inverse22(rows(V))) @ V, np.eye(2), atol=rtol)
        d2 = linalg.distance2(rows(v), rows(V))
        assert d2 == pytest.approx(v @ np.linalg.solve(V, v), rel=rtol, abs=rtol)
        expected = multivariate_normal([0, 0], V).logpdf(v)
        assert linalg.log_density(rows(v), rows(V)) == pytest.approx(expected, rel=rtol, abs=rtol)


def test_log_density_of_the_smallest_sensor() -> None:
    """0.3 mm and 0.0003 degrees: the determinant is 1e-18, and no rounding takes it for zero."""
    V = np.diag([0.0003, math.radians(0.0003)]) ** 2
    v = np.array([0.0006, 0.0])
    expected = 2.0 * -0.5 * math.log(2 * math.pi) - math.log(0.0003) - math.log(math.radians(0.0003)) - 2.0
    assert linalg.log_density(rows(v), rows(V)) == pytest.approx(expected, rel=1e-12)


# Kalman updates -----------------------------------------------------------------------------------------------------


def exact_update(P: Floats, v: Floats, G: Floats, R: Floats) -> tuple[Floats, Floats]:
    """The textbook update K = P G^T V^-1, P - K G P, in extended precision."""
    P, v, G, R = (a.astype(np.longdouble) for a in (P, v, G, R))
    V = G @ P @ G.T + R
    inverse = np.array([[V[1, 1], -V[0, 1]], [-V[1, 0], V[0, 0]]]) / (V[0, 0] * V[1, 1] - V[0, 1] * V[1, 0])
    K = P @ G.T @ inverse
    return (K @ v).astype(float), (P - K @ G @ P).astype(float)


def kalman_pose(s: Floats, P: Floats, v: Floats, G: Floats, R: Floats) -> tuple[Floats, Floats]:
    V = linalg.add22(linalg.sandwich23(rows(G), rows(P)), rows(R))
    return tuple(np.array(a) for a in linalg.kalman_pose(rows(s), rows(P), rows(v), rows(G), rows(R), V))


@pytest.mark.parametrize(("condition", "r"), [(10.0, 1.0), (10.0, 1e-3), (1e8, 1e-1), (1e4, 1e-4)])
def test_pose_update_is_the_textbook_one(condition: float, r: float) -> None:
    rng = np.random.default_rng(4)
    for _ in range(CASES):
        s = np.array([*rng.normal(0, 40, 2), rng.uniform(-3, 3)])
        P, G, R = covariance(rng, 3, condition), rng.normal(size=(2, 3)), covariance(rng, 2, 3.0) * r
        v = rng.normal(0, 0.1, 2)
        moved, shrunk = exact_update(P, v, G, R)
        s_new, P_new = kalman_pose(s, P, v, G, R)
        np.testing.assert_allclose(s_new[:2], s[:2] + moved[:2], atol=1e-9)
        assert wrap(s_new[2] - s[2] - moved[2]) == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(P_new, shrunk, rtol=1e-7, atol=1e-11)
        assert_symmetric(P_new)


def test_pose_update_wraps_the_heading() -> None:
    s, P = np.array([0.0, 0.0, math.pi - 0.01]), np.diag([1.0, 1.0, 1.0])
    G, R = np.array([[1.0, 0, 0], [0, 0, 1.0]]), np.eye(2) * 1e-6
    s_new, _ = kalman_pose(s, P, np.array([0.0, 0.03]), G, R)
    assert s_new[2] == pytest.approx(-math.pi + 0.02, abs=1e-6)


def negative_part(P: Floats) -> float:
    return -min(np.linalg.eigvalsh(P)[0], 0.0) / np.trace(P)


def test_the_covariance_stays_positive_with_a_tiny_r() -> None:
    """200 times four observations in a row, 3 m of uncertainty against R of 1e-8 and less.

    The simple form P - K G P in the same arithmetic goes negative here, by much more than is allowed to ours.
    """
    rng = np.random.default_rng(5)
    worst, worst_simple = 0.0, 0.0
    for _ in range(CASES):
        P = covariance(rng, 3, 1e4) * 10.0
        simple, R = P.copy(), covariance(rng, 2, 100.0) * 10.0 ** rng.uniform(-12, -8)
        for _ in range(4):
            G = rng.normal(size=(2, 3))
            _, P = kalman_pose(np.zeros(3), P, np.zeros(2), G, R)
            simple = simple - simple @ G.T @ np.linalg.inv(G @ simple @ G.T + R) @ G @ simple
            worst, worst_simple = max(worst, negative_part(P)), max(worst_simple, negative_part(simple))
    assert worst < 1e-12
    assert worst_simple > 1e-9


def test_certain_pose_and_certain_feature_stay() -> None:
    """P = 0 in FastSLAM, Sigma = 0 in Dual FastSLAM: no correction, nothing negative, no NaN."""
    rng = np.random.default_rng(6)
    s, v, R = np.array([1.0, 2.0, 3.0]), np.array([0.1, -0.2]), covariance(rng, 2)
    s_new, P_new = kalman_pose(s, np.zeros((3, 3)), v, rng.normal(size=(2, 3)), R)
    np.testing.assert_array_equal(s_new, s)
    np.testing.assert_array_equal(P_new, np.zeros((3, 3)))
    delta, Sigma = linalg.kalman_feature(
        rows(np.zeros((2, 2))), rows(v), rows(rng.normal(size=(2, 2))), rows(R), rows(R)
    )
    np.testing.assert_array_equal(delta, [0.0, 0.0])
    np.testing.assert_array_equal(Sigma, np.zeros((2, 2)))


@pytest.mark.parametrize(("condition", "r"), [(10.0, 1.0), (1e6, 1e-2), (10.0, 1e-6)])
def test_feature_update_is_the_textbook_one(condition: float, r: float) -> None:
    rng = np.random.default_rng(7)
    for _ in range(CASES):
        S, G, R = covariance(rng, 2, condition), rng.normal(size=(2, 2)), covariance(rng, 2, 3.0) * r
        v = rng.normal(0, 0.1, 2)
        V = linalg.add22(linalg.sandwich22(rows(G), rows(S)), rows(R))
        delta, Sigma = linalg.kalman_feature(rows(S), rows(v), rows(G), rows(R), V)
        moved, shrunk = exact_update(S, v, G, R)
        np.testing.assert_allclose(delta, moved, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(Sigma, shrunk, rtol=1e-6, atol=1e-10)
        assert_symmetric(Sigma)
        assert negative_part(np.array(Sigma)) < 1e-14


# Factors ------------------------------------------------------------------------------------------------------------


def semidefinite(rng: np.random.Generator, n: int, rank: int) -> Floats:
    """(n, n) of this rank, its coordinates of sizes from 1e-4 to 1 (so the entries from 1e-8)."""
    B = rng.normal(size=(n, rank)) * 10.0 ** rng.uniform(-4, 0, (n, 1))
    return B @ B.T


@pytest.mark.parametrize(("n", "rank"), [(2, 0), (2, 1), (2, 2), (3, 0), (3, 1), (3, 2), (3, 3)])
def test_factors_reproduce_their_matrix(n: int, rank: int) -> None:
    rng = np.random.default_rng(8)
    factor = {2: linalg.factor22, 3: linalg.factor33}[n]
    for _ in range(CASES):
        A = semidefinite(rng, n, rank)
        L = np.array(factor(rows(A)))
        assert np.isfinite(L).all()
        np.testing.assert_array_equal(np.triu(L, 1), 0.0)
        # in units of each coordinate's own deviation; a pivot below 1e-15 of its variance may be dropped
        scale = np.sqrt(np.outer(A.diagonal(), A.diagonal()))
        assert (np.abs(L @ L.T - A) <= 1e-7 * scale).all()
        if rank == n:
            np.testing.assert_allclose(L, np.linalg.cholesky(A), rtol=1e-6, atol=1e-8 * np.sqrt(A.diagonal().max()))


@pytest.mark.parametrize("zero", [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2)])
def test_factor_of_a_matrix_with_certain_coordinates(zero: tuple[int, ...]) -> None:
    A = covariance(np.random.default_rng(9), 3, 100.0)
    A[list(zero), :] = A[:, list(zero)] = 0.0
    L = np.array(linalg.factor33(rows(A)))
    np.testing.assert_allclose(L @ L.T, A, atol=1e-15)


def test_factor_of_the_pose_after_one_tick() -> None:
    """Two noisy controls make a P of rank 2, on which Cholesky fails or not as rounding has it."""
    rng = np.random.default_rng(10)
    for _ in range(CASES):
        H = rng.normal(size=(3, 2)) * 10.0 ** rng.uniform(-3, 1, (1, 2))
        P = np.array(linalg.add_outer_scaled(rows(np.zeros((3, 3))), rows(H), np.array([0.3, 0.05]) * 0.025))
        L = np.array(linalg.factor33(rows(P)))
        assert (np.abs(L @ L.T - P) <= 1e-7 * np.sqrt(np.outer(P.diagonal(), P.diagonal()))).all()
