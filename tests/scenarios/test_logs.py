"""Log readers on small files that the tests write, in each format, and on input that cannot be used."""

from __future__ import annotations

import gzip
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from scenarios.logs import dead_reckoning, is_log, part, read_log
from scenarios.logs.text import read_table
from scenarios.types import SourceError
from slam.geometry import wrap
from slam.motion import Ackermann, Unicycle, propagate
from slam.types import UNKNOWN_TAG

MRCLAM_HEADER = "# UTIAS Multi-Robot Cooperative Localization and Mapping Dataset\n# {} Data Fomat:\n"

MRCLAM = {
    "Barcodes.dat": ("Barcode", "1 5\n2 14\n6 63\n7 81\n"),
    "Landmark_Groundtruth.dat": ("Landmark Groundtruth", "6 2.0 0.5 0.0001 0.0002\n7 1.0 -1.0 0.0001 0.0002\n"),
    "Robot1_Odometry.dat": ("Odometry", "100.0 1.0 0.0\n100.1 1.0 0.5\n100.3 2.0 0.0\n100.4 0.0 0.0\n"),
    # two landmarks and robot 2 at once; robot 2 alone; an unknown barcode with a landmark
    "Robot1_Measurement.dat": (
        "Measurement",
        "100.15 63 1.9 0.1\n100.15 14 3.0 0.2\n100.15 81 1.4 -0.7\n"
        "100.2 14 3.0 0.2\n100.35 99 1.0 0.0\n100.35 63 1.6 0.3\n",
    ),
    "Robot1_Groundtruth.dat": (
        "Robot Groundtruth",
        "99.0 0.0 0.0 3.1\n100.0 1.0 2.0 3.1\n100.3 1.3 2.3 -3.1\n101.0 9.0 9.0 0.0\n",
    ),
}

# Columns t speed steering, 40 Hz; t range bearing diameter; t x y.
VICTORIA_PARK = {
    "dead_reckoning.txt": "1.000 0.0 0.0\n1.025 2.0 0.1\n1.050 2.0 0.1\n1.075 2.0 -0.1\n1.100 2.0 0.0\n",
    "trees.txt": "0.9 5.0 1.570796 0.3\n1.06 5.0 1.0 0.3\n1.06 9.0 3.1 0.5\n1.11 4.5 0.5 0.3\n",
    "gps.txt": "0.8 -67.65 -41.71\n1.0 -67.63 -41.69\n1.2 -67.55 -41.61\n",
}


NONE: Mapping[str, str] = MappingProxyType({})


def write_mrclam(
    folder: Path, pack: bool = False, newline: str = "\n", header: bool = True, changes: Mapping[str, str] = NONE
) -> Path:
    """Write the data set into `folder`; `changes` replace the text (header included) of a file, by stem."""
    folder.mkdir(exist_ok=True)
    for name, (what, rows) in MRCLAM.items():
        text = (MRCLAM_HEADER.format(what) if header else "") + rows
        write(folder, name, changes.get(name.split(".")[0], text), pack, newline)
    return folder


def write_victoria_park(
    folder: Path, pack: bool = False, newline: str = "\n", changes: Mapping[str, str] = NONE
) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in VICTORIA_PARK.items():
        write(folder, name, changes.get(name.split(".")[0], text), pack, newline)
    return folder


def write(folder: Path, name: str, text: str, pack: bool, newline: str) -> None:
    data = text.replace("\n", newline).encode()
    (folder / f"{name}{'.gz' if pack else ''}").write_bytes(gzip.compress(data) if pack else data)


def rows_of(name: str, *replaced: tuple[int, str]) -> str:
    """The text of an MRCLAM file with its header of two lines and some lines (from 1) replaced."""
    what, rows = MRCLAM[f"{name}.dat"]
    lines = (MRCLAM_HEADER.format(what) + rows).splitlines()
    for line, text in replaced:
        lines[line - 1] = text
    return "\n".join(lines) + "\n"


WAYS = pytest.mark.parametrize(
    ("pack", "newline"), [(False, "\n"), (True, "\n"), (False, "\r\n"), (True, "\r\n")], ids=str
)


@WAYS
def test_mrclam_frames_ticks_and_truth(tmp_path: Path, pack: bool, newline: str) -> None:
    source = read_log(write_mrclam(tmp_path / "set", pack, newline), robot=1)

    assert isinstance(source.motion, Unicycle)
    first, second = source.steps
    assert (first.frame.time, second.frame.time) == (100.15, 100.35)
    assert first.frame.tags.tolist() == [6, 7]
    assert second.frame.tags.tolist() == [6]
    np.testing.assert_array_equal(first.frame.z, [[1.9, 0.1], [1.4, -0.7]])
    # Ticks: 0.1 s of the first control, 0.05 of the second; then the rest of it, and 0.05 s of the third.
    np.testing.assert_array_equal(first.frame.u, [[1.0, 0.0], [1.0, 0.5]])
    np.testing.assert_allclose(first.frame.dt, [0.1, 0.05], atol=1e-9)
    np.testing.assert_array_equal(second.frame.u, [[1.0, 0.5], [2.0, 0.0]])
    np.testing.assert_allclose(second.frame.dt, [0.15, 0.05], atol=1e-9)

    np.testing.assert_array_equal(source.start, [1.0, 2.0, 3.1])
    middle = 0.5 * (3.1 + (math.tau - 3.1))  # half way on the circle, over +-pi
    assert first.truth is not None
    np.testing.assert_allclose(first.truth, [1.15, 2.15, wrap(middle)], atol=1e-9)
    assert second.truth is None  # 0.7 s between two poses
    assert source.true_map is not None
    np.testing.assert_array_equal(source.true_map.tags, [6, 7])
    np.testing.assert_array_equal(source.true_map.theta, [[2.0, 0.5], [1.0, -1.0]])
    assert source.params().association == "known"
    assert "2 of other robots" in source.title
    (warning,) = source.warnings
    assert re.search(r"Robot1_Measurement\.dat(\.gz)?:7: 1 .*barcode 99", warning)


def test_mrclam_without_headers_goes_by_name(tmp_path: Path) -> None:
    assert len(read_log(write_mrclam(tmp_path / "set", header=False)).steps) == 2


def test_mrclam_is_recognised_by_its_headers_whatever_the_names(tmp_path: Path) -> None:
    folder = write_mrclam(tmp_path / "set", pack=True)
    for file in sorted(folder.iterdir()):
        file.rename(folder / f"run-{file.name.replace('.dat.gz', '.log').replace('_', '-')}")
    assert len(read_log(folder).steps) == 2


@pytest.mark.parametrize("name", ["Robot1_Odometry.dat", "Robot1_Measurement.dat", "Barcodes.dat"])
def test_a_file_stands_for_its_data_set(tmp_path: Path, name: str) -> None:
    folder = write_mrclam(tmp_path / "set")
    assert len(read_log(folder / name).steps) == 2
    assert is_log(folder / name)


def test_a_file_of_one_robot_is_not_another_robot(tmp_path: Path) -> None:
    folder = write_mrclam(tmp_path / "set")
    with pytest.raises(SourceError, match=r"Robot1_Odometry\.dat: a file of robot 1; expected robot 2"):
        read_log(folder / "Robot1_Odometry.dat", robot=2)


def test_repeated_sightings_keep_the_first(tmp_path: Path) -> None:
    folder = write_mrclam(
        tmp_path / "set", changes={"Robot1_Measurement": rows_of("Robot1_Measurement", (4, "100.15 63 1.8 0.2"))}
    )
    source = read_log(folder)
    assert source.steps[0].frame.tags.tolist() == [6, 7]
    np.testing.assert_array_equal(source.steps[0].frame.z[0], [1.9, 0.1])
    assert any("Robot1_Measurement.dat:4: 1 repeated" in w for w in source.warnings)


def test_observations_without_controls_are_left_out(tmp_path: Path) -> None:
    rows = "90.0 63 1.9 0.1\n100.15 63 1.9 0.1\n120.0 63 1.9 0.1\n130.0 63 1.9 0.1\n"
    source = read_log(write_mrclam(tmp_path / "set", changes={"Robot1_Measurement": "# Measurement Data\n" + rows}))
    assert [step.frame.time for step in source.steps] == [100.15]
    assert any("Robot1_Odometry.dat:3" in w and "at 1 time before" in w for w in source.warnings)
    assert any("Robot1_Odometry.dat:6" in w and "2 times" in w for w in source.warnings)


@WAYS
def test_victoria_park_frames_controls_and_gps(tmp_path: Path, pack: bool, newline: str) -> None:
    source = read_log(write_victoria_park(tmp_path / "park", pack, newline))

    assert source.motion == Ackermann(wheelbase=2.83, ahead=3.78, left=0.5)
    first, second, third = source.steps
    assert [s.frame.time for s in source.steps] == [0.9, 1.06, 1.11]
    assert first.frame.u.shape == (0, 2)  # before the first control the car stands
    np.testing.assert_allclose(second.frame.dt, [0.025, 0.025, 0.01])
    np.testing.assert_allclose(third.frame.dt, [0.015, 0.025, 0.01])
    np.testing.assert_allclose(third.frame.u[:, 1], [0.1, -0.1, 0.0])
    rear = 2.0 / (1 - math.tan(0.1) * 0.76 / 2.83)
    np.testing.assert_allclose(second.frame.u[1], [rear / math.cos(0.1), 0.1], rtol=1e-12)
    np.testing.assert_allclose(second.frame.z, [[5.0, 1.0 - math.pi / 2], [9.0, 3.1 - math.pi / 2]], rtol=1e-12)
    assert second.frame.tags.tolist() == [UNKNOWN_TAG, UNKNOWN_TAG]
    assert source.params().association == "jcbb"
    np.testing.assert_allclose(source.start, [-67.65, -41.71, math.radians(35.5)])
    assert first.truth is not None
    np.testing.assert_allclose(first.truth, [-67.64, -41.70, math.nan])
    assert source.true_map is None
    assert source.warnings == ()


def test_left_turn_slows_the_left_rear_wheel(tmp_path: Path) -> None:
    """The wheel at (0, 0.76) of a vehicle that rolls with the controls moves at the speed that was logged."""
    frame = read_log(write_victoria_park(tmp_path / "park")).steps[1].frame
    wheel = Ackermann(wheelbase=2.83, ahead=0.0, left=0.76)
    moved, _, _ = propagate(wheel, (0.0, 0.76, 0.0), tuple(frame.u[1]), 1e-6)
    assert math.hypot(moved[0], moved[1] - 0.76) / 1e-6 == pytest.approx(2.0, rel=1e-5)


def test_gps_jumps_and_gaps_are_no_truth(tmp_path: Path) -> None:
    gps = "0.8 0.0 0.0\n1.0 0.1 0.0\n1.2 9.0 0.0\n5.0 9.1 0.0\n"
    steps = read_log(write_victoria_park(tmp_path / "park", changes={"gps": gps})).steps
    assert [step.truth is not None for step in steps] == [True, False, False]


def test_victoria_park_without_gps_has_no_truth(tmp_path: Path) -> None:
    folder = write_victoria_park(tmp_path / "park")
    (folder / "gps.txt").unlink()
    source = read_log(folder)
    assert all(step.truth is None for step in source.steps)
    assert any("no GPS" in w for w in source.warnings)


def test_victoria_park_is_recognised_by_its_columns(tmp_path: Path) -> None:
    folder = write_victoria_park(tmp_path / "park", pack=True)
    for file, name in zip(sorted(folder.iterdir()), ("a.bin", "b.dat", "c"), strict=True):
        file.rename(folder / name)
    (folder / "README.md").write_text("Notes of the drive\n")
    (folder / "laser").write_text("1.0 " + "81.91 " * 361 + "\n")
    assert len(read_log(folder).steps) == 3


# -- what cannot be used --------------------------------------------------------------------------------------------


def broken_mrclam(name: str, *replaced: tuple[int, str]) -> Callable[[Path], Path]:
    return lambda place: write_mrclam(place / "set", changes={name: rows_of(name, *replaced)})


def broken_park(name: str, text: str) -> Callable[[Path], Path]:
    return lambda place: write_victoria_park(place / "park", changes={name: text})


def without(name: str) -> Callable[[Path], Path]:
    def make(place: Path) -> Path:
        (write_mrclam(place / "set") / f"{name}.dat").unlink()
        return place / "set"

    return make


def one_file(data: bytes, name: str = "some.log") -> Callable[[Path], Path]:
    def make(place: Path) -> Path:
        (place / name).write_bytes(data)
        return place / name

    return make


def damaged_gzip(place: Path) -> Path:
    file = write_mrclam(place / "set", pack=True) / "Robot1_Odometry.dat.gz"
    data = bytearray(file.read_bytes())
    data[-6] ^= 0xFF  # the checksum
    file.write_bytes(data)
    return place / "set"


UNUSABLE = {
    "letters": (broken_mrclam("Robot1_Odometry", (4, "100.1 x1 0.5")), r"Odometry\.dat:4: 'x1' .* expected 3 columns"),
    "missing column": (broken_mrclam("Robot1_Odometry", (4, "100.1 1.0")), r"Odometry\.dat:4: 2 columns .*expected 3"),
    "extra column": (broken_mrclam("Robot1_Odometry", (6, "100.4 1 0 7")), r"Odometry\.dat:6: 4 columns .*expected 3"),
    "nan": (broken_mrclam("Robot1_Measurement", (5, "100.15 81 nan 0")), r"Measurement\.dat:5: 'nan' is not a finite"),
    "nan at the end": (broken_mrclam("Robot1_Odometry", (6, "100.4 0 NaN")), r"Odometry\.dat:6: 'NaN' is not a fin"),
    "infinite": (broken_mrclam("Robot1_Groundtruth", (4, "100 inf 2 3")), r"Groundtruth\.dat:4: 'inf' is not a fin"),
    "overflow": (broken_mrclam("Robot1_Groundtruth", (4, "100 1e999 2 3")), r"Groundtruth\.dat:4: '1e999' is not"),
    "negative range": (
        broken_mrclam("Robot1_Measurement", (5, "100.15 81 -1.4 0")),
        r"Measurement\.dat:5: range \[m\] is -1\.4; expected a range above 0",
    ),
    "bearing in degrees": (
        broken_mrclam("Robot1_Measurement", (5, "100.15 81 1.4 -40")),
        r"Measurement\.dat:5: bearing \[rad\] is -40; expected radians",
    ),
    "half a barcode": (
        broken_mrclam("Robot1_Measurement", (5, "100.15 8.5 1.4 0")),
        r"Measurement\.dat:5: barcode is 8\.5; expected a whole number",
    ),
    "a barcode of two": (
        lambda place: write_mrclam(place / "set", changes={"Barcodes": "# Barcode Data\n1 5\n2 14\n6 63\n7 63\n"}),
        r"Barcodes\.dat:5: barcode is 63; expected each number once",
    ),
    "a landmark that is there twice": (
        lambda place: write_mrclam(
            place / "set", changes={"Landmark_Groundtruth": "# Landmark\n6 2.0 0.5 0 0\n6 1.0 -1.0 0 0\n"}
        ),
        r"Landmark_Groundtruth\.dat:3: subject is 6; expected each number once",
    ),
    "odometry backwards": (
        broken_mrclam("Robot1_Odometry", (5, "100.05 2.0 0.0")),
        r"Odometry\.dat:5: time runs backwards, from 100\.100 s to 100\.050 s; expected times in order",
    ),
    "truth backwards": (broken_mrclam("Robot1_Groundtruth", (5, "99.5 1 2 3")), r"Groundtruth\.dat:5: time runs back"),
    "binary": (broken_mrclam("Robot1_Odometry", (4, "100.1\0 1 0")), r"Odometry\.dat:4: binary data; expected text"),
    "no odometry file": (without("Robot1_Odometry"), r"set: no Robot1_Odometry; expected .*UTIAS MRCLAM"),
    "no barcodes": (without("Barcodes"), r"set: no Barcodes; expected .*UTIAS MRCLAM"),
    "no truth": (without("Robot1_Groundtruth"), r"set: no Robot1_Groundtruth; expected"),
    "empty member": (
        lambda place: write_mrclam(place / "set", changes={"Robot1_Odometry": ""}),
        r"Robot1_Odometry\.dat: no rows; expected lines with 3 columns: time",
    ),
    "header only": (
        lambda place: write_mrclam(place / "set", changes={"Robot1_Measurement": "# Measurement Data Fomat:\n"}),
        r"Robot1_Measurement\.dat: no rows; expected lines with 4 columns",
    ),
    "only robots seen": (
        lambda place: write_mrclam(
            place / "set", changes={"Robot1_Measurement": "# Measurement Data\n100.2 14 1.0 0.0\n"}
        ),
        r"Robot1_Measurement\.dat: no sighting of a landmark",
    ),
    "other times": (
        lambda place: write_mrclam(
            place / "set", changes={"Robot1_Measurement": "# Measurement Data\n5.0 63 1.0 0.0\n"}
        ),
        r"Robot1_Odometry\.dat: .*no observation in that time; expected files of the same run",
    ),
    "truth of another run": (
        lambda place: write_mrclam(
            place / "set", changes={"Robot1_Groundtruth": "# Robot Groundtruth Data\n1 0 0 0\n2 0 0 0\n"}
        ),
        r"Robot1_Groundtruth\.dat: .*no odometry in that time; expected files of the same run",
    ),
    "damaged gzip": (damaged_gzip, r"Robot1_Odometry\.dat\.gz: damaged gzip data"),
    "park, broken line": (
        broken_park("trees", "0.9 5 1 .3\n1.06 5\n1.11 4 1 .3\n"),
        r"trees\.txt:2: 2 columns .*expected 4",
    ),
    "park, negative range": (
        broken_park("trees", "0.9 5 1 .3\n1.06 -5 1 .3\n1.1 5 1 .3\n"),
        r"trees\.txt:2: range \[m\] is -5; expected",
    ),
    "park, behind": (
        broken_park("trees", "0.9 5 1 .3\n" * 20 + "1.06 5 4.0 .3\n"),
        r"trees\.txt:21: bearing from the right \[rad\] is 4; expected a bearing from 0 \(right\) to pi",
    ),
    "park, steering": (
        broken_park("dead_reckoning", "1.0 1.0 0.0\n" * 20 + "1.1 1.0 2.5\n"),
        r"dead_reckoning\.txt:21: steering \[rad\] is 2\.5; expected a steering angle within",
    ),
    "park, backwards": (
        broken_park("trees", "0.9 5 1 .3\n1.06 5 1 .3\n1.01 5 1 .3\n1.1 5 1 .3\n"),
        r"trees\.txt:3: time runs backwards, from 1\.060 s to 1\.010 s",
    ),
    "park, no trees": (broken_park("trees", "# none\n"), r"trees\.txt: no rows; expected lines with 4 columns"),
    "empty file": (one_file(b""), r"some\.log: no log of a known format, it holds no line of text; expected UTIAS"),
    "another format": (one_file(b"VERTEX_SE2 0 1.0 2.0\n"), r"some\.log: no log of a known format.*'VERTEX_SE2 0 1\.0"),
    "garbage": (one_file(bytes(range(256)) * 64), r"some\.log: no log of a known format"),
    "garbage gzip": (one_file(b"\x1f\x8b" + bytes(range(256))), r"some\.log: no log of a known format"),
    "garbage in a known name": (one_file(b"\x00\xff" * 99, "Robot1_Odometry.dat"), r"no Robot1_Measurement"),
    "empty directory": (
        lambda place: place,
        r": no data set in this directory; expected UTIAS MRCLAM .* Victoria Park",
    ),
    "directory above": (
        lambda place: write_mrclam(place / "set").parent,
        r": no data set in this directory \(its directories: set\); expected",
    ),
    "nothing there": (
        lambda place: place / "nowhere",
        r"nowhere: cannot be read \(No such file or directory\); expected",
    ),
}


@pytest.mark.parametrize(("make", "message"), UNUSABLE.values(), ids=UNUSABLE.keys())
def test_input_that_cannot_be_used(tmp_path: Path, make: Callable[[Path], Path], message: str) -> None:
    with pytest.raises(SourceError, match=message) as caught:
        read_log(make(tmp_path))
    assert "\n" not in str(caught.value)


def test_a_robot_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"set: no robot 4; expected one of 1$"):
        read_log(write_mrclam(tmp_path / "set"), robot=4)
    with pytest.raises(SourceError, match=r"no robot 2; expected no choice of robot, Victoria Park has one vehicle"):
        read_log(write_victoria_park(tmp_path / "park"), robot=2)


def test_a_file_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_mrclam(tmp_path / "set")
    opened = Path.open

    def refuse(path: Path, *args: object, **kwargs: object) -> object:
        if path.name == "Robot1_Odometry.dat":
            raise PermissionError(13, "Permission denied")
        return opened(path, *args, **kwargs)  # pyright: ignore[reportCallIssue, reportArgumentType]

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(SourceError, match=r"Robot1_Odometry\.dat: cannot be read \(Permission denied\)"):
        read_log(folder)


# -- what is cut short ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "last", ["100.4 0.0", "100.4 0.0\n", "100.4", "100.4 0.0 -", "100.4 0.0 0.", "100.4 0.0 1.2e-"]
)
def test_a_last_line_cut_short_is_a_warning(tmp_path: Path, last: str) -> None:
    text = "# Odometry Data\n100.0 1.0 0.0\n100.1 1.0 0.5\n100.3 2.0 0.1\n" + last
    source = read_log(write_mrclam(tmp_path / "set", changes={"Robot1_Odometry": text}))
    assert len(source.steps) == 2
    assert any("Robot1_Odometry.dat:5: the last line" in w and "cut short" in w for w in source.warnings)


def test_a_last_line_without_line_end_is_whole(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("1.0 2.0\n3.0 4.0")
    table = read_table(tmp_path / "file", ("a", "b"))
    np.testing.assert_array_equal(table.values, [[1, 2], [3, 4]])
    assert table.warnings == ()


def test_gzip_cut_short_is_a_warning(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    text = "".join(f"{100 + 0.01 * i:.3f} {v:.3f} {w:.3f}\n" for i, (v, w) in enumerate(rng.normal(size=(500, 2))))
    folder = write_mrclam(tmp_path / "set")
    (folder / "Robot1_Odometry.dat").write_bytes(gzip.compress(text.encode())[:-1500])
    source = read_log(folder)
    assert len(source.steps) == 2
    assert any("Robot1_Odometry.dat:" in w and "cut short" in w for w in source.warnings)
    (folder / "Robot1_Odometry.dat").write_bytes(gzip.compress(text.encode())[:20])
    with pytest.raises(SourceError, match=r"Robot1_Odometry\.dat: no rows; its gzip data are cut short"):
        read_log(folder)


# -- parts of a log -------------------------------------------------------------------------------------------------


@pytest.fixture
def long_log(tmp_path: Path) -> Path:
    """A robot on a circle, seen by its landmarks every 0.1 s, and the truth of it."""
    t = 10.0 + 0.05 * np.arange(200)
    turned = 0.4 * (t - t[0])
    pose = np.stack([2.5 * np.sin(turned), 2.5 * (1 - np.cos(turned)), np.mod(turned + math.pi, math.tau) - math.pi], 1)
    changes = {
        "Robot1_Odometry": "# Odometry Data\n" + "".join(f"{x:.6f} 1.0 0.4\n" for x in t),
        "Robot1_Measurement": "# Measurement Data\n" + "".join(f"{x:.6f} 63 1.0 0.0\n" for x in t[2::2]),
        "Robot1_Groundtruth": "# Robot Groundtruth Data\n"
        + "".join(f"{x:.6f} {a:.9f} {b:.9f} {c:.9f}\n" for x, (a, b, c) in zip(t, pose, strict=True)),
    }
    return write_mrclam(tmp_path / "set", changes=changes)


@pytest.mark.parametrize(
    ("first", "last", "every"), [(None, None, 1), (0, 20, 1), (30, None, 1), (7, 70, 5), (3, 999, 4)]
)
def test_parts_follow_the_truth(long_log: Path, first: int | None, last: int | None, every: int) -> None:
    whole = read_log(long_log)
    source = read_log(long_log, first=first, last=last, every=every)
    end = min(len(whole.steps) - 1 if last is None else last, len(whole.steps) - 1)
    expected = [whole.steps[i].frame.time for i in range(first or 0, end + 1, every)]
    assert [step.frame.time for step in source.steps] == expected
    truth = np.array([step.truth for step in source.steps])
    np.testing.assert_allclose(dead_reckoning(source), truth, atol=1e-6)


def test_a_part_without_headings_is_fitted_to_the_positions(long_log: Path) -> None:
    whole = read_log(long_log)
    blind = [s._replace(truth=None if s.truth is None else np.array([*s.truth[:2], math.nan])) for s in whole.steps]
    turned = np.array([5.0, 6.0, 1.0])  # dead reckoning in another frame than the truth
    source = part(whole.__class__(**{**whole.__dict__, "steps": tuple(blind), "start": turned}), first=40)
    before = whole.steps[39].truth
    assert before is not None
    np.testing.assert_allclose(source.start, before, atol=1e-6)
    none = tuple(s._replace(truth=None) for s in whole.steps)
    source = part(whole.__class__(**{**whole.__dict__, "steps": none}), first=40)
    np.testing.assert_allclose(source.start, before, atol=1e-6)
    assert "no truth around frame 40" in source.warnings[-1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"first": 99}, r"first frame 99: expected 0 to 98"),
        ({"first": -1}, r"first frame -1: expected 0 to 98"),
        ({"first": 9, "last": 8}, r"last frame 8: expected 9, the first frame, or more"),
        ({"every": 0}, r"every 0: expected 1 or more"),
    ],
)
def test_parts_that_are_none(long_log: Path, options: dict[str, int], message: str) -> None:
    with pytest.raises(SourceError, match=message):
        read_log(long_log, **options)


def test_what_is_a_log(tmp_path: Path) -> None:
    world = tmp_path / "world.toml"
    world.write_text("[route]\nspeed = 1.0\n")
    assert not is_log(world)
    assert not is_log(tmp_path / "nowhere")
    assert is_log(tmp_path)
    assert is_log(write_victoria_park(tmp_path / "park") / "trees.txt")
