"""The real logs: what is in them, and that dead reckoning on them does what is known of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scenarios.logs import dead_reckoning, read_log
from scenarios.types import Source
from slam.geometry import wrap_all


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


@pytest.mark.parametrize("name", ["car-park", "mrclam", "mit-killian/mit-killian.g2o.gz", "intel/intel.relations.gz"])
def test_other_data_are_refused_in_one_sentence(shared_data: Path, name: str) -> None:
    with pytest.raises(ValueError, match="expected") as caught:
        read_log(shared_data / name)
    assert "\n" not in str(caught.value)
