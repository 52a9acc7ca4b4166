"""What is wrong with the odometry of a log, learned from what matching its own scans says of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slam.geometry import compose, wrap
from slam.perception.matching import FREEDOM, STANDARD, START, Matcher, match
from slam.types import Floats, Scan


class OdometryNoise(NamedTuple):
    """What is wrong with increments of odometry.

    Variances grow in proportion to the way and to the turn, so that it does not matter how often somebody reads the
    odometer: the deviation after 4 m is twice that after 1 m.
    """

    along: float = 0.1
    """[m] deviation in the direction of travel, after one metre."""
    lateral: float = 0.1
    """[m] deviation across it, after one metre."""
    slip: float = 0.1
    """[m] deviation in each direction, after turning by one radian."""
    turn_per_metre: float = 0.15
    """[rad] deviation of the heading, after one metre."""
    turn_per_radian: float = 0.2
    """[rad] deviation of the heading, after turning by one radian."""

    def covariance(self, u: Floats) -> Floats:
        """Q (3, 3) of an increment u (3,), in the robot's frame before it."""
        travel, turned = math.hypot(u[0], u[1]), abs(u[2])
        c, q = (u[0] / travel, u[1] / travel) if travel > 0.0 else (1.0, 0.0)
        along = self.along**2 * travel + self.slip**2 * turned + STILL[0] ** 2
        lateral = self.lateral**2 * travel + self.slip**2 * turned + STILL[0] ** 2
        Q = np.zeros((3, 3))
        Q[0, 0], Q[1, 1] = c * c * along + q * q * lateral, q * q * along + c * c * lateral
        Q[0, 1] = Q[1, 0] = c * q * (along - lateral)
        Q[2, 2] = self.turn_per_metre**2 * travel + self.turn_per_radian**2 * turned + STILL[1] ** 2
        return Q


STILL = (1e-3, 1e-3)
"""[m], [rad] Deviations of an increment of a robot that stands still."""


def odometry_noise(
    scans: Sequence[Scan], increments: Floats, settings: Matcher = STANDARD, believed: OdometryNoise | None = None
) -> OdometryNoise:
    """What is wrong with the odometry of a log, by what its scans show.

    increments (n, 3) lead from each scan to the next, the first of them to the first scan.  Where scans show the pose
    well, the differences between match and odometry are summed over stretches of some metres.  Over those what is
    systematic in the odometry outgrows what is random in it, and in the matches, and counts as deviation.  The
    variances are those of the greatest likelihood of a Student distribution, which a few wild stretches do not impress.
    `believed` is for the matching that this needs.
    """
    believed = believed or OdometryNoise()
    stretches: list[_Stretch] = []
    for first, last in _pieces(increments, settings):
        stretches += _stretches(scans, increments, first, last, settings, believed)
    travel, turned, heading, seen_travel, seen_turned, along, lateral = np.array(stretches).reshape(-1, 7).T
    seen = seen_travel + seen_turned > 0.0
    seen_travel, seen_turned, along, lateral = seen_travel[seen], seen_turned[seen], along[seen], lateral[seen]
    along_per_metre, slip = _deviations(along, seen_travel, seen_turned, believed.along, believed.slip)
    sideways, skid = _deviations(lateral, seen_travel, seen_turned, believed.lateral, believed.slip)
    turns = _deviations(heading, travel, turned, believed.turn_per_metre, believed.turn_per_radian)
    return OdometryNoise(along_per_metre, sideways, math.hypot(slip, skid) / math.sqrt(2.0), *turns)


class _Stretch(NamedTuple):
    """Sums over the steps of a stretch; the last four over those where the scans show the place well."""

    travel: float
    turned: float
    heading: float
    seen_travel: float
    seen_turned: float
    along: float
    lateral: float


LEARNING = 600
"""Steps that are matched to learn the noise of an odometry."""

PIECE = 40
"""Steps in a row."""

LONG = (5.0, 3.0)
"""[m], [rad] of way and of turn, either of which makes a stretch."""


def _pieces(increments: Floats, settings: Matcher) -> list[tuple[int, int]]:
    """(first, last) scans of pieces of the log, spread over all that is not standing still."""
    moved = np.hypot(increments[:, 0], increments[:, 1]) / settings.spacing + np.abs(increments[:, 2]) / settings.turn
    way = np.cumsum(np.minimum(moved, 1.0))
    if not len(way):
        return []
    count = max(1, min(LEARNING, math.ceil(way[-1])) // PIECE)
    starts = np.searchsorted(way, np.linspace(0.0, way[-1], count + 1)[:-1])
    ends = np.searchsorted(way, way[starts] + PIECE)
    return [(int(a), int(min(b, len(way) - 1))) for a, b in zip(starts, ends, strict=True)]


def _stretches(
    scans: Sequence[Scan], increments: Floats, first: int, last: int, settings: Matcher, believed: OdometryNoise
) -> list[_Stretch]:
    """What odometry and matches differ by, from scan `first` to `last`."""
    track, _ = match(START, scans[first], np.zeros(3), np.eye(3), settings)
    found, sums, u = [], np.zeros(7), np.zeros(3)
    for k in range(first + 1, last + 1):
        u = compose(u, increments[k])
        travel, turned = math.hypot(u[0], u[1]), abs(u[2])
        if travel < settings.spacing and turned < settings.turn:
            continue
        Q = believed.covariance(u)
        track, step = match(track, scans[k], u, Q, settings)
        if step.used:
            e = np.array([step.u[0] - u[0], step.u[1] - u[1], wrap(step.u[2] - u[2])])
            c, q = (u[0] / travel, u[1] / travel) if travel > 0.0 else (1.0, 0.0)
            place = np.array([travel, turned, c * e[0] + q * e[1], c * e[1] - q * e[0]])
            well = np.linalg.eigvalsh(step.covariance[:2, :2])[1] < SEEN * np.linalg.eigvalsh(Q[:2, :2])[0]
            sums += [travel, turned, e[2], *(place if well else np.zeros(4))]
        if sums[0] >= LONG[0] or sums[1] >= LONG[1]:
            found.append(_Stretch(*sums))
            sums = np.zeros(7)
        u = np.zeros(3)
    return found


SEEN = 0.25
"""Of the least variance of the odometry in the plane, the share that is left by a match which shows the place well."""


def _deviations(r: Floats, travel: Floats, turned: Floats, per_metre: float, per_radian: float) -> tuple[float, float]:
    """Deviations after a metre and after a radian, of sums r (n,) over stretches of `travel` [m] and `turned` [rad].

    The guess counts for one more stretch of a metre, and one of a radian.
    """
    squares = np.append(r**2, [per_metre**2, per_radian**2])
    travel, turned = np.append(travel, [1.0, 0.0]), np.append(turned, [0.0, 1.0])
    grid = np.geomspace(1e-3, 3.0, 80) ** 2
    variance = grid[:, None, None] * travel + grid[None, :, None] * turned
    cost = np.sum(np.log(variance) + (FREEDOM + 1.0) * np.log1p(squares / (FREEDOM * variance)), axis=2)
    a, b = np.unravel_index(cost.argmin(), cost.shape)
    return math.sqrt(grid[a]), math.sqrt(grid[b])
