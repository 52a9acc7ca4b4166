"""Paths through all scans of a log, from the poses at the steps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from app import session
from app.paths import MATCHED, ODOMETRY, Paths
from scenarios.logs import read_log
from scenarios.logs.keyframes import every_scan, keyframes
from scenarios.registry import build
from scenarios.types import Source
from slam.geometry import wrap_all
from tests.app.drive import Drive


def followed(source: Source, *matching: str, steps: int | None = None) -> Paths:
    """What is known after some steps, with `matching` in turn."""
    paths = Paths()
    info = session.make_info(source, [], source.params(matching=matching[0]), count=steps)
    changes = [session.Change(k + 2, source.params(matching=how)) for k, how in enumerate(matching[1:])]
    session.run(info, [paths], changes)
    return paths


def heading(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean(wrap_all(found[:, 2] - truth[: len(found), 2]) ** 2)))


@pytest.mark.parametrize("steps", [None, 4])
def test_between_steps_they_go_by_the_scans_that_were_matched(drive: Drive, steps: int | None) -> None:
    """Odometry turns too far between two steps; matches on the way do not."""
    source = keyframes(read_log(drive.log), 3.0, 2.0 * math.pi)
    assert source.scans is not None
    paths = followed(source, "on", steps=steps)
    last = source.scans.kept[len(paths.alone()[MATCHED]) - 1]
    stamps, found = paths.found()[MATCHED]
    np.testing.assert_array_equal(stamps, drive.stamps[: last + 1])
    _, by_odometry = every_scan(source, paths.alone()[MATCHED])
    np.testing.assert_allclose(found[source.scans.kept[:4]], by_odometry[source.scans.kept[:4]], atol=1e-9)
    assert heading(found, drive.truth) < 0.6 * heading(by_odometry, drive.truth)


def test_odometry_stays_as_it_is(drive: Drive) -> None:
    source = keyframes(read_log(drive.log), 3.0, 2.0 * math.pi)
    _, found = followed(source, "on").found()[ODOMETRY]
    np.testing.assert_allclose(found, drive.odometry[: len(found)], atol=1e-5)


def test_what_was_not_matched_all_the_time_goes_by_odometry(drive: Drive) -> None:
    source = keyframes(read_log(drive.log), 3.0, 2.0 * math.pi)
    for matching in (["off"], ["on", "off"], ["off", "on"]):
        paths = followed(source, *matching)
        assert list(paths.found()) == [ODOMETRY]
        poses = paths.alone()[ODOMETRY] + np.array([0.0, 0.0, 0.1])
        np.testing.assert_array_equal(paths.every_scan(poses)[1], every_scan(source, poses)[1])


def test_worlds_have_steps_alone() -> None:
    source = build("loop")
    paths = followed(source, "on", steps=5)
    stamps, found = paths.found()[MATCHED]
    np.testing.assert_array_equal(stamps, [step.frame.time for step in source.steps[:5]])
    np.testing.assert_array_equal(found, paths.alone()[MATCHED])


def test_before_the_first_step_nothing_is_known() -> None:
    assert Paths().found() == {}
