"""What the top view draws, as arrays: discs that become ellipses, and line segments; no viewer is known here.

All is flat; a layer has its height by the node that holds it.  Dots are segments of almost no length with round ends,
since of all that viser's client draws only lines have their size in pixels, at any zoom.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam.geometry import ellipse_axes
from slam.types import Bools, Floats

SIGMAS = 2.0
"""Size of every ellipse, in standard deviations."""

CORNERS = 24
"""Of a disc."""

ROUND = np.stack([f(np.linspace(0.0, 2.0 * np.pi, 2 * CORNERS + 1)) for f in (np.cos, np.sin)], axis=1)
"""(49, 2) of a circle, closed."""


class Discs(NamedTuple):
    """Instances of a unit disc."""

    positions: Floats
    """(n, 3) [m]"""
    turns: Floats
    """(n, 4) quaternions w x y z about z."""
    sizes: Floats
    """(n, 3) half axes [m], and 1."""


def unit_disc() -> tuple[Floats, NDArray[np.uint32]]:
    """Vertices (CORNERS, 3) and faces (CORNERS - 2, 3), a fan that looks up."""
    angle = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    vertices = np.stack([np.cos(angle), np.sin(angle), np.zeros(CORNERS)], axis=1)
    i = np.arange(1, CORNERS - 1)
    return vertices, np.stack([np.zeros_like(i), i, i + 1], axis=1).astype(np.uint32)


def ellipses(xy: Floats, covariance: Floats, least: float, rise: Floats | float = 0.0) -> Discs:
    """2-sigma ellipses of covariances (n, 2, 2) [m^2] about xy (n, >= 2), no half axis shorter than `least` [m].

    `rise` (n,) [m] is their height: those that lie on each other must not lie in each other.
    """
    half, direction = ellipse_axes(covariance)
    positions, turns, sizes = np.zeros((len(xy), 3)), np.zeros((len(xy), 4)), np.ones((len(xy), 3))
    positions[:, :2], positions[:, 2] = xy[:, :2], rise
    turns[:, 0], turns[:, 3] = np.cos(0.5 * direction), np.sin(0.5 * direction)
    sizes[:, :2] = np.maximum(SIGMAS * half, least)
    return Discs(positions, turns, sizes)


def outline(xy: Floats, covariance: Floats, least: float) -> Floats:
    """(48, 2, 2) segments around the same ellipse of one covariance (2, 2) about xy (2,)."""
    half, direction = ellipse_axes(covariance)
    c, q = np.cos(direction), np.sin(direction)
    return line(xy[:2] + (np.maximum(SIGMAS * half, least) * ROUND) @ np.array([[c, q], [-q, c]]))


def dots(xy: Floats, length: float) -> Floats:
    """(n, 2, 2) segments of so little length [m] that they are dots, at xy (n, >= 2)."""
    shift = np.array([0.5 * length, 0.0])
    return np.stack([xy[:, :2] - shift, xy[:, :2] + shift], axis=1)


def headings(s: Floats, length: float) -> Floats:
    """(n, 2, 2) segments of this length [m] from poses s (n, 3) forwards; none where a heading is not known."""
    s = s[np.isfinite(s[:, 2])]
    return np.stack([s[:, :2], s[:, :2] + length * np.stack([np.cos(s[:, 2]), np.sin(s[:, 2])], axis=1)], axis=1)


def line(path: Floats) -> Floats:
    """(n - 1, 2, 2) segments of a path (n, >= 2)."""
    return np.stack([path[:-1, :2], path[1:, :2]], axis=1) if len(path) else np.zeros((0, 2, 2))


def lines(rows: Floats, lengths: list[int]) -> tuple[Floats, Bools]:
    """Segments (m, 2, 2) of paths that lie one behind another in rows (n, >= 2); and which (n - 1,) pairs of rows they
    are."""
    if len(rows) < 2:
        return np.zeros((0, 2, 2)), np.zeros(max(len(rows) - 1, 0), np.bool_)
    joined = np.ones(len(rows) - 1, np.bool_)
    joined[np.cumsum(lengths)[:-1] - 1] = False
    return line(rows)[joined], joined


def rays(origin: Floats, ends: Floats) -> Floats:
    """(n, 2, 2) from origin (2,) to ends (n, 2)."""
    return np.stack([np.broadcast_to(origin[:2], ends.shape), ends], axis=1)


def bands(theta: Floats, Sigma: Floats, narrow: float) -> Floats:
    """(m, 2, 2) the borders of two standard deviations on both sides of walls theta (n, 8), at their ends and origin.

    Left out is what is nowhere wider than `narrow` [m].  At t along a wall it is off by its lateral offset and t times
    its angle.
    """
    t = np.stack([theta[:, 3], np.zeros(len(theta)), theta[:, 4]], axis=1)
    variance = Sigma[:, 0, 0, None] + 2.0 * t * Sigma[:, 0, 1, None] + t * t * Sigma[:, 1, 1, None]
    half = SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    wide = half.max(axis=1, initial=0.0) > narrow
    theta, t, half = theta[wide], t[wide, :, None], half[wide, :, None]
    axis = np.stack([np.cos(theta[:, 2]), np.sin(theta[:, 2])], axis=1)[:, None, :]
    middle, left = theta[:, None, :2] + t * axis, half * np.stack([-axis[..., 1], axis[..., 0]], axis=-1)
    sides = np.concatenate([middle + left, middle - left])
    return np.stack([sides[:, :-1], sides[:, 1:]], axis=2).reshape(-1, 2, 2)
