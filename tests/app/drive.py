"""A small laser log that a test writes, and the paths that are written of it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from scenarios.registry import build
from slam.geometry import compose, invert
from slam.types import Scan
from tests.scenarios.laser_logs import flaser, write

STEPS = 60


class Drive:
    """A drive round a corner of the simulated corridors, as a log with odometry that turns too much, or is exact."""

    def __init__(self, folder: Path, exact: bool = False) -> None:
        steps = build("loop", start=2.0).steps[:STEPS]
        self.truth = np.array([step.truth for step in steps])
        self.stamps = 1e9 + 0.5 * np.arange(STEPS)
        self.stamps[20] = self.stamps[18] + 0.1  # a stamp that steps back, as real ones do
        odometry = [self.truth[0]]
        for a, b in zip(self.truth[:-1], self.truth[1:], strict=True):
            odometry.append(compose(odometry[-1], compose(invert(a), b) * [1.02, 1.0, 1.05] + [0, 0, 0.001]))
        self.odometry = self.truth if exact else np.array(odometry)
        self.scans: list[Scan] = []
        lines = []
        for step, pose, stamp in zip(steps, self.odometry, self.stamps, strict=True):
            assert step.frame.scan is not None
            self.scans.append(step.frame.scan)
            ranges = np.where(np.isinf(step.frame.scan.ranges), 81.91, step.frame.scan.ranges)
            lines.append(flaser(ranges, pose, pose, stamp))
        self.log = write(folder, "".join(lines), "drive.log")
        self.pairs = [(0, 30), (10, 19), (20, 59), (35, 50)]
        rows = [(self.stamps[i], self.stamps[k], compose(invert(self.truth[i]), self.truth[k])) for i, k in self.pairs]
        text = "".join(f"{a:.6f} {b:.6f} {x:.6f} {y:.6f} 0 0 0 {yaw:.6f}\n" for a, b, (x, y, yaw) in rows)
        self.relations = write(folder, text, "drive.relations")
        poses = zip(self.stamps, self.truth, strict=True)
        text = "".join(f"{i} {t:.6f} {x:.6f} {y:.6f} {h:.6f}\n" for i, (t, (x, y, h)) in enumerate(poses) if i % 3 == 0)
        self.reference = write(folder, text, "drive.reference")

    def off(self, path: np.ndarray) -> np.ndarray:
        """(R,) [m] of each relation, by its definition."""
        found = []
        for i, k in self.pairs:
            a, b = (compose(invert(poses[i]), poses[k]) for poses in (path, self.truth))
            found.append(math.dist(a[:2], b[:2]))
        return np.array(found)


def tum(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (M,) and poses (M, 3)."""
    table = np.loadtxt(path)
    return table[:, 0], np.column_stack([table[:, 1:3], 2 * np.arctan2(table[:, 6], table[:, 7])])
