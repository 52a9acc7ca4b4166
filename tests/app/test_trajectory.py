"""`--trajectory`: what evo and map viewers read."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from app import session
from app.drawing import Layer, draw_map, map_layer, truth_layer
from app.trajectory import Trajectory, geojson, tum, with_gaps
from app.types import best_descendant
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.features import Point, Wall
from slam.features.wall import ends

KEYS = ("dfs", "fs2", "fs1", "ekf")
STEPS = 10


@pytest.fixture(scope="module", params=["landmarks", "walls"])
def written(request, tmp_path_factory):
    """Where the files are, and the steps: a loop of landmarks, or the walls of the same corridors."""
    directory = tmp_path_factory.mktemp("trajectory")

    class Keep:
        def begin(self, info):
            self.steps = []

        def step(self, step):
            self.steps.append(step)

        def end(self):
            pass

    source, keep = build("loop", features=request.param), Keep()
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
        route, *mapped = collection["features"]
        update = steps[-1].filters[key]
        theta, Sigma, tags = update.trace.resampled.maps.features(best_descendant(update))
        assert len(theta) > 3
        walls = isinstance(steps[-1].frame.feature, Wall)
        assert (route["properties"]["kind"], route["geometry"]["type"]) == ("path", "LineString")
        assert {f["properties"]["kind"] for f in mapped} == {"wall" if walls else "landmark"}
        assert {f["geometry"]["type"] for f in mapped} == {"LineString" if walls else "Point"}
        places = [f["geometry"]["coordinates"] for f in mapped]
        np.testing.assert_allclose(places, ends(theta) if walls else theta, atol=1e-6)
        names = ["lateral_deviation_m", "angle_deviation_rad"] if walls else ["x_deviation_m", "y_deviation_m"]
        deviations = [[f["properties"][name] for name in names] for f in mapped]
        np.testing.assert_allclose(deviations, np.sqrt(np.diagonal(Sigma, axis1=1, axis2=2)), atol=1e-8)
        assert [f["properties"]["tag"] for f in mapped] == tags.tolist()
        assert [f["properties"]["index"] for f in mapped] == list(range(len(theta)))


def test_geojson_of_walls_says_what_was_seen_of_them():
    theta = np.array([[5.0, 1.0, math.pi / 2, -2.0, 3.0, 0.0, 1.0, 17.0], [0.0, 0.0, 0.0, -1.0, 1.0, 1.0, 0.0, 1.0]])
    Sigma = np.tile(np.diag([0.04, 0.0001]), (2, 1, 1))
    text = geojson("A filter", np.zeros((2, 3)), Wall(), theta, Sigma, np.array([7, -1]), np.array([0, 3]))
    _, first, second = json.loads(text)["features"]
    assert first["geometry"]["coordinates"] == [[5.0, -1.0], [5.0, 4.0]]
    assert first["properties"] == {
        "kind": "wall",
        "filter": "A filter",
        "index": 0,
        "tag": 7,
        "observations": 17,
        "start_seen": False,
        "end_seen": True,
        "lateral_deviation_m": 0.2,
        "angle_deviation_rad": 0.01,
    }
    assert (second["properties"]["start_seen"], second["properties"]["end_seen"]) == (True, False)
    assert (second["properties"]["index"], second["properties"]["tag"]) == (3, None)


def test_an_unknown_tag_is_null():
    nothing = np.zeros((1, 2)), np.zeros((1, 2, 2))
    collection = json.loads(geojson("x", np.zeros((2, 3)), Point(), *nothing, np.array([-1]), np.array([0])))
    assert collection["features"][1]["properties"]["tag"] is None


def strokes(root, kind):
    """For each element of a class of a picture the points (n, 2) of its pieces."""
    found = [e.attrib["d"].replace("L", " ") for e in root.iter() if e.attrib.get("class") == kind]
    return [
        [np.array([[float(c) for c in point.split(",")] for point in piece.split()]) for piece in d.split("M")[1:]]
        for d in found
    ]


def pieces(root):
    """Those of its routes."""
    return strokes(root, "route")


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


@pytest.mark.parametrize("written", ["walls"], indirect=True)
def test_walls_are_drawn_where_they_are(written):
    """All the true ones and those of the map, to one scale and y up, and a dot wherever an end was seen."""
    directory, steps = written
    true = build("loop").true_map
    assert true is not None
    for key in KEYS:
        root = ElementTree.parse(directory / f"{key}.svg").getroot()
        update = steps[-1].filters[key]
        theta, _, _ = update.trace.resampled.maps.features(best_descendant(update))
        drawn = [np.array(lines) for lines in strokes(root, "walls")]
        metres = [true.theta.reshape(-1, 2, 2), ends(theta)]
        assert [len(lines) for lines in drawn] == [len(lines) for lines in metres]
        x, y = np.concatenate(drawn).reshape(-1, 2).T
        assert 0 < x.min() < x.max() < float(root.attrib["width"])
        assert 0 < y.min() < y.max() < float(root.attrib["height"])
        x_m, y_m = np.concatenate(metres).reshape(-1, 2).T
        scale = (x.max() - x.min()) / (x_m.max() - x_m.min())
        np.testing.assert_allclose(x - x.min(), scale * (x_m - x_m.min()), atol=0.2)
        np.testing.assert_allclose(y.max() - y, scale * (y_m - y_m.min()), atol=0.2)
        (dots,) = [e.attrib["d"] for e in root.iter() if e.attrib.get("class") == "ends"]
        assert dots.count("h0") == int(theta[:, 5:7].sum()) > 0
        assert not [e for e in root.iter() if e.attrib.get("class") == "scanned"]  # of logs only


def test_the_bands_of_walls_are_two_deviations_wide():
    """Along x from -10 to 20 m, with 0.1 m in the middle and 0.01 rad: at its ends that is 0.14 and 0.22 m."""
    theta = np.array([[0.0, 0.0, 0.0, -10.0, 20.0, 1.0, 1.0, 5.0], [0.0, 8.0, 0.0, -10.0, 20.0, 1.0, 1.0, 5.0]])
    Sigma = np.array([np.diag([0.01, 0.0001]), np.zeros((2, 2))])
    path = np.array([[0.0, 0.0, 0.0], [5.0, 10.0, 0.0]])
    layer = map_layer("x", (1, 2, 3), path, Wall(), theta, Sigma)
    root = ElementTree.fromstring(draw_map("bands", truth_layer("truth", (0, 0, 0), path, np.zeros((0, 4))), [layer]))
    (band,) = [e for e in root.iter() if e.tag.endswith("polygon")]  # that of the other one has no width
    x, y = np.array([[float(c) for c in point.split(",")] for point in band.attrib["points"].split()]).T
    scale = (x.max() - x.min()) / 30.0
    left, right = x == x.min(), x == x.max()
    assert np.ptp(y[left]) / scale == pytest.approx(4 * math.hypot(0.1, 0.1), abs=0.01)
    assert np.ptp(y[right]) / scale == pytest.approx(4 * math.hypot(0.1, 0.2), abs=0.01)


@pytest.mark.parametrize("extent", [(0.0, 0.0), (1e-3, 0.0), (5.0, 500.0), (1e4, 10.0)])
def test_pictures_of_any_extent(extent):
    path = np.array([[0.0, 0.0], extent])
    layer = Layer("<&>", (1, 2, 3), path, path, np.tile(np.diag([0.01, 0.04]), (2, 1, 1)))
    walls = map_layer("<&>", (1, 2, 3), path, Wall(), np.array([[*extent, 1.0, 0, 0, 0, 1, 1]]), np.zeros((1, 2, 2)))
    nothing = Layer("truth", (0, 0, 0), np.zeros((0, 3)))
    for shown in (layer, walls):
        root = ElementTree.fromstring(draw_map("a < b", nothing, [shown]))
        assert 100 < float(root.attrib["height"]) < 1200


def test_the_truth_is_not_drawn_where_it_is_not_known():
    times = np.array([0.0, 0.5, 1.0, 30.0, 30.5])
    poses = np.arange(15.0).reshape(5, 3)
    path = with_gaps(times, poses)
    assert np.isnan(path[3]).all()
    np.testing.assert_array_equal(path[[0, 1, 2, 4, 5]], poses)
    truth = Layer("truth", (0, 0, 0), path)
    root = ElementTree.fromstring(draw_map("gap", truth, []))
    assert [[len(piece) for piece in route] for route in pieces(root)] == [[3, 2]]


def test_without_a_step_nothing_is_written(tmp_path):
    trajectory = Trajectory(tmp_path)
    trajectory.begin(session.make_info(build("loop", features="landmarks"), [ESTIMATORS["dfs"]]))
    trajectory.end()
    assert list(tmp_path.iterdir()) == []
