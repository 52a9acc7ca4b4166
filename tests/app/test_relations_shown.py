"""Where paths break relations: as lines and in words, in recordings and at any step of any branch of a live session."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun.blueprint as rrb

from app import cli, session
from app.live.engine import Engine
from app.live.judge import Judge
from app.live.publisher import Publisher
from app.recording import Recorder
from app.recording.blueprint import layout
from app.recording.ground import extent_of
from app.recording.reading import Recording
from app.recording.session import SessionWriter
from app.recording.stream import FileStream
from app.relations import LEAST, MOST, Breaks, PathErrors, relations_of
from app.types import SessionInfo, SessionStep, best_path
from scenarios.logs import part, read_log
from scenarios.logs.keyframes import keyframes
from scenarios.registry import build
from scenarios.types import Source
from slam.estimators import ESTIMATORS
from slam.geometry import compose
from tests.app.drive import STEPS, Drive
from tests.app.live import at, change
from tests.scenarios.laser_logs import write

PATIENCE = 60.0


@pytest.fixture(scope="module")
def source(drive: Drive) -> Source:
    return keyframes(read_log(drive.log), 0.0, 0.0)


def info_of(source: Source, *keys: str, **params: object) -> SessionInfo:
    return session.make_info(source, [ESTIMATORS[key] for key in keys], source.params(particles=10, **params), seed=2)


def judged(drive: Drive, info: SessionInfo, steps: int) -> tuple[PathErrors, SessionStep]:
    errors = PathErrors(relations_of(drive.relations, info.source))
    session.run(info._replace(steps=steps), [errors])
    assert errors._paths.last is not None
    return errors, errors._paths.last


def strips(recording: Recording, entity: str) -> dict[int, np.ndarray]:
    rows = recording.rows(entity, "LineStrips3D:strips", "step")
    return {time: np.array(row, float).reshape(-1, 2, 3)[..., :2] for time, row in rows}


def test_lines_lead_from_the_path_to_where_the_relation_has_the_robot(drive: Drive, source: Source) -> None:
    errors, last = judged(drive, info_of(source, "fs1", matching="off"), STEPS)
    found = errors.breaks(last)
    path = best_path(last.filters["fs1"])
    assert set(found) == {"odometry", "fs1"}
    for key, poses in (("fs1", path), ("odometry", drive.odometry)):
        breaks = found[key]
        np.testing.assert_allclose(breaks.off, drive.off(poses), atol=1e-5)
        np.testing.assert_array_equal(breaks.scans, drive.pairs)
        for (one, other), (here, there) in zip(drive.pairs, breaks.segments, strict=True):
            np.testing.assert_allclose(here, poses[other, :2], atol=1e-5)
            seen = compose(poses[one], compose(invert_of(drive.truth[one]), drive.truth[other]))
            np.testing.assert_allclose(there, seen[:2], atol=1e-5)
        told = errors.found()[key].translation_m
        assert told is not None
        assert breaks.off.mean() == pytest.approx(told.mean)


def invert_of(pose: np.ndarray) -> np.ndarray:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([-c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2]])


def test_what_is_drawn_is_long_and_not_too_much() -> None:
    off = np.concatenate([[LEAST, 0.5 * LEAST], np.linspace(1.0, 2.0, MOST + 5)])
    ends = np.stack([np.zeros((len(off), 2)), np.stack([off, 0 * off], axis=1)], axis=1)
    breaks = Breaks(ends, off, np.zeros((len(off), 2), np.int64))
    drawn = np.sort(breaks.shown()[:, 1, 0])
    np.testing.assert_allclose(drawn, np.sort(off)[-MOST:])
    few = Breaks(ends[:3], off[:3], np.array([[1, 2], [3, 4], [311, 6600]]))
    np.testing.assert_allclose(few.shown()[:, 1, 0], [1.0])
    assert few.told() == "mean 0.383 m, 95 % 0.91 m, worst 1 m between scans 311 and 6600, of 3 so far"
    assert Breaks(ends[:0], off[:0], few.scans[:0]).told() == "none of them so far"


@pytest.mark.parametrize("keyframe", [0.0, 3.0])
def test_scans_have_the_numbers_of_the_whole_log(drive: Drive, keyframe: float) -> None:
    log = keyframes(part(read_log(drive.log), 12, 55), keyframe, 2.0 * math.pi * (keyframe > 0))
    errors, last = judged(drive, info_of(log), len(log.steps))
    np.testing.assert_array_equal(errors.breaks(last)["odometry"].scans, [[35, 50]])


def test_relations_so_far_are_those_of_which_both_scans_were_seen(drive: Drive, source: Source) -> None:
    errors, last = judged(drive, info_of(source, "dfs"), STEPS)
    halfway, step = judged(drive, info_of(source, "dfs"), 31)
    for key, breaks in halfway.breaks(step).items():
        np.testing.assert_array_equal(breaks.scans, [(0, 30), (10, 19)])
        earlier = errors.breaks(step)[key]
        np.testing.assert_allclose(earlier.off, breaks.off)
    assert halfway.breaks(last) == {}  # that was not seen


def test_a_recording_has_lines_and_a_page(drive: Drive, source: Source, tmp_path: Path) -> None:
    errors, info = PathErrors(relations_of(drive.relations, source)), info_of(source, "fs1", "ekf", matching="off")
    session.run(info, [errors, Recorder(tmp_path / "run.rrd", errors.breaks)])
    recording = Recording(tmp_path / "run.rrd")
    last = errors._paths.last
    assert last is not None
    for key in ("fs1", "ekf"):
        lines, breaks = strips(recording, f"/world/{key}/relations"), errors.breaks(last)[key]
        assert max(lines) == STEPS
        assert len(lines) > 10
        np.testing.assert_allclose(lines[STEPS], breaks.shown(), atol=1e-4)
    pages = dict(recording.rows("/relations", "TextDocument:text", "step"))
    (page,) = pages[STEPS]
    worst = breaks.scans[np.argmax(breaks.off)]
    assert f"| EKF-SLAM | {breaks.off.mean():.3g} |" in page
    assert f"| {worst[0]} and {worst[1]} | 4 |" in page
    assert "| odometry |" in page
    assert "none has both scans" in pages[2][0]


def views(part: Any) -> list[Any]:
    inner = getattr(part, "contents", None)
    return [part] if not isinstance(part, rrb.Container) else [view for one in inner for view in views(one)]


@pytest.mark.parametrize("judged", [False, True])
def test_the_window_has_the_page_and_lines_on_maps_alone(source: Source, judged: bool) -> None:
    known = frozenset({"relations"} if judged else ())
    window = layout([ESTIMATORS["dfs"]], extent_of(source, 9), known, "")
    shown = views(window.root_container)
    assert [view.name for view in shown].count("Relations") == judged
    spatial = [view for view in shown if isinstance(view, rrb.Spatial3DView)]
    assert len(spatial) == 5
    for view in spatial:
        assert ("- /world/dfs/relations" in view.contents) == (view.origin != "/world")


def test_without_relations_there_is_nothing_of_them(source: Source, tmp_path: Path) -> None:
    session.run(info_of(source, "ekf")._replace(steps=3), [Recorder(tmp_path / "run.rrd")])
    assert not [entity for entity in Recording(tmp_path / "run.rrd").entities if "relations" in entity]


def test_a_run_that_ends_early_is_judged_at_its_end(drive: Drive, source: Source, tmp_path: Path) -> None:
    """Although it was not the turn of its last step."""
    long = keyframes(read_log(drive.log), 0.0, 0.0)
    info = info_of(long, "ekf")._replace(steps=1000)  # of which lines are drawn every ninth step
    errors = PathErrors(relations_of(drive.relations, long))
    recorder = Recorder(tmp_path / "run.rrd", errors.breaks)
    for observer in (errors, recorder):
        observer.begin(info)
    for step in session.steps(info._replace(steps=32)):
        errors.step(step)
        recorder.step(step)
    recorder.end()
    pages = dict(Recording(tmp_path / "run.rrd").rows("/relations", "TextDocument:text", "step"))
    assert sorted(pages) == [1, 10, 19, 28, 32]
    assert "| 2 |" in pages[32][0]


def test_a_live_session_is_judged_at_any_step_of_any_branch(drive: Drive, source: Source, tmp_path: Path) -> None:
    info = info_of(source, "dfs")
    judge = Judge(relations_of(drive.relations, source), source)
    file = Publisher(
        SessionWriter(lambda *how: FileStream(tmp_path / "live.rrd", *how, index=False), judge=judge), "wait", 256
    )
    engine = Engine(info, [judge, file])
    engine.start()
    try:
        engine.step(STEPS)
        whole = at(engine, STEPS)
        engine.go(20)
        status = at(engine, 20)
        change(engine, inflate_r=4.0)
        engine.fork("other")
        engine.step(15)
        other = engine.wait(lambda s: s.branch == "other" and s.step == 35, PATIENCE)
        assert status.taken is not None
        assert whole.taken is not None
        assert other.taken is not None
        _, first = judged(drive, info, 20)
        errors, last = judged(drive, info, STEPS)
        for branch, taken, wanted in (
            ("", status.taken, first),
            ("", whole.taken, last),
            ("other", status.taken, first),
        ):
            breaks = judge.breaks(0, branch, taken.step)
            assert set(breaks) == {"odometry", "matching", "dfs"}
            for key, found in errors.breaks(wanted).items():
                np.testing.assert_allclose(breaks[key].off, found.off)
        own = judge.breaks(0, "other", other.taken.step)
        np.testing.assert_array_equal(own["dfs"].scans, [(0, 30), (10, 19)])
        assert judge.breaks(0, "other", whole.taken.step) == {}
        assert judge.breaks(0, "none", whole.taken.step) == {}
        engine.reset(seed=5)
        engine.wait(lambda s: s.number == 1, PATIENCE)
        assert judge.breaks(0, "", whole.taken.step)  # a file may still be at it
        assert judge.breaks(1, "", whole.taken.step) == {}
    finally:
        engine.close(PATIENCE)
        file.join(PATIENCE)
    recording = Recording(tmp_path / "live.rrd")
    assert STEPS in dict(recording.rows("/relations", "TextDocument:text", "step"))
    pages = dict(recording.rows("/branch/other/relations", "TextDocument:text", "step"))
    assert f"| {own['dfs'].off.mean():.3g} |" in pages[35][0]


def test_in_another_world_nobody_is_judged(drive: Drive, source: Source) -> None:
    judge = Judge(relations_of(drive.relations, source), source)
    engine = Engine(info_of(source, "dfs"), [judge])
    engine.start()
    try:
        engine.reset(source=build("paper-line"))
        status = engine.wait(lambda s: s.number == 1, PATIENCE)
        assert not judge.knows(status.info)
        engine.step(3)
        assert judge.breaks(1, "", at(engine, 3).taken.step) == {}  # type: ignore[union-attr]
    finally:
        engine.close(PATIENCE)


def test_live_complains_of_files_as_run_does(drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = write(tmp_path, "5.0 6.0 0 0 0 0 0 0\n", "other.relations")
    for arguments in (("loop", drive.relations), (drive.log, other), (drive.log, tmp_path / "none")):
        said = []
        for command in ("live", "run"):
            assert cli.entry([command, *map(str, (arguments[0], "--relations", arguments[1]))]) == 2
            said.append(capsys.readouterr().err)
        assert said[0] == said[1]
        assert said[0].startswith("dualslam: ")
        assert said[0].count("\n") == 1


def test_a_summary_and_a_recording_agree(drive: Drive, tmp_path: Path) -> None:
    record, summary = tmp_path / "a.rrd", tmp_path / "a.json"
    options = ["--filters", "dfs", "--particles", "10", "--steps", "20"]
    outputs = ["--record", str(record), "--summary", str(summary)]
    assert cli.entry(["run", str(drive.log), "--relations", str(drive.relations), *options, *outputs]) == 0
    mean = json.loads(summary.read_text())["relations"]["dfs"]["translation_m"]["mean"]
    page = dict(Recording(record).rows("/relations", "TextDocument:text", "step"))[20][0]
    assert f"| Dual FastSLAM | {mean:.3g} |" in page


def test_compare_tells_what_recordings_say_of_relations(
    drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(tmp_path / "with.rrd"), str(tmp_path / "without.rrd")]
    command = ["run", str(drive.log), "--particles", "5", "--filters", "dfs", "--record"]
    assert cli.entry([*command, paths[0], "--relations", str(drive.relations)]) == 0
    assert cli.entry([*command, paths[1]]) == 0
    capsys.readouterr()
    assert cli.entry(["compare", *paths]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "mean error of relations" in line]
    _, pages = zip(*Recording(paths[0]).rows("/relations", "TextDocument:text", "step"), strict=True)
    found = dict(re.findall(r"^\| ([^|]+?) \| (\S+) \|", pages[-1][0], re.MULTILINE))
    assert line.startswith("with, mean error of relations after step ")
    for title in ("odometry", "matching", "Dual FastSLAM"):
        assert f"{title} {found[title]} m" in line
