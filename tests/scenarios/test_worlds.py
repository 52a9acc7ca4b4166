"""Every world of landmarks: exact, sensible, and what its options promise.  Worlds of walls: `test_wall_worlds.py`."""

import math
from typing import Any

import numpy as np
import pytest

from scenarios.noise import add_noise
from scenarios.paper_line import LAYOUTS
from scenarios.preview import preview, world_row
from scenarios.registry import build, is_world, landmark_options, worlds
from scenarios.scatter import scatter
from scenarios.sensors import Sensor, observe
from scenarios.types import Source, SourceError
from slam.features import innovation
from slam.motion import Ackermann, propagate

LANDMARKS = {"features": "landmarks"}
WORLDS = [name for name, entry in worlds().items() if "landmarks" in entry.features]

VARIANTS: list[tuple[str, Any]] = [
    *((name, landmark_options(name)) for name in WORLDS),
    ("paper-line", {"vehicle": "ackermann"}),
    ("paper-line", {"period": "0.2"}),
    *(("paper-line", {"layout": layout}) for layout in LAYOUTS),
    ("corridor", {"length": 30.0, "width": 3.0, "door_spacing": 4.0, **LANDMARKS}),
    ("loop", {"laps": 2.1, "length": 40.0, **LANDMARKS}),
    ("loop", {"view_deg": 180.0, "laps": 0.5, **LANDMARKS}),
    ("rotation-then-corridor", {"turn_deg": -180.0, **LANDMARKS}),
    ("field", {"landmarks": 500, "length": 90.0, "layout_seed": 3}),
]


def by_variant(function: Any) -> Any:
    return pytest.mark.parametrize(
        ("name", "options"), VARIANTS, ids=[" ".join([n, *map(str, o.values())]) for n, o in VARIANTS]
    )(function)


def odometry_error(source: Source, seed: int) -> float:
    rng, s = np.random.default_rng(seed), tuple(source.start)
    for step in source.steps:
        frame = add_noise(rng, step.frame, source.noise)
        for u, dt in zip(frame.u, frame.dt, strict=True):
            s = propagate(frame.motion, s, u, dt)[0]
    truth = source.steps[-1].truth
    assert truth is not None
    return math.dist(s[:2], truth[:2])


@by_variant
def test_noise_free_dead_reckoning_is_the_truth(name: str, options: dict[str, Any]) -> None:
    source = build(name, **options)
    s: Any = tuple(source.start)
    for step in source.steps:
        for u, dt in zip(step.frame.u, step.frame.dt, strict=True):
            s = propagate(step.frame.motion, s, u, dt)[0]
        assert step.truth is not None
        np.testing.assert_allclose(s, step.truth, atol=1e-9, rtol=0)


@by_variant
def test_frames_are_exact_and_in_order(name: str, options: dict[str, Any]) -> None:
    source = build(name, **options)
    assert source.true_map is not None
    place = dict(zip(source.true_map.tags.tolist(), source.true_map.theta, strict=True))
    assert len(place) == len(source.true_map.tags)
    elapsed = 0.0
    for frame, truth in source.steps:
        elapsed += frame.dt.sum()
        assert frame.time == pytest.approx(elapsed, abs=1e-9)
        assert frame.u.shape == (len(frame.dt), 2)
        assert frame.z.shape == (len(frame.tags), 2)
        for tag, z in zip(frame.tags.tolist(), frame.z, strict=True):
            v, _, _ = innovation(frame.feature, place[tag], truth, z)
            np.testing.assert_allclose(v, 0, atol=1e-12)


@by_variant
def test_the_sensor_sees_what_a_plain_check_sees(name: str, options: dict[str, Any]) -> None:
    source = build(name, **options)
    all_round = name == "loop" and "view_deg" not in options
    assert source.true_map is not None
    for frame, truth in source.steps[:: max(1, len(source.steps) // 40)]:
        assert truth is not None
        expected = []
        for tag, (x, y) in zip(*source.true_map, strict=True):
            dx, dy = x - truth[0], y - truth[1]
            ahead = dx * math.cos(truth[2]) + dy * math.sin(truth[2])
            if math.hypot(dx, dy) <= source.max_range and (ahead > 0 or all_round):
                expected.append(tag)
        assert frame.tags.tolist() == expected


@pytest.mark.parametrize("opening", [360.0, 90.0, 10.0])
def test_field_of_view(opening: float) -> None:
    rng = np.random.default_rng(2)
    theta = rng.uniform(-10, 10, (300, 2))
    pose = np.array([1.0, -2.0, 3.0])  # looks backwards, across the wrap of bearings
    [(index, _)] = observe(Sensor(7.0, math.radians(opening)), theta, pose[None])
    d = theta - pose[:2]
    cosine = d @ [math.cos(3.0), math.sin(3.0)] / np.hypot(*d.T)
    seen = (np.hypot(*d.T) <= 7.0) & (cosine >= math.cos(math.radians(opening / 2)))
    np.testing.assert_array_equal(index, np.flatnonzero(seen))
    assert 0 < len(index) < 300


def test_the_sensor_is_blind_under_itself() -> None:
    [(index, z)] = observe(Sensor(5.0), np.array([[1.0, 1.0], [2.0, 1.0]]), np.array([[1.0, 1.0, 0.0]]))
    assert index.tolist() == [1]
    np.testing.assert_allclose(z, [[1.0, 0.0]])


@pytest.mark.parametrize(("period", "ticks", "updates"), [("nine-ticks", 9, 59), ("0.2", 8, 66)])
@pytest.mark.parametrize("vehicle", ["unicycle", "ackermann"])
def test_paper_line_is_the_papers(period: str, ticks: int, updates: int, vehicle: str) -> None:
    source = build("paper-line", period=period, vehicle=vehicle)
    assert len(source.steps) == updates
    assert all((step.frame.dt == 0.025).all() and len(step.frame.dt) == ticks for step in source.steps)
    assert all((step.frame.u == [3.0, 0.0]).all() for step in source.steps)
    assert source.steps[0].frame.time == pytest.approx(ticks * 0.025)
    assert isinstance(source.motion, Ackermann) == (vehicle == "ackermann")
    assert source.true_map is not None
    assert source.true_map.theta.tolist() == [[5, 6], [15, -6], [25, 6], [35, -6], [45, 6]]
    params = source.params()
    assert (params.particles, params.association) == (25, "known")
    assert math.degrees(params.believed.turn) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("layout", "least", "most", "mean"),
    [
        ("alternating", 1, 3, 2.5),
        ("sparse", 1, 2, 1.0),
        ("one-far", 1, 1, 1.0),
        ("two-far", 2, 2, 2.0),
        ("two-rows", 10, 12, 11.5),
    ],
)
def test_layouts_show_as_many_landmarks_as_they_say(layout: str, least: int, most: int, mean: float) -> None:
    visible = [len(step.frame.tags) for step in build("paper-line", layout=layout).steps]
    assert least <= min(visible) <= max(visible) <= most
    assert np.mean(visible) == pytest.approx(mean, abs=0.6)


@pytest.mark.parametrize("name", ["corridor", "loop", "rotation-then-corridor", "field"])
def test_indoor_worlds_are_worth_filtering(name: str) -> None:
    source = build(name, **landmark_options(name))
    row = world_row(source)
    assert 150 <= row.steps <= 500
    assert 2.5 <= row.visible <= 12
    errors = [odometry_error(source, seed) for seed in range(4)]
    assert 1.0 < np.median(errors) < 25.0, errors


def test_loop_returns_into_known_ground() -> None:
    source = build("loop", **LANDMARKS)
    path = np.array([step.truth for step in source.steps])
    seen = [set(step.frame.tags.tolist()) for step in source.steps]
    lap = next(i for i in range(100, len(path)) if math.hypot(*path[i, :2]) < 0.5)
    assert 90 < lap * 0.4 < 105
    assert (len(path) - lap) * 0.4 > 20
    before = set().union(*seen[: lap - 40])
    assert all(tags <= before for tags in seen[lap + 1 :])
    assert min(len(tags) for tags in seen) >= 4
    assert max(len(tags) for tags in seen) <= 14
    assert source.true_map is not None
    theta = source.true_map.theta
    gaps = np.hypot(*(theta[:, None] - theta[None]).transpose(2, 0, 1)) + np.diag(np.full(len(theta), 99.0))
    assert gaps.min() >= 2.0


def test_loop_stays_inside_its_corridor() -> None:
    for laps in (0.3, 0.99, 1.0, 2.26):
        for step in build("loop", laps=laps, **LANDMARKS).steps:
            assert step.truth is not None
            x, y = step.truth[:2]
            outside = max(abs(x) - 15.0, abs(y - 10.0) - 10.0)
            assert -0.6 < outside < 0.05  # on the centre line, corners cut by (sqrt(2) - 1) m of radius


def test_rotation_sees_nothing_until_it_is_over() -> None:
    source = build("rotation-then-corridor", **LANDMARKS)
    turning = [step for step in source.steps if (step.frame.u[:, 0] == 0).all()]
    assert len(turning) == 24  # 360 degrees at 30 degrees/s, observed every 0.5 s
    assert all(len(step.frame.tags) == 0 for step in turning)
    assert sum(step.frame.u[:, 1].sum() * 0.1 for step in turning) == pytest.approx(2 * math.pi)
    assert np.mean([len(step.frame.tags) > 0 for step in source.steps]) > 0.8


def test_scatter_keeps_its_distance_and_its_seed() -> None:
    points = scatter((0, 0, 30, 20), 60, 2.0, seed=4)
    assert points.shape == (60, 2)
    gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))[np.triu_indices(60, 1)]
    assert gaps.min() >= 2.0
    np.testing.assert_array_equal(points, scatter((0, 0, 30, 20), 60, 2.0, seed=4))
    assert not np.array_equal(points, scatter((0, 0, 30, 20), 60, 2.0, seed=5))
    with pytest.raises(SourceError, match="do not fit"):
        scatter((0, 0, 10, 10), 100, 2.0, seed=0)


def test_the_same_options_give_the_same_bits() -> None:
    for a, b in zip(build("field").steps, build("field").steps, strict=True):
        np.testing.assert_array_equal(a.frame.z, b.frame.z)
        np.testing.assert_array_equal(a.frame.u, b.frame.u)


@pytest.mark.parametrize(
    ("name", "options", "parts"),
    [
        ("lop", {}, ["unknown world 'lop'", "'loop'"]),
        ("zzz", {}, ["'zzz'", "paper-line, corridor, loop"]),
        ("loop", {"lap": 2}, ["loop", "unknown option 'lap'", "'laps'"]),
        ("loop", {"laps": 0}, ["loop: laps is 0", "above 0"]),
        ("loop", {"laps": 900, "speed": 0.1}, ["control ticks", "2000000"]),
        ("loop", {"laps": 1e5}, ["laps is 100000.0", "at most 1000"]),
        ("corridor", {"door_spacing": 1e-6, "door_width": 1e-7}, ["door_spacing is 1e-06", "at most 1000000 doors"]),
        ("loop", {"door_width": 11.0}, ["door_width is 11", "door_spacing of 5 m"]),
        ("loop", {"length": 1.0}, ["length", "expected room"]),
        ("loop", {"features": "landmark"}, ["features is 'landmark'", "'landmarks'"]),
        ("hall", {"features": "walls"}, ["hall", "unknown option 'features'"]),
        ("loop", {"max_range": 0.0}, ["max_range is 0.0", "above"]),
        ("loop", {"view_deg": 400.0, **LANDMARKS}, ["view_deg is 400.0", "at most 360"]),
        ("paper-line", {"layout": "alternate"}, ["paper-line: layout is 'alternate'", "'alternating'"]),
        ("paper-line", {"max_range": -1.0}, ["max_range is -1.0", "above 0"]),
        ("paper-line", {"max_range": 1.0}, ["none of the 5 landmarks", "max_range 1 m", "nearest landmark 6"]),
        ("corridor", {"length": math.nan}, ["length is nan", "a number"]),
        ("corridor", {"length": "long"}, ["length is 'long'", "a number"]),
        ("corridor", {"speed": 0.0}, ["speed is 0.0", "above 0"]),
        ("corridor", {"length": 3.0, **LANDMARKS}, ["corridor: landmarks: there are 0", "expected 1"]),
        ("rotation-then-corridor", {"lobby": -1.0}, ["lobby is -1.0", "at least 0"]),
        ("field", {"landmarks": 0}, ["number is 0", "at least 1"]),
        ("field", {"landmarks": 1.5}, ["landmarks is 1.5", "a whole number"]),
        ("field", {"landmarks": 2000, "spacing": 2.0}, ["do not fit"]),
        ("field", {"layout_seed": -1}, ["seed is -1"]),
        ("field", {"lane_gap": 1.0}, ["lane_gap", "room to turn"]),
    ],
)
def test_what_cannot_be_built(name: str, options: dict[str, Any], parts: list[str]) -> None:
    with pytest.raises(SourceError) as caught:
        build(name, **options)
    assert all(part in str(caught.value) for part in parts), str(caught.value)
    assert "\n" not in str(caught.value)


def test_is_world() -> None:
    assert is_world("loop")
    assert is_world("somewhere/mine.toml")
    assert not is_world("somewhere/log.gz")


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("ascii_only", [True, False])
def test_preview(name: str, ascii_only: bool) -> None:
    source = build(name, **landmark_options(name))
    lines = preview(source, 60, 15, ascii_only=ascii_only).splitlines()
    *picture, legend = lines
    assert len(picture) <= 15
    assert max(map(len, picture)) <= 60
    assert sum(line.count("S") for line in picture) == 1
    assert sum(line.count("E") for line in picture) == 1
    assert any("+" in line for line in picture)
    assert "one character" in legend
    assert not ascii_only or "\n".join(lines).isascii()


def test_preview_is_to_scale() -> None:
    """paper-line: 45 x 12 m, y up: the first landmark stands above the start, the second below."""
    lines = preview(build("paper-line"), 70, 20).splitlines()[:-1]
    start = next(i for i, line in enumerate(lines) if "S" in line)
    above, below = lines[0], lines[-1]
    assert above.count("+") == 3
    assert below.count("+") == 2
    assert above.index("+") == pytest.approx(5 / 45 * 70, abs=1)
    assert start == pytest.approx(len(lines) / 2, abs=1)
    assert len(lines) * 2 == pytest.approx(12 / 45 * 70, abs=2)


def test_the_loop_leaves_known_ground_and_returns() -> None:
    """Nothing that is seen at the start is in sight for 40 m of the lap; in the end all that is seen is known."""
    source = build("loop")
    first = set(source.steps[0].frame.tags)
    seen = [set(step.frame.tags) for step in source.steps]
    lap = round(len(seen) / 1.3)
    metres = 0.8 * 0.5
    blind = longest = 0.0
    for tags in seen[:lap]:
        blind = blind + metres if not first & tags else 0.0
        longest = max(longest, blind)
    assert longest > 40.0
    assert set().union(*seen[lap:]) <= set().union(*seen[: lap // 3], *seen[lap - 20 : lap])
    assert first <= set().union(*seen[lap:])
