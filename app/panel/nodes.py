"""Nodes of viser's scene that are made once and then only changed: a name of its own for every change would be kept
for browsers to come."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from app.colours import RGB
from app.panel import tone
from app.panel.shapes import Discs, unit_disc
from slam.types import Floats

LARGEST = 1e9
"""[m] Nothing is farther away; single precision would otherwise overflow where a filter has diverged."""


class Strokes:
    """Line segments, or dots, of one thickness in pixels; of one colour, or each of its own."""

    def __init__(self, scene: viser.SceneApi, name: str, thickness: float, rgb: RGB | None = None) -> None:
        self._own = rgb is None
        colours = np.zeros((1, 2, 3), np.uint8) if rgb is None else tone.whole(rgb)
        self.handle = scene.add_line_segments(
            name,
            np.zeros((1, 2, 3), np.float32),
            colours,
            thickness=thickness,
            thickness_units="screen",
            visible=False,
        )

    def look(self, thickness: float, rgb: RGB | None = None) -> None:
        """Another thickness, and another colour where all have one."""
        self.handle.thickness = thickness
        if rgb is not None and not self._own:
            self.handle.colors = tone.whole(rgb)

    def put(self, segments: Floats, colours: Floats | None = None) -> None:
        """These segments (n, 2, 2) [m], with colours (n, 3), or (n, 2, 3) for both ends, if each has its own."""
        if len(segments) == 0:
            self.hide()
            return
        points = np.zeros((len(segments), 2, 3), np.float32)
        points[..., :2] = np.clip(segments, -LARGEST, LARGEST)
        self.handle.points = points
        if colours is not None:
            self.handle.colors = _both_ends(colours)
        self.handle.visible = True

    def show(self) -> None:
        """What was put last."""
        self.handle.visible = True

    def hide(self) -> None:
        """Until there is something to show."""
        self.handle.visible = False


def _both_ends(colours: Floats) -> NDArray[np.uint8]:
    if colours.ndim == 2:
        return np.repeat(tone.each(colours)[:, None], 2, axis=1)
    return tone.each(colours.reshape(-1, 3)).reshape(colours.shape)


class Ellipses:
    """Translucent discs."""

    def __init__(self, scene: viser.SceneApi, name: str, opacity: float, rgb: RGB) -> None:
        vertices, faces = unit_disc()
        one = Discs(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), np.ones((1, 3)))
        self.handle = scene.add_batched_meshes_simple(
            name,
            vertices,
            faces,
            one.turns,
            one.positions,
            batched_scales=one.sizes,
            batched_colors=tone.each(np.array([rgb])),
            opacity=opacity,
            lod="off",
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self._colour = tone.each(np.array([rgb]))

    def put(self, discs: Discs, colours: Floats | None = None, opacity: float | None = None) -> None:
        """These discs, with colours (n, 3) or that which they have all.

        The client builds the mesh anew for another opacity: let it change seldom.
        """
        if len(discs.positions) == 0:
            self.hide()
            return
        self.handle.batched_positions = np.clip(discs.positions, -LARGEST, LARGEST).astype(np.float32)
        self.handle.batched_wxyzs = discs.turns.astype(np.float32)
        self.handle.batched_scales = np.minimum(discs.sizes, LARGEST).astype(np.float32)
        count = len(discs.positions)
        self.handle.batched_colors = np.repeat(self._colour, count, axis=0) if colours is None else tone.each(colours)
        if opacity is not None:
            self.handle.opacity = opacity
        self.handle.visible = True

    def hide(self) -> None:
        """Until there is something to show."""
        self.handle.visible = False


class Dots:
    """Squares that are as wide as a cell of a grid, however close one looks, and a pixel at least; of one colour.

    Of all that viser's client draws they alone are not tone-mapped.
    """

    def __init__(self, scene: viser.SceneApi, name: str, rgb: RGB) -> None:
        self.handle = scene.add_point_cloud(
            name,
            np.zeros((1, 3), np.float32),
            rgb,
            point_shape="square",
            point_shading="flat",
            precision="float32",  # half of it is 0.1 m at 200 m
            visible=False,
        )

    def put(self, xy: Floats, width: float) -> None:
        """At xy (n, 2) [m], so wide [m]."""
        if len(xy) == 0:
            self.hide()
            return
        points = np.zeros((len(xy), 3), np.float32)
        points[:, :2] = np.clip(xy, -LARGEST, LARGEST)
        self.handle.points = points
        self.handle.point_size = 0.5 * width  # the client takes it for a radius
        self.handle.visible = True

    def show(self) -> None:
        """What was put last."""
        self.handle.visible = True

    def hide(self) -> None:
        """Until there is something to show."""
        self.handle.visible = False


Node = Strokes | Ellipses | Dots


def flat_light(scene: Any) -> None:
    """Every surface shows its own colour: nothing shines, nothing throws a shadow."""
    scene.world_axes.visible = False
    scene.configure_default_lights(enabled=False, cast_shadow=False)
    scene.configure_environment_map(None)
    scene.add_light_ambient("/light", color=(255, 255, 255), intensity=float(np.pi))
