"""A recording of a run that goes on as several branches, and whose filters come and go."""

from __future__ import annotations

import dataclasses
from functools import partial

import pytest

from app import session
from app.recording.reading import Recording
from app.recording.writer import Writer, slug, unused
from app.types import SessionInfo
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from tests.app.viewer import required_viewer

STEPS, AT, FEWER = 8, 4, 7


def info_of(*keys: str) -> SessionInfo:
    source = build("paper-line")
    params = source.params(particles=20, association="known")
    return session.make_info(source, [ESTIMATORS[key] for key in keys], params, seed=3, count=STEPS)


@pytest.fixture(scope="module")
def branched(tmp_path_factory):
    """A run of eight steps, and two branches from the fourth on, the second one of the first."""
    from app.recording.stream import FileStream

    path = tmp_path_factory.mktemp("branches") / "run.rrd"
    info = info_of("dfs", "fs2")
    fewer = dataclasses.replace(info.params, particles=FEWER)
    trunk = Writer(info, partial(FileStream, path))
    state, kept = session.start(info), None
    for index in range(STEPS):
        kept = state if index == AT else kept
        state, step = session.advance(info, state, info.params)
        trunk.step(step)
    assert kept is not None
    first = trunk.fork(info._replace(params=fewer), "Seven particles, R × 4!")
    second = first.fork(info._replace(params=fewer), "seven particles r 4")
    for branch in (first, second):
        state = kept
        for _ in range(AT, STEPS):
            state, step = session.advance(info, state, fewer)
            branch.step(step)
        branch.close()
    trunk.close()
    return path


def test_a_branch_repeats_the_tree_below_its_name(branched):
    recording = Recording(branched)
    first, second = "/branch/seven-particles-r-4", "/branch/seven-particles-r-4-2"
    entities = set(recording.entities)
    own = {e for e in entities if not e.startswith(("/branch/", "/__properties"))}
    banded = ("nees", "nees_log10", "nees_x_log10", "nees_y_log10", "nees_heading_log10")
    without = {f"/plots/{plot}/{side}" for plot in banded for side in ("lower", "upper")}
    for branch in (first, second):
        assert {branch + e for e in own - without} == {e for e in entities if e.startswith(f"{branch}/")}
    for timeline in ("step", "sim_time", "stage"):
        assert timeline in recording.timelines(f"{first}/world/dfs/particles")
    steps, n_eff = recording.series(f"{first}/plots/n_eff/dfs")
    assert steps.tolist() == list(range(AT + 1, STEPS + 1))
    assert n_eff.max() <= FEWER
    assert len(recording.series("/plots/n_eff/dfs")[0]) == STEPS
    assert recording.params()["params"]["particles"] == 20
    named = recording.rows(f"{first}/plots/n_eff/dfs", "SeriesLines:names", "")
    assert named[0][1] == ["Dual FastSLAM, Seven particles, R × 4!"]
    assert recording.params(first.removeprefix("/branch/"))["parent"] == ""
    assert recording.params(second.removeprefix("/branch/"))["parent"] == first.removeprefix("/branch/")
    session_of_branch = [e for e in entities if e.startswith("/__properties/session-")]
    assert len(session_of_branch) == 2


def test_run_and_branch_are_side_by_side(branched):
    viewer = required_viewer(branched)
    try:
        viewer.seek("step", STEPS)
        views, front = viewer.views(), viewer.in_front()
        maps = {view.origin for view in views if view.view_id in front and view.origin.endswith("world")}
        assert maps == {"/world", "/branch/seven-particles-r-4-2/world"}
        assert not {view.name: view.reports for view in views if view.reports}
        plots = [view for view in views if view.view_class == "TimeSeries"]
        assert {view.origin for view in plots} == {"/"}
        assert viewer.complaints() == []
    finally:
        viewer.__exit__()


def test_filters_come_and_go(tmp_path):
    from app.recording.stream import FileStream

    path = tmp_path / "run.rrd"
    info, other = info_of("dfs"), info_of("dfs", "ekf")
    writer = Writer(info, partial(FileStream, path))
    one, two = list(session.steps(info)), list(session.steps(other))
    for index in range(STEPS):
        writer.step(two[index] if 2 <= index < 5 else one[index])
    writer.close()
    recording = Recording(path)
    assert recording.series("/plots/position_error/ekf")[0].tolist() == [3, 4, 5]
    viewer = required_viewer(path)
    try:
        names = {view.name for view in viewer.views()}
        assert "EKF-SLAM" in names
        assert not {view.name: view.reports for view in viewer.views() if view.reports}
    finally:
        viewer.__exit__()


@pytest.mark.parametrize(
    ("name", "expected"),
    [("200 particles", "200-particles"), ("R × 4, ½", "r-4"), ("//..", "branch"), ("σ", "branch"), ("a.b", "a.b")],
)
def test_names_become_paths(name, expected):
    assert slug(name) == expected


def test_no_two_branches_have_one_name():
    assert unused("a", {"b"}) == "a"
    assert unused("a", {"a", "a-2"}) == "a-3"
