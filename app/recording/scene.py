"""What the map views show: values of a step as Rerun's points, arrows, ellipses and lines.

Everything lies in the plane of the map, y up, in layers a hair's breadth apart, since the views look straight down on
it and what is nearer is drawn on top.  Dots and lines have their size on the screen, so that they show at any zoom;
ellipses and headings are to scale.  How things look is written once, as static data (`looks`); what changes is written
with each step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from app import ancestry, colours, shades
from app.colours import RGB
from app.recording import arrow
from app.recording.limits import Limits, sample, thinned, thinned_tree
from app.relations import Breaks
from slam.genealogy import Genealogy
from slam.geometry import ellipse_axes
from slam.types import Floats, Particles

SIGMAS = 2.0
"""Size of every ellipse, in standard deviations."""

CLOSE_HEIGHT = 5.0
"""Height of the eye in close-ups, in squares of the grid."""

FLAT = 1e-6
"""[m] half height of an ellipse: an ellipsoid that is seen from above."""

LIFT = 1e-4
"""Between two layers, over the distance of the eye: the least that viewers, measured, reliably tell apart is 6e-5."""

SCAN, TRUTH_MAP, ODOMETRY, TRUTH, RETURNS = range(2, 7)
"""Heights, in lifts, of what is no filter: above the grid, beneath all of them.  Rays lie below landmarks, and returns
of a laser on the walls that they came from."""

MAPS, LINEAGES, MAP_ELLIPSES, PATH, RELATIONS, MAP, SEGMENTS, ASSOCIATIONS, ELLIPSES, PARTICLES = range(2, 12)
"""Layers of the filters, from below."""


class Style(NamedTuple):
    """How one filter is drawn."""

    rgb: RGB
    rank: int
    """0 is drawn on top and smallest, so that the filters below it show as rings around it."""
    lift: float
    """[m] between two layers."""

    def z(self, layer: int) -> float:
        """[m] height of a layer of this filter."""
        return self.lift * (4 * layer + 3 - min(self.rank, 3))


def crowding(landmarks: int) -> float:
    """Factor on the size of dots for features, so that those of many landmarks do not become one blot."""
    return min(1.0, max(0.3, math.sqrt(80.0 / max(landmarks, 1))))


def looks(style: Style) -> dict[str, list[Any]]:
    """Colours and sizes of the entities of a filter, by the last part of their path; not those of features."""
    rgb, rank = style.rgb, style.rank
    return {
        "particles": [
            rr.Points3D.from_fields(radii=rr.Radius.ui_points(2.0 + 0.8 * rank)),
            rr.Arrows3D.from_fields(colors=colours.faded(rgb, 0.35), radii=rr.Radius.ui_points(0.6)),
            strokes(colours.mix(rgb, (255, 255, 255), 0.6), 2.0),  # of an outline
        ],
        "ellipses": [rr.Ellipsoids3D.from_fields(colors=(*rgb, 14), fill_mode="solid")],
        "path": [strokes(rgb, 1.4 + 0.9 * rank)],
        "relations": [strokes(colours.broken(rgb), 0.7)],
        "picked": [dots((255, 255, 255), 5.0), strokes((255, 255, 255), 2.0)],
        "lineages": [strokes(None, 1.0)],
    }


def looks_of_surroundings() -> dict[str, list[Any]]:
    """The same for what is no filter, by path below /world."""
    white = colours.TRUTH_ON_DARK
    return {
        "truth/robot": [dots(white, 4.0), rr.Arrows3D.from_fields(colors=white, radii=rr.Radius.ui_points(1.2))],
        "truth/path": [strokes(white, 1.2)],
        "odometry/path": [strokes(colours.ODOMETRY, 1.2)],
        "matching/path": [strokes(colours.MATCHING, 1.2)],
        "scans": [dots(colours.faded(colours.ODOMETRY, 0.45), 0.8)],
    }


def look_of_associations() -> list[Any]:
    """Thin enough not to hide what they join."""
    rgb = colours.ASSOCIATION
    return [strokes(rgb, 1.4), dots(rgb, 3.0)]


def points(xy: Floats, z: float) -> rr.Points3D:
    """xy (n, >= 2) [m]."""
    return rr.Points3D.from_fields(positions=arrow.vectors(xy, z))


def lines(paths: list[Floats], z: float) -> rr.LineStrips3D:
    """Paths (m, >= 2) [m]."""
    return rr.LineStrips3D.from_fields(strips=_strips(paths, z))


def ellipses(xy: Floats, covariance: Floats, z: float) -> rr.Ellipsoids3D:
    """2-sigma ellipses of covariances (n, 2, 2) [m^2] about xy (n, >= 2); those without any extent are left out."""
    half, direction = ellipse_axes(covariance)
    seen = half[:, 0] > 0.0
    half, direction, xy = half[seen], direction[seen], xy[seen]
    quaternions = np.zeros((len(xy), 4), np.float32)
    quaternions[:, 2], quaternions[:, 3] = np.sin(0.5 * direction), np.cos(0.5 * direction)
    return rr.Ellipsoids3D.from_fields(
        centers=arrow.vectors(xy, z), half_sizes=arrow.vectors(SIGMAS * half, FLAT), quaternions=quaternions
    )


def particles(p: Particles, shown: Limits, best: int, unit: float, style: Style) -> tuple[rr.Points3D, rr.Arrows3D]:
    """Positions, coloured by weight: faint below 1/K, the filter's hue at 1/K, white above; and headings.

    Arrows are in proportion to `unit` [m], the mesh of the close-up, since headings are looked at there.
    """
    dots, pointers = sample(len(p.s), shown.particles, best), sample(len(p.s), shown.arrows, best)
    brightness = shades.brightness(p.log_w[dots], len(p.s))
    z, heading = style.z(PARTICLES), p.s[pointers, 2]
    return (
        rr.Points3D.from_fields(
            positions=arrow.vectors(p.s[dots], z + 0.2 * style.lift * brightness),
            colors=arrow.colours(shades.by_brightness(style.rgb, brightness)),
        ),
        rr.Arrows3D.from_fields(
            origins=arrow.vectors(p.s[pointers], z - 0.5 * style.lift),
            vectors=arrow.vectors(0.3 * unit * np.stack([np.cos(heading), np.sin(heading)], axis=1)),
        ),
    )


def particle_ellipses(p: Particles, shown: Limits, best: int, style: Style) -> rr.Ellipsoids3D:
    """Pose covariance of the particles; nothing where they are mere samples (FastSLAM after its draw)."""
    chosen = sample(len(p.s), shown.ellipses, best)
    return ellipses(p.s[chosen], p.P[chosen, :2, :2], style.z(ELLIPSES))


def associations(seen: Floats, features: Floats, style: Style) -> list[Any]:
    """Lines from where a particle sees something, seen (m, 2), to what it takes it for, features (m, 2) [m]."""
    z = style.z(ASSOCIATIONS)
    strips = arrow.segments(np.stack([seen, features], axis=1), z)
    return [rr.LineStrips3D.from_fields(strips=strips), points(seen, z)]


def lineages(genealogy: Genealogy, shown: Limits, style: Style) -> rr.LineStrips3D:
    """All surviving paths, in the colours of the ancestry picture: the more of the living particles descend through a
    branch, the brighter it is."""
    branches, rows, lengths = thinned_tree(genealogy.branches(), genealogy.steps, 4 * shown.vertices)
    tones = ancestry.of_branches(genealogy, branches, style.rgb)
    strips = arrow.strips(rows, lengths, style.z(LINEAGES))
    return rr.LineStrips3D.from_fields(strips=strips, colors=arrow.colours(tones))


def path(poses: Floats, shown: Limits, style: Style) -> rr.LineStrips3D:
    """The path of the best particle (T, 3)."""
    return lines([thinned(poses, shown.vertices)], style.z(PATH))


def relations(breaks: Breaks, style: Style) -> rr.LineStrips3D:
    """Where the path breaks relations that it is judged by: from where it has the robot to where they have it."""
    return rr.LineStrips3D.from_fields(strips=arrow.segments(breaks.shown(), style.z(RELATIONS)))


ROUND = np.stack([f(np.linspace(0.0, 2.0 * math.pi, 49)) for f in (np.cos, np.sin)], axis=1)
"""(49, 2) of a circle, closed."""


def outline(s: Floats, P: Floats) -> Floats:
    """(49, 2) [m] the 2-sigma ellipse of a pose (3,) with covariance (3, 3), closed."""
    half, direction = ellipse_axes(P[:2, :2])
    c, q = math.cos(direction), math.sin(direction)
    return s[:2] + (SIGMAS * half * ROUND) @ np.array([[c, q], [-q, c]])


def picked(s: Floats, P: Floats, way: Floats, label: str, style: Style) -> list[Any]:
    """A particle that somebody looks at: its pose, its ellipse, its path (T, >= 2), and what is said of it."""
    z = style.z(PARTICLES) + 0.5 * style.lift
    return [points(s[None], z), rr.Points3D.from_fields(labels=[label]), lines([outline(s, P), way], z)]


def robot(pose: Floats, z: float, length: float) -> tuple[rr.Points3D, rr.Arrows3D]:
    """A pose (3,) as a dot and an arrow [m]; without the arrow where the heading is NaN."""
    headed = pose[None, :] if np.isfinite(pose[2]) else np.zeros((0, 3))
    vector = length * np.stack([np.cos(headed[:, 2]), np.sin(headed[:, 2])], axis=1)
    pointer = rr.Arrows3D.from_fields(origins=arrow.vectors(headed, z), vectors=arrow.vectors(vector))
    return points(pose[None, :], z), pointer


def rays(origin: Floats, ends: Floats, z: float) -> tuple[rr.LineStrips3D, rr.Points3D]:
    """Observations: lines from origin (2,) to ends (Z, 2) [m]."""
    return lines([np.stack([origin, end]) for end in ends], z), points(ends, z)


def close_up(centre: Floats, unit: float, height: float) -> rr.Transform3D:
    """A frame about centre (2,) [m] whose unit in the plane is `unit` [m]; the close-up sees it from a fixed height.

    Its unit upwards is another, so that the layers are as far apart, for an eye at CLOSE_HEIGHT, as they are for that
    which sees the whole map from `height` [m].
    """
    return rr.Transform3D(translation=[*centre, 0.0], scale=[unit, unit, height / CLOSE_HEIGHT])


def close_up_label(unit: float) -> rr.Points3D:
    """How large the squares of the close-up's grid are; in the frame of `close_up`."""
    text = f"{unit:g} m" if unit >= 1.0 else f"{100 * unit:g} cm" if unit >= 0.01 else f"{1000 * unit:g} mm"
    place = [[0.0, -2.2, 0.0]]
    return rr.Points3D(place, labels=f"one square: {text}", show_labels=True, radii=0.0, colors=(200, 200, 200))


def nice(length: float) -> float:
    """The next of 1, 2, 5, 10 ... [m] that is not below `length`."""
    if not (math.isfinite(length) and length > 0.0):
        return 1.0
    power = 10.0 ** math.floor(math.log10(length))
    return next(f * power for f in (1.0, 2.0, 5.0, 10.0) if f * power >= length * (1 - 1e-9))


def _strips(paths: list[Floats], z: float) -> pa.Array:
    rows = np.concatenate([p[:, :2] for p in paths]) if paths else np.zeros((0, 2))
    return arrow.strips(rows, [len(p) for p in paths], z)


def dots(rgb: RGB, radius: float) -> rr.Points3D:
    """How dots look that are so large on the screen."""
    return rr.Points3D.from_fields(colors=rgb, radii=rr.Radius.ui_points(radius))


def strokes(rgb: RGB | None, width: float) -> rr.LineStrips3D:
    """How lines look that are so wide on the screen; without a colour if each has its own."""
    return rr.LineStrips3D.from_fields(colors=rgb, radii=rr.Radius.ui_points(0.5 * width))
