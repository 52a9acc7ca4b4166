"""A recording opens in the real viewer: nothing is complained of, and every view shows something."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from app import session
from app.colours import WARNING, faded, of_filter
from app.recording import Recorder
from app.recording.blueprint import MAP_ASPECT
from app.recording.ground import extent_of
from app.recording.metrics import known_of
from app.recording.stream import Stream
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.types import UNKNOWN_TAG
from tests.app.viewer import Viewer, pixels, required_viewer, share_drawn

STEPS, AT = 12, 9
KEYS = ("dfs", "fs2", "fs1", "ekf")
LEAST = {"3D": 0.001, "2D": 0.01, "TimeSeries": 0.002, "BarChart": 0.01, "TextDocument": 0.01, "TextLog": 0.01}
"""Share of the pixels that the data of the run must draw, by the kind of view; pages are the same for every run."""


@pytest.fixture(scope="module")
def source():
    return build("paper-line")


def recorded(source, path) -> Viewer:
    params = source.params(particles=30, association="known")
    filters = [ESTIMATORS[key] for key in KEYS]
    session.run(session.make_info(source, filters, params, seed=1, count=STEPS), [Recorder(path)])
    return required_viewer(path)


@pytest.fixture(scope="module")
def viewer(source, tmp_path_factory):
    viewer = recorded(source, tmp_path_factory.mktemp("views") / "run.rrd")
    yield viewer
    viewer.__exit__()


@pytest.fixture(scope="module")
def hollow(source, tmp_path_factory):
    """The same recording without anything that happened: grids, axes and legends alone."""
    log = Stream.log

    def elsewhere(self: Stream, entity: str, *what: object) -> None:
        import rerun as rr

        log(self, "nowhere", rr.Scalars(0.0))  # a viewer wants to know of the times at least

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Stream, "log", elsewhere)
        viewer = recorded(source, tmp_path_factory.mktemp("hollow") / "run.rrd")
    yield viewer
    viewer.__exit__()


def pictures(viewer: Viewer) -> dict[tuple[str, str], bytes]:
    """A screenshot of every view, by its name and origin."""
    viewer.seek("step", AT)
    views = viewer.views()
    taken: dict[str, bytes] = {}
    for hidden in views:
        if hidden.view_id not in taken:
            viewer.bring_to_front(hidden)
            front = viewer.in_front()
            new = [view for view in views if view.view_id in front and view.view_id not in taken]
            taken |= {view.view_id: viewer.screenshot(view) for view in new}
    return {(view.name, view.origin): taken[view.view_id] for view in views}


def share_changed(one: bytes, other: bytes) -> float:
    """Share of the pixels that differ between two pictures of the same size."""
    return float((pixels(one) != pixels(other)).any(axis=2).mean())


def test_it_opens_on_the_map_and_the_plots(viewer: Viewer):
    front = viewer.in_front()
    names = [view.name for view in viewer.views() if view.view_id in front]
    assert any(name.startswith("Map: Dual FastSLAM orange") for name in names)
    assert {"FastSLAM 2.0", "Ancestry"} <= set(names)
    assert any(name.startswith("N_eff") for name in names)
    assert viewer.timelines() == {"step", "sim_time", "stage"}


def test_every_view_shows_something_and_reports_nothing(viewer: Viewer, hollow: Viewer):
    views = {(view.name, view.origin): view for view in viewer.views()}
    assert {view.view_class for view in views.values()} == set(LEAST)
    # maps, close-ups, plots (one is there twice), ancestry, weights, hypotheses, pages
    assert len(views) == 1 + len(KEYS) + 3 * len(KEYS) + 20 + 1 + 3 + 3 + 3
    full, empty = pictures(viewer), pictures(hollow)
    drawn = {
        which: share_drawn(full[which])
        if view.view_class == "TextDocument"
        else share_changed(full[which], empty[which])
        for which, view in views.items()
    }
    blank = {which: share for which, share in drawn.items() if share < LEAST[views[which].view_class]}
    assert not blank, drawn
    reports = {view.name: view.reports for view in viewer.views() if view.reports}
    assert not reports
    assert viewer.complaints() == []


@pytest.mark.parametrize("key", ["dfs", "fs2", "fs1"])
def test_close_ups_have_the_colour_of_their_filter(viewer: Viewer, key):
    viewer.seek("step", AT)
    view = next(v for v in viewer.views() if v.origin == f"/world/{key}/focus")
    viewer.bring_to_front(view)
    picture = pixels(viewer.screenshot(view)).astype(int)
    near = np.abs(picture - np.array(of_filter(key))).max(axis=2) < 40
    assert near.sum() > 50


def test_the_map_fits_and_north_is_up(viewer: Viewer, source):
    """Every landmark is drawn where a view from straight above has it, and nothing is at its mirror image."""
    viewer.seek("step", AT)
    view = next(v for v in viewer.views() if v.name.startswith("Map:"))
    viewer.bring_to_front(view)
    picture = pixels(viewer.screenshot(view)).max(axis=2)
    height, width = picture.shape
    extent = extent_of(source, STEPS)
    scale = 0.5 * height / (extent.eye_height(MAP_ASPECT) * math.tan(math.radians(27.5)))  # [pixels/m]
    for x, y in source.true_map.theta:
        column, up = int(0.5 * width + scale * (x - extent.centre[0])), scale * (y - extent.centre[1])
        for row, expected in ((int(0.5 * height - up), True), (int(0.5 * height + up), False)):
            around = picture[row - 4 : row + 5, column - 4 : column + 5]
            assert around.shape == (9, 9), f"({x}, {y}) is out of sight"
            assert (np.median(around) > 100) == expected, f"({x}, {y})"


def test_the_stages_of_a_step_look_different(viewer: Viewer):
    view = next(v for v in viewer.views() if v.origin == "/world/fs2/focus")
    viewer.bring_to_front(view)
    pictures = []
    for stage in range(3 * AT - 2, 3 * AT + 1):
        viewer.seek("stage", stage)
        pictures.append(viewer.screenshot(view))
    assert len(set(pictures)) == 3


def test_what_nobody_knows_has_no_view(source, tmp_path):
    """A log with GPS for truth and things that nobody named: no empty plots, no rays in close-ups."""
    steps = tuple(
        step._replace(
            frame=step.frame._replace(tags=np.full_like(step.frame.tags, UNKNOWN_TAG)),
            truth=np.array([*step.truth[:2], math.nan]),
        )
        for step in source.steps
    )
    log = dataclasses.replace(source, kind="log", steps=steps, true_map=None)
    filters = [ESTIMATORS["dfs"], ESTIMATORS["fs2"]]
    info = session.make_info(log, filters, log.params(particles=10, association="jcbb"), count=STEPS)
    assert known_of(log, STEPS) == {"truth"}
    assert known_of(source, STEPS) == {"truth", "heading", "map", "tags"}
    session.run(info, [Recorder(tmp_path / "log.rrd")])
    viewer = required_viewer(tmp_path / "log.rrd")
    try:
        names = {view.name for view in viewer.views()}
        assert not [name for name in names if name.startswith(("Heading error", "Map error", "Duplicate"))]
        assert {"Position error [m]", "Features in the best map"} <= names
        assert not {view.name: view.reports for view in viewer.views() if view.reports}
        close_up = next(view for view in viewer.views() if view.origin == "/world/dfs/focus")
        viewer.bring_to_front(close_up)
        yellow = np.array(faded(WARNING, 0.55))
        assert (np.abs(pixels(viewer.screenshot(close_up)).astype(int) - yellow).max(axis=2) < 12).sum() == 0
    finally:
        viewer.__exit__()


def test_it_opens_at_the_end(source, tmp_path):
    """Where maps, paths and ancestry can be seen."""
    viewer = recorded(source, tmp_path / "run.rrd")
    try:
        view = next(v for v in viewer.views() if v.name.startswith("Map:"))
        opened = viewer.screenshot(view)
        viewer.seek("step", 1)
        begun = viewer.screenshot(view)
        viewer.seek("step", STEPS)
        assert share_changed(opened, viewer.screenshot(view)) < share_changed(opened, begun)
    finally:
        viewer.__exit__()
