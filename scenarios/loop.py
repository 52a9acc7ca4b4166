"""A corridor around a rectangle: out, round, back into known ground, and on."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from scenarios.checks import check_number, check_positive
from scenarios.floorplan import DoorKind, ring_corridor
from scenarios.indoor import LASER_NOISE, Beams, Features, Laps, View, check_doors, doors, laser, sensor
from scenarios.route import Route, shorten
from scenarios.simulate import Scenario
from scenarios.types import SourceError
from scenarios.world import world_of_points, world_of_walls
from slam.motion import Unicycle
from slam.types import Noise

TITLE = "a 100 m corridor loop: the robot returns into known ground and goes on"

CORNER_RADIUS = 1.0  # [m]

LANDMARK_NOISE = Noise(speed=0.1, turn=math.radians(2.0), range=0.05, bearing=math.radians(0.5))
"""With landmarks: half the drift of the other indoor worlds, so that once round dead reckoning is 1.6 m and 5 degrees
off (median and
deviation of 20 runs)."""


@dataclass(frozen=True)
class Loop:
    """Options of `loop`."""

    features: Features = "walls"
    """What is seen: walls by a laser, or landmarks, the hinge posts of the doors, through walls."""
    length: float = 30.0
    """[m] of the longer side of the centre line, along which the robot starts."""
    depth: float = 20.0
    """[m] of the shorter side."""
    width: float = 2.0
    """[m] of the corridor."""
    start: float | None = None
    """[m] from the start to the first corner; by default 6 for walls, so that the wall ahead is in sight from where the
    robot is known to be, and half of the side for landmarks."""
    laps: Laps = 1.3
    """How often the robot goes round; 1.3 is once and 30 m more."""
    doors: DoorKind = "closed"
    """Walls only: closed (set back in their frames), open with nothing behind, with rooms behind, or no doors."""
    door_spacing: float = 5.0
    """[m] between the doors of one wall; the doors of the wall across are half a spacing ahead."""
    door_width: float = 1.0
    """[m]"""
    recess: float = 0.3
    """[m] that closed doors are set back; the thickness of the wall around open ones."""
    speed: float = 0.8
    """[m/s]"""
    beams: Beams = 181
    """Of the laser."""
    view_deg: View = None
    """[degrees] the whole opening of the sensor: 360 sees all round, 180 the frontal half circle; by default 180 for
    walls, 360 for landmarks."""
    max_range: float | None = None
    """[m] of the sensor; by default 8 for walls, 12 for landmarks: less than the way across, so that the beginning is
    out of sight for half of a lap."""


def loop(options: Loop) -> Scenario:
    """Walls, or a landmark at the hinge post of every door; observed every 0.5 s."""
    check_positive(options, "length", "depth", "width", "speed")
    check_doors(options)
    if min(options.length, options.depth) < max(options.width, 2 * CORNER_RADIUS) + options.door_width:
        raise SourceError(
            f"length and depth are {options.length:g} and {options.depth:g}; expected room for a corridor "
            f"of width {options.width:g} around something"
        )
    walls = options.features == "walls"
    plan = ring_corridor(options.length, options.depth, options.width, doors(options))
    x, y = 0.5 * options.length, options.depth
    usual = min(6.0, x) if walls else x
    ahead = usual if options.start is None else options.start
    check_number("start", ahead, "m", least=CORNER_RADIUS, most=options.length - CORNER_RADIUS)
    lap = [(x - ahead, 0.0), (x, 0.0), (x, y), (-x, y), (-x, 0.0)]
    distance = options.laps * 2 * (options.length + options.depth)
    corners = (*(lap * (int(options.laps) + 1)), lap[0])
    return Scenario(
        name="loop",
        title=TITLE,
        world=world_of_walls(plan.walls) if walls else world_of_points(plan.posts),
        motion=Unicycle(),
        route=Route(
            waypoints=shorten(corners, distance, shortest=CORNER_RADIUS),
            speed=options.speed,
            corner_radius=CORNER_RADIUS,
        ),
        sensor=laser(options) if walls else sensor(options, max_range=12.0, view_deg=360.0),
        noise=LASER_NOISE if walls else LANDMARK_NOISE,
        # Once round, the map of a Dual FastSLAM particle is off by more than the honest R of the sensor, and its
        # innovation covariance holds no map error.  Nine times R, three deviations for one, leaves room to know the
        # landmarks of the beginning again.
        defaults={} if walls else {"inflate_r": 9.0},
        options=asdict(options),
    )
