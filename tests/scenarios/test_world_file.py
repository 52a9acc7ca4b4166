"""World files: the same bits back, and an error that says where and what for everything else."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenarios.laser import Laser
from scenarios.paper_line import LAYOUTS
from scenarios.preview import world_row
from scenarios.registry import build, scenario, worlds
from scenarios.simulate import simulate
from scenarios.toml_table import Table
from scenarios.types import Source, SourceError
from scenarios.world import World, world_of_points, world_of_walls
from scenarios.world_file import read_scenario, read_world, world_text, write_world
from slam.motion import Ackermann, Odometry
from slam.types import UNKNOWN_TAG, Noise

GOOD = """\
title = "two trees"

[route]
speed = 0.8
waypoints = [[0, 0], [10.0, 0], [10, 8]]

[sensor]
max_range = 10
every = 5

[noise]
speed = 0.1
turn_deg = 3
range = 0.02
bearing_deg = 0.5

[landmarks]
points = [[5, 3], [12, 4.5]]

[defaults]
particles = 20
association = "known"
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "yard.toml"
    path.write_text(text, encoding="utf-8")
    return path


def assert_same(a: Source, b: Source) -> None:
    """Bit by bit, except for the options that made them."""
    assert (a.name, a.title, a.motion, a.noise, a.max_range, a.defaults) == (
        b.name,
        b.title,
        b.motion,
        b.noise,
        b.max_range,
        b.defaults,
    )
    np.testing.assert_array_equal(a.start, b.start)
    assert a.true_map is not None
    assert b.true_map is not None
    np.testing.assert_array_equal(a.true_map.tags, b.true_map.tags)
    np.testing.assert_array_equal(a.true_map.theta, b.true_map.theta)
    for (f, s), (g, t) in zip(a.steps, b.steps, strict=True):
        assert f.time == g.time
        assert s is not None
        assert t is not None
        scans = zip(f.scan or (), g.scan or (), strict=True)
        for x, y in ((f.u, g.u), (f.dt, g.dt), (f.z, g.z), (f.tags, g.tags), (s, t), *scans):
            x, y = np.asarray(x), np.asarray(y)
            np.testing.assert_array_equal(x, y)
            assert x.dtype == y.dtype


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, {}) for name in worlds()),
        *(("paper-line", {"layout": layout, "vehicle": "ackermann"}) for layout in LAYOUTS),
        *((name, {"features": "landmarks"}) for name in ("corridor", "loop", "rotation-then-corridor")),
        ("rotation-then-corridor", {"turn_deg": 123.456789, "turn_rate_deg": 31.7, "features": "landmarks"}),
        ("rotation-then-corridor", {"turn_deg": 12.3456789, "turn_rate_deg": 31.7, "view_deg": 271.3}),
        ("loop", {"laps": 1.0 / 3.0, "width": 1.9, "features": "landmarks"}),
        ("loop", {"laps": 1.0 / 3.0, "width": 1.9, "beams": 77, "doors": "open"}),
        ("field", {"landmarks": 200, "length": 55.5}),
    ],
)
def test_built_in_worlds_come_back_with_the_same_bits(tmp_path: Path, name: str, options: dict[str, object]) -> None:
    path = tmp_path / "copy.toml"
    write_world(path, scenario(name, **options))
    assert_same(build(name, **options), build(str(path)))
    assert world_text(read_scenario(path)) == path.read_text(encoding="utf-8")


@pytest.mark.parametrize("turn", [1.5, math.pi / 3, 1.2345678901234567, 1.9, 0.1, 1e-9])
def test_angles_keep_their_bits(tmp_path: Path, turn: float) -> None:
    """Some radians are no number of degrees in floating point; they are written as radians."""
    made = scenario("rotation-then-corridor")
    made = replace(made, route=replace(made.route, start_turn=turn), noise=replace(made.noise, bearing=turn))
    path = tmp_path / "turned.toml"
    write_world(path, made)
    assert_same(simulate(made), read_world(path))


def test_a_scenario_of_walls_keeps_its_bits(tmp_path: Path) -> None:
    made = scenario("hall", people=3)
    made = replace(
        made,
        route=replace(made.route, wait=1.7),
        sensor=Laser(
            beams=33, field_of_view=1.2345678901234567, max_range=math.inf, every=7, origin=(0.1, -0.2, 1 / 3)
        ),
        noise=Noise(speed=0.1, turn=1 / 3, range=0.012, bearing=0.1, odometry=0.07, missing=0.01),
        defaults={"temper": 0.1},
    )
    path = tmp_path / "hall.toml"
    write_world(path, made)
    assert_same(simulate(made), read_world(path))


def test_landmarks_and_walls_in_one_world(tmp_path: Path) -> None:
    """The sensor tells which are seen; the others are kept."""
    both = World(world_of_points([(5, 3), (12, 4.5)]).landmarks, world_of_walls([(0, 2, 9, 2)]).walls)
    made = replace(read_scenario(write(tmp_path, GOOD)), world=both)
    for sensor in (made.sensor, Laser()):
        path = tmp_path / "both.toml"
        write_world(path, replace(made, sensor=sensor))
        copy = read_scenario(path)
        np.testing.assert_array_equal(copy.world.landmarks.theta, both.landmarks.theta)
        np.testing.assert_array_equal(copy.world.walls.theta, both.walls.theta)
        source = read_world(path)
        assert source.true_map is not None
        assert source.true_map.theta.shape[1] == (4 if isinstance(sensor, Laser) else 2)
        assert source.warnings == ()


WALLS = """\
[route]
speed = 0.8
waypoints = [[0, 0], [10.0, 0]]

[laser]
max_range = 8

[noise]
range = 0.01
odometry = 0.1

[walls]
segments = [[-2, 1, 12, 1], [-2, -1, 12, -1.5]]
"""


def test_a_world_of_walls_of_ones_own(tmp_path: Path) -> None:
    source = read_world(write(tmp_path, WALLS))
    assert (source.motion, source.max_range, source.warnings) == (Odometry(), 8.0, ())
    assert source.noise == Noise(range=0.01, odometry=0.1)
    scan = source.steps[0].frame.scan
    assert scan is not None
    assert scan.walls is not None
    assert len(scan.ranges) == 181
    assert set(scan.walls.tolist()) == {2, 1, -1}
    around = WALLS.replace("max_range = 8", "max_range = 8\nfield_of_view_deg = 360\nbeams = 360\norigin = [0.2, 0]")
    scan = read_world(write(tmp_path, around)).steps[0].frame.scan
    assert scan is not None
    assert np.degrees(scan.bearings[-1] - scan.bearings[0]) == pytest.approx(359)
    assert scan.origin.tolist() == [0.2, 0.0, 0.0]
    quiet = read_world(write(tmp_path, WALLS.replace("range = 0.01", "range = 0")))
    assert quiet.warnings == ("noise.range is 0: let the filters believe in more than that",)


def test_a_robot_that_waits(tmp_path: Path) -> None:
    source = read_world(write(tmp_path, WALLS.replace("speed = 0.8", "speed = 0.8\nwait = 3600")))
    assert len(source.steps) == 7225


def test_walls_are_counted_as_they_are_drawn(tmp_path: Path) -> None:
    """One that is seen from both sides is two features of a map, but one wall."""
    around = "waypoints = [[0, 0], [10, 0], [10, 4], [0, 4]]"
    one = WALLS.replace("waypoints = [[0, 0], [10.0, 0]]", around).replace(
        "[[-2, 1, 12, 1], [-2, -1, 12, -1.5]]", "[[2, 2, 6, 2]]"
    )
    source = read_world(write(tmp_path, one))
    assert source.true_map is not None
    assert len(source.true_map.tags) == 2
    assert world_row(source).things == 1
    assert world_row(read_world(write(tmp_path, WALLS))).things == 2
    with pytest.raises(SourceError, match=r"route: the only wall never comes into view, with laser\.max_range 0\.5 m"):
        read_world(write(tmp_path, one.replace("max_range = 8", "max_range = 0.5")))


def test_walls_in_the_way_are_a_warning(tmp_path: Path) -> None:
    text = WALLS.replace("[-2, 1, 12, 1]", "[3, 1, 3, -1]")
    [warning] = read_world(write(tmp_path, text)).warnings
    assert "walls.segments[0], from (3, 1) to (3, -1), is in the way" in warning


PEOPLE = "[movers]\npaths = [[0, 0, 1, 1]]\nspeeds = [1]\noffsets = [0]\nradii = [0.2]\n[walls]"
contains = Table.__contains__

BAD_WALLS = [
    ("segments = [[-2, 1, 12, 1], [-2, -1, 12, -1.5]]", "segments = []", 13, ["walls.segments: there are 0"]),
    ("[-2, 1, 12, 1]", "[3, 4, 3, 4]", 13, ["walls.segments[0] is [3, 4, 3, 4], a wall of no length"]),
    ("-1.5]", "inf]", 13, ["walls.segments[1] is [-2, -1, 12, inf]", "finite metres"]),
    ("[-2, 1, 12, 1]", "[3, 4, 3]", 13, ["walls.segments[0] is [3, 4, 3]", "4 numbers, [x0, y0, x1, y1]"]),
    ("[-2, 1, 12, 1]", '"a wall"', 13, ["walls.segments[0] is 'a wall'"]),
    ("[walls]", "[wals]", None, ["walls is missing", "'wals' is there", "[walls]"]),
    ("segments", "segment", 12, ["walls.segments is missing", "'segment' is there"]),
    ("[laser]", "[lasr]", None, ["sensor is missing", "[sensor] or [laser]"]),
    ("[laser]", "[sensor]\nmax_range = 3\n[laser]", 7, ["laser and sensor are both there"]),
    ("max_range = 8\n", "", 5, ["laser.max_range is missing"]),
    ("max_range = 8", "max_range = 0", 6, ["laser.max_range is 0", "above 0.01"]),
    ("max_range = 8", "max_range = 8\nbeams = 0", 7, ["laser.beams is 0", "at least 1"]),
    ("max_range = 8", "max_range = 8\nbeams = 1.5", 7, ["laser.beams is 1.5", "whole number"]),
    ("max_range = 8", "max_range = 8\nfield_of_view_deg = 361", 7, ["laser.field_of_view_deg is 361", "at most 360"]),
    ("max_range = 8", "max_range = 8\nfield_of_view_deg = 0", 7, ["laser.field_of_view_deg is 0", "above 0"]),
    ("max_range = 8", "max_range = 8\nevery = 0", 7, ["laser.every is 0"]),
    ("max_range = 8", "max_range = 8\nevery = 1000", 7, ["laser.every is 1000", "only 125 control ticks"]),
    ("max_range = 8", "max_range = 8\norigin = [0.1]", 7, ["laser.origin is [0.1]", "2 numbers"]),
    ("max_range = 8", "max_range = 8\nbeam = 3", 7, ["laser.beam is not a known key", "'beams'"]),
    ("max_range = 8", "max_range = 0.5", 1, ["none of the 2 walls comes into view", "laser.max_range 0.5 m"]),
    ("odometry = 0.1\n", "", 8, ["noise.odometry is missing"]),
    ("odometry = 0.1", "odometry = 0.1\nmissing = 2", 11, ["noise.missing is 2", "at most 1"]),
    ("odometry = 0.1", "odometry = -0.1", 10, ["noise.odometry is -0.1", "at least 0"]),
    ("speed = 0.8", "speed = 0.8\nwait = -1", 3, ["route.wait is -1", "at least 0"]),
    (
        "[walls]",
        "[movers]\npaths = [[0, 0, 1, 1]]\n[walls]",
        12,
        ["movers.speeds is missing; expected a list of 1 number"],
    ),
    ("[walls]", "[movers]\npaths = []\n[walls]", 13, ["movers.paths is []", "or no table [movers]"]),
    (
        "[walls]",
        "[movers]\npaths = [[0, 0, 1, 1]]\nspeeds = [1, 2]\n[walls]",
        14,
        ["movers.speeds is [1, 2]; expected 1 number"],
    ),
    (
        "[walls]",
        "[movers]\npaths = [[0, 0, 1, 1]]\nspeeds = [1]\noffsets = [0]\nradii = [0]\n[walls]",
        16,
        ["movers.radii[0] is 0.0", "above 0"],
    ),
]


@pytest.mark.parametrize(
    ("old", "new", "line", "parts"), BAD_WALLS, ids=[f"{i}-{bad[1][-20:]}" for i, bad in enumerate(BAD_WALLS)]
)
def test_what_is_wrong_with_walls_is_said(
    tmp_path: Path, old: str, new: str, line: int | None, parts: list[str]
) -> None:
    assert WALLS.count(old) == 1
    path = write(tmp_path, WALLS.replace(old, new))
    with pytest.raises(SourceError) as caught:
        read_world(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: " if line is None else f"{path}:{line}: ")
    assert all(part in message for part in parts), message
    assert "expected" in message or "did you mean" in message
    assert "\n" not in message


def test_titles_are_quoted(tmp_path: Path) -> None:
    made = replace(scenario("corridor"), title='a "quoted" \\ title,\nwith\ta tab, é and \x7f')
    path = tmp_path / "quoted.toml"
    write_world(path, made)
    assert read_scenario(path).title == made.title


def test_a_world_of_ones_own(tmp_path: Path) -> None:
    source = read_world(write(tmp_path, GOOD))
    assert (source.name, source.title, source.kind) == ("yard", "two trees", "world")
    assert source.params().particles == 20
    assert source.noise.bearing == math.radians(0.5)
    assert source.true_map is not None
    assert source.true_map.tags.tolist() == [0, 1]
    truth = source.steps[-1].truth
    assert truth is not None
    assert math.dist(truth[:2], (10, 8)) < 0.45  # stops between two observations


def test_defaults_come_back(tmp_path: Path) -> None:
    made = replace(scenario("corridor"), defaults={"floor_angle": math.radians(0.1), "orthogonal": True})
    path = tmp_path / "defaults.toml"
    write_world(path, made)
    assert read_scenario(path).defaults == made.defaults


def test_a_perfect_sensor_is_a_warning(tmp_path: Path) -> None:
    assert read_world(write(tmp_path, GOOD)).warnings == ()
    [warning] = read_world(write(tmp_path, GOOD.replace("range = 0.02", "range = 0"))).warnings
    assert "noise.range is 0" in warning


def test_an_ackermann_world(tmp_path: Path) -> None:
    text = '[vehicle]\nkind = "ackermann"\nwheelbase = 1.5\n' + GOOD.replace(
        "speed = 0.8", "speed = 0.8\ncorner_radius = 3"
    )
    source = read_world(write(tmp_path, text.replace('title = "two trees"\n', "")))
    assert source.motion == Ackermann(1.5, 1.5, 0.0)


def test_random_landmarks(tmp_path: Path) -> None:
    def points(random: str) -> np.ndarray:
        text = GOOD.replace("[landmarks]\npoints = [[5, 3], [12, 4.5]]", f"[landmarks.random]\n{random}")
        true_map = read_world(write(tmp_path, text)).true_map
        assert true_map is not None
        return true_map.theta

    area = "area = [0, -5, 20, 15]\n"
    some = points(f"number = 30\nspacing = 1.5\n{area}")
    assert some.shape == (30, 2)
    assert (some >= [0, -5]).all()
    assert (some <= [20, 15]).all()
    np.testing.assert_array_equal(some, points(f"number = 30\nspacing = 1.5\nseed = 0\n{area}"))
    assert len(points(f"density = 0.1\n{area}")) == 40
    around = points("number = 300")
    assert (around >= -10).all()
    assert (around <= [20, 18]).all()


BAD = [
    # what is replaced, by what, parts of the message
    ("speed = 0.8", "speed = = 0.8", ["line 4", "column"]),
    ("[route]", "[route", ["line 3"]),
    ("[[5, 3], [12, 4.5]]", "[[5, 3], [12, 4.5]", ["line 20"]),
    ("speed = 0.8", "speed = 0.8\nspeed = 0.9", ["line 5", "overwrite"]),
    ("speed = 0.8\n", "", ["route.speed is missing", "a number"]),
    ("speed = 0.8", "sped = 0.8", ["route.speed is missing", "'sped' is there"]),
    ("max_range = 10\n", "", ["sensor.max_range is missing"]),
    ("turn_deg = 3\n", "", ["noise.turn_deg is missing"]),
    ("points = [[5, 3], [12, 4.5]]\n", "", ["landmarks.points is missing", "a list of [x, y]"]),
    ("[route]", "[rout]", ["route is missing", "'rout' is there", "[route]"]),
    ("every = 5", "evry = 5", ["sensor.evry is not a known key", "'every'"]),
    ("every = 5", "beams = 181", ["sensor.beams is not a known key", "max_range"]),
    ("title =", "colour = 3\ntitle =", ["colour is not a known key"]),
    ("[defaults]", "[defults]", ["defults is not a known key", "'defaults'"]),
    ("particles = 20", "particle = 20", ["defaults.particle ", "'particles'"]),
    ("particles = 20", "believed = 20", ["defaults.believed is not a known key"]),
    ("speed = 0.8", 'speed = "fast"', ["route.speed is 'fast'", "a number"]),
    ("speed = 0.8", "speed = true", ["route.speed is True", "a number"]),
    ("speed = 0.8", "speed = 0", ["route.speed is 0.0", "above 0", "[m/s]"]),
    ("speed = 0.8", "speed = -1", ["route.speed is -1.0", "above 0"]),
    ("speed = 0.8", "speed = nan", ["route.speed is nan", "finite"]),
    ("speed = 0.8", "speed = inf", ["route.speed is inf", "at most"]),
    ("speed = 0.8", "speed = 1" + "0" * 400, ["route.speed is an enormous number"]),
    ("speed = 0.8", "speed = 1e-9", ["control ticks", "at most 2000000"]),
    ("[[0, 0], [10.0, 0], [10, 8]]", "[[0, 0], [0.3, 0]]", ["sensor.every is 5", "only 4 control ticks"]),
    ("speed = 0.8", "speed = 0.8\ntick = 0", ["route.tick is 0.0", "above 0"]),
    ("speed = 0.8", "speed = 0.8\ncorner_radius = 9", ["route.corner_radius is 9", "no room"]),
    ("speed = 0.8", "speed = 0.8\nturn_rate_deg = 0", ["route.turn_rate_deg is 0", "above 0"]),
    ("speed = 0.8", "speed = 0.8\nturn_rate_deg = 9\nturn_rate_rad = 1", ["both", "route.turn_rate_deg"]),
    ("[[0, 0], [10.0, 0], [10, 8]]", "[]", ["route.waypoints", "leads nowhere with 0 waypoints"]),
    ("[[0, 0], [10.0, 0], [10, 8]]", "[[1, 1], [1, 1], [1, 1]]", ["route.waypoints", "two or more that differ"]),
    ("[[0, 0], [10.0, 0], [10, 8]]", "[[0, 0], [10]]", ["route.waypoints[1] is [10]", "[x, y]"]),
    ("[[0, 0], [10.0, 0], [10, 8]]", "[0, 0]", ["route.waypoints[0] is 0"]),
    ("[[0, 0], [10.0, 0], [10, 8]]", '"home"', ["route.waypoints is 'home'", "a list of [x, y]"]),
    ("[[0, 0], [10.0, 0], [10, 8]]", "[[0, 0], [inf, 0]]", ["waypoint 2 is (inf, 0)", "finite"]),
    ("[[0, 0], [10.0, 0], [10, 8]]", "[[0, 0], [nan, 0]]", ["route.waypoints[1] is nan", "finite"]),
    ("[[5, 3], [12, 4.5]]", "[]", ["landmarks: there are 0"]),
    ("[[5, 3], [12, 4.5]]", "[[5, 1e300]]", ["landmark 1 is at (5, 1e+300)"]),
    ("[[5, 3], [12, 4.5]]", "[[5, 300]]", ["the only landmark never comes", "max_range 10 m", "route past landmarks"]),
    ("4.5]]", "4.5]]\ntags = [3, 3]", ["landmarks.tags: 3 is there 2 times"]),
    ("4.5]]", "4.5]]\ntags = [3]", ["landmarks.tags: there are 1", "each of the 2"]),
    ("4.5]]", "4.5]]\ntags = [-1, 2]", ["landmarks.tags: -1 is negative"]),
    ("4.5]]", "4.5]]\ntags = [1, 2.5]", ["landmarks.tags[1] is 2.5", "whole"]),
    ("4.5]]", "4.5]]\ntags = [1, 9007199254740992]", ["landmarks.tags", "9007199254740992 is too large"]),
    ("4.5]]", "4.5]]\n[landmarks.random]\nnumber = 3", ["landmarks.points is not a known key"]),
    ("points = [[5, 3], [12, 4.5]]", "random.seed = 3", ["landmarks.random.number is missing"]),
    ("points = [[5, 3], [12, 4.5]]", "random.number = 0", ["landmarks.random: number is 0"]),
    ("points = [[5, 3], [12, 4.5]]", "random.number = 3000000", ["number is 3000000", "at most 1e+06"]),
    (
        "points = [[5, 3], [12, 4.5]]",
        "random = { density = 0.1, area = [-inf, 0, inf, 9] }",
        ["random", "area is [-inf"],
    ),
    ("points = [[5, 3], [12, 4.5]]", "random = { number = 900, spacing = 2 }", ["landmarks.random", "do not fit"]),
    ("points = [[5, 3], [12, 4.5]]", "random = { number = 9, area = [0, 0, 0, 9] }", ["area", "room inside"]),
    ("points = [[5, 3], [12, 4.5]]", "random = { number = 9, area = [0, 0] }", ["area is [0, 0]", "4 numbers"]),
    ("points = [[5, 3], [12, 4.5]]", "random = { density = -1 }", ["density is -1.0", "above 0"]),
    ("points = [[5, 3], [12, 4.5]]", "random = { number = 9, seed = -1 }", ["seed is -1"]),
    ("max_range = 10", "max_range = 0", ["sensor.max_range is 0.0", "above"]),
    ("every = 5", "every = 0", ["sensor.every is 0", "at least 1"]),
    ("every = 5", "every = 2.5", ["sensor.every is 2.5", "a whole number"]),
    ("every = 5", "every = 100000", ["sensor.every is 100000", "at least one observation"]),
    ("every = 5", "field_of_view_deg = 400", ["sensor.field_of_view_deg is 400", "at most 360", "degrees"]),
    ("every = 5", "field_of_view_deg = 0", ["sensor.field_of_view_deg is 0", "above 0"]),
    ("range = 0.02", "range = -0.02", ["noise.range is -0.02", "at least 0", "[m]"]),
    ("turn_deg = 3", "turn_deg = -3", ["noise.turn_deg is -3", "at least 0", "degrees"]),
    ("range = 0.02", "range = nan", ["noise.range is nan", "finite"]),
    ("range = 0.02", "range = inf", ["noise.range is inf", "at most"]),
    ("particles = 20", "particles = 0", ["defaults.particles is 0", "between 1 and 1000000"]),
    ("particles = 20", "inflate_r = -1", ["defaults.inflate_r is -1", "between 0 and"]),
    ("particles = 20", "gate = 5", ["defaults.gate is 5", "between 0 and 1, both excluded"]),
    ("particles = 20", "temper = 0", ["defaults.temper is 0", "0 excluded"]),
    ("particles = 20", "floor_angle = -0.1", ["defaults.floor_angle is -0.1", "between 0 and"]),
    ("particles = 20", "orthogonal = 1", ["defaults.orthogonal is 1", "true or false"]),
    ('association = "known"', 'association = "jcb"', ["defaults.association is 'jcb'", "'jcbb'"]),
    ("[route]", '[vehicle]\nkind = "bike"\n[route]', ["vehicle.kind is 'bike'", "unicycle, ackermann"]),
    ("[route]", "[vehicle]\nwheelbase = 2\n[route]", ["vehicle.wheelbase is not a known key"]),
    ("[route]", '[vehicle]\nkind = "ackermann"\nwheelbase = 0\n[route]', ["vehicle.wheelbase is 0.0", "above 0"]),
    ("[route]", '[vehicle]\nkind = "ackermann"\n[route]', ["Ackermann vehicle cannot turn on the spot"]),
]


@pytest.mark.parametrize(("old", "new", "parts"), BAD, ids=[f"{i}-{new[:20]}" for i, (_, new, _) in enumerate(BAD)])
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    assert GOOD.count(old) == 1 or old == "speed = 0.8"
    path = write(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(SourceError) as caught:
        read_world(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert all(part in message for part in parts), message
    assert "expected" in message or "did you mean" in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"", "route is missing"),
        (b"\xff\xfe\x00", "not UTF-8"),
        (b"\x1f\x8b\x08\x00", "not UTF-8"),
        (b"a = " + b"[" * 100_000, "expected a world file in TOML"),
        (b"route = 3", "route is 3; expected a table, [route]"),
    ],
)
def test_files_that_are_no_worlds(tmp_path: Path, content: bytes, part: str) -> None:
    path = tmp_path / "odd.toml"
    path.write_bytes(content)
    with pytest.raises(SourceError, match=r"odd\.toml") as caught:
        build(str(path))
    assert part in str(caught.value)


def test_paths_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"none\.toml: cannot be read"):
        read_world(tmp_path / "none.toml")
    with pytest.raises(SourceError, match="cannot be read"):
        read_world(tmp_path)
    with pytest.raises(SourceError, match="cannot be written"):
        write_world(tmp_path / "no" / "such" / "folder.toml", scenario("loop"))


def test_world_files_take_no_options(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="takes no options, but 'laps'"):
        build(str(write(tmp_path, GOOD)), laps=2)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("range = 0.02", "range = -0.02", "range"),
        ("particles = 20", "particles = 0", "particles"),
        ("speed = 0.8", "spede = 0.8", "[route]"),  # where the missing one belongs
    ],
)
def test_a_bad_value_has_its_line(tmp_path: Path, old: str, new: str, key: str) -> None:
    text = GOOD.replace(old, new, 1)
    assert text != GOOD
    path = write(tmp_path, text)
    line = 1 + next(i for i, line in enumerate(text.splitlines()) if line.startswith(key))
    with pytest.raises(SourceError) as caught:
        build(str(path))
    assert str(caught.value).startswith(f"{path}:{line}: ")


GUIDE = (Path(__file__).parent.parent.parent / "scenarios" / "README.md").read_text(encoding="utf-8")


def test_the_example_of_the_guide_is_a_world(tmp_path: Path) -> None:
    [example] = re.findall(r"```toml\n(.*?)```", GUIDE, flags=re.DOTALL)
    source = read_world(write(tmp_path, example))
    assert source.warnings == ()
    assert source.title == "a corridor with a corner, and somebody in it"
    row = world_row(source)
    assert (row.things, row.what) == (4, "walls")
    assert row.visible > 2
    somebody = [f.frame.scan.walls for f in source.steps if f.frame.scan is not None and f.frame.scan.walls is not None]
    assert source.steps[0].truth is not None
    assert source.steps[3].truth.tolist() == [1.0, 0.0, 0.0]  # type: ignore[union-attr]
    assert any((walls == UNKNOWN_TAG).any() for walls in somebody)


def test_the_guide_has_every_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: set[str] = set()
    monkeypatch.setattr(Table, "__contains__", lambda table, key: asked.add(table.path(key)) or contains(table, key))
    read_scenario(write(tmp_path, WALLS.replace("[walls]", PEOPLE)))
    random = "[landmarks.random]\nnumber = 3\narea = [0, 0, 9, 9]"
    read_scenario(write(tmp_path, GOOD.replace("points = [[5, 3], [12, 4.5]]", random)))
    car = GOOD.replace("speed = 0.8", "speed = 0.8\ncorner_radius = 3") + "[vehicle]\nkind = 'ackermann'\n"
    read_scenario(write(tmp_path, car))
    keys = {key.rpartition(".")[2] for key in asked if not key.startswith("defaults.") and not key.endswith("_rad")}
    section = GUIDE[GUIDE.index("## The world file") : GUIDE.index("## Logs")]
    named = set(re.findall(r"\w+", " ".join(re.findall(r"`[^`\n]+`", section))))
    assert keys <= named
    assert len(keys) > 30
