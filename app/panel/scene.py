"""The panel's own map: a top view of the session, with particles that can be picked.

Everything lies in the plane, y up, in layers; the page must be dark (`gui.configure_theme(dark_mode=True)`).  Lines and
dots have their size on the screen; ellipses are to scale, but never smaller than a few pixels of whoever is closest.
What is shown of a filter is its step as weighted, before the resampling, as in a recording.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from time import monotonic
from typing import Any

import numpy as np
import viser

from app.live.engine import Status
from app.panel.camera import TopCamera
from app.panel.layers import FilterLayers, GroundLayers, Layers, PickLayers, Shown, View
from app.panel.nodes import flat_light
from app.panel.picking import BEGUN_AGAIN, HINT, Lost, Pick, described, followed, where
from app.panel.trails import OdometryTrail
from app.recording.ground import extent_of
from app.types import SessionInfo
from slam.estimators import ESTIMATORS
from slam.features import Wall

LAYERS = ("truth", "odometry", "seen", "ellipses", "headings", "maps", "paths", "lineages")
"""What can be switched off.  Without ellipses, small discs remain to be clicked."""

ONE_CLICK = 0.3
"""[s] within which two tidings are of one click."""


class TopView:
    """Draws the step where a session stands into viser's scene.

    Callable from any thread; meant to be called by one, as often as it likes: what has not changed costs nothing.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        on_pick: Callable[[str, int], None] | None = None,
        on_clear: Callable[[], None] | None = None,
    ) -> None:
        self._server = server
        self._on_pick, self._on_clear = on_pick, on_clear
        self._lock = threading.RLock()
        self.trail = OdometryTrail()
        """Add it to the listeners of the engine: then the path of dead reckoning is complete."""
        self._info: SessionInfo | None = None
        self._number = -1
        self._camera: TopCamera | None = None
        self._status: Status | None = None
        self._drawn: tuple[Any, ...] | None = None
        self._off: frozenset[str] = frozenset()
        self._pick: Pick | None = None
        self._picked_at = -math.inf
        self._notice = HINT
        self._shown: dict[str, Shown] = {}
        self._stale: dict[str, None] = {}
        """Filters whose lineages are those of an earlier step, the oldest first."""
        self._make_nodes()
        server.scene.on_click()(self._ground_clicked)
        server.scene.on_rect_select()(self._rectangle_drawn)
        server.on_client_connect(self._connected)

    # --- What one can ask for ---------------------------------------------------------------------------------------

    def reset(self, info: SessionInfo) -> None:
        """Another session, perhaps in another world; `show` does it by itself where the session has a new number."""
        with self._lock, self._server.atomic():
            self._begin(info)

    def show(self, status: Status) -> None:
        """Draw the step where the session stands, if that is not what is drawn already."""
        with self._lock:
            if status.number != self._number or self._camera is None:
                self._number = status.number
                self.reset(status.info)
            self.trail.start(status.number, np.asarray(status.info.source.start, float))
            self._status = status
            self._follow(status)
            self._draw(status)

    def visible(self, layer: str, on: bool) -> None:
        """Show or hide one of `LAYERS`, at once."""
        if layer not in LAYERS:
            raise ValueError(f"no layer {layer!r}: there are {', '.join(LAYERS)}")
        with self._lock:
            self._off = self._off - {layer} if on else self._off | {layer}
            if self._status is not None:
                self._draw(self._status)

    def is_visible(self, layer: str) -> bool:
        """Whether it is shown."""
        return layer not in self._off

    @property
    def pick(self) -> Pick | None:
        """The particle that is looked at."""
        return self._pick

    def select(self, key: str, index: int) -> None:
        """Look at a particle of the step that is shown; nothing happens if there is no such particle."""
        self._choose(key, lambda shown: index if 0 <= index < len(shown.update.trace.weighted.s) else None)

    def clear(self) -> None:
        """Look at none."""
        with self._lock:
            had, self._pick, self._notice = self._pick, None, HINT
        if had is not None and self._on_clear is not None:
            self._on_clear()

    def describe_pick(self, status: Status) -> str:
        """Markdown on the picked particle; or why there is none."""
        with self._lock:
            self._follow(status)
            return self._notice if self._pick is None else described(self._pick)

    def fit(self) -> None:
        """Show all of the map, from straight above, in all browsers."""
        for client in self._server.get_clients().values():
            self._connected(client)

    # --- What browsers send, in viser's threads: nothing of it is trusted -------------------------------------------

    def _particle_clicked(self, key: str, event: Any) -> None:
        instance = getattr(event, "instance_index", None)

        def chosen(shown: Shown) -> int | None:
            if isinstance(instance, bool) or not isinstance(instance, int):
                return None
            return int(shown.particles[instance]) if 0 <= instance < len(shown.particles) else None

        self._choose(key, chosen)

    def _choose(self, key: str, chosen: Callable[[Shown], int | None]) -> None:
        with self._lock:
            shown = self._shown.get(key)
            index = None if shown is None else chosen(shown)
            if shown is None or index is None:
                return
            self._pick = Pick(key, index, shown.where, shown.update)
            self._picked_at = monotonic()
        if self._on_pick is not None:
            self._on_pick(key, index)

    def _ground_clicked(self, _: Any) -> None:
        """Clear the pick; but a click on a particle is told as one on the ground, too, before it or after it."""
        if monotonic() - self._picked_at > ONE_CLICK:
            self.clear()

    def _rectangle_drawn(self, event: Any) -> None:
        """Zoom in; a drag would otherwise tilt a map that is flat."""
        if self._camera is not None:
            self._camera.closer(event.client, event.screen_min, event.screen_max)

    def _connected(self, client: viser.ClientHandle) -> None:
        if self._camera is not None:
            self._camera.fit(client)

    # --- A session begins -------------------------------------------------------------------------------------------

    def _make_nodes(self) -> None:
        scene = self._server.scene
        flat_light(scene)
        self._root = scene.add_frame("/map", show_axes=False)
        self._ground = GroundLayers(scene)
        self._filters = {key: FilterLayers(scene, key, rank) for rank, key in enumerate(ESTIMATORS)}
        for key, nodes in self._filters.items():
            nodes.ellipses.handle.on_click(lambda event, key=key: self._particle_clicked(key, event))
        self._picked = PickLayers(scene)
        self._all: tuple[Layers, ...] = (self._ground, *self._filters.values(), self._picked)

    def _begin(self, info: SessionInfo) -> None:
        another = self._info is None or info.source is not self._info.source
        self._info, self._status, self._drawn = info, None, None
        self._shown, self._stale = {}, {}
        if self._pick is not None:
            self._pick, self._notice = None, BEGUN_AGAIN
        for nodes in self._all:
            nodes.hide()
        if another or self._camera is None:
            extent = extent_of(info.source, info.steps)
            camera = self._camera = TopCamera(extent)
            self._root.position = camera.look_at
            for nodes in self._all:
                nodes.place(camera.lift)
            for nodes in self._filters.values():
                nodes.enter(info)
            self._ground.enter(info, extent)
            camera.prepare(self._server.initial_camera)
            self.fit()
        self._ground.grid.show()
        self._ground.draw_start(info, self._view(self._camera))

    # --- Drawing ----------------------------------------------------------------------------------------------------

    def _view(self, camera: TopCamera) -> View:
        pixel = camera.pixel(self._server.get_clients().values())
        return View(camera.centre, pixel, camera.lift, self._off)

    def _follow(self, status: Status) -> None:
        if self._pick is None:
            return
        found = followed(self._pick, status)
        if isinstance(found, Lost):
            self._pick, self._notice = None, found.reason
        else:
            self._pick = found

    def _draw(self, status: Status) -> None:
        """What is different from what is drawn."""
        if self._camera is None:
            return
        view, walls = self._view(self._camera), isinstance(status.info.source.feature, Wall)
        how = (where(status), view.pixel, self._off)
        same = self._drawn is not None and self._drawn[0] is status.taken and self._drawn[1] == how
        if same and not self._stale and self._drawn is not None and self._drawn[2] is self._pick:
            return
        with self._server.atomic():
            if not same:
                self._draw_step(status, walls, view)
            self._draw_lineages(status.playing, view)
            self._picked.draw(self._pick, walls, view)
        self._drawn = (status.taken, how, self._pick)

    def _draw_step(self, status: Status, walls: bool, view: View) -> None:
        step, now = status.taken.step if status.taken else None, where(status)
        if step is None or now is None:
            for nodes in self._filters.values():
                nodes.hide()
            self._shown, self._stale = {}, {}
            self._ground.draw_start(status.info, view)
            return
        self.trail.note(status.branch, step.index, step.odometry)
        self._ground.draw(status, step, self.trail, view)
        shown = {}
        for key, nodes in self._filters.items():
            update = step.filters.get(key)
            if update is None:
                nodes.hide()
            else:
                shown[key] = nodes.draw(now, update, walls, view)
        self._shown = shown
        self._stale = dict.fromkeys([*(key for key in self._stale if key in shown), *shown])

    def _draw_lineages(self, playing: bool, view: View) -> None:
        """Those that were not drawn for longest, of one filter while the session runs: they are expensive."""
        for key in list(self._stale)[: 1 if playing else None]:
            del self._stale[key]
            if key in self._shown:
                self._filters[key].draw_lineages(self._shown[key].update, view)
