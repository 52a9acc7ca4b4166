"""What a sensor sees of a world, without noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from scenarios.checks import check_angle, check_number
from scenarios.types import SourceError
from slam.geometry import wrap_all
from slam.types import Floats, Ints

BLIND = 0.01
"""[m] A landmark nearer than this is under the sensor: it has no bearing and is not seen."""

MAX_OBSERVATIONS = 20_000_000


@dataclass(frozen=True)
class Sensor:
    """Measures range and bearing of every landmark within reach; nothing hides a landmark."""

    max_range: float = 10.0
    """[m]; may be infinite."""
    field_of_view: float = math.pi
    """[rad] the whole opening, centred on the heading: pi is the frontal half circle."""
    every: int = 5
    """Control ticks from one observation to the next.

    Counted, not measured in seconds: the simulator of the paper adds up 0.025 s eight times, finds that below its
    0.2 s, and observes every ninth tick.
    """


def check_sensor(sensor: Sensor) -> None:
    """Raise `SourceError` unless the sensor can see something."""
    check_number("sensor.max_range", sensor.max_range, "m", above=BLIND, most=math.inf)
    check_angle("sensor.field_of_view", sensor.field_of_view, above=0, most=360)
    check_number("sensor.every", sensor.every, "control ticks", least=1, whole=True)


def visible(sensor: Sensor, theta: Floats, pose: Floats) -> tuple[Ints, Floats]:
    """Which of the landmarks theta (n, 2) are seen from the pose (3,), in order, and z (Z, 2) [m, rad] (45)."""
    dx, dy = theta[:, 0] - pose[0], theta[:, 1] - pose[1]
    distance = np.hypot(dx, dy)
    bearing = wrap_all(np.arctan2(dy, dx) - pose[2])
    near = (distance >= BLIND) & (distance <= sensor.max_range)
    seen = np.flatnonzero(near & (np.abs(bearing) <= 0.5 * sensor.field_of_view))
    return seen, np.stack([distance[seen], bearing[seen]], axis=1)


def observe(sensor: Sensor, theta: Floats, poses: Floats) -> list[tuple[Ints, Floats]]:
    """`visible` from each of the poses (S, 3), through a search tree: a large world costs no more than a small one.

    Raises `SourceError` where the sensor would see more than the memory holds.
    """
    tree = KDTree(theta)
    reach = min(1.001 * sensor.max_range, 1e8)
    near = np.asarray(tree.query_ball_point(poses[:, :2], reach, return_length=True))
    if near.sum() > MAX_OBSERVATIONS:
        raise SourceError(
            f"sensor.max_range is {sensor.max_range:g}: {len(poses)} steps would see about {near.mean():.0f} of "
            f"the {len(theta)} landmarks each; expected at most {MAX_OBSERVATIONS} observations in all"
        )
    seen = []
    for pose in poses:
        candidates = np.array(tree.query_ball_point(pose[:2], reach, return_sorted=True), np.int64)
        index, z = visible(sensor, theta[candidates], pose)
        seen.append((candidates[index], z))
    return seen
