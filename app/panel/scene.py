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
from typing import Any, NamedTuple

import numpy as np
import viser

from app.live.engine import Status
from app.live.history import Taken
from app.live.judge import Judge
from app.pace import Pace
from app.panel.camera import Cameras, TopCamera
from app.panel.layers import FilterLayers, GroundLayers, Layers, PickLayers, Shown, View
from app.panel.nodes import flat_light
from app.panel.picking import BEGUN_AGAIN, HINT, Lost, Pick, described, followed, where
from app.panel.trails import OdometryTrail
from app.paths import MATCHED, ODOMETRY
from app.recording.ground import Extent, Scanned, Survey, extent_of, is_charted
from app.relations import Breaks
from app.types import SessionInfo, SessionStep, best_descendant, best_path
from slam.estimators import ESTIMATORS
from slam.features import Wall
from slam.types import Floats

LAYERS = ("truth", "odometry", "seen", "ellipses", "headings", "maps", "paths", "lineages", "scans", "relations")
"""What can be switched off.  Without ellipses, small discs remain to be clicked."""

BEGIN = 10.0
"""[m] around the start that are shown of a log of which nobody knows where it leads."""

ROOM = 0.25
"""Share of what was visited that is left around it, when what is shown is too little."""

DUTY = 0.05
"""Share of the time that may be spent on what takes long, while the session runs: scans and relations."""

ONE_CLICK = 0.3
"""[s] within which two tidings are of one click."""


class Found(NamedTuple):
    """What takes long to find of a step."""

    taken: Taken | None
    met: tuple[Floats, float] | None
    """What all scans met (`Scanned.along`); None if nobody wants to know."""
    breaks: dict[str, Breaks]
    """By filter, where its path breaks relations."""


NOTHING = Found(None, None, {})


class TopView:
    """Draws the step where a session stands into viser's scene.

    Callable from any thread; meant to be called by one, as often as it likes: what has not changed costs nothing.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        on_pick: Callable[[str, int], None] | None = None,
        on_clear: Callable[[], None] | None = None,
        judge: Judge | None = None,
    ) -> None:
        """`judge`, a listener of the engine, knows where paths break relations."""
        self._server = server
        self._judge = judge
        self._on_pick, self._on_clear = on_pick, on_clear
        self._lock = threading.RLock()
        self.trail = OdometryTrail()
        """Add it to the listeners of the engine: then the path of dead reckoning is complete."""
        self._info: SessionInfo | None = None
        self._number = -1
        self._camera: TopCamera | None = None
        self._cameras = Cameras()
        self._centre = np.zeros(2)
        """[m] where all nodes have their parent."""
        self._survey: Survey | None = None
        """Of a log of which nobody knows where it leads."""
        self._scanned: Scanned | None = None
        self._found = NOTHING
        self._pace = Pace(DUTY)
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
        server.on_client_disconnect(self._cameras.gone)

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

    def layers(self, info: SessionInfo) -> tuple[str, ...]:
        """Those of `LAYERS` that a session has."""
        idle = {"scans": info.source.scans is None, "relations": self._judge is None or not self._judge.knows(info)}
        return tuple(layer for layer in LAYERS if not idle.get(layer))

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

    def describe_relations(self) -> str:
        """Markdown on how well the paths fit relations, as of the last step of which that was found; empty without."""
        breaks = self._found.breaks
        titles = {key: estimator.title for key, estimator in ESTIMATORS.items()}
        titles |= {alone: f"{alone} alone" for alone in (ODOMETRY, MATCHED)}
        return "\n".join(f"- relations, {titles[key]}: {breaks[key].told()}" for key in titles if key in breaks)

    def fit(self) -> None:
        """Show all of the map, from straight above, in all browsers: of a log, all that was visited so far."""
        with self._lock:
            tightened = self._survey.tightened() if self._survey is not None else None
            if tightened is not None:
                self._frame(tightened)
            self._fit()

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
        with self._lock:
            if self._camera is not None:
                self._cameras.fit(self._camera, client)

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
            self._enter(info)
            self._fit()
        elif self._survey is not None:
            self._frame(self._first_extent(info))
            self._follow_map()
        self._found = NOTHING
        self._ground.grid.show()
        if self._camera is not None:
            self._ground.draw_start(info, self._view(self._camera))

    def _enter(self, info: SessionInfo) -> None:
        """Another world."""
        extent = self._first_extent(info)
        self._centre = extent.centre
        self._root.position = (float(extent.centre[0]), float(extent.centre[1]), 0.0)
        self._scanned = None if info.source.scans is None else Scanned(info.source)
        for nodes in self._filters.values():
            nodes.enter(info)
        self._ground.enter(info)
        self._frame(extent)

    def _first_extent(self, info: SessionInfo) -> Extent:
        """What is shown in the beginning."""
        if is_charted(info.source, info.steps):
            self._survey = None
            return extent_of(info.source, info.steps)
        start = np.asarray(info.source.start, float)[:2]
        extent = Extent(start - BEGIN, start + BEGIN)
        self._survey = Survey(extent, ROOM)
        return extent

    # --- What part of the plane is shown ----------------------------------------------------------------------------

    def _frame(self, extent: Extent) -> None:
        """Prepare for another part of the plane; no browser sees it yet."""
        camera = self._camera = TopCamera(extent)
        for nodes in self._all:
            nodes.place(camera.lift)
        self._ground.draw_grid(extent, self._centre)
        self._cameras.offer(camera, self._server.initial_camera)

    def _fit(self) -> None:
        """Show it in all browsers."""
        for client in self._server.get_clients().values():
            self._connected(client)

    def _follow_map(self) -> None:
        """Show it where nobody has zoomed or moved."""
        for client in self._server.get_clients().values():
            if self._camera is not None:
                self._cameras.follow(self._camera, client)

    def _visit(self, step: SessionStep) -> None:
        """Show more, if the filters have been where nothing is shown; the step may be one of the past."""
        if self._survey is None or not step.filters:
            return
        paths = np.concatenate([update.genealogy.path(best_descendant(update)) for update in step.filters.values()])
        outgrown = self._survey.outgrown(paths)
        if outgrown is not None:
            with self._server.atomic():
                self._frame(outgrown)
                self._follow_map()

    # --- Drawing ----------------------------------------------------------------------------------------------------

    def _view(self, camera: TopCamera) -> View:
        pixel = camera.pixel(self._server.get_clients().values())
        return View(self._centre, pixel, camera.lift, self._off)

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
        if status.taken is not None and (self._drawn is None or self._drawn[0] is not status.taken):
            self._visit(status.taken.step)
        view, walls = self._view(self._camera), isinstance(status.info.source.feature, Wall)
        how = (where(status), view.pixel, view.lift, self._off)
        same = self._drawn is not None and self._drawn[0] is status.taken and self._drawn[1] == how
        found = self._find(status)
        if same and not self._stale and not found and self._drawn is not None and self._drawn[2] is self._pick:
            return
        with self._server.atomic():
            if not same:
                self._draw_step(status, walls, view)
            if found or not same:
                self._draw_found(view)
            self._draw_lineages(status.playing, view)
            self._picked.draw(self._pick, walls, view)
        self._drawn = (status.taken, how, self._pick)

    def _find(self, status: Status) -> bool:
        """What takes long: seldom while the session runs, else at once; whether there is something new."""
        taken = status.taken
        if taken is None:
            before, self._found = self._found, NOTHING
            return before is not NOTHING
        wanted = self._scanned is not None and "scans" not in self._off
        if self._found.taken is taken and (self._found.met is not None or not wanted):
            return False
        if status.playing and not self._pace.due:
            return False
        with self._pace.kept():
            first = next(iter(taken.step.filters.values()), None)
            met = self._scanned.along(best_path(first)) if self._scanned and wanted and first else None
            breaks = self._judge.breaks(status.number, status.branch, taken.step) if self._judge else {}
            self._found = Found(taken, met, breaks)
        return True

    def _draw_found(self, view: View) -> None:
        """Scans and relations, as they were found last."""
        self._ground.draw_scans(self._found.met, view)
        for key in self._shown:
            self._filters[key].draw_relations(self._found.breaks.get(key), view)

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
                self._filters[key].draw_lineages(self._shown[key].update, len(self._shown) == 1, view)
