"""The builder: world + route + sensor + noise, each a small value, give a `Source` of exact frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from scenarios.checks import check_number
from scenarios.noise import check_noise
from scenarios.route import Route, check_route, controls, drive, start_pose
from scenarios.sensors import Sensor, check_sensor, observe
from scenarios.types import Source, SourceError, Step
from scenarios.world import World, check_world
from slam.features import Point
from slam.motion import Ackermann, Unicycle
from slam.types import Frame, Noise


@dataclass(frozen=True, eq=False)
class Scenario:
    """All that a simulated run is made of; a world file is this, written down."""

    name: str
    title: str
    """One line for people."""
    world: World
    motion: Unicycle | Ackermann
    route: Route
    sensor: Sensor
    noise: Noise
    defaults: dict[str, Any] = field(default_factory=dict)
    """Parameters (`slam.types.Params` fields) that suit this world better than the general defaults."""
    options: dict[str, Any] = field(default_factory=dict)
    """The options that made this scenario."""


def simulate(scenario: Scenario) -> Source:
    """Drive the route and observe after every `sensor.every` ticks; ticks after the last observation are dropped.

    Frames are exact: dead reckoning on them is the truth.  Raises `SourceError` for values that are impossible or
    absurd, and for a run in which nothing would ever be seen.
    """
    _check(scenario)
    motion, sensor, route = scenario.motion, scenario.sensor, scenario.route
    u, dt = controls(route, motion)
    start = start_pose(route)
    count = len(u) // sensor.every
    if not count:
        raise SourceError(
            f"sensor.every is {sensor.every}, but the route has only {len(u)} control ticks; expected at least "
            "one observation before it ends"
        )
    truth = drive(motion, start, u, dt)[sensor.every :: sensor.every]  # (count, 3)
    tags, theta = scenario.world.landmarks
    seen = observe(sensor, theta, truth)
    if not any(len(index) for index, _ in seen):
        nearest = min(float(np.hypot(*(theta - pose[:2]).T).min()) for pose in truth[:: max(1, count // 1000)])
        raise SourceError(
            f"route: none of the {len(theta)} landmarks comes into view, with sensor.max_range "
            f"{sensor.max_range:g} m and the nearest landmark {nearest:.3g} m from the route; expected a "
            "route past landmarks"
        )
    steps = []
    for k, (index, z) in enumerate(seen):
        ticks = slice(k * sensor.every, (k + 1) * sensor.every)
        time = (k + 1) * sensor.every * route.tick
        frame = Frame(time, motion, u[ticks], dt[ticks], Point(), z, tags[index])
        steps.append(Step(frame, truth[k]))
    return Source(
        name=scenario.name,
        title=scenario.title,
        kind="world",
        motion=motion,
        feature=Point(),
        steps=tuple(steps),
        start=start,
        noise=scenario.noise,
        true_map=scenario.world.landmarks,
        max_range=sensor.max_range,
        defaults=dict(scenario.defaults),
        warnings=_warnings(scenario.noise),
        options=dict(scenario.options),
    )


def _warnings(noise: Noise) -> tuple[str, ...]:
    """A filter divides by what it believes of the sensor, which is this noise unless it is told otherwise."""
    silent = [f"noise.{name}" for name in ("range", "bearing") if getattr(noise, name) == 0]
    verb = "is" if len(silent) == 1 else "are"
    return (f"{' and '.join(silent)} {verb} 0: let the filters believe in more than that",) if silent else ()


def _check(scenario: Scenario) -> None:
    if isinstance(scenario.motion, Ackermann):
        check_number("vehicle.wheelbase", scenario.motion.wheelbase, "m", above=0)
        if scenario.motion.ahead != scenario.motion.wheelbase or scenario.motion.left:
            raise SourceError(
                "vehicle: a simulated Ackermann vehicle is described by its front axle (ahead = wheelbase)"
            )
    check_route(scenario.route)
    check_sensor(scenario.sensor)
    check_noise(scenario.noise)
    check_world(scenario.world)
