"""A long straight corridor with doors on both sides."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from scenarios.checks import check_positive
from scenarios.floorplan import DoorKind, straight_corridor
from scenarios.indoor import INDOOR_NOISE, LASER_NOISE, Beams, Features, View, check_doors, doors, laser, sensor
from scenarios.route import Route
from scenarios.simulate import Scenario
from scenarios.types import SourceError
from scenarios.world import world_of_points, world_of_walls
from slam.motion import Unicycle

TITLE = "a long straight corridor with doors on both sides: errors grow and nothing closes"

BEFORE, AFTER = 1.0, 5.0
"""[m] of the corridor that are behind the robot at the start, and before it at the end."""


@dataclass(frozen=True)
class Corridor:
    """Options of `corridor`."""

    features: Features = "walls"
    """What is seen: walls by a laser, or landmarks, the hinge posts of the doors."""
    length: float = 100.0
    """[m] of the corridor; the robot drives from 1 m after its beginning to 5 m before its end."""
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
    far_end: Literal["wall", "open"] = "wall"
    """Walls only: without doors and end wall, nothing tells how far along the corridor the robot is."""
    speed: float = 0.8
    """[m/s]"""
    beams: Beams = 181
    """Of the laser."""
    view_deg: View = None
    """[degrees] the whole opening of the sensor; by default 180, the frontal half circle."""
    max_range: float | None = None
    """[m] of the sensor; by default 8 for walls, 10 for landmarks."""


def corridor(options: Corridor) -> Scenario:
    """Walls, or a landmark at the hinge post of every door; observed every 0.5 s."""
    check_positive(options, "length", "width", "speed")
    check_doors(options)
    walls = options.features == "walls"
    if walls and options.length <= BEFORE + AFTER:
        raise SourceError(
            f"length is {options.length:g}; expected above {BEFORE + AFTER:g} m, since the robot drives from "
            f"{BEFORE:g} m after the beginning to {AFTER:g} m before the end"
        )
    plan = straight_corridor(0.0, options.length, options.width, doors(options))
    half = 0.5 * options.width
    end = [(options.length, -half, options.length, half)] if options.far_end == "wall" else []
    return Scenario(
        name="corridor",
        title=TITLE,
        world=world_of_walls(np.array([*plan.walls, *end])) if walls else world_of_points(plan.posts),
        motion=Unicycle(),
        route=Route(waypoints=((BEFORE, 0.0), (options.length - AFTER, 0.0)), speed=options.speed),
        sensor=laser(options) if walls else sensor(options, max_range=10.0),
        noise=LASER_NOISE if walls else INDOOR_NOISE,
        options=asdict(options),
    )
