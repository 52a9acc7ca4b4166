"""`--summary`: complete, deterministic, and written whole."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from app import session
from app.errors import UsageError
from app.files import check_directory, check_file, write_whole
from app.summary import SCHEMA, Summary, dump, without_timings
from scenarios.registry import build
from scenarios.types import Step
from slam.estimators import ESTIMATORS
from slam.types import UNKNOWN_TAG

ARRAYS = {
    "step",
    "time_s",
    "position_error_m",
    "best_position_error_m",
    "heading_error_rad",
    "diversity",
    "n_eff",
    "nees",
    "nees_pose",
    "features",
    "duplicates_so_far",
    "resampled",
}
NUMBERS = {
    "title",
    "particles",
    "position_mse",
    "nees_infinite",
    "nees_pose_infinite",
    "duplicates",
    "resamplings",
    "association",
    "update_ms",
    "real_time_factor",
}


def summarise(source=None, keys=("dfs", "fs2", "fs1", "ekf"), count=15, seed=2, path=None, align=False, **changes):
    source = source or build("loop", features="landmarks")
    params = source.params(particles=10, **changes)
    summary = Summary(path, align=align)
    filters = [ESTIMATORS[key] for key in keys]
    session.run(session.make_info(source, filters, params, seed=seed, count=count), [summary])
    return summary


def test_schema(tmp_path):
    path = tmp_path / "summary.json"
    summarise(path=path)
    summary = json.loads(path.read_text())
    assert list(summary) == [
        "schema",
        "version",
        "world",
        "title",
        "seed",
        "mistake",
        "steps",
        "complete",
        "params",
        "matching",
        "changes",
        "events",
        "relations",
        "alone",
        "filters",
    ]
    assert (summary["schema"], summary["world"], summary["seed"]) == (SCHEMA, "loop", 2)
    assert (summary["steps"], summary["complete"]) == (15, True)
    assert summary["params"]["particles"] == 10
    assert summary["params"]["believed"]["range"] == summary["params"]["noise"]["range"] == 0.05
    assert summary["params"]["options"]["length"] == 30.0
    assert summary["params"]["odometry"] is summary["matching"] is None
    assert list(summary["filters"]) == ["dfs", "fs2", "fs1", "ekf"]
    for key, filter in summary["filters"].items():
        assert set(filter) == ARRAYS | NUMBERS
        assert {len(filter[name]) for name in ARRAYS} == {15}
        assert filter["step"] == list(range(1, 16))
        assert filter["time_s"] == pytest.approx(0.5 * np.arange(1, 16))
        assert filter["particles"] == (1 if key == "ekf" else 10)
        assert filter["position_mse"] == pytest.approx(np.mean(np.square(filter["position_error_m"])))
        assert filter["resamplings"] == sum(filter["resampled"])
        assert filter["duplicates"] == filter["duplicates_so_far"][-1]
        assert type(filter["duplicates"]) is int
        assert set(filter["association"]) == {"correct", "wrong", "missed"}
        assert set(filter["update_ms"]) == {"median", "p95", "total_s"}
        assert all(0 < share <= 1 for share in filter["diversity"])


def test_walls_are_summarised_like_landmarks(tmp_path):
    path = tmp_path / "summary.json"
    summarise(build("loop"), path=path)
    summary = json.loads(path.read_text())
    assert (summary["params"]["options"]["features"], summary["params"]["noise"]["odometry"]) == ("walls", 0.1)
    for filter in summary["filters"].values():
        assert set(filter) == ARRAYS | NUMBERS
        assert {len(filter[name]) for name in ARRAYS} == {15}
        assert all(count is not None for count in filter["duplicates_so_far"])
        assert filter["features"][-1] > 5
        right, wrong, missed = (filter["association"][name] for name in ("correct", "wrong", "missed"))
        assert right > wrong + missed


def test_numbers_are_those_of_the_measures():
    class Last:
        def begin(self, info):
            pass

        def step(self, step):
            self.measures = step.filters["dfs"].measures

        def end(self):
            pass

    source, summary, last = build("loop", features="landmarks"), Summary(), Last()
    session.run(session.make_info(source, [ESTIMATORS["dfs"]], count=3), [summary, last])
    filter = summary.as_dict()["filters"]["dfs"]
    assert filter["position_error_m"][-1] == last.measures.position_error_m
    assert filter["best_position_error_m"][-1] == last.measures.best_position_error_m
    assert filter["nees"][-1] == last.measures.nees_position
    assert filter["features"][-1] == last.measures.features


def test_same_seed_same_summary():
    once, again, other = summarise().as_dict(), summarise().as_dict(), summarise(seed=3).as_dict()
    assert dump(without_timings(once)) == dump(without_timings(again))
    assert dump(without_timings(once)["filters"]) != dump(without_timings(other)["filters"])
    assert "update_ms" not in without_timings(once)["filters"]["dfs"]
    assert "update_ms" in once["filters"]["dfs"]


def test_what_is_not_known_is_null():
    source = build("loop", features="landmarks")
    steps = tuple(
        Step(s.frame._replace(tags=np.full(len(s.frame.tags), UNKNOWN_TAG)), None if i % 2 else s.truth)
        for i, s in enumerate(source.steps)
    )
    unknown = dataclasses.replace(source, steps=steps, true_map=None)
    filter = summarise(unknown, ["dfs"], count=4).as_dict()["filters"]["dfs"]
    assert [value is None for value in filter["position_error_m"]] == [False, True, False, True]
    assert filter["position_mse"] is not None
    assert filter["association"] is None
    assert filter["duplicates"] is None

    never = dataclasses.replace(unknown, steps=tuple(s._replace(truth=None) for s in steps))
    filter = summarise(never, ["dfs"], count=4).as_dict()["filters"]["dfs"]
    assert filter["position_mse"] is None
    assert filter["nees"] == [None] * 4
    assert filter["nees_infinite"] == 0


def test_infinite_nees_is_null_and_counted():
    filter = summarise(keys=["fs1"], count=3).as_dict()["filters"]["fs1"]
    one = summarise(keys=["fs1"], count=3)
    one.filters["fs1"].series["nees"][1] = math.inf
    changed = one.as_dict()["filters"]["fs1"]
    assert changed["nees"] == [filter["nees"][0], None, filter["nees"][2]]
    assert changed["nees_infinite"] == 1


def test_alignment_takes_out_a_rigid_motion():
    plain = summarise(keys=["ekf"], count=40).as_dict()["filters"]["ekf"]
    source = _turned(build("loop", features="landmarks"))
    turned = summarise(source, ["ekf"], count=40)
    aligned = summarise(source, ["ekf"], count=40, align=True).as_dict()["filters"]["ekf"]
    assert turned.as_dict()["filters"]["ekf"]["position_mse"] > 1.0
    assert aligned["position_mse"] <= plain["position_mse"]
    assert max(aligned["heading_error_rad"]) < 0.2
    assert aligned["nees"] == [None] * 40
    again = summarise(keys=["ekf"], count=40, align=True).as_dict()["filters"]["ekf"]
    np.testing.assert_allclose(aligned["position_error_m"], again["position_error_m"], atol=1e-9)


def _turned(source):
    """The same source with a truth that is told in another frame."""

    def turn(pose):
        x, y, heading = pose
        return np.array([5 - y, 3 + x, heading + math.pi / 2])

    return dataclasses.replace(source, steps=tuple(s._replace(truth=turn(s.truth)) for s in source.steps))


def test_an_interrupted_run_is_summarised_as_far_as_it_came():
    source, summary = build("loop", features="landmarks"), Summary()
    info = session.make_info(source, [ESTIMATORS["dfs"]], count=5)
    summary.begin(info)
    found = summary.as_dict()
    assert (found["steps"], found["complete"]) == (0, False)
    assert found["filters"]["dfs"]["update_ms"] == {"median": None, "p95": None, "total_s": 0.0}
    for step in list(session.steps(info))[:2]:
        summary.step(step)
    assert (summary.as_dict()["steps"], summary.as_dict()["complete"]) == (2, False)


def test_dump_is_json_with_arrays_on_one_line():
    value = {"a": [1, 2.5, None], "b": {"c": "é", "d": {}}, "e": True}
    assert json.loads(dump(value)) == value
    assert '"a": [1, 2.5, null]' in dump(value)
    with pytest.raises(ValueError, match="JSON"):
        dump({"a": math.nan})


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "file.txt"
    write_whole(path, "first")
    path.chmod(0o640)
    write_whole(path, "second")
    assert path.read_text() == "second"
    assert path.stat().st_mode & 0o777 == 0o640
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "\ud800")
    assert path.read_text() == "second"
    assert list(tmp_path.iterdir()) == [path]


def test_outputs_are_checked(tmp_path):
    check_file("--summary", tmp_path / "new.json")
    assert list(tmp_path.iterdir()) == []
    file = tmp_path / "file"
    file.touch()
    for check, path, complaint in (
        (check_file, tmp_path, "is a directory"),
        (check_file, tmp_path / "no" / "x.json", "the directory .*no does not exist"),
        (check_file, file / "x.json", "is no directory"),
        (check_directory, file, "is a file"),
        (check_directory, file / "x", "cannot be made"),
    ):
        with pytest.raises(UsageError, match=complaint):
            check("--out", path)
    check_directory("--trajectory", tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == [file]


def test_the_events_are_those_that_a_recording_tells():
    summary = Summary()
    source = build("paper-line")
    filters = [ESTIMATORS["fs1"], ESTIMATORS["dfs"]]
    session.run(session.make_info(source, filters, source.params(particles=10), count=8), [summary])
    events = summary.as_dict()["events"]
    assert [event for event in events if event[1] == "fs1" and "resampled: N_eff" in event[2]]
    assert any("one founder left" in sentence for _, key, sentence in events if key == "fs1")
    assert {step for step, _, _ in events} <= set(range(1, 9))


def test_that_nothing_is_seen_is_an_event_of_no_filter():
    summary, source = Summary(), build("loop")
    noise = dataclasses.replace(source.noise, missing=1.0)
    session.run(session.make_info(source, [ESTIMATORS["ekf"]], noise=noise, count=62), [summary])
    assert summary.as_dict()["events"] == [[60, "", "Nothing has been seen since 0.0 s, for 30 s"]]
