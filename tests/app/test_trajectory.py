"""`--trajectory`: what evo and map viewers read."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from app import session
from app.drawing import Layer, draw_map
from app.trajectory import Trajectory, geojson, tum, with_gaps
from app.types import best_descendant
from scenarios.registry import build
from slam.estimators import ESTIMATORS

KEYS = ("dfs", "fs2", "fs1", "ekf")
STEPS = 10


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Where the files are, and the last step."""
    directory = tmp_path_factory.mktemp("trajectory")

    class Keep:
        def begin(self, info):
            self.steps = []

        def step(self, step):
            self.steps.append(step)

        def end(self):
            pass

    source, keep = build("loop", features="landmarks"), Keep()
    params = source.params(particles=10)
    info = session.make_info(source, [ESTIMATORS[key] for key in KEYS], params, seed=1, count=STEPS)
    session.run(info, [keep, Trajectory(directory)])
    return directory, keep.steps


def test_files(written):
    directory, _ = written
    expected = {f"{key}{ending}" for key in KEYS for ending in (".tum", "-online.tum", ".geojson", ".svg")}
    assert {path.name for path in directory.iterdir()} == expected | {"truth.tum", "odometry.tum", "map.svg"}


@pytest.mark.parametrize("name", [*KEYS, *(f"{key}-online" for key in KEYS), "truth", "odometry"])
def test_tum_files_have_a_line_for_every_observation(written, name):
    directory, steps = written
    table = np.loadtxt(directory / f"{name}.tum")
    assert table.shape == (STEPS, 8)
    np.testing.assert_allclose(table[:, 0], [step.frame.time for step in steps], atol=1e-6)
    np.testing.assert_array_equal(table[:, 3:6], 0)
    np.testing.assert_allclose(np.hypot(table[:, 6], table[:, 7]), 1, atol=1e-8)


def test_the_online_path_is_the_estimate_and_the_path_ends_at_the_best_particle(written):
    directory, steps = written
    for key in KEYS:
        online = np.loadtxt(directory / f"{key}-online.tum")
        estimates = np.array([step.filters[key].measures.estimate for step in steps])
        np.testing.assert_allclose(online[:, 1:3], estimates[:, :2], atol=1e-6)
        np.testing.assert_allclose(2 * np.arctan2(online[:, 6], online[:, 7]), estimates[:, 2], atol=1e-6)
        update = steps[-1].filters[key]
        end = update.trace.resampled.s[best_descendant(update)]
        np.testing.assert_allclose(np.loadtxt(directory / f"{key}.tum")[-1, 1:3], end[:2], atol=1e-6)


def test_stamps_keep_microseconds_and_an_unknown_heading_is_zero():
    text = tum([1248272282.034001], np.array([[1.0, -2.0, math.nan]]))
    assert text == "1248272282.034001 1 -2 0 0 0 0 1\n"


def test_geojson(written):
    directory, steps = written
    for key in KEYS:
        collection = json.loads((directory / f"{key}.geojson").read_text())
        kinds = [feature["properties"]["kind"] for feature in collection["features"]]
        update = steps[-1].filters[key]
        theta, Sigma, tags = update.trace.resampled.maps.features(best_descendant(update))
        assert kinds == ["path"] + ["landmark"] * len(theta)
        points = [f["geometry"]["coordinates"] for f in collection["features"][1:]]
        np.testing.assert_allclose(points, theta, atol=1e-6)
        deviations = [f["properties"]["x_deviation_m"] for f in collection["features"][1:]]
        np.testing.assert_allclose(deviations, np.sqrt(Sigma[:, 0, 0]), atol=1e-8)
        assert [f["properties"]["tag"] for f in collection["features"][1:]] == tags.tolist()


def test_an_unknown_tag_is_null():
    collection = json.loads(geojson("x", np.zeros((2, 3)), np.zeros((1, 2)), np.zeros((1, 2, 2)), np.array([-1])))
    assert collection["features"][1]["properties"]["tag"] is None


def pieces(root):
    """For each route of a picture the points (n, 2) of its pieces."""
    routes = [e.attrib["d"] for e in root.iter() if e.attrib.get("class") == "route"]
    return [
        [np.array([[float(c) for c in point.split(",")] for point in piece.split()]) for piece in d.split("M")[1:]]
        for d in routes
    ]


def test_pictures_are_well_formed(written):
    directory, _ = written
    for path in directory.glob("*.svg"):
        root = ElementTree.parse(path).getroot()
        assert root.tag.endswith("svg")
        width, height = float(root.attrib["width"]), float(root.attrib["height"])
        routes = pieces(root)
        assert len(routes) == (len(KEYS) if path.stem == "map" else 1) + 1
        for (points,) in routes:
            assert (points >= 0).all()
            assert (points <= [width, height]).all()


@pytest.mark.parametrize("extent", [(0.0, 0.0), (1e-3, 0.0), (5.0, 500.0), (1e4, 10.0)])
def test_pictures_of_any_extent(extent):
    path = np.array([[0.0, 0.0], extent])
    layer = Layer("<&>", (1, 2, 3), path, path, np.tile(np.diag([0.01, 0.04]), (2, 1, 1)))
    nothing = Layer("truth", (0, 0, 0), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    root = ElementTree.fromstring(draw_map("a < b", nothing, [layer]))
    assert 100 < float(root.attrib["height"]) < 1200


def test_the_truth_is_not_drawn_where_it_is_not_known():
    times = np.array([0.0, 0.5, 1.0, 30.0, 30.5])
    poses = np.arange(15.0).reshape(5, 3)
    path = with_gaps(times, poses)
    assert np.isnan(path[3]).all()
    np.testing.assert_array_equal(path[[0, 1, 2, 4, 5]], poses)
    truth = Layer("truth", (0, 0, 0), path, np.zeros((0, 2)), np.zeros((0, 2, 2)))
    root = ElementTree.fromstring(draw_map("gap", truth, []))
    assert [[len(piece) for piece in route] for route in pieces(root)] == [[3, 2]]


def test_without_a_step_nothing_is_written(tmp_path):
    trajectory = Trajectory(tmp_path)
    trajectory.begin(session.make_info(build("loop", features="landmarks"), [ESTIMATORS["dfs"]]))
    trajectory.end()
    assert list(tmp_path.iterdir()) == []
