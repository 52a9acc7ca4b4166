"""Small laser logs, as lines of text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from slam.geometry import compose

NOTHING = 81.91


def numbers(values: Iterable[float], form: str = ".6f") -> str:
    return " ".join(format(value, form) for value in values)


def readings(k: int, n: int = 181, none: float = NOTHING) -> np.ndarray:
    """(n,) [m] of scan k: no two alike below 10 m, and every tenth beam is `none`."""
    found = 1.0 + 7.0 * np.abs(np.sin(0.7 * k + 0.031 * np.arange(n)))
    found[::10] = none
    return np.round(found, 3)


def flaser(
    ranges: Sequence[float] | np.ndarray,
    laser: Sequence[float] | np.ndarray,
    robot: Sequence[float] | np.ndarray,
    stamp: float | None = None,
    word: str = "FLASER",
) -> str:
    behind = "" if stamp is None else f" {stamp:.6f} host {stamp:.6f}"
    return f"{word} {len(ranges)} {numbers(ranges, 'g')} {numbers(laser)} {numbers(robot)}{behind}\n"


def robotlaser(
    ranges: Sequence[float] | np.ndarray,
    laser: Sequence[float] | np.ndarray,
    robot: Sequence[float] | np.ndarray,
    stamp: float,
    start: float = -0.5 * math.pi,
    spacing: float = math.radians(1.0),
    limit: float = 81.9,
    remissions: Sequence[float] = (),
) -> str:
    head = f"ROBOTLASER1 0 {start:.6f} 3.141593 {spacing:.6f} {limit:g} 0.01 0 {len(ranges)} {numbers(ranges, 'g')}"
    poses = f"{len(remissions)} {numbers(remissions, 'g')} {numbers(laser)} {numbers(robot)}"
    return f"{head} {poses} 0.1 0.0 0.3 0.2 0.5 {stamp:.6f} host {stamp:.6f}\n"


def odom(robot: Sequence[float] | np.ndarray, stamp: float) -> str:
    return f"ODOM {numbers(robot)} 0.1 0.0 0.0 {stamp:.6f} host {stamp:.6f}\n"


def arc(count: int, step: float = 0.1, turn: float = 0.05) -> np.ndarray:
    """(count, 3) poses on a circle from (3, 4), heading for -3 rad: it soon passes -pi."""
    poses = [np.array([3.0, 4.0, -3.0])]
    for _ in range(count - 1):
        poses.append(compose(poses[-1], np.array([step, 0.0, -turn])))
    return np.array(poses)


def plain_log(poses: np.ndarray, n: int = 181, period: float = 0.5, first: float = 1000.0) -> str:
    """A `FLASER` line for each pose, every `period` s."""
    return "".join(flaser(readings(k, n), p, p, first + period * k) for k, p in enumerate(poses))


def write(folder: Path, text: str, name: str = "some.log") -> Path:
    (folder / name).write_text(text)
    return folder / name
