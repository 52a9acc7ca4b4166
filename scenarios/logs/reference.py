"""Poses that somebody found for the scans of a laser log, in a file of their own: `scan_index stamp x y theta` lines.

`scan_index` counts the scans of the log from 0.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from scenarios.logs.odometry import carried, travelled
from scenarios.logs.text import read_table
from scenarios.types import Source, SourceError
from scenarios.words import counted
from slam.types import Floats, Ints

COLUMNS = ("scan", "time stamp [s]", "x [m]", "y [m]", "heading [rad]")

SAME_TIME = 0.05
"""[s] within which the stamp of a scan and that in the reference are the same."""

REACH = 1.0
"""[m] of travel from a scan with a known pose within which odometry tells the true poses of others."""


def with_reference(source: Source, path: str | Path) -> Source:
    """A whole laser log with the poses of a reference as its truth.

    Scans without one get it by odometry from the nearest that has one within `REACH`; nothing is known of the others.
    The start pose is moved into the frame of the reference.  Raises `SourceError` for a file that is no reference of
    this log.
    """
    if source.scans is None or len(source.scans.kept) != len(source.scans.stamps):
        raise SourceError(f"{source.name}: a reference is for the scans of a whole laser log; expected one")
    scans, poses, warnings = _read(Path(path), source.scans.stamps)
    odometry, way = source.scans.odometry, travelled(source.scans.odometry)
    after = np.clip(np.searchsorted(way[scans], way), 1, max(len(scans) - 1, 1))
    after = np.minimum(after, len(scans) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(way - way[scans[before]] <= way[scans[after]] - way, before, after)
    nearest[scans] = np.arange(len(scans))
    truth = carried(poses[nearest], odometry[scans[nearest]], odometry)
    known = np.abs(way - way[scans[nearest]]) <= REACH
    steps = tuple(
        step._replace(truth=pose if is_known else None)
        for step, pose, is_known in zip(source.steps, truth, known, strict=True)
    )
    if not known[0]:
        warnings.append(
            f"{path}: no pose near the first scan; the start is that of scan {scans[0]} moved back by odometry over "
            f"{way[scans[0]]:.1f} m, and so wrong as that is the frame in which a filter begins"
        )
    return replace(
        source,
        steps=steps,
        start=truth[0].copy(),
        warnings=(*source.warnings, *warnings),
        options={**source.options, "reference": str(path)},
    )


def _read(path: Path, stamps: Floats) -> tuple[Ints, Floats, list[str]]:
    """Which scans (R,), in their order, have which poses (R, 3), and warnings."""
    table = read_table(path, COLUMNS)
    index = table.values[:, 0]
    table.require(0, index == np.floor(index), "a whole number")
    table.require(0, (index >= 0) & (index < len(stamps)), f"0 to {len(stamps) - 1}, the scans of the log")
    scans = index.astype(np.int64)
    same = np.abs(stamps[scans] - table.values[:, 1]) <= SAME_TIME
    if same.sum() < 0.5 * len(same):
        row = int(np.argmin(same))
        raise SourceError(
            f"{table.place(row)}: scan {scans[row]} at {table.values[row, 1]:.3f} s, where the log has "
            f"{stamps[scans[row]]:.3f} s, as for {(~same).sum()} of {len(same)} lines; expected a reference of this log"
        )
    warnings = list(table.warnings)
    if not same.all():
        row = int(np.argmin(same))
        lines = counted(int((~same).sum()), "line")
        warnings.append(f"{table.place(row)}: left out {lines} with another time stamp than the log, here the first")
    chosen, first = np.unique(scans[same], return_index=True)
    return chosen, table.values[same][first, 2:], warnings
