"""Landmarks at random, but none too close to another."""

from __future__ import annotations

import math

import numpy as np

from scenarios.checks import LARGEST, check_number
from scenarios.types import SourceError
from scenarios.world import MAX_LANDMARKS
from slam.types import Floats

Area = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max [m]"""


def landmark_count(area: Area, density: float) -> int:
    """How many landmarks a density [1/m^2] gives in the area; at least one."""
    check_number("density", density, "landmarks/m^2", above=0)
    _check_area(area)
    return max(1, round(density * (area[2] - area[0]) * (area[3] - area[1])))


def _check_area(area: Area) -> None:
    x0, y0, x1, y1 = area
    if not (-LARGEST <= x0 < x1 <= LARGEST and -LARGEST <= y0 < y1 <= LARGEST):
        raise SourceError(f"area is {list(area)}; expected [x_min, y_min, x_max, y_max] with room inside")


def scatter(area: Area, number: int, spacing: float, seed: int) -> Floats:
    """(number, 2) [m] uniform in the area, any two at least `spacing` [m] apart: darts too close are dropped.

    Raises `SourceError` where so many do not fit.
    """
    check_number("number", number, "landmarks", least=1, most=MAX_LANDMARKS, whole=True)
    check_number("spacing", spacing, "m", least=0)
    check_number("seed", seed, least=0, most=2**63, whole=True)
    _check_area(area)
    x0, y0, x1, y1 = area
    too_dense = (
        f"number is {number}: so many do not fit in {x1 - x0:g} x {y1 - y0:g} m, {spacing:g} m apart; expected fewer, "
        "closer together or a larger area"
    )
    # Discs thrown at random jam at 0.547 of the area, that is 0.7 of it in squares of the discs' width.
    if number * spacing**2 > 0.7 * (x1 - x0 + spacing) * (y1 - y0 + spacing):
        raise SourceError(too_dense)
    rng = np.random.default_rng(seed)
    cell = max(spacing, 1e-9)
    taken: dict[tuple[int, int], list[tuple[float, float]]] = {}
    kept: list[tuple[float, float]] = []
    for _ in range(30):
        for x, y in rng.uniform((x0, y0), (x1, y1), (number, 2)).tolist():
            i, j = math.floor(x / cell), math.floor(y / cell)
            around = (taken.get((i + di, j + dj), ()) for di in (-1, 0, 1) for dj in (-1, 0, 1))
            if spacing and any(math.dist((x, y), other) < spacing for near in around for other in near):
                continue
            taken.setdefault((i, j), []).append((x, y))
            kept.append((x, y))
            if len(kept) == number:
                return np.array(kept)
    raise SourceError(too_dense)
