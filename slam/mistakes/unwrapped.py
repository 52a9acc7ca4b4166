"""Feature kinds whose angles are differences of numbers, not of directions."""

from __future__ import annotations

import math
from typing import Any

from numba.extending import register_jitable

from slam.features import Point, Wall

_of_point, _of_wall = register_jitable(Point.innovation), register_jitable(Wall.innovation)


class UnwrappedPoint(Point):
    """A landmark whose bearing may come out a turn off."""

    @staticmethod
    def innovation(feature: Any, theta: Any, s: Any, z: Any) -> Any:
        """As `Point` has it, without the wrap."""
        v, G_s, G_theta = _of_point(feature, theta, s, z)
        return (v[0], z[1] - math.atan2(theta[1] - s[1], theta[0] - s[0]) + s[2]), G_s, G_theta


class UnwrappedWall(Wall):
    """A wall whose angle may come out a turn off."""

    @staticmethod
    def innovation(feature: Any, theta: Any, s: Any, z: Any) -> Any:
        """As `Wall` has it, without the wrap."""
        v, G_s, G_theta = _of_wall(feature, theta, s, z)
        return (v[0], theta[2] - s[2] - z[2]), G_s, G_theta


def unwrapped(feature: Any) -> Any:
    """The same feature kind with this mistake."""
    return UnwrappedPoint() if isinstance(feature, Point) else UnwrappedWall(*feature)
