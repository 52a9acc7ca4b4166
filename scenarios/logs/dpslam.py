"""Logs of DP-SLAM (Eliazar and Parr, Duke University): an `Odometry` line, then the `Laser` line that was taken there.

    Odometry x y theta
    Laser n r_1 ... r_n

Metres and radians.  There are no time stamps: the number of the scan stands for its time.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scenarios.logs.laser_log import Beams, LaserLog, source_of, spread
from scenarios.logs.messages import BrokenError, count_of, numbers, read_messages
from scenarios.logs.text import Head, Role
from scenarios.types import Source, SourceError

TITLE = "DP-SLAM"
EXPECTED = "a DP-SLAM log (pairs of Odometry and Laser lines)"
ONE_FILE = True

KNOWN = re.compile("Odometry|Laser")


def role(head: Head) -> Role | None:
    """A log, if it has lines of both kinds."""
    return Role("log") if {"Odometry", "Laser"} <= head.words else None


def read(place: Path, files: dict[Role, Path], robot: int | None) -> Source:
    """The one log in `files`, every scan of it.  Raises `SourceError`."""
    if robot is not None:
        raise SourceError(f"{place}: no robot {robot}; expected no choice of robot, a DP-SLAM log has one")
    (path,) = files.values()
    messages, warnings = read_messages(path, KNOWN, re.compile(r"[A-Z][A-Za-z]*"))
    scans, told = numbers(messages, "Laser", _laser)
    (poses,), more = numbers(messages, "Odometry", _odometry)
    lines = np.array(messages.by_word["Laser"][: sum(len(group.rows) for group in scans)], np.int64)
    before = np.searchsorted(messages.by_word["Odometry"][: len(poses.rows)], lines) - 1
    if before[0] < 0:
        raise SourceError(f"{messages.place(lines[0])}: no odometry before this scan; expected an Odometry line first")
    beams, odd = spread(path, lines + 1, [Beams(group.rows, np.zeros(0), group.readings) for group in scans])
    odometry, stamps = poses.rest[before], np.arange(len(lines), dtype=float)
    warnings += [*told, *more, *odd]
    return source_of(LaserLog(TITLE, path, lines + 1, stamps, odometry, odometry, beams, tuple(warnings)))


def _odometry(fields: Sequence[bytes]) -> list[bytes]:
    if len(fields) != 4:
        raise BrokenError(f"{len(fields) - 1} fields; expected 3, x y theta")
    return [b"0", *fields[1:]]


def _laser(fields: Sequence[bytes]) -> list[bytes]:
    n = count_of(fields, 1)
    if len(fields) != n + 2:
        raise BrokenError(f"{len(fields) - 2} readings; expected {n}, as it says")
    return list(fields[1:])
