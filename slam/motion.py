"""Motion models h (5): what a control tick does to a pose, with its exact Jacobians (21, 22).

A model is a `NamedTuple`; its instance travels in the `Frame` (see `slam.features` for why).  Static functions over
scalars and tuples:

    propagate(motion, s, u, dt) -> s' (3,), H_s (3, 3), H_u (3, m)       h and its Jacobians
    deviation(motion, u, noise) -> (T, m) standard deviations of controls u (T, m)

The covariance of the noise on the pose is H_u diag(deviation^2) H_u^T for each tick: the paper's Q (7) is on the pose,
the noise of every real robot is on its controls.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload, register_jitable

from slam.geometry import wrap
from slam.types import Floats, Noise


class Unicycle(NamedTuple):
    """Controls (v, w) [m/s, rad/s], constant during a tick: the exact arc, written as chord and mid-heading."""

    controls = 2

    @staticmethod
    def propagate(motion: Any, s: Any, u: Any, dt: Any) -> Any:
        """h(s, u): the chord is v dt sinc(w dt / 2), in the direction of the heading half way."""
        half = 0.5 * u[1] * dt
        if abs(half) < 1e-4:  # series: sin(a)/a and its derivative lose digits near zero
            sinc, dsinc = 1.0 - half * half / 6.0, -half / 3.0
        else:
            sinc = math.sin(half) / half
            dsinc = (math.cos(half) - sinc) / half
        c, q = math.cos(s[2] + half), math.sin(s[2] + half)
        chord = u[0] * dt * sinc
        dchord = 0.5 * u[0] * dt * dt * dsinc  # d chord / d w
        s_new = (s[0] + chord * c, s[1] + chord * q, wrap(s[2] + u[1] * dt))
        H_s = ((1.0, 0.0, -chord * q), (0.0, 1.0, chord * c), (0.0, 0.0, 1.0))
        H_u = (
            (dt * sinc * c, dchord * c - 0.5 * dt * chord * q),
            (dt * sinc * q, dchord * q + 0.5 * dt * chord * c),
            (0.0, dt),
        )
        return s_new, H_s, H_u

    @staticmethod
    def deviation(motion: Unicycle, u: Floats, noise: Noise) -> Floats:
        """(speed, turn) for every tick."""
        return np.broadcast_to(np.array([noise.speed, noise.turn]), u.shape)


class Ackermann(NamedTuple):
    """Controls (v, G): speed of the front wheel [m/s] and steering angle [rad]; the pose is of a point of the vehicle.

    That point lies `ahead` of the rear axle and `left` of the centre line.  At the front axle (ahead = wheelbase, left
    = 0) this is the vehicle of the paper's baseline code: x' = v cos(heading + G), heading' = v sin(G) / wheelbase,
    integrated as that code does, by one Euler step a tick.  A wheel speed at the rear axle is v cos(G).
    """

    wheelbase: float = 4.0
    """[m]"""
    ahead: float = 4.0
    """[m]"""
    left: float = 0.0
    """[m]"""

    controls = 2

    @staticmethod
    def propagate(motion: Any, s: Any, u: Any, dt: Any) -> Any:
        """h(s, u): the rear axle rolls with v cos(G), the reference point swings about it."""
        c, q = math.cos(s[2]), math.sin(s[2])
        cG, sG = math.cos(u[1]), math.sin(u[1])
        ax = motion.ahead * q + motion.left * c  # minus d(arm)/d(heading) . x
        ay = motion.ahead * c - motion.left * q
        turn = dt * u[0] / motion.wheelbase  # heading change per unit of sin(G)
        dx = dt * u[0] * cG * c - turn * sG * ax
        dy = dt * u[0] * cG * q + turn * sG * ay
        s_new = (s[0] + dx, s[1] + dy, wrap(s[2] + turn * sG))
        H_s = ((1.0, 0.0, -dy), (0.0, 1.0, dx), (0.0, 0.0, 1.0))
        per_metre = 1.0 / motion.wheelbase
        H_u = (
            (dt * (cG * c - per_metre * sG * ax), -dt * u[0] * sG * c - turn * cG * ax),
            (dt * (cG * q + per_metre * sG * ay), -dt * u[0] * sG * q + turn * cG * ay),
            (dt * per_metre * sG, turn * cG),
        )
        return s_new, H_s, H_u

    @staticmethod
    def deviation(motion: Ackermann, u: Floats, noise: Noise) -> Floats:
        """(speed, steering) for every tick."""
        return np.broadcast_to(np.array([noise.speed, noise.turn]), u.shape)


@register_jitable
def _after(s: Any, u: Any) -> Any:
    """s (+) u for an increment u (3,), and its Jacobians by both."""
    c, q = math.cos(s[2]), math.sin(s[2])
    dx, dy = c * u[0] - q * u[1], q * u[0] + c * u[1]
    s_new = (s[0] + dx, s[1] + dy, wrap(s[2] + u[2]))
    J_s = ((1.0, 0.0, -dy), (0.0, 1.0, dx), (0.0, 0.0, 1.0))
    J_u = ((c, -q, 0.0), (q, c, 0.0), (0.0, 0.0, 1.0))
    return s_new, J_s, J_u


class Odometry(NamedTuple):
    """Controls are increments (dx, dy, dphi) [m, m, rad] in the robot's frame, as wheel odometry integrates them.

    What is wrong with them is given in parts of `Noise.odometry`, the deviation ahead after one metre (ours).
    """

    turn_per_metre: float = 0.1
    """[rad/m] of the heading, for the way."""
    turn_per_radian: float = 1.0
    """[rad/rad] of the heading, for the turn."""
    lateral: float = 1.0
    """Sideways, for the way."""
    slip: float = 0.0
    """[m/rad] Ahead and sideways, for the turn."""
    walk: bool = False
    """Whether errors of one increment say nothing of the next one: then variances grow with the motion, however many
    increments there are of it; if not, the deviation of each is in proportion to it."""

    controls = 3

    @staticmethod
    def propagate(motion: Any, s: Any, u: Any, dt: Any) -> Any:
        """h(s, u) = s (+) u; dt does not matter."""
        return _after(s, u)

    @staticmethod
    def deviation(motion: Odometry, u: Floats, noise: Noise) -> Floats:
        """Of each increment, for its way and its turn."""
        way, turned = np.hypot(u[:, 0], u[:, 1]), np.abs(u[:, 2])
        if motion.walk:
            way, turned = np.sqrt(way), np.sqrt(turned)
        ahead = np.hypot(way, motion.slip * turned)
        sideways = np.hypot(motion.lateral * way, motion.slip * turned)
        heading = np.hypot(motion.turn_per_radian * turned, motion.turn_per_metre * way)
        return noise.odometry * np.stack([ahead, sideways, heading], axis=1)


class Matched(NamedTuple):
    """Increments that scan matching has corrected, with errors that depend on each other (5.2).

    In a corridor the error lies along the corridor, whichever way the robot looks.  So the controls are not the
    increment u itself but w with u = L w, whose errors are independent: the covariance of u is L D L^T, with L lower
    triangular and ones on its diagonal.  That exists for every covariance, singular ones included.
    """

    sigma_0: float = 0.0
    """[m] Deviations of the three controls, the square roots of D."""
    sigma_1: float = 0.0
    sigma_2: float = 0.0
    l_10: float = 0.0
    """What is below the diagonal of L."""
    l_20: float = 0.0
    l_21: float = 0.0

    controls = 3

    @staticmethod
    def propagate(motion: Any, s: Any, u: Any, dt: Any) -> Any:
        """h(s, w) = s (+) L w; dt does not matter."""
        turn = motion.l_20 * u[0] + motion.l_21 * u[1] + u[2]
        s_new, H_s, J = _after(s, (u[0], motion.l_10 * u[0] + u[1], turn))
        H_u = (  # J L
            (J[0][0] + J[0][1] * motion.l_10, J[0][1], 0.0),
            (J[1][0] + J[1][1] * motion.l_10, J[1][1], 0.0),
            (motion.l_20, motion.l_21, 1.0),
        )
        return s_new, H_s, H_u

    @staticmethod
    def deviation(motion: Matched, u: Floats, noise: Noise) -> Floats:
        """What the matching said; the believed noise of the odometry is in that already."""
        return np.broadcast_to(np.array([motion.sigma_0, motion.sigma_1, motion.sigma_2]), u.shape)


def matched(u: Floats, covariance: Floats) -> tuple[Matched, Floats]:
    """The model and its controls (3,) for an increment u (3,) [m, m, rad] with a covariance (3, 3)."""
    L, D = np.eye(3), np.zeros(3)
    for j in range(3):  # L D L^T; a control without error takes nothing of the others
        D[j] = max(covariance[j, j] - float(L[j, :j] ** 2 @ D[:j]), 0.0)
        for i in range(j + 1, 3):
            L[i, j] = (covariance[i, j] - float(L[i, :j] * L[j, :j] @ D[:j])) / D[j] if D[j] > 0.0 else 0.0
    a, b, c = np.sqrt(D).tolist()
    model = Matched(a, b, c, float(L[1, 0]), float(L[2, 0]), float(L[2, 1]))
    return model, np.array(np.linalg.solve(L, u), float)


def propagate(motion: Any, s: Any, u: Any, dt: Any) -> Any:
    """s' (3,), H_s (3, 3), H_u (3, m) of one control tick of `dt` seconds (5, 21, 22)."""
    return type(motion).propagate(motion, s, u, dt)


@overload(propagate)
def _propagate(motion: Any, s: Any, u: Any, dt: Any) -> Any:
    return motion.instance_class.propagate


def deviation(motion: Any, u: Floats, noise: Noise) -> Floats:
    """(T, m) standard deviations of the controls u (T, m)."""
    return type(motion).deviation(motion, u, noise)
