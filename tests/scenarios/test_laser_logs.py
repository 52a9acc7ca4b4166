"""CARMEN and DP-SLAM logs that the tests write: what becomes of them, and what cannot be used."""

from __future__ import annotations

import gzip
import math
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from scenarios.logs import dead_reckoning, is_log, read_log
from scenarios.logs.keyframes import keyframes
from scenarios.types import Source, SourceError
from slam.features import Wall
from slam.geometry import compose
from slam.motion import Odometry
from slam.perception import perceive
from slam.presets import BUILDING
from tests.scenarios.laser_logs import NOTHING, arc, flaser, odom, plain_log, readings, robotlaser, write

POSES = arc(5)


def scans_of(source: Source) -> list[np.ndarray]:
    found = [step.frame.scan for step in source.steps]
    return [scan.ranges for scan in found if scan is not None]


def scan_of(source: Source, k: int = 0):
    scan = source.steps[k].frame.scan
    assert scan is not None
    return scan


@pytest.mark.parametrize("pack", [False, True])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_flaser(tmp_path: Path, pack: bool, newline: str) -> None:
    text = "# comment\nPARAM robot_length 0.5 host 0\nSYNC x\n" + plain_log(POSES)
    data = text.replace("\n", newline).encode()
    path = tmp_path / ("my.first.log.gz" if pack else "my.first.log")
    path.write_bytes(gzip.compress(data) if pack else data)
    source = read_log(path)
    assert (source.kind, source.name, source.warnings) == ("log", "my.first", ())
    assert "5 scans of 181 beams, 0 m by odometry" in source.title
    assert source.params().inflate_r == BUILDING["inflate_r"]
    assert source.start.tolist() == pytest.approx(POSES[0], abs=1e-6)
    np.testing.assert_allclose(dead_reckoning(source), POSES, atol=2e-6)
    for k, (frame, truth) in enumerate(source.steps):
        assert truth is None
        assert (frame.motion, frame.feature, frame.time) == (Odometry(), Wall(), 1000.0 + 0.5 * k)
        assert (frame.u.shape, frame.z.shape, frame.tags.shape) == ((1, 3), (0, Wall.observation), (0,))
        np.testing.assert_allclose(frame.u[0], [0.1, 0.0, -0.05] if k else [0, 0, 0], atol=3e-6)
        assert frame.dt.tolist() == ([0.5] if k else [0.0])
        expected = np.where(readings(k) == NOTHING, np.inf, readings(k))
        np.testing.assert_allclose(scan_of(source, k).ranges, expected)
        np.testing.assert_array_equal(scan_of(source, k).origin, 0.0)
        assert 8.0 < scan_of(source, k).max_range < NOTHING
    assert source.scans is not None
    np.testing.assert_allclose(source.scans.odometry, POSES, atol=1e-6)
    assert source.scans.kept.tolist() == list(range(5))


@pytest.mark.parametrize(
    ("n", "first", "last", "spacing"),
    [(180, -90, 89, 1), (181, -90, 90, 1), (360, -90, 89.5, 0.5), (361, -90, 90, 0.5), (401, -50, 50, 0.25)],
)
def test_where_the_beams_of_old_logs_look(tmp_path: Path, n: int, first: float, last: float, spacing: float) -> None:
    bearings = np.degrees(scan_of(read_log(write(tmp_path, plain_log(POSES, n)))).bearings)
    assert (bearings[0], bearings[-1]) == pytest.approx((first, last))
    assert np.diff(bearings) == pytest.approx(spacing)


def test_scans_of_180_and_181_beams_may_alternate(tmp_path: Path) -> None:
    text = "".join(flaser(readings(k, 180 + k % 2), p, p, float(k)) for k, p in enumerate(POSES))
    source = read_log(write(tmp_path, text))
    assert [len(ranges) for ranges in scans_of(source)] == [180, 181, 180, 181, 180]
    assert "180 to 181 beams" in source.title
    assert source.warnings == ()
    np.testing.assert_allclose(scans_of(source)[3][1:10], readings(3)[1:10])
    np.testing.assert_allclose(dead_reckoning(source), POSES, atol=2e-6)


def test_numbers_of_beams_of_different_lasers_are_told(tmp_path: Path) -> None:
    text = "".join(flaser(readings(k, 181 if k < 3 else 361), p, p, float(k)) for k, p in enumerate(POSES))
    one, other = read_log(write(tmp_path, text)).warnings
    assert "some.log:1: the number of readings changes" in one
    assert "those of 3 scans of 181 are taken to be 1 degrees apart, from -90" in one
    assert "some.log:4: " in other
    assert "those of 2 scans of 361 are taken to be 0.5 degrees apart, from -90" in other


def test_other_numbers_of_beams_are_spread_in_front(tmp_path: Path) -> None:
    source = read_log(write(tmp_path, plain_log(POSES, 91)))
    assert np.degrees(scan_of(source).bearings[[0, 1, -1]]) == pytest.approx([-90, -88, 90])
    (warning,) = source.warnings
    assert "some.log:1: nothing tells where the 91 beams look" in warning


def test_an_empty_scan_is_no_other_number_of_beams(tmp_path: Path) -> None:
    lines = plain_log(POSES, 91) + flaser([], POSES[4], POSES[4], 1003.0)
    assert [len(ranges) for ranges in scans_of(read_log(write(tmp_path, lines)))] == [91] * 5 + [0]


def test_old_logs_without_time_stamps(tmp_path: Path) -> None:
    source = read_log(write(tmp_path, "".join(flaser(readings(k), p, p) for k, p in enumerate(POSES))))
    assert [step.frame.time for step in source.steps] == [0, 1, 2, 3, 4]


def test_a_laser_that_stands_ahead(tmp_path: Path) -> None:
    ahead = np.array([0.22, -0.03, 0.1])
    text = "".join(flaser(readings(k), compose(p, ahead), p, float(k)) for k, p in enumerate(POSES))
    source = read_log(write(tmp_path, text))
    assert scan_of(source, 2).origin == pytest.approx(ahead, abs=1e-4)
    assert source.steps[2].truth is None
    np.testing.assert_allclose(dead_reckoning(source), POSES, atol=2e-6)


def test_robotlaser(tmp_path: Path) -> None:
    """Angles and the largest range are its own, scan by scan; remissions and what follows the poses do not matter."""
    ahead, text = np.array([0.22, 0.0, 0.0]), ""
    for k, p in enumerate(POSES):
        start, limit = math.radians(-90 + 0.25 * (k % 4)), 50.0 if k == 4 else 81.9
        ranges = readings(k, 180 + (k % 4 == 0))
        ranges[5] = 60.0
        text += robotlaser(ranges, compose(p, ahead), p, float(k), start, limit=limit, remissions=[7.0] * (k % 3))
    source = read_log(write(tmp_path, text))
    assert source.warnings == ()
    np.testing.assert_allclose(dead_reckoning(source), POSES, atol=2e-6)
    for k in range(5):
        scan = scan_of(source, k)
        assert np.degrees(scan.bearings[0]) == pytest.approx(-90 + 0.25 * (k % 4), abs=1e-4)
        assert len(scan.bearings) == len(scan.ranges) == 180 + (k % 4 == 0)
        assert scan.ranges[5] == (math.inf if k == 4 else 60.0)
        assert scan.max_range == pytest.approx(50.0 if k == 4 else 81.9, rel=0.003)
        assert np.isinf(scan.ranges[0])
        assert scan.origin == pytest.approx(ahead, abs=1e-4)


def test_rawlaser_takes_its_pose_from_odom_messages(tmp_path: Path) -> None:
    raw = "RAWLASER1 0 -1.570796 3.141593 0.017453 81.9 0.01 0 {} {} 0 {:.6f} host 0\n"
    text = odom((1.4, 2.8, -3.1), 11.0)
    for stamp in (10.25, 10.5, 12.5):
        text += raw.format(181, " ".join(f"{r:g}" for r in readings(1)), stamp)
    text += odom((1.0, 2.0, 3.1), 10.0)  # in any order
    source = read_log(write(tmp_path, text))
    assert source.scans is not None
    middle = 3.1 + 0.25 * (math.tau - 6.2)  # on the circle, over pi
    expected = [[1.1, 2.2, middle], [1.2, 2.4, -math.pi], [1.4, 2.8, -3.1]]
    np.testing.assert_allclose(source.scans.odometry, expected, atol=1e-6)
    (warning,) = source.warnings
    assert "some.log:4: 1 scan lies before the first or after the last ODOM message" in warning


def test_corrected_poses_are_the_truth(tmp_path: Path) -> None:
    shift = np.array([0.5, -0.5, 0.3])
    better = compose(shift, arc(30, 0.1, 0.08))
    pairs = enumerate(zip(better, arc(30), strict=True))
    source = read_log(write(tmp_path, "".join(flaser(readings(k), b, p, float(k)) for k, (b, p) in pairs)))
    np.testing.assert_allclose([step.truth for step in source.steps], better, atol=1e-6)
    assert source.start == pytest.approx(better[0], abs=1e-6)
    np.testing.assert_allclose(dead_reckoning(source), compose(shift, arc(30)), atol=1e-5)
    assert "corrected poses as truth" in source.title
    np.testing.assert_array_equal(scan_of(source).origin, 0.0)


def test_a_log_that_gmapping_has_corrected_says_so(tmp_path: Path) -> None:
    lines = plain_log(POSES).splitlines(keepends=True)
    source = read_log(write(tmp_path, "".join(f"{line}NEFF 12.5\n" for line in lines)))
    (warning,) = source.warnings
    assert "the odometry is already corrected, by GMapping" in warning
    assert source.steps[1].truth is None


# -- what came back -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("codes", "returns"),
    [
        ([81.83], 26.0),
        ([81.91, 81.83, 81.87], 73.98),
        ([51.06, 51.11, 51.12, 51.2], 49.9),
        ([8.183, 8.183001, 8.187, 8.191], 7.9),
    ],
)
def test_what_stands_for_no_return(tmp_path: Path, codes: list[float], returns: float) -> None:
    text = ""
    for k, pose in enumerate(POSES):
        ranges = readings(k, none=3.0)
        ranges[: 4 * len(codes)] = codes * 4
        ranges[100] = returns
        text += flaser(ranges, pose, pose, float(k))
    source = read_log(write(tmp_path, text))
    for ranges in scans_of(source):
        assert np.isinf(ranges[: 4 * len(codes)]).all()
        assert np.isfinite(ranges[4 * len(codes) :]).all()
    assert returns < source.max_range < min(codes)


def test_where_all_beams_come_back_the_farthest_is_a_reading(tmp_path: Path) -> None:
    text = "".join(flaser(readings(k, none=2.0), p, p, float(k)) for k, p in enumerate(POSES))
    source = read_log(write(tmp_path, text))
    assert np.isfinite(scans_of(source)).all()
    assert np.max(scans_of(source)) < source.max_range < 9.0


def test_ranges_that_are_none_are_counted_in_one_warning(tmp_path: Path) -> None:
    text = ""
    for k, pose in enumerate(POSES):
        ranges = readings(k)
        if k in (1, 3):
            ranges[[1, 2, 3, 4]] = [math.nan, -1.0, 0.0, math.inf]
        text += flaser(ranges, pose, pose, float(k))
    source = read_log(write(tmp_path, text))
    (warning,) = source.warnings
    assert "some.log:2: 6 ranges are zero, negative or no number" in warning  # an infinite one is no complaint
    assert np.isinf(scans_of(source)[1][[1, 2, 3, 4]]).all()
    assert np.isfinite(scans_of(source)[0][[1, 2, 3, 4]]).all()
    assert not any(np.isnan(ranges).any() for ranges in scans_of(source))


def test_scans_with_nothing_in_them(tmp_path: Path) -> None:
    nothing = [[NOTHING] * 181, [], readings(2), [math.nan] * 181, readings(4)]
    text = "".join(flaser(ranges, p, p, float(k)) for k, (ranges, p) in enumerate(zip(nothing, POSES, strict=True)))
    source = read_log(write(tmp_path, text))
    np.testing.assert_allclose(dead_reckoning(source), POSES, atol=2e-6)
    assert [len(ranges) for ranges in scans_of(source)] == [181, 0, 181, 181, 181]
    for k in (0, 1, 3):
        assert not np.isfinite(scans_of(source)[k]).any()
        assert len(perceive(source.steps[k].frame, source.params()).z) == 0


# -- other messages -------------------------------------------------------------------------------------------------


def test_other_messages_are_passed_over(tmp_path: Path) -> None:
    first, *rest = plain_log(POSES).splitlines(keepends=True)
    between = "NEFF 3\nSYNC a b\nPARAM x\nODOM 1 2 3\nTRUEPOS 1 2 3 4 5 6\n# FLASER 181\n\n   \nGPS 1\n"
    source = read_log(write(tmp_path, first + between + "".join(rest)))
    assert len(source.steps) == 5
    (warning,) = source.warnings
    assert "corrected" in warning  # because of NEFF


def test_unknown_messages_and_other_lasers_are_named(tmp_path: Path) -> None:
    first, *rest = plain_log(POSES).splitlines(keepends=True)
    rear = flaser(readings(0), POSES[0], POSES[0], 1.0, "RLASER")
    source = read_log(write(tmp_path, first + "WHATEVER 1 2\n" + rear + "WHATEVER 3\n" + rear + "".join(rest)))
    assert len(source.steps) == 5
    unknown, lasers = source.warnings
    assert "some.log:2: messages that are not known are passed over: WHATEVER" in unknown
    assert "some.log:3: only FLASER messages are read; left out: 2 RLASER" in lasers


def test_one_laser_in_two_formats_is_read_once(tmp_path: Path) -> None:
    text = "".join(
        flaser(readings(k), p, p, float(k)) + robotlaser(readings(k), p, p, float(k)) for k, p in enumerate(POSES)
    )
    source = read_log(write(tmp_path, text))
    assert len(source.steps) == 5
    assert "only ROBOTLASER1 messages are read; left out: 5 FLASER" in source.warnings[0]


# -- time -----------------------------------------------------------------------------------------------------------


def test_stamps_that_jitter_keep_the_order_of_the_file(tmp_path: Path) -> None:
    stamps = [10.0, 10.5, 10.2, 10.3, 11.0]
    text = "".join(flaser(readings(k), p, p, t) for k, (p, t) in enumerate(zip(POSES, stamps, strict=True)))
    source = read_log(write(tmp_path, text))
    assert source.warnings == ()
    assert [step.frame.time for step in source.steps] == stamps
    assert [step.frame.dt[0] for step in source.steps] == pytest.approx([0.0, 0.5, 0.0, 0.0, 0.5])
    np.testing.assert_allclose(dead_reckoning(source), POSES, atol=2e-6)


def test_stamps_that_jump_are_counted_in_one_warning(tmp_path: Path) -> None:
    stamps = [1000.0, 1001.0, 1100.0, 50.0, 51.0]
    text = "".join(flaser(readings(k), p, p, t) for k, (p, t) in enumerate(zip(POSES, stamps, strict=True)))
    source = read_log(write(tmp_path, text))
    (warning,) = source.warnings
    assert "some.log:3: 2 times the time stamps jump" in warning
    assert "here by 99.000 s" in warning
    assert [step.frame.dt[0] for step in source.steps] == pytest.approx([0.0, 1.0, 99.0, 0.0, 1.0])


def test_odometry_that_leaps_is_a_warning(tmp_path: Path) -> None:
    poses = POSES.copy()
    poses[3:, 0] += 6.0
    (warning,) = read_log(write(tmp_path, plain_log(poses))).warnings
    assert "some.log:4: once the odometry leaps by more than 5 m between two scans, here by 5.9 m" in warning


def test_a_robot_that_stands_still_for_an_hour(tmp_path: Path) -> None:
    pose, text = POSES[0], "".join(flaser(readings(1, 5), POSES[0], POSES[0], 0.2 * k) for k in range(18000))
    began = perf_counter()
    source = read_log(write(tmp_path, text))
    kept = keyframes(source, 0.25, math.radians(8))
    assert perf_counter() - began < 10.0
    assert (len(source.steps), len(kept.steps)) == (18000, 2)
    assert sum(step.frame.dt.sum() for step in kept.steps) == pytest.approx(0.2 * 17999)
    np.testing.assert_allclose(dead_reckoning(kept), [pose, pose], atol=1e-6)
    assert any("some.log: by its odometry the robot never moves" in warning for warning in source.warnings)


# -- cut short ------------------------------------------------------------------------------------------------------


LINE = flaser(readings(4), POSES[4], POSES[4], 1002.0)


@pytest.mark.parametrize(
    "last",
    [
        "FLAS",
        "FLASER",
        "FLASER 18",
        "FLASER 181 1.2 3.",
        LINE.rpartition(" host")[0],
        LINE[:400],
        "1.23 1.2",
        "FLASER x\n",
    ],
)
def test_a_last_line_cut_short_is_a_warning(tmp_path: Path, last: str) -> None:
    source = read_log(write(tmp_path, plain_log(POSES[:4]) + last))
    assert len(source.steps) == 4
    (warning,) = source.warnings
    assert "some.log:5: the last line is cut short and left out" in warning


def test_a_last_line_without_line_end_is_whole(tmp_path: Path) -> None:
    source = read_log(write(tmp_path, plain_log(POSES).rstrip()))
    assert len(source.steps) == 5
    assert source.warnings == ()


def test_gzip_cut_short_is_a_warning(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    text = "".join(flaser(rng.uniform(1, 9, 181), p, p, float(k)) for k, p in enumerate(arc(40)))
    (tmp_path / "some.log.gz").write_bytes(gzip.compress(text.encode())[:-9000])
    source = read_log(tmp_path / "some.log.gz")
    assert 5 < len(source.steps) < 40
    assert f"some.log.gz:{len(source.steps)}: the gzip data are cut short here" in source.warnings[0]


# -- what cannot be used --------------------------------------------------------------------------------------------


def with_line(line: str) -> str:
    """A log with this as its third line of five."""
    lines = plain_log(POSES).splitlines(keepends=True)
    return "".join([*lines[:2], line, *lines[2:]])


def poses_with(value: float) -> str:
    return flaser(readings(0), (value, 0, 0), POSES[0], 1.0)


STANDING = "".join(flaser(readings(k), p, (0, 0, 0), float(k)) for k, p in enumerate(arc(30)))

UNUSABLE = {
    "letters": (with_line(plain_log(POSES[:1]).replace("181 ", "181 x", 1)), r"some\.log:3: FLASER: 'x81\.91' is no n"),
    "a field too few": (with_line(LINE.replace(" host", "")), r"some\.log:3: FLASER: 189 fields .*181; expected 190"),
    "other count": (with_line(LINE.replace("181", "180", 1)), r"some\.log:3: FLASER: 190 fields .* 180; expected 189"),
    "short before other messages": (
        plain_log(POSES) + LINE[:200] + "\nNEFF 1\n",
        r"some\.log:6: FLASER: .*expected 190",
    ),
    "no count": (with_line("FLASER many 1 2 3\n"), r"some\.log:3: FLASER: 'many' is no number of readings"),
    "huge count": (with_line(f"FLASER {'9' * 5000} 1 2 3\n"), r"some\.log:3: FLASER: '9{40}' is no number of readings"),
    "underscore": (
        with_line(LINE.replace("1002.0", "1_002.0", 1)),
        r"some\.log:3: FLASER: '1_002\.0+' is no number",
    ),
    "half a line": (with_line("1.23 1.24 1.25\n"), r"some\.log:3: '1\.23 1\.24 1\.25' is no message"),
    "binary": (with_line("\x00\x01\x02 \x00\n"), r"some\.log:3: '\\x00\\x01\\x02 \\x00' is no message"),
    "nan pose": (with_line(poses_with(math.nan)), r"some\.log:3: pose nan 0 0; expected finite numbers"),
    "infinite stamp": (with_line(LINE.replace("1002.000000", "inf")), r"some\.log:3: time stamp inf; expected finite"),
    "beams that change": (
        with_line(flaser(readings(0, 90), POSES[0], POSES[0], 1.0)),
        r"some\.log:3: 90 readings where other scans have 181, and nothing tells where the beams look",
    ),
    "nothing came back": (
        "".join(flaser([math.nan] * 181, p, p, float(k)) for k, p in enumerate(POSES)),
        r"some\.log: nothing came back to the laser in any of its 5 scans",
    ),
    "no odometry": (STANDING, r"some\.log: no odometry, the pose of the robot is \[0\.0, 0\.0, 0\.0\] in all 30 scans"),
    "no odometry beside raw scans": (
        robotlaser(readings(1), POSES[0], POSES[0], 1.0)
        .replace("ROBOT", "RAW")
        .replace(" 0.1 0.0 0.3 0.2 0.5", "")
        .replace(" 3.000000 4.000000 -3.000000", ""),
        r"some\.log: no odometry, since RAWLASER1 messages have no pose; expected ODOM messages",
    ),
    "only odometry": (odom(POSES[0], 1.0), r"some\.log: no scan of a laser in front, only ODOM; expected a CARMEN log"),
    "rear laser only": (
        flaser(readings(0), POSES[0], POSES[0], 1.0, "RLASER"),
        r"some\.log: no scan of a laser in front, only RLASER; expected",
    ),
    "degrees": (
        robotlaser(readings(0), POSES[0], POSES[0], 1.0, start=-90.0),
        r"some\.log:1: the start angle is -90; expected radians, at most one turn",
    ),
    "spacing in degrees": (
        robotlaser(readings(0), POSES[0], POSES[0], 1.0, spacing=1.0),
        r"some\.log:1: the angle between beams is 1; expected radians above 0, for 181 beams at most one turn",
    ),
    "remissions that are not there": (
        with_line("") + robotlaser(readings(0), POSES[0], POSES[0], 1.0).replace("\n", " 1\n") * 2,
        r"some\.log:6: ROBOTLASER1: 205 fields with 181 readings and 0 remissions; expected 204",
    ),
    "the only line is cut": (
        "FLASER 181 1.0 2.0\n",
        r"some\.log:1: FLASER: 2 fields behind the number of re",
    ),
    "small pose graph": (
        "VERTEX_SE2 0 1 2 3\n" + robotlaser(readings(0), POSES[0], POSES[0], 1.0),
        r"some\.log: no log of a known format, it begins with 'VERTEX_SE2",
    ),
    "pose graph": (
        "PARAM x\n" * 9000 + "VERTEX_SE2 0 1 2 3\n",
        r"some\.log: a pose graph \(g2o\), which has",
    ),
    "laser before odometry": (
        "Laser 2 1.0 2.0\nOdometry 1 2 3\nLaser 2 1.0 2.0\n",
        r"some\.log:1: no odometry before this scan; expected an Odometry line first",
    ),
    "dp-slam, fewer readings": (
        "Odometry 1 2 3\nLaser 3 1.0 2.0\nOdometry 1 2 3\nLaser 2 1.0 2.0\n",
        r"some\.log:2: Laser: 2 readings; expected 3, as it says",
    ),
    "dp-slam, broken odometry": (
        "Odometry 1 2\nLaser 2 1.0 2.0\n",
        r"some\.log:1: Odometry: 2 fields; expected 3, x y theta",
    ),
}


@pytest.mark.parametrize(("text", "message"), UNUSABLE.values(), ids=UNUSABLE.keys())
def test_input_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SourceError, match=message) as caught:
        read_log(write(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_log_has_one_robot(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no robot 2; expected no choice of robot"):
        read_log(write(tmp_path, plain_log(POSES)), robot=2)


# -- DP-SLAM --------------------------------------------------------------------------------------------------------


def test_dp_slam(tmp_path: Path) -> None:
    """The number of a scan stands for its time; of several poses before a scan the last counts."""
    text = "Odometry 9 9 0\n"
    for k, (x, y, theta) in enumerate(POSES):
        ranges = " ".join(f"{r:g}" for r in readings(k, none=8.191))
        text += f"Odometry {x:.6f} {y:.6f} {theta:.6f}\nLaser 181 {ranges}\n"
    source = read_log(write(tmp_path, text + "Odometry 1 2"))
    assert "DP-SLAM some.log: 5 scans of 181 beams" in source.title
    assert [step.frame.time for step in source.steps] == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(dead_reckoning(source), POSES, atol=2e-6)
    assert np.isinf(scans_of(source)[1][0])
    assert np.degrees(scan_of(source).bearings[[0, -1]]) == pytest.approx([-90, 90])
    (warning,) = source.warnings
    assert "some.log:12: the last line is cut short" in warning


# -- directories ----------------------------------------------------------------------------------------------------


def test_a_directory_with_one_log_and_corrected_ones(tmp_path: Path) -> None:
    write(tmp_path, plain_log(POSES), "b.log")
    write(tmp_path, plain_log(arc(40)).replace("FLASER", "NEFF 1\nFLASER"), "a.log")
    write(tmp_path, "1000.0 1001.0 1 0 0 0 0 0\n", "b.relations")
    assert read_log(tmp_path).name == "b"
    assert read_log(tmp_path / "a.log").name == "a"
    (tmp_path / "b.log").unlink()
    assert read_log(tmp_path).name == "a"
    assert is_log(tmp_path / "a.log")


def test_of_several_logs_the_one_that_is_called_like_the_directory(tmp_path: Path) -> None:
    folder = tmp_path / "building"
    folder.mkdir()
    for name in ("building.log", "building.easy.log", "other.log"):
        write(folder, plain_log(POSES), name)
    assert read_log(folder).name == "building"
    (folder / "building.log").unlink()
    assert read_log(folder).name == "building.easy"
    (folder / "building.easy.log").rename(folder / "third.log")
    message = r"building: 2 logs in this directory, other\.log, third\.log; expected one of these files"
    with pytest.raises(SourceError, match=message):
        read_log(folder)
