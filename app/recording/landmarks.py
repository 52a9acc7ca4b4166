"""How point landmarks are drawn: dots with ellipses.  `walls` has the same functions for walls."""

from __future__ import annotations

from typing import Any

import rerun as rr

from app import colours
from app.recording import scene
from app.recording.ground import seen
from app.recording.limits import Limits
from app.recording.scene import Style
from slam.map_store import Maps
from slam.types import Floats, Frame, Ints, Particles

LEGEND = ""
"""What the title of a map adds."""


def looks(style: Style, crowd: float) -> dict[str, list[Any]]:
    """Colours and sizes of the entities of a filter that have to do with features, by the last part of their path."""
    rgb, rank = style.rgb, style.rank
    return {
        "map": [
            scene.dots(rgb, crowd * (2.5 + 0.8 * rank)),
            rr.Ellipsoids3D.from_fields(colors=(*rgb, 40), fill_mode="solid"),
        ],
        "maps": [scene.dots(colours.faded(rgb, 0.4), 1.2)],
        "picked/map": [scene.dots((255, 255, 255), crowd * 2.0)],
        "associations": scene.look_of_associations(),
    }


def looks_of_surroundings(crowd: float) -> dict[str, list[Any]]:
    """The same of what belongs to no filter, by path below /world."""
    yellow = colours.faded(colours.WARNING, 0.55)
    return {
        "truth/map": [scene.dots(colours.faded(colours.TRUTH_ON_DARK, 0.35), crowd * 6.0)],
        "scan": [scene.strokes(yellow, 0.8), scene.dots(yellow, 1.5)],
    }


def true_map(theta: Floats, lift: float) -> rr.Points3D:
    """theta (n, 2) [m]."""
    return scene.points(theta, scene.TRUTH_MAP * lift)


def scan(frame: Frame, s: Floats, lift: float) -> list[Any]:
    """What the sensor saw, as lines from the pose s (3,) of the robot."""
    return list(scene.rays(s[:2], seen(frame, s), scene.SCAN * lift))


def beside_particles(p: Particles, best: int, style: Style) -> list[Any]:
    """Nothing: an ellipse is wide enough to be seen as an area."""
    return []


def observations(frame: Frame, s: Floats, n: Ints, theta: Floats, style: Style) -> dict[str, list[Any]]:
    """Of a frame that a particle sees from s (3,): what is paired, n (Z,), and with what, its features theta (Z, 2)."""
    paired = n >= 0
    return {"associations": scene.associations(seen(frame, s)[paired], theta[paired], style)}


def best_map(theta: Floats, Sigma: Floats, style: Style) -> dict[str, list[Any]]:
    """Features theta (n, 2) [m] of one map, with their covariance (n, 2, 2)."""
    ellipses = scene.ellipses(theta, Sigma, style.z(scene.MAP_ELLIPSES))
    return {"map": [scene.points(theta, style.z(scene.MAP)), ellipses]}


def picked_map(theta: Floats, style: Style) -> list[Any]:
    """The map of a particle that somebody looks at."""
    return [scene.points(theta, style.z(scene.MAP) + 0.5 * style.lift)]


def all_maps(maps: Maps, shown: Limits, style: Style) -> rr.Points3D:
    """The features of all particles."""
    return scene.points(maps.everything(shown.hypotheses)[1], style.z(scene.MAPS))
