"""Relations between two poses of a log, found by hand or from an optimised graph, to judge a path by.

A line is `stamp_1 stamp_2 x y z roll pitch yaw`: where the robot was at the second time, as seen from where it was at
the first (R. Kuemmerle, B. Steder, C. Dornhege, M. Ruhnke, G. Grisetti, C. Stachniss, A. Kleiner, "On measuring the
accuracy of SLAM algorithms", Autonomous Robots 27, 2009).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from scenarios.logs.text import read_table
from scenarios.types import SourceError
from slam.relations import belongs, within
from slam.types import Floats

COLUMNS = ("first stamp [s]", "second stamp [s]", "x [m]", "y [m]", "z [m]", "roll [rad]", "pitch [rad]", "yaw [rad]")


class Relations(NamedTuple):
    """What should be between two poses of a path."""

    path: Path
    times: Floats
    """(R, 2) [s] stamps of the two scans."""
    poses: Floats
    """(R, 3) [m, m, rad] the second pose in the frame of the first."""
    warnings: tuple[str, ...] = ()


def read_relations(path: str | Path, stamps: Floats) -> Relations:
    """The relations of a log with these time stamps (N,) [s].

    Raises `SourceError`, with file and line, for anything that is no relation, and for a file of another log: of those
    relations that are within the time of this one, half or more have no scan at their times.
    """
    table = read_table(Path(path), COLUMNS)
    times = table.values[:, :2]
    inside = within(times, stamps)
    found = belongs(times, stamps)
    if not found.any() or found.sum() < 0.5 * inside.sum():
        raise SourceError(
            f"{path}: {found.sum() or 'none'} of its {len(times)} relations belong to the log: they are from "
            f"{times.min():.3f} s to {times.max():.3f} s, the log from {stamps.min():.3f} s to {stamps.max():.3f} s; "
            "expected relations of this log"
        )
    return Relations(table.path, times, table.values[:, [2, 3, 7]], table.warnings)
