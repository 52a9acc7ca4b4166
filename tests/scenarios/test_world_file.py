"""World files: the same bits back, and an error that says where and what for everything else."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenarios.paper_line import LAYOUTS
from scenarios.registry import build, scenario, worlds
from scenarios.simulate import simulate
from scenarios.types import Source, SourceError
from scenarios.world_file import read_scenario, read_world, world_text, write_world
from slam.motion import Ackermann

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
        for x, y in ((f.u, g.u), (f.dt, g.dt), (f.z, g.z), (f.tags, g.tags), (s, t)):
            np.testing.assert_array_equal(x, y)
            assert x.dtype == y.dtype


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, {}) for name in worlds()),
        *(("paper-line", {"layout": layout, "vehicle": "ackermann"}) for layout in LAYOUTS),
        ("rotation-then-corridor", {"turn_deg": 123.456789, "turn_rate_deg": 31.7}),
        ("loop", {"laps": 1.0 / 3.0, "width": 1.9}),
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
    ("[[5, 3], [12, 4.5]]", "[[5, 300]]", ["none of the 1 landmarks", "max_range 10 m", "route past landmarks"]),
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
