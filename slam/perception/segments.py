"""Straight pieces of wall in a laser scan, with the covariance that they deserve.

1. Beams without a return are left out, and the scan is broken where it jumps (G. A. Borges, M.-J. Aldon, "Line
   extraction in 2D range images for mobile robotics", J. Intell. Robot. Syst. 40, 2004: the adaptive breakpoint).
2. What is between two breaks is split where the sum of squared deviations, and a penalty for every piece, is smallest:
   dynamic programming over prefix sums, pruned as in R. Killick, P. Fearnhead, I. A. Eckley, "Optimal detection of
   changepoints with a linear computational cost", JASA 107, 2012, and a little more.  Split and merge minimises much
   the same greedily; but its chord hangs on two noisy points, and a door that stands back by 0.12 m is found or not by
   luck.  This has no such luck, needs no merging, and takes a sixth of the time of a scan.
3. Pieces on one line are joined where the gap between them is hidden by something nearer; not where it is open.
4. The line of greatest likelihood, range noise acting along the beam.  The first and the last beam of a piece that goes
   on into the next one, without a jump, may belong to that: they have no part in the line.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam._jit import inline, kernel
from slam.features.wall import CORNER, EDGE, HIDDEN, OUT_OF_REACH, SAME_END, STRAIGHT
from slam.geometry import TWO_PI, compose
from slam.types import Floats, Ints, Scan


class Extraction(NamedTuple):
    """How to read a scan."""

    shortest: float = 0.5
    """[m] A shorter piece is no observation.  It may well be straight and its covariance is honest, but what is that
    short indoors is furniture, legs, door frames and the facets of something round: gone or different the next time."""
    fewest: int = 7
    """Beams that a piece needs."""
    quantum: float = 0.0
    """[m] to which the scanner rounds its ranges: adds quantum^2 / 12 to the variance of a range."""
    flat: float = 0.005
    """[m] Deviation of a real wall from a straight line, where the question is whether it still is one."""
    penalty: float = 25.0
    """Squared deviations (each in units of its variance) that must vanish to make one more piece."""
    grazing: float = math.radians(10.0)
    """[rad] Lambda: the least angle between a beam and a wall that is followed from beam to beam."""
    opening: float = 0.6
    """[m] of wall from which nothing returns is a doorway.  Less than that are missing returns."""
    apart: float = 0.2
    """[m] in front of a wall that hides it: one wall is on both sides of it."""
    steepest: float = 0.1
    """The cosine of incidence below which a beam weighs no more: what acts across the beam (its width, an error of its
    bearing) is no longer negligible."""
    prior: float = 20.0
    """How many beams the believed deviation counts for where the residuals estimate the true one.  With few beams the
    residuals alone would make errors of a t distribution: too small a variance half of the time."""


STANDARD = Extraction()

TRIM, END_TRIM = 3.5, 2.5
"""Deviations from the line at which a beam is no longer of it; of the first or last beam, which may be of what is
beyond a corner."""

MEAN_SIZE = math.sqrt(2.0 / math.pi)
"""The mean absolute value of a standard normal number."""

YOUNG = 16
"""Beams within which a new piece need not show that it is better than the old one going on."""

SAME_LINE = 9.21
"""The squared deviations that two pieces may add when put on one line: 99 % of chi-square, two degrees of freedom."""

PARALLEL = 3.0
"""Deviations of the difference of two directions within which two pieces of a scan are taken to be parallel."""

PASSES = 7
"""Over the beams of a line."""

OFF = 3.0
"""Deviations from the line at which a beam shows something nearer or farther."""

ROUGH = 4.0
"""Mean squared deviation, in units of its variance, of what is not straight at all."""

CORNER_ROOM = 0.1
"""[m] by which the end of a wall may miss its corner with the next one, besides the distance of two beams."""

SMALLEST, FARTHEST = 1e-5, 1e6
"""[m] A deviation of a range is no smaller than the one, and no range as large as the other, whatever is said."""


class Segments(NamedTuple):
    """What a scan shows of walls, longest first."""

    z: Floats
    """(Z, 11) observations as in `slam.features.wall`, in the robot's frame."""
    label: Ints
    """(B,) row of z that a beam was used for, -1 for none."""


def extract(scan: Scan, sigma: float, settings: Extraction = STANDARD) -> Segments:
    """The walls of a scan whose ranges have the deviation sigma [m].

    Both ends of a piece are where its first and last beam meet the line; at a corner, where the two lines meet.
    """
    label = np.full(len(scan.ranges), -1)
    beams, step, closed = _returns(scan)
    if len(beams) < settings.fewest:
        return Segments(np.zeros((0, 11)), label)
    variance = max(sigma, SMALLEST) ** 2 + settings.quantum**2 / 12.0
    r, theta = scan.ranges[beams].astype(float), scan.bearings[beams].astype(float)
    broken, start = _breaks(r, theta, step, closed, math.sqrt(variance), settings)
    if start:  # so that no piece lies across the seam
        beams, r, broken = np.roll(beams, -start), np.roll(r, -start), np.roll(broken, -start)
        theta = np.concatenate([theta[start:], theta[:start] + TWO_PI])

    n = len(r)
    ray = np.stack([r, theta, np.cos(theta), np.sin(theta)], axis=1)
    x, y = r * ray[:, 2], r * ray[:, 3]
    sums = np.zeros((n + 1, MOMENTS))
    np.cumsum(
        np.stack([np.ones(n), x, y, x * x, x * y, y * y, np.cos(2.0 * theta), np.sin(2.0 * theta)], axis=1),
        axis=0,
        out=sums[1:],
    )
    first = np.empty(n + 1, np.int64)
    P = _split(sums, broken, variance, settings, np.empty((2, n + 1)), np.empty((2, n + 1), np.int64), first)
    pieces = np.empty((4, P), np.int64)
    moments = np.empty((P, MOMENTS))
    _join(ray, sums, first, step, closed, variance, settings, pieces, moments)
    member, lines = np.full(n, -1), np.zeros((P, FIELDS))
    _fit(ray, broken, first, pieces, moments, variance, settings, member, lines)
    _ends(ray, member, step, closed, float(scan.max_range), variance, settings, lines)

    kept = np.flatnonzero(lines[:, KEPT] > 0.0)
    kept = kept[np.argsort(lines[kept, 3] - lines[kept, 4], kind="stable")]
    row = np.full(P + 1, -1)  # the last is for beams of no line
    row[kept] = np.arange(len(kept))
    label[beams] = row[member]
    z = lines[kept, :10]
    z[:, :3] = compose(scan.origin, z[:, :3])
    return Segments(np.column_stack([z, shared_directions(z[:, 2], z[:, 6])]), label)


def shared_directions(phi: Floats, variance: Floats) -> Floats:
    """(Z,) [rad] the direction of each piece by all that may be parallel to it, whichever side of a wall they show.

    phi (Z,) [rad] and variance (Z,) [rad^2] are those of the pieces alone.  The mean of those that are within
    `PARALLEL` deviations, weighted by how well each knows its own, no better than a wall is straight.  So a door that
    is seen at half a degree has the direction of the wall it is in.
    """
    variance = variance + STRAIGHT[1] ** 2
    away = phi[None, :] - phi[:, None]
    away -= math.pi * np.round(away / math.pi)
    weight = (away**2 <= PARALLEL**2 * (variance[:, None] + variance)) / variance
    return phi + np.sum(weight * away, axis=1) / np.sum(weight, axis=1)


def _returns(scan: Scan) -> tuple[Ints, float, bool]:
    """The beams from which something came back, the angle [rad] between beams, and whether they go all round."""
    bearings, ranges = scan.bearings, scan.ranges
    if len(bearings) < 2:
        return np.zeros(0, np.int64), 1.0, False
    span = float(bearings[-1] - bearings[0])
    step = span / (len(bearings) - 1)
    seen = (ranges > 0.0) & (ranges < min(scan.max_range, FARTHEST)) & np.isfinite(bearings)
    if not (step > 0.0 and math.isfinite(span)):
        return np.zeros(0, np.int64), 1.0, False
    closed = TWO_PI - span < 1.5 * step
    if closed:  # 361 beams in 360 degrees: the last is the first again
        seen &= bearings < bearings[0] + TWO_PI - 0.5 * step
    return np.flatnonzero(seen), step, closed


def _breaks(
    r: Floats, theta: Floats, step: float, closed: bool, sigma: float, settings: Extraction
) -> tuple[NDArray[np.bool_], int]:
    """Before which beams (n,) the scan is broken, and the beam to begin with.

    The distance to the next beam of a wall at the angle lambda is r sin(d) / sin(lambda - d), with the nearer r.
    """
    before = np.roll(r, 1)
    turn = theta - np.roll(theta, 1)
    turn[0] += TWO_PI
    jump = np.sqrt((r - before) ** 2 + 4.0 * r * before * np.sin(0.5 * turn) ** 2)
    room = np.sin(np.maximum(max(settings.grazing, 2.0 * step) - turn, 1e-9))
    allowed = np.minimum(r, before) * np.sin(turn) / room + OFF * math.sqrt(2.0) * sigma
    broken = (jump > allowed) | (turn > settings.grazing) & (turn > 2.0 * step)
    broken |= (turn > 1.5 * step) & (jump > settings.opening)
    if not closed:
        broken[0] = True
        return broken, 0
    # What is farthest from the laser is the end of some wall, or a corner.
    return broken, int(np.argmax(np.where(broken, jump, 0.0)) if broken.any() else np.argmax(r))


MOMENTS = 8
"""Number, x, y, xx, xy, yy, cos 2 theta, sin 2 theta, each summed over the beams of a piece."""


@inline
def _moments(sums: Any, i: Any, j: Any) -> Any:
    """Those of beams i to j - 1."""
    return (
        sums[j, 0] - sums[i, 0], sums[j, 1] - sums[i, 1], sums[j, 2] - sums[i, 2], sums[j, 3] - sums[i, 3],
        sums[j, 4] - sums[i, 4], sums[j, 5] - sums[i, 5], sums[j, 6] - sums[i, 6], sums[j, 7] - sums[i, 7],
    )  # fmt: skip


@inline
def _row(moments: Any, p: Any) -> Any:
    """Those of a wall."""
    return (
        moments[p, 0], moments[p, 1], moments[p, 2], moments[p, 3],
        moments[p, 4], moments[p, 5], moments[p, 6], moments[p, 7],
    )  # fmt: skip


@inline
def _sum(m: Any, o: Any) -> Any:
    """Those of two pieces together."""
    return m[0] + o[0], m[1] + o[1], m[2] + o[2], m[3] + o[3], m[4] + o[4], m[5] + o[5], m[6] + o[6], m[7] + o[7]


@inline
def _axis(m: Any) -> Any:
    """(cos 2 phi, sin 2 phi) of the line of least squares, and the sum of squared distances from it [m^2]."""
    n, x, y, xx, xy, yy, _, _ = m
    half, off, trace = 0.5 * (xx - yy - (x * x - y * y) / n), xy - x * y / n, xx + yy - (x * x + y * y) / n
    root = math.sqrt(half * half + off * off)
    if not root > 0.0:
        return 1.0, 0.0, 0.0
    return half / root, off / root, max(0.5 * trace - root, 0.0)


@inline
def _cost(m: Any, variance: Any, flat: Any) -> Any:
    """Squared distances in units of their variance, sigma^2 cos^2(incidence) + flat^2, its mean over the piece.

    The squared cosine between a beam theta and the normal of a line phi is (1 - cos 2(theta - phi)) / 2.
    """
    if m[0] < 3.0:
        return 0.0
    c, q, squares = _axis(m)
    facing = 0.5 - 0.5 * (m[6] * c + m[7] * q) / m[0]
    return squares / (variance * facing + flat * flat)


@kernel
def _split(sums: Any, broken: Any, variance: Any, settings: Any, value: Any, index: Any, first: Any) -> Any:
    """The number P of pieces; first (n + 1,) receives where each begins, and after the last n.

    Work space: value (2, n + 1), index (2, n + 1).
    """
    n = len(broken)
    best, trial = value
    back, begins = index
    best[0], M = 0.0, 0
    for j in range(1, n + 1):
        if broken[j - 1]:
            M = 0
        begins[M] = j - 1
        M += 1
        low, back[j] = np.inf, j - 1
        for c in range(M):
            i = begins[c]
            trial[c] = best[i] + _cost(_moments(sums, i, j), variance, settings.flat)
            if trial[c] < low:
                low, back[j] = trial[c], i
        best[j] = low + settings.penalty
        # A beginning that costs more than a new one here never pays.  Along a wall hardly any does, yet none is so bad
        # that it is certain: of those that have had their chance and gain little, one in eight is kept, to be sure.
        kept = 0
        for c in range(M):
            i = begins[c]
            gain = best[j] - trial[c]
            if gain >= 0.0 and (j - i < YOUNG or gain >= 0.2 * settings.penalty or i % 8 == 0):
                begins[kept] = i
                kept += 1
        M = kept
    P, j = 0, n
    while j > 0:
        P, j = P + 1, back[j]
    first[P], j = n, n
    for p in range(P - 1, -1, -1):
        first[p] = j = back[j]
    return P


@inline
def _normal(m: Any) -> Any:
    """(nx, ny, d) of the line nx x + ny y = d through a piece, d >= 0: the normal points away from the laser."""
    c, q, _ = _axis(m)
    phi = 0.5 * math.atan2(q, c)
    nx, ny = -math.sin(phi), math.cos(phi)
    d = (nx * m[1] + ny * m[2]) / m[0]
    if d < 0.0:
        return -nx, -ny, -d
    return nx, ny, d


@inline
def _turn(ray: Any, k: Any, after: Any) -> Any:
    """[rad] from one beam to one that comes after it, perhaps across the seam."""
    turn = ray[after, 1] - ray[k, 1]
    return turn if after > k else turn + TWO_PI


@inline
def _along(ray: Any, k: Any, nx: Any, ny: Any, d: Any) -> Any:
    """[m] Where the ray of beam k meets a line, along it from the foot of the laser; infinite if it hardly does."""
    facing = nx * ray[k, 2] + ny * ray[k, 3]
    return d * (nx * ray[k, 3] - ny * ray[k, 2]) / facing if facing >= 0.02 else np.inf


@inline
def _hidden(ray: Any, k: Any, end: Any, line: Any, step: Any, variance: Any, settings: Any) -> Any:
    """Whether all that is between beam k and beam `end`, both of one line, is nearer than the line (or on it).

    And for the greater part much nearer: the backs of two recesses are on one line too, and the wall between them hides
    nothing.
    """
    nx, ny, d = line
    n, between, apart = len(ray), 0, 0
    if _turn(ray, k, end) > 0.5 * math.pi:
        return False
    t_before = _along(ray, k, nx, ny, d)
    while k != end:
        after = k + 1 if k + 1 < n else 0
        facing = nx * ray[after, 2] + ny * ray[after, 3]
        t = _along(ray, after, nx, ny, d)
        if facing < 0.02 or (_turn(ray, k, after) > 1.5 * step and t - t_before > settings.opening):
            return False
        off = ray[after, 0] * facing - d
        if off > OFF * math.sqrt(variance * facing * facing + settings.flat * settings.flat):
            return False
        if after != end:
            between += 1
            apart += off < -settings.apart
        k, t_before = after, t
    return 2 * apart >= between


@kernel
def _join(
    ray: Any, sums: Any, first: Any, step: Any, closed: Any, variance: Any, settings: Any, pieces: Any, moments: Any
) -> None:
    """Chain pieces of one wall: pieces (4, P) receives head, next, previous (-1 for none) and the number of beams.

    moments (P, MOMENTS) receives those of the whole wall, in the row of its head.
    """
    head, follower, previous, beams = pieces
    P = len(head)
    for p in range(P):
        head[p], follower[p], previous[p], beams[p] = p, -1, -1, first[p + 1] - first[p]
        for a in range(MOMENTS):
            moments[p, a] = sums[first[p + 1], a] - sums[first[p], a]
    for p in range(P):
        if beams[p] < 3:
            continue
        last = first[p + 1] - 1
        for far in range(p + 1, p + P if closed else P):
            q = far % P
            h = head[p]
            if _turn(ray, last, first[q]) > 0.5 * math.pi:
                break
            if beams[q] < 3 or previous[q] >= 0 or head[q] == h:
                continue
            one, other = _row(moments, h), _row(moments, q)
            both = _sum(one, other)
            apart = _cost(one, variance, settings.flat) + _cost(other, variance, settings.flat)
            if _cost(both, variance, settings.flat) > apart + SAME_LINE:
                continue
            nx, ny, d = _normal(both)
            t0, t1 = _along(ray, first[h], nx, ny, d), _along(ray, last, nx, ny, d)
            t2, t3 = _along(ray, first[q], nx, ny, d), _along(ray, first[q + 1] - 1, nx, ny, d)
            if not t2 - t1 <= t1 - t0 + t3 - t2:  # any two short pieces far apart are on one line, nearly
                continue
            if not _hidden(ray, last, first[q], (nx, ny, d), step, variance, settings):
                continue
            follower[p], previous[q] = q, p
            for a in range(MOMENTS):
                moments[h, a] += moments[q, a]
            while q >= 0:
                head[q] = h
                q = follower[q]
            break


KEPT, NX, NY, D, FIRST, LAST, FIELDS = 10, 11, 12, 13, 14, 15, 16
"""Columns of a fitted line after the ten of an observation: 1 if it is one (0: too short or too few beams, but good for
a corner; -1: none), its normal and distance from the laser, its first and last beam."""


@kernel
def _fit(
    ray: Any, broken: Any, first: Any, pieces: Any, moments: Any, variance: Any, settings: Any, member: Any, lines: Any
) -> None:
    """The line of greatest likelihood through each wall: lines (P, FIELDS), and of which each beam is, member (n,).

    A beam theta meets the line with normal n at the range d / cos i, its incidence i being the angle between them.  The
    range is off by sigma, so the point is off the line by e of deviation sigma cos i, and where it ought to be along
    the line, t = d tan i, is not uncertain at all (it is where the line is).  Gauss-Newton: e = de + t dphi, weighted.
    Beams that are off are left out, first by what a wall may be rough, then by the deviations themselves.
    """
    head, follower, _, _ = pieces
    flat2 = settings.flat * settings.flat
    for h in range(len(head)):
        line = lines[h]
        line[KEPT], line[FIRST], line[LAST] = -1.0, -1.0, -1.0
        if head[h] != h or moments[h, 0] < 3.0:
            continue
        nx, ny, d = _normal(_row(moments, h))
        beams, seen, rough, scale, W, Wt, Wtt, low, high = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        wide, weight, spread, centre = np.inf, np.inf, np.inf, 0.0  # those of the pass before
        for iteration in range(PASSES):
            beams, rough, scale, W, Wt, Wtt, We, Wte = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            low, high, size, seen, begin, end = np.inf, -np.inf, 0.0, 0.0, -1, -1
            p = h
            while p >= 0:
                for k in range(first[p], first[p + 1]):
                    facing = nx * ray[k, 2] + ny * ray[k, 3]
                    if facing < 0.02:
                        member[k] = -1
                        continue
                    e = ray[k, 0] * facing - d
                    straight = variance * facing * facing + flat2
                    w = 1.0 / (variance * max(facing, settings.steepest) ** 2)
                    t = d * (nx * ray[k, 3] - ny * ray[k, 2]) / facing
                    after = k + 1 if k + 1 < len(ray) else 0
                    goes_on = (k == line[FIRST] and not broken[k]) or (k == line[LAST] and not broken[after])
                    # The variance of e: less for a beam that has drawn the line to itself, more for one that has not.
                    lever = w / weight + w * (t - centre) * (t - centre) / spread
                    lever = 1.0 - min(lever, 0.9) if member[k] == h and not goes_on else 1.0 + lever
                    limit = END_TRIM if k == line[FIRST] or k == line[LAST] else TRIM
                    member[k] = -1
                    if e * e * w > limit * limit * wide * lever:
                        continue
                    if iteration == 1 and e * e > TRIM * TRIM * straight:
                        continue
                    member[k] = h
                    if t < low:
                        low, begin = t, k
                    if t > high:
                        high, end = t, k
                    seen += 1.0
                    if goes_on:
                        continue
                    size += math.sqrt(e * e * w)
                    beams += 1.0
                    rough += e * e / straight
                    scale += w * e * e
                    W += w
                    Wt += w * t
                    Wtt += w * t * t
                    We += w * e
                    Wte += w * t * e
                p = follower[p]
            line[FIRST], line[LAST] = begin, end
            if beams < 3.0 or not Wtt - Wt * Wt / W > 0.0:
                beams = 0.0
                break
            if iteration > 0:
                # Mean absolute deviations: squares would let what is to be left out widen its own limit.
                size = (settings.prior * MEAN_SIZE + size) / (settings.prior + beams)
                wide = max(size / MEAN_SIZE, 1.0) ** 2
                weight, centre, spread = W, Wt / W, Wtt - Wt * Wt / W
            if iteration < PASSES - 1:
                t, e = Wt / W, We / W
                turn = -(Wte - Wt * e) / (Wtt - Wt * t)  # e grows along the wall: clockwise
                x, y = (d + e) * nx - t * ny, (d + e) * ny + t * nx
                c, q = math.cos(turn), math.sin(turn)
                nx, ny = c * nx - q * ny, q * nx + c * ny
                d = nx * x + ny * y
                if not d > 0.0:
                    beams = 0.0
                    break
        if beams < 3.0 or rough > ROUGH * max(beams - 2.0, 1.0):
            continue
        t = Wt / W
        scale = (settings.prior + scale) / (settings.prior + beams - 2.0)
        line[0], line[1], line[2] = d * nx - t * ny, d * ny + t * nx, math.atan2(nx, -ny)
        line[3], line[4] = low - t, high - t
        line[5], line[6] = scale / W, scale / (Wtt - Wt * t)
        line[9] = seen
        line[NX], line[NY], line[D] = nx, ny, d
        line[KEPT] = 1.0 if seen >= settings.fewest and high - low >= settings.shortest else 0.0


UNDECIDED = -1


@inline
def _end(
    ray: Any, member: Any, line: Any, lines: Any, k: Any, way: Any, step: Any, closed: Any, max_range: Any,
    variance: Any, settings: Any,
) -> Any:  # fmt: skip
    """Why a line ends with beam k, going way = 1 or -1 from beam to beam, and where, along the line.

    The wall could go on as far as the ray of the next beam meets its line; what that beam saw says why it does not.
    """
    n = len(ray)
    nx, ny, d = line[NX], line[NY], line[D]
    end = t = _along(ray, k, nx, ny, d)
    why, j = UNDECIDED, k
    for _ in range(3):  # single beams at a corner may be of no line, or on this one and yet no part of it
        before, j = j, j + way
        if closed:
            j = (j + n) % n
        if j < 0 or j >= n or j == k:
            break
        t_next = _along(ray, j, nx, ny, d)
        if member[j] >= 0 and lines[member[j], KEPT] >= 0.0:
            ox, oy, od = lines[member[j], NX], lines[member[j], NY], lines[member[j], D]
            det = nx * oy - ny * ox
            if abs(det) > 0.2:
                x, y = (d * oy - ny * od) / det, (nx * od - d * ox) / det
                corner, t_other = nx * y - ny * x, _along(ray, j, ox, oy, od)
                room = min(abs(t_next - t), 2.0 * SAME_END) + CORNER_ROOM
                room_other = min(abs(_along(ray, before, ox, oy, od) - t_other), 2.0 * SAME_END) + CORNER_ROOM
                if abs(corner - t) <= room and abs(ox * y - oy * x - t_other) <= room_other:
                    return CORNER, corner
        if why == UNDECIDED:
            turn = _turn(ray, before, j) if way > 0 else _turn(ray, j, before)
            facing = nx * ray[j, 2] + ny * ray[j, 3]
            off = ray[j, 0] * facing - d
            room = OFF * math.sqrt(variance * facing * facing + settings.flat * settings.flat)
            if turn > 1.5 * step or facing < 0.02 or d > max_range * facing:
                why = OUT_OF_REACH
            elif off < -room:
                why = HIDDEN
            elif off > room:  # the ray goes through where the wall would be
                why = EDGE if abs(t_next - t) <= SAME_END else OUT_OF_REACH
            else:
                t = t_next
        if member[j] >= 0:
            break
    return OUT_OF_REACH if why == UNDECIDED else why, end


@kernel
def _ends(
    ray: Any, member: Any, step: Any, closed: Any, max_range: Any, variance: Any, settings: Any, lines: Any
) -> None:
    """The ends of every line that is an observation (columns 3, 4, 7, 8)."""
    for h in range(len(lines)):
        line = lines[h]
        if line[KEPT] > 0.0:
            centre = line[NX] * line[1] - line[NY] * line[0]
            for side in range(2):
                k, way = (int(line[FIRST]), -1) if side == 0 else (int(line[LAST]), 1)
                kind, t = _end(ray, member, line, lines, k, way, step, closed, max_range, variance, settings)
                line[7 + side] = kind
                line[3 + side] = min(t - centre, 0.0) if side == 0 else max(t - centre, 0.0)
