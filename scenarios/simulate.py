"""The builder: world + route + sensor + noise, each a small value, give a `Source` of exact frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from scenarios.checks import check_number
from scenarios.collisions import collisions
from scenarios.laser import Laser, check_laser, faces, scan
from scenarios.movers import places
from scenarios.noise import check_noise
from scenarios.route import Route, check_route, controls, drive, start_pose
from scenarios.sensors import Sensor, check_sensor, observe
from scenarios.types import Source, SourceError, Step, TrueMap
from scenarios.world import World, check_landmarks, check_walls
from slam.features import Point, Wall
from slam.geometry import compose, invert, wrap_all
from slam.motion import Ackermann, Odometry, Unicycle
from slam.presets import BUILDING
from slam.types import Floats, Frame, Noise

NAMED = 5
"""Walls in the way that a warning names; of the rest it says how many."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """All that a simulated run is made of; a world file is this, written down."""

    name: str
    title: str
    """One line for people."""
    world: World
    motion: Unicycle | Ackermann
    """How the robot is driven.  Seen by a laser, it reports what wheel odometry makes of that: `Odometry`."""
    route: Route
    sensor: Sensor | Laser
    """A `Sensor` sees the landmarks of the world, a `Laser` its walls."""
    noise: Noise
    defaults: dict[str, Any] = field(default_factory=dict)
    """Parameters (`slam.types.Params` fields) that suit this world better than the general defaults, or those for walls
    (`slam.presets.BUILDING`)."""
    options: dict[str, Any] = field(default_factory=dict)
    """The options that made this scenario."""


def simulate(scenario: Scenario) -> Source:
    """Drive the route and observe after every `sensor.every` ticks; ticks after the last observation are dropped.

    Frames are exact: dead reckoning on them is the truth.  Raises `SourceError` for values that are impossible or
    absurd, and for a run in which nothing would ever be seen.
    """
    _check(scenario)
    sensor, route = scenario.sensor, scenario.route
    u, dt = controls(route, scenario.motion)
    start = start_pose(route)
    count = len(u) // sensor.every
    if not count:
        name = "laser" if isinstance(sensor, Laser) else "sensor"
        raise SourceError(
            f"{name}.every is {sensor.every}, but the route has only {len(u)} control ticks; expected at least "
            "one observation before it ends"
        )
    u, dt = u[: count * sensor.every], dt[: count * sensor.every]
    path = drive(scenario.motion, start, u, dt)
    see = _see_walls if isinstance(sensor, Laser) else _see_landmarks
    frames = see(scenario, u, dt, path)
    truth = path[sensor.every :: sensor.every]  # (count, 3)
    return Source(
        name=scenario.name,
        title=scenario.title,
        kind="world",
        motion=frames[0].motion,
        feature=frames[0].feature,
        steps=tuple(Step(frame, pose) for frame, pose in zip(frames, truth, strict=True)),
        start=start,
        noise=scenario.noise,
        true_map=_true_map(scenario, frames),
        max_range=sensor.max_range,
        defaults={**(BUILDING if isinstance(sensor, Laser) else {}), **scenario.defaults},
        warnings=(*_silent(scenario), *_in_the_way(scenario.world, route, path)),
        options=dict(scenario.options),
    )


def _true_map(scenario: Scenario, frames: list[Frame]) -> TrueMap:
    """The landmarks, or the walls, with the backs of those that are seen from both sides."""
    if not isinstance(scenario.sensor, Laser):
        return scenario.world.landmarks
    return faces(scenario.world.walls.theta, [frame.scan for frame in frames if frame.scan is not None])


def _see_landmarks(scenario: Scenario, u: Floats, dt: Floats, path: Floats) -> list[Frame]:
    """Range and bearing of every landmark in reach, and the control ticks in between as they were driven."""
    sensor = scenario.sensor
    assert isinstance(sensor, Sensor)
    truth = path[sensor.every :: sensor.every]
    tags, theta = scenario.world.landmarks
    seen = observe(sensor, theta, truth)
    if not any(len(index) for index, _ in seen):
        nearest = min(float(np.hypot(*(theta - pose[:2]).T).min()) for pose in truth[:: max(1, len(truth) // 1000)])
        raise SourceError(
            f"route: {_none_of(len(theta), 'landmark')} into view, with sensor.max_range "
            f"{sensor.max_range:g} m and the nearest landmark {nearest:.3g} m from the route; expected a "
            "route past landmarks"
        )
    frames = []
    for k, (index, z) in enumerate(seen):
        ticks = slice(k * sensor.every, (k + 1) * sensor.every)
        frames.append(Frame(_time(scenario, k), scenario.motion, u[ticks], dt[ticks], Point(), z, tags[index]))
    return frames


def _none_of(count: int, what: str) -> str:
    return f"none of the {count} {what}s comes" if count > 1 else f"the only {what} never comes"


def _see_walls(scenario: Scenario, u: Floats, dt: Floats, path: Floats) -> list[Frame]:
    """A scan at every step, and one increment of odometry since the one before; what is in the scan is left to
    `slam.perception`."""
    laser, world = scenario.sensor, scenario.world
    assert isinstance(laser, Laser)
    truth = path[laser.every :: laser.every]
    times = np.array([_time(scenario, k) for k in range(len(truth))])
    discs = places(world.movers, times) if len(world.movers.paths) else None
    scans = scan(laser, world.walls.theta, truth, discs)
    if not any((found.walls >= 0).any() for found in scans if found.walls is not None):
        raise SourceError(
            f"route: {_none_of(len(world.walls.theta), 'wall')} into view, with laser.max_range "
            f"{laser.max_range:g} m; expected a route past walls"
        )
    moved = increments(path, laser.every)
    passed = dt.reshape(-1, laser.every).sum(axis=1)
    nothing, no_tags = np.empty((0, Wall.observation)), np.empty(0, np.int64)
    return [
        Frame(_time(scenario, k), Odometry(), moved[k : k + 1], passed[k : k + 1], Wall(), nothing, no_tags, found)
        for k, found in enumerate(scans)
    ]


def increments(path: Floats, every: int) -> Floats:
    """(S, 3) [m, m, rad] motion of every `every` ticks of a path (S every + 1, 3), in the frame where it began.

    The heading counts whole turns, since odometry errs with the motion, not with its remainder.
    """
    ends = path[::every]
    moved = compose(invert(ends[:-1]), ends[1:])
    moved[:, 2] = wrap_all(np.diff(path[:, 2])).reshape(-1, every).sum(axis=1)
    return moved


def _time(scenario: Scenario, k: int) -> float:
    """[s] of observing step k."""
    return (k + 1) * scenario.sensor.every * scenario.route.tick


def _silent(scenario: Scenario) -> list[str]:
    """A filter divides by what it believes of the sensor, which is this noise unless it is told otherwise."""
    names = ("range",) if isinstance(scenario.sensor, Laser) else ("range", "bearing")
    silent = [f"noise.{name}" for name in names if getattr(scenario.noise, name) == 0]
    verb = "is" if len(silent) == 1 else "are"
    return [f"{' and '.join(silent)} {verb} 0: let the filters believe in more than that"] if silent else []


def _in_the_way(world: World, route: Route, path: Floats) -> list[str]:
    """The walls that the robot drives through.  It is let through: the rest of the run may be what somebody wants."""
    walls = world.walls.theta
    hits = collisions(walls, path[:, :2]) if len(walls) else []
    said = []
    for wall, tick in hits[:NAMED]:
        x0, y0, x1, y1 = walls[wall]
        x, y, _ = path[tick]
        said.append(
            f"walls.segments[{wall}], from ({x0:g}, {y0:g}) to ({x1:g}, {y1:g}), is in the way: the robot drives "
            f"through it at ({x:.2f}, {y:.2f}), after {tick * route.tick:.1f} s"
        )
    if len(hits) > NAMED:
        said.append(f"walls.segments: the robot drives through {len(hits) - NAMED} more")
    return said


def _check(scenario: Scenario) -> None:
    if isinstance(scenario.motion, Ackermann):
        check_number("vehicle.wheelbase", scenario.motion.wheelbase, "m", above=0)
        if scenario.motion.ahead != scenario.motion.wheelbase or scenario.motion.left:
            raise SourceError(
                "vehicle: a simulated Ackermann vehicle is described by its front axle (ahead = wheelbase)"
            )
    check_route(scenario.route)
    check_noise(scenario.noise)
    world = scenario.world
    if isinstance(scenario.sensor, Laser):
        check_laser(scenario.sensor)
        check_walls(world)
    else:
        check_sensor(scenario.sensor)
        check_landmarks(world.landmarks)
        if len(world.walls.theta):
            check_walls(world)
