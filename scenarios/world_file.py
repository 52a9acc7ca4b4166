"""World files: a scenario written as TOML, for worlds of one's own.  README.md has the tables and their keys.

Angles may be given in radians, as `<name>_rad` in place of `<name>_deg`.
"""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from scenarios.checks import naming
from scenarios.laser import Laser, check_laser
from scenarios.movers import NOBODY, Movers
from scenarios.route import Route, Waypoints, check_route
from scenarios.scatter import landmark_count, scatter
from scenarios.sensors import Sensor, check_sensor
from scenarios.simulate import Scenario, simulate
from scenarios.toml_table import Table
from scenarios.types import Source, SourceError
from scenarios.world import World, check_landmarks, check_walls, world_of_points, world_of_walls
from slam.limits import PARAMS
from slam.motion import Ackermann, Unicycle
from slam.types import Noise, Params

AROUND_ROUTE = 10.0
"""[m] that the area of random landmarks reaches beyond the waypoints, unless it is given."""


def read_world(path: str | Path) -> Source:
    """The world of a file, simulated.  Raises `SourceError` naming file and line, or file and key."""
    scenario = read_scenario(path)
    try:
        return simulate(scenario)
    except SourceError as error:
        raise SourceError(f"{_place(path, str(error))}: {error}") from None


def read_scenario(path: str | Path) -> Scenario:
    """The scenario that a world file describes.  Raises `SourceError` as `read_world`."""
    try:
        values = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise SourceError(f"{path}: cannot be read ({error.strerror}); expected a world file") from None
    except UnicodeDecodeError as error:
        raise SourceError(f"{path}: byte {error.start} is not UTF-8 text; expected a world file in TOML") from None
    except tomllib.TOMLDecodeError as error:
        raise SourceError(_syntax_error(path, str(error))) from None
    except RecursionError:
        raise SourceError(f"{path}: nested too deeply; expected a world file in TOML") from None
    try:
        return _scenario(Table(values), Path(path).stem)
    except SourceError as error:
        raise SourceError(f"{_place(path, str(error))}: {error}") from None


def write_world(path: str | Path, scenario: Scenario) -> None:
    """Write a scenario so that `read_world` gives the same frames, bit by bit; `SourceError` if it cannot."""
    try:
        Path(path).write_text(world_text(scenario), encoding="utf-8", newline="\n")
    except OSError as error:
        raise SourceError(f"{path}: cannot be written ({error.strerror})") from None


def world_text(scenario: Scenario) -> str:
    """The text of a world file; random landmarks are written as the points they have become."""
    route, world = scenario.route, scenario.world
    vehicle: dict[str, Any] = {"kind": "unicycle"}
    if isinstance(scenario.motion, Ackermann):
        vehicle = {"kind": "ackermann", "wheelbase": scenario.motion.wheelbase}
    tables: dict[str, dict[str, Any]] = {
        "vehicle": vehicle,
        "route": {
            "speed": route.speed,
            "tick": route.tick,
            "corner_radius": route.corner_radius,
            **_angle("turn_rate", route.turn_rate),
            **_angle("start_turn", route.start_turn),
            "wait": route.wait,
            "waypoints": route.waypoints,
        },
        **_sensor_tables(scenario.sensor),
        "noise": _noise_table(scenario.noise, laser=isinstance(scenario.sensor, Laser)),
        "landmarks": {"points": world.landmarks.theta.tolist(), "tags": world.landmarks.tags.tolist()}
        if len(world.landmarks.theta)
        else {},
        "walls": {"segments": world.walls.theta.tolist()} if len(world.walls.theta) else {},
        "movers": {name: values.tolist() for name, values in world.movers._asdict().items()}
        if len(world.movers.paths)
        else {},
        "defaults": {f.name: scenario.defaults[f.name] for f in fields(Params) if f.name in scenario.defaults},
    }
    lines = [
        "# Metres, seconds and degrees; what each key means: scenarios/README.md",
        f"name = {_value(scenario.name)}",
        f"title = {_value(scenario.title)}",
    ]
    for name, table in tables.items():
        if table:
            lines += ["", f"[{name}]", *(f"{key} = {_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _sensor_tables(sensor: Sensor | Laser) -> dict[str, dict[str, Any]]:
    common = {
        "max_range": sensor.max_range,
        **_angle("field_of_view", sensor.field_of_view),
        "every": sensor.every,
    }
    if isinstance(sensor, Sensor):
        return {"sensor": common}
    x, y, heading = sensor.origin
    return {"laser": {"beams": sensor.beams, **common, "origin": [x, y], **_angle("heading", heading)}}


def _noise_table(noise: Noise, laser: bool) -> dict[str, Any]:
    """What the world has; of the rest only what is not the general default, so that nothing is lost."""
    default = Noise()
    of_laser = {"range": noise.range, "odometry": noise.odometry, "missing": noise.missing}
    of_sensor = {
        "speed": noise.speed,
        **_angle("turn", noise.turn),
        "range": noise.range,
        **_angle("bearing", noise.bearing),
    }
    table, other = (of_laser, of_sensor) if laser else (of_sensor, of_laser)
    usual = {**default.__dict__, **_angle("turn", default.turn), **_angle("bearing", default.bearing)}
    return {**table, **{key: value for key, value in other.items() if key not in table and value != usual.get(key)}}


def _scenario(top: Table, stem: str) -> Scenario:
    motion = _vehicle(top.table("vehicle", {}))
    route = _route(top.table("route"))
    sensor = _eye(top)
    scenario = Scenario(
        name=top.text("name", stem),
        title=top.text("title", "a world of one's own"),
        motion=motion,
        route=route,
        sensor=sensor,
        noise=_noise(top.table("noise"), laser=isinstance(sensor, Laser)),
        world=_world(top, route.waypoints, laser=isinstance(sensor, Laser)),
        defaults=_defaults(top.table("defaults", {})),
    )
    top.end()
    return scenario


def _vehicle(table: Table) -> Unicycle | Ackermann:
    motion: Unicycle | Ackermann = Unicycle()
    if table.text("kind", "unicycle", words=("unicycle", "ackermann")) == "ackermann":
        wheelbase = table.number("wheelbase", Ackermann().wheelbase)
        motion = Ackermann(wheelbase, ahead=wheelbase)
    table.end()
    return motion


def _route(table: Table) -> Route:
    default = Route(())
    route = Route(
        speed=table.number("speed"),
        waypoints=table.points("waypoints"),
        tick=table.number("tick", default.tick),
        corner_radius=table.number("corner_radius", default.corner_radius),
        turn_rate=table.angle("turn_rate", default.turn_rate),
        start_turn=table.angle("start_turn", default.start_turn),
        wait=table.number("wait", default.wait),
    )
    table.end()
    check_route(route)
    return route


def _eye(top: Table) -> Sensor | Laser:
    """The table `laser` or the table `sensor`, which is missed where there is neither."""
    if "laser" not in top:
        return _sensor(top.table("sensor", instead="laser"))
    if "sensor" in top:
        raise SourceError("laser and sensor are both there; expected one, that which the robot has")
    return _laser(top.table("laser"))


def _laser(table: Table) -> Laser:
    default = Laser()
    x, y = table.numbers("origin", 2, default.origin[:2])
    laser = Laser(
        max_range=table.number("max_range"),
        beams=table.integer("beams", default.beams),
        field_of_view=table.angle("field_of_view", default.field_of_view),
        every=table.integer("every", default.every),
        origin=(x, y, table.angle("heading", default.origin[2])),
    )
    table.end()
    check_laser(laser)
    return laser


def _sensor(table: Table) -> Sensor:
    default = Sensor()
    sensor = Sensor(
        max_range=table.number("max_range"),
        field_of_view=table.angle("field_of_view", default.field_of_view),
        every=table.integer("every", default.every),
    )
    table.end()
    check_sensor(sensor)
    return sensor


def _noise(table: Table, laser: bool) -> Noise:
    """What the sensor and its vehicle need must be there; the rest may be."""
    default = Noise()
    if laser:
        noise = Noise(
            range=table.number("range"),
            odometry=table.number("odometry"),
            missing=table.number("missing", default.missing),
            speed=table.number("speed", default.speed),
            turn=table.angle("turn", default.turn),
            bearing=table.angle("bearing", default.bearing),
        )
    else:
        noise = Noise(
            speed=table.number("speed"),
            turn=table.angle("turn"),
            range=table.number("range"),
            bearing=table.angle("bearing"),
            odometry=table.number("odometry", default.odometry),
            missing=table.number("missing", default.missing),
        )
    table.end()
    return noise


def _world(top: Table, waypoints: Waypoints, laser: bool) -> World:
    """The tables `landmarks` and `walls`; that which the sensor sees must be there."""
    walls = _walls(top) if laser or "walls" in top else world_of_walls([])
    points = _landmarks(top.table("landmarks"), waypoints) if not laser or "landmarks" in top else world_of_points([])
    return World(points.landmarks, walls.walls, walls.movers)


def _walls(top: Table) -> World:
    table = top.table("walls")
    segments = table.segments("segments")
    table.end()
    world = world_of_walls(segments, _movers(top.table("movers")) if "movers" in top else NOBODY)
    check_walls(world)
    return world


def _movers(table: Table) -> Movers:
    paths = table.segments("paths")
    if not paths:
        raise SourceError("movers.paths is []; expected at least one [x0, y0, x1, y1], or no table [movers]")
    each = (table.numbers(name, len(paths)) for name in Movers._fields[1:])
    movers = Movers(np.array(paths, float).reshape(-1, 4), *(np.array(values, float) for values in each))
    table.end()
    return movers


def _landmarks(table: Table, waypoints: Waypoints) -> World:
    if "random" in table:
        points = _random_landmarks(table.table("random"), waypoints)
        table.end()
        return world_of_points(points)
    points = table.points("points")
    tags = table.integers("tags") if "tags" in table else None
    table.end()
    world = world_of_points(points, tags)
    check_landmarks(world.landmarks)
    return world


def _random_landmarks(table: Table, waypoints: Waypoints) -> Any:
    if "area" in table:
        x0, y0, x1, y1 = table.numbers("area", 4)
    else:
        xs, ys = [p[0] for p in waypoints] or [0.0], [p[1] for p in waypoints] or [0.0]
        x0, y0 = min(xs) - AROUND_ROUTE, min(ys) - AROUND_ROUTE
        x1, y1 = max(xs) + AROUND_ROUTE, max(ys) + AROUND_ROUTE
    area = (x0, y0, x1, y1)
    spacing, seed = table.number("spacing", 0.0), table.integer("seed", 0)
    with_density = "density" in table
    density, number = (table.number("density"), 0) if with_density else (0.0, table.integer("number"))
    table.end()
    with naming("landmarks.random"):
        return scatter(area, landmark_count(area, density) if with_density else number, spacing, seed)


def _defaults(table: Table) -> dict[str, Any]:
    """Fields of `Params` other than `believed`: words, true or false, and numbers within `slam.limits`."""
    values: dict[str, Any] = {}
    hints = get_type_hints(Params)
    for field in fields(Params):
        key, hint = field.name, hints[field.name]
        if key == "believed" or key not in table:
            continue
        if get_origin(hint) is Literal:
            values[key] = table.text(key, words=get_args(hint))
        elif hint is bool:
            values[key] = table.flag(key)
        elif hint is int:
            values[key] = table.integer(key)
        else:
            values[key] = table.number(key)
        if key in PARAMS and values[key] not in PARAMS[key]:
            raise SourceError(f"{table.path(key)} is {values[key]!r}; expected a number {PARAMS[key]}")
    table.end()
    return values


def _place(path: str | Path, message: str) -> str:
    """`path:line` of the key that a message begins with, or of the table it should be in; else the path alone.

    `tomllib` does not tell where it found a key; in a file of sections and plain keys a look is enough.
    """
    named = re.match(r"[\w.]+", message)
    table, line_of = "", dict[str, int]()
    for number, line in enumerate(Path(path).read_text(encoding="utf-8-sig").splitlines(), start=1):
        if header := re.match(r"\s*\[\s*([\w.]+)\s*\]", line):
            table = f"{header[1]}."
            line_of.setdefault(header[1], number)
        elif key := re.match(r"\s*([\w.]+)\s*=", line):
            line_of.setdefault(table + key[1], number)
    parts = named[0].split(".") if named else []
    for length in range(len(parts), 0, -1):
        if number := line_of.get(".".join(parts[:length])):
            return f"{path}:{number}"
    return str(path)


def _syntax_error(path: str | Path, message: str) -> str:
    """`tomllib` puts the place behind its message; here it comes first."""
    found = re.fullmatch(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)\)", message, re.DOTALL)
    if not found:
        return f"{path}: {message}; expected TOML"
    what, line, column = found.groups()
    place = f"line {line}, column {column}" if line else "at its end"
    return f"{path}, {place}: {what}; expected TOML"


def _angle(key: str, radians: float) -> dict[str, float]:
    """In degrees, as short as gives back the same bits; in radians where no number of degrees does."""
    for digits in range(1, 18):
        degrees = float(f"{math.degrees(radians):.{digits}g}")
        if math.radians(degrees) == radians:
            return {f"{key}_deg": degrees}
    return {f"{key}_rad": radians}


def _value(value: Any) -> str:
    """As TOML: `repr` of a float is exact."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08X}" for c in value)
        return f'"{escaped}"'
    if isinstance(value, list | tuple):
        rows = [_value(row) for row in value]
        if value and isinstance(value[0], list | tuple):
            return "[\n" + "".join(f"    {row},\n" for row in rows) + "]"
        return f"[{', '.join(rows)}]"
    return repr(float(value)) if isinstance(value, float) else str(int(value))
