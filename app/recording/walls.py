"""How walls are drawn: lines, with a dot at every end that is known to be one.  `landmarks` does the same for points.

A wall is the brighter the more often it was seen.  Its covariance is that of its lateral offset and its angle, so what
it covers is a band that is wider at the ends.  What the laser saw is drawn twice: its returns where they were, from the
true pose, and the pieces of wall that were made of them where the best particle believes to see them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from app import colours, shades
from app.recording import arrow, scene
from app.recording.limits import Limits, sample
from app.recording.scene import Style
from app.scans import returns
from slam.features.wall import ends
from slam.geometry import compose, ellipse_axes
from slam.map_store import Maps
from slam.types import IGNORED, NEW, Floats, Frame, Ints, Particles

LEGEND = "; seen: matched yellow, new violet, rejected red"
"""What the title of a map adds."""

OFTEN = 20.0
"""Observations after which a wall is drawn as bright as it gets."""

DIM = 0.7
"""How much of a wall that was seen once is background."""

NARROW = 0.02
"""[m] up to which the band of a wall is left out: it would be hidden by the line of the wall."""

SHARED = 4
"""Particles have most walls in common: of so many times as many as may be drawn, that much is left to draw."""


def looks(style: Style, crowd: float) -> dict[str, list[Any]]:
    """Colours and sizes of the entities of a filter that have to do with features, by the last part of their path."""
    rgb, rank = style.rgb, style.rank
    return {
        "map": [scene.strokes(None, 1.8 + 1.4 * rank)],
        "map/ends": [scene.dots(rgb, crowd * (3.2 + 0.7 * rank))],
        "map/bands": [rr.Mesh3D.from_fields(albedo_factor=(*rgb, 24))],
        "maps": [scene.strokes(colours.faded(rgb, 0.58), 0.8)],
        "picked/map": [scene.strokes((255, 255, 255), 1.0)],
        "segments": [scene.strokes(None, 3.6)],
        "associations": scene.look_of_associations(),
    }


def looks_of_surroundings(crowd: float) -> dict[str, list[Any]]:
    """The same of what belongs to no filter, by path below /world; lines do not become blots, however many."""
    return {
        "truth/map": [scene.strokes(colours.faded(colours.TRUTH_ON_DARK, 0.74), 4.0)],
        "scan": [scene.dots(colours.faded(colours.WARNING, 0.4), 1.4)],
    }


def true_map(theta: Floats, lift: float) -> rr.LineStrips3D:
    """theta (n, 4): x0 y0 x1 y1 [m]."""
    return rr.LineStrips3D.from_fields(strips=arrow.segments(theta.reshape(-1, 2, 2), scene.TRUTH_MAP * lift))


def scan(frame: Frame, s: Floats, lift: float) -> list[Any]:
    """Where the laser met something, seen from the pose s (3,) of the robot."""
    return [scene.points(np.zeros((0, 2)) if frame.scan is None else returns(frame.scan, s), scene.RETURNS * lift)]


def observations(frame: Frame, s: Floats, n: Ints, theta: Floats, style: Style) -> dict[str, list[Any]]:
    """Of a frame that a particle sees from s (3,): the pieces, and what is paired, n (Z,), with its walls theta (Z, 8).

    The other end of an association is the point of the wall that is nearest to the centroid of the piece.
    """
    frames = compose(s, frame.z[:, :3])
    pieces = ends(np.concatenate([frames, frame.z[:, 3:5]], axis=1))
    rgb = np.where(n == NEW, 1, np.where(n == IGNORED, 2, 0))
    colour = arrow.colours(np.array([colours.MATCHED, colours.NEW, colours.REJECTED])[rgb])
    centroids, walls = frames[n >= 0, :2], theta[n >= 0]
    axis = np.stack([np.cos(walls[:, 2]), np.sin(walls[:, 2])], axis=1)
    along = np.clip(np.sum(axis * (centroids - walls[:, :2]), axis=1), walls[:, 3], walls[:, 4])
    return {
        "segments": [
            rr.LineStrips3D.from_fields(strips=arrow.segments(pieces, style.z(scene.SEGMENTS)), colors=colour)
        ],
        "associations": scene.associations(centroids, walls[:, :2] + along[:, None] * axis, style),
    }


def beside_particles(p: Particles, best: int, style: Style) -> list[Any]:
    """The 2-sigma ellipse of the best particle as a line, that is no line where it has no extent.

    In a corridor it is metres long and a millimetre wide: the area alone would not be seen.
    """
    half, _ = ellipse_axes(p.P[best, :2, :2])
    rows = scene.outline(p.s[best], p.P[best])
    strips = arrow.strips(rows, [len(rows)], style.z(scene.ELLIPSES))
    return [rr.LineStrips3D.from_fields(strips=strips[: int(half[0] > 0.0)])]


def picked_map(theta: Floats, style: Style) -> list[Any]:
    """The map of a particle that somebody looks at."""
    return [rr.LineStrips3D.from_fields(strips=arrow.segments(ends(theta), style.z(scene.MAP) + 0.5 * style.lift))]


def best_map(theta: Floats, Sigma: Floats, style: Style) -> dict[str, list[Any]]:
    """Walls theta (n, 8) of one map, with the covariance (n, 2, 2) of their lateral offset and angle."""
    places = ends(theta)
    dim = DIM * (1.0 - np.log(np.clip(theta[:, 7], 1.0, OFTEN)) / np.log(OFTEN))
    lines = rr.LineStrips3D.from_fields(
        strips=arrow.segments(places, style.z(scene.MAP)), colors=arrow.colours(shades.faded(style.rgb, dim))
    )
    seen = rr.AnyValues(observations=pa.array(theta[:, 7].astype(np.int32)))  # a viewer shows it where the mouse is
    return {
        "map": [lines, seen],
        "map/ends": [scene.points(places[theta[:, 5:7] > 0.0], style.z(scene.MAP) + 0.5 * style.lift)],
        "map/bands": [bands(theta, Sigma, style.z(scene.MAP_ELLIPSES))],
    }


def bands(theta: Floats, Sigma: Floats, z: float) -> rr.Mesh3D:
    """Two standard deviations to both sides of the walls, at their ends and at their origin; narrow ones are left out.

    At t along a wall it is off by its lateral offset and t times its angle.
    """
    t = np.stack([theta[:, 3], np.zeros(len(theta)), theta[:, 4]], axis=1)
    variance = Sigma[:, 0, 0, None] + 2.0 * t * Sigma[:, 0, 1, None] + t * t * Sigma[:, 1, 1, None]
    half = scene.SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    wide = half.max(axis=1, initial=0.0) > NARROW
    theta, t, half = theta[wide], t[wide, :, None], half[wide, :, None]
    axis = np.stack([np.cos(theta[:, 2]), np.sin(theta[:, 2])], axis=1)[:, None, :]
    middle, left = theta[:, None, :2] + t * axis, half * np.stack([-axis[..., 1], axis[..., 0]], axis=-1)
    corners = np.concatenate([middle + left, middle - left], axis=1).reshape(-1, 2)
    return rr.Mesh3D.from_fields(
        vertex_positions=arrow.vectors(corners, z),
        triangle_indices=arrow.triangles(6 * np.arange(len(theta))[:, None, None] + TRIANGLES),
    )


TRIANGLES = np.array([[0, 3, 1], [1, 3, 4], [1, 4, 2], [2, 4, 5]])
"""Of a band between three points on its left and three on its right."""


def all_maps(maps: Maps, shown: Limits, style: Style) -> rr.LineStrips3D:
    """The walls of all particles; what particles have in common is drawn once."""
    _, theta = maps.everything(SHARED * shown.hypotheses)
    rows = ends(theta).reshape(len(theta), 4).view("V32").ravel().tolist()  # bytes, of which a dictionary is quick
    places = np.frombuffer(b"".join(dict.fromkeys(rows)), float).reshape(-1, 2, 2)
    places = places[sample(len(places), shown.hypotheses)]
    return rr.LineStrips3D.from_fields(strips=arrow.segments(places, style.z(scene.MAPS)))
