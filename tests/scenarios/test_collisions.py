"""Driving through walls is noticed, and where."""

import math

import numpy as np
import pytest

from scenarios.collisions import BLOCK, collisions
from scenarios.laser import Laser
from scenarios.route import Route
from scenarios.simulate import Scenario, simulate
from scenarios.world import world_of_walls
from slam.motion import Unicycle
from slam.types import Noise


def crosses(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    """Two segments in general position: each has the ends of the other on both its sides."""

    def side(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> float:
        return float(np.linalg.det(np.stack([v - u, w - u])))

    return side(p, q, a) * side(p, q, b) < 0 and side(a, b, p) * side(a, b, q) < 0


def test_against_a_slow_implementation() -> None:
    rng = np.random.default_rng(3)
    path = np.cumsum(rng.normal(0, 0.3, (5 * BLOCK + 7, 2)), axis=0)
    walls = np.concatenate([rng.uniform(-4, 4, (60, 2)), rng.uniform(-4, 4, (60, 2))], axis=1)
    expected = []
    for n, wall in enumerate(walls):
        ticks = [t for t in range(len(path) - 1) if crosses(path[t], path[t + 1], wall[:2], wall[2:])]
        expected += [(n, ticks[0])] if ticks else []
    assert 5 < len(expected) < 55
    assert collisions(walls, path) == sorted(expected, key=lambda hit: hit[1])


@pytest.mark.parametrize(
    ("wall", "hit"),
    [
        ((1.0, -1.0, 1.0, 1.0), True),
        ((1.0, 0.0, 1.0, 1.0), True),  # touched
        ((1.0, 1e-9, 1.0, 1.0), False),
        ((0.5, 0.0, 9.0, 0.0), True),  # driven along
        ((2.1, 0.0, 9.0, 0.0), False),  # ahead
        ((0.5, 1e-9, 9.0, 1e-9), False),
    ],
)
def test_edges(wall: tuple[float, ...], hit: bool) -> None:
    path = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.0], [1.5, 0.0], [2.0, 0.0]])
    assert bool(collisions(np.array([wall]), path)) == hit


def test_one_who_stands_still_hits_nothing() -> None:
    walls = np.array([[0.0, -1.0, 0.0, 1.0], [3.0, -1.0, 3.0, 1.0]])
    assert collisions(walls, np.full((200, 2), 1.0)) == []


def world(walls: list[tuple[float, ...]], **route: float) -> Scenario:
    return Scenario(
        name="yard",
        title="",
        world=world_of_walls(walls),
        motion=Unicycle(),
        route=Route(((0.0, 0.0), (10.0, 0.0)), speed=1.0, **route),
        sensor=Laser(),
        noise=Noise(),
    )


def test_the_warning_names_wall_and_place() -> None:
    walls = [(-1.0, 2.0, 12.0, 2.0), (4.05, -1.0, 4.05, 1.0)]
    [warning] = simulate(world(walls)).warnings
    assert warning == (
        "walls.segments[1], from (4.05, -1) to (4.05, 1), is in the way: the robot drives through it at (4.00, 0.00), "
        "after 4.0 s"
    )
    assert simulate(world(walls[:1])).warnings == ()


def test_of_many_walls_in_the_way_some_are_named() -> None:
    walls = [(x, -1.0, x, 1.0) for x in np.arange(0.5, 9.0, 0.5)]
    warnings = simulate(world(walls)).warnings
    assert len(warnings) == 6
    assert warnings[-1] == "walls.segments: the robot drives through 12 more"


def test_standing_still_for_an_hour() -> None:
    source = simulate(world([(0.0, 2.0, 12.0, 2.0)], wait=3600.0))
    assert len(source.steps) == 7220
    frames = [step.frame for step in source.steps]
    assert all((frame.u == 0.0).all() for frame in frames[:7200])
    assert frames[0].scan is not None
    assert all((frame.scan.ranges == frames[0].scan.ranges).all() for frame in frames[:7200] if frame.scan)
    assert frames[-1].time == pytest.approx(3610.0)
    truth = source.steps[-1].truth
    assert truth is not None
    assert math.dist(truth[:2], (10.0, 0.0)) < 1e-9


def test_nothing_in_view_for_minutes() -> None:
    source = simulate(world([(9.0, 6.0, 12.0, 6.0)], wait=180.0))
    scans = [step.frame.scan for step in source.steps]
    assert all(found is not None for found in scans)
    empty = [np.isinf(found.ranges).all() for found in scans if found is not None]
    assert all(empty[:360])
    assert not all(empty)
