"""SE(2): poses (x, y, heading) [m, m, rad], their composition and inverse, angles on the circle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba.extending import register_jitable

from slam.types import Floats

TWO_PI = 2.0 * math.pi


@register_jitable
def wrap(angle: Any) -> Any:
    """The same angle in [-pi, pi).  Exact for angles that are there already.

    A plain function to Python, which would else have to compile it in every process.
    """
    if -math.pi <= angle < math.pi:
        return angle
    if -9.0 < angle < 9.0:  # the sum of two or three angles: a turn off, exactly
        return angle - math.copysign(TWO_PI, angle)
    wrapped = (angle + math.pi) % TWO_PI - math.pi
    return -math.pi if wrapped >= math.pi else wrapped


def wrap_all(angles: Floats) -> Floats:
    """`wrap` for an array of any shape [rad]."""
    wrapped = np.mod(np.asarray(angles, float) + math.pi, TWO_PI) - math.pi
    wrapped = np.where(wrapped >= math.pi, -math.pi, wrapped)  # rounded up from just below -pi
    return np.where((angles >= -math.pi) & (angles < math.pi), angles, wrapped)


def compose(a: Floats, b: Floats) -> Floats:
    """a (+) b: the pose b, given in the frame a, in the frame in which a is given.  (..., 3) each."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack([x, y, wrap_all(a[..., 2] + b[..., 2])], axis=-1)


def invert(a: Floats) -> Floats:
    """(-) a, so that compose(a, invert(a)) is the origin.  (..., 3)."""
    a = np.asarray(a, float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = -c * a[..., 0] - s * a[..., 1]
    y = s * a[..., 0] - c * a[..., 1]
    return np.stack([x, y, wrap_all(-a[..., 2])], axis=-1)


def circular_mean(angles: Floats, weights: Floats) -> float:
    """The weighted mean direction [rad]; (K,) each."""
    return float(math.atan2(np.sum(weights * np.sin(angles)), np.sum(weights * np.cos(angles))))


def ellipse_axes(covariance: Floats) -> tuple[Floats, Floats]:
    """Half axes (..., 2) [m], longest first, and the direction (...,) [rad] of the longest, of (..., 2, 2) at 1
    sigma."""
    a, b, c = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    mean, radius = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    half = np.sqrt(np.maximum(np.stack([mean + radius, mean - radius], axis=-1), 0.0))
    return half, 0.5 * np.arctan2(2.0 * b, a - c)
