"""The panel's top view of a log of which nobody knows the truth: what part of the plane it shows, scans, relations."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser

from app import session
from app.live.engine import Engine, Status
from app.live.judge import Judge
from app.live.trend import Trend
from app.pace import Pace
from app.panel import scene
from app.panel.camera import OUT, Cameras, TopCamera
from app.panel.layers import LEAST
from app.panel.panel import Panel
from app.panel.scene import BEGIN, LAYERS, TopView
from app.recording import ground
from app.recording.ground import Extent, Scanned, Survey, is_charted, returns
from app.relations import relations_of
from app.types import best_path
from scenarios.logs import read_log
from scenarios.logs.keyframes import keyframes
from scenarios.logs.reference import with_reference
from scenarios.registry import build
from scenarios.types import Source
from slam.estimators import ESTIMATORS
from tests.app.drive import Drive
from tests.app.test_panel import Records

PATIENCE = 240.0


@pytest.fixture(scope="module")
def source(drive: Drive) -> Source:
    return keyframes(read_log(drive.log), 0.5, math.radians(15.0))


@pytest.fixture
def engine(source: Source) -> Iterator[Engine]:
    info = session.make_info(source, [ESTIMATORS[key] for key in ("dfs", "fs2")], source.params(particles=10), seed=1)
    engine = Engine(info)
    engine.start()
    yield engine
    engine.close()


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


class Browser:
    """What the server knows of one."""

    def __init__(self, client_id: int, aspect: float = 0.7) -> None:
        self.client_id = client_id
        self.camera: Any = SimpleNamespace(
            position=(3.0, 3.0, 3.0), image_width=700 * aspect, image_height=700, far=1.0, max_orbit_distance=1.0
        )
        self.atomic = nullcontext

    def shows(self, xy: Any) -> bool:
        """Whether it sees all of these places."""
        x, y, height = self.camera.position
        half = height * math.tan(0.5 * self.camera.fov)
        aspect = self.camera.image_width / self.camera.image_height
        off = np.abs(np.asarray(xy)[:, :2] - [x, y])
        return bool((off <= [half * aspect, half]).all())


def browsers(server: viser.ViserServer, monkeypatch: pytest.MonkeyPatch, *clients: Browser) -> None:
    monkeypatch.setattr(server, "get_clients", lambda: {client.client_id: client for client in clients})


def after(engine: Engine, step: int) -> Status:
    engine.step(step - engine.status.step)
    return engine.wait(lambda s: s.step == step, PATIENCE)


def back(engine: Engine, step: int) -> Status:
    engine.go(step)
    return engine.wait(lambda s: s.step == step and not s.message, PATIENCE)


def node(server: viser.ViserServer, name: str) -> Any:
    handle = server.scene.get_handle_by_name(f"/map/{name}")
    assert handle is not None, name
    return handle


def placed(server: viser.ViserServer, points: Any) -> np.ndarray:
    """(n, 2) [m] in the world."""
    parent = server.scene.get_handle_by_name("/map")
    assert parent is not None
    return np.asarray(points)[..., :2] + np.array(parent.position[:2])


def paths(status: Status) -> np.ndarray:
    """(n, 3) where the filters have been."""
    return np.concatenate([best_path(update) for update in status.taken.step.filters.values()])  # type: ignore[union-attr]


def end(source: Source) -> int:
    return len(source.steps)


def test_it_begins_around_the_start_and_follows_the_map(server, engine, source, monkeypatch):
    follower, owner = Browser(0), Browser(1, 1.5)
    browsers(server, monkeypatch, follower, owner)
    top = TopView(server)
    top.show(engine.status)
    first = follower.camera.position
    assert follower.shows([source.start[:2] - BEGIN, source.start[:2] + BEGIN])
    assert not follower.shows([source.start[:2] + 3 * BEGIN])
    centre = tuple(server.scene.get_handle_by_name("/map").position)  # type: ignore[union-attr]

    x, y, height = owner.camera.position
    owner.camera.position = own = (x + 1.0, y, 0.8 * height)
    limits = owner.camera.max_orbit_distance
    for step in range(4, end(source) + 1, 4):
        status = after(engine, step)
        top.show(status)
        assert follower.shows(paths(status)), step
    assert not owner.shows(paths(status))
    assert owner.camera.position == own
    assert owner.camera.max_orbit_distance > limits  # it may look from as far away as the others
    assert follower.camera.position[2] > first[2]
    assert tuple(server.scene.get_handle_by_name("/map").position) == centre  # type: ignore[union-attr]

    grid = placed(server, node(server, "grid").points).reshape(-1, 2)
    assert Extent(grid.min(axis=0), grid.max(axis=0)).holds(paths(status)[:, :2])
    camera = top._camera
    assert camera is not None
    assert node(server, "dfs/dots").position[2] == pytest.approx(camera.lift * (4 * 13 + 3), rel=0.05)
    weighted = status.taken.step.filters["dfs"].trace.weighted  # type: ignore[union-attr]
    top._particle_clicked("dfs", SimpleNamespace(instance_index=9))
    assert top.pick is not None
    dots = placed(server, node(server, "dfs/dots").points.mean(axis=1))
    np.testing.assert_allclose(dots[9], weighted.s[top.pick.particle, :2], atol=1e-4)


def test_what_was_visited_is_shown_to_those_who_ask_and_those_who_come(server, engine, source, monkeypatch):
    owner = Browser(0)
    browsers(server, monkeypatch, owner)
    top = TopView(server)
    top.show(engine.status)
    owner.camera.position = own = (1.0, 2.0, 50.0)
    status = after(engine, end(source))
    top.show(status)
    assert owner.camera.position == own
    late = Browser(1, 2.0)
    top._connected(late)  # type: ignore[arg-type]
    assert late.shows(paths(status))
    home = Browser(2)
    initial = server.initial_camera
    home.camera.position, home.camera.fov = initial.position, initial.fov
    assert home.shows(paths(status))  # Reset View
    assert top._cameras._is_own(home)

    top.fit()
    assert owner.shows(paths(status))
    tight = owner.camera.position
    top.show(status)  # the same step, but a pixel is another length
    pixel = top._camera.pixel(server.get_clients().values())  # type: ignore[union-attr]
    np.testing.assert_allclose(node(server, "fs2/ellipses").batched_scales[:, :2].min(), LEAST * pixel, rtol=1e-6)
    x, y = np.ptp(paths(status)[:, :2], axis=0)
    low, high = top._survey._shown  # type: ignore[union-attr]
    np.testing.assert_array_less(high - low, np.array([x, y]) + 2 * 5.0 + 0.2 * max(x, y))

    visited = paths(status)
    top.show(back(engine, 5))
    assert owner.camera.position == tight
    top.fit()
    assert owner.shows(visited)  # although it stands in the past


def test_a_reset_begins_around_the_start_again(server, engine, source, monkeypatch):
    follower, owner = Browser(0), Browser(1)
    browsers(server, monkeypatch, follower, owner)
    top = TopView(server)
    top.show(engine.status)
    first = follower.camera.position
    top.show(after(engine, end(source)))
    assert follower.camera.position != first
    owner.camera.position = own = (1.0, 2.0, 50.0)
    engine.reset(seed=2)
    top.show(engine.wait(lambda s: s.number == 1, PATIENCE))
    assert follower.camera.position == first
    assert owner.camera.position == own
    assert not node(server, "scans").visible
    engine.reset(source=build("paper-line"))
    top.show(engine.wait(lambda s: s.number == 2, PATIENCE))
    assert owner.camera.position != own  # another world
    assert top._survey is None


def test_logs_whose_way_is_known_stay_as_they_are(server, drive, monkeypatch):
    known = keyframes(with_reference(read_log(drive.log), drive.reference), 0.5, math.radians(15.0))
    assert is_charted(known, 99)
    assert not is_charted(keyframes(read_log(drive.log), 0.5, 1.0), 99)
    count = len(known.steps)
    for unknown in (slice(1, None), slice(0, count // 2), slice(5, 5 + count // 3)):  # of a part only
        steps = list(known.steps)
        steps[unknown] = [step._replace(truth=None) for step in steps[unknown]]
        assert not is_charted(replace(known, steps=tuple(steps)), 99)
    steps = [step if i % 4 == 0 else step._replace(truth=None) for i, step in enumerate(known.steps)]
    assert is_charted(replace(known, steps=tuple(steps)), 99)
    info = session.make_info(known, [ESTIMATORS["dfs"]], known.params(particles=5))
    browser = Browser(0)
    browsers(server, monkeypatch, browser)
    top = TopView(server)
    top.reset(info)
    assert browser.shows(drive.truth)
    top.fit()
    assert browser.shows(drive.truth)


def test_a_camera_is_ours_wherever_it_was_put_and_nowhere_else():
    wide, wider = (TopCamera(Extent(np.zeros(2), np.full(2, size))) for size in (20.0, 50.0))
    cameras, slow = Cameras(), Browser(7)
    cameras.fit(wide, slow)
    old = slow.camera.position
    cameras.follow(wider, slow)
    assert slow.camera.position != old
    slow.camera.position = old  # told late by a slow browser
    cameras.follow(wider, slow)
    assert slow.camera.position == wider.position(0.7)
    x, y, height = slow.camera.position
    for moved in ((x + 1e-3 * height, y, height), (x, y, 0.98 * height), (x, y + 1e-3 * height, height)):
        slow.camera.position = moved
        cameras.follow(wider, slow)
        assert slow.camera.position == moved
        assert slow.camera.max_orbit_distance == OUT * wider.height
    slow.camera.position = (x, y, height + 1e-9)  # rounding
    assert cameras._is_own(slow)
    for nonsense in ((math.nan,) * 3, None, (1.0,), "x"):
        slow.camera.position = nonsense
        cameras.follow(wider, slow)
    slow.camera.position, slow.camera.far = (x, y, 0.5 * height), math.nan
    cameras.follow(wider, slow)
    assert slow.camera.far > 0.0
    cameras.gone(slow)
    slow.camera.position = (x, y, height)
    assert not cameras._is_own(slow)


def test_a_survey_grows_with_room_and_never_shrinks():
    survey = Survey(Extent(np.full(2, -10.0), np.full(2, 10.0)), 0.25)
    assert survey.found() is None
    assert survey.outgrown(np.array([[9.0, 0.0], [math.nan, 99.0]])) is None
    grown = survey.outgrown(np.array([[40.0, 0.0], [0.0, 0.0]]))
    assert grown is not None
    np.testing.assert_allclose(grown.high, [50.0, 10.0])
    assert survey.outgrown(np.array([[49.0, 0.0]])) is None
    found = survey.found()
    assert found is not None
    np.testing.assert_allclose([found.low, found.high], [[-5.0, -5.0], [54.0, 5.0]])
    assert survey.outgrown(np.zeros((0, 3))) is None
    assert survey.outgrown(np.array([[49.9, 9.9]])) is None
    survey.tightened()
    assert survey.outgrown(np.array([[49.9, 20.0]])) is not None


def test_scans_lie_where_the_path_has_them(source, monkeypatch):
    scanned, poses = Scanned(source), np.array([[100.0, -50.0, 2.0], [101.0, -50.0, 2.5], [0.0, 0.0, 0.0]])
    for count in (3, 1, 2):
        cells, size = scanned.along(poses[:count])
        assert size == ground.FINEST
        scans = [step.frame.scan for step in source.steps[:count]]
        ends = np.concatenate([returns(scan, pose) for scan, pose in zip(scans, poses, strict=False) if scan])
        wanted = np.unique(np.floor(ends / size), axis=0)
        np.testing.assert_allclose(np.unique(cells, axis=0), (wanted + 0.5) * size, atol=1e-9)
    monkeypatch.setattr(ground, "MOST_CELLS", 60)
    cells, size = scanned.along(poses)
    assert size > ground.FINEST
    assert 15 < len(cells) <= 60
    assert scanned.along(np.full((2, 3), math.nan))[0].shape == (0, 2)
    assert scanned.along(poses[:0])[0].shape == (0, 2)


def test_scans_are_a_layer_of_logs_that_is_sent_when_it_is_new(server, engine, source, monkeypatch):
    top = TopView(server)
    top.show(engine.status)
    assert not node(server, "scans").visible
    status = after(engine, 12)
    top.show(status)
    dots = node(server, "scans")
    cells, size = Scanned(source).along(best_path(status.taken.step.filters["dfs"]))  # type: ignore[union-attr]
    np.testing.assert_allclose(placed(server, dots.points), cells, atol=1e-4)
    assert dots.point_size == size / 2
    assert dots.position[2] < node(server, "seen").position[2]

    sent, put = dots.points, []
    monkeypatch.setattr(top._ground.scans, "put", lambda *what, own=top._ground.scans.put: put.append(own(*what)))
    top.visible("headings", False)
    top.visible("scans", False)
    assert not dots.visible
    top.visible("scans", True)
    assert dots.visible
    assert dots.points is sent
    playing = after(engine, 14)._replace(playing=True)
    top._pace._next = math.inf
    top.show(playing)
    assert dots.points is sent  # it is not their turn
    assert node(server, "dfs/dots").visible
    top.show(playing._replace(playing=False))
    assert dots.points is not sent
    assert len(put) == 1
    back(engine, 0)
    top.show(engine.status)
    assert not dots.visible
    for world, there in (("paper-line", False), ("loop", False)):
        assert ("scans" in top.layers(session.make_info(build(world), []))) == there
    assert set(top.layers(status.info)) == set(LAYERS) - {"relations"}


def test_what_takes_long_takes_its_share(monkeypatch):
    now = 100.0
    monkeypatch.setattr("app.pace.monotonic", lambda: now)
    pace = Pace(0.05)
    assert pace.due
    with pace.kept():
        now += 1.0
    now += 18.9
    assert not pace.due
    now += 0.2
    assert pace.due
    assert scene.DUTY <= 0.05


def test_relations_are_a_layer_and_a_line(server, engine, source, drive):
    judge = Judge(relations_of(drive.relations, source), source)
    engine.add(judge)
    view: list[TopView] = []

    def made(own: viser.ViserServer) -> TopView:
        view.append(TopView(own, judge=judge))
        return view[0]

    panel = Panel(engine, Trend(), Records(), ["loop"], build, made)  # type: ignore[arg-type]
    try:
        panel._closing.set()  # what is shown from here on, and when, is up to this thread alone
        panel._wake.set()
        panel._thread.join(PATIENCE)
        assert {"scans", "relations"} <= set(panel.layers)
        engine.step(end(source))
        status = engine.wait(lambda s: s.step == end(source), PATIENCE)
        view[0].show(status)
        panel._refresh()
        found = judge.breaks(0, "", status.taken.step)  # type: ignore[union-attr]
        breaks = found["dfs"]
        lines = panel.server.scene.get_handle_by_name("/map/dfs/relations")
        assert lines is not None
        assert lines.visible == bool((breaks.off > 0.1).any())  # type: ignore[attr-defined]
        text = view[0].describe_relations()
        assert f"Dual FastSLAM: {breaks.told()}" in text
        assert text.endswith(
            f"odometry alone: {found['odometry'].told()}\n- relations, matching alone: {found['matching'].told()}"
        )
        assert text in panel.table.content
        assert "NEES" not in panel.table.content  # nobody knows the truth
        assert not panel.plots._error._handle.visible
        view[0].visible("relations", False)
        assert not lines.visible
        engine.reset(source=build("loop"))
        status = engine.wait(lambda s: s.number == 1, PATIENCE)
        panel._refresh()
        assert not {"scans", "relations"} & set(panel.layers)
        assert view[0].describe_relations() == ""
        assert "relations" not in panel.table.content
        assert "| error, m | NEES |" in panel.table.content
        assert panel.plots._error._handle.visible
    finally:
        panel.close()
