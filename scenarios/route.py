"""Where the robot drives: from waypoints to the exact controls that pass through them.

A route is cut into legs (straights, arcs, turns on the spot), and those into control ticks.  The poses are what the
motion model makes of the controls, so truth and model agree to the last bit; the route itself is met to a few
millimetres, since a tick may begin on a straight and end on an arc.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from scenarios.checks import LARGEST, check_angle, check_number
from scenarios.types import SourceError
from slam.geometry import wrap
from slam.motion import Ackermann, propagate
from slam.types import Floats

MAX_TICKS = 2_000_000
MAX_STEERING = math.radians(60.0)
MOST_TURN = 36_000.0
"""[degrees] on the spot, and in a second."""

Waypoints = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Route:
    """Straight from waypoint to waypoint at constant speed, with rounded corners or turns on the spot."""

    waypoints: Waypoints
    """(x, y) [m, m]; the robot starts at the first one and heads for the second."""
    speed: float = 0.8
    """[m/s]"""
    tick: float = 0.1
    """[s] duration of a control tick."""
    corner_radius: float = 0.0
    """[m] of the arcs that replace corners; 0: stop and turn on the spot (unicycle only)."""
    turn_rate: float = math.radians(30.0)
    """[rad/s] of turns on the spot."""
    start_turn: float = 0.0
    """[rad] turned on the spot before setting off, counter-clockwise (unicycle only)."""
    wait: float = 0.0
    """[s] that the robot stands still before anything else."""


class Leg(NamedTuple):
    """A straight (turn 0), an arc, or a turn on the spot (length 0)."""

    length: float
    """[m]"""
    turn: float
    """[rad]"""


def check_route(route: Route) -> None:
    """Raise `SourceError` unless the route leads somewhere at a possible speed."""
    check_number("route.speed", route.speed, "m/s", above=0)
    check_number("route.tick", route.tick, "s", above=0)
    check_number("route.corner_radius", route.corner_radius, "m", least=0)
    check_angle("route.turn_rate", route.turn_rate, above=0, most=MOST_TURN)
    check_angle("route.start_turn", route.start_turn, least=-MOST_TURN, most=MOST_TURN)
    check_number("route.wait", route.wait, "s", least=0)
    for i, (x, y) in enumerate(route.waypoints):
        if not (abs(x) <= LARGEST and abs(y) <= LARGEST):
            raise SourceError(
                f"route.waypoints: waypoint {i + 1} is {_place((x, y))}; expected finite metres, at most {LARGEST:g}"
            )
    if len(_distinct(route.waypoints)) < 2:
        raise SourceError(
            f"route.waypoints: the route leads nowhere with {len(route.waypoints)} waypoints; expected two or "
            "more that differ"
        )


def start_pose(route: Route) -> Floats:
    """(3,) pose at the first waypoint, before any turn."""
    (x0, y0), (x1, y1) = _distinct(route.waypoints)[:2]
    return np.array([x0, y0, wrap(math.atan2(y1 - y0, x1 - x0) - route.start_turn)])


def legs(route: Route) -> list[Leg]:
    """The route cut into straights, arcs and turns on the spot.

    Raises `SourceError` where two waypoints are too close for the arcs at both.
    """
    points = _distinct(route.waypoints)
    steps = np.diff(np.array(points), axis=0)
    lengths, course = np.hypot(steps[:, 0], steps[:, 1]), np.arctan2(steps[:, 1], steps[:, 0])
    turns = [wrap(float(b - a)) for a, b in pairwise(course)]
    trims = [0.0, *(route.corner_radius * math.tan(0.5 * abs(turn)) for turn in turns), 0.0]
    parts = [Leg(0.0, route.start_turn)]
    for i, length in enumerate(lengths):
        straight = float(length) - trims[i] - trims[i + 1]
        if straight < -1e-9:
            raise SourceError(
                f"route.corner_radius is {route.corner_radius:g}: no room for such arcs between "
                f"{_place(points[i])} and {_place(points[i + 1])}, {length:g} m apart; expected a smaller "
                "radius or less sharp corners"
            )
        parts.append(Leg(straight, 0.0))
        if i < len(turns):
            parts.append(Leg(route.corner_radius * abs(turns[i]), turns[i]))
    return [leg for leg in parts if leg.length > 1e-9 or abs(leg.turn) > 1e-12]


def controls(route: Route, motion: Any) -> tuple[Floats, Floats]:
    """u (T, 2) and dt (T,) [s] that drive `motion` (`Unicycle` or `Ackermann`) along the route.

    Raises `SourceError` for more than `MAX_TICKS` ticks, and for corners that the vehicle cannot take.
    """
    parts = legs(route)
    seconds = sum(leg.length / route.speed if leg.length else abs(leg.turn) / route.turn_rate for leg in parts)
    seconds += route.wait
    if not seconds / route.tick <= MAX_TICKS:
        raise SourceError(
            f"route: it takes {seconds:g} s, {seconds / route.tick:g} control ticks of {route.tick:g} s; expected "
            f"at most {MAX_TICKS}"
        )
    if isinstance(motion, Ackermann):
        u = _steer(parts, route, motion)
    else:
        u = np.concatenate([_turn_on_spot(d, route) if not d[0].length else _drive(d, route) for d in _drives(parts)])
    if route.wait > 0:
        u = np.concatenate([np.zeros((math.ceil(route.wait / route.tick - 1e-9), 2)), u])
    return u, np.full(len(u), route.tick)


def drive(motion: Any, start: Floats, u: Floats, dt: Floats) -> Floats:
    """(T + 1, 3) poses from `start` (3,) under the controls u (T, m): dead reckoning (5)."""
    poses = np.empty((len(u) + 1, 3))
    poses[0] = start
    s: Any = tuple(np.asarray(start, float).tolist())
    for t, (tick, seconds) in enumerate(zip(u.tolist(), dt.tolist(), strict=True)):
        s, _, _ = propagate(motion, s, tick, seconds)
        poses[t + 1] = s
    return poses


def shorten(waypoints: Waypoints, length: float, shortest: float = 0.0) -> Waypoints:
    """The first `length` [m] of the polyline, without a last leg below `shortest` [m]: too short to turn into."""
    kept = [waypoints[0]]
    for a, b in pairwise(waypoints):
        leg = math.dist(a, b)
        share = min(1.0, length / leg)
        if share * leg < shortest and len(kept) > 1:
            break
        kept.append(b if share == 1.0 else (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])))
        length -= leg
        if length <= 0.0:
            break
    return tuple(kept)


def _distinct(waypoints: Waypoints) -> Waypoints:
    """Without waypoints that repeat the one before."""
    return tuple(p for i, p in enumerate(waypoints) if i == 0 or math.dist(p, waypoints[i - 1]) > 1e-6)


def _place(point: tuple[float, float]) -> str:
    return f"({point[0]:g}, {point[1]:g})"


def _drives(parts: list[Leg]) -> list[list[Leg]]:
    """Legs grouped into drives without a halt, and single turns on the spot."""
    drives: list[list[Leg]] = []
    for leg in parts:
        if leg.length and drives and drives[-1][0].length:
            drives[-1].append(leg)
        else:
            drives.append([leg])
    return drives


def _turn_on_spot(parts: list[Leg], route: Route) -> Floats:
    """A whole number of ticks, hence a little slower than `turn_rate`."""
    turn = parts[0].turn
    ticks = max(1, math.ceil(abs(turn) / (route.turn_rate * route.tick) - 1e-9))
    return np.tile([0.0, turn / (ticks * route.tick)], (ticks, 1))


def _profile(parts: list[Leg], route: Route) -> tuple[Floats, Floats]:
    """Distance (T + 1,) [m] at the border of every tick, and how far the course has turned there [rad]."""
    distance = np.concatenate([[0.0], np.cumsum([leg.length for leg in parts])])
    turned = np.concatenate([[0.0], np.cumsum([leg.turn for leg in parts])])
    ticks = math.floor(distance[-1] / (route.speed * route.tick) + 1e-9)
    at = route.speed * route.tick * np.arange(ticks + 1)
    if distance[-1] - at[-1] > 1e-9:  # the last tick is driven slower, so that the drive ends where it should
        at = np.append(at, distance[-1])
    return at, np.interp(at, distance, turned)


def _drive(parts: list[Leg], route: Route) -> Floats:
    """(v, w) of a unicycle: the turn rate of a tick is what the course turns in it."""
    at, turned = _profile(parts, route)
    return np.stack([_speeds(at, route), np.diff(turned) / route.tick], axis=1)


def _speeds(at: Floats, route: Route) -> Floats:
    v = np.full(len(at) - 1, route.speed)  # exactly, where a difference of distances would round
    v[-1] = min(route.speed, (at[-1] - at[-2]) / route.tick)
    return v if route.speed - v[-1] > 1e-9 * route.speed else np.full(len(v), route.speed)


def _steer(parts: list[Leg], route: Route, motion: Ackermann) -> Floats:
    """(v, G) of an Ackermann vehicle whose front wheel follows the route: it points along the course."""
    if any(not leg.length for leg in parts):
        raise SourceError(
            "route.corner_radius is 0 or there is a start turn, but an Ackermann vehicle cannot turn on the "
            "spot; expected a corner radius above its wheelbase, and no start turn"
        )
    at, turned = _profile(parts, route)
    v = _speeds(at, route)
    G, heading = np.empty(len(v)), 0.0  # heading and course, both from the first leg
    for t, course in enumerate(0.5 * (turned[1:] + turned[:-1])):
        G[t] = course - heading
        heading += route.tick * v[t] * math.sin(G[t]) / motion.wheelbase
        if abs(G[t]) > MAX_STEERING:
            raise SourceError(
                f"route.corner_radius is {route.corner_radius:g}: too tight for a wheelbase of "
                f"{motion.wheelbase:g} m, which would have to steer {math.degrees(abs(G[t])):.0f} degrees; expected "
                f"at most {math.degrees(MAX_STEERING):.0f}"
            )
    return np.stack([v, G], axis=1)
