"""How a robot really moved between two scans: the scan is laid on those before, and odometry has its say.

1. Every beam that is part of a surface gets a normal, from its neighbours.
2. Each point of the scan, where odometry puts it, is paired with the nearest point of the submap (the scans of the way
   so far, as far back as it is of use) that faces the same way: P. J. Besl, N. D. McKay, "A method for registration of
   3-D shapes", IEEE Trans. PAMI 14, 1992; F. Lu, E. Milios, "Robot pose estimation in unknown environments by matching
   2D range scans", J. Intell. Robot. Syst. 18, 1997.
3. What counts is the distance from the surface there, not from the point: A. Censi, "An ICP variant using a
   point-to-line metric", ICRA 2008.  The surface is the mean of what many scans saw of it, as in J.-E. Deschaud,
   "IMLS-SLAM: scan-to-model matching based on 3D data", ICRA 2018: single ranges are noisy, and rounded.
4. Gauss-Newton on the sum of squares (Huber's beyond a few centimetres) and on the distance from the odometry in units
   of its covariance; then new pairs, within a gate that narrows.  What two walls of a corridor do not show, how far
   along it the robot is, they must not show by the noise of their normals either (J. Zhang, M. Kaess, S. Singh, "On
   degeneracy of optimization-based state estimation problems", ICRA 2016), and what little shows it is believed less.
5. The covariance is the inverse of the curvature at the end (A. Censi, "An accurate closed-form estimate of ICP's
   covariance", ICRA 2007, has also what the noise of both scans does to it), with a deviation of a point so large that
   the many errors that points have in common are covered.

Points are (x, y, nx, ny): a place [m] and the unit normal of the surface, on the side from which it was seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from slam._jit import inline, kernel
from slam.geometry import compose, invert, wrap
from slam.linalg import dot3, load33, times33
from slam.types import Floats, Ints, Scan


class Matcher(NamedTuple):
    """How to match scans, and when to believe it."""

    keyframes: int = 100
    """Scans that the submap is made of, at most."""
    spacing: float = 0.25
    """[m] of way after which a scan is added to it."""
    turn: float = math.radians(6.0)
    """[rad] of turn after which one is."""
    patience: float = 4.0
    """Times as much before one is of which only the odometry tells where it was taken."""
    most: int = 400
    """Beams of a scan that are matched and kept; of more, every second or third is."""
    fewest: int = 15
    """Points with a normal that a scan needs."""
    baseline: float = 0.1
    """[m] to either side of a beam from which its normal is taken, and no less than `neighbours` beams."""
    neighbours: int = 2
    """Beams to either side."""
    smooth: float = 0.1
    """[m] around the nearest point of the submap over which the surface is averaged."""
    facing: float = 0.7
    """The cosine of the angle between the normals of a pair, at least."""
    widest: float = 0.6
    """[m] between the points of a pair, at first."""
    narrowest: float = 0.15
    """[m] between them, in the end."""
    narrowing: float = 0.7
    """What is left of the gate after each iteration."""
    huber: float = 0.03
    """[m] from the surface beyond which a point no longer pulls harder."""
    sigma: float = 0.02
    """[m] deviation of a point from the surface, for the estimate: small, so that what is systematic in the odometry
    has no part in what the scan shows better."""
    reported: float = 0.1
    """[m] the same for the covariance that is reported: large, since errors are alike from beam to beam, and from scan
    to scan."""
    clean: float = 0.015
    """[m] mean distance from the surface up to which both hold; they grow with its square beyond.  What leaves more is
    not made of walls, or is not the same place."""
    parallel: float = 0.15
    """[rad] Surfaces that are within this of the direction in which the pose is known least say nothing along it."""
    caution: float = 8.0
    """How many times its information the odometry has along a direction that hardly any surface shows: what little
    there is may be a person who walks on."""
    iterations: int = 30
    """At most."""
    restarts: tuple[float, ...] = (math.radians(6.0), -math.radians(6.0), math.radians(14.0), -math.radians(14.0))
    """[rad] from the heading by odometry at which to begin again, where that heading itself leads to nothing good."""
    shares: tuple[float, ...] = (0.0, -1.0)
    """Of the way by odometry, at which to begin again, too: wheels slip, and odometers are known that count ahead when
    the robot goes back (in the log of Freiburg's building 079)."""
    good_overlap: float = 0.7
    """The share of the points that are paired, from which on nothing is begun again."""
    good_residual: float = 0.03
    """[m] mean distance from the surface, up to which nothing is."""
    least_overlap: float = 0.3
    """Below this share a match is not used."""
    largest_residual: float = 0.06
    """[m] Above this mean distance it is not."""
    surprise: float = 3.0
    """Deviations from the odometry beyond which a match is not used unless it is the likelier of the two."""


STANDARD = Matcher()


class Track(NamedTuple):
    """The way so far, and what was seen along it: a value, from which one may go on as often as one likes."""

    pose: Floats
    """(3,) [m, m, rad] of the robot in the frame in which the way began."""
    doubt: Floats
    """(3, 3) covariance of the pose with regard to the submap: that of the odometry since a match was used, or a scan
    was added without one."""
    newest: Floats
    """(3,) pose at which the newest scan of the submap was taken."""
    scans: tuple[Floats, ...]
    """Points (n, 4) of each scan of the submap, in that frame, oldest first.  Tracks share these arrays."""


START = Track(np.zeros(3), np.zeros((3, 3)), np.zeros(3), ())
"""Before the first scan."""


class Match(NamedTuple):
    """What takes the place of an odometry increment."""

    u: Floats
    """(3,) increment [m, m, rad] in the robot's frame before it (`slam.motion.Odometry`)."""
    covariance: Floats
    """(3, 3) of u."""
    overlap: float
    """Share of the points of the scan that were paired, 0 to 1."""
    residual: float
    """[m] mean distance of those from the surface."""
    used: bool
    """Whether u is that of the match; else it is the odometry as it was given, and so is the covariance."""
    reason: str
    """Why it is not."""
    passed: Floats = np.zeros((0, 3))
    """(n, 3) increments like u up to each of n scans that were matched on the way."""


FREEDOM = 4.0
"""Of the Student distribution of what is wrong with an odometry."""

SLIGHTEST = 1e-4
"""[m] and [rad] Added to the deviations of an odometry, which may be believed to be exact in some direction."""

STEADY = (3e-4, 5e-5)
"""[m], [rad] of correction below which an iteration was the last."""


def match(track: Track, scan: Scan, u: Floats, Q: Floats, settings: Matcher = STANDARD) -> tuple[Track, Match]:
    """The track after a scan and the increment that led to it; u (3,) and Q (3, 3) are those of the odometry."""
    q = surface_points(scan, settings)
    doubt = _doubt(track, u, Q)
    found = _match(track, q, u, Q, doubt, settings)
    pose = compose(track.pose, found.u)
    track = track._replace(pose=pose, doubt=np.zeros((3, 3)) if found.used or not track.scans else doubt)
    if len(q) < settings.fewest or not _to_be_kept(track, found.used, settings):
        return track, found
    scans = (*track.scans[-settings.keyframes + 1 :], _placed(q, pose))
    return Track(pose, np.zeros((3, 3)), pose, scans), found


def _doubt(track: Track, u: Floats, Q: Floats) -> Floats:
    """The covariance (3, 3) of the pose with regard to the submap, after an increment."""
    turn, H = _rotation(track.pose[2]), np.eye(3)
    H[:2, 2] = turn[:2, :2] @ [-u[1], u[0]]
    return H @ track.doubt @ H.T + turn @ Q @ turn.T


def _to_be_kept(track: Track, sure: bool, settings: Matcher) -> bool:
    """Whether a scan at the pose of the track, far enough from the newest of the submap, is to be added.

    If the pose is that of the odometry alone, the next scans may show better where the robot is, in a submap without
    this one.
    """
    if not track.scans:
        return True
    x, y, turned = compose(invert(track.newest), track.pose)
    far = 1.0 if sure else settings.patience
    return math.hypot(x, y) > far * settings.spacing or abs(turned) > far * settings.turn


def _match(track: Track, q: Floats, u: Floats, Q: Floats, doubt: Floats, settings: Matcher) -> Match:
    """What the points q (M, 4), in the robot's frame, say of the increment that led to them."""
    if not track.scans:
        return Match(u, Q, 0.0, 0.0, False, "first scan")
    if len(q) < settings.fewest:
        return Match(u, Q, 0.0, 0.0, False, "too few points")
    predicted = compose(track.pose, u)
    prior = np.linalg.inv(doubt + np.diag([SLIGHTEST**2] * 3)).astype(np.float64)
    reach = float(np.hypot(q[:, 0], q[:, 1]).max()) + settings.widest
    pairing = _Pairing(q, *_submap(track, predicted, reach, settings))
    starts = [predicted + np.array([0.0, 0.0, turn]) for turn in (0.0, *settings.restarts)]
    starts += [compose(track.pose, u * [share, share, 1.0]) for share in settings.shares]
    fit, pose, information = _align(pairing, predicted, starts, prior, settings)
    covariance = np.linalg.inv(information / (settings.reported * _roughness(fit.residual, settings)) ** 2 + prior)
    distance2 = float(fit.away @ np.linalg.solve(doubt + covariance, fit.away))
    reason = _objection(pairing, predicted, fit, distance2, settings)
    if reason:
        return Match(u, Q, fit.overlap, fit.residual, False, reason)
    turn = _rotation(track.pose[2])
    covariance = turn.T @ (covariance + track.doubt) @ turn
    covariance = 0.5 * (covariance + covariance.T)
    return Match(compose(invert(track.pose), pose), covariance, fit.overlap, fit.residual, True, "")


def _objection(pairing: _Pairing, predicted: Floats, fit: _Fit, distance2: float, settings: Matcher) -> str:
    """Why a fit is not to be used, if so; it is at a squared distance from the odometry, in deviations of both."""
    if fit.overlap < settings.least_overlap:
        return "too little overlap"
    if fit.residual > settings.largest_residual:
        return "does not fit"
    if distance2 <= settings.surprise**2:
        return ""
    everywhere = (1.0, 0.0, 0.0)
    before = _linearise(*pairing, predicted, settings.narrowest, everywhere, settings, np.empty((5, 3)))
    return "far from an odometry that fits as well" if fit.cost > _cost(pairing, before[2], 0.0, settings) else ""


def _cost(pairing: _Pairing, misfit: float, distance2: float, settings: Matcher) -> float:
    """Minus the log of the probability of a misfit at a squared distance from the odometry, in its deviations.

    Points have the deviation that is reported.  The error of an odometry is that of a Student distribution: wheels that
    slip make it wrong by ten deviations.
    """
    points = len(pairing.q) * misfit / settings.reported**2
    return points + 0.5 * (FREEDOM + 3.0) * math.log1p(distance2 / FREEDOM)


class _Fit(NamedTuple):
    """How well points lie on a submap."""

    overlap: float
    residual: float
    cost: float
    """See `_cost`."""
    away: Floats
    """(3,) from where odometry has the robot."""


class _Pairing(NamedTuple):
    """What is laid on what."""

    q: Floats
    """(M, 4) points of a scan, in the robot's frame."""
    points: Floats
    """(n, 4) points of the submap, by bucket."""
    start: Ints
    """(H + 1,) where the points of each bucket begin."""


def _rotation(angle: float) -> Floats:
    """(3, 3) that turns the covariance of a pose."""
    c, q = math.cos(angle), math.sin(angle)
    return np.array([[c, -q, 0.0], [q, c, 0.0], [0.0, 0.0, 1.0]])


def _placed(points: Floats, pose: Floats) -> Floats:
    """Points (n, 4) given in the frame of a pose, in the frame in which the pose is given."""
    turn = _rotation(pose[2])[:2, :2]
    return np.hstack([points[:, :2] @ turn.T + pose[:2], points[:, 2:] @ turn.T])


def surface_points(scan: Scan, settings: Matcher = STANDARD) -> Floats:
    """(n, 4) the beams of a scan that met a surface, in the robot's frame."""
    B = len(scan.ranges)
    points = np.empty((B, 4))
    if B < 2:
        return points[:0]
    step = abs(scan.bearings[-1] - scan.bearings[0]) / (B - 1)
    every = -(-B // settings.most)
    seen = np.where(scan.ranges < scan.max_range, scan.ranges, np.inf)
    n = _surface(seen, np.cos(scan.bearings), np.sin(scan.bearings), step, every, settings, points)
    return _placed(points[:n], scan.origin)


def _submap(track: Track, centre: Floats, radius: float, settings: Matcher) -> tuple[Floats, Ints]:
    """The points of the submap within a radius [m], sorted by cell, and where the points of each bucket begin."""
    points = np.concatenate(track.scans)
    buckets = 1 << max(6, int(len(points) - 1).bit_length())
    ordered = np.empty_like(points)
    start, bucket = np.zeros(buckets + 1, np.int64), np.empty(len(points), np.int64)
    n = _sort(points, centre, radius, settings.smooth, bucket, start, ordered)
    return ordered[:n], start


def _align(
    pairing: _Pairing, predicted: Floats, starts: Sequence[Floats], prior: Floats, settings: Matcher
) -> tuple[_Fit, Floats, Floats]:
    """The best fit, its pose (3,) and its information (3, 3), begun at the first of the starts (3,); where that leads
    to nothing good, at the others.

    The information is that of the scan alone, for a deviation of one metre.
    """
    best, pose, information = _Fit(0.0, math.inf, math.inf, np.zeros(3)), predicted, np.zeros((3, 3))
    for start in starts:
        x, system = start.copy(), np.empty((5, 3))
        overlap, residual, misfit = _descend(*pairing, predicted, prior, settings, x, system)
        away = np.array([x[0] - predicted[0], x[1] - predicted[1], wrap(x[2] - predicted[2])])
        fit = _Fit(overlap, residual, _cost(pairing, misfit, float(away @ prior @ away), settings), away)
        if fit.cost < best.cost:
            best, pose, information = fit, x, system[:3]
        if best.overlap >= settings.good_overlap and best.residual <= settings.good_residual:
            break
    return best, pose, information


# The loops -----------------------------------------------------------------------------------------------------------


@kernel
def _surface(r: Any, c: Any, s: Any, step: Any, every: Any, settings: Any, points: Any) -> Any:
    """The number of points; those of the beams with a range r and the direction (c, s) that are part of a surface.

    Neighbours are beams without a jump between them: what meets a wall at 10 degrees is on the same wall.
    """
    n, count = len(r), 0
    for i in range(0, n, every):
        if not 0.0 < r[i] < np.inf:
            continue
        x, y = r[i] * c[i], r[i] * s[i]
        N, sx, sy, sxx, sxy, syy, sides = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
        for way in (-1, 1):
            k = i
            while True:
                j = k + way
                if j < 0 or j >= n or not 0.0 < r[j] < np.inf:
                    break
                dx, dy = r[j] * c[j] - r[k] * c[k], r[j] * s[j] - r[k] * s[k]
                if math.hypot(dx, dy) > GRAZING * step * min(r[j], r[k]) + JUMP:
                    break
                dx, dy = r[j] * c[j] - x, r[j] * s[j] - y
                if abs(j - i) > settings.neighbours and dx * dx + dy * dy > settings.baseline * settings.baseline:
                    break
                N, sx, sy = N + 1.0, sx + dx, sy + dy
                sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
                k = j
            sides += k != i
        if N < 4.0 or sides < 2:
            continue
        a, b, d = sxx - sx * sx / N, sxy - sx * sy / N, syy - sy * sy / N
        root = math.hypot(0.5 * (a - d), b)
        across, along = 0.5 * (a + d) - root, 0.5 * (a + d) + root
        if not across < ROUND * along:
            continue
        phi = 0.5 * math.atan2(b, 0.5 * (a - d))
        nx, ny = -math.sin(phi), math.cos(phi)
        if nx * x + ny * y > 0.0:
            nx, ny = -nx, -ny
        points[count, 0], points[count, 1], points[count, 2], points[count, 3] = x, y, nx, ny
        count += 1
    return count


GRAZING = 1.0 / math.sin(math.radians(10.0))
JUMP = 0.1
"""[m] between two beams that are neighbours whatever else."""
ROUND = 0.1
"""The variance of neighbours across their line, as a share of that along it, from which on it is no line."""


@inline
def _bucket(x: Any, y: Any, buckets: Any) -> Any:
    """That of the cell (x, y): another one may have the same, and then costs time."""
    return (x * 73856093 ^ y * 19349663) & (buckets - 1)


@inline
def _cell(x: Any, size: Any) -> Any:
    return math.floor(x / size)


@kernel
def _sort(points: Any, centre: Any, radius: Any, size: Any, bucket: Any, start: Any, ordered: Any) -> Any:
    """How many points are within the radius; `ordered` receives them by bucket, start (H + 1,) where each begins."""
    H, n = len(start) - 1, 0
    for i in range(len(points)):
        dx, dy = points[i, 0] - centre[0], points[i, 1] - centre[1]
        bucket[i] = -1
        if dx * dx + dy * dy <= radius * radius:
            bucket[i] = _bucket(_cell(points[i, 0], size), _cell(points[i, 1], size), H)
            start[bucket[i]] += 1
            n += 1
    for h in range(1, H + 1):
        start[h] += start[h - 1]
    for i in range(len(points) - 1, -1, -1):
        if bucket[i] >= 0:
            start[bucket[i]] -= 1
            for k in range(4):
                ordered[start[bucket[i]], k] = points[i, k]
    return n


@inline
def _nearest(p: Any, gate: Any, points: Any, start: Any, settings: Any) -> Any:
    """The nearest point of the submap to p (x, y, nx, ny) that faces the same way, -1 for none: ring after ring of
    cells."""
    size, H = settings.smooth, len(start) - 1
    cx, cy = _cell(p[0], size), _cell(p[1], size)
    least, nearest = gate * gate, -1
    for ring in range(math.ceil(gate / size) + 1):
        if least <= (max(ring - 1, 0) * size) ** 2:
            break
        for x in range(cx - ring, cx + ring + 1):
            leap = 1 if x == cx - ring or x == cx + ring else 2 * ring
            for y in range(cy - ring, cy + ring + 1, leap):
                h = _bucket(x, y, H)
                for k in range(start[h], start[h + 1]):
                    dx, dy = points[k, 0] - p[0], points[k, 1] - p[1]
                    away = dx * dx + dy * dy
                    if away < least and p[2] * points[k, 2] + p[3] * points[k, 3] > settings.facing:
                        least, nearest = away, k
    return nearest


@inline
def _mean_surface(k: Any, points: Any, start: Any, settings: Any) -> Any:
    """(x, y, nx, ny) of the surface around point k of the submap: the mean of what faces the same way."""
    size, H = settings.smooth, len(start) - 1
    cx, cy, reach = points[k, 0], points[k, 1], settings.smooth * settings.smooth
    W, x, y, nx, ny = 0.0, 0.0, 0.0, 0.0, 0.0
    for ix in range(_cell(cx - size, size), _cell(cx + size, size) + 1):
        for iy in range(_cell(cy - size, size), _cell(cy + size, size) + 1):
            h = _bucket(ix, iy, H)
            for j in range(start[h], start[h + 1]):
                dx, dy = points[j, 0] - cx, points[j, 1] - cy
                w = 1.0 - (dx * dx + dy * dy) / reach
                if w <= 0.0 or points[k, 2] * points[j, 2] + points[k, 3] * points[j, 3] < settings.facing:
                    continue
                w *= w
                W, x, y = W + w, x + w * dx, y + w * dy
                nx, ny = nx + w * points[j, 2], ny + w * points[j, 3]
    size = math.hypot(nx, ny)
    return cx + x / W, cy + y / W, nx / size, ny / size


@kernel
def _linearise(q: Any, points: Any, start: Any, pose: Any, gate: Any, weak: Any, settings: Any, system: Any) -> Any:
    """(overlap, residual [m], misfit [m^2]) of the points at a pose.

    system (5, 3) receives the curvature (three rows) and the slope of the misfit, as sums over the pairs, and the sums
    of (nx nx, nx ny, ny ny).  The misfit is half of the mean over all points of the squared distance from the surface
    (Huber's beyond a few centimetres); for a point without a pair, of the largest that it could have.  A surface that
    may be parallel to the direction `weak` is taken to be so.
    """
    M, pairs, distance, misfit = len(q), 0, 0.0, 0.0
    c, s, limit = math.cos(pose[2]), math.sin(pose[2]), settings.huber
    system[:] = 0.0
    for i in range(M):
        rx, ry = c * q[i, 0] - s * q[i, 1], s * q[i, 0] + c * q[i, 1]
        p = (pose[0] + rx, pose[1] + ry, c * q[i, 2] - s * q[i, 3], s * q[i, 2] + c * q[i, 3])
        k = _nearest(p, gate, points, start, settings)
        if k < 0:
            misfit += limit * (gate - 0.5 * limit)
            continue
        x, y, nx, ny = _mean_surface(k, points, start, settings)
        e = nx * (p[0] - x) + ny * (p[1] - y)
        off = abs(e)
        w = 1.0 if off <= limit else limit / off
        pairs, distance = pairs + 1, distance + off
        misfit += 0.5 * off * off if off <= limit else limit * (off - 0.5 * limit)
        system[4, 0] += w * nx * nx
        system[4, 1] += w * nx * ny
        system[4, 2] += w * ny * ny
        if weak[2] > 0.0 and abs(nx * weak[0] + ny * weak[1]) < settings.parallel:
            side = 1.0 if ny * weak[0] - nx * weak[1] > 0.0 else -1.0
            nx, ny = -side * weak[1], side * weak[0]
        J = (nx, ny, ny * rx - nx * ry)
        for a in range(3):
            for b in range(3):
                system[a, b] += w * J[a] * J[b]
            system[3, a] += w * J[a] * e
    return pairs / M, distance / max(pairs, 1), misfit / M


@inline
def _weakest(system: Any) -> Any:
    """(x, y) the direction that the normals show least, and how badly: from 1, not at all, to 0, well."""
    a, b, d = system[4, 0], system[4, 1], system[4, 2]
    root, phi = math.hypot(0.5 * (a - d), b), 0.5 * math.atan2(b, 0.5 * (a - d))
    least, most = 0.5 * (a + d) - root, 0.5 * (a + d) + root
    return -math.sin(phi), math.cos(phi), max(1.0 - least / (WEAK * most), 0.0)


WEAK = 0.2
"""Of the sums of squared normals along two directions, the share of the smaller from which on it is shown well."""


@inline
def _cautious(L: Any, weak: Any, settings: Any) -> Any:
    """The information L (3, 3) of the odometry, and more of it along a direction d that is shown badly.

    L + c (L d) (L d)^T / (d^T L d): the best place along d, given all else, stays where it is.
    """
    d = (weak[0], weak[1], 0.0)
    v = times33(L, d)
    more = (settings.caution - 1.0) * weak[2] * weak[2] / dot3(d, v)
    return (
        (L[0][0] + more * v[0] * v[0], L[0][1] + more * v[0] * v[1], L[0][2] + more * v[0] * v[2]),
        (L[1][0] + more * v[1] * v[0], L[1][1] + more * v[1] * v[1], L[1][2] + more * v[1] * v[2]),
        (L[2][0] + more * v[2] * v[0], L[2][1] + more * v[2] * v[1], L[2][2] + more * v[2] * v[2]),
    )


@inline
def _solve(A: Any, g: Any, L: Any, away: Any, weight: Any) -> Any:
    """The step (3,) down from the slope weight g + L away, for the curvature weight A + L (Cholesky); NaN for none."""
    h00, h10, h20 = weight * A[0, 0] + L[0][0], weight * A[1, 0] + L[1][0], weight * A[2, 0] + L[2][0]
    h11, h21, h22 = weight * A[1, 1] + L[1][1], weight * A[2, 1] + L[2][1], weight * A[2, 2] + L[2][2]
    b0, b1, b2 = -weight * g[0] - dot3(L[0], away), -weight * g[1] - dot3(L[1], away), -weight * g[2] - dot3(L[2], away)
    l00 = math.sqrt(h00)
    l10, l20 = h10 / l00, h20 / l00
    l11 = math.sqrt(h11 - l10 * l10)
    l21 = (h21 - l20 * l10) / l11
    l22 = math.sqrt(h22 - l20 * l20 - l21 * l21)
    z0 = b0 / l00
    z1 = (b1 - l10 * z0) / l11
    z2 = (b2 - l20 * z0 - l21 * z1) / (l22 * l22)
    z1 = (z1 - l21 * z2) / l11
    return (z0 - l10 * z1 - l20 * z2) / l00, z1, z2


@register_jitable
def _roughness(residual: Any, settings: Any) -> Any:
    """Factor on the deviation of a point."""
    return max(1.0, (residual / settings.clean) ** 2)


@kernel
def _descend(q: Any, points: Any, start: Any, predicted: Any, prior: Any, settings: Any, pose: Any, system: Any) -> Any:
    """(overlap, residual, misfit) at the end of the way down from `pose` (3,), which receives the end.

    predicted (3,) and prior (3, 3) are the pose by odometry and its information; system as in `_linearise`.
    """
    gate, weak, rough = settings.widest, (1.0, 0.0, 0.0), 0.0
    for _ in range(settings.iterations):
        _, residual, _ = _linearise(q, points, start, pose, gate, weak, settings, system)
        weak, sigma = _weakest(system), settings.sigma * max(rough, 1.0)
        away = (pose[0] - predicted[0], pose[1] - predicted[1], wrap(pose[2] - predicted[2]))
        L = _cautious(load33(prior), weak, settings)
        dx, dy, turn = _solve(system, system[3], L, away, 1.0 / (sigma * sigma))
        pose[0], pose[1], pose[2] = pose[0] + dx, pose[1] + dy, wrap(pose[2] + turn)
        if gate <= settings.narrowest and math.hypot(dx, dy) < STEADY[0] and abs(turn) < STEADY[1]:
            if rough > 0.0:
                break
            rough = _roughness(residual, settings)
            if rough <= 1.0:
                break
        gate = max(settings.narrowing * gate, settings.narrowest)
    return _linearise(q, points, start, pose, settings.narrowest, weak, settings, system)
