"""`dualslam compare`: the numbers are those of the runs, what is the same is found to be, and all of it is written."""

from __future__ import annotations

import dataclasses
import io
import json
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from app import cli, colours, report, session
from app.compare import plots
from app.compare.numbers import compare
from app.compare.output import as_dict
from app.compare.runs import read_run, read_runs, split_branch, titles
from app.compare.table import filter_table, header, rows
from app.compare.words import all_the_same, data_of, no_statistics, sentences, study_commands
from app.errors import UsageError
from app.recording import Recorder, RecordingError
from app.recording.metrics import METRICS
from app.recording.reading import Recording
from app.recording.stream import FLUSH_EVERY
from app.rows import NEES, ROWS
from app.summary import Summary
from scenarios.registry import build
from scenarios.types import Step
from slam.estimators import ESTIMATORS
from slam.types import UNKNOWN_TAG
from tests.app.viewer import pixels, required_viewer

STEPS, FEWER, AT = 14, 9, 5

ALL_EQUAL = "truth, odometry and observations are equal at every step"


def record(path, keys, source=None, seed=3, steps=STEPS, changes=(), command="", **params):
    """One run, recorded; returns its summary."""
    source, summary = source or build("paper-line"), Summary()
    params = source.params(**{"particles": 12, "association": "known", "resample_below": 0.9, **params})
    filters = [ESTIMATORS[key] for key in keys]
    info = session.make_info(source, filters, params, seed=seed, count=steps, command=command)
    session.run(info, [Recorder(path), summary], changes)
    return summary


def unknown(source):
    """The same as a log of which nobody knows the truth."""
    steps = tuple(Step(s.frame._replace(tags=np.full(len(s.frame.tags), UNKNOWN_TAG)), None) for s in source.steps)
    return dataclasses.replace(source, name="log", kind="log", steps=steps, true_map=None)


def branched(path):
    """A live session that went on differently after some steps."""
    from app.recording.stream import FileStream
    from app.recording.writer import Writer

    source = build("paper-line")
    info = session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=12), seed=3, count=STEPS)
    fewer = dataclasses.replace(info.params, particles=6)
    trunk, states = Writer(info, partial(FileStream, path)), [session.start(info)]
    for _ in range(STEPS):
        state, step = session.advance(info, states[-1], info.params)
        trunk.step(step)
        states.append(state)
    branch, state = trunk.fork(info._replace(params=fewer), "Six particles!"), states[AT]
    for _ in range(AT, STEPS):
        state, step = session.advance(info, state, fewer)
        branch.step(step)
    branch.close()
    trunk.close()


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("compare")


@pytest.fixture(scope="module")
def summaries(place):
    """By name of the recordings beside each other in `place`."""
    command = "dualslam run paper-line --steps 14 --association known --layout sparse --particles"
    return {
        "a": record(place / "a.rrd", ("dfs", "fs2", "ekf"), command=f"{command} 12"),
        "again": record(place / "again.rrd", ("dfs", "ekf"), steps=FEWER),
        "more": record(place / "more.rrd", ("dfs", "fs2", "ekf"), particles=20, command=f"{command}=20"),
        "seed": record(place / "seed.rrd", ("dfs", "fs2"), seed=4),
        "blind": record(place / "blind.rrd", ("dfs",), unknown(build("paper-line")), association="jcbb"),
    }


@pytest.fixture(scope="module")
def found(place, summaries):
    return compare(read_runs([str(place / f"{name}.rrd") for name in ("a", "more")]))


def printed(table) -> list[str]:
    console = Console(width=300, file=io.StringIO(), color_system=None)
    console.print(table)
    return console.file.getvalue().splitlines()


class TestNumbers:
    def test_those_of_the_summaries_of_the_same_runs(self, found, summaries):
        assert [one.key for one in found.filters] == ["dfs", "fs2", "ekf"]
        for one in found.filters:
            for column in one.columns:
                summary = summaries[column.run.name].as_dict()["filters"][one.key]
                values, errors = column.values, np.array(summary["position_error_m"])
                assert values["position_error_end_m"] == errors[-1]
                assert values["position_error_rms_m"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12)
                assert values["position_mse"] == pytest.approx(summary["position_mse"], rel=1e-12)
                heading = np.sqrt(np.mean(np.square(summary["heading_error_rad"])))
                assert values["heading_error_rms_rad"] == pytest.approx(heading, rel=1e-12)
                assert values["nees_mean"] == pytest.approx(np.mean(summary["nees"]), rel=1e-12)
                assert values["diversity_end"] == summary["diversity"][-1]
                assert values["n_eff_median"] == np.median(summary["n_eff"])
                assert values["resamplings"] == summary["resamplings"] == sum(summary["resampled"])
                assert column.series["resampled"].tolist() == summary["resampled"]
                assert values["features"] == summary["features"][-1]
                assert values["duplicates"] == summary["duplicates"]
                assert values["update_median_s"] == pytest.approx(1e-3 * summary["update_ms"]["median"], rel=1e-12)
                assert values["update_p95_s"] == pytest.approx(1e-3 * summary["update_ms"]["p95"], rel=1e-12)
        assert any(column.values["resamplings"] > 0 for one in found.filters for column in one.columns)

    def test_rows_are_written_as_in_the_report(self, found, summaries):
        """Name, digits and unit."""
        of_runs = {name: printed(report.table(summary)) for name, summary in summaries.items()}
        one = found.filters[0]
        for title, cells in rows(one, found):
            if title == "map error, end":  # which the report does not have
                continue
            for name, cell in (("a", cells[0]), ("more", cells[1])):
                (line,) = (line for line in of_runs[name] if line.startswith(f"{title}  "))
                assert line.removeprefix(title).split("  ")[1:] != []
                assert cell in [part.strip() for part in line.removeprefix(title).split("  ")]

    def test_differences(self, found):
        one = found.filters[0]
        first, other = one.columns
        assert header(one, found) == ["a", "more", "more - a"]
        table = dict(rows(one, found))
        assert table["particles"] == ["12", "20", "+8"]
        apart = other.values["n_eff_median"] - first.values["n_eff_median"]
        assert table["N_eff, median"][2].startswith(f"+{apart:.3g} (+")
        assert table["diversity, end"][2].endswith("points") or table["diversity, end"][2] == "="
        assert set(dict(rows(found.filters[2], found))["position error, RMS"][2]) == {"="}
        assert [line for line in printed(filter_table(one, found)) if line.startswith("features")]

    def test_infinite_nees_is_no_number_in_json(self, found):
        first = found.filters[0].columns[0]
        series = {**first.series, "nees": np.where(np.arange(STEPS) == 2, np.inf, first.series["nees"])}
        one = found.filters[0]._replace(columns=[first._replace(series=series)])
        assert "(1 inf)" in dict(rows(one, found._replace(runs=found.runs[:1])))["NEES (1.09 to 3.18)"][0]

    def test_over_the_steps_that_all_have(self, place, summaries):
        both = compare(read_runs([str(place / "a.rrd"), str(place / "again.rrd")]))
        assert both.steps.tolist() == list(range(1, FEWER + 1))
        assert f"a has {STEPS}, again has {FEWER} steps: compared over the {FEWER} that all have, 1 to {FEWER}" in (
            sentences(both)
        )
        errors = summaries["a"].as_dict()["filters"]["dfs"]["position_error_m"][:FEWER]
        assert both.filters[0].columns[0].values["position_error_end_m"] == errors[-1]
        assert both.filters[0].columns[0].values["position_mse"] == pytest.approx(np.mean(np.square(errors)))

    def test_a_filter_that_only_one_has(self, place, summaries):
        both = compare(read_runs([str(place / "again.rrd"), str(place / "a.rrd")]))
        alone = next(one for one in both.filters if one.key == "fs2")
        assert header(alone, both) == ["again", "a"] or header(alone, both) == ["again", "", "a"]
        assert dict(rows(alone, both))["particles"][0] == "-"


class TestWords:
    def test_same_seed_is_the_same_run(self, place, summaries):
        both = compare(read_runs([str(place / "a.rrd"), str(place / "again.rrd")]))
        said = " / ".join(sentences(both))
        assert f"again saw the same data as a: {ALL_EQUAL}" in said
        assert "Dual FastSLAM and EKF-SLAM are the same run in a and again: every number, bit for bit" in said
        assert not all_the_same(both)  # FastSLAM 2.0 is missing
        assert [column.parts_at for one in both.filters for column in one.columns] == [None] * 5

    def test_a_recording_is_the_same_as_itself(self, place, summaries):
        both = compare(read_runs([str(place / "a.rrd")] * 2))
        assert all_the_same(both)
        assert len({run.name for run in both.runs}) == 2

    def test_another_number_of_particles(self, found):
        said = sentences(found)
        assert f"compared over all {STEPS} steps, 1 to {STEPS}" in said
        assert "more differs from a: particles 12 -> 20" in said
        assert f"more saw the same data as a: {ALL_EQUAL}" in said
        assert "EKF-SLAM is the same run in a and more: every number, bit for bit" in said
        assert found.filters[0].columns[1].parts_at is not None

    def test_another_seed(self, place, summaries):
        both = compare(read_runs([str(place / "a.rrd"), str(place / "seed.rrd")]))
        said = sentences(both)
        assert "seed differs from a: seed 3 -> 4; without ekf" in said
        assert "seed saw other data than a: other odometry and observations from step 1 on; truth the same" in said

    def test_what_changed_while_it_ran(self, place, summaries, tmp_path):
        """Also noise, of which the beginning of a recording says nothing."""
        source = build("paper-line")
        params = source.params(particles=12, association="known", resample_below=0.9)
        noise = dataclasses.replace(source.noise, speed=0.6)
        changes = [session.Change(6, dataclasses.replace(params, temper=0.5), noise)]
        record(tmp_path / "changed.rrd", ("dfs",), changes=changes)
        both = compare(read_runs([str(place / "a.rrd"), str(tmp_path / "changed.rrd")]))
        said = " / ".join(sentences(both))
        assert "changed while it ran: temper: 1.0 -> 0.5 at step 6; noise.speed: 0.3 -> 0.6 at step 6" in said
        assert "changed saw other data than a: other odometry" in said
        assert "although source, noise and seed are said to be the same" in said
        data = data_of(*both.runs, both.steps)
        assert (data.same, data.equal, data.other) == (False, ["truth", "observations"], {"odometry": 6}) or (
            data.other["odometry"] == 6
        )
        assert both.filters[0].columns[1].parts_at == 6

    def test_without_truth(self, place, summaries):
        blind = compare(read_runs([str(place / "blind.rrd")] * 2))
        said = " / ".join(sentences(blind))
        assert "nobody knows the truth: there are no errors and no NEES" in said
        assert "the same data" in said
        titles = [title for title, _ in rows(blind.filters[0], blind)]
        assert "N_eff, median" in titles
        assert not [title for title in titles if "error" in title or "NEES" in title or "duplicates" in title]
        one_eyed = compare(read_runs([str(place / "a.rrd"), str(place / "blind.rrd")]))
        assert "nobody knows the truth in blind: no errors and no NEES there" in sentences(one_eyed)
        assert dict(rows(one_eyed.filters[0], one_eyed))["position error, RMS"][1:] == ["-", ""]

    def test_parts_of_one_log(self, place, summaries, tmp_path):
        whole = unknown(build("paper-line"))
        part = dataclasses.replace(whole, options={**whole.options, "last": FEWER})
        record(tmp_path / "part.rrd", ("dfs",), part, steps=FEWER, association="jcbb")
        said = sentences(compare(read_runs([str(place / "blind.rrd"), str(tmp_path / "part.rrd")])))
        assert f"part differs from blind: options.last none -> {FEWER}" in said
        assert "part saw the same data as blind: odometry is equal at every step" in said
        assert "Dual FastSLAM is the same run in blind and part: every number, bit for bit" in said

    def test_commands_of_a_study_can_be_typed(self, found):
        from app.command import parse

        world, study = study_commands(found.runs)
        assert world == "dualslam worlds paper-line --layout sparse --write paper-line-1.toml"
        assert study == (
            "dualslam study log-error paper-line-1.toml --filters dfs fs2 ekf --particles 12 20 --steps 14 "
            "--association known"
        )
        typed, _ = parse(study.split()[1:])
        assert typed.study.particles == (12, 20)
        assert typed.study.association == "known"

    def test_a_session_from_python_has_no_command(self, place, summaries):
        runs = read_runs([str(place / "seed.rrd"), str(place / "again.rrd")])
        assert study_commands(runs) == ["dualslam study log-error paper-line --filters dfs fs2 ekf --particles 12"]


@pytest.fixture(scope="module")
def live(place):
    branched(place / "live.rrd")
    return place / "live.rrd"


class TestBranches:
    def test_the_run_and_its_branch(self, live):
        assert split_branch(f"{live}#six-particles") == (live, "six-particles")
        assert split_branch(str(live)) == (live, "")
        both = compare(read_runs([str(live), f"{live}#six-particles"]))
        assert both.steps.tolist() == list(range(AT + 1, STEPS + 1))
        said = sentences(both)
        assert "live#six-particles differs from live: particles 12 -> 6" in said
        assert f"live#six-particles saw the same data as live: {ALL_EQUAL}" in said
        assert both.filters[0].columns[1].series["n_eff"].max() <= 6
        assert len(no_statistics(both)) == 1  # no study has what a person changed on the way

    def test_a_nees_that_is_infinite_at_times_has_no_difference(self, live):
        one = compare(read_runs([str(live), f"{live}#six-particles"])).filters[0]
        row = next(row for row in ROWS if row.key == NEES)
        assert np.isfinite(one.difference(row, one.columns[1]))
        nees = one.columns[0].series["nees"].copy()
        nees[0] = np.inf
        first = one.columns[0]._replace(series={**one.columns[0].series, "nees": nees})
        assert np.isnan(one._replace(columns=[first, one.columns[1]]).difference(row, one.columns[1]))

    def test_a_run_that_is_wrong_on_purpose_is_called_so(self, live):
        run = read_run(live, "", "live")
        wrong = run._replace(told={**run.told, "mistake": "shared-maps"})
        assert "live is wrong on purpose: shared-maps" in sentences(compare([wrong, run._replace(name="other")]))

    def test_branches_that_are_not_compared_are_told(self, live, place, summaries):
        both = compare(read_runs([str(live), str(place / "a.rrd")]))
        assert sentences(both)[0].endswith(f"the other is {live}#six-particles")
        assert both.steps.tolist() == list(range(1, STEPS + 1))

    def test_a_branch_that_is_not_there(self, live, capsys):
        assert cli.entry(["compare", str(live), f"{live}#seven"]) == 2
        assert "has no branch 'seven'; it has six-particles" in capsys.readouterr().err


class TestFiles:
    def test_a_damaged_one_is_read_as_far_as_it_goes(self, tmp_path, capsys):
        """Its series end at different steps; all numbers are of the last step that all have."""
        whole, cut, size = tmp_path / "whole.rrd", tmp_path / "cut.rrd", 0

        class Pause:
            def begin(self, info):
                pass

            def step(self, step):
                nonlocal size
                if step.index == AT:
                    time.sleep(3 * FLUSH_EVERY)
                    size = whole.stat().st_size

            def end(self):
                pass

        source = build("paper-line")
        info = session.make_info(
            source, [ESTIMATORS["dfs"], ESTIMATORS["fs2"]], source.params(particles=9), count=STEPS
        )
        session.run(info, [Recorder(whole), Pause()])
        for more in range(20_000, 20_300, 100):  # a cut that happens to fall between two chunks is no damage
            cut.write_bytes(whole.read_bytes()[: size + more])
            if Recording(cut).damaged:
                break
        assert Recording(cut).damaged
        assert cli.entry(["compare", str(whole), str(cut)]) == 0
        both = compare(read_runs([str(whole), str(cut)]))
        assert AT <= len(both.steps) < STEPS
        said = f"warning: {cut} is damaged: it is read as far as that goes, to step {both.steps[-1]} of {STEPS}\n"
        assert capsys.readouterr().err == said
        for one in both.filters:
            first, second = one.columns
            names = set(second.series) - {"resampled"}  # whose last ones may be lost
            assert all(np.array_equal(first.series[n], second.series[n], equal_nan=True) for n in names)

    def test_an_unfinished_one_is_told(self, place, summaries, tmp_path, capsys):
        source, path = build("paper-line"), tmp_path / "short.rrd"
        info = session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=5), count=30)
        recorder = Recorder(path)
        recorder.begin(info)
        for step in list(session.steps(info))[:4]:
            recorder.step(step)
        recorder.end()
        assert cli.entry(["compare", str(place / "a.rrd"), str(path)]) == 0
        assert f"warning: {path} ends at step 4 of 30" in capsys.readouterr().err

    def test_what_is_no_recording_of_a_run(self, place, summaries, tmp_path, capsys):
        import rerun as rr

        (tmp_path / "text.rrd").write_text("hello")
        (tmp_path / "empty.rrd").touch()
        other = rr.RecordingStream("other")
        other.save(tmp_path / "other.rrd")
        other.log("a", rr.TextLog("b"))
        other.disconnect()
        recorder, source = Recorder(tmp_path / "none.rrd"), build("paper-line")
        recorder.begin(session.make_info(source, [ESTIMATORS["dfs"]]))
        recorder.end()
        for name, expected in {
            "text": "is no Rerun recording",
            "empty": "is empty",
            "other": "but not one of dualslam",
            "missing": "cannot be read: no such file or directory",
            "none": "has no step of any filter; nothing can be compared",
        }.items():
            assert cli.entry(["compare", str(place / "a.rrd"), str(tmp_path / f"{name}.rrd")]) == 2
            err = capsys.readouterr().err
            assert err.startswith("dualslam: ")
            assert expected in err
            assert err.count("\n") == 1

    def test_arguments(self, place, summaries, tmp_path, capsys):
        a = str(place / "a.rrd")
        (tmp_path / "compare.rrd").write_bytes((place / "a.rrd").read_bytes())
        (tmp_path / "file").touch()
        (tmp_path / "notes").mkdir()
        (tmp_path / "notes" / "compare.rrd").write_text("years of work")
        for arguments, expected in {
            (): "compare needs 2 to 8 recordings, and 0 were given",
            (a,): "compare needs 2 to 8 recordings, and 1 was given",
            (a,) * 9: "and 9 were given",
            (a, ""): "is empty; expected a path",
            (a, a, "--laps", "2"): "unknown option --laps",
            (a, a, "--ouf", "x"): "unknown option --ouf (did you mean --out?)",
            (a, a, "--out", f"{tmp_path / 'file'}"): "is a file; expected a directory",
            (a, a, "--out", f"{tmp_path / 'notes'}"): "exists and is no recording; it is not overwritten",
            (f"{tmp_path / 'compare.rrd'}", a, "--out", f"{tmp_path}"): "which is to be compared",
        }.items():
            assert cli.entry(["compare", *arguments]) == 2
            assert expected in capsys.readouterr().err
        assert (tmp_path / "notes" / "compare.rrd").read_text() == "years of work"

    def test_names(self):
        a, b, c = Path("x/a.rrd"), Path("y/a.rrd"), Path("y/b.rrd")
        assert titles([(a, ""), (c, ""), (c, "br")]) == ["a", "b", "b#br"]
        assert titles([(a, ""), (b, ""), (c, "")]) == ["x/a", "y/a", "b"]
        assert titles([(a, ""), (a, "")]) == ["x/a (1)", "x/a (2)"]

    def test_a_file_whose_name_has_the_mark_of_branches(self, place, summaries, tmp_path):
        (tmp_path / "run#1.rrd").write_bytes((place / "a.rrd").read_bytes())
        assert split_branch(str(tmp_path / "run#1.rrd")) == (tmp_path / "run#1.rrd", "")
        assert read_run(tmp_path / "run#1.rrd", "", "x").told["seed"] == 3

    def test_steps_that_nobody_has_in_common(self, place, summaries):
        first, other = read_runs([str(place / "a.rrd"), str(place / "again.rrd")])
        later = {key: numbers._replace(steps=numbers.steps + 100) for key, numbers in other.filters.items()}
        with pytest.raises(UsageError, match=r"no step in common.*a has steps 1 to 14, again has steps 101 to 109"):
            compare([first, other._replace(filters=later)])

    def test_a_filter_that_was_not_always_on(self, found):
        first, other = found.runs
        late = other.filters["fs2"]
        late = late._replace(steps=late.steps[3:], series={name: of[3:] for name, of in late.series.items()})
        both = compare([first, other._replace(filters={**other.filters, "fs2": late})])
        assert [len(one.steps) for one in both.filters] == [STEPS, STEPS - 3, STEPS]
        assert {len(column.series["nees"]) for column in both.filters[1].columns} == {STEPS - 3}
        assert f"FastSLAM 2.0 was not always on: compared over {STEPS - 3} steps, 4 to {STEPS}" in sentences(both)

    def test_a_series_that_one_of_them_does_not_have(self, place, summaries):
        """The filters may be the same all the same."""
        first, other = read_runs([str(place / "a.rrd")] * 2)
        dfs, blank = other.filters["dfs"], np.full(STEPS, np.nan)
        less = dfs._replace(series={**dfs.series, "diversity": blank}, missing=frozenset({"diversity"}))
        both = compare([first, other._replace(name="less", filters={**other.filters, "dfs": less})])
        assert dict(rows(both.filters[0], both))["diversity, end"][1:] == ["-", ""]
        assert "the recording of less lacks diversity of Dual FastSLAM" in sentences(both)
        assert all_the_same(both)

    def test_a_recording_without_a_series(self, place, summaries, tmp_path):
        from rerun.chunk import RrdReader

        whole = RrdReader(place / "a.rrd").store().stream()
        part = whole.drop(content="/plots/diversity/dfs")
        part.write_rrd(tmp_path / "part.rrd", application_id="dual-fastslam", recording_id="part")
        numbers = read_run(tmp_path / "part.rrd", "", "part").filters["dfs"]
        assert numbers.missing == {"diversity"}
        assert len(numbers.steps) == STEPS


@pytest.fixture(scope="module")
def written(place, summaries):
    """What `--out` writes of two runs, and where."""
    out = place / "out" / "deep"
    assert cli.entry(["compare", str(place / "a.rrd"), str(place / "more.rrd"), "--out", str(out)]) == 0
    return out


class TestOutput:
    def test_files(self, written):
        assert {path.name for path in written.iterdir()} == {"compare.json", "compare.rrd", *plots.names()}

    def test_json(self, written, found, summaries):
        saved = json.loads((written / "compare.json").read_text())
        assert list(saved) == ["schema", "version", "command", "steps", "said", "study", "runs", "filters", "plots"]
        assert saved["schema"] == 1
        assert saved["steps"] == {"first": 1, "last": STEPS, "count": STEPS}
        assert "more differs from a: particles 12 -> 20" in saved["said"]
        assert saved["study"][1].startswith("dualslam ")
        a, more = saved["runs"]
        assert (a["name"], a["data"], a["differences"]) == ("a", None, {})
        assert more["differences"] == {"particles": [12, 20]}
        assert more["data"] == {"same": True, "equal": ["truth", "odometry", "observations"], "other": {}}
        assert (more["seed"], more["steps"], more["asked"], more["damaged"]) == (3, STEPS, STEPS, False)
        for key in ("dfs", "fs2", "ekf"):
            for name in ("a", "more"):
                summary, one = summaries[name].as_dict()["filters"][key], saved["filters"][key]["runs"][name]
                for series in ("position_error_m", "nees", "n_eff", "diversity", "features", "duplicates_so_far"):
                    assert one["series"][series] == summary[series], series
                assert one["numbers"]["position_mse"] == pytest.approx(summary["position_mse"])
        apart = saved["filters"]["dfs"]["runs"]["more"]["differences"]["n_eff_median"]
        assert apart == pytest.approx(
            np.median(summaries["more"].filters["dfs"].array("n_eff"))
            - np.median(summaries["a"].filters["dfs"].array("n_eff"))
        )
        same = {key: one["runs"]["more"]["same_run"] for key, one in saved["filters"].items()}
        assert same == {"dfs": False, "fs2": False, "ekf": True}
        assert saved["filters"]["dfs"]["runs"]["more"]["differs_from_step"] == 1

    def test_pictures(self, written):
        for name in plots.names():
            if name.endswith(".png"):
                assert (pixels((written / name).read_bytes()) < 250).mean() > 0.01, name
        svg = (written / "n-eff.svg").read_text()
        for rank in (0, 1):
            for key in ("dfs", "fs2"):
                red, green, blue = colours.of_run(colours.of_filter(key), rank, on_dark=False)
                assert f"stroke: #{red:02x}{green:02x}{blue:02x}" in svg
        assert ">more<" in svg
        assert ">EKF-SLAM<" not in svg  # it has no population
        assert ">EKF-SLAM<" in (written / "nees.svg").read_text()

    def test_same_runs_same_pictures(self, written, found, tmp_path, monkeypatch):
        monkeypatch.setattr(plots, "PLOTS", [plot for plot in plots.PLOTS if plot.name == "n-eff"])
        assert plots.draw(found, tmp_path) == ["n-eff", "paths"]
        for path in tmp_path.iterdir():
            assert path.read_bytes() == (written / path.name).read_bytes(), path.name

    def test_no_plot_of_an_earlier_comparison_is_left(self, place, summaries, tmp_path, monkeypatch):
        (tmp_path / "compare.json").write_text("{}")
        for name in ("nees.svg", "n-eff.svg", "mine.svg"):
            (tmp_path / name).write_text("old")
        monkeypatch.setattr(plots, "PLOTS", [plot for plot in plots.PLOTS if plot.name in ("nees", "n-eff")])
        blind = str(place / "blind.rrd")
        assert cli.entry(["compare", blind, blind, "--out", str(tmp_path)]) == 0
        assert (tmp_path / "mine.svg").read_text() == "old"
        assert {path.stem for path in tmp_path.glob("*.svg")} == {"n-eff", "paths", "mine"}
        assert (tmp_path / "n-eff.svg").read_text() != "old"

    def test_all_is_written_before_anything_is_printed(self, place, summaries, tmp_path, monkeypatch):
        """| head ends a program that prints."""

        def nobody_reads(*_):
            raise KeyboardInterrupt

        monkeypatch.setattr("app.compare.command._print", nobody_reads)
        monkeypatch.setattr(plots, "PLOTS", [])
        a = str(place / "a.rrd")
        assert cli.entry(["compare", a, a, "--out", str(tmp_path)]) == 130
        assert {path.name for path in tmp_path.iterdir()} == {"compare.json", "compare.rrd", "paths.png", "paths.svg"}

    def test_no_line_is_cut_off(self, written, found):
        """The filters of a plot may share an axis, which must hold all of them."""
        import matplotlib as mpl

        with mpl.rc_context(plots.LETTERS):
            for plot in plots.PLOTS:
                figure = plots.over_steps(plot, found)
                assert figure is not None
                for axes in figure.axes:
                    low, high = axes.get_ylim()
                    for line in axes.get_lines():
                        drawn = np.asarray(line.get_ydata(), float)
                        assert low <= np.nanmin(drawn) <= np.nanmax(drawn) <= high, plot.name

    def test_what_nobody_knows_is_not_drawn(self, place, summaries):
        blind = compare(read_runs([str(place / "blind.rrd")] * 2))
        drawn = [plot.name for plot in plots.PLOTS if plots.over_steps(plot, blind) is not None]
        assert drawn == ["n-eff", "diversity", "features", "update"]

    def test_the_merged_recording(self, written, place, capsys):
        from rerun.chunk import RrdReader

        reader = RrdReader(written / "compare.rrd")
        chunks = reader.store().stream().to_chunks()
        entities = {chunk.entity_path for chunk in chunks}
        for name in ("a", "more"):
            own = {e for e in Recording(place / f"{name}.rrd").entities if not e.startswith("/__properties")}
            banded = [metric.name for metric in METRICS if metric.band is not None]
            bands = {f"/plots/{plot}/{side}" for plot in banded for side in ("lower", "upper")}
            assert len(bands) == 10
            there = {e.removeprefix(f"/{name}") for e in entities if e.startswith(f"/{name}/")}
            assert there == (own if name == "a" else own - bands)
        moved = [chunk for chunk in chunks if chunk.entity_path == "/more/plots/n_eff/dfs" and not chunk.is_static]
        values = np.concatenate([chunk.to_record_batch().column("Scalars:scalars").flatten() for chunk in moved])
        _, expected = Recording(place / "more.rrd").series("/plots/n_eff/dfs")
        assert sorted(values.tolist()) == sorted(expected.tolist())
        assert {timeline for chunk in moved for timeline in chunk.timeline_names} == {"step", "sim_time", "stage"}
        with pytest.raises(RecordingError, match="was merged from several recordings"):
            Recording(written / "compare.rrd")

    def test_a_merged_branch_lies_beside_its_run(self, live, tmp_path):
        """Not below it, too; and curves say whose they are."""
        from rerun.chunk import RrdReader

        assert cli.entry(["compare", str(live), f"{live}#six-particles", "--out", str(tmp_path)]) == 0
        chunks = RrdReader(tmp_path / "compare.rrd").store().stream().to_chunks()
        entities = {chunk.entity_path for chunk in chunks}
        assert {e.split("/")[1] for e in entities} == {"live", "live-six-particles", "comparison", "__properties"}
        assert not [e for e in entities if "branch" in e]
        for name in ("live", "live-six-particles"):
            look = [c for c in chunks if c.entity_path == f"/{name}/plots/n_eff/dfs" and c.is_static]
            named = [batch.column("SeriesLines:names").to_pylist() for batch in (c.to_record_batch() for c in look)]
            assert named == [[[f"Dual FastSLAM, {name.replace('live-', 'live#')}"]]]

    def test_side_by_side(self, written):
        viewer = required_viewer(written / "compare.rrd")
        try:
            viewer.seek("step", STEPS)
            views, front = viewer.views(), viewer.in_front()
            maps = {view.origin for view in views if view.view_id in front and view.view_class == "3D"}
            assert maps == {"/a/world", "/more/world"}
            assert "Comparison" in {view.name for view in views if view.view_id in front}
            assert not {view.name: view.reports for view in views if view.reports}
            n_eff = next(view for view in views if view.name.startswith("N_eff"))
            seen = {tuple(rgb) for rgb in np.unique(pixels(viewer.screenshot(n_eff)).reshape(-1, 3), axis=0)}
            for rank in (0, 1):
                shade = np.array(colours.of_run(colours.of_filter("dfs"), rank, on_dark=True))
                assert min(np.abs(shade - rgb).max() for rgb in seen) < 40, rank
            assert viewer.complaints() == []
        finally:
            viewer.__exit__()


@pytest.mark.parametrize("on_dark", [True, False])
@pytest.mark.parametrize("key", colours.FILTERS)
def test_shades_are_told_apart(key, on_dark):
    """Neighbours by their brightness, which everybody sees."""
    shades = [colours.of_run(colours.of_filter(key), rank, on_dark) for rank in range(8)]
    light = np.array(shades) @ (0.299, 0.587, 0.114)
    assert np.abs(np.diff(light)).min() > 20.0


def test_as_dict_has_no_numpy(found):
    from app.compare.output import Told

    json.dumps(as_dict(found, Told([], [""]), "", []), allow_nan=False)


def test_a_filter_without_a_common_step_is_said_to_be_missing(tmp_path):
    for name in "ab":
        record(tmp_path / f"{name}.rrd", ["dfs", "fs1"])
    a, b = read_runs([str(tmp_path / f"{name}.rrd") for name in "ab"])
    said = "FastSLAM 1.0 was on at no step that all of them have: it is not compared"
    assert said not in sentences(compare([a, b]))
    later = b.filters["fs1"]._replace(steps=b.filters["fs1"].steps + 100)
    found = compare([a, b._replace(filters={**b.filters, "fs1": later})])
    assert [one.key for one in found.filters] == ["dfs"]
    assert said in sentences(found)
