"""The rigid motion that lays one set of places upon another, or upon lines."""

from __future__ import annotations

import math

import numpy as np

from slam.types import Floats

STEPS = 30
"""Of Gauss-Newton, at most; three or four are enough for a map that is nearly right."""

PARALLEL = 1e-10
"""Lines whose directions spread less, squared and relative, say nothing about a shift along them."""


def align_rigid(p: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Rotation R (2, 2) and translation t (2,) with the least sum of |R p + t - q|^2; p, q (n, 2), n >= 1.

    S. Umeyama, IEEE Trans. PAMI 13 (1991), without scale: in the plane the best turn is the direction of the
    summed dot and cross products, never a reflection.  One point, or points all in one place, are only
    translated.
    """
    p_mean, q_mean = p.mean(axis=0), q.mean(axis=0)
    a, b = p - p_mean, q - q_mean
    dot = float(np.sum(a * b))
    cross = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    # Points in one place leave differences that are rounding errors, and their turn means nothing.
    rounding = len(p) * np.finfo(float).eps * float(np.abs(p).max() * np.abs(b).sum())
    angle = math.atan2(cross, dot) if math.hypot(dot, cross) > rounding else 0.0
    c, s = math.cos(angle), math.sin(angle)
    R = np.array([[c, -s], [s, c]])
    return R, q_mean - R @ p_mean


def align_to_lines(p: Floats, q: Floats, normal: Floats, angle: float = 0.0) -> tuple[Floats, Floats]:
    """Rotation R (2, 2), near one by `angle`, and translation t (2,) with the least sum of (normal . (R p + t - q))^2.

    The squared distances of places p from the lines through q with unit normals, (n, 2) each, n >= 1.  For a given turn
    the best shift is linear in its cosine and sine, and put in; what is left is Gauss-Newton on the angle alone.  Where
    all lines are parallel nothing tells how far to shift along them: the places, in the mean, are not.
    """
    centre = p.mean(axis=0)
    a, b = p - centre, centre - q
    # R a + b is (cos, sin, 1) @ (a, a turned by a quarter, b)
    rows = [(a * normal).sum(axis=1), a[:, 0] * normal[:, 1] - a[:, 1] * normal[:, 0], (b * normal).sum(axis=1)]
    distance = np.stack(rows, axis=1)
    shift = -np.linalg.pinv(normal.T @ normal, rcond=PARALLEL, hermitian=True) @ (normal.T @ distance)
    left = distance + normal @ shift
    M = left.T @ left  # the sum of squares is x @ M @ x
    for _ in range(STEPS):
        c, s = math.cos(angle), math.sin(angle)
        downhill = M @ np.array([-s, c, 0.0])
        curvature = float(c * downhill[1] - s * downhill[0])
        step = float(c * downhill[0] + s * downhill[1] + downhill[2]) / curvature if curvature > 0.0 else 0.0
        angle -= step
        if abs(step) < 1e-12:
            break
    c, s = math.cos(angle), math.sin(angle)
    R = np.array([[c, -s], [s, c]])
    return R, centre - R @ centre + shift @ np.array([c, s, 1.0])
