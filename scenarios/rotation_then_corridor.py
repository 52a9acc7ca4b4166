"""Turn on the spot with nothing in view, then a long corridor (Fig. 14): the map inherits a wrong heading."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np

from scenarios.checks import Limits, check_number, check_positive
from scenarios.floorplan import DoorKind, straight_corridor
from scenarios.indoor import INDOOR_NOISE, LASER_NOISE, Beams, Features, View, check_doors, doors, laser, sensor
from scenarios.route import MOST_TURN, Route
from scenarios.simulate import Scenario
from scenarios.types import SourceError
from scenarios.world import world_of_points, world_of_walls
from slam.motion import Unicycle
from slam.types import Floats

TITLE = "turn on the spot seeing nothing, then a long corridor: the heading is uncertain before the map begins"

AFTER = 5.0
"""[m] of the corridor that are before the robot at the end."""


@dataclass(frozen=True)
class RotationThenCorridor:
    """Options of `rotation-then-corridor`."""

    features: Features = "walls"
    """What is seen: walls by a laser, or landmarks, the hinge posts of the doors."""
    turn_deg: Annotated[float, Limits(least=-MOST_TURN, most=MOST_TURN, unit="degrees")] = 360.0
    """[degrees] turned on the spot before setting off, counter-clockwise."""
    turn_rate_deg: Annotated[float, Limits(above=0, most=MOST_TURN, unit="degrees/s")] = 30.0
    """[degrees/s]"""
    lobby: float = 9.0
    """[m] from the start to the corridor and to the other three walls of the lobby: farther than the laser sees, and
    with half a door spacing farther than the landmark sensor does."""
    length: float = 60.0
    """[m] of the corridor; the robot stops 5 m before its end."""
    width: float = 2.0
    """[m]"""
    doors: DoorKind = "closed"
    """Walls only: closed (set back in their frames), open with nothing behind, with rooms behind, or no doors."""
    door_spacing: float = 5.0
    """[m] between the doors of one side; the other side is half a spacing ahead."""
    door_width: float = 1.0
    """[m]"""
    recess: float = 0.3
    """[m] that closed doors are set back; the thickness of the wall around open ones."""
    lobby_walls: Literal["all", "none"] = "all"
    """Walls only: whether the lobby is a room, or the corridor begins in the open."""
    far_end: Literal["wall", "open"] = "wall"
    """Walls only: what the corridor ends in."""
    speed: float = 0.8
    """[m/s]"""
    beams: Beams = 181
    """Of the laser."""
    view_deg: View = None
    """[degrees] the whole opening of the sensor; by default 180, the frontal half circle."""
    max_range: float | None = None
    """[m] of the sensor; by default 8 for walls, 10 for landmarks."""


def rotation_then_corridor(options: RotationThenCorridor) -> Scenario:
    """The start is known; what is seen first is seen from a heading that the turn has made uncertain."""
    check_positive(options, "length", "width", "speed")
    check_doors(options)
    check_number("lobby", options.lobby, "m", least=0)
    walls = options.features == "walls"
    if walls and options.lobby + options.length <= AFTER:
        raise SourceError(
            f"length is {options.length:g}; expected above {AFTER - options.lobby:g} m, since the robot stops "
            f"{AFTER:g} m before the end"
        )
    plan = straight_corridor(options.lobby, options.length, options.width, doors(options))
    return Scenario(
        name="rotation-then-corridor",
        title=TITLE,
        world=world_of_walls(np.concatenate([plan.walls, _ends(options)])) if walls else world_of_points(plan.posts),
        motion=Unicycle(),
        route=Route(
            waypoints=((0.0, 0.0), (options.lobby + options.length - AFTER, 0.0)),
            speed=options.speed,
            turn_rate=math.radians(options.turn_rate_deg),
            start_turn=math.radians(options.turn_deg),
        ),
        sensor=laser(options) if walls else sensor(options, max_range=10.0),
        noise=LASER_NOISE if walls else INDOOR_NOISE,
        options=asdict(options),
    )


def _ends(options: RotationThenCorridor) -> Floats:
    """(n, 4) [m] the walls of the lobby, a square around the start, and the far end of the corridor."""
    a, half = options.lobby, 0.5 * options.width
    end = a + options.length
    walls = [(end, -half, end, half)] if options.far_end == "wall" else []
    if options.lobby_walls == "all" and a > half:  # a smaller lobby would be no wider than the corridor
        corners = [(a, half), (a, a), (-a, a), (-a, -a), (a, -a), (a, -half)]
        walls += [(*p, *q) for p, q in pairwise(corners)]
    return np.array(walls, float).reshape(-1, 4)
