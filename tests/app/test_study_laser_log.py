"""The study of laser logs: its numbers against the paths that `dualslam run` writes, its pictures, what it refuses."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from app import cli, session
from app.drawing import NO_TRUTH, Layer, draw_map
from app.scans import all_returns
from app.study.laser_log import worse
from app.study.path_fit import Fit
from app.types import SessionInfo, SessionStep
from slam.geometry import compose, invert
from slam.types import Scan
from tests.app.drive import STEPS, Drive, tum
from tests.scenarios.laser_logs import plain_log, write

CLOSURES = ((3, 51), (30, 12), (9, 39))


def study(*arguments: object) -> int:
    words = list(map(str, arguments))
    for option, usual in {"--matching": "off", "--keyframe": "0.25,8"}.items():
        words += [] if option in words or words[:1] in ([], ["loop"]) else [option, usual]
    return cli.entry(["study", "laser-log", *words, "--jobs", "1"])


def saved(folder: Path, *arguments: object) -> dict[str, Any]:
    assert study(*arguments, "--out", folder / "study.json") == 0
    return json.loads((folder / "study.json").read_text())


def closed_to(path: np.ndarray, truth: np.ndarray) -> list[float]:
    """[m] of each closure, by its definition."""
    found = []
    for a, b in CLOSURES:
        seen, true = (compose(invert(poses[a]), poses[b]) for poses in (path, truth))
        found.append(math.dist(seen[:2], true[:2]))
    return found


def after_alignment(p: np.ndarray, q: np.ndarray) -> float:
    """[m] rms of places p (n, 2) laid upon q, by the singular vectors of what they have in common (Kabsch)."""
    a, b = p - p.mean(axis=0), q - q.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = Vt.T @ np.diag([1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    return float(np.sqrt(np.mean(np.sum((a @ R.T - b) ** 2, axis=1))))


def test_its_numbers_are_those_of_the_paths(drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = (
        "--relations",
        drive.relations,
        "--reference",
        drive.reference,
        "--keyframe",
        "0.9,30",
        "--matching",
        "off",
    )
    pairs = [f"{a}:{b}" for a, b in CLOSURES]
    found = saved(tmp_path, drive.log, *options, "--closures", *pairs, "--particles", 10, 20, "--seeds", 3, "--seed", 5)
    out = capsys.readouterr().out
    assert [(cell["filter"], cell["particles"], len(cell["runs"])) for cell in found["cells"]] == [
        ("dfs", 10, 3),
        ("dfs", 20, 3),
    ]
    files = ("--trajectory", tmp_path, "--summary", tmp_path / "s.json")
    line = ("run", drive.log, *options, "--filters", "dfs", "--particles", 20, "--seed", 6, *files)
    assert cli.entry([str(word) for word in line]) == 0
    summary = json.loads((tmp_path / "s.json").read_text())

    order = np.argsort(drive.stamps, kind="stable")
    stamps, truth = tum(tmp_path / "truth.tum")
    steps = np.array([int(np.argmin(np.abs(drive.stamps - stamp))) for stamp in stamps])
    cell = found["cells"][1]
    for key, judged in (("odometry", found["alone"]["odometry"]), ("dfs", cell["runs"][1])):
        path = np.empty((STEPS, 3))
        path[order] = tum(tmp_path / f"{key}.tum")[1]
        off = drive.off(path)
        assert judged["relations"] == 4
        assert judged["mean_m"] == pytest.approx(off.mean(), abs=1e-4)
        assert judged["median_m"] == pytest.approx(np.median(off), abs=1e-4)
        assert judged["p95_m"] == pytest.approx(np.quantile(off, 0.95), abs=1e-4)
        assert judged["max_m"] == pytest.approx(off.max(), abs=1e-4)
        assert judged["rotation_rad"] == pytest.approx(summary["relations"][key]["rotation_rad"]["mean"])
        assert judged["closures_m"] == pytest.approx(closed_to(path, drive.truth), abs=1e-4)
        assert judged["aligned_rms_m"] == pytest.approx(after_alignment(path[steps, :2], truth[:, :2]), abs=1e-4)
    run, filtered = cell["runs"][1], summary["filters"]["dfs"]
    assert (run["features"], run["resamplings"]) == (filtered["features"][-1], filtered["resamplings"])
    assert run["real_time_factor"] * run["filter_s"] == pytest.approx(drive.stamps[-1] - drive.stamps[0])
    assert 1e-3 * run["update_ms"] * summary["steps"] == pytest.approx(run["filter_s"], rel=0.9)
    assert found["log"]["scans"] == [0, STEPS - 1]
    assert found["log"]["steps"] == summary["steps"]

    off = np.array([run["closures_m"] for run in cell["runs"]])
    assert cell["closed"] == (off <= 0.5).sum(axis=0).tolist()
    assert cell["closed_all"] == (off <= 0.5).all(axis=1).sum()
    assert cell["median"]["closures_m"] == np.median(off, axis=0).tolist()
    row = re.findall(r"Dual FastSLAM +20 .*of 3.*", out)[0].split()
    assert [row[i] for i in (3, 7, 11)] == [f"{error:.3g}" for error in np.median(off, axis=0)]
    means = [run["mean_m"] for run in cell["runs"]]
    assert cell["median"]["mean_m"] == np.median(means)
    assert f"{np.median(means):.3g} ({min(means):.3g}-{max(means):.3g})" in out
    assert out.count("0 of 1") == sum(error > 0.5 for error in found["alone"]["odometry"]["closures_m"]) + 1
    assert "30:12 [m]" in out
    assert "3 of 3 seeds" in out
    assert "matching alone" not in out


def test_what_is_true_between_the_poses_of_a_reference(drive: Drive, tmp_path: Path) -> None:
    """Scans 10 and 50 have none, and get it by odometry from the scan beside them."""
    options = ("--reference", drive.reference, "--closures", "10:50", "--particles", 5, "--seeds", 1)
    found = saved(tmp_path, drive.log, *options, "--from", 6, "--to", 55)
    seen, true = (compose(invert(poses[10]), poses[50]) for poses in (drive.odometry, drive.truth))
    (error,) = found["alone"]["odometry"]["closures_m"]
    assert error == pytest.approx(math.dist(seen[:2], true[:2]), abs=0.03)
    assert error > 0.3
    assert found["log"]["scans"] == [6, 55]
    assert found["alone"]["odometry"]["mean_m"] is None


def test_a_part_without_relations_says_so(drive: Drive, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--relations", drive.relations, "--particles", 5, "--seeds", 1, "--to")
    assert study(drive.log, *options, 15) == 0
    out = capsys.readouterr().out
    assert "warning: none of the 4 relations is between two of the scans 0 to 15\n" in out
    assert "errors of" not in out
    assert study(drive.log, *options, 20) == 0
    out = capsys.readouterr().out
    assert "warning" not in out
    assert "errors of 1 relation " in out


def test_without_anything_to_compare_with(drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = saved(tmp_path, drive.log, "--particles", 5, "--filters", "dfs", "ekf", "--seeds", 2)
    out = capsys.readouterr().out
    assert [(cell["filter"], cell["particles"]) for cell in found["cells"]] == [("dfs", 5), ("ekf", 1)]
    assert found["cells"][0]["median"]["mean_m"] is None
    assert found["cells"][0]["closed_all"] is None
    assert "ms/step" in out
    for name in ("relations", "closures", "aligned", "warning"):
        assert name not in out


@pytest.mark.parametrize("period", [0.5, 1.0])
def test_a_log_whose_stamps_are_numbers_has_no_real_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], period: float
) -> None:
    """And the robot rests for ten scans, which make no step but are counted."""
    poses = np.outer(np.maximum(np.arange(30) - 10, 0), [0.3, 0.0, 0.0])
    log = write(tmp_path, plain_log(poses, period=period))
    rows = "".join(f"{k} {1000 + period * k} {x} {0.1 * (k == 25)} 0\n" for k, (x, _, _) in enumerate(poses))
    reference = write(tmp_path, rows, "some.reference")
    options = ("--particles", 5, "--seeds", 1, "--reference", reference, "--closures", "5:25")
    found = saved(tmp_path, log, *options)
    assert found["log"]["steps"] < 25
    assert found["alone"]["odometry"]["closures_m"] == [pytest.approx(0.1)]
    (run,) = found["cells"][0]["runs"]
    if period == 1.0:
        assert run["real_time_factor"] is None
        assert re.search(r"Dual FastSLAM .* -\s*\n", capsys.readouterr().out)
    else:
        assert run["real_time_factor"] * run["filter_s"] == pytest.approx(29 * period)


def test_what_filters_believe_and_do_may_be_told(drive: Drive, tmp_path: Path) -> None:
    errors = set()
    for told in ((), ("--believed.odometry", 3), ("--temper", 1), ("--every", 2)):
        found = saved(tmp_path, drive.log, "--particles", 5, "--seeds", 1, "--relations", drive.relations, *told)
        errors.add(found["cells"][0]["runs"][0]["mean_m"])
    assert len(errors) == 4


def test_matching_alone_is_judged_as_odometry_is(
    drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Matching that finds the truth."""

    class Matching:
        def begin(self, info: SessionInfo) -> None:
            pass

        def step(self, step: SessionStep) -> None:
            object.__setattr__(step, "matched", drive.truth[step.index - 1])

        def end(self) -> None:
            pass

    run = session.run
    monkeypatch.setattr(session, "run", lambda info, observers: run(info, [Matching(), *observers]))
    options = ("--keyframe", "0,0", "--particles", 5, "--seeds", 2, "--reference", drive.reference)
    found = saved(tmp_path, drive.log, *options, "--closures", "3:51")
    assert set(found["alone"]) == {"odometry", "matching"}
    assert found["alone"]["matching"]["closures_m"] == [pytest.approx(0.0, abs=1e-5)]
    assert found["alone"]["matching"]["aligned_rms_m"] < 0.02 < found["alone"]["odometry"]["aligned_rms_m"]
    assert found["cells"][0]["worse_than"]["matching"] == 2
    out = capsys.readouterr().out
    assert re.search(r"matching alone +\S+ +1 of 1 +1 of 1\s*\n", out)
    assert "is worse than matching alone" in out


# -- worse than without a filter ------------------------------------------------------------------------------------


def test_a_filter_that_makes_good_odometry_worse_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exact = Drive(tmp_path, exact=True)
    options = ("--particles", 3, "--seeds", 2, "--believed.odometry", 3)
    for judge in (("--relations", exact.relations), ("--reference", exact.reference)):
        found = saved(tmp_path, exact.log, *options, *judge)
        told = capsys.readouterr().out.replace("\n", " ")
        assert "warning: Dual FastSLAM with 3 particles is worse than odometry alone: " in told
        assert "on 2 of 2 seeds" in told
        assert found["cells"][0]["worse_than"] == {"odometry": 2}


def test_worse_than_what() -> None:
    def one(mean: float, rms: float, relations: int = 4) -> Any:
        return Fit(relations, mean, mean, mean, mean, 0.0, rms, ())

    class Run:
        def __init__(self, path: Fit) -> None:
            self.fits = {"dfs": path}

    alone = {"odometry": one(0.5, 9.0), "matching": one(0.2, 9.0)}
    cells: Any = {("dfs", 1): [Run(one(mean, 0.0)) for mean in (0.1, 0.3, 0.6)]}
    (sentence,) = worse(alone, cells)
    assert sentence == (
        "Dual FastSLAM with 1 particle is worse than matching alone: 0.3 m against 0.2 m, on 2 of 3 seeds"
    )
    assert not worse(alone, {("dfs", 1): cells["dfs", 1][:1]})
    nan = math.nan
    unjudged: Any = {("dfs", 1): [Run(one(nan, nan, 0))]}
    assert not worse({"odometry": one(nan, nan, 0)}, unjudged)
    aligned: Any = {("dfs", 30): [Run(one(nan, 2.0, 0))]}
    assert len(worse({"odometry": one(nan, 1.0, 0)}, aligned)) == 1


# -- pictures -------------------------------------------------------------------------------------------------------


def cells_of(root: ElementTree.Element) -> set[tuple[int, int]]:
    """The pixels (x, y) that the runs of a picture cover."""
    (d,) = [e.attrib["d"] for e in root.iter() if e.attrib.get("class") == "scanned"]
    x = y = 0
    found: list[tuple[int, int]] = []
    for dx, dy, long in re.findall(r"m(-?\d+) (-?\d+)h(\d+)", d):
        x, y = x + int(dx), y + int(dy)
        found += [(x + i, y) for i in range(int(long))]
        x += int(long)
    assert len(found) == len(set(found))
    return set(found)


def test_scans_are_seen_from_where_they_were_taken() -> None:
    scan = Scan(np.array([2.0, math.inf, 3.0]), np.radians([-90.0, 0.0, 90.0]), np.array([0.5, 0.0, 0.0]), 8.0)
    poses = np.array([[10.0, 20.0, math.pi / 2], [0.0, 0.0, 0.0]])
    source: Any = SimpleNamespace(steps=[SimpleNamespace(frame=SimpleNamespace(scan=s)) for s in (scan, None, scan)])
    np.testing.assert_allclose(all_returns(source, poses), [[12.0, 20.5], [7.0, 20.5]], atol=1e-12)
    assert all_returns(source, poses[:0]).shape == (0, 2)


def test_scan_points_are_the_pixels_they_fall_into() -> None:
    """A picture of 92.8 m is to a scale of 10 pixels a metre, from the 36th on."""
    path = np.array([[0.0, 0.0], [92.8, 0.0], [92.8, 30.0]])
    rng = np.random.default_rng(1)
    points = rng.uniform([-3, -3], [95, 32], (3000, 2))
    far = np.array([[500.0, 10.0], [10.0, -400.0], [-20.0, 5.0]])
    text = draw_map("x", NO_TRUTH, [Layer("y", (1, 2, 3), path)], np.concatenate([points, points[:500], far]))
    expected = np.floor(np.stack([36 + 10 * points[:, 0], 34 + 36 + 10 * (30 - points[:, 1])], axis=1) + 1e-9)
    assert cells_of(ElementTree.fromstring(text)) == {(int(x), int(y)) for x, y in expected}
    assert "seen by the laser" in text
    assert "scanned" not in draw_map("x", NO_TRUTH, [Layer("y", (1, 2, 3), path)], far)


def test_pictures_show_the_map_over_the_scans(drive: Drive, tmp_path: Path) -> None:
    options = ("--keyframe", "0,0", "--filters", "dfs", "ekf", "--matching", "off")
    pictures = tmp_path / "new" / "pictures"
    assert study(drive.log, *options, "--particles", 5, 20, "--seeds", 2, "--seed", 3, "--picture", pictures) == 0
    names = {"drive-dfs-5.svg", "drive-dfs-20.svg", "drive-ekf-1.svg"}
    assert {path.name for path in pictures.iterdir()} == names
    line = ("run", drive.log, *options, "--particles", 20, "--seed", 3, "--trajectory", tmp_path)
    assert cli.entry([str(word) for word in line]) == 0
    poses = np.empty((STEPS, 3))
    poses[np.argsort(drive.stamps, kind="stable")] = tum(tmp_path / "dfs.tum")[1]
    points = [np.zeros((0, 2))]
    for scan, (x, y, heading) in zip(drive.scans, poses, strict=True):
        back = np.isfinite(scan.ranges)
        r, angle = scan.ranges[back], heading + scan.bearings[back]
        points.append(np.stack([x + r * np.cos(angle), y + r * np.sin(angle)], axis=1))
    for picture in (pictures / "drive-dfs-20.svg", tmp_path / "dfs.svg"):
        root = ElementTree.parse(picture).getroot()
        (route,) = [e.attrib["d"] for e in root.iter() if e.attrib.get("class") == "route"]
        drawn = np.array([[float(c) for c in point.split(",")] for point in route.removeprefix("M").split()])
        scale = np.ptp(drawn[:, 0]) / np.ptp(poses[:, 0])
        at = drawn.mean(axis=0) + scale * (np.concatenate(points) - poses[:, :2].mean(axis=0)) * [1, -1]
        inside = (at > [1, 36]).all(axis=1) & (at < [999, float(root.attrib["height"]) - 48]).all(axis=1)
        expected = {(int(x), int(y)) for x, y in np.floor(at[inside])}
        cells = cells_of(root)
        near = {(x + i, y + j) for x, y in cells for i in (-1, 0, 1) for j in (-1, 0, 1)}
        assert len(expected) > 500
        assert expected <= near
        assert len(cells & expected) > 0.8 * len(cells)
    assert "scanned" not in (tmp_path / "map.svg").read_text()


# -- what is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--closures", "3:60"), "--closures is 3:60; expected two of the scans 0 to 59"),
        (("--closures", "3:30", "--from", "12"), "--closures is 3:30; expected two of the scans 12 to 59"),
        (("--closures", "7:7"), "--closures is 7:7; expected two of the scans"),
        (("--closures", "3-60"), "--closures is '3-60'; expected two whole numbers with a colon between them"),
        (("--closures", "1:2:3"), "--closures is '1:2:3'; expected two whole numbers"),
        (("--closures", "3:x"), "--closures is 'x'; expected a whole number"),
        (("--closures", "-3:4"), "--closures is -3; expected a whole number"),
        (("--closures",), "--closures needs at least one value"),
        (("--picture", "/dev/null"), "--picture /dev/null is a file; expected a directory"),
        (("--orthogonal",), "unknown option --orthogonal"),
        (("--inflate-r", "0"), "--inflate-r is 0; expected a number"),
        (("--association", "known"), "--association is known, but nobody knows"),
    ],
)
def test_what_it_refuses(drive: Drive, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], told: str) -> None:
    assert study(drive.log, "--reference", drive.reference, *options) == 2
    assert capsys.readouterr().err.startswith(f"dualslam: {told}")


def test_closures_need_true_poses(drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert study(drive.log, "--closures", "3:51") == 2
    assert "--closures needs true poses, and drive has none; expected --reference FILE" in capsys.readouterr().err
    short = write(tmp_path, "".join(drive.reference.read_text().splitlines(keepends=True)[:5]), "short.reference")
    assert study(drive.log, "--reference", short, "--closures", "3:51") == 2
    assert "--closures is 3:51, but nobody knows the true pose of scan 51; expected" in capsys.readouterr().err


def test_it_is_for_logs_of_a_laser(capsys: pytest.CaptureFixture[str]) -> None:
    assert study("loop") == 2
    assert "study laser-log does not apply to loop: it is for logs of a laser" in capsys.readouterr().err
    assert study() == 2
    assert "study laser-log needs a log of a laser, such as" in capsys.readouterr().err


def test_matching_alone_is_a_row_of_its_own(drive: Drive, tmp_path: Path) -> None:
    options = ("--relations", drive.relations, "--reference", drive.reference, "--particles", 5, "--seeds", 1)
    alone = saved(tmp_path, drive.log, *options, "--matching", "auto")["alone"]
    for error in ("mean_m", "aligned_rms_m"):
        assert alone["matching"][error] < 0.3 * alone["odometry"][error]
