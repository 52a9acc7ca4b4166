"""A long straight corridor with doors on both sides."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from scenarios.checks import check_positive
from scenarios.floorplan import straight_corridor
from scenarios.indoor import INDOOR_NOISE
from scenarios.route import Route
from scenarios.sensors import Sensor
from scenarios.simulate import Scenario
from scenarios.world import world_of_points
from slam.motion import Unicycle

TITLE = "a long straight corridor with doors on both sides: errors grow and nothing closes"


@dataclass(frozen=True)
class Corridor:
    """Options of `corridor`."""

    length: float = 100.0
    """[m] of the corridor; the robot drives from 1 m after its beginning to 5 m before its end."""
    width: float = 2.0
    """[m]"""
    door_spacing: float = 5.0
    """[m] between the doors of one side; the other side is half a spacing ahead."""
    door_width: float = 1.0
    """[m]"""
    speed: float = 0.8
    """[m/s]"""
    max_range: float = 10.0
    """[m] of the sensor."""


def corridor(options: Corridor) -> Scenario:
    """A landmark at the hinge post of every door; observed every 0.5 s."""
    check_positive(options, "length", "width", "door_spacing", "door_width", "speed", "max_range")
    _, posts = straight_corridor(0.0, options.length, options.width, options.door_spacing, options.door_width)
    return Scenario(
        name="corridor",
        title=TITLE,
        world=world_of_points(posts),
        motion=Unicycle(),
        route=Route(waypoints=((1.0, 0.0), (options.length - 5.0, 0.0)), speed=options.speed),
        sensor=Sensor(max_range=options.max_range),
        noise=INDOOR_NOISE,
        options=asdict(options),
    )
