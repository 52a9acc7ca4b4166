"""A ray caster in plain NumPy, worlds of straight walls, and what an extractor ought to have found in them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from slam.perception import Extraction, extract
from slam.perception.score import Score, total
from slam.perception.score import score as score_scan
from slam.types import UNKNOWN_TAG, Floats, Ints, Scan


class Laser(NamedTuple):
    beams: int = 181
    view: float = 180.0  # degrees
    reach: float = 8.0  # m
    sigma: float = 0.01  # m
    quantum: float = 0.0  # m, 0: not rounded
    missing: float = 0.0  # share of beams that do not return
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def bearings(self) -> Floats:
        """The last beam of a scan all round is one step before the first, unless their number is odd."""
        inclusive = self.view < 360.0 or self.beams % 2 == 1
        return np.radians(np.linspace(-self.view / 2, self.view / 2, self.beams, endpoint=inclusive))


def cast(walls: Floats, place: Floats, bearings: Floats) -> tuple[Floats, Ints]:
    """Ranges (B,) [m], inf for none, and the wall met (B,), -1 for none; walls (W, 4) from (x, y) to (x, y)."""
    angle = place[2] + bearings
    ux, uy = np.cos(angle)[:, None], np.sin(angle)[:, None]
    ax, ay = walls[:, 0] - place[0], walls[:, 1] - place[1]
    ex, ey = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    cross = ux * ey - uy * ex
    cross = np.where(np.abs(cross) < 1e-12, 1e-12, cross)
    r = (ax * ey - ay * ex) / cross
    along = (ax * uy - ay * ux) / cross
    r = np.where((r > 0.0) & (along >= 0.0) & (along <= 1.0), r, np.inf)
    met = r.argmin(axis=1)
    best = r[np.arange(len(r)), met]
    return best, np.where(np.isfinite(best), met, -1)


def look(rng: np.random.Generator, walls: Floats, pose: Floats, laser: Laser) -> Scan:
    """What a laser on a robot at `pose` measures; the tag of a wall is its row."""
    x, y, heading = laser.origin
    c, q = math.cos(pose[2]), math.sin(pose[2])
    place = np.array([pose[0] + c * x - q * y, pose[1] + q * x + c * y, pose[2] + heading])
    r, met = cast(walls, place, laser.bearings)
    r = r + rng.normal(0.0, laser.sigma, len(r))
    if laser.quantum:
        r = np.round(r / laser.quantum) * laser.quantum
    r = np.where((r >= laser.reach) | (rng.random(len(r)) < laser.missing), np.inf, r)
    return Scan(r, laser.bearings, np.array(laser.origin), laser.reach, np.where(np.isfinite(r), met, UNKNOWN_TAG))


# Worlds: walls (W, 4) and a place to stand (x, y) ---------------------------------------------------------------------


def path(*corners: tuple[float, float]) -> Floats:
    p = np.array(corners)
    return np.hstack([p[:-1], p[1:]])


def box(x: float, y: float, length: float, width: float, turn: float) -> Floats:
    c, q = math.cos(turn), math.sin(turn)
    local = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * [length / 2, width / 2]
    p = local @ np.array([[c, q], [-q, c]]) + [x, y]
    return np.hstack([p[:-1], p[1:]])


def room(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """A rectangle with an alcove, and boxes in it."""
    length, width = rng.uniform(3, 12), rng.uniform(3, 8)
    cut, deep = rng.uniform(0.2, 0.8) * length, rng.uniform(0.8, 2.0)
    walls = [path((0, 0), (length, 0), (length, width), (cut, width), (cut, width + deep), (0, width + deep), (0, 0))]
    place = rng.uniform((0.6, 0.6), (length - 0.6, width - 0.6))
    for _ in range(rng.integers(0, 5)):
        x, y = rng.uniform((0.5, 0.5), (length - 0.5, width - 0.5))
        if math.hypot(x - place[0], y - place[1]) > 1.2:
            walls.append(box(x, y, rng.uniform(0.2, 1.2), rng.uniform(0.2, 1.2), rng.uniform(0, math.pi)))
    return np.vstack(walls), place


def corridor(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """30 m long, with doors of 0.9 m that stand back by 0.12 m, and now and then a box at the wall."""
    width, walls = rng.uniform(1.6, 3.0), []
    for side in (0, 1):
        x, corners = 0.0, [(0.0, 0.0)]
        while x < 25.0:
            x += rng.uniform(1.0, 5.0)
            corners += [(x, 0.0), (x, -0.12), (x + 0.9, -0.12), (x + 0.9, 0.0)]
            x += 0.9
        corners.append((30.0, 0.0))
        p = path(*corners)
        walls.append(p if side == 0 else [30.0, width, 30.0, width] - p)
    walls += [path((0, 0), (0, width)), path((30, 0), (30, width))]
    place = np.array([rng.uniform(1, 29), rng.uniform(0.5, width - 0.5)])
    for _ in range(3):
        x = rng.uniform(1, 29)
        if abs(x - place[0]) > 1.0:
            walls.append(box(x, 0.2, 0.6, 0.4, 0.0))
    return np.vstack(walls), place


# What was found -------------------------------------------------------------------------------------------------------


World = Callable[[np.random.Generator], tuple[Floats, Floats]]


def score(world: World, laser: Laser, scans: int, seed: int, settings: Extraction | None = None) -> Score:
    """Look at `scans` worlds, built by `world(rng)`, once each, with a laser in the origin of the robot."""
    rng = np.random.default_rng(seed)
    settings = settings or Extraction(quantum=laser.quantum)
    scores = []
    for _ in range(scans):
        walls, place = world(rng)
        pose = np.array([*place, rng.uniform(-math.pi, math.pi)])
        scan = look(rng, walls, pose, laser)
        exact, _ = cast(walls, pose, laser.bearings)
        segments = extract(scan, laser.sigma, settings)
        scores.append(score_scan(segments, scan, exact, np.arange(len(walls)), walls, pose, settings))
    return total(scores)
