"""Studies: the same results from any number of processes, standard errors, and what is saved."""

from __future__ import annotations

import json
import math
import os
import signal
import threading

import numpy as np
import pytest
from scipy.stats import chi2

from app import cli
from app.study import consistency, consistency_plot
from app.study.jobs import run_all
from app.study.statistics import Mean, mean, spread


def saved(tmp_path, *arguments: str) -> dict:
    path = tmp_path / "study.json"
    assert cli.entry(["study", *arguments, "--out", str(path)]) == 0
    return json.loads(path.read_text())


def test_mean_and_its_standard_error():
    values = [1.0, 2.0, 4.0, 5.0]
    assert mean(values) == (3.0, pytest.approx(np.std(values, ddof=1) / 2))
    assert math.isnan(mean([1.0]).error)


def test_how_means_are_written():
    assert str(Mean(0.01772, 0.00213)) == ".0177±.0021"
    assert str(Mean(-0.5, 0.25)) == "-.50±.25"
    assert str(Mean(96.1234, 1.5)) == "96.1±1.5"
    assert str(Mean(1.0, 0.0)) == "1.00±.00"
    assert str(Mean(0.25, math.nan)) == "0.25"
    assert spread([0.3, 0.1, 0.2]) == "0.2 (0.1-0.3)"
    assert spread([15, 15], ".0f") == "15"


def test_paper_table(capsys, tmp_path):
    found = saved(tmp_path, "paper-table", "--runs", "2", "--jobs", "1", "--particles", "10")
    out = capsys.readouterr().out
    for text in (
        "FastSLAM 1.0",
        "Dual, marginal",
        "Dual, joint",
        "EKF-SLAM",
        "±",
        "0.3 mm",
        "2 of 2 seeds",
        "alternating",
    ):
        assert text in out
    assert "dualslam study paper-table --runs 2" in out
    assert found["options"]["particles"] == 10
    level = found["levels"]["3 mm, 0.003°"]
    assert set(level) == {"fs1", "fs2", "dfs", "dfs-joint", "ekf"}
    for row in level.values():
        assert len(row["squared_errors_m2"]) == 2
        assert row["final_mse_m2"]["value"] == pytest.approx(np.mean(row["squared_errors_m2"]))
        assert list(row["diversity"]) == ["at 5", "at 10", "at 20", "at 59"]
    assert level["dfs"] != level["dfs-joint"]


def test_results_do_not_depend_on_the_number_of_processes(tmp_path):
    one, two = (
        saved(tmp_path, "association", "--runs", "3", "--steps", "10", "--particles", "5", "--jobs", jobs)
        for jobs in ("1", "2")
    )
    assert one["filters"] == two["filters"]
    runs = one["filters"]["fs2"]["runs"]
    assert len(runs) == 3
    assert all(run["correct"] + run["wrong"] + run["missed"] == pytest.approx(1) for run in runs)


def test_log_error(capsys, tmp_path):
    line = """log-error field --seeds 2 --steps 10 --particles 5 10 --inflate-r 1 4 --filters fs2 ekf --jobs 1
    --association known"""
    found = saved(tmp_path, *line.split())
    cells = {(cell["filter"], cell["particles"], cell["inflate_r"]) for cell in found["cells"]}
    assert cells == {("fs2", k, r) for k in (5, 10) for r in (1.0, 4.0)} | {("ekf", 1, r) for r in (1.0, 4.0)}
    for cell in found["cells"]:
        errors = [run["position_rmse_m"] for run in cell["runs"]]
        assert cell["median"]["position_rmse_m"] == pytest.approx(np.median(errors))
        assert len(set(errors)) == 2
    assert "dead reckoning" in capsys.readouterr().out


def test_orthogonality(capsys, tmp_path):
    """On the same data the constraint makes walls agree, and what is saved is what the runs came to."""
    line = "orthogonality --world corridor --runs 2 --steps 20 --association known --jobs 1"
    found = saved(tmp_path, *line.split())
    rows = found["associations"]["known"]
    assert set(rows) == {"free", "orthogonal"}
    assert rows["free"]["nees_pose_by_step"][0] == rows["orthogonal"]["nees_pose_by_step"][0] > 0
    assert rows["free"]["nees_pose_by_step"] != rows["orthogonal"]["nees_pose_by_step"]
    for row in rows.values():
        assert len(row["nees_pose_by_step"]) == 20
        assert np.mean(row["runs"]["nees_pose"]) == pytest.approx(np.mean(row["nees_pose_by_step"]))
        assert row["runs"]["wrong"] == [0, 0]
        low, high = row["nees_pose_interval"]
        assert row["inside"] == np.mean([low <= value <= high for value in row["nees_pose_by_step"]])
        assert low < 3 < high
    out = capsys.readouterr().out
    assert "RMSE, m" in out
    assert "2 of 2 seeds" in out


def test_extraction(capsys, tmp_path):
    line = "extraction --worlds loop hall --poses 40 --beams 181 --jobs 1"
    found = saved(tmp_path, *line.split())
    fine, coarse = found["lasers"]
    assert (fine["range_noise_m"], coarse["range_noise_m"]) == (0.01, 0.05)
    worlds = fine["worlds"]
    assert set(worlds) == {"loop", "hall", "all"}
    everything = worlds["all"]
    assert everything["walls"] == worlds["loop"]["walls"] + worlds["hall"]["walls"] > 150
    assert everything["found_percent"]["value"] >= 95
    assert everything["false_percent"]["value"] <= 2
    for name in ("lateral_variance", "angle_variance"):
        assert 0.7 < everything[name]["value"] < 1.4
        assert everything[name]["error"] < 0.15
    assert coarse["worlds"]["all"]["found_percent"]["value"] < everything["found_percent"]["value"]
    out = capsys.readouterr().out
    assert "4 of 4 worlds" in out
    assert "no wall was ever seen" not in out


def test_extraction_of_nothing(capsys, tmp_path):
    """Too few beams for a wall: no share, rather than one of zero, and a word on it."""
    line = "extraction --worlds loop --poses 3 --beams 5 --range-noise 0.01 --jobs 1"
    found = saved(tmp_path, *line.split())
    assert found["lasers"][0]["worlds"]["loop"]["found_percent"] is None
    assert found["lasers"][0]["worlds"]["loop"]["segments"] == 0
    told = "warning: no wall was ever seen with 5 beams and a deviation of 0.01 m"
    assert told in capsys.readouterr().out


def _interrupting(task: int) -> int:
    if task == 2:
        os.kill(os.getpid(), signal.SIGINT)
    return task * task


def test_an_interruption_keeps_what_is_done():
    assert run_all(_interrupting, [0, 1, 2, 3], 1, "squares") == ([0, 1], True)


def test_a_study_interrupted_in_its_first_run_says_so(capsys, monkeypatch):
    monkeypatch.setattr("app.study.rotation_spread.one_run", lambda task: os.kill(os.getpid(), signal.SIGINT))
    assert cli.entry(["study", "rotation-spread", "--runs", "20", "--jobs", "1"]) == 130
    assert capsys.readouterr().err == "interrupted before the first of 20 seeds was done\n"


def _slow(task: int) -> int:
    if task:
        threading.Event().wait(60)
    else:  # here, in the process that listens to signals
        threading.Timer(2.0, os.kill, (os.getpid(), signal.SIGTERM)).start()
    return task


def test_an_interruption_does_not_wait_for_other_processes():
    assert run_all(_slow, [0, 1, 2], 2, "slow") == ([0], True)


class TestConsistency:
    def test_an_ekf_is_consistent_and_joint_weights_of_few_particles_are_not(self, tmp_path, capsys):
        out = tmp_path / "c.json"
        words = ["study", "consistency", "--runs", "12", "--particles", "50", "--filters", "dfs", "ekf"]
        assert cli.entry([*words, "--weighting", "joint", "--seed", "40", "--jobs", "1", "--out", str(out)]) == 0
        told = json.loads(out.read_text())["filters"]
        assert "EKF-SLAM" in capsys.readouterr().out
        assert told["ekf"]["pose"]["share_in_band"] > 0.7
        assert told["dfs"]["position"]["share_in_band"] < 0.3
        assert len(told["ekf"]["pose"]["mean_by_step"]) == 59
        assert abs(told["ekf"]["nis"][0]["value"] - 1.0) < 0.2

    def test_one_step_in_which_nothing_is_known_yet(self, tmp_path, capsys):
        """No innovations, and no warning of any library."""
        line = "consistency --runs 2 --steps 1 --particles 5 --filters dfs ekf --jobs 1"
        found = saved(tmp_path, *line.split(), "--picture", str(tmp_path / "plots"))
        assert found["filters"]["dfs"]["nis"] == [None, None]
        assert found["filters"]["ekf"]["heading"]["mean_by_step"][0] > 0.0
        assert "nan" not in capsys.readouterr().out
        names = {"consistency-paper-line.png", "consistency-paper-line.svg"}
        assert {path.name for path in (tmp_path / "plots").iterdir()} == names

    def test_averages_are_those_of_the_runs(self, tmp_path):
        """Of each component, and the share of them in the band of their degrees of freedom."""
        line = "consistency --runs 3 --steps 12 --particles 20 --filters fs2 --seed 5 --jobs 1"
        found = saved(tmp_path, *line.split())["filters"]["fs2"]
        study = consistency.ConsistencyStudy(filters=("fs2",), steps=12, particles=20)
        runs = [consistency.one_run(consistency.Task(study, seed))["fs2"] for seed in (5, 6, 7)]
        for name, freedom in (("position", 2), ("x", 1), ("y", 1), ("heading", 1), ("pose", 3)):
            averages = np.mean([run.nees[name] for run in runs], axis=0)
            low, high = chi2.ppf([0.025, 0.975], 3 * freedom) / 3
            assert found[name]["mean_by_step"] == pytest.approx(averages)
            assert found[name]["band"] == pytest.approx([low, high])
            assert found[name]["share_in_band"] == ((averages >= low) & (averages <= high)).mean()

    def test_the_picture_has_a_line_for_each_filter_and_the_band_of_each_component(self, tmp_path):
        values = np.array([1.0, 2.0, 20.0, math.inf, 0.01])
        averages = {key: dict.fromkeys(("position", "x", "y", "heading", "pose"), values) for key in ("dfs", "fs1")}
        figure = consistency_plot.figure_of(averages, "a world", 20)
        assert [axes.get_title(loc="left").split(":")[0] for axes in figure.axes] == ["position", "x", "y", "heading"]
        for axes, freedom in zip(figure.axes, (2, 1, 1, 1), strict=True):
            (band,), lines = axes.patches, axes.get_lines()[1:]
            assert (band.get_y(), band.get_y() + band.get_height()) == pytest.approx(
                chi2.ppf([0.025, 0.975], 20 * freedom) / 20
            )
            assert [line.get_color() for line in lines] == ["#e69f00", "#009e73"]
            for line in lines:
                assert line.get_ydata().tolist() == [1.0, 2.0, 20.0, 30.0, 0.1]
            low, high = axes.get_ylim()
            assert low < 0.1 < 30.0 < high
        drawn = [consistency_plot.draw(averages, "loop", 30, 20, tmp_path / name) for name in ("a", "b")]
        assert drawn == ["consistency-loop"] * 2
        one, other = ((tmp_path / name / "consistency-loop.svg").read_text() for name in ("a", "b"))
        assert one == other
        assert ">Dual FastSLAM<" in one


class TestDiagnosis:
    def test_one_run_of_a_setting(self, tmp_path, capsys):
        out = tmp_path / "d.json"
        words = ["study", "diagnosis", "--runs", "1", "--settings", "dual-joint", "fastslam1", "--jobs", "1"]
        assert cli.entry([*words, "--seed", "3", "--out", str(out)]) == 0
        assert "dual-joint: paper-line, Dual FastSLAM, K = 100, weighting joint" in capsys.readouterr().out
        told = json.loads(out.read_text())["settings"]
        (joint,), (starved,) = told["dual-joint"]["runs"], told["fastslam1"]["runs"]
        assert joint["cause"] == "shape of the map"
        assert (starved["advice"], starved["particles"], starved["kept"]) == ("more particles in vain", 1000, True)
