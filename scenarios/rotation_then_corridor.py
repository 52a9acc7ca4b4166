"""Turn on the spot with nothing in view, then a long corridor (Fig. 14): the map inherits a wrong heading."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from scenarios.checks import check_number, check_positive
from scenarios.floorplan import straight_corridor
from scenarios.indoor import INDOOR_NOISE
from scenarios.route import Route
from scenarios.sensors import Sensor
from scenarios.simulate import Scenario
from scenarios.world import world_of_points
from slam.motion import Unicycle

TITLE = "turn on the spot seeing nothing, then a long corridor: the heading is uncertain before the map begins"


@dataclass(frozen=True)
class RotationThenCorridor:
    """Options of `rotation-then-corridor`."""

    turn_deg: float = 360.0
    """[degrees] turned on the spot before setting off, counter-clockwise."""
    turn_rate_deg: float = 30.0
    """[degrees/s]"""
    lobby: float = 9.0
    """[m] from the start to the corridor; with half a door spacing, farther than the sensor sees."""
    length: float = 60.0
    """[m] of the corridor; the robot stops 5 m before its end."""
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


def rotation_then_corridor(options: RotationThenCorridor) -> Scenario:
    """The start is known; what is seen first is seen from a heading that the turn has made uncertain."""
    check_positive(options, "turn_rate_deg", "length", "width", "door_spacing", "door_width", "speed", "max_range")
    check_number("lobby", options.lobby, "m", least=0)
    _, posts = straight_corridor(options.lobby, options.length, options.width, options.door_spacing, options.door_width)
    return Scenario(
        name="rotation-then-corridor",
        title=TITLE,
        world=world_of_points(posts),
        motion=Unicycle(),
        route=Route(
            waypoints=((0.0, 0.0), (options.lobby + options.length - 5.0, 0.0)),
            speed=options.speed,
            turn_rate=math.radians(options.turn_rate_deg),
            start_turn=math.radians(options.turn_deg),
        ),
        sensor=Sensor(max_range=options.max_range),
        noise=INDOOR_NOISE,
        options=asdict(options),
    )
