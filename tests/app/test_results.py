"""What the README says comes out, still comes out: fewer runs than there, the same seeds, bounds in standard errors."""

from __future__ import annotations

import json

import pytest

from app import cli


def study(tmp_path, *arguments: str) -> dict:
    path = tmp_path / "study.json"
    assert cli.entry(["study", *arguments, "--jobs", "1", "--out", str(path)]) == 0
    return json.loads(path.read_text())


def test_the_comparison_of_the_paper(tmp_path):
    """The right column are measurements with another implementation, on 50 other seeds."""
    levels = study(tmp_path, "paper-table", "--runs", "30")["levels"]
    coarse, fine = levels["3 mm, 0.003°"], levels["0.3 mm, 0.0003°"]
    for row, mse in (
        (coarse["fs1"], 0.0316),
        (coarse["fs2"], 0.0240),
        (coarse["dfs"], 0.0177),
        (coarse["ekf"], 0.0159),
    ):
        found = row["final_mse_m2"]
        assert abs(found["value"] - mse) < 4.0 * found["error"]
    for row, at, diversity in (
        (coarse["fs2"], "at 5", 0.92),
        (coarse["fs2"], "at 10", 0.64),
        (coarse["fs2"], "at 20", 0.37),
        (coarse["fs2"], "at 59", 0.16),
        (coarse["dfs"], "at 5", 0.92),
        (coarse["dfs"], "at 10", 0.83),
        (coarse["dfs"], "at 20", 0.66),
        (coarse["dfs"], "at 59", 0.41),
        (coarse["dfs-joint"], "at 10", 0.08),
    ):
        found = row["diversity"][at]
        assert abs(found["value"] - diversity) < 4.0 * found["error"]
    assert coarse["fs1"]["diversity"]["at 59"]["value"] == pytest.approx(1 / 25)
    assert fine["dfs"]["diversity"]["at 59"]["value"] >= 0.98
    assert fine["fs2"]["diversity"]["at 59"]["value"] <= 0.10
    better = [a - b for a, b in zip(fine["dfs"]["squared_errors_m2"], fine["fs2"]["squared_errors_m2"], strict=True)]
    assert sum(better) < 0.0


def test_mrclam(shared_data, tmp_path):
    """Robot 3, 100 particles; dead reckoning is 4.28 m off.  Dual FastSLAM gains by a larger R."""
    log = str(shared_data / "mrclam" / "MRCLAM_Dataset6")
    cells = study(
        tmp_path, "log-error", log, "--robot", "3", "--association", "known", "--seeds", "5", "--inflate-r", "1", "16"
    )["cells"]
    rmse = {(cell["filter"], cell["inflate_r"]): cell["median"]["position_rmse_m"] for cell in cells}
    assert rmse["fs2", 1.0] <= 0.25
    assert rmse["dfs", 1.0] <= 0.45
    assert rmse["dfs", 16.0] < rmse["dfs", 1.0]


def test_victoria_park(shared_data, tmp_path):
    """The first quarter of the drive: dead reckoning is 14 m off by then."""
    log = str(shared_data / "victoria-park")
    cells = study(
        tmp_path, "log-error", log, "--filters", "fs2", "--particles", "20", "--seeds", "1", "--steps", "1800"
    )["cells"]
    assert cells[0]["median"]["position_rmse_m"] < 5.0
    assert 50 < cells[0]["median"]["features"] < 400


def test_unknown_association_round_a_loop(tmp_path):
    """Of a map that was out of sight for most of the way."""
    filters = study(tmp_path, "association", "--runs", "4")["filters"]
    for key in ("fs2", "dfs"):
        assert filters[key]["correct"]["value"] >= 0.95
        assert filters[key]["duplicates"]["value"] <= 0.10
