"""The camera of the top view: straight down, from so far that it is as good as orthographic.

viser has no orthographic camera.  What browsers say of theirs is used only to see how large a pixel is, and is brought
between limits.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from typing import Any

import numpy as np

from app.recording.ground import MARGIN, Extent

FIELD = 0.1
"""[rad] of view; less is more orthographic, but viser's clients go no farther than `FARTHEST` away."""

FARTHEST = 9000.0
"""[m]"""

ASPECT, HEIGHT = 0.7, 700
"""Width over height, and height in pixels, of a view of which nobody has told yet."""

SHARE = 0.45
"""Of the height of a view that is free, above the controls."""

NEAR, FAR, CLOSEST, OUT = 1 / 400, 4.0, 1 / 200, 3.0
"""Clipping planes and limits of the zoom, over the height from which all is seen."""

SAME = 1e-4
"""Over its height, how far a camera may be from where it was put: less than a pixel, more than what rounding does."""

LIFT = 3e-5
"""Between two layers, over that height: told apart also by browsers without a reversed depth buffer."""

REMEMBERED = 50
"""Places where a camera was put."""

Vector = tuple[float, float, float]


class TopCamera:
    """How to see an extent from above."""

    def __init__(self, extent: Extent) -> None:
        x, y = (float(c) for c in extent.centre)
        self._extent = extent
        self.look_at: Vector = (x, y, 0.0)
        self.height = min(self._tall(ASPECT) / (2.0 * math.tan(0.5 * FIELD)), FARTHEST)
        """[m] from where a view of the common shape sees all."""
        self.field = 2.0 * math.atan(0.5 * self._tall(ASPECT) / self.height)
        """[rad]"""

    @property
    def lift(self) -> float:
        """[m] between two layers."""
        return LIFT * self.height

    def _tall(self, aspect: float) -> float:
        """[m] that a view must show from bottom to top."""
        width, height = self._extent.high - self._extent.low
        return float(MARGIN * max(height / SHARE, width / aspect, 1.0))

    def position(self, aspect: float = ASPECT) -> Vector:
        """From where a view of this shape sees all."""
        aspect = min(max(aspect, 0.2), 5.0) if math.isfinite(aspect) else ASPECT
        height = self.height * self._tall(aspect) / self._tall(ASPECT)
        x, y, _ = self.look_at
        return x, y - 0.5 * (1.0 - SHARE) * self._tall(aspect), min(height, 0.99 * OUT * self.height)

    def prepare(self, initial: Any) -> None:
        """For browsers that come, and for "Reset View" (`viser.InitialCameraConfig`)."""
        initial.fov, initial.near, initial.far = self.field, NEAR * self.height, FAR * self.height
        position = self.position()
        initial.position, initial.look_at, initial.up = position, (*position[:2], 0.0), (0.0, 1.0, 0.0)

    def fit(self, client: Any) -> Vector:
        """Show all in one browser (`viser.ClientHandle`); from where that is."""
        camera, position = client.camera, self.position(_aspect(client.camera))
        with client.atomic():
            camera.min_orbit_distance = 1e-6  # at all times less than the other
            camera.max_orbit_distance = OUT * self.height
            camera.min_orbit_distance = CLOSEST * self.height
            camera.fov, camera.near, camera.far = self.field, NEAR * self.height, FAR * self.height
            self.see(client, position)
        return position

    def allow(self, client: Any) -> None:
        """Let a browser whose camera a person has go as far away as there is something to see; it stays where it is."""
        camera = client.camera
        with client.atomic():
            camera.far = max(FAR * self.height, float(camera.far))  # in this order never NaN
            camera.max_orbit_distance = max(OUT * self.height, float(camera.max_orbit_distance))

    def see(self, client: Any, position: Vector) -> None:
        """Look straight down from there."""
        camera = client.camera
        with client.atomic():
            camera.position = position
            camera.look_at = (*position[:2], 0.0)
            camera.up_direction = (0.0, 1.0, 0.0)

    def closer(self, client: Any, corner: Any, opposite: Any) -> None:
        """Zoom into a rectangle of the screen, its corners (x, y) in 0..1 from the upper left; not into nonsense."""
        try:
            a, b = np.asarray(corner, float), np.asarray(opposite, float)
            x, y, z = (float(c) for c in client.camera.position)
        except (AssertionError, TypeError, ValueError):
            return
        if not (a.shape == b.shape == (2,) and np.isfinite([*a, *b, x, y, z]).all() and z > 0.0):
            return
        a, b = np.clip(a, 0.0, 1.0), np.clip(b, 0.0, 1.0)
        tall = 2.0 * min(z, OUT * self.height) * math.tan(0.5 * self.field)
        aspect = min(max(_aspect(client.camera), 0.2), 5.0)
        middle, share = 0.5 * (a + b) - 0.5, float(np.abs(b - a).max())
        if share < 0.02:  # a click with a trembling hand
            return
        height = min(max(z * share, CLOSEST * self.height), OUT * self.height)
        self.see(client, (x + float(middle[0]) * tall * aspect, y - float(middle[1]) * tall, height))

    def pixel(self, clients: Any) -> float:
        """[m] that a pixel is wide in the browser that is closest; in steps, so that it changes seldom."""
        common = 2.0 * self.height * math.tan(0.5 * self.field) / HEIGHT
        sizes = [size for client in clients if (size := self._pixel(client.camera)) is not None]
        ratio = min(max(min(sizes, default=common) / common, CLOSEST), OUT)
        return common * 2.0 ** (round(2.0 * math.log2(ratio)) / 2.0)

    def _pixel(self, camera: Any) -> float | None:
        """Of one browser; None for what cannot be."""
        try:
            height, tall = float(camera.position[2]), float(camera.image_height)
        except (AssertionError, TypeError, ValueError, IndexError):  # it has not told yet, or told nonsense
            return None
        if not (math.isfinite(height) and math.isfinite(tall) and height > 0.0 and tall >= 1.0):
            return None
        return 2.0 * height * math.tan(0.5 * self.field) / tall


class Cameras:
    """Which browsers have their camera where it was put, and not where a person wants it.

    A slow browser may tell long after that it is where it was put before: the last `REMEMBERED` places count.
    """

    def __init__(self) -> None:
        self._put: dict[int, deque[Vector]] = {}
        """By browser (`ClientHandle.client_id`)."""
        self._offered: deque[Vector] = deque(maxlen=REMEMBERED)
        """Where those begin that come, and where "Reset View" leads."""

    def offer(self, camera: TopCamera, initial: Any) -> None:
        """Those that come, and those that ask for it, see all (`viser.InitialCameraConfig`)."""
        camera.prepare(initial)
        self._offered.append(camera.position())

    def fit(self, camera: TopCamera, client: Any) -> None:
        """Show all in one browser, whoever has its camera."""
        self._put[client.client_id] = deque([camera.fit(client)], REMEMBERED)

    def follow(self, camera: TopCamera, client: Any) -> None:
        """Show all in one browser, unless a person has its camera."""
        with suppress(AssertionError, TypeError, ValueError):  # it has not told yet, or told nonsense
            if self._is_own(client):
                self._put.setdefault(client.client_id, deque(maxlen=REMEMBERED)).append(camera.fit(client))
            else:
                camera.allow(client)

    def gone(self, client: Any) -> None:
        """A browser was closed."""
        self._put.pop(client.client_id, None)

    def _is_own(self, client: Any) -> bool:
        """Whether its camera is where it was put."""
        now = np.asarray(client.camera.position, float)
        places = [*self._offered, *self._put.get(client.client_id, ())]
        return now.shape == (3,) and any(math.dist(now, place) <= SAME * place[2] for place in places)


def _aspect(camera: Any) -> float:
    try:
        return float(camera.image_width) / float(camera.image_height)
    except (AssertionError, TypeError, ValueError, ZeroDivisionError):
        return ASPECT
