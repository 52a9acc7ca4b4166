"""A world at a glance, in plain text: a top view and the numbers that say what kind of run it gives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from scenarios.laser import walls_in_view
from scenarios.route import drive
from scenarios.types import Source
from slam.motion import Odometry
from slam.types import Floats, Frame

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
    things: int
    """How many landmarks or walls there are."""
    what: str
    """Which of them, in the plural."""
    steps: int
    """Observing steps."""
    visible: float
    """Things in view at a step, mean."""
    title: str


def world_row(source: Source) -> WorldRow:
    """The numbers of a simulated world."""
    frames = [step.frame for step in source.steps]
    return WorldRow(
        name=source.name,
        route=sum(driven(f) for f in frames),
        duration=frames[-1].time,
        things=0 if source.true_map is None else _things(source.true_map.theta),
        what="landmarks" if frames[0].scan is None else "walls",
        steps=len(frames),
        visible=float(np.mean([len(f.tags) if f.scan is None else len(walls_in_view(f.scan)) for f in frames])),
        title=source.title,
    )


def _things(theta: Floats) -> int:
    """Landmarks (n, 2), or walls (n, 4) as they were drawn: one that is seen from both sides is in the map twice."""
    if theta.shape[1] == 2:
        return len(theta)
    return len({min((*a, *b), (*b, *a)) for a, b in theta.reshape(-1, 2, 2).tolist()})


def driven(frame: Frame) -> float:
    """[m] forwards and backwards."""
    if isinstance(frame.motion, Odometry):
        return float(np.hypot(frame.u[:, 0], frame.u[:, 1]).sum())
    return float(np.sum(np.abs(frame.u[:, 0]) * frame.dt))


def preview(source: Source, width: int = 70, height: int = 20, *, ascii_only: bool = False) -> str:
    """Top view of a world, y up, at most `width` x `height` characters, and below it a line that explains it.

    The route is dotted, `+` is a landmark, `S` the start, `E` the end.  Walls are lines, and the route among them a dot
    where there is room for one.  Lengths are true, except that a flat world is stretched upwards.  `ascii_only` is for
    terminals without braille.
    """
    route = _route(source)
    theta = np.empty((0, 2)) if source.true_map is None else source.true_map.theta
    landmarks = theta if theta.shape[1] == 2 else np.empty((0, 2))
    walls = theta.reshape(-1, 2, 2) if theta.shape[1] == 4 else np.empty((0, 2, 2))
    everything = np.concatenate([route, landmarks, walls.reshape(-1, 2)])
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
    marks: dict[tuple[int, int], str] = {}
    lines = _along(walls, dot) if len(walls) else route
    for x, y in zip(*cell(lines), strict=True):
        bits[y // 4, x // 2] |= _DOTS[y % 4][x % 2]
    if len(walls):
        for x, y in zip(*cell(route), strict=True):
            if not bits[y // 4, x // 2]:
                marks[y // 4, x // 2] = "." if ascii_only else "·"
    for symbol, points in (("+", landmarks), ("E", route[-1:]), ("S", route[:1])):
        for x, y in zip(*cell(points), strict=True):
            marks[y // 4, x // 2] = symbol

    def character(row: int, column: int) -> str:
        if (row, column) in marks:
            return marks[row, column]
        if not bits[row, column]:
            return " "
        if ascii_only:
            return "#" if len(walls) else "."
        return chr(0x2800 + bits[row, column])

    picture = ["".join(character(r, c) for c in range(columns)).rstrip() for r in range(rows)]
    times = "x" if ascii_only else "×"
    dot_mark = "." if ascii_only else "·"
    things = f"{dot_mark} route between walls" if len(walls) else "+ landmark" if len(landmarks) else "dotted the route"
    legend = (
        f"S start, E end, {things}; {size[0]:.3g} {times} {size[1]:.3g} m, one character is "
        f"{2 * dot[0]:.2g} {times} {4 * dot[1]:.2g} m"
    )
    return "\n".join([*picture, legend])


def _along(walls: Floats, dot: Floats) -> Floats:
    """(N, 2) [m] points on the walls (n, 2, 2), no further apart than a dot."""
    points = []
    for a, b in walls:
        number = math.ceil(float(np.max(np.abs(b - a) / dot))) + 1
        points.append(np.linspace(a, b, number))
    return np.concatenate(points)


def _route(source: Source) -> Floats:
    """(N, 2) [m] the path driven, no further apart than a dot needs."""
    poses = [source.start[None, :]]
    for step in source.steps:
        poses.append(drive(step.frame.motion, poses[-1][-1], step.frame.u, step.frame.dt)[1:])
    path = np.concatenate(poses)[:, :2]
    return path[:: max(1, math.ceil(len(path) / 20_000))]
