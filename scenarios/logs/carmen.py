"""CARMEN text logs: one message a line, `FLASER`, `ROBOTLASER1` or `RAWLASER1` for the laser in front.

    FLASER n r_1 ... r_n  x y theta  odom_x odom_y odom_theta  [stamp host logger_stamp]
    ROBOTLASER1 type start_angle field_of_view resolution max_range accuracy remission_mode n r_1 ... r_n m e_1 ... e_m
        laser_x laser_y laser_theta  robot_x robot_y robot_theta  tv rv forward_safety side_safety turn_axis
        stamp host logger_stamp
    RAWLASER1 (as ROBOTLASER1 up to e_m)  stamp host logger_stamp
    ODOM x y theta tv rv acceleration  stamp host logger_stamp

The second pose of a laser message is the robot's by odometry; `RAWLASER1` has none and takes it from `ODOM` messages.
Logs that GMapping has written have its own poses in both places, and an `NEFF` message after every scan.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scenarios.logs.laser_log import Beams, LaserLog, source_of, spread
from scenarios.logs.messages import BrokenError, Messages, Numbers, count_of, numbers, read_messages
from scenarios.logs.text import Head, Role
from scenarios.types import Source, SourceError
from slam.geometry import TWO_PI, wrap_all
from slam.types import Floats, Ints

TITLE = "CARMEN"
EXPECTED = "a CARMEN log (FLASER, ROBOTLASER1 or RAWLASER1 messages)"
ONE_FILE = True

FRONT = ("ROBOTLASER1", "FLASER", "RAWLASER1")
"""Messages of the laser in front; of two kinds in one log the first is read."""

OTHER_LASERS = re.compile(r"RLASER|LASER\d|(RAW|ROBOT)LASER[02-9]|REMISSION[FR]LASER")

KNOWN = re.compile(
    rf"{'|'.join(FRONT)}|{OTHER_LASERS.pattern}|PARAM|SYNC|ODOM|TRUEPOS|NEFF|MARKER|COMMENT|GPS|NMEA\w+|SONAR|BUMPER|IMU|"
    "ARM|POSITION|VECTORMOVE|ROBOTVELOCITY|FOLLOWTRAJECTORY|BASEVELOCITY|SCANMARK|POSECORR"
)
"""Messages that need no warning; most say nothing of what is read here."""

WORD = re.compile(r"[A-Z][A-Z0-9_]*")

POSE_GRAPH = {"VERTEX_SE2", "EDGE_SE2", "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT"}
"""What lines of g2o files begin with: their laser messages have optimised poses, and no odometry."""

HOLD = 0.5
"""[s] for which a scan may lie before the first or after the last `ODOM` message without a warning."""


class _Piece(NamedTuple):
    """Messages with as many readings each."""

    rows: Ints
    """(G,) which scans."""
    ranges: Floats
    """(G, n) [m]"""
    stamps: Floats
    """(G,) [s]"""
    laser: Floats
    """(G, 3)"""
    robot: Floats
    """(G, 3)"""
    angles: Floats | None
    """(G, 3) first bearing and spacing [rad], largest range [m], if the messages tell."""


def role(head: Head) -> Role | None:
    """A log, or a corrected log as GMapping writes it; None for pose graphs, which have laser messages too."""
    if not {*FRONT, "ODOM", "RLASER", "PARAM"} & head.words or POSE_GRAPH & head.words:
        return None
    return Role("corrected log" if "NEFF" in head.words else "log")


def read(place: Path, files: dict[Role, Path], robot: int | None) -> Source:
    """The one log in `files`, every scan of it.  Raises `SourceError`."""
    if robot is not None:
        raise SourceError(f"{place}: no robot {robot}; expected no choice of robot, a CARMEN log has one")
    (path,) = files.values()
    messages, warnings = read_messages(path, KNOWN, WORD)
    if POSE_GRAPH & messages.by_word.keys():
        raise SourceError(f"{path}: a pose graph (g2o), which has optimised poses and no odometry; expected {EXPECTED}")
    kind, told = _front(messages)
    warnings += told
    fields_of, piece_of = _READ[kind]
    found, told = numbers(messages, kind, fields_of)
    pieces = [piece_of(group) for group in found]
    rows = np.concatenate([piece.rows for piece in pieces])
    order = np.argsort(rows)
    stamps, laser, odometry = (
        np.concatenate([getattr(piece, name) for piece in pieces])[order] for name in ("stamps", "laser", "robot")
    )
    lines = np.array(messages.by_word[kind][: len(rows)], np.int64) + 1
    warnings += told
    if kind == "RAWLASER1":
        odometry, told = _from_odom(messages, stamps, lines)
        laser, warnings = odometry, warnings + told
    if "NEFF" in messages.by_word and np.array_equal(laser, odometry):
        warnings.append(f"{path}: the odometry is already corrected, by GMapping; the robot's own is not in this log")
    beams, told = _beams(path, lines, pieces)
    return source_of(LaserLog(TITLE, path, lines, stamps, odometry, laser, beams, (*warnings, *told)))


def _front(messages: Messages) -> tuple[str, list[str]]:
    """The kind of message that is read, and a warning on those of other lasers."""
    kinds = [kind for kind in FRONT if kind in messages.by_word]
    others = {word: at for word, at in messages.by_word.items() if OTHER_LASERS.fullmatch(word)}
    if not kinds:
        what = f"only {', '.join(sorted(messages.by_word)[:8])}" if messages.by_word else "no message at all"
        raise SourceError(f"{messages.path}: no scan of a laser in front, {what}; expected {EXPECTED}")
    if "FLASER" in kinds[1:]:
        others["FLASER"] = messages.by_word["FLASER"]
    if not others:
        return kinds[0], []
    first = min(at[0] for at in others.values())
    told = ", ".join(f"{len(at)} {word}" for word, at in sorted(others.items()))
    return kinds[0], [f"{messages.place(first)}: only {kinds[0]} messages are read; left out: {told}"]


# -- laser messages -------------------------------------------------------------------------------------------------


def _flaser(fields: Sequence[bytes]) -> list[bytes]:
    n = count_of(fields, 1)
    if len(fields) not in (n + 8, n + 11):
        raise BrokenError(
            f"{len(fields) - 2} fields behind the number of readings, {n}; expected {n + 9}, the readings, two poses, "
            f"a time stamp, a host and another stamp, or {n + 6} without these three"
        )
    return list(fields[1 : n + 9])


def _piece_of_flaser(group: Numbers) -> _Piece:
    """Old logs without time stamps have the number of the scan for it."""
    rows, _, ranges, rest = group
    stamps = rest[:, 6] if rest.shape[1] > 6 else rows.astype(float)
    return _Piece(rows, ranges, stamps, rest[:, :3], rest[:, 3:6], None)


def _with_angles(fields: Sequence[bytes], behind: int, poses: int) -> list[bytes]:
    """Behind the remissions stand `behind` fields; the first `poses` of them count, and the stamp before the host."""
    n = count_of(fields, 8)
    remissions = count_of(fields, 9 + n)
    whole = 10 + n + remissions + behind
    if len(fields) != whole:
        raise BrokenError(
            f"{len(fields) - 1} fields with {n} readings and {remissions} remissions; expected {whole - 1}"
        )
    rest = fields[whole - behind :]
    return [*fields[8 : 9 + n], *rest[:poses], rest[-3], fields[2], fields[4], fields[5]]


def _robotlaser(fields: Sequence[bytes]) -> list[bytes]:
    return _with_angles(fields, 14, 6)


def _piece_of_robotlaser(group: Numbers) -> _Piece:
    rows, _, ranges, rest = group
    return _Piece(rows, ranges, rest[:, 6], rest[:, :3], rest[:, 3:6], rest[:, 7:])


def _rawlaser(fields: Sequence[bytes]) -> list[bytes]:
    return _with_angles(fields, 3, 0)


def _piece_of_rawlaser(group: Numbers) -> _Piece:
    rows, _, ranges, rest = group
    nowhere = np.zeros((len(rows), 3))
    return _Piece(rows, ranges, rest[:, 0], nowhere, nowhere, rest[:, 1:])


_READ = {
    "FLASER": (_flaser, _piece_of_flaser),
    "ROBOTLASER1": (_robotlaser, _piece_of_robotlaser),
    "RAWLASER1": (_rawlaser, _piece_of_rawlaser),
}


# -- where the beams look -------------------------------------------------------------------------------------------


def _beams(path: Path, lines: Ints, pieces: Sequence[_Piece]) -> tuple[tuple[Beams, ...], list[str]]:
    """The scans by where their beams look, and warnings."""
    if all(piece.angles is None for piece in pieces):
        return spread(path, lines, [Beams(piece.rows, np.zeros(0), piece.ranges) for piece in pieces])
    found = []
    for rows, ranges, _, _, _, angles in pieces:
        assert angles is not None
        n = ranges.shape[1]
        _check_angles(path, lines[rows], n, angles)
        kinds, which = np.unique(angles, axis=0, return_inverse=True)
        for k, (first, spacing, limit) in enumerate(kinds):
            same = np.flatnonzero(which.ravel() == k)
            bearings = first + spacing * np.arange(n)
            found.append(Beams(rows[same], bearings, ranges[same], limit if limit > 0 else np.inf))
    return tuple(found), []


def _check_angles(path: Path, lines: Ints, n: int, angles: Floats) -> None:
    first, spacing, limit = angles.T
    good_spacing = (spacing > 0) & (spacing * max(n - 1, 1) <= TWO_PI + 1e-3)
    for values, good, what, expected in (
        (first, np.abs(first) <= TWO_PI, "start angle", "radians, at most one turn"),
        (spacing, good_spacing, "angle between beams", f"radians above 0, for {n} beams at most one turn"),
        (limit, ~np.isnan(limit), "largest range", "metres"),
    ):
        if not good.all():
            row = int(np.argmin(good))
            raise SourceError(f"{path}:{lines[row]}: the {what} is {values[row]:g}; expected {expected}")


# -- odometry in messages of its own --------------------------------------------------------------------------------


def _from_odom(messages: Messages, stamps: Floats, lines: Ints) -> tuple[Floats, list[str]]:
    """(N, 3) pose of the robot at each scan, between the `ODOM` messages around it, and warnings."""
    if "ODOM" not in messages.by_word:
        raise SourceError(
            f"{messages.path}: no odometry, since RAWLASER1 messages have no pose; expected ODOM messages beside them"
        )
    (found,), warnings = numbers(messages, "ODOM", _odom)
    table = found.rest[np.argsort(found.rest[:, 3], kind="stable")]
    if not np.isfinite(table).all():
        raise SourceError(
            f"{messages.path}: an ODOM message has NaN or infinity in its pose or stamp; expected finite ones"
        )
    times, heading = table[:, 3], np.unwrap(table[:, 2])
    odometry = np.stack([np.interp(stamps, times, values) for values in (table[:, 0], table[:, 1], heading)], axis=1)
    odometry[:, 2] = wrap_all(odometry[:, 2])
    outside = np.flatnonzero((stamps < times[0] - HOLD) | (stamps > times[-1] + HOLD))
    if len(outside):
        lie = "1 scan lies" if len(outside) == 1 else f"{len(outside)} scans lie"
        warnings.append(
            f"{messages.path}:{lines[outside[0]]}: {lie} before the first or after the last ODOM "
            "message; the robot is taken to stand there"
        )
    return odometry, warnings


def _odom(fields: Sequence[bytes]) -> list[bytes]:
    if len(fields) != 10:
        raise BrokenError(f"{len(fields) - 1} fields; expected 9, x y theta tv rv acceleration and stamp host stamp")
    return [b"0", *fields[1:4], fields[7]]
