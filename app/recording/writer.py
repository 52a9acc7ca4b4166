"""From a session to the entities of a recording: what is written when, and on which timelines."""

from __future__ import annotations

import copy
import itertools
import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from typing import Literal, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from app import ancestry, colours
from app.events import Watch
from app.pace import Pace
from app.recording import arrow, charts, landmarks, scene, texts, walls
from app.recording.blueprint import MAP_ASPECT, Shown, layout_of_branches
from app.recording.ground import Extent, Scanned, Survey, estimates, extent_of, is_charted, known, observer
from app.recording.limits import due, limits_for, thinned
from app.recording.metrics import METRICS, known_of, populations
from app.recording.stream import BranchStream, OpenStream
from app.relations import Breaks
from app.session import estimators
from app.types import FilterUpdate, SessionInfo, SessionStep, best_descendant, best_path
from slam.estimators import ESTIMATORS
from slam.features import Wall
from slam.geometry import ellipse_axes
from slam.types import Floats, Frame, Particles

EPOCH = 1e7
"""[s] beyond which a log's clock counts from a distant past; `sim_time` then counts from the log's start."""

SHARPEST = 1e-3
"""[m] smallest square of a close-up's grid: single precision shows no more of a map."""

BORDERS = {
    f"{metric.name}/{side}": value
    for metric in METRICS
    if metric.band is not None
    for side, value in zip(("lower", "upper"), metric.band, strict=True)
}
"""Series in `/plots` that are the same at every step."""

GUIDES = dict.fromkeys(BORDERS, "95 % band") | {"n_eff/threshold": "resampling below"}
"""All that belong to no filter, with their names."""

Detail = Literal["usual", "all", "present", "numbers"]
"""What is written of a step: pictures as often as their turn comes; all of them; the particles as they are weighted,
and resampled if they were, but nothing of what lies behind (maps of all particles, lineages, ancestry); no picture."""

Judge = Callable[[SessionStep], Mapping[str, Breaks]]
"""Tells after a step where the paths of odometry, of matching alone and of each filter break relations."""

OF_A_BRANCH = ("n_eff/threshold",)
"""Those of them that may differ from the run's."""

WIDTH, BRANCH_WIDTH = 1.8, 0.9
"""[points] of the lines of a run and of its branches in plots."""

GUIDE: colours.RGB = (140, 140, 140)

DUTY = 0.05
"""Share of the time that scans and relations may take where all pictures are written, for viewers."""

LESSON = "lesson"
"""The page of a lesson."""

TRUTH_GAP = 2.0
"""[s] without a true pose after which the true robot is no longer shown, and its path interrupted."""


def unused(name: str, taken: Collection[str]) -> str:
    """The name, or with a number behind it."""
    names = itertools.chain([name], (f"{name}-{i}" for i in itertools.count(2)))
    return next(n for n in names if n not in taken)


def slug(name: str) -> str:
    """A name as a part of an entity path."""
    return re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-.") or "branch"


class Trunk(NamedTuple):
    """Where a branch belongs."""

    writer: Writer
    prefix: str
    """Of its entities; ends in a slash."""
    label: str
    """Its name, for people."""
    path: str
    """The name that it has in the recording."""
    parent: str
    """That of the branch that it left, empty for the run itself."""


class TruePath:
    """Where the robot was, as far as anybody knows."""

    def __init__(self) -> None:
        self.stretches: list[list[Floats]] = []
        """Of the path along which the truth is known."""
        self.lost = False
        """Whether nobody has known it since, for longer than `TRUTH_GAP`."""
        self._seen = -math.inf
        """[s] when it was known last."""

    def add(self, truth: Floats | None, time: float) -> None:
        """One more pose (3,), at a time [s], if it is known."""
        if truth is not None and known(truth):
            if self.lost or not self.stretches:
                self.stretches.append([])
            self.stretches[-1].append(truth)
            self._seen, self.lost = time, False
        elif self.stretches and time - self._seen > TRUTH_GAP:
            self.lost = True


class Writer:
    """One recording that is being written, or a branch of one."""

    def __init__(
        self,
        info: SessionInfo,
        open_stream: OpenStream,
        aspect: float = MAP_ASPECT,
        trunk: Trunk | None = None,
        judge: Judge | None = None,
        lesson: tuple[str, str] | None = None,
    ) -> None:
        """`aspect` is the width over the height of the map view; `trunk` is what a branch belongs to (`fork`); `judge`
        knows where paths break relations; `lesson` is what this run is called in a lesson, and its text, Markdown."""
        self._info, self._judge, self._trunk = info, judge, trunk
        self._last: SessionStep | None = None
        self._pace = Pace(DUTY)
        self._pictured = 0
        """The last step of which there are pictures."""
        self._complete = 0
        """The last step of which every picture was written."""
        self._judged = 0
        """The last step of which relations were written."""
        self._limits = limits_for(info.steps)
        self._features = walls if isinstance(info.source.feature, Wall) else landmarks
        self._watch = Watch({key: estimator.title for key, estimator in ESTIMATORS.items()}, info.source.has_clock)
        self._truth = TruePath()
        self._matched: list[Floats] = []
        self._odometry: list[Floats] = [] if trunk else [np.asarray(info.source.start, float)]
        self._time_origin = _origin(info)
        self._picked = ""
        """The filter of which a particle is shown that somebody looks at."""
        self._unit: dict[str, float] = {}
        self._labelled: dict[str, float] = {}
        self._rank = 0 if trunk is None else 1 + len(trunk.writer._branches)
        """Among a run and its branches."""
        landmarks_there = 0 if info.source.true_map is None else len(info.source.true_map.theta)
        self._crowd = scene.crowding(landmarks_there)
        self._guides = GUIDES if trunk is None else {path: GUIDES[path] for path in OF_A_BRANCH}
        self._branches: dict[str, Writer] = {}
        self._axis = 0
        """[steps] of the time axis of the ancestry picture; 0 before there is one."""
        self._most = 0
        """The largest number of particles so far."""
        self._scale = 0
        """The one that the axis of what is left of the ancestors has; 0 before there is one."""
        self._descended: dict[str, int] = {}
        """By filter the last step of which the ancestors are written."""
        self._on = {f.key for f in info.filters}
        self._survey_ground(aspect)
        self._arrange()
        self._begin(open_stream, lesson)

    def _survey_ground(self, aspect: float) -> None:
        """How large the world is, what all scans met, and what the windows show of it at first."""
        info, extent = self._info, extent_of(self._info.source, self._info.steps)
        self._size, self._height = extent.size, extent.eye_height(aspect)
        self._lift = scene.LIFT * self._height
        self._survey = None if is_charted(info.source, info.steps) else Survey(extent)
        self._scanned = None if info.source.scans is None else Scanned(info.source)
        known_of_it = known_of(info.source, info.steps) | ({"relations"} if self._judge is not None else set())
        self._shown = Shown(tuple(info.filters), extent, known_of_it, self._features.LEGEND, aspect=aspect)
        if self._trunk is not None:  # of one session
            of_run, trunk = self._trunk.writer, self._trunk
            self._survey, self._scanned = copy.copy(of_run._survey), of_run._scanned
            self._shown = self._shown._replace(
                extent=of_run._shown.extent, prefix=trunk.prefix, label=trunk.label, lesson=of_run._shown.lesson
            )

    def _begin(self, open_stream: OpenStream, lesson: tuple[str, str] | None) -> None:
        """Open the stream, and write what does not change."""
        if lesson is not None:
            self._shown = self._shown._replace(label=lesson[0], lesson=LESSON)
        title = self._shown.named(f"{self._info.source.name}, seed {self._info.seed}")
        self._stream = open_stream(layout_of_branches([self._shown]), title)
        self._write_static()
        if lesson is not None:
            self.teach(lesson[1])
        self._stream.begun()

    def fork(self, info: SessionInfo, name: str, judge: Judge | None = None) -> Writer:
        """A branch beside it, under `/branch/<name>/` and on the same timelines; of a branch, one beside that.

        It shares the stream, so both are written from one thread, and closing the branch closes nothing.
        """
        if self._trunk is not None:
            return self._trunk.writer._branch(info, name, judge, self._trunk.path)
        return self._branch(info, name, judge, "")

    def _branch(self, info: SessionInfo, name: str, judge: Judge | None, parent: str) -> Writer:
        path = unused(slug(name), self._branches)
        trunk = Trunk(self, f"branch/{path}/", name, path, parent)
        stream = BranchStream(self._stream, path)
        self._branches[path] = Writer(info, lambda *_: stream, self._shown.aspect, trunk, judge)
        self.show()
        return self._branches[path]

    def _look_at(self, extent: Extent | None) -> None:
        """Have the windows show another part of the plane, unless it is None."""
        if extent is not None:
            self._shown = self._shown._replace(extent=extent)
            self.show()

    def show(self) -> None:
        """Lay out the windows anew: the run with its branches."""
        if self._trunk is not None:
            self._trunk.writer.show()
        else:
            branches = [self._shown, *(branch._shown for branch in self._branches.values())]
            self._stream.show(layout_of_branches(branches))

    def step(self, step: SessionStep, detail: Detail = "usual") -> None:
        """One observing step.

        `stage` has three moments of it.  `step` and `sim_time` have one: the particles as they are weighted, and all
        else as it is when the step is done.
        """
        stage = 3 * (step.index - 1) + 1
        now = self._now(step)

        self._stream.set_time(stage, *now)
        self._notice(step.filters.keys())
        self._remember(step)
        if self._survey is not None:
            self._look_at(self._survey.outgrown(estimates(step)))
        if detail != "numbers":
            self._write_pictures(step, stage, now, detail)

        self._stream.set_time(stage + 2, *now)
        for key, update in step.filters.items():
            plotted = arrow.scalars([metric.value(update) for metric in METRICS])
            for metric, value in zip(METRICS, plotted, strict=True):
                self._stream.log(f"plots/{metric.name}/{key}", value)
            self._stream.log(f"evidence/{key}", charts.evidence(update.evidence))
            self._write_ancestors(key, update, step, stage + 2)
        self._write_guides(step)
        for event in self._watch.step(step):
            line = rr.TextLog(
                f"{step.index}: {event.text}",
                level=event.level,
                color=colours.of_filter(event.who) if event.who else None,
            )
            self._stream.log("events", line)
        self._stream.check()

    def _write_pictures(self, step: SessionStep, stage: int, now: tuple[int, float], detail: Detail) -> None:
        """All but numbers."""
        everything = detail == "all"  # however seldom its turn is in a long run
        self._pictured = step.index
        self._write_surroundings(step, everything)
        for key, update in step.filters.items():
            self._write_focus(key, update, step.truth)

        moments = detail != "present"  # or else only the one that the other timelines have
        self._stream.set_time(stage)
        for key, update in step.filters.items() if moments else ():
            self._write_particles(key, update.trace.predicted, int(update.measures.best))

        self._stream.set_time(stage + 1, *now)
        for key, update in step.filters.items():
            weighted = update.trace.weighted
            self._write_particles(key, weighted, int(update.measures.best))
            self._write_observations(key, update, step.frame)
            bars = charts.weight_bars(weighted, self._limits, colours.of_filter(key))
            self._stream.log(f"weights/{key}", bars)

        self._write_picked(step)

        self._stream.set_time(stage + 2)
        for key, update in step.filters.items():
            if moments or update.trace.did_resample:
                self._write_particles(key, update.trace.resampled, best_descendant(update))

        self._stream.set_time(stage + 2, *now)
        picture = moments and (everything or due(step.index, self._info.steps, self._limits.pictures))
        self._write_descent(step, picture)
        for key, update in step.filters.items():
            self._write_memory(key, update, step.index, everything, picture)
        if self._has_time_for_the_log(step, detail):
            with self._pace.kept():
                self._write_scans(step)
                self._write_relations(step)
            if everything or due(step.index, self._info.steps, self._limits.paths):
                self._complete = step.index

    def teach(self, text: str) -> None:
        """The page of a lesson, Markdown, in place of what stood there."""
        self._stream.log_static(LESSON, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def close(self) -> None:
        """Complete the file."""
        for writer in (self, *self._branches.values()):
            writer.complete()
            found = None if writer._survey is None else writer._survey.found()
            writer._shown = writer._shown._replace(extent=found or writer._shown.extent)
        if self._survey is not None:
            self.show()
        self._stream.close()

    def complete(self) -> None:
        """Bring all pictures up to the last step, and how well the paths fit relations, if they are older."""
        step = self._last
        if step is None:
            return
        old = self._complete != step.index
        if self._pictured != step.index:
            self._write_pictures(step, 3 * (step.index - 1) + 1, self._now(step), "present")
        self._stream.set_time(3 * step.index, *self._now(step))
        if old:
            self._write_surroundings(step, everything=True)
            self._write_descent(step, picture=True)
            for key, update in step.filters.items():
                self._write_memory(key, update, step.index, everything=True, picture=True)
            self._write_scans(step)
        self._write_relations(step)

    def _now(self, step: SessionStep) -> tuple[int, float]:
        """Of a step, on the timelines that are not about parts of it."""
        return step.index, step.frame.time - self._time_origin

    def _write_static(self) -> None:
        info, log = self._info, self._stream.log_static
        described = texts.description(info, self._time_origin)
        if self._trunk is not None:
            described["parent"] = self._trunk.parent
        self._stream.property("session", rr.AnyValues(json=json.dumps(described)))
        for entity, page in {
            "about": texts.about(info, self._limits),
            "params": texts.parameter_page(described),
        }.items():
            log(entity, rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN))
        if info.source.true_map is not None:
            log("world/truth/map", self._features.true_map(info.source.true_map.theta, self._lift))
        for entity, look in (scene.looks_of_surroundings() | self._features.looks_of_surroundings(self._crowd)).items():
            log(f"world/{entity}", *look)
        for path, name in self._guides.items():
            log(f"plots/{path}", rr.SeriesLines(names=self._shown.named(name), colors=GUIDE, widths=1.0))
        log("evidence", charts.evidence_names())
        self._write_looks()

    def _arrange(self) -> None:
        """Styles of the filters, and the parts of the picture of their ancestry."""
        keys = [f.key for f in self._shown.filters]
        self._styles = {k: scene.Style(colours.of_filter(k), rank, self._lift) for rank, k in enumerate(keys)}
        self._many = populations(keys)
        bands = charts.bands(len(self._many))
        self._axis = 0
        self._bands = dict.fromkeys(keys, bands[-1]) | dict(zip(self._many, bands, strict=True))

    def _write_looks(self) -> None:
        """What depends on which filters there are."""
        log, branch = self._stream.log_static, self._trunk is not None
        for f in self._shown.filters:
            rgb, style, title = colours.of_filter(f.key), self._styles[f.key], self._shown.named(f.title)
            for entity, look in (scene.looks(style) | self._features.looks(style, self._crowd)).items():
                if entity != "relations" or self._judge is not None:
                    log(f"world/{f.key}/{entity}", *look)
            for metric in METRICS:
                line = rr.SeriesLines(names=title, colors=self._curve(rgb), widths=BRANCH_WIDTH if branch else WIDTH)
                log(f"plots/{metric.name}/{f.key}", line)
            if f.key in self._many:
                log(f"genealogy/frame/{f.key}", charts.ancestry_frame(self._bands[f.key], rgb))
                log(f"genealogy/{f.key}/lags", charts.look_of_lag_curve(rgb))
                log(f"genealogy/{f.key}/words", charts.look_of_words(self._bands[f.key], rgb))
        log("genealogy/cursor", charts.look_of_cursor())

    def _curve(self, rgb: colours.RGB) -> colours.RGB:
        """The shade of a filter's colour for its curves: a lesson may have many runs, and has all of them at once."""
        return colours.of_run(rgb, self._rank, on_dark=True) if self._shown.lesson else rgb

    def _notice(self, keys: Collection[str]) -> None:
        """Filters that were switched on or off: the windows keep a place for what was there once."""
        there = {f.key for f in self._shown.filters}
        new = estimators((key for key in keys if key not in there), self._info.mistake)
        for key in self._on - set(keys):
            self._stream.log(f"world/{key}", rr.Clear(recursive=True))
            self._labelled = {
                entity: u for entity, u in self._labelled.items() if not entity.startswith(f"world/{key}/")
            }
        self._on = set(keys)
        if new:
            order = list(ESTIMATORS)
            filters = sorted([*self._shown.filters, *new], key=lambda f: order.index(f.key))
            self._shown = self._shown._replace(filters=tuple(filters))
            self._arrange()
            self._write_looks()
            self.show()

    def _remember(self, step: SessionStep) -> None:
        """Where the robot and dead reckoning were, and the largest K; also of steps of which there is no picture."""
        if self._last is None:  # steps before this recording, or before the branch left, had another K maybe
            self._most = max((int(u.genealogy.sizes.max()) for u in step.filters.values()), default=0)
        self._last, self._most = step, max(self._most, step.params.particles)
        self._truth.add(step.truth, step.frame.time)
        self._odometry.append(step.odometry)
        if step.matched is not None:
            self._matched.append(step.matched)

    def _write_surroundings(self, step: SessionStep, everything: bool) -> None:
        redraw = everything or due(step.index, self._info.steps, self._limits.paths)
        z, length, log = self._lift, self._size / 30, self._stream.log
        if step.truth is not None and known(step.truth):
            log("world/truth/robot", *scene.robot(step.truth, scene.TRUTH * z, length))
        elif self._truth.lost:
            log("world/truth/robot", rr.Clear(recursive=False))  # nobody knows where it is
        if redraw and self._truth.stretches:
            share = max(2, self._limits.vertices // len(self._truth.stretches))
            paths = [thinned(np.array(stretch), share) for stretch in self._truth.stretches if len(stretch) > 1]
            log("world/truth/path", scene.lines(paths, scene.TRUTH * z))
        if redraw:
            path = thinned(np.array(self._odometry), self._limits.vertices)
            log("world/odometry/path", scene.lines([path], scene.ODOMETRY * z))
            if len(self._matched) > 1:
                path = thinned(np.array(self._matched), self._limits.vertices)
                log("world/matching/path", scene.lines([path], scene.ODOMETRY * z))
        log("world/scan", *self._features.scan(step.frame, observer(step), z))

    def _write_focus(self, key: str, update: FilterUpdate, truth: Floats | None) -> None:
        """Frames of the close-ups: one on particles and truth, however far apart, one on the best particle alone."""
        measures, weighted = update.measures, update.trace.weighted
        centre = measures.estimate[:2]
        spread = _spread(measures.covariance)
        if truth is not None and known(truth):
            spread = max(spread, float(np.hypot(*(truth[:2] - centre))) / 2.0)
        self._unit[key] = scene.nice(max(spread, SHARPEST))
        best = int(measures.best)
        own = _spread(weighted.P[best])
        frames = {
            "focus": (centre, self._unit[key]),
            "best": (weighted.s[best, :2], scene.nice(max(own, SHARPEST)) if own > 0.0 else self._unit[key]),
        }
        for name, (middle, unit) in frames.items():
            entity = f"world/{key}/{name}"
            self._stream.log(entity, scene.close_up(middle, unit, self._height))
            if self._labelled.get(entity) != unit:
                self._stream.log(f"{entity}/scale", scene.close_up_label(unit))
                self._labelled[entity] = unit

    def _write_particles(self, key: str, particles: Particles, best: int) -> None:
        style, log = self._styles[key], self._stream.log
        drawn = scene.particles(particles, self._limits, best, self._unit[key], style)
        log(f"world/{key}/particles", *drawn, *self._features.beside_particles(particles, best, style))
        log(f"world/{key}/ellipses", scene.particle_ellipses(particles, self._limits, best, style))

    def _write_picked(self, step: SessionStep) -> None:
        """The particle that somebody looks at: pose, ellipse, path, and its own map; nothing when nobody does."""
        key, k = step.picked or ("", 0)
        if self._picked and self._picked != key:
            self._stream.log(f"world/{self._picked}/picked", rr.Clear(recursive=True))
            self._picked = ""
        update = step.filters.get(key)
        if update is None or not 0 <= k < len(update.trace.weighted.s):
            return
        self._picked, weighted, style = key, update.trace.weighted, self._styles[key]
        living = np.flatnonzero(update.trace.selected == k)  # a particle that dies in this step leaves no path
        way = update.genealogy.path(int(living[0])) if len(living) else weighted.s[[k, k]]
        label = f"particle {k}, weight times K: {len(weighted.s) * math.exp(weighted.log_w[k]):.3g}"
        self._stream.log(f"world/{key}/picked", *scene.picked(weighted.s[k], weighted.P[k], way, label, style))
        theta, _, _ = weighted.maps.features(k)
        self._stream.log(f"world/{key}/picked/map", *self._features.picked_map(theta, style))

    def _write_observations(self, key: str, update: FilterUpdate, frame: Frame) -> None:
        """What the best particle sees, and what it takes it for."""
        best, weighted = int(update.measures.best), update.trace.weighted
        n = update.trace.n[best]
        theta, _ = weighted.maps.select(np.array([best])).take(n[None])
        seen = self._features.observations(frame, weighted.s[best], n, theta[0], self._styles[key])
        for entity, what in seen.items():
            self._stream.log(f"world/{key}/{entity}", *what)

    def _write_memory(self, key: str, update: FilterUpdate, index: int, everything: bool, picture: bool) -> None:
        """What the filter remembers: maps, paths, ancestry."""
        style, limits, log = self._styles[key], self._limits, self._stream.log
        weighted, steps = update.trace.weighted, self._info.steps
        if picture or update.measures.features <= limits.features:
            theta, Sigma, _ = weighted.maps.features(int(update.measures.best))
            for entity, what in self._features.best_map(theta, Sigma, style).items():
                log(f"world/{key}/{entity}", *what)
        if everything or due(index, steps, limits.paths):
            log(f"world/{key}/path", scene.path(update.genealogy.path(best_descendant(update)), limits, style))
        if picture:
            log(f"world/{key}/maps", self._features.all_maps(weighted.maps, limits, style))
            log(f"world/{key}/lineages", scene.lineages(update.genealogy, limits, style))
            log(f"genealogy/{key}", charts.ancestry(update.genealogy, self._bands[key], self._axis, style.rgb))
            copies, holders = weighted.maps.hypotheses()
            numbers = rr.AnyValues(copies=pa.array(copies, pa.int32()), maps=pa.array(holders, pa.int32()))
            log(f"hypotheses/{key}", charts.hypothesis_bars(copies, style.rgb), numbers)
            of_best = copies[weighted.maps.indices(int(update.measures.best))]
            log(f"world/{key}/map", rr.AnyValues(hypotheses=pa.array(of_best, pa.int32())))  # shown where the mouse is

    def _write_descent(self, step: SessionStep, picture: bool) -> None:
        """What of the ancestry is cheap enough for every step: how many are left, by lag and in words, and the cursor;
        with a new picture, a time axis that is long enough until the next one; and after K grew, another scale."""
        first, last = self._bands[self._many[0]], self._bands[self._many[-1]]
        axis = charts.time_axis(step.index + self._limits.pictures - 1, self._info.steps)
        if picture and axis != self._axis:
            self._axis = axis
            self._stream.log("genealogy/frame/time", charts.time_marks(last, axis))
        if self._most != self._scale:
            self._scale = self._most
            self._stream.log("genealogy/frame/lags", *charts.lag_frame(self._info.steps, self._scale))
        lags = ancestry.lags(step.index)
        back = pa.array(lags, pa.int32())
        for f in self._shown.filters:
            update = step.filters.get(f.key)
            if update is not None and f.key in self._many:
                left = update.genealogy.distinct(lags)
                curve = charts.lag_curve(lags, left, self._info.steps, self._scale)
                numbers = rr.AnyValues(steps_back=back, ancestors=pa.array(left, pa.int32()))
                self._stream.log(f"genealogy/{f.key}/lags", curve, numbers)
                said = f"{ESTIMATORS[f.key].title}: {ancestry.brief(update)}"  # no mistakes: views are narrow
                self._stream.log(f"genealogy/{f.key}/words", charts.words(said))
        if self._axis:
            self._stream.log("genealogy/cursor", charts.cursor(step.index, self._axis, first, last))

    def _write_ancestors(self, key: str, update: FilterUpdate, step: SessionStep, stage: int) -> None:
        """Of which particle before a step each one after it is a copy, wherever it is not simply the same.

        Also of steps that a recording does not have otherwise: it may have begun late, and a viewer's loses some.
        """
        done = self._descended.get(key, 0)
        self._descended[key] = step.index
        found = (update.trace.ancestors,) if done == step.index - 1 else update.genealogy.ancestors[done:]
        for index, ancestors in enumerate(found, done + 1):
            if index == 1 or not np.array_equal(ancestors, np.arange(len(ancestors))):
                if index < step.index:
                    self._stream.set_time(3 * index, index)
                self._stream.log(f"ancestors/{key}", rr.AnyValues(ancestors=pa.array(ancestors, pa.uint32())))
                if index < step.index:
                    self._stream.set_time(stage, *self._now(step))

    def _has_time_for_the_log(self, step: SessionStep, detail: Detail) -> bool:
        """Whether it is the turn of what all scans tell: with all other pictures of the past, but for viewers, who get
        these of every step, seldom."""
        turn = due(step.index, self._info.steps, self._limits.pictures)
        return turn if detail == "usual" else detail == "all" and self._pace.due

    def _write_scans(self, step: SessionStep) -> None:
        """What all scans of a log met, as the path of the first filter that is on has them."""
        first = next(iter(step.filters.values()), None)
        if self._scanned is not None and first is not None:
            cells, _ = self._scanned.along(best_path(first))
            self._stream.log("world/scans", scene.points(cells, scene.SCAN * self._lift))

    def _write_relations(self, step: SessionStep) -> None:
        """Where paths break the relations that they are judged by: lines on the map, and in words."""
        if self._judge is None or self._judged == step.index:
            return
        self._judged = step.index
        found = self._judge(step)
        if not found:
            return
        for key in step.filters:
            if key in found:
                self._stream.log(f"world/{key}/relations", scene.relations(found[key], self._styles[key]))
        page = texts.relations(found, {f.key: f.title for f in self._shown.filters}, step.index)
        self._stream.log("relations", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN))

    def _write_guides(self, step: SessionStep) -> None:
        """Two points would do for a straight line, but nobody knows which step will be the last."""
        if due(step.index, self._info.steps, self._limits.pictures):
            values = BORDERS | {"n_eff/threshold": step.params.resample_below * step.params.particles}
            for path in self._guides:
                self._stream.log(f"plots/{path}", rr.Scalars(values[path]))


def _spread(covariance: Floats) -> float:
    """[m] two standard deviations in the worst direction of the plane; of a covariance (3, 3)."""
    return scene.SIGMAS * float(ellipse_axes(covariance[:2, :2])[0][0])


def _origin(info: SessionInfo) -> float:
    """[s] where `sim_time` begins."""
    first = info.source.steps[0].frame.time if info.source.steps else 0.0
    return first if abs(first) > EPOCH else 0.0
