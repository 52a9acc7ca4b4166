"""A recording of walls: what the laser saw, what was made of it, what it was taken for, and the maps."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from app import colours, session
from app.colours import MATCHED, NEW, REJECTED, of_filter
from app.recording import Recorder, arrow, texts, walls
from app.recording.ground import extent_of
from app.recording.limits import limits_for
from app.recording.reading import Recording
from app.recording.scene import Style
from app.scans import returns
from app.trajectory import Trajectory
from app.types import SessionInfo, SessionStep, best_descendant
from scenarios.registry import build
from scenarios.types import TrueMap
from slam.estimators import ESTIMATORS
from slam.map_store import MapStore
from slam.types import IGNORED, Floats, Scan
from slam.types import NEW as UNPAIRED
from tests.app.test_recording import Watch
from tests.app.viewer import Viewer, pixels, required_viewer

STEPS, K = 26, 12
KEYS = ("dfs", "fs2", "ekf")
ORANGE = Style(of_filter("dfs"), 0, 1e-3)


@pytest.fixture(scope="module")
def info() -> SessionInfo:
    source = build("hospital")
    filters = [ESTIMATORS[key] for key in KEYS]
    strict = {"temper": 1.0, "inflate_r": 1.0, "gate": 0.99, "gate_new": 0.999999, "floor_lateral": 0.005}
    params = source.params(particles=K, floor_angle=math.radians(0.1), **strict)  # so that pieces are rejected, too
    return session.make_info(source, filters, params, seed=1, count=STEPS)


def recorded_strictly(info: SessionInfo, path: Path) -> tuple[Recording, list[SessionStep]]:
    """What was recorded of a session, bad data being an error, and its steps."""
    import rerun as rr

    watch = Watch()
    rr.set_strict_mode(True)
    try:
        session.run(info, [Recorder(path), watch])
    finally:
        rr.set_strict_mode(False)
    return Recording(path), watch.steps


@pytest.fixture(scope="module")
def recorded(info, tmp_path_factory) -> tuple[Recording, list[SessionStep]]:
    return recorded_strictly(info, tmp_path_factory.mktemp("walls") / "run.rrd")


def strips(recording: Recording, entity: str, timeline: str = "step") -> dict[int, Floats]:
    """(n, 2, 2) of the lines between two ends of an entity, by time."""
    rows = recording.rows(entity, "LineStrips3D:strips", timeline)
    return {time: np.array(row, float).reshape(-1, 2, 3)[..., :2] for time, row in rows}


def packed(rgb: tuple[int, int, int]) -> int:
    return rgb[0] << 24 | rgb[1] << 16 | rgb[2] << 8 | 255


def placed(s: Floats, x: float, y: float) -> list[float]:
    """(x, y) of the robot's frame, for a robot at s."""
    c, q = math.cos(s[2]), math.sin(s[2])
    return [s[0] + c * x - q * y, s[1] + q * x + c * y]


def two_ends(x: float, y: float, phi: float, a: float, b: float) -> list[list[float]]:
    return [[x + t * math.cos(phi), y + t * math.sin(phi)] for t in (a, b)]


def best_map(step: SessionStep, key: str) -> tuple[Floats, Floats]:
    update = step.filters[key]
    theta, Sigma, _ = update.trace.weighted.maps.features(update.measures.best)
    return theta, Sigma


def test_every_entity_of_walls_is_there(recorded):
    recording, _ = recorded
    parts = ("segments", "associations", "map", "map/ends", "map/bands", "maps")
    for entity in ("/world/scan", *(f"/world/{key}/{part}" for key in KEYS for part in parts)):
        assert recording.timelines(entity) == {"step", "sim_time", "stage"}, entity


def test_the_true_walls(recorded, info):
    recording, _ = recorded
    drawn = [row for _, row in recording._rows("/world/truth/map", "LineStrips3D:strips") if len(row)]
    np.testing.assert_allclose(np.array(drawn)[..., :2].reshape(-1, 4), info.source.true_map.theta, atol=1e-5)


def test_all_of_every_wall_is_in_the_picture(info):
    """Also the end of a wall that the robot never comes near, whichever of the two it is."""
    for theta in ([0.0, 0.0, 90.0, -70.0], [90.0, -70.0, 0.0, 0.0]):
        source = dataclasses.replace(info.source, true_map=TrueMap(np.array([0]), np.array([theta])))
        extent = extent_of(source, STEPS)
        assert extent.high[0] > 90.0
        assert extent.low[1] < -70.0


def test_the_scan_is_what_came_back_to_the_true_robot(recorded):
    recording, steps = recorded
    rows = recording.rows("/world/scan", "Points3D:positions", "step")
    assert [index for index, _ in rows] == list(range(1, STEPS + 1))
    lost = 0
    for step, (_, drawn) in zip(steps, rows, strict=True):
        scan = step.frame.scan
        back = np.isfinite(scan.ranges)
        lost += np.count_nonzero(~back)
        np.testing.assert_allclose(np.hypot(*(np.array(drawn)[:, :2] - step.truth[:2]).T), scan.ranges[back], atol=1e-4)
        ends = [placed(step.truth, r * math.cos(b), r * math.sin(b)) for r, b in zip(*scan[:2], strict=True) if r < 1e9]
        np.testing.assert_allclose(np.array(drawn)[:, :2], ends, atol=1e-5)
    assert lost > 0


def test_returns_of_a_laser_that_is_not_in_the_middle_and_fails_now_and_then():
    ranges = np.array([1.0, math.inf, math.nan, 2.0, 0.0, -1.0, 8.0, 9.0])
    bearings = np.array([0.0, 0.1, 0.2, math.pi / 2, 1.7, 1.8, 1.9, 2.0])
    laser = Scan(ranges, bearings, origin=np.array([0.5, 0.0, math.pi / 2]), max_range=8.0)
    seen = returns(laser, np.array([10.0, 20.0, math.pi]))
    np.testing.assert_allclose(seen, [[9.5, 19.0], [11.5, 20.0]], atol=1e-12)
    assert returns(laser._replace(ranges=np.full(8, math.nan)), np.zeros(3)).shape == (0, 2)


@pytest.mark.parametrize("key", KEYS)
def test_pieces_lie_where_the_best_particle_sees_them(recorded, key):
    recording, steps = recorded
    drawn = strips(recording, f"/world/{key}/segments")
    for step in steps:
        update = step.filters[key]
        s = update.trace.weighted.s[update.measures.best]
        expected = [two_ends(*placed(s, z[0], z[1]), s[2] + z[2], z[3], z[4]) for z in step.frame.z]
        np.testing.assert_allclose(drawn[step.index], np.array(expected).reshape(-1, 2, 2), atol=1e-5)
    assert sum(len(row) for row in drawn.values()) > 2 * STEPS


@pytest.mark.parametrize("key", KEYS)
def test_the_colour_of_a_piece_says_what_became_of_it(recorded, key):
    recording, steps = recorded
    rows = recording.rows(f"/world/{key}/segments", "LineStrips3D:colors", "step")
    seen: set[int] = set()
    for step, (_, row) in zip(steps, rows, strict=True):
        update = step.filters[key]
        n = update.trace.n[update.measures.best]
        assert row == [packed({UNPAIRED: NEW, IGNORED: REJECTED}.get(int(i), MATCHED)) for i in n]
        seen |= {min(int(i), 0) for i in n}
    assert seen >= {0, UNPAIRED}
    if key == "dfs":
        assert IGNORED in seen


def test_what_became_of_a_piece_can_be_told_from_the_filters():
    """By people with any of the three colour deficiencies, too: distances in CIELAB, severe deficiency (Machado)."""
    statuses, filters = (MATCHED, NEW, REJECTED), [*colours.FILTERS.values(), colours.TRUTH_ON_DARK]
    for deficiency in DEFICIENCIES:
        for i, one in enumerate(statuses):
            for other in statuses[:i]:
                assert distance(one, other, deficiency) > 35.0
            for other in filters:
                assert distance(one, other, deficiency) > 12.0


DEFICIENCIES = (
    np.eye(3),
    np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]),
    np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]),
    np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]),
)


def distance(one: colours.RGB, other: colours.RGB, deficiency: Floats) -> float:
    def lab(rgb: colours.RGB) -> Floats:
        c = np.array(rgb) / 255.0
        light = np.clip(deficiency @ np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4), 0.0, 1.0)
        xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ light
        f = np.cbrt(xyz / [0.9505, 1.0, 1.089])
        return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])

    return float(np.linalg.norm(lab(one) - lab(other)))


@pytest.mark.parametrize("key", KEYS)
def test_associations_join_every_matched_piece_with_its_wall(recorded, key):
    recording, steps = recorded
    drawn = strips(recording, f"/world/{key}/associations")
    dots = dict(recording.rows(f"/world/{key}/associations", "Points3D:positions", "step"))
    for step in steps:
        update = step.filters[key]
        best = update.measures.best
        theta, n, s = best_map(step, key)[0], update.trace.n[best], update.trace.weighted.s[best]
        matched = [i for i in range(len(n)) if n[i] >= 0]
        assert len(drawn[step.index]) == len(matched)
        np.testing.assert_allclose(np.array(dots[step.index]).reshape(-1, 3)[:, :2], drawn[step.index][:, 0], atol=1e-6)
        for i, (seen, foot) in zip(matched, drawn[step.index], strict=True):
            np.testing.assert_allclose(seen, placed(s, *step.frame.z[i, :2]), atol=1e-5)
            (x, y), (far_x, far_y) = two_ends(*theta[n[i], :5])
            on_the_wall = [[x + u * (far_x - x), y + u * (far_y - y)] for u in np.linspace(0.0, 1.0, 2001)]
            away = np.hypot(*(np.array(on_the_wall) - seen).T)
            assert math.dist(seen, foot) <= away.min() + 1e-5
            assert np.hypot(*(np.array(on_the_wall) - foot).T).min() < 0.01
    assert sum(len(row) for row in drawn.values()) > STEPS


def test_an_association_ends_where_the_wall_does():
    wall = np.array([[0.0, 0.0, math.pi / 2, -1.0, 2.0, 1.0, 1.0, 5.0]])  # along x = 0, from y = -1 to 2
    z = np.zeros((2, 11))
    z[:, :3] = [[0.1, 2.5, math.pi / 2], [-0.2, 1.0, math.pi / 2]]
    frame = build("corridor").steps[0].frame._replace(z=z)
    drawn = walls.observations(frame, np.zeros(3), np.array([0, 0]), wall[[0, 0]], ORANGE)["associations"][0]
    ends = np.array(drawn.strips.as_arrow_array().to_pylist())[:, 1, :2]
    np.testing.assert_allclose(ends, [[0.0, 2.0], [0.0, 1.0]], atol=1e-6)


def test_associations_are_hidden_in_every_view(recorded):
    recording, _ = recorded
    reader = RrdReader(recording.path)
    (blueprint,) = reader.blueprints()
    chunks = reader.store(store=blueprint).stream().to_chunks()
    shown: dict[str, list[bool]] = {}
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if "EntityBehavior:visible" in batch.schema.names and "/overrides/" in chunk.entity_path:
            shown.setdefault(chunk.entity_path, []).extend(batch.column("EntityBehavior:visible").flatten().to_pylist())
    hidden = [path for path, values in shown.items() if values == [False]]
    for key in KEYS:
        of_it = [path for path in hidden if f"/world/{key}/associations" in path]
        assert len(of_it) == 5  # two maps, three close-ups


@pytest.mark.parametrize("key", KEYS)
def test_the_map_has_walls_ends_and_counts(recorded, key):
    recording, steps = recorded
    drawn = strips(recording, f"/world/{key}/map")
    counts = dict(recording.rows(f"/world/{key}/map", "observations", "step"))
    shades = dict(recording.rows(f"/world/{key}/map", "LineStrips3D:colors", "step"))
    dots = dict(recording.rows(f"/world/{key}/map/ends", "Points3D:positions", "step"))
    for step in steps:
        theta, _ = best_map(step, key)
        expected = np.array([two_ends(*wall[:5]) for wall in theta])
        np.testing.assert_allclose(drawn[step.index], expected, atol=1e-5)
        assert counts[step.index] == theta[:, 7].tolist()
        known = expected[theta[:, 5:7] == 1.0]
        np.testing.assert_allclose(np.array(dots[step.index])[:, :2], known, atol=1e-5)
    assert 0 < len(known) < 2 * len(theta)
    brightness = np.array([sum((shade >> bits) & 255 for bits in (8, 16, 24)) for shade in shades[STEPS]])
    order = np.argsort(theta[:, 7], kind="stable")
    assert (np.diff(brightness[order]) >= 0).all()
    assert brightness[theta[:, 7] == 1.0].max() < 0.5 * brightness[theta[:, 7] > 15.0].min()


@pytest.mark.parametrize("key", KEYS)
def test_all_maps_have_every_wall_of_every_particle_once(recorded, key):
    recording, steps = recorded
    drawn = strips(recording, f"/world/{key}/maps")
    for step in steps:
        maps = step.filters[key].trace.weighted.maps
        every = {tuple(w[:5]) for k in range(len(maps)) for w in maps.features(k)[0]}
        expected = np.array([two_ends(*wall) for wall in every]).astype(np.float32).reshape(-1, 4)
        found = drawn[step.index].astype(np.float32).reshape(-1, 4)
        assert len(found) == len(every)
        np.testing.assert_allclose(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)], atol=1e-5)
    assert len(every) < maps.counts.sum() or key == "ekf"


def test_a_wall_that_was_merged_is_drawn_no_more(tmp_path):
    """Copies are made with small floors and a narrow gate; then they are merged.  Event, pictures, and files agree."""
    source, merge = build("corridor"), 16
    copying = {"temper": 1.0, "inflate_r": 1.0, "gate": 0.9, "gate_new": 0.0, "floor_lateral": 1e-3}
    params = source.params(particles=5, floor_angle=5e-4, **copying)
    info = session.make_info(source, [ESTIMATORS["dfs"]], params, seed=1, count=18)
    path, watch, files = tmp_path / "merged.rrd", Watch(), Trajectory(tmp_path / "files")
    change = session.Change(merge, source.params(particles=5, merge_walls=True))
    session.run(info, [Recorder(path), watch, files], [change])
    update = watch.steps[merge - 1].filters["dfs"]
    maps, best = update.trace.weighted.maps, update.measures.best
    assert len(maps.indices(best)) < maps.counts[best]
    recording = Recording(path)
    assert [event.step for event in recording.events() if "merged a wall of its best map" in event.text] == [merge]
    drawn = strips(recording, "/world/dfs/map")[merge]
    assert len(drawn) == len(maps.indices(best)) == update.measures.features
    every = {tuple(two_ends(*wall[:5])[0]) for k in range(len(maps)) for wall in maps.features(k)[0]}
    assert {tuple(np.float32(wall[0])) for wall in strips(recording, "/world/dfs/maps")[merge]} == {
        tuple(np.float32(end)) for end in every
    }
    assert len(strips(recording, "/world/dfs/associations")[merge]) == int((update.trace.n[best] >= 0).sum()) > 0
    last = watch.steps[-1].filters["dfs"]
    shapes = json.loads((tmp_path / "files" / "dfs.geojson").read_text())["features"]
    walls_of_map = [shape for shape in shapes if "observations" in shape["properties"]]
    kept = last.trace.resampled.maps.indices(best_descendant(last))
    assert [shape["properties"]["index"] for shape in walls_of_map] == kept.tolist()
    assert kept[-1] >= len(kept)


def test_of_many_walls_no_more_than_allowed_are_drawn():
    feature = build("corridor").feature
    maps = MapStore(feature).empty(3)
    theta = np.zeros((3, 40, 8))
    theta[..., 0], theta[..., 4] = np.arange(120.0).reshape(3, 40), 1.0
    maps = maps.append(np.ones((3, 40), bool), theta, np.zeros((3, 40, 2, 2)), np.arange(40))
    for limit, expected in ((100, 100), (120, 120), (10, 10)):
        drawn = walls.all_maps(maps, limits_for(1)._replace(hypotheses=limit), ORANGE)
        assert len(drawn.strips.as_arrow_array()) == expected


@pytest.mark.parametrize("key", KEYS)
def test_bands_are_two_deviations_of_what_is_uncertain(recorded, key):
    recording, steps = recorded
    corners = dict(recording.rows(f"/world/{key}/map/bands", "Mesh3D:vertex_positions", "step"))
    narrow = wide = 0
    for step in steps:
        expected = []
        theta, Sigma = best_map(step, key)
        for (x, y, phi, a, b, *_), covariance in zip(theta, Sigma, strict=True):
            half = {t: 2.0 * math.sqrt(np.array([1.0, t]) @ covariance @ [1.0, t]) for t in (a, 0.0, b)}
            if max(half.values()) > 0.02:
                sides = [(t, side * h) for side in (1.0, -1.0) for t, h in half.items()]
                expected += [placed(np.array([x, y, phi]), *place) for place in sides]
        narrow, wide = narrow + len(theta) - len(expected) // 6, wide + len(expected) // 6
        drawn = np.array(corners[step.index]).reshape(-1, 3)[:, :2]
        np.testing.assert_allclose(drawn, np.array(expected).reshape(-1, 2), atol=1e-5)
    assert (narrow > 0, wide > 0) == {"dfs": (True, False), "fs2": (True, True), "ekf": (False, True)}[key]


def test_bands_are_filled(recorded):
    recording, _ = recorded
    _, corners = recording.rows("/world/ekf/map/bands", "Mesh3D:vertex_positions", "step")[-1]
    _, triangles = recording.rows("/world/ekf/map/bands", "Mesh3D:triangle_indices", "step")[-1]
    bands, used = np.array(corners).reshape(-1, 6, 3)[..., :2], np.array(triangles).reshape(-1, 4, 3)
    assert (used // 6 == np.arange(len(bands))[:, None, None]).all()
    for band, four in zip(bands, used % 6, strict=True):
        assert sum(area(band[three]) for three in four) == pytest.approx(area(band[[0, 1, 2, 5, 4, 3]]), rel=1e-3)


def area(polygon: Floats) -> float:
    x, y = (polygon - polygon[0]).T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


@pytest.mark.parametrize("key", KEYS)
def test_the_outline_is_the_ellipse_of_the_best_particle(recorded, key):
    recording, steps = recorded
    rows = dict(recording.rows(f"/world/{key}/particles", "LineStrips3D:strips", "stage"))
    for step in steps:
        update = step.filters[key]
        best = update.measures.best
        weighted = update.trace.weighted
        (outline,) = rows[3 * step.index - 1]
        off = np.array(outline)[:, :2] - weighted.s[best, :2]
        np.testing.assert_array_equal(outline[0], outline[-1])
        whitened = np.linalg.solve(np.linalg.cholesky(weighted.P[best, :2, :2]), off.T)
        np.testing.assert_allclose(np.hypot(*whitened), 2.0, atol=0.1)  # single precision, some millimetres across
        if key == "fs2":
            assert rows[3 * step.index] == []  # drawn: a mere sample


def test_nothing_seen(info, tmp_path):
    """No scan at all, a scan of nothing, and nobody who knows where the robot is."""
    recorder = Recorder(tmp_path / "a.rrd")
    recorder.begin(info)
    nothing = np.zeros((0, 11))
    for step in session.steps(info._replace(steps=3)):
        scan = None if step.index == 1 else step.frame.scan._replace(ranges=np.full(181, math.inf))
        frame = step.frame._replace(scan=scan, z=nothing, tags=np.zeros(0, np.int64))
        filters = {k: u._replace(trace=u.trace._replace(n=u.trace.n[:, :0])) for k, u in step.filters.items()}
        recorder.step(dataclasses.replace(step, frame=frame, truth=None, filters=filters))
    recorder.end()
    recording = Recording(tmp_path / "a.rrd")
    for entity, part in (("scan", "Points3D:positions"), ("dfs/segments", "LineStrips3D:strips")):
        assert recording.rows(f"/world/{entity}", part, "step") == [(1, []), (2, []), (3, [])]


def test_a_map_without_walls():
    drawn = walls.best_map(np.zeros((0, 8)), np.zeros((0, 2, 2)), ORANGE)
    assert len(drawn["map"][0].strips.as_arrow_array()) == 0
    assert len(walls.all_maps(MapStore(build("corridor").feature).empty(2), limits_for(9), ORANGE).strips) == 0


def test_pages_and_titles_explain_what_is_there(info):
    page = texts.about(info, limits_for(STEPS))
    landmarks = build("paper-line")
    other = texts.about(session.make_info(landmarks, info.filters, count=3), limits_for(3))
    for word in ("**yellow**", "**violet**", "**red**", "`observations`", "faint lines"):
        assert word in page
        assert word not in other
    assert "`associations`" in page
    assert "`associations`" in other


@pytest.mark.parametrize("count", [1, 2, 100])
def test_bars_are_stored_as_rerun_would_store_them(count):
    import rerun as rr

    heights = np.random.default_rng(count).random(count)
    expected = rr.components.TensorDataBatch(heights.astype(np.float32)).as_arrow_array()
    found = arrow.bars(heights)
    found.validate(full=True)
    assert found.type == expected.type
    assert found.equals(expected)


@pytest.fixture(scope="module")
def corridor(tmp_path_factory) -> Viewer:
    """Dual FastSLAM with one particle, far down a corridor."""
    source, path = build("corridor"), tmp_path_factory.mktemp("corridor") / "run.rrd"
    params = source.params(particles=1)
    session.run(session.make_info(source, [ESTIMATORS["dfs"]], params, seed=1, count=FAR), [Recorder(path)])
    viewer = required_viewer(path)
    yield viewer
    viewer.__exit__()


FAR = 100


def close(picture: np.ndarray, rgb: tuple[int, int, int], tolerance: int = 12) -> np.ndarray:
    """(height, width) which pixels have a colour."""
    return np.abs(picture.astype(int) - np.array(rgb)).max(axis=2) < tolerance


@pytest.mark.parametrize("name", ["/world/dfs/focus", "/world/dfs/best", "/world"])
def test_the_ellipse_is_seen_to_be_long_along_the_corridor(corridor: Viewer, name):
    corridor.seek("step", FAR)
    view = next(v for v in corridor.views() if v.origin == name)
    corridor.bring_to_front(view)
    rows, columns = np.nonzero(close(pixels(corridor.screenshot(view)), colours.mix(of_filter("dfs"), (255,) * 3, 0.6)))
    length, width = np.ptp(columns) + 1, np.ptp(rows) + 1
    whole = name == "/world"  # of 100 m: a centimetre is a tenth of a pixel, and half of its length lies under a dot
    assert length > (2 if whole else 4) * width
    assert length > (5 if whole else 60)


def test_every_view_of_walls_reports_nothing(corridor: Viewer):
    corridor.seek("step", FAR)
    for view in corridor.views():
        corridor.bring_to_front(view)
    assert not {view.name: view.reports for view in corridor.views() if view.reports}
    assert corridor.complaints() == []


def test_pieces_and_scan_are_seen(corridor: Viewer):
    corridor.seek("step", FAR)
    view = next(v for v in corridor.views() if v.name.startswith("Map:"))
    assert "seen: matched yellow, new violet, rejected red" in view.name
    corridor.bring_to_front(view)
    picture = pixels(corridor.screenshot(view))
    assert close(picture, MATCHED).sum() > 50
    assert close(picture, colours.faded(colours.WARNING, 0.4)).sum() > 5  # on top of the true walls


def test_associations_can_be_switched_on(corridor: Viewer):
    corridor.seek("step", FAR)
    view = next(v for v in corridor.views() if v.name.startswith("Map:"))
    corridor.bring_to_front(view)
    before = pixels(corridor.screenshot(view))
    corridor.switch_on("/world/dfs/associations")
    after = pixels(corridor.screenshot(view))
    assert (close(after, colours.ASSOCIATION, 90) & ~close(before, colours.ASSOCIATION, 90)).sum() > 30
