"""The layers of the top view: the ground with the truth, every filter, and the particle that was picked.

Heights are those of the nodes, a hair's breadth apart.  Positions are relative to where the parent of all nodes stands,
within the map: single precision is then enough, wherever on earth a map lies.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import viser

from app import colours, shades
from app.ancestry import of_branches
from app.live.engine import Status
from app.panel import shapes
from app.panel.nodes import Dots, Ellipses, Node, Strokes
from app.panel.picking import Pick, Where, ancestry
from app.panel.trails import OdometryTrail
from app.recording.ground import Extent, known, observer, seen
from app.recording.limits import sample, thinned, thinned_tree
from app.relations import Breaks
from app.scans import returns
from app.types import FilterUpdate, SessionInfo, SessionStep, best_descendant
from slam.features import Wall
from slam.features.wall import ends
from slam.geometry import ellipse_axes
from slam.types import Floats, Ints

MOST, MOST_HEADINGS, MOST_FEATURES = 1000, 300, 2000
"""Particles, headings and features of a map that are drawn."""

VERTICES = 800
"""Of a path; of all lineages of a filter as many."""

LEAST = 4.0
"""[px] half axis of the smallest ellipse: what is smaller could be neither seen nor picked."""

POINTER = 14.0
"""[px] length of a heading."""

SQUARES = 8
"""Of the grid, about, over the longer side."""

OFTEN, DIM = 20.0, 0.7
"""A wall that was seen once is to that share background; one that was seen so often not at all."""

NARROW = 0.02
"""[m] up to which the band of a wall is left out."""

GAP = 2.0
"""[s] without a true pose that interrupt the true path."""

PICKED: colours.RGB = (255, 255, 255)

GRID, SCANS, TRUE_MAP, SEEN, ODOMETRY, TRUTH = range(6)
LINEAGES, MAP_ELLIPSES, PATH, RELATIONS, MAP, ELLIPSES, HEADINGS, DOTS, PICK = range(6, 15)
"""Layers, from below.  In each, the first filter is on top, and those below it are drawn a little larger."""


class View(NamedTuple):
    """How to draw."""

    centre: Floats
    """(2,) [m] where the parent of all nodes stands."""
    pixel: float
    """[m] that a pixel is wide, for whoever is closest."""
    lift: float
    """[m] between two layers."""
    off: frozenset[str]
    """What is not to be shown."""

    def at(self, xy: Floats) -> Floats:
        """(n, >= 2) about the centre, without headings."""
        return xy[..., :2] - self.centre

    def poses(self, s: Floats) -> Floats:
        """(n, 3) about the centre, with headings."""
        return s - np.array([*self.centre, 0.0])

    def dots(self, xy: Floats) -> Floats:
        """Segments that are dots at xy (n, >= 2)."""
        return shapes.dots(self.at(xy), 0.02 * self.pixel)


class Layers:
    """Nodes with their layers."""

    rank = 0

    def __init__(self) -> None:
        self.nodes: dict[Node, int] = {}

    def place(self, lift: float) -> None:
        """In heights `lift` [m] apart; of two nodes in one layer the later one is on top."""
        for i, (node, layer) in enumerate(self.nodes.items()):
            within = 0.5 * i / len(self.nodes)
            node.handle.position = (0.0, 0.0, lift * (4 * layer + 3 - self.rank + within))

    def hide(self) -> None:
        """Until something is drawn."""
        for node in self.nodes:
            node.hide()


class GroundLayers(Layers):
    """What is no filter: the grid, the true map, path and robot, dead reckoning, what the sensor sees and has seen."""

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__()
        white = colours.TRUTH_ON_DARK
        self.grid = Strokes(scene, "/map/grid", 1.0, colours.faded((110, 118, 122), 0.75))
        self.scans = Dots(scene, "/map/scans", colours.faded(colours.ODOMETRY, 0.45))
        self.map = Strokes(scene, "/map/truth/map", 4.0, white)
        self.seen = Strokes(scene, "/map/seen", 1.0, colours.WARNING)
        self.odometry = Strokes(scene, "/map/odometry", 1.2, colours.ODOMETRY)
        self.path = Strokes(scene, "/map/truth/path", 1.2, colours.faded(white, 0.3))
        self.heading = Strokes(scene, "/map/truth/heading", 2.4, white)
        self.robot = Strokes(scene, "/map/truth/robot", 9.0, white)
        self._met: tuple[Floats, float] | None = None
        """What `scans` has."""
        self.scale = scene.add_label("/map/scale", "", anchor="bottom-left", font_screen_scale=0.7)
        self.nodes = {
            self.grid: GRID,
            self.scans: SCANS,
            self.map: TRUE_MAP,
            self.seen: SEEN,
            self.odometry: ODOMETRY,
            self.path: TRUTH,
            self.heading: TRUTH,
            self.robot: TRUTH,
        }

    def enter(self, info: SessionInfo) -> None:
        """Another world."""
        steps = info.source.steps
        at = [i for i, step in enumerate(steps) if known(step.truth)]
        self._known = np.array(at, np.int64) + 1
        self._true = np.array([steps[i].truth[:2] for i in at], float).reshape(-1, 2)  # type: ignore[index]
        times = np.array([steps[i].frame.time for i in at])
        # a robot that rests makes no steps: only where somebody could have known, and did not, is there a gap
        unknown = np.diff(self._known, prepend=self._known[:1]) > 1
        self._stretch = np.cumsum(unknown & (np.diff(times, prepend=times[:1]) > GAP))
        self._walls = isinstance(info.source.feature, Wall)
        self._crowd = _crowding(0 if info.source.true_map is None else len(info.source.true_map.theta))
        white, yellow = colours.TRUTH_ON_DARK, colours.WARNING
        self.map.look(3.0 if self._walls else 9.0 * self._crowd, colours.faded(white, 0.74 if self._walls else 0.5))
        self.seen.look(2.0 if self._walls else 1.0, colours.faded(yellow, 0.4 if self._walls else 0.6))

    def draw_grid(self, extent: Extent, centre: Floats) -> None:
        """Over the part of the plane that is shown, with its scale; `centre` (2,) [m] as in `View`."""
        mesh = nice(extent.size / SQUARES)
        low, high = (f(edge / mesh) * mesh for f, edge in ((np.floor, extent.low), (np.ceil, extent.high)))
        x, y = (np.arange(a, b + 0.5 * mesh, mesh) for a, b in zip(low, high, strict=True))
        upright = np.stack([np.stack([x, np.full_like(x, edge)], axis=1) for edge in (low[1], high[1])], axis=1)
        level = np.stack([np.stack([np.full_like(y, edge), y], axis=1) for edge in (low[0], high[0])], axis=1)
        self.grid.put(np.concatenate([upright, level]) - centre)
        self.scale.text = f"one square: {mesh:g} m"
        self.scale.position = (*(extent.low - centre), 0.0)

    def draw_scans(self, met: tuple[Floats, float] | None, view: View) -> None:
        """What all scans met, as `Scanned.along` tells; sent to browsers only if it is something else."""
        if met is None or not len(met[0]) or "scans" in view.off:
            self.scans.hide()
        elif met is self._met:
            self.scans.show()
        else:
            self._met = met
            self.scans.put(view.at(met[0]), met[1])

    def draw_start(self, info: SessionInfo, view: View) -> None:
        """Before the first step."""
        self._draw_map(info, view)
        self._draw_robot(np.asarray(info.source.start, float), view)
        for node in (self.scans, self.seen, self.odometry, self.path):
            node.hide()

    def draw(self, status: Status, step: SessionStep, trail: OdometryTrail, view: View) -> None:
        """After a step."""
        self._draw_map(status.info, view)
        if "truth" in view.off or step.truth is None or not known(step.truth):
            self.robot.hide()
            self.heading.hide()
        else:
            self._draw_robot(step.truth, view)
        self._draw_true_path(step.index, view)
        if "odometry" in view.off:
            self.odometry.hide()
        else:
            path = trail.path(status.branches, status.branch, step.index)
            self.odometry.put(shapes.line(view.at(thinned(path, VERTICES))))
        self._draw_seen(step, view)

    def _draw_map(self, info: SessionInfo, view: View) -> None:
        if info.source.true_map is None or "truth" in view.off:
            self.map.hide()
        else:
            theta = info.source.true_map.theta
            self.map.put(view.at(theta.reshape(-1, 2, 2)) if self._walls else view.dots(theta))

    def _draw_robot(self, pose: Floats, view: View) -> None:
        if "truth" in view.off:
            self.robot.hide()
            self.heading.hide()
        else:
            self.robot.put(view.dots(pose[None]))
            self.heading.put(shapes.headings(view.poses(pose[None]), 1.6 * POINTER * view.pixel))

    def _draw_true_path(self, index: int, view: View) -> None:
        if "truth" in view.off:
            self.path.hide()
            return
        done = int(np.searchsorted(self._known, index, side="right"))
        rows = np.column_stack([self._true[:done], self._stretch[:done].astype(float)])
        rows = thinned(rows, VERTICES) if done else rows
        self.path.put(shapes.line(view.at(rows))[rows[1:, 2] == rows[:-1, 2]])

    def _draw_seen(self, step: SessionStep, view: View) -> None:
        s = observer(step)
        if "seen" in view.off:
            self.seen.hide()
        elif step.frame.scan is not None:
            self.seen.put(view.dots(returns(step.frame.scan, s)))
        else:
            self.seen.put(shapes.rays(view.at(s), view.at(seen(step.frame, s))))


class Shown(NamedTuple):
    """What browsers show of a filter."""

    where: Where
    update: FilterUpdate
    particles: Ints
    """(n,) by instance of the discs."""


class FilterLayers(Layers):
    """One filter."""

    def __init__(self, scene: viser.SceneApi, key: str, rank: int) -> None:
        super().__init__()
        self.rgb = rgb = colours.of_filter(key)
        self.rank, top = rank, f"/map/{key}"
        self.lineages = Strokes(scene, f"{top}/lineages", 1.0)
        self.map_ellipses = Ellipses(scene, f"{top}/map_ellipses", 0.2, rgb)
        self.bands = Strokes(scene, f"{top}/bands", 1.0, colours.faded(rgb, 0.5))
        self.path = Strokes(scene, f"{top}/path", 1.2 + 0.7 * rank, colours.faded(rgb, 0.1))
        self.relations = Strokes(scene, f"{top}/relations", 1.0, colours.broken(rgb))
        self._breaks: Breaks | None = None
        self._broken = np.zeros((0, 2, 2))
        """What `relations` has."""
        self.map = Strokes(scene, f"{top}/map", 2.0)
        self.ellipses = Ellipses(scene, f"{top}/ellipses", 0.1, rgb)
        self.headings = Strokes(scene, f"{top}/headings", 1.0, colours.faded(rgb, 0.35))
        self.dots = Strokes(scene, f"{top}/dots", 3.2 + 0.9 * rank)
        self.nodes = {
            self.lineages: LINEAGES,
            self.map_ellipses: MAP_ELLIPSES,
            self.bands: MAP_ELLIPSES,
            self.path: PATH,
            self.relations: RELATIONS,
            self.map: MAP,
            self.ellipses: ELLIPSES,
            self.headings: HEADINGS,
            self.dots: DOTS,
        }

    def enter(self, info: SessionInfo) -> None:
        """Another world."""
        landmarks = 0 if info.source.true_map is None else len(info.source.true_map.theta)
        walls = isinstance(info.source.feature, Wall)
        self.map.look(1.4 + 1.2 * self.rank if walls else _crowding(landmarks) * (5.0 + 1.6 * self.rank))

    def draw(self, where: Where, update: FilterUpdate, walls: bool, view: View) -> Shown:
        """After a step; all but the lineages."""
        weighted, best = update.trace.weighted, int(update.measures.best)
        theta, Sigma, _ = weighted.maps.features(best)
        self._draw_map(theta, Sigma, walls, view)
        if "paths" in view.off:
            self.path.hide()
        else:
            path = update.genealogy.path(best_descendant(update))
            self.path.put(shapes.line(view.at(thinned(path, VERTICES))))
        return self._draw_particles(where, update, best, view)

    def _draw_map(self, theta: Floats, Sigma: Floats, walls: bool, view: View) -> None:
        for node in (self.map, self.map_ellipses, self.bands):
            node.hide()
        if "maps" in view.off or len(theta) == 0:
            return
        chosen = sample(len(theta), MOST_FEATURES)
        theta, Sigma = theta[chosen], Sigma[chosen]
        if walls:
            dim = DIM * (1.0 - np.log(np.clip(theta[:, 7], 1.0, OFTEN)) / math.log(OFTEN))
            self.map.put(view.at(ends(theta)), shades.faded(self.rgb, dim))
            self.bands.put(view.at(shapes.bands(theta, Sigma, NARROW)))
            return
        self.map.put(view.dots(theta), np.broadcast_to(self.rgb, (len(theta), 3)))
        uncertain = ellipse_axes(Sigma)[0][:, 0] > 0.0
        self.map_ellipses.put(shapes.ellipses(view.at(theta[uncertain]), Sigma[uncertain], 0.5 * LEAST * view.pixel))

    def draw_lineages(self, update: FilterUpdate, alone: bool, view: View) -> None:
        """The paths that lead to living particles; takes as long as all the rest.

        Of a filter alone they have the colours of the ancestry picture; among others, that of the filter.
        """
        branches = [] if "lineages" in view.off else update.genealogy.branches()
        branches, rows, lengths = thinned_tree(branches, max(update.genealogy.steps, 1), VERTICES)
        segments, joined = shapes.lines(view.at(rows), lengths)
        if alone:
            tones = of_branches(update.genealogy, branches, self.rgb)
        else:
            living = np.array([b.living for b in branches], float)
            tones = shades.faded(self.rgb, 0.75 - 0.4 * np.sqrt(living / max(living, default=1.0)))
        self.lineages.put(segments, np.repeat(tones, lengths, axis=0)[1:][joined])

    def draw_relations(self, breaks: Breaks | None, view: View) -> None:
        """Where the path breaks the relations that it is judged by."""
        if breaks is not self._breaks:
            self._breaks, self._broken = breaks, np.zeros((0, 2, 2)) if breaks is None else breaks.shown()
            self.relations.put(view.at(self._broken))
        elif len(self._broken):
            self.relations.show()
        if "relations" in view.off:
            self.relations.hide()

    def _draw_particles(self, where: Where, update: FilterUpdate, best: int, view: View) -> Shown:
        """Ellipses, headings and dots; the heavier ones on top, for eyes and clicks alike."""
        weighted = update.trace.weighted
        chosen = sample(len(weighted.s), MOST, best)
        chosen = chosen[np.argsort(weighted.log_w[chosen], kind="stable")]
        s, P, n = weighted.s[chosen], weighted.P[chosen, :2, :2], len(chosen)
        if "ellipses" in view.off:
            P = np.zeros_like(P)
        rise = view.lift * np.arange(n) / n
        discs = shapes.ellipses(view.at(s), P, LEAST * view.pixel, rise)
        tones = shades.by_brightness(self.rgb, shades.brightness(weighted.log_w[chosen], len(weighted.s)))
        self.ellipses.put(discs, tones, _opacity(n))
        self.dots.put(view.dots(s), tones)
        if "headings" in view.off:
            self.headings.hide()
        else:
            some = s[sample(n, MOST_HEADINGS, n - 1)]
            self.headings.put(shapes.headings(view.poses(some), POINTER * view.pixel))
        return Shown(where, update, chosen)


class PickLayers(Layers):
    """The particle that was picked: its pose, 2-sigma ellipse, map and ancestors."""

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__()
        self.path = Strokes(scene, "/map/pick/path", 1.2, colours.faded(PICKED, 0.2))
        self.map = Strokes(scene, "/map/pick/map", 1.4, PICKED)
        self.outline = Strokes(scene, "/map/pick/outline", 1.6, PICKED)
        self.heading = Strokes(scene, "/map/pick/heading", 2.0, PICKED)
        self.dot = Strokes(scene, "/map/pick/dot", 6.0, PICKED)
        self.nodes = dict.fromkeys((self.path, self.map, self.outline, self.heading, self.dot), PICK)

    def draw(self, pick: Pick | None, walls: bool, view: View) -> None:
        """Or nothing, if there is none."""
        if pick is None:
            self.hide()
            return
        weighted, k = pick.update.trace.weighted, pick.particle
        s, least = weighted.s[k], (LEAST + 1.0) * view.pixel
        self.dot.put(view.dots(s[None]))
        self.outline.put(shapes.outline(view.at(s), weighted.P[k, :2, :2], least))
        self.heading.put(shapes.headings(view.poses(s[None]), 1.4 * POINTER * view.pixel))
        self.path.put(shapes.line(view.at(thinned(ancestry(pick), VERTICES))))
        theta = weighted.maps.features(k)[0]
        theta = theta[sample(len(theta), MOST_FEATURES)]
        self.map.look(1.2 if walls else 3.0)
        self.map.put(view.at(ends(theta)) if walls else view.dots(theta))


def nice(length: float) -> float:
    """The next of 1, 2, 5, 10 ... [m] that is not below `length`."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(f * power for f in (1.0, 2.0, 5.0, 10.0) if f * power >= length * (1.0 - 1e-9))


def _opacity(count: int) -> float:
    """Of so many ellipses that may all lie on each other; few values, since another one is a new mesh for browsers."""
    return 0.22 if count <= 30 else 0.1 if count <= 250 else 0.05


def _crowding(landmarks: int) -> float:
    """Factor on the size of dots for features, so that those of many landmarks do not become one blot."""
    return min(1.0, max(0.45, math.sqrt(80.0 / max(landmarks, 1))))
