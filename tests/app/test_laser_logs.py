"""`dualslam run` on laser logs: keyframes, relations, references, and a line for every scan."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from app import cli
from slam.estimators import ESTIMATORS
from slam.geometry import compose, invert
from tests.app.drive import STEPS, Drive, tum
from tests.scenarios.laser_logs import NOTHING, flaser, plain_log, readings, write

KEYS = ("dfs", "fs2", "ekf")


def run(*arguments: object) -> int:
    return cli.entry(["run", *map(str, arguments), "--particles", "20", "--filters", *KEYS])


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("dualslam: ")
    assert err.count("\n") == 1
    return err


def test_a_log_is_run_and_judged(drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary = tmp_path / "s.json"
    options = ("--relations", drive.relations, "--reference", drive.reference, "--keyframe", "0.9,30")
    assert run(drive.log, *options, "--summary", summary, "--trajectory", tmp_path) == 0
    found = json.loads(summary.read_text())
    assert found["steps"] < 0.7 * STEPS
    assert found["params"]["options"]["keyframe"] == [0.9, pytest.approx(30)]

    order = np.argsort(drive.stamps, kind="stable")
    for name in (*KEYS, *(f"{key}-online" for key in KEYS), "odometry", "matching"):
        stamps, _ = tum(tmp_path / f"{name}.tum")
        np.testing.assert_allclose(stamps, drive.stamps[order], atol=1e-6)
    stamps, _ = tum(tmp_path / "truth.tum")
    assert len(stamps) == found["steps"]
    _, odometry = tum(tmp_path / "odometry.tum")
    np.testing.assert_allclose(odometry[:, :2], drive.odometry[order, :2], atol=1e-5)

    relations = found["relations"]
    assert relations["relations"] == 4
    assert relations["file"] == str(drive.relations)
    for key in ("odometry", "matching", *KEYS):
        path = np.empty((STEPS, 3))
        path[order] = tum(tmp_path / f"{key}.tum")[1]
        errors = relations[key]
        assert (errors["used"], errors["left_out"]) == (4, 0)
        assert errors["translation_m"]["mean"] == pytest.approx(drive.off(path).mean(), abs=1e-4)
        assert errors["translation_m"]["max"] == pytest.approx(drive.off(path).max(), abs=1e-4)
        assert found["filters"].get(key, {}).get("position_mse", 0.0) < 0.5  # the reference is the truth
    for key, error in (("ekf", "translation_m"), ("dfs", "rotation_rad")):
        assert relations[key][error]["mean"] < 0.5 * relations["odometry"][error]["mean"]
    out = capsys.readouterr().out
    assert found["alone"]["matching"] < 0.5 * found["alone"]["odometry"] < 2.0
    numbers = ", ".join(f"{key} alone {found['alone'][key]:.3g} m" for key in ("odometry", "matching"))
    assert f"without a filter: {numbers}" in out
    matching = found["matching"]
    assert matching["steps"] == found["steps"] > matching["used"] > 0.8 * found["steps"]
    assert f"scan matching: used in {matching['used']} of {found['steps']} steps; not used: first scan (1)" in out
    noise = found["params"]["odometry"]
    assert 0.0 < noise["along"] == found["params"]["believed"]["odometry"]
    assert f"and {math.degrees(noise['turn_per_metre']):.3g}° after one metre" in out
    (line,) = [line for line in out.splitlines() if line.startswith("odometry ")]
    assert f"{relations['odometry']['translation_m']['mean']:.3g} m" in line
    assert f"{math.degrees(relations['odometry']['rotation_rad']['max']):.3g}°" in line
    named = [line for line in out.splitlines() if "Dual FastSLAM" in line and "is worse than" not in line]
    assert len(named) == 2  # in the table of filters, and in that of relations


@pytest.mark.parametrize(
    ("options", "used"), [(("--to", 21), 1), (("--from", 12, "--to", 55), 1), (("--steps", 27), 2), (("--steps", 2), 0)]
)
def test_relations_of_a_part_are_counted(
    drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[object, ...], used: int
) -> None:
    summary = tmp_path / "s.json"
    assert run(drive.log, "--relations", drive.relations, *options, "--summary", summary) == 0
    relations = json.loads(summary.read_text())["relations"]
    for key in ("odometry", *KEYS):
        assert (relations[key]["used"], relations[key]["left_out"]) == (used, 4 - used)
        assert (relations[key]["translation_m"] is None) == (used == 0)
    nothing = "none of the 4 relations is between two scans of the part that was run"
    assert (nothing in capsys.readouterr().out) == (used == 0)


@pytest.mark.parametrize("exact", [True, False])
def test_a_filter_that_is_worse_than_none_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], exact: bool
) -> None:
    drive, summary = Drive(tmp_path, exact=exact), tmp_path / "s.json"
    assert run(drive.log, "--relations", drive.relations, "--matching", "off", "--summary", summary) == 0
    relations = json.loads(summary.read_text())["relations"]
    means = {key: relations[key]["translation_m"]["mean"] for key in ("odometry", *KEYS)}
    out = capsys.readouterr().out
    for key in KEYS:
        sentence = f"{ESTIMATORS[key].title} is worse than odometry alone: {means[key]:.3g} m against"
        assert (sentence in out) == (means[key] > means["odometry"])
    assert (means["dfs"] > means["odometry"]) == exact


@pytest.mark.parametrize(
    ("options", "keyframe", "steps"),
    [
        ((), (0.5, 15), STEPS // 2 + 4),
        (("--keyframe", "0,0"), (0, 0), STEPS),
        (("--keyframe", "1,400"), (1, 400), STEPS // 3 + 1),
    ],
)
def test_keyframes_from_the_command_line(
    drive: Drive, tmp_path: Path, options: tuple[str, ...], keyframe: tuple[float, float], steps: int
) -> None:
    summary = tmp_path / "s.json"
    assert run(drive.log, *options, "--summary", summary) == 0
    found = json.loads(summary.read_text())
    assert found["relations"] is None
    assert found["steps"] == pytest.approx(steps, abs=0 if steps == STEPS else 3)
    assert found["params"]["options"]["keyframe"] == pytest.approx(keyframe)


def test_every_second_scan_is_a_step_and_every_scan_a_line(drive: Drive, tmp_path: Path) -> None:
    assert run(drive.log, "--every", "2", "--trajectory", tmp_path, "--summary", tmp_path / "s.json") == 0
    assert json.loads((tmp_path / "s.json").read_text())["steps"] == STEPS // 2
    assert len(tum(tmp_path / "dfs.tum")[0]) == STEPS - 1  # the last one is beyond the last step


@pytest.mark.parametrize(("matching", "alone"), [("off", "odometry"), ("on", "matching")])
def test_online_paths_do_not_know_what_comes(drive: Drive, tmp_path: Path, matching: str, alone: str) -> None:
    """Between two steps they go on as odometry does, or the matches on the way, and are set right at the next."""
    assert run(drive.log, "--keyframe", "2,360", "--trajectory", tmp_path, "--matching", matching) == 0
    order = np.argsort(drive.stamps, kind="stable")
    moved = {}
    for name in ("dfs", "dfs-online", alone):
        path = np.empty((STEPS, 3))
        path[order] = tum(tmp_path / f"{name}.tum")[1]
        moved[name] = compose(invert(path[:-1]), path[1:])[:, :2]
    as_alone = {n: np.isclose(moved[n], moved[alone], atol=1e-4).all(axis=1) for n in ("dfs", "dfs-online")}
    assert as_alone["dfs-online"].mean() > 0.7
    assert as_alone["dfs"].mean() < 0.5


def test_what_does_not_go_together(drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = write(tmp_path, "5.0 6.0 0 0 0 0 0 0\n", "other.relations")
    assert "none of its 1 relations belong to the log" in refused(capsys, drive.log, "--relations", other)
    assert "no.relations: cannot be read" in refused(capsys, drive.log, "--relations", tmp_path / "no.relations")
    other = write(tmp_path, "0 5.0 0 0 0\n", "other.reference")
    assert "expected a reference of this log" in refused(capsys, drive.log, "--reference", other)
    assert "--relations does not apply to loop" in refused(capsys, "loop", "--relations", drive.relations)
    assert "known, but nobody knows what was seen in drive" in refused(capsys, drive.log, "--association", "known")
    assert "--from 60: expected 0 to 59" in refused(capsys, drive.log, "--from", "60")
    park = tmp_path / "park"
    park.mkdir()
    rows = {"dead_reckoning": "{t:.3f} 1.0 0.01", "trees": "{t:.3f} 5.0 1.5 0.4", "gps": "{t:.3f} 1.0 2.0"}
    for name, row in rows.items():
        write(park, "".join(row.format(t=0.025 * k) + "\n" for k in range(200)), f"{name}.txt")
    for option in (("--keyframe", "1,2"), ("--reference", drive.reference)):
        assert f"{option[0]} does not apply to {park}: it is for logs of a laser" in refused(capsys, park, *option)
    assert "--relations does not apply to victoria-park" in refused(capsys, park, "--relations", drive.relations)


def test_a_robot_at_rest_is_a_short_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write(tmp_path, plain_log(np.ones((3000, 3)), 31))
    assert run(log, "--trajectory", tmp_path) == 0
    assert "2 steps, 1500 s" in capsys.readouterr().out
    assert len(tum(tmp_path / "ekf.tum")[0]) == 3000


@pytest.mark.parametrize("stamped", [True, False])
def test_a_log_without_time_stamps_has_no_seconds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], stamped: bool
) -> None:
    poses = np.outer(np.arange(20), [0.3, 0.0, 0.0])
    lines = [flaser(readings(k), p, p, 0.5 * k if stamped else None) for k, p in enumerate(poses)]
    log, summary = write(tmp_path, "".join(lines)), tmp_path / "s.json"
    assert run(log, "--summary", summary) == 0
    out = capsys.readouterr().out
    assert run(log) == 0
    out = capsys.readouterr().out
    assert ("no time stamps" in out) != stamped
    assert (", 10 s, " in out) == stamped
    assert ("times real time" in out) == stamped
    found = json.loads(summary.read_text())["filters"]["dfs"]
    assert (found["real_time_factor"] is None) != stamped


def test_what_is_odd_in_a_part_is_said_before_it_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A minute without any return, and an end beyond that of the log; and the part is named."""
    poses = np.outer(np.arange(100), [0.3, 0.0, 0.0])
    lines = [
        flaser(np.full(181, NOTHING) if 10 <= k <= 90 else readings(k), p, p, 1000.0 + 0.75 * k)
        for k, p in enumerate(poses)
    ]
    assert run(write(tmp_path, "".join(lines)), "--from", 5, "--to", 200, "--every", 2) == 0
    out, err = capsys.readouterr()
    blind = "nothing came back to the laser for 58 s, in 40 scans from scan 11 on; filters are blind there"
    assert f"warning: some: {blind}" in err
    assert "warning: some: its last scan is 99, and so that of the part, which was to go on to 200" in err
    assert out.splitlines()[0].endswith("; scans 5 to 99 of it, every 2nd")


@pytest.mark.parametrize("stamped", [True, False])
def test_that_no_wall_was_seen_for_long_is_said_at_the_end(
    drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str], stamped: bool
) -> None:
    """Something came back meanwhile, from one beam in ten: too little for a wall."""
    lines = []
    for k, (scan, pose) in enumerate(zip(drive.scans, drive.odometry, strict=True)):
        few = (np.arange(len(scan.ranges)) % 10 == 0) | (k < 10) | (k >= 55)
        ranges = np.where(few & np.isfinite(scan.ranges), scan.ranges, NOTHING)
        lines.append(flaser(ranges, pose, pose, 1000.0 + 1.5 * k if stamped else None))
    assert run(write(tmp_path, "".join(lines)), "--keyframe", "0,0") == 0
    out, err = capsys.readouterr()
    (line,) = [line for line in out.splitlines() if "nothing was seen for" in line]
    assert line.startswith(f"nothing was seen for {'68 s' if stamped else '45 scans'}, in 45 steps from step 11 on")
    assert "nothing came back" not in err


@pytest.mark.parametrize(
    ("short", "options", "origin", "words"),
    [
        (False, (), "scans", "odometry, as its scans show, off by "),
        (False, ("--believed.odometry", "0.5"), "given", "odometry, as given, off by 0.5 m ahead"),
        (True, (), "guess", "odometry, at a guess, since its scans show too little of it, off by "),
    ],
)
def test_where_the_noise_of_odometry_comes_from_is_said(
    drive: Drive,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    short: bool,
    options: tuple[str, ...],
    origin: str,
    words: str,
) -> None:
    log = write(tmp_path, plain_log(np.outer(np.arange(3), [0.3, 0.0, 0.0]))) if short else drive.log
    assert run(log, *options) == 0
    assert words in capsys.readouterr().out
    summary = tmp_path / "s.json"
    assert run(log, *options, "--summary", summary) == 0
    assert json.loads(summary.read_text())["params"]["odometry"]["from"] == origin


def test_a_log_can_be_looked_at_before_it_is_run(drive: Drive, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.entry(["worlds", str(drive.log)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("drive  CARMEN drive.log: 60 scans of 181 beams, ")
    way = np.hypot(*np.diff(drive.odometry[:, :2], axis=0).T).sum()
    (line,) = [line for line in out.splitlines() if "by odometry in" in line]
    assert float(line.split(" m ")[0]) == pytest.approx(way, rel=0.03)
    steps = int(line.removesuffix(" observing steps").split()[-1])
    assert "60 scans, of which keyframes are " in line
    assert steps == pytest.approx(STEPS // 2 + 4, abs=3)
    for part in (
        "dotted the route",
        "laser: 181 beams, 1° apart",
        "sideways and",
        "truth: not known",
        "--matching auto",
    ):
        assert part in out
    assert cli.entry(["worlds", str(drive.log), "--write", "x.toml"]) == 2
    assert "--write does not apply to" in capsys.readouterr().err


def test_the_help_tells_the_defaults_of_logs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.entry(["run", "some.log", "--help"]) == 0
    assert "1.0; 0.03 for logs of a laser" in " ".join(capsys.readouterr().out.split())


def test_of_a_log_without_walls_nothing_is_told_of_duplicates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses = np.outer(np.arange(20), [0.3, 0.0, 0.0])
    assert run(write(tmp_path, plain_log(poses, 5)), "--summary", tmp_path / "s.json") == 0
    out = capsys.readouterr().out
    assert "no wall was seen" in out
    assert "duplicates" not in out
    found = json.loads((tmp_path / "s.json").read_text())["filters"]["dfs"]
    assert found["duplicates"] is None
