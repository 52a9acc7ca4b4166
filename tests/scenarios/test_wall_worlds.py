"""Every world of walls: exact, passable, and what its options promise."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from scenarios.floorplan import Doors, ring_corridor, straight_corridor
from scenarios.laser import walls_in_view
from scenarios.noise import add_noise
from scenarios.preview import preview, world_row
from scenarios.registry import build, scenario, worlds
from scenarios.route import drive
from scenarios.simulate import increments, simulate
from scenarios.types import Source, SourceError
from scenarios.world import lengths
from slam.features import Wall
from slam.motion import Odometry
from slam.presets import BUILDING
from slam.types import UNKNOWN_TAG

WORLDS = [name for name, entry in worlds().items() if "walls" in entry.features]

VARIANTS: list[tuple[str, dict[str, Any]]] = [
    *((name, {}) for name in WORLDS),
    *(("corridor", {"length": 30.0, "doors": doors}) for doors in ("open", "rooms", "none")),
    ("corridor", {"length": 20.0, "recess": 0.0, "doors": "rooms", "far_end": "open", "view_deg": 360.0}),
    *(("loop", {"laps": 1.1, "doors": doors}) for doors in ("open", "rooms", "none")),
    ("loop", {"laps": 2.3, "width": 3.0, "length": 12.0, "depth": 8.0, "door_spacing": 3.0, "doors": "rooms"}),
    ("rotation-then-corridor", {"turn_deg": -200.0, "lobby_walls": "none", "doors": "open"}),
    ("rotation-then-corridor", {"lobby": 0.0, "length": 20.0, "far_end": "open"}),
    *(("hospital", {"layout_seed": seed, "visits": 10}) for seed in range(3)),
    ("hospital", {"length": 20.0, "depth": 24.0, "room_width": 3.0, "visits": 0, "laps": 0.4}),
    *(("hall", {"layout_seed": seed}) for seed in range(1, 4)),
    ("hall", {"booths": 0, "pillars": 0, "people": 0, "laps": 0.5, "margin": 7.0}),
]

by_variant = pytest.mark.parametrize(
    ("name", "options"), VARIANTS, ids=[" ".join([n, *map(str, o.values())]) for n, o in VARIANTS]
)


def dead_reckoning(source: Source, seed: int | None = None) -> np.ndarray:
    """(S + 1, 3) poses, with the noise of a seed or with none."""
    rng = np.random.default_rng(seed)
    frames = [step.frame if seed is None else add_noise(rng, step.frame, source.noise) for step in source.steps]
    u, dt = np.concatenate([frame.u for frame in frames]), np.concatenate([frame.dt for frame in frames])
    return drive(source.motion, source.start, u, dt)


def true_path(source: Source) -> np.ndarray:
    return np.array([source.start, *(step.truth for step in source.steps)])


@by_variant
def test_a_wall_world_is_what_it_should_be(name: str, options: dict[str, Any]) -> None:
    source = build(name, **options)
    assert source.warnings == ()  # the robot drives through no wall
    assert isinstance(source.motion, Odometry)
    assert source.true_map is not None
    tags, theta = source.true_map
    if options.get("doors") != "open" and options.get("width") != 3.0:  # backs are seen through doors and small rooms
        assert tags.tolist() == list(range(len(theta)))
    assert theta.shape == (len(tags), 4)
    assert lengths(theta).min() > 0.05
    elapsed = 0.0
    for frame, _ in source.steps:
        elapsed += frame.dt.sum()
        assert frame.time == pytest.approx(elapsed, abs=1e-9)
        assert isinstance(frame.feature, Wall)
        assert (frame.u.shape, frame.dt.shape) == ((1, 3), (1,))
        assert (frame.z.shape, frame.tags.shape) == ((0, 11), (0,))
        assert frame.scan is not None
        assert frame.scan.walls is not None
        assert frame.scan.max_range == source.max_range
        assert (frame.scan.ranges[np.isfinite(frame.scan.ranges)] <= source.max_range).all()
        if name != "hall":
            np.testing.assert_array_equal(frame.scan.walls == UNKNOWN_TAG, np.isinf(frame.scan.ranges))
    poses, truth = dead_reckoning(source), true_path(source)
    np.testing.assert_allclose(poses[:, :2], truth[:, :2], atol=1e-9, rtol=0)
    turned = poses[:, 2] - truth[:, 2]
    np.testing.assert_allclose((turned + math.pi) % (2 * math.pi) - math.pi, 0, atol=1e-9)


@pytest.mark.parametrize("name", WORLDS)
def test_the_end_of_every_beam_is_on_its_wall(name: str) -> None:
    source = build(name)
    assert source.true_map is not None
    theta = source.true_map.theta
    for frame, truth in source.steps[::20]:
        assert frame.scan is not None
        assert frame.scan.walls is not None
        assert truth is not None
        hit = frame.scan.walls != UNKNOWN_TAG
        angle, reading, wall = truth[2] + frame.scan.bearings[hit], frame.scan.ranges[hit], theta[frame.scan.walls[hit]]
        end = truth[:2] + reading[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        off = np.hypot(*(end - wall[:, :2]).T) + np.hypot(*(end - wall[:, 2:]).T) - lengths(wall)
        np.testing.assert_allclose(off, 0, atol=1e-8)


def test_increments_count_whole_turns() -> None:
    path = np.array([[0, 0, 0.0], [1, 0, 2.5], [1, 0, -1.3], [1, 0, 1.2], [1, 0, 2.0]])
    moved = increments(path, 2)
    np.testing.assert_allclose(moved[:, 2], [2 * math.pi - 1.3, 3.3], atol=1e-12)
    np.testing.assert_allclose(moved[:, :2], [[1, 0], [0, 0]], atol=1e-12)


@pytest.mark.parametrize("name", WORLDS)
def test_odometry_is_metres_off(name: str) -> None:
    source = build(name)
    assert 150 <= len(source.steps) <= 500
    assert np.median(np.diff([step.frame.time for step in source.steps])) == pytest.approx(0.5)
    truth = true_path(source)[-1]
    errors = [math.dist(dead_reckoning(source, seed)[-1, :2], truth[:2]) for seed in range(10)]
    assert 1.5 < np.median(errors) < 6.0, errors


def test_loop_is_about_100_m_and_comes_back() -> None:
    source = build("loop")
    path = true_path(source)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    back = next(i for i in range(150, len(path)) if math.dist(path[i, :2], path[0, :2]) < 0.5)
    assert 95 < driven[back] < 102
    assert driven[-1] - driven[back] > 25
    views = [set(walls_in_view(step.frame.scan).tolist()) for step in source.steps if step.frame.scan]
    assert all(view <= set().union(*views[: back - 60]) for view in views[back:])
    twice = build("loop", laps=2.0)
    assert len(twice.steps) == pytest.approx(2 * 0.77 * len(source.steps), rel=0.03)


def test_where_the_loop_starts() -> None:
    """Before the first corner, where its last wall is in sight."""
    assert build("loop").start.tolist() == [9.0, 0.0, 0.0]
    assert build("loop", start=2.5).start.tolist() == [12.5, 0.0, 0.0]
    assert build("loop", features="landmarks").start.tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(SourceError, match=r"start is 0\.5.*expected"):
        build("loop", start=0.5)


def test_worlds_of_walls_believe_what_suits_walls() -> None:
    for name in WORLDS:
        assert build(name).defaults == BUILDING
    assert build("corridor", features="landmarks").defaults == {}
    own = dataclasses.replace(scenario("corridor"), defaults={"temper": 0.5})
    assert simulate(own).defaults == {**BUILDING, "temper": 0.5}


def test_loop_has_something_to_see_all_the_way() -> None:
    for step in build("loop").steps:
        assert step.frame.scan is not None
        assert np.isfinite(step.frame.scan.ranges).mean() > 0.5


def test_rotation_sees_nothing_until_it_is_over() -> None:
    for options in ({}, {"view_deg": 360.0}, {"lobby_walls": "none"}):
        source = build("rotation-then-corridor", **options)
        turning = [step.frame for step in source.steps if np.hypot(*step.frame.u[0, :2]) < 1e-12]
        assert len(turning) == 24  # 360 degrees at 30 degrees/s, a scan every 0.5 s
        assert sum(frame.u[0, 2] for frame in turning) == pytest.approx(2 * math.pi)
        assert all(np.isinf(frame.scan.ranges).all() for frame in turning if frame.scan)
        seeing = [bool(np.isfinite(step.frame.scan.ranges).any()) for step in source.steps if step.frame.scan]
        assert np.mean(seeing) > 0.8


def test_a_corridor_without_doors_and_end_says_nothing_about_the_way_along() -> None:
    source = build("corridor", doors="none", far_end="open")
    assert source.true_map is not None
    np.testing.assert_array_equal(source.true_map.theta[:, [1, 3]], [[1, 1], [-1, -1]])
    scans = [step.frame.scan for step in source.steps if step.frame.scan]
    middle = scans[len(scans) // 2]
    for other in scans[5 : len(scans) - 20]:
        np.testing.assert_allclose(other.ranges, middle.ranges, atol=1e-9)


def test_hospital_enters_rooms() -> None:
    """As many as asked: the robot leaves the corridors so often, and sees the four walls of a room from inside."""
    for visits in (0, 2, 5):
        path = true_path(build("hospital", visits=visits))
        outside = np.maximum(np.abs(path[:, 0]) - 18.0, np.abs(path[:, 1] - 7.0) - 7.0)
        away = (outside > 1.3) | (outside < -1.3)
        assert np.count_nonzero(np.diff(away.astype(int)) == 1) == visits
    perimeter = 2 * (36.0 + 14.0)
    assert perimeter == 100.0
    assert world_row(build("hospital", visits=0, laps=1.0)).route == pytest.approx(perimeter, abs=0.5)


def test_people_hide_walls() -> None:
    with_people, without = build("hall"), build("hall", people=0)
    hidden = total = 0
    for step, empty in zip(with_people.steps, without.steps, strict=True):
        a, b = step.frame.scan, empty.frame.scan
        assert a is not None
        assert b is not None
        assert a.walls is not None
        changed = a.ranges != b.ranges
        assert (a.walls[changed] == UNKNOWN_TAG).all()
        assert (a.ranges[changed] < b.ranges[changed]).all()
        hidden, total = hidden + np.count_nonzero(changed), total + len(changed)
    assert 0.005 < hidden / total < 0.3
    assert all(
        (step.frame.scan.ranges == again.frame.scan.ranges).all()
        for step, again in zip(with_people.steps, build("hall").steps, strict=True)
        if step.frame.scan and again.frame.scan
    )


def test_doors_leave_the_walls_between_them() -> None:
    """One leaf and two jambs for each closed door; the posts stand where the corridor's face is interrupted."""
    plan = straight_corridor(2.0, 20.0, 3.0, Doors(spacing=5.0, width=1.0, kind="closed", recess=0.2))
    walls = plan.walls.reshape(-1, 2, 2)
    faces = walls[(np.abs(walls[:, :, 1]) == 1.5).all(axis=1)]
    leaves = walls[np.isclose(np.abs(walls[:, :, 1]), 1.7).all(axis=1)]
    assert len(leaves) == len(plan.posts) == 7
    assert len(walls) == len(faces) + 3 * len(leaves)
    np.testing.assert_allclose(lengths(leaves.reshape(-1, 4)), 1.0)
    assert lengths(faces.reshape(-1, 4)).sum() == pytest.approx(40.0 - 7.0)
    for post in plan.posts:
        assert any(np.allclose(end, post) for wall in faces for end in wall)


@pytest.mark.parametrize("kind", ["closed", "open", "rooms", "none"])
def test_whoever_sees_a_wall_is_to_the_left_of_it(kind: Any) -> None:
    """As `slam.features.wall` has it; seen by a robot in the corridor, whatever is behind the doors."""
    source = build("loop", doors=kind, laps=1.0)
    assert source.true_map is not None
    theta = dict(zip(*source.true_map, strict=True))
    for frame, truth in source.steps[::10]:
        assert frame.scan is not None
        assert truth is not None
        for wall in (theta[tag] for tag in walls_in_view(frame.scan)):
            d, to = wall[2:] - wall[:2], truth[:2] - wall[:2]
            assert d[0] * to[1] - d[1] * to[0] > 0


def test_rooms_of_a_small_ring_stay_in_their_block() -> None:
    plan = ring_corridor(12.0, 8.0, 2.0, Doors(spacing=3.0, width=0.9, kind="rooms", recess=0.1))
    inside = (np.abs(plan.walls[:, [0, 2]]) < 5.0 - 1e-9).all(axis=1)
    inside &= (np.abs(plan.walls[:, [1, 3]] - 4.0) < 3.0 - 1e-9).all(axis=1)
    assert inside.sum() > 20


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("ascii_only", [True, False])
def test_preview(name: str, ascii_only: bool) -> None:
    *picture, legend = preview(build(name), 60, 15, ascii_only=ascii_only).splitlines()
    text = "".join(picture)
    assert len(picture) <= 15
    assert max(map(len, picture)) <= 60
    assert (text.count("S"), text.count("E")) == (1, 1)
    route = "." if ascii_only else "·"
    assert text.count(route) >= 5
    assert f"{route} route between walls" in legend
    assert sum(c == "#" or 0x2800 < ord(c) <= 0x28FF for c in text) > 40
    assert not ascii_only or text.isascii()


def test_a_row_of_the_table() -> None:
    row = world_row(build("corridor", doors="none", length=60.0))
    assert (row.things, row.what, row.steps) == (3, "walls", 135)
    assert row.route == pytest.approx(54.0)
    assert 2.0 <= row.visible < 2.5


@pytest.mark.parametrize(
    ("name", "options", "parts"),
    [
        ("loop", {"beams": 0}, ["loop: beams is 0", "at least 1"]),
        ("loop", {"beams": 2.5}, ["beams is 2.5", "a whole number"]),
        ("loop", {"view_deg": 0.0}, ["view_deg is 0.0", "above 0"]),
        ("loop", {"max_range": -1.0}, ["max_range is -1.0", "above 0.01"]),
        ("loop", {"recess": -0.1}, ["recess is -0.1", "at least 0"]),
        ("loop", {"doors": "shut"}, ["doors is 'shut'", "closed, open, rooms, none"]),
        ("corridor", {"length": 6.0}, ["corridor: length is 6", "expected above 6 m"]),
        ("rotation-then-corridor", {"lobby": 0.0, "length": 4.0}, ["length is 4", "expected above 5 m"]),
        ("hospital", {"visits": 99}, ["visits is 99; expected at most"]),
        ("hospital", {"visits": -1}, ["visits is -1"]),
        ("hospital", {"room_width": 1.0}, ["room_width is 1", "room for a door"]),
        ("hospital", {"depth": 5.0}, ["length and depth are 36 and 5", "two rows of rooms"]),
        ("hall", {"pillars": 900}, ["so many do not fit into the hall"]),
        ("hall", {"booth": 40.0}, ["40 m does not fit into the hall"]),
        ("hall", {"margin": 14.0}, ["margin is 14", "expected at most 13 m"]),
        ("hall", {"people": -1}, ["people is -1"]),
        ("hall", {"people": 1_000_000}, ["people is 1000000", "at most 1000"]),
        ("hall", {"layout_seed": -1}, ["layout_seed is -1"]),
    ],
)
def test_what_cannot_be_built(name: str, options: dict[str, Any], parts: list[str]) -> None:
    with pytest.raises(SourceError) as caught:
        build(name, **options)
    assert all(part in str(caught.value) for part in parts), str(caught.value)
    assert "\n" not in str(caught.value)


def test_landmarks_and_walls_are_the_same_building() -> None:
    """A landmark stands where the frame of a door begins."""
    for name in ("corridor", "loop", "rotation-then-corridor"):
        points = scenario(name, features="landmarks").world.landmarks.theta
        ends = scenario(name).world.walls.theta.reshape(-1, 2)
        gaps = np.hypot(*(points[:, None] - ends[None]).transpose(2, 0, 1)).min(axis=1)
        assert gaps.max() < 1e-9
