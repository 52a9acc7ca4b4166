"""A wall, seen in part by a laser: a segment in a frame of its own (4.1).

The paper refers to its own variant of the SPmap (J. A. Castellanos, J. M. M. Montiel, J. Neira, J. D. Tardos, IEEE
Trans. Robotics and Automation 15(5), 1999).  The frame stands at the centroid of the points that made the wall, with
its x axis along it; a wall looks the same from everywhere along that axis, so only two coordinates are observable: the
lateral offset and the angle.  At the centroid the two are uncorrelated.  Where the wall ends is kept beside, by what
was seen of it.

With a robot to the left of a wall, its x axis points counter-clockwise around the robot, so the two faces of a thin
wall are two features (Fig. 11).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from slam.geometry import wrap
from slam.linalg import (
    add22,
    determinant22,
    distance2,
    dot3,
    kalman_feature,
    largest_eigenvalue22,
    sandwich22,
    times33,
)
from slam.types import Floats, ObservationNoise, Params

HIDDEN, OUT_OF_REACH, EDGE, CORNER = 0, 1, 2, 3
"""What ends an observed piece: something nearer hides the rest; the scan or its range ends there; the wall itself ends,
with free space behind; it meets another wall.  From `EDGE` on it is an end of the wall."""

STRAIGHT = (0.005, math.radians(0.05))
"""[m, rad] Deviation of a wall from the line that is fitted to a piece of it (ours): what no sensor noise explains."""

LEVER = 20.0
"""[m] of a wall over which the error of its angle counts."""

FLUSH = 0.1
"""[m] Walls that stand farther apart are two, whatever else is allowed to them: a closed door, a shelf (ours)."""

SAME_END = 0.3
"""[m] within which an end that was seen is the end that the map has."""


@register_jitable  # plain Python to Python, as `wrap` is
def _placed(s: Any, x: Any, y: Any) -> Any:
    """(x, y) of the robot's frame in the world."""
    c, q = math.cos(s[2]), math.sin(s[2])
    return s[0] + c * x - q * y, s[1] + q * x + c * y


@register_jitable
def _offset_row(phi: Any, dx: Any, dy: Any) -> Any:
    """How the lateral offset from a wall along phi, of what is (dx, dy) from the robot, changes with the pose."""
    c, q = math.cos(phi), math.sin(phi)
    return -q, c, q * dy + c * dx


@register_jitable
def _told(P: Any, R: Any) -> Any:
    """The share of an innovation of the angle by which the heading is corrected on it alone."""
    return P[2][2] / (P[2][2] + R[1][1]) if P[2][2] > 0.0 else 0.0


@register_jitable
def stretch(theta: Any, place: Any, a: Any, b: Any) -> Any:
    """From where to where [m] along the axis of a wall a piece reaches that has its ends a, b in the frame `place`."""
    middle = math.cos(theta[2]) * (place[0] - theta[0]) + math.sin(theta[2]) * (place[1] - theta[1])
    turned = math.cos(place[2] - theta[2])
    return middle + min(turned * a, turned * b), middle + max(turned * a, turned * b)


@register_jitable
def _lies_along(theta: Any, place: Any, z: Any) -> Any:
    """Whether a piece z with its frame at `place` has `SAME_END` or more of its length in common with a wall."""
    low, high = stretch(theta, place, z[3], z[4])
    return min(high, theta[4]) - max(low, theta[3]) >= SAME_END


@register_jitable
def _across(theta: Any, x: Any, y: Any) -> Any:
    """How far [m] the point (x, y) is along the axis of a wall, and how far to the left of it."""
    c, q = math.cos(theta[2]), math.sin(theta[2])
    dx, dy = x - theta[0], y - theta[1]
    return c * dx + q * dy, c * dy - q * dx


@register_jitable
def _lever(t: Any) -> Any:
    """What the lateral offset and the angle of a wall are, t along it, by those at its origin."""
    return (1.0, t), (0.0, 1.0)


class Wall(NamedTuple):
    """State theta (8,) and observation z (11,).

    theta = (x, y, phi, a, b, end_a, end_b, seen): the frame in the world [m, m, rad], the ends a <= b along its x axis
    [m], 1 for each end that is known to be one and 0 for one that is only as far as anybody saw, and how often the wall
    was seen.  z = (x, y, phi, a, b, var_lateral, var_angle, end_a, end_b, beams, axis): the same of the piece that is
    seen, in the robot's frame, with the variances of its two observable coordinates [m^2, rad^2], why it ends
    (`HIDDEN` ...), from how many beams it was made, and its direction [rad] by all pieces that are parallel to it.
    """

    slack: float = 0.5
    """[m] a piece may lie beyond what was seen of a wall and still be of it, besides the deviation along it."""
    turn: float = 0.6
    """[rad] that a piece and its wall may differ by: which side is seen is never in doubt."""

    dim = 8
    observation = 11
    grows = True
    merges = True

    @staticmethod
    def believed(z: Floats, params: Params) -> ObservationNoise:
        """That of the fitted lines, (lateral, angle); and `STRAIGHT`, or lower floors, since no wall is a perfect
        line."""
        R = np.zeros((len(z), 2, 2))
        R[:, 0, 0], R[:, 1, 1] = z[:, 5], z[:, 6]
        floors = (params.floor_lateral, params.floor_angle)
        return ObservationNoise(R, np.diag(np.minimum(floors, STRAIGHT) ** 2))

    @staticmethod
    def of_known(R: ObservationNoise, params: Params) -> ObservationNoise:
        """`inflate_r` times it, with the floors whole (ours).

        A frozen wall is as wrong for ever as when it was drawn.  To believe a few millimetres of it makes a particle
        lose walls that it knows.
        """
        model = np.diag([params.floor_lateral**2, params.floor_angle**2])
        return ObservationNoise(params.inflate_r * R.sensor, params.inflate_r * model)

    @staticmethod
    def total(feature: Any, R: Any, G_theta: Any, model: Any) -> Any:
        """With the model's error, seen from where along the wall the piece is: far off, an angle is a lateral offset.

        A wall that is drawn once has a frozen angle error; 0.1 degrees are 5 cm after 30 m.  It grows no more beyond
        `LEVER`: who is that far off has had time to make a new wall.
        """
        t = min(max(-G_theta[0][1], -LEVER), LEVER)
        return add22(R, sandwich22(((-1.0, -t), (0.0, -1.0)), model))

    @staticmethod
    def innovation(feature: Any, theta: Any, s: Any, z: Any) -> Any:
        """v = -B ((-) theta (+) s (+) z): minus the lateral offset and the angle of the piece in the wall's frame."""
        px, py = _placed(s, z[0], z[1])
        c, q = math.cos(theta[2]), math.sin(theta[2])
        dx, dy = px - theta[0], py - theta[1]
        t = c * dx + q * dy  # where along the wall
        v = (q * dx - c * dy, wrap(theta[2] - s[2] - z[2]))
        G_s = (_offset_row(theta[2], px - s[0], py - s[1]), (0.0, 0.0, 1.0))
        G_theta = ((-1.0, -t), (0.0, -1.0))
        return v, G_s, G_theta

    @staticmethod
    def observable(feature: Any, s: Any, P: Any, z: Any, v: Any, G_s: Any, R: Any) -> Any:
        """The lateral row of G_s is that of a wall along the direction that is seen (ours).

        The walls of a particle's map are frozen a little wrong.  Two parallel walls at different angles would say where
        along the corridor the robot is, which neither of them knows.  Parallel pieces of a scan have one and the same
        `axis`, or nearly, and the heading as the piece's own angle corrects it turns that into the world: so a scan
        tells nothing of what it does not show, and many, each with an axis a little off, little.  The rule is that of
        G. P. Huang, A. I. Mourikis, S. I. Roumeliotis, "Observability-based rules for designing consistent EKF SLAM
        estimators", Int. J. Robotics Research 29(5), 2010.
        """
        px, py = _placed(s, z[0], z[1])
        return _offset_row(s[2] + _told(P, R) * v[1] + z[10], px - s[0], py - s[1]), G_s[1]

    @staticmethod
    def displacement(feature: Any, s: Any, P: Any, z: Any, V: Any, R: Any, normal: Any) -> Any:
        """Of N(0, V) with the lateral row of `observable`: the angle first, since the row depends on it.

        V has the row of the mean.  Drawn with another row than the pose is corrected with, walls would tell of what
        they do not show.
        """
        angle = math.sqrt(V[1][1]) * normal[1]
        px, py = _placed(s, z[0], z[1])
        row = _offset_row(s[2] + _told(P, R) * angle + z[10], px - s[0], py - s[1])
        P_row = times33(P, row)
        lateral, both = dot3(row, P_row) + R[0][0], P_row[2] + R[0][1]
        left = max(lateral - both * both / V[1][1], 0.0) if V[1][1] > 0.0 else lateral
        mean = both / V[1][1] * angle if V[1][1] > 0.0 else 0.0
        return mean + math.sqrt(left) * normal[0], angle

    @staticmethod
    def inverse(feature: Any, s: Any, z: Any) -> Any:
        """theta = s (+) z (33); F_s, F_z (35) of its lateral offset and angle: its place along itself is no matter."""
        px, py = _placed(s, z[0], z[1])
        phi = wrap(s[2] + z[2])
        theta = (px, py, phi, z[3], z[4], 1.0 if z[7] >= EDGE else 0.0, 1.0 if z[8] >= EDGE else 0.0, 1.0)
        F_s = (_offset_row(phi, px - s[0], py - s[1]), (0.0, 0.0, 1.0))
        return theta, F_s, ((1.0, 0.0), (0.0, 1.0))

    @staticmethod
    def draw(feature: Any, theta: Any, delta: Any) -> Any:
        """Displaced sideways and turned about the origin of its frame."""
        x, y = theta[0] - math.sin(theta[2]) * delta[0], theta[1] + math.cos(theta[2]) * delta[0]
        return (x, y, wrap(theta[2] + delta[1]), theta[3], theta[4], theta[5], theta[6], theta[7])

    @staticmethod
    def compatible(feature: Any, theta: Any, s: Any, P: Any, z: Any) -> Any:
        """The longitudinal test: the piece shows this side of the wall, and overlaps it or lies just beyond its end.

        Beyond an end that is known there is no slack.  Of two deviations of the pose along the wall no more than
        `SAME_END` counts: that of all the way from the start says little of how far off a wall is that was made a
        moment ago, and with half a metre of it, walls would be joined across the doors between them.
        """
        if abs(wrap(theta[2] - s[2] - z[2])) > feature.turn:
            return False
        px, py = _placed(s, z[0], z[1])
        c, q = math.cos(theta[2]), math.sin(theta[2])
        t = c * (px - theta[0]) + q * (py - theta[1])
        along = (c, q, q * (px - s[0]) - c * (py - s[1]))  # dt/ds
        room = min(2.0 * math.sqrt(max(dot3(along, times33(P, along)), 0.0)), SAME_END)
        before = theta[3] - (t + z[4])
        beyond = (t + z[3]) - theta[4]
        return before <= room + feature.slack * (1.0 - theta[5]) and beyond <= room + feature.slack * (1.0 - theta[6])

    @staticmethod
    def extend(feature: Any, theta: Any, s: Any, z: Any) -> Any:
        """The wall with all that is now known of its ends: the union of the pieces, up to an end that was seen."""
        c, q = math.cos(theta[2]), math.sin(theta[2])
        turned = math.cos(wrap(s[2] + z[2] - theta[2]))
        px, py = _placed(s, z[0], z[1])
        t = c * (px - theta[0]) + q * (py - theta[1])
        a, b, end_a, end_b = theta[3], theta[4], theta[5], theta[6]
        if end_a == 0.0:
            a = min(a, t + turned * z[3])
            end_a = 1.0 if z[7] >= EDGE and t + turned * z[3] - a <= SAME_END else 0.0
        if end_b == 0.0:
            b = max(b, t + turned * z[4])
            end_b = 1.0 if z[8] >= EDGE and b - t - turned * z[4] <= SAME_END else 0.0
        return (theta[0], theta[1], theta[2], a, b, end_a, end_b, theta[7] + 1.0)

    @staticmethod
    def distance(feature: Any, theta: Any, Sigma: Any, other: Any, Sigma_other: Any, s: Any, z: Any, model: Any) -> Any:
        """Of the other wall's lateral offset and angle in the frame of the first, beside the piece (ours).

        Each wall may be as wrong as `model` and its Sigma say, seen from where along it the piece is.  Infinite unless
        the piece lies along both, they are flush there, and neither goes on beyond an end of the other one that was
        seen: a piece that reaches across a door does not make one wall of two.
        """
        px, py = _placed(s, z[0], z[1])
        place = (px, py, s[2] + z[2])
        if not (_lies_along(theta, place, z) and _lies_along(other, place, z)):
            return math.inf
        a, b = stretch(theta, other, other[3], other[4])
        before, beyond = theta[3] - a, b - theta[4]  # how far the other one goes on beyond the first
        if (theta[5] > 0.0 and before > SAME_END) or (other[5] > 0.0 and -before > SAME_END):
            return math.inf
        if (theta[6] > 0.0 and beyond > SAME_END) or (other[6] > 0.0 and -beyond > SAME_END):
            return math.inf
        t, _ = _across(other, px, py)
        x, y = other[0] + t * math.cos(other[2]), other[1] + t * math.sin(other[2])
        along, lateral = _across(theta, x, y)
        if abs(lateral) > FLUSH:
            return math.inf
        V = add22(sandwich22(_lever(along), Sigma), sandwich22(_lever(t), Sigma_other))
        V = add22(V, sandwich22(_lever(min(max(along, -LEVER), LEVER)), model))
        V = add22(V, sandwich22(_lever(min(max(t, -LEVER), LEVER)), model))
        return distance2((lateral, wrap(other[2] - theta[2])), V)

    @staticmethod
    def united(feature: Any, theta: Any, Sigma: Any, other: Any, Sigma_other: Any) -> Any:
        """The product of their Gaussians, from the end of one to the end of the other, seen as often as both (ours).

        A frozen wall (Sigma = 0) stays where it is: the pose and all later walls of its particle lean on it.
        """
        t, _ = _across(other, theta[0], theta[1])
        x, y = other[0] + t * math.cos(other[2]), other[1] + t * math.sin(other[2])
        _, lateral = _across(theta, x, y)
        R = sandwich22(_lever(t), Sigma_other)
        V = add22(Sigma, R)
        delta, fused = (0.0, 0.0), Sigma
        if determinant22(V) > 0.0:
            v = (lateral, wrap(other[2] - theta[2]))
            delta, fused = kalman_feature(Sigma, v, ((1.0, 0.0), (0.0, 1.0)), R, V)
        x, y = theta[0] - math.sin(theta[2]) * delta[0], theta[1] + math.cos(theta[2]) * delta[0]
        a, b = stretch(theta, other, other[3], other[4])
        a = theta[3] if theta[5] > 0.0 else min(theta[3], a)
        b = theta[4] if theta[6] > 0.0 else max(theta[4], b)
        end_a, end_b = max(theta[5], other[5]), max(theta[6], other[6])
        return (x, y, wrap(theta[2] + delta[1]), a, b, end_a, end_b, theta[7] + other[7]), fused

    @staticmethod
    def extent(feature: Any, theta: Any) -> Any:
        """Box around the two ends."""
        c, q = math.cos(theta[2]), math.sin(theta[2])
        x0, x1 = theta[0] + c * theta[3], theta[0] + c * theta[4]
        y0, y1 = theta[1] + q * theta[3], theta[1] + q * theta[4]
        return min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)

    @staticmethod
    def spread(feature: Any, theta: Any, Sigma: Any) -> Any:
        """Deviation of its lateral offset at the farther end, with a metre more of lever arm."""
        lever = 1.0 + max(abs(theta[3]), abs(theta[4]))
        return math.sqrt(max(Sigma[0][0], 0.0)) + lever * math.sqrt(max(Sigma[1][1], 0.0))

    @staticmethod
    def region(feature: Any, s: Any, P: Any, z: Any, R: Any, model: Any, reach: Any) -> Any:
        """Box around the piece as seen from the mean pose, with room for all that gate and `compatible` allow.

        A distance (25) is at least v^2 / V of the lateral offset alone and of the angle alone.  With `arm` from the
        robot to the centroid, the deviation of the pose shifts the piece by at most `shift` in any direction.  A wall
        of deviation q (`spread`) is farther from the line of the piece by at most reach q (1 + |t| beyond its end), and
        by reach q half at the end of the piece, where `half` is the longer half of it.
        """
        arm = math.hypot(z[0], z[1])
        half = max(abs(z[3]), abs(z[4]))
        heading = math.sqrt(max(P[2][2], 0.0))
        shift = math.sqrt(max(largest_eigenvalue22(P), 0.0)) + arm * heading
        room = feature.slack + 2.0 * shift
        bent = math.sqrt(model[0][0]) + LEVER * math.sqrt(model[1][1])
        turned = min(reach * math.sqrt(heading * heading + R[1][1] + model[1][1]), feature.turn)
        margin = room + reach * math.sqrt(shift * shift + R[0][0] + bent * bent) + half * turned
        px, py = _placed(s, z[0], z[1])
        c, q = math.cos(s[2] + z[2]), math.sin(s[2] + z[2])
        x0, x1, y0, y1 = px + c * z[3], px + c * z[4], py + q * z[3], py + q * z[4]
        box = (min(x0, x1) - margin, min(y0, y1) - margin, max(x0, x1) + margin, max(y0, y1) + margin)
        return box, reach * (1.0 + 2.0 * half + room)


def ends(theta: Floats) -> Floats:
    """(n, 2, 2) [m] the two ends of walls theta (n, 8) in the world."""
    axis = np.stack([np.cos(theta[:, 2]), np.sin(theta[:, 2])], axis=-1)
    return theta[:, None, :2] + theta[:, 3:5, None] * axis[:, None, :]
