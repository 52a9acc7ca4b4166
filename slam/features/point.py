"""A point landmark seen by range and bearing (45)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from slam.geometry import wrap
from slam.linalg import factor22, largest_eigenvalue22, times22
from slam.types import Floats, ObservationNoise, Params


@register_jitable
def _span(near: Any, far: Any, towards: Any, half: Any) -> Any:
    """The least and the largest r cos(angle) with near <= r <= far and |angle - towards| <= half."""
    a, b = math.cos(towards - half), math.cos(towards + half)
    low = -1.0 if abs(wrap(towards - math.pi)) <= half else min(a, b)
    high = 1.0 if abs(wrap(towards)) <= half else max(a, b)
    return low * (near if low > 0.0 else far), high * (far if high > 0.0 else near)


class Point(NamedTuple):
    """State theta = (x, y) [m, m]; observation z = (range [m], bearing [rad]), the bearing from the robot's heading.

    The paper prints (45) with d = robot minus landmark under the root; the bearing must be that of the landmark seen
    from the robot, so here d = landmark minus robot throughout.
    """

    dim = 2
    observation = 2
    grows = False
    merges = False

    @staticmethod
    def believed(z: Floats, params: Params) -> ObservationNoise:
        """Independent range and bearing; a landmark is a point indeed."""
        R = np.zeros((len(z), 2, 2))
        R[:, 0, 0], R[:, 1, 1] = params.believed.range**2, params.believed.bearing**2
        return ObservationNoise(R, np.zeros((2, 2)))

    @staticmethod
    def of_known(R: ObservationNoise, params: Params) -> ObservationNoise:
        """`inflate_r` times it."""
        return ObservationNoise(params.inflate_r * R.sensor, R.model)

    @staticmethod
    def total(feature: Any, R: Any, G_theta: Any, model: Any) -> Any:
        """Its own."""
        return R

    @staticmethod
    def innovation(feature: Any, theta: Any, s: Any, z: Any) -> Any:
        """v = z - g(s, theta) (23, 45) with the bearing wrapped; G_s, G_theta (24).  Range must not be zero."""
        dx, dy = theta[0] - s[0], theta[1] - s[1]
        d2 = dx * dx + dy * dy
        d = math.sqrt(d2)
        v = (z[0] - d, wrap(z[1] - math.atan2(dy, dx) + s[2]))
        G_s = ((-dx / d, -dy / d, 0.0), (dy / d2, -dx / d2, -1.0))
        G_theta = ((dx / d, dy / d), (-dy / d2, dx / d2))
        return v, G_s, G_theta

    @staticmethod
    def observable(feature: Any, s: Any, P: Any, z: Any, v: Any, G_s: Any, R: Any) -> Any:
        """As it is: a point is observed in all its coordinates."""
        return G_s

    @staticmethod
    def displacement(feature: Any, s: Any, P: Any, z: Any, V: Any, R: Any, normal: Any) -> Any:
        """Of N(0, V)."""
        return times22(factor22(V), normal)

    @staticmethod
    def inverse(feature: Any, s: Any, z: Any) -> Any:
        """theta = f(s, z) (33) and its Jacobians F_s, F_z (35)."""
        c, q = math.cos(s[2] + z[1]), math.sin(s[2] + z[1])
        theta = (s[0] + z[0] * c, s[1] + z[0] * q)
        F_s = ((1.0, 0.0, -z[0] * q), (0.0, 1.0, z[0] * c))
        F_z = ((c, -z[0] * q), (q, z[0] * c))
        return theta, F_s, F_z

    @staticmethod
    def draw(feature: Any, theta: Any, delta: Any) -> Any:
        """The uncertain coordinates of a point are its own x and y."""
        return (theta[0] + delta[0], theta[1] + delta[1])

    @staticmethod
    def compatible(feature: Any, theta: Any, s: Any, P: Any, z: Any) -> Any:
        """The distance (25) says all."""
        return True

    @staticmethod
    def extend(feature: Any, theta: Any, s: Any, z: Any) -> Any:
        """A point is seen whole or not at all."""
        return (theta[0], theta[1])

    @staticmethod
    def spread(feature: Any, theta: Any, Sigma: Any) -> Any:
        """The trace bounds the largest eigenvalue from above: a search may look a little too far, never too near."""
        return math.sqrt(Sigma[0][0] + Sigma[1][1])

    @staticmethod
    def extent(feature: Any, theta: Any) -> Any:
        """A point covers itself."""
        return theta[0], theta[1], theta[0], theta[1]

    @staticmethod
    def region(feature: Any, s: Any, P: Any, z: Any, R: Any, model: Any, reach: Any) -> Any:
        """Box around a sector of an annulus, not linearised: a heading error of 0.3 rad is far off its tangent at 20 m.

        A distance (25) is at least v^2 / V of the range alone and of the bearing alone.  With d the range of the
        feature and `spread` the largest deviation of the position, V of the range is at most spread^2 + R_r; that of
        the bearing, (spread / d + deviation of the heading)^2 + R_b.  A Sigma of deviation q adds at most reach q to
        the bounds on the range and reach q / d to those on the bearing: no point is more than (2 + half) reach q
        outside.
        """
        spread = math.sqrt(max(largest_eigenvalue22(P), 0.0))
        margin = reach * math.sqrt(spread * spread + R[0][0])
        near, far = z[0] - margin, z[0] + margin
        if near <= 0.0:  # the robot may stand on it, and see it in any direction
            return (s[0] - far, s[1] - far, s[0] + far, s[1] + far), reach
        turn = spread / near + math.sqrt(max(P[2][2], 0.0))
        half = min(reach * math.sqrt(turn * turn + R[1][1]), math.pi)
        x0, x1 = _span(near, far, s[2] + z[1], half)
        y0, y1 = _span(near, far, s[2] + z[1] - 0.5 * math.pi, half)
        return (s[0] + x0, s[1] + y0, s[0] + x1, s[1] + y1), (2.0 + half) * reach
