"""A recording of a laser log: what all scans met, scan matching, the ground of it, and what nobody knows."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rerun.blueprint as rrb

from app import session
from app.recording import Recorder, ground
from app.recording.ground import Extent, Scanned, Survey, estimates, extent_of
from app.recording.reading import Recording, open_reader
from app.recording.stream import FileStream
from app.recording.writer import Writer
from app.scans import returns
from app.sources import LogParts, load
from app.types import SessionInfo, SessionStep, best_path
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.types import Floats, Scan
from tests.app.drive import Drive
from tests.app.test_recording import Watch
from tests.app.test_recording_walls import recorded_strictly

KEYS, K = ("fs2", "dfs"), 10


def info_of(drive: Drive, reference: bool = False, **changes: Any) -> SessionInfo:
    source = load(str(drive.log), {}, LogParts(reference=drive.reference if reference else None))
    filters = [ESTIMATORS[key] for key in KEYS]
    return session.make_info(source, filters, source.params(particles=K, **changes), seed=1)


@pytest.fixture(scope="module")
def info(drive: Drive) -> SessionInfo:
    return info_of(drive)


@pytest.fixture(scope="module")
def recorded(info: SessionInfo, tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, list[SessionStep]]:
    return recorded_strictly(info, tmp_path_factory.mktemp("log") / "run.rrd")


class Kept(FileStream):
    """A file of which the layouts are kept, too, as they were shown."""

    def __init__(self, path: Path, blueprint: rrb.Blueprint, name: str) -> None:
        self.layouts = [blueprint]
        super().__init__(path, blueprint, name)

    def show(self, blueprint: rrb.Blueprint) -> None:
        self.layouts.append(blueprint)
        super().show(blueprint)


def views(part: Any) -> Iterator[Any]:
    """The map views and close-ups of a layout."""
    if isinstance(part, rrb.Spatial3DView):
        yield part
    elif isinstance(part, rrb.Container):
        for one in part.contents:
            yield from views(one)


def looks_at(layout: rrb.Blueprint, origin: str = "/world") -> tuple[Floats, float]:
    """Where the first map of a run looks, (2,) [m], and how far from there the eye is [m]."""
    first = next(view for view in views(layout.root_container) if view.origin == origin)
    eye: Any = first.properties["EyeControls3D"]
    ((x, y, _),), ((_, _, height),) = (v.as_arrow_array().to_pylist() for v in (eye.look_target, eye.position))
    return np.array([x, y]), height


def lines(recording: Recording, entity: str) -> dict[int, list[Floats]]:
    """Its lines, (n, 2) each, by step."""
    rows = recording.rows(entity, "LineStrips3D:strips", "step")
    return {step: [np.array(line)[:, :2] for line in row] for step, row in rows}


def moved(step: SessionStep, away: float) -> SessionStep:
    """A step after which all filters believe to be so far away [m] from where they are."""
    filters = {
        key: u._replace(measures=u.measures._replace(estimate=u.measures.estimate + np.array([away, 0.0, 0.0])))
        for key, u in step.filters.items()
    }
    return dataclasses.replace(step, filters=filters)


# What is there --------------------------------------------------------------------------------------------------------


def ends(scan: Scan, s: Floats) -> Floats:
    """(m, 2) where the beams that came back ended."""
    found = []
    for r, bearing in zip(scan.ranges, scan.bearings, strict=True):
        if math.isfinite(r):
            angle = s[2] + bearing
            found.append((s[0] + r * math.cos(angle), s[1] + r * math.sin(angle)))
    return np.array(found)


@pytest.mark.parametrize("at", [5, 14])
def test_all_scans_lie_along_the_path_of_the_first_filter(
    recorded: tuple[Recording, list[SessionStep]], info: SessionInfo, at: int
) -> None:
    """As it is known at that moment, one point for each square in which a beam ended."""
    recording, steps = recorded
    step = steps[at]
    drawn = np.array(dict(recording.rows("/world/scans", "Points3D:positions", "step"))[step.index])[:, :2]
    path = best_path(step.filters[KEYS[0]])
    _, cell = Scanned(info.source).along(path)
    scans = [s.frame.scan for s in steps[: step.index] if s.frame.scan is not None]
    seen = np.concatenate([ends(scan, pose) for scan, pose in zip(scans, path, strict=True)])
    away = np.abs(seen[:, None] - drawn).max(axis=2)
    assert away.min(axis=0).max() <= 0.5 * cell + 1e-5
    assert away.min(axis=1).max() <= 0.5 * cell + 1e-5
    between = np.abs(drawn[:, None] - drawn).max(axis=2) + np.eye(len(drawn))
    assert between.min() > 0.99 * cell


def test_they_lie_along_the_next_one_where_the_first_is_off(
    recorded: tuple[Recording, list[SessionStep]], info: SessionInfo, tmp_path: Path
) -> None:
    _, steps = recorded
    writer = Writer(info, lambda *how: FileStream(tmp_path / "off.rrd", *how))
    writer.step(steps[0])
    for step in steps[1:4]:
        writer.step(dataclasses.replace(step, filters={KEYS[1]: step.filters[KEYS[1]]}))
    writer.close()
    drawn = dict(Recording(tmp_path / "off.rrd").rows("/world/scans", "Points3D:positions", "step"))
    assert sorted(drawn) == [1, 2, 3, 4]


def test_a_branch_is_framed_by_its_run_and_reads_no_scan_again(
    recorded: tuple[Recording, list[SessionStep]], info: SessionInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    placed: list[Scan] = []
    monkeypatch.setattr(ground, "returns", lambda scan, pose: placed.append(scan) or returns(scan, pose))
    stream = Kept(tmp_path / "branch.rrd", rrb.Blueprint(), "branch")
    writer, (_, steps) = Writer(info, lambda *_: stream), recorded
    for step, away in zip(steps[:3], (0.0, 100.0, 0.0), strict=True):
        writer.step(moved(step, away))
    writer.fork(info, "other").step(moved(steps[3], 200.0))
    assert len(placed) == 4
    writer.close()
    home = steps[0].filters["dfs"].measures.estimate
    for origin, far in (("/world", 100.0), ("/branch/other/world", 200.0)):
        assert looks_at(stream.layouts[-1], origin)[0][0] == pytest.approx(home[0] + 0.5 * far, abs=2.0)


def test_only_logs_have_all_their_scans(tmp_path: Path) -> None:
    for world in ("paper-line", "hospital"):
        source = build(world)
        info = session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=5), count=2)
        session.run(info, [Recorder(tmp_path / f"{world}.rrd")])
        recording = Recording(tmp_path / f"{world}.rrd")
        assert recording.timelines("/world/scan")
        for entity in ("/world/scans", "/world/matching/path"):
            assert not recording.timelines(entity)


def test_paths_of_odometry_and_of_matching_alone(
    recorded: tuple[Recording, list[SessionStep]], info: SessionInfo
) -> None:
    recording, steps = recorded
    odometry, matching = (lines(recording, f"/world/{name}/path") for name in ("odometry", "matching"))
    assert sorted(odometry) == list(range(1, info.steps + 1))
    assert sorted(matching) == list(range(2, info.steps + 1))  # one pose is no line
    dead_reckoning, matched = np.array([s.odometry[:2] for s in steps]), np.array([s.matched for s in steps])[:, :2]
    np.testing.assert_allclose(odometry[12][0], [info.source.start[:2], *dead_reckoning[:12]], atol=1e-5)
    np.testing.assert_allclose(matching[12][0], matched[:12], atol=1e-5)
    np.testing.assert_allclose(matching[info.steps][0], matched, atol=1e-5)
    assert np.hypot(*(matched - dead_reckoning).T).max() > 0.05


def test_without_matching_there_is_no_path_of_it(drive: Drive, tmp_path: Path) -> None:
    info = info_of(drive, matching="off")._replace(steps=3)
    session.run(info, [Recorder(tmp_path / "off.rrd")])
    assert not Recording(tmp_path / "off.rrd").timelines("/world/matching/path")


def test_it_is_told_where_matching_is_not_used(info: SessionInfo, tmp_path: Path) -> None:
    blind = list(info.source.steps)
    frame = blind[4].frame
    assert frame.scan is not None
    nothing = frame.scan._replace(ranges=np.full_like(frame.scan.ranges, np.inf))
    blind[4] = blind[4]._replace(frame=frame._replace(scan=nothing))
    source = dataclasses.replace(info.source, steps=tuple(blind))
    session.run(info._replace(source=source, steps=7), [Recorder(tmp_path / "blind.rrd")])
    told = [event for event in Recording(tmp_path / "blind.rrd").events() if "Scan matching" in event.text]
    assert told == [(5, "INFO", "5: Scan matching is not used: too few points")]


def test_a_reference_is_the_truth(drive: Drive, tmp_path: Path) -> None:
    """And then there are scans in close-ups, which nobody could place without it."""
    shown: dict[bool, list[Any]] = {}
    for reference in (False, True):
        info, watch, streams = info_of(drive, reference)._replace(steps=6), Watch(), []
        path = tmp_path / f"{reference}.rrd"

        def opened(layout: rrb.Blueprint, name: str, path: Path = path, streams: list[Kept] = streams) -> Kept:
            streams.append(Kept(path, layout, name))
            return streams[0]

        writer = Writer(info, opened)
        session.run(info, [watch])
        for step in watch.steps:
            writer.step(step)
        writer.close()
        truth = lines(Recording(path), "/world/truth/path")
        if reference:
            np.testing.assert_allclose(truth[6][0], np.array([step.truth for step in watch.steps])[:, :2], atol=1e-5)
        else:
            assert not truth
        assert (len(streams[0].layouts) == 1) == reference  # where the robot is to be is known before
        shown[reference] = [
            (view.origin, {entity for entity in view.contents if entity in ("+ /world/scan", "+ /world/scans")})
            for view in views(streams[0].layouts[-1].root_container)
        ]
    for origin, scans in shown[False]:
        assert len(scans) == (2 if origin == "/world" else 0)
    assert {len(scans) for _, scans in shown[True]} == {2}
    assert {origin for origin, _ in shown[True]} > {"/world", "/world/dfs/focus", "/world/dfs/best"}


# The ground -----------------------------------------------------------------------------------------------------------


def stood(*places: tuple[float, float]) -> Floats:
    """(n, 3) what is told of a step after which filters believe to be there."""
    updates = [SimpleNamespace(measures=SimpleNamespace(estimate=np.array([*place, 0.0]))) for place in places]
    return estimates(SimpleNamespace(filters=dict(enumerate(updates))))  # type: ignore[arg-type]


def test_what_is_shown_grows_with_where_filters_have_been() -> None:
    survey = Survey(Extent(np.zeros(2), np.full(2, 10.0)))
    assert survey.found() is None
    assert survey.outgrown(stood()) is None
    assert survey.outgrown(stood((math.nan, 50.0))) is None
    assert survey.found() is None
    assert survey.outgrown(stood((0.0, 0.0), (10.0, 5.0))) is None
    grown = survey.outgrown(stood((2.0, 3.0), (30.0, 5.0)))
    assert grown is not None
    np.testing.assert_allclose(grown, [[-15.0, -15.0], [45.0, 20.0]])  # half of 30 m on every side
    assert survey.outgrown(stood((44.0, -14.0))) is None
    assert survey.outgrown(stood((46.0, 0.0), (math.nan, 0.0))) is not None
    found = survey.found()
    assert found is not None
    np.testing.assert_allclose(found, [[-5.0, -19.0], [51.0, 10.0]])  # 5 m, of what is smaller than 60 m
    survey.outgrown(stood((146.0, 0.0)))
    found = survey.found()
    assert found is not None
    np.testing.assert_allclose(found.high, [146.0 + 0.08 * 146.0, 5.0 + 0.08 * 146.0])


def test_windows_show_where_the_robot_has_been(
    recorded: tuple[Recording, list[SessionStep]], info: SessionInfo, tmp_path: Path
) -> None:
    """A filter finds that the robot has gone far from dead reckoning, and at last comes back."""
    streams: list[Kept] = []

    def opened(layout: rrb.Blueprint, name: str) -> Kept:
        streams.append(Kept(tmp_path / "far.rrd", layout, name))
        return streams[0]

    _, steps = recorded
    writer = Writer(info, opened)
    layouts = streams[0].layouts
    for step, away in zip(steps[:4], (0.0, 100.0, 120.0, 0.0), strict=True):
        writer.step(moved(step, away))
    writer.close()
    begin, far, end = (looks_at(layout) for layout in layouts)  # 120 m are within the room to go on
    extent = extent_of(info.source, info.steps)
    np.testing.assert_allclose(begin[0], extent.centre, atol=1e-3)
    home = steps[0].filters["dfs"].measures.estimate
    assert far[0][0] == pytest.approx(home[0] + 50.0, abs=2.0)
    assert end[0][0] == pytest.approx(home[0] + 60.0, abs=2.0)
    assert begin[1] < end[1] < far[1]
    stored = open_reader(tmp_path / "far.rrd")
    heights = [
        round(row[0][2], 1)
        for blueprint in stored.blueprints()
        for chunk in stored.store(store=blueprint).stream().to_chunks()
        if "EyeControls3D:position" in chunk.to_record_batch().schema.names
        for row in chunk.to_record_batch().column("EyeControls3D:position").to_pylist()
        if row
    ]
    assert {round(height, 1) for _, height in (begin, far, end)} <= set(heights)


def test_a_file_that_fell_behind_shows_the_last_step_when_it_is_closed(info: SessionInfo, tmp_path: Path) -> None:
    """With all pictures: of its last steps it had numbers only."""
    writer, step = Writer(info, lambda *how: FileStream(tmp_path / "run.rrd", *how)), None
    for step in session.steps(info):
        writer.step(step, "usual" if step.index < 5 else "present" if step.index < 9 else "numbers")
    writer.close()
    assert step is not None
    found = Recording(tmp_path / "run.rrd")
    for entity, component in (("path", "LineStrips3D:strips"), ("lineages", "LineStrips3D:strips")):
        assert max(dict(found.rows(f"/world/dfs/{entity}", component, "step"))) == step.index
    assert max(dict(found.rows("/world/scans", "Points3D:positions", "step"))) == step.index
