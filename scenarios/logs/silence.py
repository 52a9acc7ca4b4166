"""Where a laser log has nothing to say: scan after scan that nothing came back to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenarios.types import Source

LONG = 30.0
"""[s], or scans of a log without time stamps, from which on an empty stretch is told."""

LEAST = 5
"""Scans that it has at least."""


def with_silence_told(source: Source) -> Source:
    """The source with a warning if long stretches of it are empty; for a laser log, before keyframes are chosen."""
    if source.scans is None:
        return source
    scans = [step.frame.scan for step in source.steps]
    empty = np.array([scan is None or not np.isfinite(scan.ranges).any() for scan in scans], np.int64)
    begins, ends = np.flatnonzero(np.diff(empty, prepend=0, append=0)).reshape(-1, 2).T  # the ends are not empty
    times = np.cumsum([step.frame.dt.sum() for step in source.steps])
    counts, lasts = ends - begins, times[ends - 1] - times[begins]
    long = np.flatnonzero((lasts >= LONG) & (counts >= LEAST))
    if not len(long):
        return source
    longest = long[np.argmax(lasts[long])]
    told = f"in {counts[longest]} scans from scan {source.scans.kept[begins[longest]]} on"
    if source.has_clock:
        told = f"for {lasts[longest]:.0f} s, {told}"
    if len(long) > 1:
        told += f" (the longest of {len(long)} such stretches, with {counts[long].sum()} scans)"
    warning = f"{source.name}: nothing came back to the laser {told}; filters are blind there and follow the odometry"
    return replace(source, warnings=(*source.warnings, warning))
