"""A world at a glance, in plain text: a top view and the numbers that say what kind of run it gives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from scenarios.route import drive
from scenarios.types import Source
from slam.types import Floats

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Braille: the bit of each of the 4 x 2 dots of a character."""

FLAT = 6
"""Lines that even a corridor is given, at the price of its proportions."""


class WorldRow(NamedTuple):
    """One line of a table of worlds."""

    name: str
    route: float
    """[m] driven."""
    duration: float
    """[s]"""
    landmarks: int
    steps: int
    """Observing steps."""
    visible: float
    """Observations a step, mean."""
    title: str


def world_row(source: Source) -> WorldRow:
    """The numbers of a simulated world."""
    frames = [step.frame for step in source.steps]
    return WorldRow(
        name=source.name,
        route=float(sum(np.sum(np.abs(f.u[:, 0]) * f.dt) for f in frames)),
        duration=frames[-1].time,
        landmarks=0 if source.true_map is None else len(source.true_map.tags),
        steps=len(frames),
        visible=float(np.mean([len(f.tags) for f in frames])),
        title=source.title,
    )


def preview(source: Source, width: int = 70, height: int = 20, *, ascii_only: bool = False) -> str:
    """Top view of a world, y up, at most `width` x `height` characters, and below it a line that explains it.

    The route is dotted, `+` is a landmark, `S` the start, `E` the end.  Lengths are true, except that a flat world
    is stretched upwards.  `ascii_only` is for terminals without braille.
    """
    route = _route(source)
    landmarks = np.empty((0, 2)) if source.true_map is None else source.true_map.theta
    everything = np.concatenate([route, landmarks])
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    # A character is 2 x 4 dots and about twice as high as wide, so dots are square.
    dot = np.full(2, max(size[0] / (2 * width - 2), size[1] / (4 * height - 4)))  # [m] size of one
    dot[1] = min(dot[1], max(size[1] / (4 * min(FLAT, height) - 4), 1e-9))
    last = np.rint(size / dot).astype(int)
    columns, rows = last // (2, 4) + 1

    def cell(points: Floats) -> tuple[np.ndarray, np.ndarray]:
        """Dot column and row, counted from top left."""
        dots = np.rint((points - low) / dot).astype(int)
        return dots[:, 0], last[1] - dots[:, 1]

    bits = np.zeros((rows, columns), int)
    for x, y in zip(*cell(route), strict=True):
        bits[y // 4, x // 2] |= _DOTS[y % 4][x % 2]
    marks: dict[tuple[int, int], str] = {}
    for symbol, points in (("+", landmarks), ("E", route[-1:]), ("S", route[:1])):
        for x, y in zip(*cell(points), strict=True):
            marks[y // 4, x // 2] = symbol

    def character(row: int, column: int) -> str:
        if (row, column) in marks:
            return marks[row, column]
        if not bits[row, column]:
            return " "
        return "." if ascii_only else chr(0x2800 + bits[row, column])

    picture = ["".join(character(r, c) for c in range(columns)).rstrip() for r in range(rows)]
    times = "x" if ascii_only else "×"
    legend = (
        f"S start, E end, + landmark; {size[0]:.3g} {times} {size[1]:.3g} m, one character is "
        f"{2 * dot[0]:.2g} {times} {4 * dot[1]:.2g} m"
    )
    return "\n".join([*picture, legend])


def _route(source: Source) -> Floats:
    """(N, 2) [m] the path driven, no further apart than a dot needs."""
    poses = [source.start[None, :]]
    for step in source.steps:
        poses.append(drive(step.frame.motion, poses[-1][-1], step.frame.u, step.frame.dt)[1:])
    path = np.concatenate(poses)[:, :2]
    return path[:: max(1, math.ceil(len(path) / 20_000))]
