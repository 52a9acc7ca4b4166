"""Where what came back to a laser lies on the map."""

from __future__ import annotations

import numpy as np

from scenarios.types import Source
from slam.geometry import compose
from slam.types import Floats, Scan


def returns(scan: Scan, s: Floats) -> Floats:
    """(m, 2) [m] where the beams ended that came back, seen from the pose s (3,) of the robot."""
    r, theta = scan.ranges, scan.bearings
    back = (r > 0.0) & (r < scan.max_range) & np.isfinite(r) & np.isfinite(theta)  # never true of NaN
    laser = compose(s, scan.origin)
    direction = laser[2] + theta[back]
    return laser[:2] + r[back, None] * np.stack([np.cos(direction), np.sin(direction)], axis=1)


def all_returns(source: Source, path: Floats) -> Floats:
    """(N, 2) [m] the same of all scans of the first T steps of a source, taken at the poses (T, 3)."""
    scans = (step.frame.scan for step in source.steps[: len(path)])
    found = [returns(scan, pose) for scan, pose in zip(scans, path, strict=True) if scan is not None]
    return np.concatenate([np.zeros((0, 2)), *found])
