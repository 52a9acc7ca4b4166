"""A recording holds what the session was, at the places and on the timelines that are documented."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from app import session
from app.recording import Recorder
from app.recording.limits import due, limits_for, sample, thinned, thinned_branches, thinned_tree
from app.recording.metrics import METRICS
from app.recording.reading import Recording
from app.types import SessionInfo, SessionStep
from scenarios.registry import build
from slam.ancestry_variance import luck_of_pose
from slam.estimators import ESTIMATORS
from slam.genealogy import Branch
from slam.weights import weight_variance

STEPS, K, FEWER, CHANGE = 14, 20, 15, 9
KEYS = ("dfs", "fs2", "fs1", "ekf")
FIELDS = {
    "n_eff": "n_eff",
    "diversity": "diversity",
    "nees": "nees_position",
    "position_error": "position_error_m",
    "map_error": "map_error_m",
    "features": "features",
    "duplicates": "duplicates",
    "common_ancestor": "common_ancestor_age",
}


class Watch:
    """Keeps the steps."""

    def __init__(self) -> None:
        self.steps: list[SessionStep] = []

    def begin(self, info: SessionInfo) -> None: ...

    def step(self, step: SessionStep) -> None:
        self.steps.append(step)

    def end(self) -> None: ...


@pytest.fixture(scope="module")
def strict():
    """Bad data is an error and not a warning that nobody reads."""
    import rerun as rr

    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def info() -> SessionInfo:
    source = build("paper-line")
    filters = [ESTIMATORS[key] for key in KEYS]
    params = source.params(particles=K, association="known")
    return session.make_info(source, filters, params, seed=3, count=STEPS, command="a test")


def record(path, info: SessionInfo) -> list[SessionStep]:
    watch, changes = Watch(), [session.Change(CHANGE, dataclasses.replace(info.params, particles=FEWER))]
    session.run(info, [Recorder(path), watch], changes)
    return watch.steps


@pytest.fixture(scope="module")
def recorded(info, strict, tmp_path_factory) -> tuple[Recording, list[SessionStep]]:
    path = tmp_path_factory.mktemp("recording") / "run.rrd"
    steps = record(path, info)
    return Recording(path), steps


def test_every_entity_of_the_contract_is_there(recorded):
    recording, _ = recorded
    wanted = {"/world/truth/robot", "/world/truth/path", "/world/truth/map", "/world/odometry/path", "/world/scan"}
    for key in KEYS:
        parts = ("particles", "ellipses", "map", "maps", "associations", "path", "lineages", "focus", "best")
        wanted |= {f"/world/{key}/{part}" for part in parts}
        wanted |= {f"/plots/{metric.name}/{key}" for metric in METRICS}
        wanted |= {f"/genealogy/{key}", f"/weights/{key}"}
    wanted |= {"/plots/nees/lower", "/plots/nees/upper", "/plots/n_eff/threshold", "/events", "/about", "/params"}
    assert wanted <= set(recording.entities)
    moving = wanted - {"/world/truth/map", "/about", "/params"}
    for entity in moving:
        assert recording.timelines(entity) == {"step", "sim_time", "stage"}, entity


def test_there_is_no_entity_for_a_particle(recorded):
    recording, _ = recorded
    assert len(recording.entities) < 60 * len(KEYS)


def test_the_file_says_what_made_it(recorded, info):
    recording, _ = recorded
    said = recording.params()
    assert recording.filters() == list(KEYS)
    assert (said["world"], said["seed"], said["steps"], said["command"]) == ("paper-line", 3, STEPS, "a test")
    assert said["params"] == dataclasses.asdict(info.params)
    assert said["noise"] == dataclasses.asdict(info.noise)
    assert said["versions"]["rerun-sdk"].startswith("0.")


def test_the_blueprint_travels_in_the_file(recorded):
    from rerun.chunk import RrdReader

    recording, _ = recorded
    reader = RrdReader(recording.path)
    assert [entry.application_id for entry in reader.recordings()] == ["dual-fastslam"]
    assert len(reader.blueprints()) == 1


@pytest.mark.parametrize(
    ("plot", "freedom", "logarithm"),
    [("nees", 2, False), ("nees_log10", 2, True), ("nees_x_log10", 1, True), ("nees_heading_log10", 1, True)],
)
def test_plots_of_the_nees_have_the_band_of_their_degrees_of_freedom(recorded, plot, freedom, logarithm):
    recording, _ = recorded
    borders = [recording.series(f"/plots/{plot}/{side}")[1] for side in ("lower", "upper")]
    expected = chi2.ppf([0.025, 0.975], freedom)
    for values, border in zip(borders, np.log10(expected) if logarithm else expected, strict=True):
        np.testing.assert_allclose(values, border, rtol=1e-9)


@pytest.mark.parametrize("key", ["dfs", "fs2", "ekf"])
def test_the_luck_of_the_particles_is_plotted_beside_what_the_filter_reports(recorded, key):
    """As it is worked out anew from the particles; of one particle there is none."""
    recording, steps = recorded
    _, told = recording.series(f"/plots/monte_carlo/{key}")
    _, spread = recording.series(f"/plots/spread/{key}")
    updates = [s.filters[key] for s in steps]
    expected = [luck_of_pose(u.trace.weighted, u.measures.estimate)[:2].mean() ** 0.5 for u in updates]
    np.testing.assert_allclose(told, expected, rtol=1e-12)
    assert np.isfinite(told).any() == (key != "ekf")
    np.testing.assert_allclose(spread, [np.diag(u.measures.covariance)[:2].mean() ** 0.5 for u in updates], rtol=1e-12)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("name", FIELDS)
def test_plots_are_the_measures(recorded, key, name):
    recording, steps = recorded
    index, values = recording.series(f"/plots/{name}/{key}")
    np.testing.assert_array_equal(index, np.arange(1, STEPS + 1))
    np.testing.assert_array_equal(values, [float(getattr(s.filters[key].measures, FIELDS[name])) for s in steps])


def test_units_of_the_other_plots(recorded):
    recording, steps = recorded
    updates = [s.filters["fs1"] for s in steps]
    _, heading = recording.series("/plots/heading_error/fs1")
    np.testing.assert_allclose(heading, np.degrees([u.measures.heading_error_rad for u in updates]), rtol=1e-12)
    _, cost = recording.series("/plots/update_ms/fs1")
    np.testing.assert_allclose(cost, [1e3 * u.seconds for u in updates], rtol=1e-12)
    _, logarithm = recording.series("/plots/nees_log10/fs1")
    assert np.isfinite(logarithm).all()
    expected = np.clip(np.log10(np.maximum([u.measures.nees_position for u in updates], 1e-300)), -2.0, 6.0)
    np.testing.assert_allclose(logarithm, expected, atol=1e-12)
    for i, name in enumerate(("x", "y", "heading")):
        _, logarithm = recording.series(f"/plots/nees_{name}_log10/fs1")
        expected = np.clip(np.log10(np.maximum([u.measures.nees_components[i] for u in updates], 1e-300)), -3.5, 6.0)
        np.testing.assert_allclose(logarithm, expected, atol=1e-12)
    time, _ = recording.series("/plots/n_eff/dfs", "sim_time")
    np.testing.assert_allclose(time, [s.frame.time for s in steps], atol=1e-8)


@pytest.mark.parametrize("key", KEYS)
def test_the_three_stages_of_a_step_can_be_scrubbed(recorded, key):
    recording, steps = recorded
    rows = recording.rows(f"/world/{key}/particles", "Points3D:positions", "stage")
    assert [stage for stage, _ in rows] == list(range(1, 3 * STEPS + 1))
    for step in steps:
        trace = step.filters[key].trace
        for offset, particles in enumerate((trace.predicted, trace.weighted, trace.resampled)):
            _, positions = rows[3 * (step.index - 1) + offset]
            np.testing.assert_allclose(np.array(positions)[:, :2], particles.s[:, :2], atol=1e-5)


def test_a_step_shows_the_weighted_particles(recorded):
    recording, steps = recorded
    rows = recording.rows("/world/dfs/particles", "Points3D:positions", "step")
    assert [index for index, _ in rows] == list(range(1, STEPS + 1))
    weighted = steps[4].filters["dfs"].trace.weighted
    np.testing.assert_allclose(np.array(rows[4][1])[:, :2], weighted.s[:, :2], atol=1e-5)


def test_heavy_particles_are_brighter(recorded):
    recording, steps = recorded
    colours = recording.rows("/world/fs2/particles", "Points3D:colors", "step")
    for step, (_, row) in zip(steps, colours, strict=True):
        log_w = step.filters["fs2"].trace.weighted.log_w
        packed = np.array(row, np.uint32)
        brightness = (packed >> 24).astype(int) + ((packed >> 16) & 255) + ((packed >> 8) & 255)
        assert (np.diff(brightness[np.argsort(log_w)]) >= 0).all()


def test_ellipses_have_two_standard_deviations(recorded):
    recording, steps = recorded
    _, sizes = recording.rows("/world/dfs/ellipses", "Ellipsoids3D:half_sizes", "step")[-1]
    variances = np.linalg.eigvalsh(steps[-1].filters["dfs"].trace.weighted.P[:, :2, :2])[:, ::-1]
    np.testing.assert_allclose(np.array(sizes)[:, :2], 2.0 * np.sqrt(variances), rtol=1e-4)
    _, none = recording.rows("/world/fs1/ellipses", "Ellipsoids3D:half_sizes", "step")[-1]
    assert none == []  # the particles of FastSLAM 1.0 have no covariance


def test_maps_and_paths(recorded):
    recording, steps = recorded
    update = steps[-1].filters["dfs"]
    theta, _, _ = update.trace.weighted.maps.features(update.measures.best)
    _, features = recording.rows("/world/dfs/map", "Points3D:positions", "step")[-1]
    np.testing.assert_allclose(np.array(features)[:, :2], theta, atol=1e-5)
    _, everything = recording.rows("/world/dfs/maps", "Points3D:positions", "step")[-1]
    assert len(everything) == int(update.trace.weighted.maps.counts.sum())
    _, (path,) = recording.rows("/world/dfs/path", "LineStrips3D:strips", "step")[-1]
    assert len(path) == STEPS + 1
    _, (truth,) = recording.rows("/world/truth/path", "LineStrips3D:strips", "step")[-1]
    np.testing.assert_allclose(np.array(truth)[:, :2], [s.truth[:2] for s in steps if s.truth is not None], atol=1e-5)
    _, lineages = recording.rows("/world/dfs/lineages", "LineStrips3D:strips", "step")[-1]
    assert len(lineages) == len(update.genealogy.branches())


@pytest.mark.parametrize("key", KEYS)
def test_associations_join_what_is_seen_with_what_it_is_taken_for(recorded, key):
    recording, steps = recorded
    rows = recording.rows(f"/world/{key}/associations", "LineStrips3D:strips", "step")
    for step, (_, drawn) in zip(steps, rows, strict=True):
        trace, best = step.filters[key].trace, step.filters[key].measures.best
        theta, _, _ = trace.weighted.maps.features(best)
        x, y, heading = trace.weighted.s[best]
        expected = [
            [[x + r * np.cos(heading + b), y + r * np.sin(heading + b)], theta[i]]
            for (r, b), i in zip(step.frame.z, trace.n[best], strict=True)
            if i >= 0
        ]
        np.testing.assert_allclose(
            np.array(drawn).reshape(-1, 2, 3)[..., :2], np.array(expected).reshape(-1, 2, 2), atol=1e-5
        )
    assert sum(len(drawn) for _, drawn in rows) > STEPS


def test_events_tell_what_happened(recorded):
    recording, steps = recorded
    events = recording.events()
    resampled = [(s.index, u.trace) for s in steps for k, u in s.filters.items() if k != "ekf" and u.trace.did_resample]
    told = [e for e in events if "resampled: N_eff" in e.text]
    assert [e.step for e in told] == [index for index, _ in resampled]
    assert all(f"{trace.n_eff:.1f}" in e.text for e, (_, trace) in zip(told, resampled, strict=True))
    assert [(e.step, e.text) for e in events if "Parameter" in e.text] == [
        (CHANGE, f"{CHANGE}: Parameter changed: particles: {K} -> {FEWER}")
    ]
    depleted = [e for e in events if e.level == "WARN" and e.text.startswith(f"{e.step}: FastSLAM 1.0 is depleted")]
    assert depleted
    for event in depleted:
        why = weight_variance(steps[event.step - 1].filters["fs1"].trace)
        decisive = int(np.argmax(why.observations))
        assert f"observation {decisive + 1}" in event.text
        share = f" of {len(why.observations)} has {why.observations[decisive]:.0%} of the variance of the log weights"
        assert f"{share}; {why.first:.0%} by ranges, {why.second:.0%} by bearings" in event.text
        assert event.text.endswith(f"{why.inside:.0%} of the particles are where the likelihood is")


def test_two_runs_give_the_same_recording(recorded, info, tmp_path):
    recording, _ = recorded
    record(tmp_path / "again.rrd", info)
    again = Recording(tmp_path / "again.rrd")
    assert again.entities == recording.entities
    for entity in recording.entities:
        if "update_ms" in entity:
            continue
        if entity.startswith("/plots") and recording.timelines(entity):
            np.testing.assert_array_equal(again.series(entity), recording.series(entity))
        if entity.endswith("/particles"):
            for part in ("Points3D:positions", "Points3D:colors", "Arrows3D:vectors"):
                assert again.rows(entity, part) == recording.rows(entity, part)


def test_importing_the_recorder_does_not_import_rerun():
    import subprocess
    import sys

    code = "import sys, app.recording; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("steps", [1, 59, 120, 121, 5000, 100_000])
def test_what_a_recording_draws_of_the_past_is_bounded(steps):
    shown = limits_for(steps)
    pictures = [i for i in range(1, steps + 1) if due(i, steps, shown.pictures)]
    assert len(pictures) <= 122
    assert pictures[0] == 1
    assert pictures[-1] == steps
    assert len([i for i in range(1, steps + 1) if due(i, steps, shown.paths)]) <= 502
    for length in (1, 2, 1000, 1025, 99_999):
        path = np.arange(2.0 * length).reshape(-1, 2)
        kept = thinned(path, shown.vertices)
        assert len(kept) <= shown.vertices + 2
        np.testing.assert_array_equal(kept[[0, -1]], path[[0, -1]])


def test_thinned_branches_still_join():
    trunk, fork = np.arange(200.0).reshape(-1, 2), np.arange(198.0, 398.0).reshape(-1, 2)
    rows, (first, second) = thinned_branches([trunk, fork], [0, 99], 4)
    assert first + second == len(rows) <= 50 + 4
    np.testing.assert_array_equal(rows[[0, first - 1, first, -1]], [trunk[0], trunk[-1], fork[0], fork[-1]])
    np.testing.assert_array_equal(rows[1:3, 0], [8.0, 16.0])


def test_of_a_large_tree_the_large_branches_are_kept():
    poses = np.zeros((500, 3))
    branches = [Branch(poses, 0, 1 + 1000 * (i == 77), i) for i in range(1000)]
    chosen, rows, lengths = thinned_tree(branches, 500, 4096)
    assert chosen[0].founder == 77
    assert 10 < len(chosen) == len(lengths) < 1000
    assert sum(lengths) == len(rows) <= 4096
    assert thinned_tree([], 0, 4096)[0] == []
    alone = [Branch(np.zeros((3001, 3)), 0, 30, 0)]
    _, rows, _ = thinned_tree(alone, 3000, 800)  # few have more of their corners
    assert 400 < len(rows) <= 800


def test_a_sample_keeps_the_best():
    for keep in range(1000):
        chosen = sample(1000, 10, keep)
        assert keep in chosen
        assert len(set(chosen)) == 10
    np.testing.assert_array_equal(sample(5, 10), np.arange(5))
