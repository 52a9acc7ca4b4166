"""What a laser sees of a world of walls, without noise: exact ray casting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenarios.checks import LARGEST, check_angle, check_number
from scenarios.sensors import BLIND, MAX_OBSERVATIONS
from scenarios.types import SourceError, TrueMap
from slam._jit import inline, kernel
from slam.geometry import TWO_PI, compose, wrap
from slam.types import UNKNOWN_TAG, Floats, Ints, Scan

MAX_BEAMS = 100_000

OVERLAP = 1e-9
"""[m] that a wall is longer at both ends for the beams, so that none slips through a corner of two walls."""

CORNER = 1e-6
"""[m] A beam that meets two walls nearer to one another than this has hit a corner, and the tag is that of a face which
is turned to the laser."""


@dataclass(frozen=True)
class Laser:
    """Measures the range along every beam to the first wall, or person, that it meets."""

    beams: int = 181
    """How many, evenly spaced, from one border of the field of view to the other; all round, the last is one spacing
    before the first."""
    field_of_view: float = math.pi
    """[rad] the whole opening, centred on the x axis of the laser; a single beam looks along that axis."""
    max_range: float = 8.0
    """[m] beyond which nothing comes back; may be infinite."""
    every: int = 5
    """Control ticks from one scan to the next."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(m, m, rad) pose of the laser on the robot."""


def check_laser(laser: Laser) -> None:
    """Raise `SourceError` unless the laser can see something."""
    check_number("laser.beams", laser.beams, "beams", least=1, most=MAX_BEAMS, whole=True)
    check_angle("laser.field_of_view", laser.field_of_view, above=0, most=360)
    check_number("laser.max_range", laser.max_range, "m", above=BLIND, most=math.inf)
    check_number("laser.every", laser.every, "control ticks", least=1, whole=True)
    for name, value in zip("xy", laser.origin[:2], strict=True):
        check_number(f"laser.origin: {name}", value, "m", least=-LARGEST)
    check_angle("laser.heading", laser.origin[2], least=-360, most=360)


def beam_bearings(laser: Laser) -> Floats:
    """(B,) [rad] increasing, from the x axis of the laser."""
    if laser.beams == 1:
        return np.zeros(1)
    first = -0.5 * laser.field_of_view
    return first + spacing(laser) * np.arange(laser.beams, dtype=float)


def spacing(laser: Laser) -> float:
    """[rad] between two beams."""
    all_round = laser.field_of_view >= TWO_PI - 1e-9
    return laser.field_of_view / (laser.beams if all_round else max(1, laser.beams - 1))


def scan(laser: Laser, walls: Floats, poses: Floats, discs: Floats | None = None) -> list[Scan]:
    """What is seen of the walls (n, 4) from the poses (S, 3) of the robot; `discs` (S, m, 3) (x, y, radius) [m] hide
    it.

    A beam that ends on a wall carries the tag of the face that it meets: n for the one to the left of wall n, and n
    plus the number of walls for the other (`faces`); one that ends on a disc carries `UNKNOWN_TAG`.  Neither a wall
    nearer than `BLIND` is seen, nor a disc that the laser is in.  Raises `SourceError` where the memory would not
    hold so many beams.
    """
    steps, beams = len(poses), laser.beams
    if steps * beams > MAX_OBSERVATIONS:
        raise SourceError(
            f"laser.beams is {beams}: {steps} scans of so many are {steps * beams} beams; expected at most "
            f"{MAX_OBSERVATIONS} in all"
        )
    origin = np.array(laser.origin, float)
    bearings = beam_bearings(laser)
    ranges = np.full((steps, beams), np.inf)
    tags = np.full((steps, beams), UNKNOWN_TAG)
    if discs is None:
        discs = np.empty((steps, 0, 3))
    _cast(
        compose(poses, origin),
        bearings,
        spacing(laser),
        np.ascontiguousarray(walls),
        np.ascontiguousarray(discs),
        float(laser.max_range),
        np.empty((beams, 2)),
        ranges,
        tags,
    )
    return [Scan(ranges[i], bearings, origin, float(laser.max_range), tags[i]) for i in range(steps)]


@inline
def _meet(ax: Any, ay: Any, ex: Any, ey: Any, c: Any, q: Any) -> Any:
    """How far along the direction (c, q) from the origin the wall from (ax, ay) to (ax + ex, ay + ey) is; inf if it is
    not."""
    slope = c * ey - q * ex
    if slope == 0.0:
        return math.inf  # seen edge-on
    along = (ax * q - ay * c) / slope  # 0 to 1 from end to end
    overlap = OVERLAP / math.sqrt(ex * ex + ey * ey)
    return (ax * ey - ay * ex) / slope if -overlap <= along <= 1.0 + overlap else math.inf


@kernel
def _cast(
    lasers: Any, bearings: Any, step: Any, walls: Any, discs: Any, max_range: Any, work: Any, ranges: Any, tags: Any
) -> None:
    """The nearest wall of every beam of every scan, into `ranges` and `tags`; `work` (B, 2) are the beams' directions.

    Every wall is tried by the beams between its two ends and by one more at either side, and by all beams where the
    laser stands so nearly in line with it that rounding decides what is between.
    """
    B = len(bearings)
    for k in range(len(lasers)):
        x, y, phi = lasers[k, 0], lasers[k, 1], lasers[k, 2]
        for i in range(B):
            work[i, 0], work[i, 1] = math.cos(phi + bearings[i]), math.sin(phi + bearings[i])
        for n in range(len(walls)):
            ax, ay, bx, by = walls[n, 0] - x, walls[n, 1] - y, walls[n, 2] - x, walls[n, 3] - y
            if min(ax, bx) > max_range or max(ax, bx) < -max_range:
                continue
            if min(ay, by) > max_range or max(ay, by) < -max_range:
                continue
            start, end = math.atan2(ay, ax), math.atan2(by, bx)
            sweep = wrap(end - start)
            if sweep < 0.0:
                start, sweep = end, -sweep
            start = wrap(start - phi)
            front = (bx - ax) * ay <= (by - ay) * ax  # the laser is to the left of the wall, or on its line
            everywhere = sweep > 3.14 or ax * ax + ay * ay < 1e-6 or bx * bx + by * by < 1e-6
            for turn in range(2):  # the wall may reach across the seam behind the laser
                low, high = 0, B - 1
                if not everywhere:
                    first = (start - turn * TWO_PI - bearings[0]) / step
                    low, high = max(low, math.floor(first)), min(high, math.ceil(first + sweep / step))
                elif turn == 1:
                    break
                for i in range(low, high + 1):
                    distance = _meet(ax, ay, bx - ax, by - ay, work[i, 0], work[i, 1])
                    if not BLIND <= distance <= max_range:
                        continue
                    nearer, from_behind = ranges[k, i] - distance, tags[k, i] >= len(walls)
                    if nearer > CORNER or (abs(nearer) <= CORNER and front and from_behind):
                        tags[k, i] = n if front else len(walls) + n
                    ranges[k, i] = min(ranges[k, i], distance)
        for m in range(discs.shape[1]):
            cx, cy, radius = discs[k, m, 0] - x, discs[k, m, 1] - y, discs[k, m, 2]
            away = math.hypot(cx, cy)
            if away <= radius or away - radius > max_range:
                continue
            for i in range(B):
                ahead = work[i, 0] * cx + work[i, 1] * cy
                aside = work[i, 0] * cy - work[i, 1] * cx
                if ahead <= 0.0 or abs(aside) > radius:
                    continue
                distance = ahead - math.sqrt(radius * radius - aside * aside)
                if BLIND <= distance <= max_range and distance < ranges[k, i]:
                    ranges[k, i], tags[k, i] = distance, UNKNOWN_TAG


def faces(walls: Floats, scans: Sequence[Scan]) -> TrueMap:
    """Walls (n, 4) and their tags, and after them the backs of those that scans see from behind, turned round.

    The two faces of a wall are two features of a map (Fig. 11).
    """
    seen = [walls_in_view(found) for found in scans]
    behind = np.unique(np.concatenate(seen)) if seen else np.empty(0, np.int64)
    behind = behind[behind >= len(walls)]
    theta = np.concatenate([walls, walls[behind - len(walls)][:, [2, 3, 0, 1]]])
    return TrueMap(np.concatenate([np.arange(len(walls)), behind]), theta)


def walls_in_view(found: Scan) -> Ints:
    """The tags of the faces that a scan of a simulated world meets, in order."""
    return np.empty(0, np.int64) if found.walls is None else np.unique(found.walls[found.walls != UNKNOWN_TAG])
