"""What a robot's own odometry says of the way between two scans."""

from __future__ import annotations

import numpy as np

from slam.geometry import compose, invert, wrap_all
from slam.types import Floats

LEVER = 0.5
"""[m] of way that a turn of one radian counts as, so that turning on the spot gets somewhere, too."""


def increments(odometry: Floats) -> Floats:
    """(N, 3) [m, m, rad] motion since the pose (N, 3) before, in the frame of that pose; none for the first."""
    moved = np.zeros((len(odometry), 3))
    moved[1:] = compose(invert(odometry[:-1]), odometry[1:])
    return moved


def path_length(odometry: Floats) -> float:
    """[m] of the straight pieces between the poses (N, 3)."""
    return float(np.hypot(*np.diff(odometry[:, :2], axis=0).T).sum())


def travelled(odometry: Floats) -> Floats:
    """(N,) [m] from the first pose to each of the poses (N, 3), with `LEVER` for turns."""
    step = np.diff(odometry, axis=0)
    way = np.hypot(step[:, 0], step[:, 1]) + LEVER * np.abs(wrap_all(step[:, 2]))
    return np.concatenate([[0.0], np.cumsum(way)])


def carried(pose: Floats, start: Floats, end: Floats) -> Floats:
    """A pose (..., 3) that is known where odometry says `start`, moved to where it says `end`; (..., 3) each."""
    return compose(pose, compose(invert(start), end))
