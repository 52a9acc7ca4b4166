"""Victoria Park: a car among trees (Guivant and Nebot, ACFR, Sydney): vehicle, tree sightings, GPS.

Three text files in a directory, all starting with the time [s]: dead reckoning (speed of the left rear wheel,
steering), trees (range and bearing to the centre of a trunk, diameter), and GPS (x, y; without it there is no truth).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from scenarios.logs.text import Head, Role, Table, read_table
from scenarios.logs.timing import HOLD, interpolate, ticks, with_controls
from scenarios.types import Source, SourceError, Step
from slam.features.point import Point
from slam.geometry import wrap_all
from slam.motion import Ackermann
from slam.types import UNKNOWN_TAG, Floats, Frame, Noise

TITLE = "Victoria Park"
EXPECTED = "Victoria Park (dead reckoning: t speed steering; trees: t range bearing diameter; GPS: t x y)"
ONE_FILE = False

VEHICLE = Ackermann(wheelbase=2.83, ahead=3.78, left=0.5)
"""The pose is that of the laser, 3.78 m ahead of the rear axle and 0.5 m left of the centre line.

The GPS fixes, fitted to the path of an EKF-SLAM, lie within 0.2 m of the laser: no arm to correct for."""

WHEEL_LEFT = 0.76
"""[m] from the centre line to the left rear wheel, where the speed is measured."""

START = (-67.65, -41.71, math.radians(35.5))
"""Where the vehicle stands at first, in the frame of the GPS: the first fix; the heading belongs to the data set.

The later fixes, as a whole, fit a path that starts 1.9 m to the north-west of this."""

MAX_STEERING = 1.2
"""[rad] beyond any real steering (0.6 in the log); the correction of the wheel speed is singular at 1.31."""

FIX_GAP = 0.45
"""[s] between two GPS fixes (0.2 when reception is good) beyond which nothing is said about the time between."""

FIX_SPEED = 10.0
"""[m/s] between two fixes above which one of them has jumped; the car never exceeds 6.7 m/s."""

DEAD_RECKONING = ("time [s]", "speed [m/s]", "steering [rad]")
TREES = ("time [s]", "range [m]", "bearing from the right [rad]", "diameter [m]")
GPS = ("time [s]", "x east [m]", "y north [m]")

BELIEVED = Noise(speed=0.7, turn=math.radians(6.0), range=1.0, bearing=math.radians(2.0))
"""Deviations of speed and steering in each tick (25 ms), and of a sighting.

Measured against the path of an EKF-SLAM on this log.  Errors of the dead reckoning over 5 to 50 s grow as independent
errors of 0.6 m/s and 7 to 9 degrees a tick would make them (over 1 s: 0.5 m/s, 4 degrees); most of it is a steering
bias of 0.3 degrees.  Innovations of matched trees spread by 0.2-0.4 m and 0.6-0.9 degrees; but the same few trunks are
seen in scan after scan with the same error, so the deviations are about three times that.  Others believe more:
UFastSLAM (openslam_ufastslam, setconfigfile.m) 2 m/s, 6 degrees, 1 m, 3 degrees; RFS-SLAM
(fastslam_VictoriaPark.xml) for the sensor 1.4 m and 2.5 degrees with its inflation of 75.
"""


def role(head: Head) -> Role | None:
    """What the columns of a file say it is; None if it is no file of a data set.

    Dead reckoning and GPS have three columns both.  Comments or a usual name may tell; otherwise steering is what stays
    below 1.2 rad and comes 40 times a second, against 5.
    """
    rows, columns = head.rows, head.rows.shape[1]
    widths = {"dead_reckoning": 3, "gps": 3, "trees": 4}
    usual = next((kind for kind in widths if head.path.name.lower().startswith(kind)), None)
    if usual and columns in (0, widths[usual]):  # even without one good row: reading the file will say what is wrong
        return Role(usual)
    if columns not in (3, 4) or np.any(rows[:, 0] < 0) or np.any(np.abs(rows[:, 0]) > 1e8):
        return None
    if columns == 4:
        bearing = (rows[:, 2] >= 0) & (rows[:, 2] <= math.pi)
        return Role("trees") if np.mean(bearing & (rows[:, 1] > 0)) > 0.5 else None
    if "steering" in head.comments:
        return Role("dead_reckoning")
    if "gps" in head.comments or "north" in head.comments:
        return Role("gps")
    fast = len(rows) < 2 or np.median(np.diff(rows[:, 0])) < 0.15
    return Role("dead_reckoning" if fast and np.mean(np.abs(rows[:, 2]) <= MAX_STEERING) > 0.5 else "gps")


def read(place: Path, files: dict[Role, Path], robot: int | None) -> Source:
    """The whole log.  `place` is for messages; `files` what `role` found there.  Raises `SourceError`."""
    if robot is not None:
        raise SourceError(f"{place}: no robot {robot}; expected no choice of robot, Victoria Park has one vehicle")
    missing = [kind for kind in ("dead_reckoning", "trees") if Role(kind) not in files]
    if missing:
        columns = {"dead_reckoning": DEAD_RECKONING, "trees": TREES}[missing[0]]
        raise SourceError(
            f"{place}: no file of {missing[0].replace('_', ' ')} for {TITLE}; expected one with {', '.join(columns)}"
        )
    wheel = read_table(files[Role("dead_reckoning")], DEAD_RECKONING)
    trees = read_table(files[Role("trees")], TREES)
    fixes = read_table(files[Role("gps")], GPS) if Role("gps") in files else None
    warnings = [*wheel.warnings, *trees.warnings]
    for table in (wheel, trees, *([fixes] if fixes else [])):
        table.require_time_order()
    wheel.require(2, np.abs(wheel.values[:, 2]) <= MAX_STEERING, f"a steering angle within +-{MAX_STEERING} rad")
    trees.require(1, trees.values[:, 1] > 0, "a range above 0 m")
    in_front = (trees.values[:, 2] >= 0) & (trees.values[:, 2] <= math.pi)
    trees.require(2, in_front, "a bearing from 0 (right) to pi (left)")

    start_time = float(wheel.values[0, 0]) - HOLD
    t_trees, first = np.unique(trees.values[:, 0], return_index=True)
    good, complaints = with_controls(wheel, t_trees, start_time)
    warnings += complaints
    last = np.append(first[1:], len(trees.values))
    stamps, first, last = t_trees[good], first[good], last[good]
    z = np.stack([trees.values[:, 1], wrap_all(trees.values[:, 2] - 0.5 * math.pi)], axis=1)
    if fixes is None:
        warnings.append(f"{place}: no GPS file, so there is no truth; expected one with {', '.join(GPS)}")
        truths = [None] * len(stamps)
    else:
        warnings += fixes.warnings
        truths = _truth(fixes, stamps)
    feature = Point()
    steps = tuple(
        Step(Frame(float(t), VEHICLE, u, dt, feature, z[a:b], np.full(b - a, UNKNOWN_TAG, dtype=np.int64)), truth)
        for t, (u, dt), a, b, truth in zip(
            stamps, ticks(wheel.values[:, 0], controls(wheel), start_time, stamps), first, last, truths, strict=True
        )
    )
    known = sum(truth is not None for truth in truths)
    return Source(
        name="victoria-park",
        title=f"{TITLE}: {(last - first).sum()} sightings of trees from a car, GPS at {known} of {len(steps)} steps",
        kind="log",
        motion=VEHICLE,
        feature=feature,
        steps=steps,
        start=np.array(START),
        noise=BELIEVED,
        max_range=80.0,
        # The errors of one trunk are alike in scan after scan: what they weigh is tempered (K = 30, seeds 0 and 1:
        # 3.6 and 3.2 m from the GPS with 0.1, 6.9 and 7.8 m with 1).
        defaults={"association": "jcbb", "temper": 0.1},
        warnings=tuple(warnings),
    )


def controls(wheel: Table) -> Floats:
    """(N, 2) speed of the front wheel [m/s] and steering [rad] from the speed of the left rear wheel.

    In a left turn the left rear wheel runs slower than the middle of the rear axle, and the front wheel faster.
    """
    v, steering = wheel.values[:, 1], wheel.values[:, 2]
    rear = v / (1.0 - np.tan(steering) * WHEEL_LEFT / VEHICLE.wheelbase)
    return np.stack([rear / np.cos(steering), steering], axis=1)


def _truth(fixes: Table, stamps: Floats) -> list[Floats | None]:
    """(x, y, NaN) at each time where GPS fixes surround it closely and agree with a car's speed; else None."""
    t, xy = fixes.values[:, 0], fixes.values[:, 1:]
    span = np.diff(t)
    jump = np.hypot(*np.diff(xy, axis=0).T) > FIX_SPEED * span
    found = interpolate(t, xy, stamps, (span <= FIX_GAP) & ~jump)
    return [None if p is None else np.array([p[0], p[1], math.nan]) for p in found]
