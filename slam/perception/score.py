"""What was found in the scan of a simulated world, beside what is there.

A wall counts if at least `FEWEST` beams meet it, over at least the shortest length of a piece.  A segment is false if
no wall was met by more than half of its beams, or if it is off the one that was by more than `OFF` of its own
deviations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slam.perception.segments import STANDARD, Extraction, Segments
from slam.types import Floats, Ints, Scan

FEWEST = 12
"""Beams that meet a wall which ought to be found."""

OFF = 6.0
"""Deviations beyond which an error is none of noise."""


class Score(NamedTuple):
    """Of one scan, or of many."""

    walls: int
    """Walls that ought to be found."""
    found: int
    short: int
    """Walls that `FEWEST` beams met, but over less than the shortest length of a piece."""
    segments: int
    nobodys: int
    """Segments of no wall."""
    off: int
    """Segments that are off their wall."""
    lateral: Floats
    """(N,) lateral errors / deviations of the segments that are not false."""
    angle: Floats
    """(N,) the same of their angles."""
    beams: Floats
    """(N,) of how many beams those were made."""

    @property
    def false(self) -> int:
        """Segments of no wall, or off their wall."""
        return self.nobodys + self.off


def score(
    segments: Segments,
    scan: Scan,
    exact: Floats,
    tags: Ints,
    walls: Floats,
    pose: Floats,
    settings: Extraction = STANDARD,
) -> Score:
    """The segments of a scan that knows which walls it met, from a robot at `pose`, against walls (n, 4) of tags (n,).

    exact (B,) [m] are the ranges without noise.
    """
    met = np.full(len(exact), -1) if scan.walls is None else scan.walls
    row = {int(tag): i for i, tag in enumerate(tags)}
    hit: set[int] = set()
    nobodys = off = 0
    lateral, angle, beams = [], [], []
    for i, z in enumerate(segments.z):
        own = met[segments.label == i]
        values, votes = np.unique(own, return_counts=True)
        tag = int(values[votes.argmax()])
        if 2 * votes.max() <= len(own) or tag not in row:
            nobodys += 1
            continue
        e = np.array(errors(z, walls[row[tag]], pose)) / np.sqrt(z[5:7])
        if np.abs(e).max() > OFF:
            off += 1
            continue
        hit.add(tag)
        lateral.append(e[0])
        angle.append(e[1])
        beams.append(z[9])
    expected, short = _expected(scan, met, exact, row, walls, pose, settings)
    found = len(expected & hit)
    return Score(
        len(expected), found, short, len(segments.z), nobodys, off, np.array(lateral), np.array(angle), np.array(beams)
    )


def total(scores: Sequence[Score]) -> Score:
    """Of all scans together."""
    return Score(
        walls=sum(s.walls for s in scores),
        found=sum(s.found for s in scores),
        short=sum(s.short for s in scores),
        segments=sum(s.segments for s in scores),
        nobodys=sum(s.nobodys for s in scores),
        off=sum(s.off for s in scores),
        lateral=np.concatenate([s.lateral for s in scores]),
        angle=np.concatenate([s.angle for s in scores]),
        beams=np.concatenate([s.beams for s in scores]),
    )


def errors(z: Floats, wall: Floats, pose: Floats) -> tuple[float, float]:
    """(lateral [m], angle [rad]) of an observation from a robot at `pose` against the wall (4,)."""
    c, q = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * z[0] - q * z[1], pose[1] + q * z[0] + c * z[1]
    true = math.atan2(wall[3] - wall[1], wall[2] - wall[0])
    angle = math.remainder(pose[2] + z[2] - true, math.pi)  # either way along it
    phi = pose[2] + z[2] - angle
    return -math.sin(phi) * (x - wall[0]) + math.cos(phi) * (y - wall[1]), angle


def _expected(
    scan: Scan, met: Ints, exact: Floats, row: dict[int, int], walls: Floats, pose: Floats, settings: Extraction
) -> tuple[set[int], int]:
    """The tags of the walls that ought to be found, and how many more are too short."""
    expected, short = set(), 0
    for tag, beams in zip(*np.unique(met, return_counts=True), strict=True):
        if beams < FEWEST or int(tag) not in row:
            continue
        on = np.flatnonzero(met == tag)
        wall = walls[row[int(tag)]]
        along = math.atan2(wall[3] - wall[1], wall[2] - wall[0])
        heading = pose[2] + scan.origin[2] + scan.bearings[on]
        if np.ptp(exact[on] * np.cos(heading - along)) < settings.shortest:
            short += 1
        else:
            expected.add(int(tag))
    return expected, short
