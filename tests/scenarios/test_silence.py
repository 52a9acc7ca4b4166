"""Stretches of a laser log that nothing came back in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scenarios.logs import part, read_log
from scenarios.logs.silence import with_silence_told
from tests.scenarios.laser_logs import NOTHING, flaser, readings, write


def told(folder: Path, empty: set[int], period: float | None = 1.5, first: int | None = None) -> list[str]:
    """Of a log of 100 scans, some of them empty."""
    pose = np.zeros(3)
    lines = [
        flaser(np.full(181, NOTHING) if k in empty else readings(k), pose, pose, None if period is None else period * k)
        for k in range(100)
    ]
    source = part(read_log(write(folder, "".join(lines))), first)
    return [text for text in with_silence_told(source).warnings if "nothing came back" in text]


@pytest.mark.parametrize(
    ("empty", "period", "expected"),
    [
        (range(20, 41), 1.5, "for 30 s, in 21 scans from scan 20 on; filters"),
        (range(0, 30), 1.5, "for 44 s, in 30 scans from scan 0 on; filters"),
        (range(60, 100), 1.5, "for 58 s, in 40 scans from scan 60 on; filters"),
        ([*range(9, 40), *range(60, 82)], 1.5, "in 31 scans from scan 9 on (the longest of 2 such stretches, with 53"),
        (range(20, 51), None, "laser in 31 scans from scan 20 on; filters"),
    ],
)
def test_a_long_one_is_told(tmp_path: Path, empty: list[int], period: float | None, expected: str) -> None:
    (sentence,) = told(tmp_path, set(empty), period)
    assert expected in sentence


@pytest.mark.parametrize(
    ("empty", "period"), [(range(20, 40), 1.5), (range(20, 50), None), (range(0, 100, 2), 1.5), (range(20, 24), 20.0)]
)
def test_a_short_one_is_not(tmp_path: Path, empty: range, period: float | None) -> None:
    assert told(tmp_path, set(empty), period) == []


def test_scans_are_numbered_as_in_the_whole_log(tmp_path: Path) -> None:
    assert "in 30 scans from scan 50 on" in told(tmp_path, set(range(10, 80)), first=50)[0]
