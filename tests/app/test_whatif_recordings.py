"""`dualslam whatif` of recordings that are not of one right run from its first step to its last: lessons, mistakes,
relations, damage; and the recordings that it writes itself."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest

from app import session
from app.compare.numbers import compare
from app.compare.output import Told, as_dict
from app.compare.runs import read_run, read_runs
from app.diagnosis.reading import read_cases
from app.live.engine import Engine
from app.recording import Recorder
from app.recording.charts import WIDTH
from app.recording.lesson import LessonRecorder
from app.recording.reading import Recording
from app.recording.session import SessionWriter
from app.recording.stream import FileStream
from app.run import session_of_command
from app.session import Change
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from tests.app.asking import SEED, asked, record, refused, whatif
from tests.app.live import at, change

STEPS, FROM = 12, 5

run = partial(record, filters=("dfs", "fs2"), steps=STEPS)


@pytest.fixture(scope="module")
def lesson(tmp_path_factory):
    """Its first run, one with a mistake, one of another world with other filters, and one that is longer."""
    path = tmp_path_factory.mktemp("lesson") / "lesson.rrd"
    recorder = LessonRecorder(path, "# A lesson")
    runs = {
        "right": "--filters fs2 fs1 --steps 12",
        "wrong": "--filters fs2 --steps 12 --mistake shared-maps",
        "elsewhere": "--layout two-far --filters dfs --steps 12 --seed 4",
        "longer": "--filters fs2 --steps 15",
    }
    for name, options in runs.items():
        recorder.next(name)
        session.run(session_of_command(f"dualslam run paper-line --particles 12 --seed {SEED} {options}"), [recorder])
    recorder.close("# A lesson")
    return path


class TestLessons:
    """Every run has its own world, filters, seed, steps and mistake, and nothing of another one."""

    @pytest.mark.parametrize(
        ("name", "filters", "steps"),
        [("", ["fs2", "fs1"], 12), ("wrong", ["fs2"], 12), ("elsewhere", ["dfs"], 12), ("longer", ["fs2"], 15)],
    )
    def test_unchanged_it_is_the_run_that_was_recorded(self, lesson, tmp_path, name, filters, steps):
        found = asked(f"{lesson}#{name}" if name else lesson, tmp_path, "--from", FROM, "--set", "temper=0.5")
        mistake = [warning for warning in found["warnings"] if "--mistake shared-maps" in warning]
        assert found["warnings"] == mistake
        assert len(mistake) == (name == "wrong")
        recorded = read_run(lesson, name, "run")
        assert list(found["filters"]) == list(recorded.filters) == filters
        assert (found["to"], found["seed"]) == (steps, recorded.told["seed"])
        for key, one in found["filters"].items():
            series, was = one["unchanged"]["series"], recorded.filters[key].at(np.arange(FROM, steps + 1))
            for number in ("n_eff", "position_error_m", "map_error_m", "features"):
                assert series[number] == was[number].tolist()

    def test_from_its_first_step(self, lesson, tmp_path):
        found = asked(f"{lesson}#elsewhere", tmp_path, "--from", 1, "--set", "particles=20")
        assert found["warnings"] == []
        assert found["set"] == {"particles": [12, 20]}

    def test_its_recording_is_of_that_run(self, lesson, tmp_path):
        both = tmp_path / "both.rrd"
        asked(f"{lesson}#elsewhere", tmp_path, "--from", FROM, "--set", "temper=0.5", "--record", both)
        told, was = Recording(both).params(), Recording(lesson).params("elsewhere")
        assert told == {name: value for name, value in was.items() if name != "parent"}

    def test_a_diagnosis_is_of_that_run_alone(self, lesson):
        for name, filters, steps in (("wrong", ["fs2"], 12), ("elsewhere", ["dfs"], 12), ("longer", ["fs2"], 15)):
            read = read_cases(lesson, name)
            assert read.heading.startswith(f"paper-line, seed {4 if name == 'elsewhere' else SEED}, step {steps} of")
            assert read.warnings == []
            assert [case.key for case in read.cases] == filters
            (case,) = read.cases
            assert case.record.steps.tolist() == list(range(1, steps + 1))
            n_eff = read_run(lesson, name, "run").filters[case.key].series["n_eff"]
            assert case.record["n_eff"].tolist() == n_eff.tolist()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return run(tmp_path_factory.mktemp("recorded") / "run.rrd")


class TestFurther:
    def test_a_recording_that_goes_further_says_so(self, recorded, tmp_path):
        both = tmp_path / "both.rrd"
        asked(recorded, tmp_path, "--from", FROM, "--set", "particles=20", "--steps", 30, "--record", both)
        recording = Recording(both)
        (branch,) = recording.branches()
        for name in ("", branch):
            assert recording.params(name)["steps"] == 30
            read = read_cases(both, name)
            assert "step 30 of 30" in read.heading
            assert read.warnings == []
            root = f"/branch/{branch}" if name else ""
            pictures = recording.rows(f"{root}/genealogy/dfs", "LineStrips2D:strips", "step")
            assert pictures
            ends = [max(x for line in lines for x, _ in line) for _, lines in pictures if lines]
            assert max(ends) <= WIDTH * (1 + 1e-6), "beyond the frame"


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    """A recording of which from step 4 on the numbers are others, for a reason that it does not tell."""
    path = tmp_path_factory.mktemp("odd") / "odd.rrd"
    recorder = Recorder(path)
    info = session_of_command("dualslam run paper-line --filters dfs --steps 12 --particles 12")
    recorder.begin(info)
    for step in session.steps(info, [Change(4, dataclasses.replace(info.params, temper=0.5))]):
        recorder.step(dataclasses.replace(step, changes=()))
    recorder.end()
    return path


class TestRefused:
    """Found out only on the way: the file that was asked for is as if nothing had been."""

    def test_no_recording_is_left_or_announced(self, odd, tmp_path, capsys):
        out = tmp_path / "both.rrd"
        line = refused(capsys, odd, "--from", FROM, "--set", "temper=0.5", "--record", out)
        assert "cannot be run again: at step 4" in line
        assert list(tmp_path.iterdir()) == []

    def test_one_that_was_there_is_there_again(self, odd, recorded, tmp_path, capsys):
        out, link = tmp_path / "both.rrd", tmp_path / "link.rrd"
        out.write_bytes(recorded.read_bytes())
        link.symlink_to(out)
        refused(capsys, odd, "--from", FROM, "--set", "temper=0.5", "--record", link)
        assert out.read_bytes() == recorded.read_bytes()
        assert link.is_symlink()
        assert sorted(tmp_path.iterdir()) == [out, link]

    def test_one_that_was_there_is_replaced_by_an_answer(self, recorded, tmp_path):
        out = tmp_path / "both.rrd"
        out.write_bytes(recorded.read_bytes())
        assert whatif(recorded, "--from", FROM, "--set", "temper=0.5", "--record", out) == 0
        assert list(tmp_path.iterdir()) == [out]
        assert Recording(out).branches()

    def test_one_that_another_program_writes_is_left_to_it(self, recorded, tmp_path, capsys):
        other = Recorder(tmp_path / "both.rrd")
        other.begin(session_of_command("dualslam run paper-line --filters dfs --steps 1"))
        refused(capsys, recorded, "--from", FROM, "--set", "temper=0.5", "--record", other.path)
        other.end()
        assert not Recording(other.path).damaged
        assert list(tmp_path.iterdir()) == [other.path]


class TestMistakes:
    """A run that was wrong on purpose is told of as such."""

    @pytest.fixture(scope="class")
    @classmethod
    def wrong(cls, tmp_path_factory):
        path = tmp_path_factory.mktemp("wrong") / "wrong.rrd"
        return run(path, "--mistake", "resample-always", filters=("dfs", "fs2"))

    def test_titles_and_a_key(self, wrong, recorded, tmp_path, capsys):
        capsys.readouterr()
        found = asked(wrong, tmp_path, "--from", FROM, "--set", "particles=20", "--seeds", 1)
        said = capsys.readouterr()
        assert found["mistake"] == "resample-always"
        assert f"{wrong} was made with --mistake resample-always, and so are both ways" in found["warnings"]
        for key, title in (("dfs", "Dual FastSLAM"), ("fs2", "FastSLAM 2.0")):
            assert found["filters"][key]["title"] == f"{title} (resample-always)"
            lines = [line for line in said.out.splitlines() if line.startswith(f"{title} (resample-always)")]
            assert len(lines) == 3  # a sentence, a table, and one over other random numbers
        assert asked(recorded, tmp_path, "--from", FROM, "--set", "particles=20")["mistake"] is None

    def test_comparisons(self, wrong, recorded):
        found = compare(read_runs([str(recorded), str(wrong)]))
        told = as_dict(found, Told([], []), "dualslam compare", [])
        assert [one["mistake"] for one in told["runs"]] == [None, "resample-always"]


def test_relations_that_are_not_judged_by(drive, tmp_path):
    options = ("--keyframe", "0.5,10", "--relations", drive.relations)
    path = run(tmp_path / "drive.rrd", *options, world=drive.log, filters=("dfs",))
    both, question = tmp_path / "both.rrd", ("--from", FROM, "--set", "particles=20")
    found = asked(path, tmp_path, *question, "--record", both)
    assert found["warnings"] == [f"{path} was judged with --relations, and neither way is judged by them here"]
    assert not [entity for entity in Recording(both).entities if entity.endswith("relations")]
    (branch,) = Recording(both).branches()
    assert asked(f"{both}#{branch}", tmp_path, *question[:2], "--set", "temper=0.5")["warnings"] == []


class TestTheEnd:
    def test_of_a_damaged_file_is_the_last_step_that_is_all_there(self, recorded, tmp_path, capsys, monkeypatch):
        class Cut(Recording):
            """The end of some series is lost."""

            def __init__(self, path):
                super().__init__(path)
                self.damaged = True

            def series(self, entity, timeline="step"):
                steps, values = super().series(entity, timeline)
                end = {"/plots/features/fs2": 9, "/plots/update_ms/dfs": 10}.get(entity, STEPS)
                return steps[steps <= end], values[steps <= end]

        monkeypatch.setattr("app.whatif.origin.Recording", Cut)
        monkeypatch.setattr("app.compare.runs.Recording", Cut)
        found = asked(recorded, tmp_path, "--from", FROM, "--set", "temper=0.5")
        assert found["warnings"] == [f"{recorded} is damaged: it is read as far as that goes, to step 9"]
        assert found["to"] == 9 == min(numbers.steps[-1] for numbers in read_run(recorded, "", "x").filters.values())
        line = refused(capsys, recorded, "--from", 10, "--set", "temper=0.5")
        assert f"--from is 10; {recorded} is damaged, and only has steps 1 to 9" in line

    @pytest.mark.parametrize("branch", ["", "other"])
    def test_of_a_live_session_is_that_of_the_filters_that_are_on(self, tmp_path, branch):
        path, source = tmp_path / "live.rrd", build("paper-line")
        filters, params = [ESTIMATORS[key] for key in ("dfs", "fs2")], source.params(particles=12)
        info = session.make_info(source, filters, params, seed=SEED, command="dualslam live")
        engine = Engine(info, [SessionWriter(partial(FileStream, path))])
        engine.start()
        engine.step(6)
        at(engine, 6)
        if branch:
            engine.go(5)
            at(engine, 5)
        change(engine, filters=("fs2",))
        if branch:
            engine.fork("Other")
        engine.step(4)
        last = at(engine, 9 if branch else 10, "Other" if branch else None).step
        engine.close()
        found = asked(f"{path}#{branch}" if branch else path, tmp_path, "--from", FROM, "--set", "temper=0.5")
        assert found["to"] == last
        assert list(found["filters"]) == ["dfs", "fs2"]
        assert found["warnings"] == []
