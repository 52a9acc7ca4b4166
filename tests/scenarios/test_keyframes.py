"""Fewer steps of a laser log, parts of it, and the way back to all of its scans."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from scenarios.logs import dead_reckoning, part, read_log
from scenarios.logs.keyframes import PASSING, every_scan, keyframes
from scenarios.logs.odometry import LEVER, path_length, travelled
from scenarios.logs.reference import with_reference
from scenarios.registry import build
from scenarios.types import Source, SourceError
from slam.geometry import compose, invert, wrap_all
from slam.types import Floats
from tests.scenarios.laser_logs import arc, plain_log, write

COUNT = 60


def wander() -> Floats:
    """(COUNT, 3): ahead, a rest, on the spot, and ahead again in a bend."""
    moves = [(0.07, 0.01, 0.02)] * 20 + [(0.0, 0.0, 0.0)] * 10 + [(0.0, 0.0, 0.09)] * 10 + [(0.11, 0.0, -0.05)] * 19
    poses = [np.array([2.0, -1.0, 2.9])]
    for move in moves:
        poses.append(compose(poses[-1], np.array(move)))
    return np.array(poses)


@pytest.fixture
def source(tmp_path: Path) -> Source:
    return read_log(write(tmp_path, plain_log(wander(), 181, period=0.4)))


def assert_poses(found: Floats, expected: Floats, atol: float = 1e-5) -> None:
    off = np.asarray(found) - expected
    off[:, 2] = wrap_all(off[:, 2])
    np.testing.assert_allclose(off, 0.0, atol=atol)


def raw(source: Source) -> Floats:
    assert source.scans is not None
    return source.scans.odometry


def kept(source: Source) -> list[int]:
    assert source.scans is not None
    return source.scans.kept.tolist()


@pytest.mark.parametrize(("distance", "turn"), [(0.25, 8.0), (0.3, 360.0), (1000.0, 20.0), (1.0, 45.0)])
def test_between_keyframes_the_robot_has_moved_just_so_far(source: Source, distance: float, turn: float) -> None:
    few = keyframes(source, distance, math.radians(turn))
    index = kept(few)
    assert (index[0], index[-1]) == (0, COUNT - 1)

    def moved(i: int, k: int) -> bool:
        dx, dy, dphi = compose(invert(raw(source)[i]), raw(source)[k])
        return math.hypot(dx, dy) >= distance or abs(dphi) >= math.radians(turn)

    for i, k in pairwise(index):
        assert moved(i, k) or k == COUNT - 1
        assert not any(moved(i, between) for between in range(i + 1, k))
    assert_poses(dead_reckoning(few), raw(source)[index])
    assert [step.frame.time for step in few.steps] == [source.steps[i].frame.time for i in index]
    assert all(step.frame.scan is source.steps[i].frame.scan for step, i in zip(few.steps, index, strict=True))
    assert sum(step.frame.dt.sum() for step in few.steps) == pytest.approx(0.4 * (COUNT - 1))
    assert few.options["keyframe"] == [distance, pytest.approx(turn)]


def test_scans_on_the_way_are_kept_for_matching(source: Source) -> None:
    few = keyframes(source, 1.0, math.radians(45))
    scans = {id(step.frame.scan): i for i, step in enumerate(source.steps)}
    ways = 0
    for begin, end, step in zip(kept(few), kept(few)[1:], few.steps[1:], strict=False):
        frame = step.frame
        assert len(frame.u) == len(frame.dt) == len(frame.between) + 1
        index = [begin, *(scans[id(scan)] for scan in frame.between), end]
        for i, k, u, dt in zip(index, index[1:], frame.u, frame.dt, strict=False):
            assert i < k
            assert_poses(u[None], compose(invert(raw(source)[i]), raw(source)[k])[None])
            assert dt == pytest.approx(0.4 * (k - i))
            if k != end:
                ways += 1
                assert math.hypot(u[0], u[1]) >= PASSING[0] or abs(u[2]) >= PASSING[1]
    assert ways > 4


def test_without_distance_every_scan_is_a_keyframe(source: Source) -> None:
    assert kept(keyframes(source, 0.0, 0.0)) == list(range(COUNT))


def test_whole_turns_count(tmp_path: Path) -> None:
    """Odometry errs with the motion, not with its remainder."""
    poses = np.array([[0.0, 0.0, wrap_all(np.array(0.5 * k))] for k in range(20)])
    few = keyframes(read_log(write(tmp_path, plain_log(poses))), 1.0, 7.0)
    assert kept(few) == [0, 14, 19]
    assert few.steps[1].frame.u.sum(axis=0) == pytest.approx([0.0, 0.0, 7.0], abs=1e-4)


def test_keyframes_of_a_simulated_world() -> None:
    world = build("corridor")
    few = keyframes(world, 1.0, math.radians(30))
    assert few.scans is None
    truth = np.array([step.truth for step in few.steps])
    assert 5 < len(few.steps) < len(world.steps) / 2
    assert_poses(dead_reckoning(few), truth)
    stamps, poses = every_scan(few, truth[:3])
    assert stamps.tolist() == [step.frame.time for step in few.steps[:3]]
    np.testing.assert_array_equal(poses, truth[:3])


@pytest.mark.parametrize(("distance", "turn"), [(-1.0, 0.1), (0.1, -1.0), (math.nan, 0.1), (math.inf, 0.1)])
def test_keyframes_that_are_none(source: Source, distance: float, turn: float) -> None:
    with pytest.raises(SourceError, match=r"keyframe (distance|turn) is .*; expected a number"):
        keyframes(source, distance, turn)


def test_landmarks_have_no_keyframes() -> None:
    with pytest.raises(SourceError, match="paper-line: no keyframes without increments of odometry"):
        keyframes(build("paper-line"), 0.1, 0.1)


@pytest.mark.parametrize(("first", "last", "every"), [(0, None, 1), (7, 50, 1), (5, None, 4), (13, 999, 7)])
def test_parts_keep_the_scans(source: Source, first: int, last: int | None, every: int) -> None:
    some = part(source, first, last, every)
    end = min(COUNT - 1 if last is None else last, COUNT - 1)
    assert kept(some) == list(range(first, end + 1, every))
    assert len(some.warnings) == (last is not None and last >= COUNT)
    assert all("which was to go on to 999" in warning for warning in some.warnings)
    assert_poses(dead_reckoning(some), raw(source)[kept(some)])
    few = keyframes(some, 0.25, math.radians(8))
    assert set(kept(few)) <= set(kept(some))
    assert_poses(dead_reckoning(few), raw(source)[kept(few)])
    stamps, poses = every_scan(few, dead_reckoning(few))
    covered = slice(kept(few)[0], kept(few)[-1] + 1)  # also the scans that `every` left out
    assert_poses(poses, raw(source)[covered])
    assert source.scans is not None
    np.testing.assert_array_equal(stamps, source.scans.stamps[covered])


# -- a pose for every scan ------------------------------------------------------------------------------------------


def test_poses_between_keyframes_fit_both(source: Source) -> None:
    """What odometry is off at a keyframe is spread over the way there, in proportion to what was travelled."""
    few = keyframes(source, 0.25, math.radians(8))
    off = np.random.default_rng(1).normal(0.0, 0.05, (len(few.steps), 3))
    corrected = dead_reckoning(few) + off
    _, poses = every_scan(few, corrected)
    assert_poses(poses[kept(few)], corrected)
    _, online = every_scan(few, corrected, fit=False)
    for i, (a, b) in enumerate(pairwise(kept(few))):
        moved = compose(invert(raw(few)[a]), raw(few)[a : b + 1])
        forward = compose(corrected[i], moved)
        assert_poses(online[a:b], forward[:-1])
        whole = corrected[i + 1] - forward[-1]
        whole[2] = wrap_all(whole[2])
        step = np.diff(raw(few)[a : b + 1], axis=0)
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*step[:, :2].T) + LEVER * np.abs(wrap_all(step[:, 2])))])
        assert_poses(poses[a : b + 1], forward + way[:, None] / way[-1] * whole)


def test_poses_up_to_where_a_run_was_stopped(source: Source) -> None:
    few = keyframes(source, 0.25, math.radians(8))
    for done in (1, 2, 5):
        stamps, poses = every_scan(few, dead_reckoning(few)[:done])
        assert len(stamps) == len(poses) == kept(few)[done - 1] + 1
        assert_poses(poses, raw(source)[: len(poses)])
    stamps, poses = every_scan(few, np.zeros((0, 3)))
    assert (stamps.shape, poses.shape) == ((0,), (0, 3))


def test_a_robot_at_rest_is_moved_by_and_by(tmp_path: Path) -> None:
    still = keyframes(read_log(write(tmp_path, plain_log(np.ones((5, 3))))), 1.0, 1.0)
    _, poses = every_scan(still, np.array([[1.0, 1.0, 1.0], [1.4, 1.0, 0.8]]))
    assert_poses(poses, np.array([[1.0 + 0.1 * k, 1.0, 1.0 - 0.05 * k] for k in range(5)]))


def test_travelled_way() -> None:
    poses = np.array([[0.0, 0.0, 3.0], [3.0, 4.0, -3.0], [3.0, 4.0, -2.0]])
    assert travelled(poses) == pytest.approx([0.0, 5.0 + LEVER * (math.tau - 6.0), 5.0 + LEVER * (math.tau - 5.0)])
    assert path_length(poses) == pytest.approx(5.0)


# -- references -----------------------------------------------------------------------------------------------------


SHIFT = np.array([100.0, -50.0, 1.0])
"""The frame of the reference."""


def reference(folder: Path, rows: list[tuple[int, float]], poses: Floats) -> Path:
    lines = "".join(f"{i} {t:.6f} {x:.6f} {y:.6f} {h:.6f}\n" for (i, t), (x, y, h) in zip(rows, poses, strict=True))
    return write(folder, "# scan_index timestamp x y theta\n" + lines, "some.ref.txt")


def test_scans_near_one_of_a_reference_have_a_truth(source: Source, tmp_path: Path) -> None:
    """In any order; the others by odometry, as far as it can be trusted."""
    known = [50, 3]
    path = reference(tmp_path, [(i, 1000.0 + 0.4 * i) for i in known], compose(SHIFT, raw(source)[known]))
    found = with_reference(source, path)
    way = travelled(raw(source))
    near = np.minimum(np.abs(way - way[3]), np.abs(way - way[50])) <= 1.0
    assert 20 < near.sum() < 50
    assert [step.truth is not None for step in found.steps] == near.tolist()
    truth = np.array([step.truth for step in found.steps if step.truth is not None])
    assert_poses(truth, compose(SHIFT, raw(source)[near]))
    assert found.start == pytest.approx(compose(SHIFT, raw(source)[0]), abs=1e-5)
    assert found.warnings == ()
    few = keyframes(found, 0.25, math.radians(8))
    assert [step.truth is not None for step in few.steps] == near[kept(few)].tolist()
    for first in (10, 25, 59):
        some = part(found, first)
        assert_poses(dead_reckoning(some), compose(SHIFT, raw(source)[kept(some)]))
        assert some.warnings == ()


def test_the_nearest_scan_of_a_reference_counts(source: Source, tmp_path: Path) -> None:
    poses = raw(source)[[0, 10]] + [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    found = with_reference(source, reference(tmp_path, [(0, 1000.0), (10, 1004.0)], poses))
    truth = np.array([step.truth for step in found.steps[:11]])
    shift = truth[:, 1] - raw(source)[:11, 1]
    assert shift == pytest.approx([0.0] * 6 + [1.0] * 5, abs=1e-4)


def test_a_reference_that_begins_late_says_how_far_the_start_is_moved(source: Source, tmp_path: Path) -> None:
    found = with_reference(source, reference(tmp_path, [(50, 1020.0)], compose(SHIFT, raw(source)[[50]])))
    (warning,) = found.warnings
    assert f"the start is that of scan 50 moved back by odometry over {travelled(raw(source))[50]:.1f} m" in warning
    assert found.start == pytest.approx(compose(SHIFT, raw(source)[0]), abs=1e-4)
    assert found.steps[0].truth is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 1000.0 1 2\n0 1000.0 1 2 3\n", r"some\.ref\.txt:1: 4 columns"),
        ("0.5 1000.0 1 2 3\n", r"some\.ref\.txt:1: scan is 0\.5; expected a whole number"),
        ("60 1000.0 1 2 3\n", r"some\.ref\.txt:1: scan is 60; expected 0 to 59, the scans of the log"),
        ("0 1000 1 2 3\n1 77 1 2 3\n2 78 1 2 3\n", r"some\.ref\.txt:2: scan 1 at 77\.000 s, where the log has 1000\.4"),
        ("# nothing\n", r"some\.ref\.txt: no rows"),
    ],
)
def test_references_that_cannot_be_used(source: Source, tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        with_reference(source, write(tmp_path, text, "some.ref.txt"))


def test_lines_of_a_reference_with_other_stamps_are_left_out(source: Source, tmp_path: Path) -> None:
    rows = [(0, 1000.0), (1, 1000.4), (2, 1000.86)]
    found = with_reference(source, reference(tmp_path, rows, compose(SHIFT, raw(source)[[0, 1, 3]])))
    (warning,) = found.warnings
    assert "some.ref.txt:4: left out 1 line with another time stamp than the log" in warning
    assert_poses(np.array([found.steps[2].truth]), compose(SHIFT, raw(source)[[2]]))


def test_a_reference_is_for_whole_laser_logs(source: Source, tmp_path: Path) -> None:
    path = reference(tmp_path, [(0, 1000.0)], raw(source)[:1])
    for other in (build("paper-line"), part(source, 3), replace(source, scans=None)):
        with pytest.raises(SourceError, match="a reference is for the scans of a whole laser log"):
            with_reference(other, path)


def test_a_long_log_is_cut_and_thinned_at_once(tmp_path: Path) -> None:
    source = read_log(write(tmp_path, plain_log(arc(20000, 0.03), 5)))
    began = perf_counter()
    few = keyframes(part(source, 100, 19000, 2), 0.25, math.radians(8))
    every_scan(few, dead_reckoning(few))
    assert perf_counter() - began < 5.0
    assert 1000 < len(few.steps) < 9000
