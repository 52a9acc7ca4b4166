"""What values a parameter may have; one place for the command line, world files and the panel."""

from __future__ import annotations

import math
from typing import NamedTuple

LARGEST = 1e6
"""No deviation, in metres or radians, is larger, and no log density that somebody adds."""


class Interval(NamedTuple):
    """A range of numbers."""

    low: float
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False

    def __contains__(self, value: object) -> bool:
        if not isinstance(value, int | float) or not math.isfinite(value):
            return False
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        return above and below

    def __str__(self) -> str:
        low, high = f"{self.low:.12g}", f"{self.high:.12g}"
        if math.isinf(self.low):
            return "finite"
        if math.isinf(self.high):
            return f"greater than {low}" if self.open_low else f"of at least {low}"
        if self.open_low and self.open_high:
            return f"between {low} and {high}, both excluded"
        if self.open_low or self.open_high:
            return f"between {low} and {high}, {low if self.open_low else high} excluded"
        return f"between {low} and {high}"


PARAMS: dict[str, Interval] = {
    "particles": Interval(1, 1_000_000),
    "gate": Interval(0, 1, open_low=True, open_high=True),
    "gate_known": Interval(0, 1, open_low=True),
    "gate_new": Interval(0, 1, open_high=True),
    "inflate_r": Interval(0, 1e12, open_low=True),
    "temper": Interval(0, 1, open_low=True),
    "floor_lateral": Interval(0, LARGEST),
    "floor_angle": Interval(0, LARGEST),
    "most_new": Interval(0, 1_000_000),
    "log_p_new": Interval(-LARGEST, LARGEST),
    "resample_below": Interval(0, 1),
}
"""Fields of `slam.types.Params`."""

DEVIATION = Interval(0, LARGEST)
"""The standard deviation of a noise."""

BELIEVED_SENSOR = Interval(0, LARGEST, open_low=True)
"""The deviation of a sensor that a filter believes: with zero its innovation covariance would be singular."""
