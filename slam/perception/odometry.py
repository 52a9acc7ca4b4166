"""Better odometry, once for all particles: what a laser scan, matched with those before, says of the motion (5.2)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from slam.geometry import compose
from slam.motion import Odometry, deviation, matched, propagate
from slam.perception.matching import STANDARD, START, Match, Matcher, Track
from slam.perception.matching import match as match_scan
from slam.types import Floats, Frame, Noise, Params, Scan


class Increment(NamedTuple):
    """A motion, and how far it may be trusted."""

    u: Floats
    """(3,) [m, m, rad] in the robot's frame at its beginning."""
    covariance: Floats
    """(3, 3) of u, in the same frame."""


NOWHERE = Increment(np.zeros(3), np.zeros((3, 3)))


def increment(frame: Frame, params: Params, first: int = 0, last: int | None = None) -> Increment:
    """What the control ticks `first` to `last` of a frame amount to, with the Q (7) that is believed of them."""
    s, P, ticks = (0.0, 0.0, 0.0), np.zeros((3, 3)), slice(first, last)
    sigma = deviation(frame.motion, frame.u[ticks], params.believed)
    for u, dt, deviations in zip(frame.u[ticks].tolist(), frame.dt[ticks].tolist(), sigma, strict=True):
        s, H_s, H_u = propagate(frame.motion, s, u, dt)
        noise = np.array(H_u) * deviations
        P = np.array(H_s) @ P @ np.array(H_s).T + noise @ noise.T
    return Increment(np.array(s), P)


def then(one: Increment, other: Increment) -> Increment:
    """A motion, and another one after it, with independent errors."""
    c, q = math.cos(one.u[2]), math.sin(one.u[2])
    x, y = other.u[:2]
    J = np.array([[1.0, 0.0, -q * x - c * y], [0.0, 1.0, c * x - q * y], [0.0, 0.0, 1.0]])
    R = np.array([[c, -q, 0.0], [q, c, 0.0], [0.0, 0.0, 1.0]])
    return Increment(compose(one.u, other.u), J @ one.covariance @ J.T + R @ other.covariance @ R.T)


def correct_odometry(
    track: Track | None, frame: Frame, params: Params, settings: Matcher = STANDARD
) -> tuple[Track | None, Frame, Match | None]:
    """The frame with the motion that matching its scans gives, where it is used; and the track for the next frame.

    The match that is returned is that of the whole way: its overlap is the least on the way, its residual the largest,
    and it counts as used if each is.  Without a scan, with matching off, or where it is not `worth_matching`, the frame
    stays as it is, and what was tracked is forgotten.
    """
    unwanted = params.matching == "auto" and not worth_matching(frame.motion, params.believed)
    if frame.scan is None or params.matching == "off" or unwanted:
        return None, frame, None
    if params.matching == "on":
        settings = settings._replace(surprise=math.inf)
    track, moved, matches = track or START, [NOWHERE], []
    for scan, way in _ways(frame, params):
        track, match = match_scan(track, scan, way.u, way.covariance, settings)
        moved.append(then(moved[-1], Increment(match.u, match.covariance)))
        matches.append(match)
    found = _of_all(moved[1:], matches)
    if not any(match.used for match in matches):
        return track, frame, found
    model, w = matched(found.u, found.covariance)
    return track, frame._replace(motion=model, u=w[None], dt=np.array([frame.dt.sum()])), found


GOOD_HEADING = 0.0075
"""[rad] Deviation of the heading after one metre, up to which an odometry is better left alone.

The heading of matches drifts too, by one degree in 20 m (0.004 rad after one metre) on the real logs that were looked
at.  With odometries as good as that (0.002 and 0.005) they did harm, with others (0.026 to 0.11) good."""


def worth_matching(motion: Any, believed: Noise) -> bool:
    """Whether matches are likely to be better, in the long run, than an odometry with the noise that is believed."""
    if not isinstance(motion, Odometry):
        return True
    return float(deviation(motion, np.array([[1.0, 0.0, 0.0]]), believed)[0, 2]) > GOOD_HEADING


def _ways(frame: Frame, params: Params) -> Iterator[tuple[Scan, Increment]]:
    """Each scan of a frame, and the way to it by odometry."""
    assert frame.scan is not None
    if len(frame.between) != len(frame.u) - 1:
        yield frame.scan, increment(frame, params)
        return
    for tick, scan in enumerate((*frame.between, frame.scan)):
        yield scan, increment(frame, params, tick, tick + 1)


def _of_all(moved: Sequence[Increment], matches: Sequence[Match]) -> Match:
    """What the matches come to, with the motions from the beginning of the frame up to each."""
    reason = next((match.reason for match in matches if not match.used), "")
    overlap, residual = min(match.overlap for match in matches), max(match.residual for match in matches)
    passed = np.array([motion.u for motion in moved[:-1]]).reshape(-1, 3)
    return Match(*moved[-1], overlap, residual, all(match.used for match in matches), reason, passed)
