"""The panel's top view, through the handles of viser's nodes; no browser."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser

from app import colours, session
from app.live.engine import Engine, Status
from app.panel import tone
from app.panel.camera import CLOSEST, OUT, TopCamera
from app.panel.layers import LEAST, nice
from app.panel.nodes import Ellipses, Strokes
from app.panel.picking import HINT, Lost, Pick, ancestry, followed, shared_steps, where
from app.panel.scene import TopView
from app.panel.shapes import ellipses, line, outline
from app.panel.trails import OdometryTrail
from app.recording.ground import Extent
from scenarios.registry import build
from slam.estimators import ESTIMATORS

PATIENCE = 240.0


def engine_of(world: str, filters: tuple[str, ...], particles: int = 20) -> Engine:
    source = build(world)
    params = dataclasses.replace(source.params(), particles=particles)
    return Engine(session.make_info(source, [ESTIMATORS[key] for key in filters], params=params, seed=1))


def after(engine: Engine, step: int) -> Status:
    engine.step(step - engine.status.step)
    return engine.wait(lambda s: s.step == step, PATIENCE)


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def points() -> Iterator[Engine]:
    engine = engine_of("paper-line", ("dfs", "fs2", "fs1"))
    engine.start()
    yield engine
    engine.close()


@pytest.fixture
def walls() -> Iterator[Engine]:
    engine = engine_of("loop", ("dfs", "fs2"))
    engine.start()
    yield engine
    engine.close()


def node(server: viser.ViserServer, name: str) -> Any:
    handle = server.scene.get_handle_by_name(f"/map/{name}")
    assert handle is not None, name
    return handle


def nodes(server: viser.ViserServer) -> set[str]:
    return set(server.scene._handle_from_node_name)


def messages(server: viser.ViserServer) -> int:
    """That a browser would be sent which comes now."""
    return len(server._websock_server._broadcast_buffer.message_from_id)


def click(top: TopView, key: str, instance: Any) -> None:
    top._particle_clicked(key, SimpleNamespace(instance_index=instance))


def ground(top: TopView) -> None:
    top._ground_clicked(object())


def test_points_are_drawn_where_they_are(server, points):
    top = TopView(server)
    status = after(points, 12)
    top.show(status)
    step = status.taken.step  # type: ignore[union-attr]
    centre = server.scene.get_handle_by_name("/map").position[:2]  # type: ignore[union-attr]
    for key, update in step.filters.items():
        weighted = update.trace.weighted
        ellipses, dots, best_map = (node(server, f"{key}/{name}") for name in ("ellipses", "dots", "map"))
        assert ellipses.visible
        assert len(ellipses.batched_positions) == len(ellipses.batched_colors) == len(dots.points) == 20
        order = np.argsort(weighted.log_w, kind="stable")
        np.testing.assert_allclose(ellipses.batched_positions[:, :2] + centre, weighted.s[order, :2], atol=1e-4)
        assert np.all(np.diff(ellipses.batched_positions[:, 2]) > 0)  # the heavier ones lie on top
        np.testing.assert_allclose(dots.points.mean(axis=1)[:, :2] + centre, weighted.s[order, :2], atol=1e-4)
        theta = weighted.maps.features(int(update.measures.best))[0]
        np.testing.assert_allclose(best_map.points.mean(axis=1)[:, :2] + centre, theta, atol=1e-3)
        np.testing.assert_array_equal(best_map.colors[0, 0], tone.each(np.array([colours.of_filter(key)]))[0])
    robot = node(server, "truth/robot").points.mean(axis=1)[0, :2] + centre
    np.testing.assert_allclose(robot, step.truth[:2], atol=1e-4)  # type: ignore[index]
    assert len(node(server, "truth/map").points) == 5
    assert len(node(server, "truth/path").points) == 11
    assert len(node(server, "seen").points) == len(step.frame.z)
    assert not node(server, "ekf/ellipses").visible
    assert not node(server, "dfs/map_ellipses").visible  # its map is sampled
    assert node(server, "fs1/map_ellipses").visible


def test_ellipses_are_two_sigma_and_never_too_small(server, points):
    top = TopView(server)
    status = after(points, 8)
    top.show(status)
    pixel = top._view(top._camera).pixel  # type: ignore[arg-type]
    weighted = status.taken.step.filters["fs1"].trace.weighted  # type: ignore[union-attr]
    assert np.all(weighted.P == 0.0)
    np.testing.assert_allclose(node(server, "fs1/ellipses").batched_scales[:, :2], LEAST * pixel, rtol=1e-6)
    P = np.array([[4.0, 0.0], [0.0, 1.0]])
    discs = ellipses(np.array([[1.0, 2.0, 0.3]]), P[None], 0.1)
    np.testing.assert_allclose(discs.sizes[0], [4.0, 2.0, 1.0])
    assert np.abs(outline(np.array([1.0, 2.0]), P, 0.1)[:, 0] - [1.0, 2.0]).max() == pytest.approx(4.0)


def test_walls_are_drawn_as_segments(server, walls):
    top = TopView(server)
    status = after(walls, 10)
    top.show(status)
    update = status.taken.step.filters["dfs"]  # type: ignore[union-attr]
    features = update.trace.weighted.maps.features(int(update.measures.best))[0]
    assert node(server, "dfs/map").points.shape == (len(features), 2, 3)
    lengths = np.linalg.norm(np.diff(node(server, "dfs/map").points, axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, features[:, 4] - features[:, 3], atol=1e-3)
    assert len(node(server, "truth/map").points) == len(status.info.source.true_map.theta)  # type: ignore[union-attr]
    assert node(server, "seen").visible
    assert not node(server, "dfs/map_ellipses").visible
    click(top, "dfs", 3)
    top.show(status)
    assert node(server, "pick/map").visible
    assert "features in its map" in top.describe_pick(status)


def test_nodes_never_become_more(server, points):
    top = TopView(server)
    top.show(points.status)
    before = nodes(server)
    for step in range(1, 41):
        if step == 10:
            points.put({"particles": 35})
        if step == 20:
            points.put({"filters": ["dfs"]})
        if step == 30:
            points.put({"filters": ["dfs", "fs1", "ekf"], "particles": 7})
        top.show(after(points, step))
        click(top, "dfs", step % 7)
    top.show(points.status)
    known = messages(server)
    for step in [*range(40, 0, -1)] * 4:
        points.go(step)
        top.show(points.wait(lambda s, step=step: s.step == step, PATIENCE))
        click(top, "dfs", step % 5)
    assert nodes(server) == before
    assert messages(server) <= known + 20


def test_what_has_not_changed_costs_nothing(server, points, monkeypatch):
    top = TopView(server)
    status = after(points, 3)
    top.show(status)
    monkeypatch.setattr(top, "_draw_step", lambda *_: pytest.fail("drawn again"))
    monkeypatch.setattr(top._picked, "draw", lambda *_: pytest.fail("drawn again"))
    top.show(status)
    top.show(status._replace(changed=status.changed + 1, message="?"))


def test_other_filters_and_other_numbers_of_particles(server, points):
    top = TopView(server)
    after(points, 3)
    top.show(points.status)
    click(top, "fs1", 2)
    points.put({"filters": ["dfs", "ekf"], "particles": 11})
    status = after(points, 4)
    top.show(status)
    assert not node(server, "fs1/ellipses").visible
    assert not node(server, "fs1/path").visible
    assert len(node(server, "ekf/ellipses").batched_positions) == 1
    assert len(node(server, "dfs/ellipses").batched_positions) == 11
    assert top.pick is None
    assert "switched off" in top.describe_pick(status)
    click(top, "fs1", 2)
    assert top.pick is None


def test_many_particles_are_sampled(server):
    engine = engine_of("paper-line", ("fs1",), particles=2500)
    engine.start()
    try:
        top = TopView(server)
        status = after(engine, 3)
        top.show(status)
        assert len(node(server, "fs1/ellipses").batched_positions) == 1000
        click(top, "fs1", 999)  # the heaviest lies on top
        update = status.taken.step.filters["fs1"]  # type: ignore[union-attr]
        assert top.pick is not None
        assert top.pick.particle == int(update.measures.best)
    finally:
        engine.close()


def test_layers_can_be_hidden(server, points):
    top = TopView(server)
    top.show(after(points, 6))
    of = {
        "truth": "truth/map truth/path truth/robot",
        "odometry": "odometry",
        "seen": "seen",
        "headings": "fs1/headings",
        "maps": "fs1/map fs1/map_ellipses",
        "paths": "fs1/path",
        "lineages": "fs1/lineages",
    }
    assert {*of, "ellipses"} == set(top.layers(points.status.info))
    for layer, names in of.items():
        for on in (False, True):
            top.visible(layer, on)
            assert top.is_visible(layer) == on
            assert [node(server, name).visible for name in names.split()] == [on] * len(names.split()), layer
    top.visible("ellipses", False)
    assert node(server, "dfs/ellipses").visible  # small, to be clicked
    with pytest.raises(ValueError, match="no layer 'walls'"):
        top.visible("walls", True)


def test_pick_is_told_drawn_and_cleared(server, points):
    told: list[Any] = []
    top = TopView(server, on_pick=lambda *what: told.append(what), on_clear=lambda: told.append(None))
    assert top.describe_pick(points.status) == HINT
    status = after(points, 5)
    top.show(status)
    click(top, "dfs", 4)
    assert isinstance(top.pick, Pick)
    assert told == [("dfs", top.pick.particle)]
    top.show(status)
    weighted = status.taken.step.filters["dfs"].trace.weighted  # type: ignore[union-attr]
    centre = server.scene.get_handle_by_name("/map").position[:2]  # type: ignore[union-attr]
    s = weighted.s[top.pick.particle]
    np.testing.assert_allclose(node(server, "pick/dot").points.mean(axis=1)[0, :2] + centre, s[:2], atol=1e-4)
    text = top.describe_pick(status)
    for part in ("Dual FastSLAM", f"particle {top.pick.particle}", f"{s[0]:.3f} m", "standard deviations", "founder"):
        assert part in text
    weight = 20 * math.exp(weighted.log_w[top.pick.particle])
    assert f"{weight:.3g}" in text

    ground(top)  # the same click, as one on the ground
    assert top.pick is not None
    top._picked_at -= 1.0
    ground(top)
    assert top.pick is None
    assert told[-1] is None
    top.show(status)
    assert not any(node(server, f"pick/{name}").visible for name in ("dot", "outline", "path", "map", "heading"))


@pytest.mark.parametrize("instance", [None, -1, 20, 10**9, "3", 3.0, math.nan, True, [1], {}])
def test_garbage_picks_nothing(server, points, instance):
    top = TopView(server)
    click(top, "dfs", 0)  # before anything is shown
    top.show(after(points, 2))
    click(top, "dfs", instance)
    click(top, "ekf", 0)
    click(top, "../truth", 0)
    top.select("dfs", -1)
    top.select("dfs", 20)
    assert top.pick is None
    top._particle_clicked("dfs", object())


def test_pick_follows_the_heaviest_descendant_and_goes_back_to_the_ancestor(points):
    one = after(points, 5)
    update = one.taken.step.filters["fs1"]  # type: ignore[union-attr]
    survivors = np.unique(update.trace.selected)
    pick = Pick("fs1", int(survivors[0]), where(one), update)  # type: ignore[arg-type]
    two = after(points, 6)
    found = followed(pick, two)
    trace = two.taken.step.filters["fs1"].trace  # type: ignore[union-attr]
    heirs = [k for k in range(20) if update.trace.selected[trace.resized[k]] == pick.particle]
    assert isinstance(found, Pick)
    assert found.particle == heirs[int(np.argmax(trace.weighted.log_w[heirs]))]
    assert followed(found, two).particle == found.particle  # type: ignore[union-attr]
    back = followed(found, one)
    assert isinstance(back, Pick)
    assert back.particle == pick.particle

    later = after(points, 40)  # all at once is the same as one by one, for the dead too
    paths = later.taken.step.filters["fs1"].genealogy.ancestors  # type: ignore[union-attr]
    alive = np.arange(20)
    for step in range(40, 5, -1):
        alive = paths[step - 1][alive]
    for k in range(20):
        now = followed(Pick("fs1", k, where(one), update), later)  # type: ignore[arg-type]
        if isinstance(now, Lost):
            assert "died" in now.reason
        if k in update.trace.selected[alive]:
            assert isinstance(now, Pick)


def test_pick_that_dies_says_so(server, points):
    top = TopView(server)
    step = 1
    while True:
        step += 1
        status = after(points, step)
        trace = status.taken.step.filters["fs1"].trace  # type: ignore[union-attr]
        dead = np.setdiff1d(np.arange(20), trace.selected)
        if len(dead):
            break
    top.show(status)
    top.select("fs1", int(dead[0]))
    assert "dies in the resampling" in top.describe_pick(status)
    assert top.pick is not None
    way = ancestry(top.pick)
    np.testing.assert_array_equal(way[-1], trace.weighted.s[dead[0]])
    top.show(status)
    status = after(points, step + 1)
    top.show(status)
    assert top.pick is None
    assert f"died in step {step}" in top.describe_pick(status)
    assert not node(server, "pick/dot").visible


def test_pick_has_the_path_of_its_ancestors(points):
    status = after(points, 10)
    update = status.taken.step.filters["dfs"]  # type: ignore[union-attr]
    child = 3
    parent = int(update.trace.selected[child])
    way = ancestry(Pick("dfs", parent, where(status), update))  # type: ignore[arg-type]
    assert way.shape == (11, 3)
    np.testing.assert_array_equal(way[-1], update.trace.weighted.s[parent])


def test_pick_in_time_travel_and_branches(server, points):
    top = TopView(server)
    status = after(points, 12)
    top.show(status)
    top.select("dfs", 4)
    points.go(6)
    status = points.wait(lambda s: s.step == 6, PATIENCE)
    top.show(status)
    assert top.pick is not None
    assert top.pick.where == (0, "", 6)
    points.put({"inflate_r": 4.0})
    points.fork("other")
    status = after(points, 7)
    top.show(status)
    assert status.branch == "other"
    assert top.pick is None or top.pick.where.branch == "other"
    points.go(0)
    status = points.wait(lambda s: s.step == 0, PATIENCE)
    top.show(status)
    assert top.pick is None
    assert not node(server, "dfs/ellipses").visible
    assert node(server, "truth/robot").visible
    assert top.describe_pick(status)


def test_steps_that_branches_share():
    branches = (("", "", 0, 50), ("a", "", 20, 40), ("b", "a", 30, 60), ("c", "", 10, 12))
    assert shared_steps(branches, "b", "a") == 30
    assert shared_steps(branches, "b", "") == 20
    assert shared_steps(branches, "b", "c") == 10
    assert shared_steps(branches, "", "") > 10**9
    assert shared_steps(branches, "b", "nowhere") == 0


def test_another_session_in_another_world(server, points):
    top = TopView(server)
    top.show(after(points, 4))
    top.select("dfs", 1)
    before = nodes(server)
    place = tuple(server.scene.get_handle_by_name("/map").position)  # type: ignore[union-attr]
    points.reset(source=build("loop"))
    status = points.wait(lambda s: s.number == 1, PATIENCE)
    top.show(status)
    assert top.pick is None
    assert not node(server, "dfs/ellipses").visible
    assert not node(server, "odometry").visible
    assert len(node(server, "truth/map").points) == 152
    assert tuple(server.scene.get_handle_by_name("/map").position) != place  # type: ignore[union-attr]
    assert nodes(server) == before
    top.reset(status.info)
    top.show(status)


def test_trail_of_dead_reckoning(points):
    trail = OdometryTrail()
    points.add(trail)
    status = after(points, 8)
    path = trail.path(status.branches, status.branch, 8)
    assert path.shape == (9, 2)
    np.testing.assert_array_equal(path[-1], status.taken.step.odometry[:2])  # type: ignore[union-attr]
    assert len(trail.path(status.branches, status.branch, 3)) == 4
    points.go(5)
    points.wait(lambda s: s.step == 5, PATIENCE)
    points.fork("b")
    status = after(points, 7)
    assert trail.path(status.branches, "b", 7).shape == (8, 2)
    trail.note("b", 9, np.zeros(3))  # one is missing
    assert trail.path(status.branches, "b", 9).shape == (9, 2)


def test_colours_come_out_as_they_are_meant():
    def shown(light: np.ndarray) -> np.ndarray:
        """three.js' ACES curve, and sRGB."""
        v = (light / 0.6) @ np.linalg.inv(tone._IN).T
        v = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081)
        return 255 * tone._encoded(np.clip(v @ np.linalg.inv(tone._OUT).T, 0, 1))

    assert np.allclose(shown(np.array([230, 159, 0]) / 255), [226, 209, 73], atol=1)  # yellow, if nothing is done
    for rgb in (*colours.FILTERS.values(), colours.ODOMETRY, colours.BACKGROUND):
        got = shown(tone.each(np.array([rgb]))[0] / 255)
        assert np.abs(got - rgb).max() < 34, rgb
        assert np.abs(got - rgb).mean() < 12, rgb


def test_numbers_beyond_all_bounds_do_not_stop_it(server):
    strokes, discs = Strokes(server.scene, "/a", 1.0), Ellipses(server.scene, "/b", 0.5, (1, 2, 3))
    far = np.array([[1e300, -np.inf], [np.nan, 0.0]])
    strokes.put(line(far), np.zeros((1, 3)))
    discs.put(ellipses(far, np.full((2, 2, 2), 1e200), 0.1))
    assert len(strokes.handle.points) == 1
    assert len(discs.handle.batched_positions) == 2


def client_at(position: Any, width: Any = 500, height: Any = 700) -> Any:
    camera = SimpleNamespace(position=position, image_width=width, image_height=height)
    return SimpleNamespace(camera=camera, atomic=nullcontext)


def test_camera_sees_all_and_trusts_nobody():
    camera = TopCamera(Extent(np.array([0.0, 0.0]), np.array([40.0, 10.0])))
    assert camera.look_at == (20.0, 5.0, 0.0)
    for aspect in (0.3, 0.7, 2.0):
        tall = 2 * camera.position(aspect)[2] * math.tan(camera.field / 2)
        assert tall >= 10.0
        assert tall * aspect >= 40.0 or camera.position(aspect)[2] > 0.98 * OUT * camera.height
    assert math.isfinite(camera.position(math.nan)[2])
    common = camera.pixel([])
    for position in ((0, 0, math.nan), (0, 0, -1), (0, 0), None, (0, 0, "x"), (0, 0, 0.0)):
        assert camera.pixel([client_at(position)]) == common
        camera.closer(client_at(position), (0.1, 0.1), (0.4, 0.4))
    assert camera.pixel([client_at((0, 0, 1e-300))]) >= 0.5 * CLOSEST * common
    assert camera.pixel([client_at((0, 0, 1e300))]) <= 2 * OUT * common
    close = client_at((20.0, 5.0, camera.height))
    for corners in ((None, None), ((0, math.nan), (1, 1)), ((0,), (1,)), ("a", "b"), ((0.5, 0.5), (0.505, 0.505))):
        camera.closer(close, *corners)
        assert close.camera.position == (20.0, 5.0, camera.height)
    camera.closer(close, (0.75, 0.25), (1.0, 0.5))
    assert close.camera.position[0] > 20.0
    assert close.camera.position[1] > 5.0
    assert close.camera.position[2] == pytest.approx(0.25 * camera.height)
    camera.closer(close, (-9.0, 3.0), (1e9, -1e9))


def test_a_world_far_from_its_origin_is_drawn_exactly():
    extent = Extent(np.array([5e6, 4e6]), np.array([5e6 + 100.0, 4e6 + 50.0]))
    camera = TopCamera(extent)
    assert camera.look_at[:2] == (5e6 + 50.0, 4e6 + 25.0)
    assert camera.height < 9001.0
    assert [nice(x) for x in (0.7, 1.0, 1.2, 31.0)] == [1.0, 1.0, 2.0, 50.0]
