"""The real logs: what is in them, and that dead reckoning on them does what is known of it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from scenarios.logs import dead_reckoning, part, read_log
from scenarios.logs.keyframes import every_scan, keyframes
from scenarios.logs.odometry import path_length
from scenarios.logs.reference import with_reference
from scenarios.logs.relations import read_relations
from scenarios.types import Source
from slam.geometry import wrap_all
from slam.relations import relation_errors
from slam.types import Floats


def position_rmse(source: Source, path: np.ndarray) -> float:
    errors = [np.hypot(*(p[:2] - s.truth[:2])) for p, s in zip(path, source.steps, strict=True) if s.truth is not None]
    return float(np.sqrt(np.mean(np.square(errors))))


def test_mrclam_robot_3(shared_data: Path) -> None:
    source = read_log(shared_data / "mrclam" / "MRCLAM_Dataset6", robot=3)
    assert len(source.steps) == 2279
    assert sum(len(step.frame.z) for step in source.steps) == 4348
    assert source.true_map is not None
    assert source.true_map.tags.tolist() == list(range(6, 21))
    assert all(step.truth is not None for step in source.steps)
    for before, step in zip(source.steps[:-1], source.steps[1:], strict=True):
        assert step.frame.dt.sum() == pytest.approx(step.frame.time - before.frame.time, abs=1e-6)
        assert (step.frame.dt > 0).all()
    assert position_rmse(source, dead_reckoning(source)) == pytest.approx(4.28, abs=0.01)


@pytest.mark.parametrize("robot", [1, 2, 3, 4, 5])
def test_mrclam_sightings_fit_the_true_map(shared_data: Path, robot: int) -> None:
    """Robust spread of the residuals: centimetres and under a degree, in the robot's own frame."""
    source = read_log(shared_data / "mrclam" / "MRCLAM_Dataset6", robot=robot)
    assert source.true_map is not None
    theta = dict(zip(source.true_map.tags.tolist(), source.true_map.theta, strict=True))
    residuals = []
    for frame, truth in source.steps:
        if truth is not None:
            d = np.array([theta[tag] for tag in frame.tags.tolist()]) - truth[:2]
            predicted = np.stack([np.hypot(d[:, 0], d[:, 1]), np.arctan2(d[:, 1], d[:, 0]) - truth[2]], axis=1)
            residuals.append(frame.z - predicted)
    residual = np.concatenate(residuals)
    assert np.median(np.abs(residual[:, 0])) < 0.15
    assert np.median(np.abs(wrap_all(residual[:, 1]))) < np.radians(1.0)


def test_victoria_park(shared_data: Path) -> None:
    source = read_log(shared_data / "victoria-park")
    assert len(source.steps) == 7230
    assert sum(len(step.frame.z) for step in source.steps) == 52974
    known = [step.truth for step in source.steps if step.truth is not None]
    assert len(known) == 4073
    assert np.isnan(np.array(known)[:, 2]).all()
    u, dt = (np.concatenate([getattr(step.frame, name) for step in source.steps]) for name in ("u", "dt"))
    assert np.sum(np.abs(u[:, 0]) * dt) == pytest.approx(4074, abs=1)
    path = dead_reckoning(source)
    early = [i for i, step in enumerate(source.steps) if step.truth is not None and step.frame.time < 60]
    near = Source(**{**source.__dict__, "steps": tuple(source.steps[i] for i in early)})
    assert position_rmse(near, path[early]) < 5.0  # a wrong sign of steering or heading is tens of metres off


def test_victoria_park_part_starts_near_its_gps(shared_data: Path) -> None:
    source = read_log(shared_data / "victoria-park", first=4000, last=4100)
    assert len(source.steps) == 101
    assert position_rmse(source, dead_reckoning(source)) < 5.0


@pytest.mark.parametrize("name", ["dead_reckoning.txt.gz", "trees_rfs-slam.txt.gz", "gps.txt.gz"])
def test_a_file_of_victoria_park_stands_for_it(shared_data: Path, name: str) -> None:
    assert len(read_log(shared_data / "victoria-park" / name).steps) == 7230


LASER_LOGS = {
    "mit-killian": (17480, {180}, 1911, 7677, 51.0),
    "intel": (13631, {180}, 508, 2691, 81.8),
    "mit-csail": (1988, {361}, 374, 424, 81.9),
    "fr-clinic": (6917, {180, 181}, 1402, 4820, 81.8),
    "fr101": (292, {360}, 209, 291, 81.9),
    "dpslam-loop5": (551, {181}, 56, 550, 8.18),
}
"""Scans, beams, path by odometry [m], duration [s], what stands for no return [m]."""


@pytest.fixture(scope="module")
def laser_log(shared_data: Path) -> Callable[[str], Source]:
    """A log by its directory, read once."""
    return functools.lru_cache(lambda name: read_log(shared_data / name))


@pytest.mark.parametrize("name", LASER_LOGS)
def test_laser_logs(laser_log: Callable[[str], Source], name: str) -> None:
    scans, beams, path, duration, silence = LASER_LOGS[name]
    source = laser_log(name)
    assert len(source.steps) == scans
    found = [step.frame.scan for step in source.steps if step.frame.scan is not None]
    assert {len(scan.ranges) for scan in found} == beams
    assert source.scans is not None
    assert path_length(source.scans.odometry) == pytest.approx(path, abs=0.6)
    assert f"{scans} scans" in source.title
    assert sum(float(step.frame.dt.sum()) for step in source.steps) == pytest.approx(duration, abs=1)
    assert 0.99 * silence < source.max_range <= silence
    missing = np.mean([np.isinf(scan.ranges).mean() for scan in found])
    assert 0.01 < missing < 0.13
    ahead = 0.22 if name == "fr-clinic" else 0.0
    assert found[0].origin == pytest.approx([ahead, 0, 0])
    truth = [step.truth for step in source.steps]
    assert all((pose is not None) == (name == "fr101") for pose in truth)
    if truth[-1] is not None:  # GMapping's poses, and odometry that ends elsewhere
        assert np.hypot(*(truth[-1] - source.scans.odometry[-1])[:2]) > 2.0


@pytest.mark.parametrize(
    ("name", "odometry", "graph"),
    [("mit-killian", 50.3, 0.039), ("intel", 7.37, 0.029), ("mit-csail", 1.68, 0.004), ("fr-clinic", 0.615, None)],
)
def test_relations_of_laser_logs(
    shared_data: Path, laser_log: Callable[[str], Source], name: str, odometry: float, graph: float | None
) -> None:
    """Of raw odometry, of the poses of the optimised graph, and of keyframes that have these."""
    source = laser_log(name)
    assert source.scans is not None
    stamps = source.scans.stamps
    relations = read_relations(shared_data / name / f"{name}.relations.gz", stamps)

    def mean(times: Floats, path: Floats) -> tuple[float, int]:
        found = relation_errors(times, path, relations.times, relations.poses)
        assert found.translation_m is not None
        return found.translation_m.mean, found.left_out

    assert mean(stamps, source.scans.odometry) == (pytest.approx(odometry, rel=0.002), 0)
    if graph is None:
        return
    file = shared_data / name / f"{name}.ref-graph.txt.gz"
    exact = np.loadtxt(file)
    assert mean(exact[:, 1], exact[:, 2:])[0] == pytest.approx(graph, abs=0.0006)
    few = keyframes(with_reference(source, file), 0.25, math.radians(8))
    known = [i for i, step in enumerate(few.steps) if step.truth is not None]
    first, last = known[0], known[-1]
    few = part(few, first, last)
    truth = [step.truth for step in few.steps]
    assert sum(pose is None for pose in truth) < 0.01 * len(truth)
    path = np.array([dead if pose is None else pose for pose, dead in zip(truth, dead_reckoning(few), strict=True)])
    assert mean(*every_scan(few, path))[0] < graph + 0.02


@pytest.mark.parametrize("name", ["car-park", "mrclam", "mit-killian/mit-killian.g2o.gz", "intel/intel.relations.gz"])
def test_other_data_are_refused_in_one_sentence(shared_data: Path, name: str) -> None:
    with pytest.raises(ValueError, match="expected") as caught:
        read_log(shared_data / name)
    assert "\n" not in str(caught.value)
