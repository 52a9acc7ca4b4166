"""UTIAS MRCLAM: robots that see barcodes, under a Vicon system (Leung, Halpern, Barfoot, Liu, IJRR 30(8), 2011).

A data set is a directory with Robot<N>_Odometry, Robot<N>_Measurement and Robot<N>_Groundtruth for each robot, Barcodes
and Landmark_Groundtruth.  Measurements name barcodes; Barcodes.dat gives the subject behind each: 1-5 are the robots,
6-20 the landmarks.  Only landmarks are observations here, with their subject numbers as tags.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenarios.logs.text import Head, Role, Table, read_table
from scenarios.logs.timing import interpolate, ticks, with_controls
from scenarios.types import Source, SourceError, Step, TrueMap
from slam.features.point import Point
from slam.geometry import wrap, wrap_all
from slam.motion import Unicycle
from slam.types import Floats, Frame, Ints, Noise

TITLE = "UTIAS MRCLAM"
EXPECTED = "UTIAS MRCLAM (Robot<N>_Odometry, _Measurement, _Groundtruth, Barcodes, Landmark_Groundtruth)"
ONE_FILE = False

ROBOTS = range(1, 6)
"""Subjects that are robots; larger numbers are landmarks."""

TRUTH_GAP = 0.5
"""[s] between two Vicon poses (usually 0.01) beyond which nothing is said about the time between."""

ODOMETRY = ("time [s]", "forward velocity [m/s]", "angular velocity [rad/s]")
MEASUREMENT = ("time [s]", "barcode", "range [m]", "bearing [rad]")
GROUNDTRUTH = ("time [s]", "x [m]", "y [m]", "orientation [rad]")
BARCODES = ("subject", "barcode")
LANDMARKS = ("subject", "x [m]", "y [m]", "x deviation [m]", "y deviation [m]")

BELIEVED = Noise(speed=0.1, turn=0.25, range=0.2, bearing=0.02)
"""Deviations of speed and turn rate in each tick, and of a sighting, for all five robots of data set 6.

Odometry against Vicon: over 1 s the errors are 0.012 m and 0.034-0.054 rad, over 20 s the turn is 0.12-0.17 rad off;
independent errors in ticks as long as these (effectively 26-30 ms for robots 2, 3 and 5) make that of 0.07 m/s and
0.2-0.3 rad/s.  The logged speed is 5 to 11 % too high throughout, so a little more is believed of its deviation.
Sightings against the true map: 0.12-0.21 m and, barcodes mistaken for others aside, 0.6-1.1 degrees.
"""

DEFAULTS = {"association": "known", "gate_known": 1.0 - 1e-9, "temper": 0.1}
"""A barcode says which landmark it is, but not always rightly: four of robot 3's sightings, three in each thousand at
worst, are more than 2 rad off.  Errors of one landmark are alike from frame to frame, with a correlation c of 0.7-0.9
in range and 0.3-0.8 in bearing: n sightings tell as much as n (1 - c) / (1 + c) independent ones, and so they are
weighed.
"""


def role(head: Head) -> Role | None:
    """What the header of a file says it is, or without a header its name; None if it is no file of a data set.

    The number of the robot is nowhere but in the name.
    """
    name = head.path.name.lower()
    kinds = {
        "odometry": ("odometry data", r"robot\d+_odometry"),
        "measurement": ("measurement data", r"robot\d+_measurement"),
        "groundtruth": ("robot groundtruth data", r"robot\d+_groundtruth"),
        "barcodes": ("barcode data", r"barcodes"),
        "landmarks": ("landmark groundtruth data", r"landmark_groundtruth"),
    }
    found = [k for k, (header, _) in kinds.items() if header in head.comments]
    found += [k for k, (_, pattern) in kinds.items() if re.match(pattern, name)]
    if not found:
        return None
    if found[0] in ("barcodes", "landmarks"):
        return Role(found[0], 0)
    number = re.search(r"robot\D?(\d+)", name) or re.search(r"(\d+)", name)
    return Role(found[0], int(number[1]) if number else 1)


def read(place: Path, files: dict[Role, Path], robot: int | None) -> Source:
    """The log of one robot (default: the lowest number there is).

    `place` is for messages; `files` what `role` found there.  Raises `SourceError`.
    """
    robots = sorted({r.robot for r in files if r.robot})
    if robot is None:
        robot = robots[0] if robots else 1
    if robots and robot not in robots:
        raise SourceError(f"{place}: no robot {robot}; expected one of {', '.join(map(str, robots))}")
    wanted = {
        Role("odometry", robot): f"Robot{robot}_Odometry",
        Role("measurement", robot): f"Robot{robot}_Measurement",
        Role("groundtruth", robot): f"Robot{robot}_Groundtruth",
        Role("barcodes", 0): "Barcodes",
        Role("landmarks", 0): "Landmark_Groundtruth",
    }
    missing = [name for r, name in wanted.items() if r not in files]
    if missing:
        raise SourceError(f"{place}: no {' and no '.join(missing)}; expected a data set of {EXPECTED}")
    odometry, measurement, groundtruth, barcodes, landmarks = (
        read_table(files[r], columns)
        for r, columns in zip(wanted, (ODOMETRY, MEASUREMENT, GROUNDTRUTH, BARCODES, LANDMARKS), strict=True)
    )
    for table in (odometry, measurement, groundtruth):
        table.require_time_order()
    for table, columns in ((barcodes, (0, 1)), (landmarks, (0,)), (measurement, (1,))):
        for column in columns:
            whole = table.values[:, column]
            table.require(column, whole == np.floor(whole), "a whole number")
    for table, columns in ((barcodes, (0, 1)), (landmarks, (0,))):
        for column in columns:
            table.require(column, _first_of_its_kind(table.values[:, column]), "each number once")
    measurement.require(2, measurement.values[:, 2] > 0, "a range above 0 m")
    measurement.require(3, np.abs(measurement.values[:, 3]) <= math.tau, "radians, at most one turn")
    warnings = [w for t in (odometry, measurement, groundtruth, barcodes, landmarks) for w in t.warnings]

    subject_of = {int(code): int(subject) for subject, code in barcodes.values}
    subject = np.array([subject_of.get(int(code), -1) for code in measurement.values[:, 1]])
    unknown = np.flatnonzero(subject == -1)
    if len(unknown):
        warnings.append(
            f"{measurement.place(unknown[0])}: {len(unknown)} sightings of barcodes that {barcodes.path.name} does not "
            f"name are left out, the first of barcode {measurement.values[unknown[0], 1]:.0f}"
        )
    seen = np.flatnonzero((subject != -1) & ~np.isin(subject, ROBOTS))
    if not len(seen):
        raise SourceError(f"{measurement.path}: no sighting of a landmark; expected barcodes of subjects above 5")
    others = len(subject) - len(unknown) - len(seen)
    seen, doubled = _once_a_frame(seen, measurement.values[:, 0], subject)
    if len(doubled):
        where = measurement.place(doubled[0])
        warnings.append(f"{where}: {len(doubled)} repeated sightings of a landmark at the same time are left out")

    start, first_pose, truth_at = _truth(groundtruth, odometry)
    good, complaints = with_controls(odometry, np.unique(measurement.values[seen, 0]), start)
    stamps = np.unique(measurement.values[seen, 0])[good]
    warnings += complaints
    z = np.stack([measurement.values[:, 2], wrap_all(measurement.values[:, 3])], axis=1)
    motion, feature = Unicycle(), Point()
    bounds = np.searchsorted(measurement.values[seen, 0], stamps, side="left")
    ends = np.searchsorted(measurement.values[seen, 0], stamps, side="right")
    controls = ticks(odometry.values[:, 0], odometry.values[:, 1:], start, stamps)
    steps = tuple(
        Step(Frame(float(t), motion, u, dt, feature, z[rows], subject[rows].astype(np.int64)), truth)
        for t, (u, dt), rows, truth in zip(
            stamps, controls, (seen[a:b] for a, b in zip(bounds, ends, strict=True)), truth_at(stamps), strict=True
        )
    )
    is_landmark = ~np.isin(landmarks.values[:, 0], ROBOTS)
    name = measurement.path.absolute().parent.name
    return Source(
        name=f"{name}-robot{robot}",
        title=f"{TITLE} {name}, robot {robot}: {len(seen)} sightings of {len(set(subject[seen]))} landmarks "
        f"({others} of other robots left out), Vicon truth",
        kind="log",
        motion=motion,
        feature=feature,
        steps=steps,
        start=first_pose,
        noise=BELIEVED,
        true_map=TrueMap(landmarks.values[is_landmark, 0].astype(np.int64), landmarks.values[is_landmark, 1:3].copy()),
        max_range=float(z[seen, 0].max()),
        defaults=dict(DEFAULTS),
        warnings=tuple(warnings),
        options={"robot": robot},
    )


def _first_of_its_kind(values: Floats) -> NDArray[np.bool_]:
    """(N,) whether no earlier one of the values (N,) is the same."""
    first = np.zeros(len(values), np.bool_)
    first[np.unique(values, return_index=True)[1]] = True
    return first


def _once_a_frame(seen: Ints, times: Floats, subject: Ints) -> tuple[Ints, Ints]:
    """Rows `seen`, split in the first of each landmark at each time and its repetitions.

    Two sightings with one tag in one frame would be two new landmarks to a filter that has not seen it before.
    """
    _, first = np.unique(np.stack([times[seen], subject[seen]]), axis=1, return_index=True)
    return seen[np.sort(first)], np.delete(seen, first)


def _truth(groundtruth: Table, odometry: Table) -> tuple[float, Floats, Callable[[Floats], list[Floats | None]]]:
    """When the first control is that has a true pose, this pose (3,), and the true poses at any times."""
    t, poses = groundtruth.values[:, 0], groundtruth.values[:, 1:].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    usable = np.diff(t) <= TRUTH_GAP

    def at(times: Floats) -> list[Floats | None]:
        found = interpolate(t, poses, times, usable)
        return [None if p is None else np.array([p[0], p[1], wrap(float(p[2]))]) for p in found]

    begins = odometry.values[:, 0]
    for start, pose in zip(begins, at(begins), strict=True):
        if pose is not None:
            return float(start), pose, at
    raise SourceError(
        f"{groundtruth.path}: poses from {t[0]:.3f} s to {t[-1]:.3f} s, and no odometry in that time; "
        f"expected files of the same run"
    )
