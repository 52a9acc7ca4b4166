"""`dualslam whatif`: both ways are the session's own, what is told of them is true, and what cannot be is refused."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from functools import partial

import numpy as np
import pytest

from app import cli, session
from app.compare.runs import read_run
from app.live.engine import Engine
from app.recording import Recorder
from app.recording.metrics import METRICS
from app.recording.reading import Recording
from app.recording.session import SessionWriter
from app.recording.stream import FLUSH_EVERY, FileStream
from app.rows import NEES, ROWS
from app.session import WORLD, Change, stream
from app.whatif import origin
from app.whatif.fork import Plan, made
from app.whatif.numbers import Spread, _value
from app.whatif.origin import Departure, read_origin
from app.whatif.settings import read_settings
from app.whatif.words import _fate, _of_spread
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from tests.app.asking import SEED, asked, record, refused, whatif
from tests.app.live import at, change
from tests.app.viewer import required_viewer

STEPS, FROM = 16, 7
KEYS = ("dfs", "fs2", "ekf")

run = partial(record, filters=KEYS, steps=STEPS)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("whatif")


@pytest.fixture(scope="module")
def recorded(place):
    return run(place / "run.rrd", "--association", "known")


@pytest.fixture(scope="module")
def answer(recorded, place):
    """What if with more particles and a larger R; recorded, and with other random numbers."""
    out, numbers = place / "both.rrd", place / "both.json"
    settings = ("particles=30", "inflate-r=4")
    assert (
        whatif(recorded, "--from", FROM, "--set", *settings, "--record", out, "--summary", numbers, "--seeds", 6) == 0
    )
    return out, json.loads(numbers.read_text())


@pytest.fixture(scope="module")
def by_hand():
    """The same by `app.session`: steps unchanged, and with the parameters changed from the step on."""
    source = build("paper-line")
    params = source.params(particles=12, association="known")
    info = session.make_info(source, [ESTIMATORS[key] for key in KEYS], params, seed=SEED, count=STEPS)
    other = dataclasses.replace(params, particles=30, inflate_r=4.0)
    return list(session.steps(info)), list(session.steps(info, [Change(FROM, other)]))


def same(values, expected) -> bool:
    return np.array_equal(np.array(values, float), np.array(expected, float), equal_nan=True)


class TestBothWays:
    def test_unchanged_it_is_what_was_recorded_bit_for_bit(self, recorded, answer):
        run, found = read_run(recorded, "", "run"), answer[1]
        assert found["warnings"] == []
        assert (found["from"], found["to"], found["complete"], found["seed"]) == (FROM, STEPS, True, SEED)
        for key in KEYS:
            one = found["filters"][key]
            assert one["step"] == list(range(FROM, STEPS + 1))
            mine = run.filters[key].at(np.arange(FROM, STEPS + 1))
            for name in set(mine) - {"seconds"}:
                theirs = np.where(np.isfinite(mine[name]), mine[name], np.nan)
                values = np.array(one["unchanged"]["series"][name], float)
                if name == "heading_error_rad":  # recorded in degrees
                    np.testing.assert_allclose(values, theirs, rtol=1e-15)
                else:
                    assert same(values, theirs), name

    def test_changed_it_is_the_session_with_that_change(self, answer, by_hand):
        for key in KEYS:
            one = answer[1]["filters"][key]
            for way, steps in zip(("unchanged", "changed"), by_hand, strict=True):
                measures = [step.filters[key].measures for step in steps[FROM - 1 :]]
                series = one[way]["series"]
                assert same(series["position_error_m"], [m.position_error_m for m in measures])
                assert same(series["n_eff"], [m.n_eff for m in measures])
                assert same(series["diversity"], [m.diversity for m in measures])
                assert same(series["map_error_m"], [m.map_error_m for m in measures])
                update = steps[-1].filters[key]
                assert series["ancestors"][-1] == update.genealogy.distinct_ancestors()[STEPS - FROM]
            K = 1 if key == "ekf" else 30
            assert one["changed"]["particles"] == one["changed"]["series"]["ancestors"][0] == K
            assert one["differs_from_step"] == FROM  # EKF-SLAM has no particles, but an R
            for row in ROWS:
                numbers = [one[way]["numbers"][row.key] for way in ("unchanged", "changed")]
                if None not in numbers:
                    assert one["differences"][row.key] == numbers[1] - numbers[0]

    def test_one_recording_has_both(self, recorded, answer, by_hand):
        before, both = Recording(recorded), Recording(answer[0])
        (branch,) = both.branches()
        assert branch == f"{FROM}-particles-30-inflate-r-4"
        assert both.params(branch)["parent"] == ""
        assert both.params(branch)["params"]["inflate_r"] == 4.0
        assert both.params() == before.params()
        for key in KEYS:
            for metric in METRICS:
                if metric.name == "update_ms":
                    continue
                entity = f"/plots/{metric.name}/{key}"
                assert same(both.series(entity)[1], before.series(entity)[1])
                steps, values = both.series(f"/branch/{branch}{entity}")
                assert steps.tolist() == list(range(FROM, STEPS + 1))
                assert same(values, [metric.value(step.filters[key]) for step in by_hand[1][FROM - 1 :]])
        changed = [event for event in both.events(f"/branch/{branch}/events") if "changed" in event.text]
        assert [(event.step, event.text) for event in changed] == [
            (FROM, f"{FROM}: Parameter changed: particles: 12 -> 30"),
            (FROM, f"{FROM}: Parameter changed: inflate_r: 1.0 -> 4.0"),
        ]

    def test_a_branch_can_be_asked_again(self, answer, by_hand, place):
        out, (branch,) = answer[0], Recording(answer[0]).branches()
        found = asked(f"{out}#{branch}", place, "--from", FROM + 4, "--set", "temper=0.5")
        assert found["branch"] == branch
        assert found["set"] == {"temper": [1.0, 0.5]}
        assert found["warnings"] == []
        errors = [step.filters["fs2"].measures.position_error_m for step in by_hand[1][FROM + 3 :]]
        assert same(found["filters"]["fs2"]["unchanged"]["series"]["position_error_m"], errors)

    def test_both_are_drawn_side_by_side(self, answer):
        viewer = required_viewer(answer[0])
        try:
            viewer.seek("step", STEPS)
            views, front = viewer.views(), viewer.in_front()
            maps = {view.origin for view in views if view.view_id in front and view.origin.endswith("world")}
            assert maps == {"/world", f"/branch/{FROM}-particles-30-inflate-r-4/world"}
            assert viewer.complaints() == []
        finally:
            viewer.__exit__()


class TestLuck:
    def test_other_random_numbers_are_for_filters_alone_and_from_the_fork_on(self, recorded):
        plan = Plan(read_origin(recorded, "", None), FROM, STEPS, {"particles": 30}, seeds=2)
        steps = list(made(plan))
        assert len(steps) == plan.work
        at_end = {(one.changed, one.draw): one.step for one in steps if one.step.index == STEPS}
        own = at_end[False, 0]
        for one in at_end.values():
            assert same(one.frame.z, own.frame.z)
            assert same(one.odometry, own.odometry)
        for key in ("dfs", "fs2"):
            errors = {at_end[way].filters[key].measures.position_error_m for way in at_end}
            assert len(errors) == len(at_end) == 6
        assert {one.step.index for one in steps if one.draw} == set(range(FROM, STEPS + 1))
        same_run = [at_end[way].filters["ekf"].measures.position_error_m for way in at_end]
        assert len(set(same_run)) == 1  # it draws nothing

    def test_streams_are_named(self):
        own, again, other = (stream(5, "dfs", 9, draw).random(4) for draw in (0, 1, 2))
        assert same(own, np.random.default_rng(np.random.SeedSequence(5, spawn_key=(9, *b"dfs"))).random(4))
        assert len({tuple(numbers) for numbers in (own, again, other, stream(5, WORLD, 9, 1).random(4))}) == 4

    def test_medians_ranges_and_who_is_lower(self, answer):
        found = answer[1]
        assert found["seeds"] == 6
        for key in KEYS:
            for name, one in found["filters"][key]["seeds"].items():
                a, b = (np.array(one["values"][way], float) for way in ("unchanged", "changed"))
                assert len(a) == len(b) == 6
                if None in one["values"]["unchanged"]:
                    continue
                assert one["changed"] == {"median": np.median(b), "least": b.min(), "most": b.max()}, name
                assert (one["lower"], one["higher"]) == (np.sum(b < a), np.sum(b > a))
        # the run's own random numbers are not among them: they were chosen for what they did
        own = found["filters"]["fs2"]["unchanged"]["numbers"]["position_error_rms_m"]
        assert own not in found["filters"]["fs2"]["seeds"]["position_error_rms_m"]["values"]["unchanged"]

    def test_sign_test(self):
        row = ROWS[0]
        spread = Spread(row, np.arange(10.0), np.arange(10.0) - 1.0)
        assert (spread.lower, spread.higher, spread.luck) == (10, 0, 2 / 1024)
        even = Spread(row, np.zeros(4), np.array([-1.0, 1.0, -1.0, 1.0]))
        assert even.luck == 1.0
        assert math.isnan(Spread(row, np.zeros(3), np.ones(3)).luck)  # copies of one comparison are no sample

    def test_copies_of_one_comparison_are_told_as_such(self):
        row = next(row for row in ROWS if row.key == "position_error_rms_m")
        spread = Spread(row, np.full(20, 0.2), np.full(20, 0.1))
        assert (
            _of_spread(spread, 20) == "position error (RMS) 0.1 m instead of 0.2 m with all of them: no luck is in it"
        )
        assert _fate(spread, 0.2, 20) == ""
        assert "3 of 20 do better" in _fate(spread._replace(unchanged=np.repeat([0.1, 0.3], [3, 17])), 0.2, 20)

    def test_an_infinite_nees_is_in_no_mean(self):
        row = next(row for row in ROWS if row.key == NEES)
        assert _value(row, {"nees": np.array([1.0, np.inf, 2.0])}) == math.inf
        assert _value(row, {"nees": np.array([1.0, np.nan, 2.0])}) == 1.5
        most = Spread(row, np.zeros(6), np.array([-1.0, -1.0, -1.0, -1.0, -1.0, 1.0]))
        assert most.luck == pytest.approx(2 * 7 / 64)


class TestWords:
    def test_what_changes_nothing_is_said_to(self, recorded, place, capsys):
        found = asked(recorded, place, "--from", FROM, "--set", "weighting=joint", "gate_new=0.9")
        said = capsys.readouterr().out
        for key in ("fs2", "ekf"):
            one = found["filters"][key]
            assert one["differs_from_step"] is None
            assert one["unchanged"]["series"]["nees"] == one["changed"]["series"]["nees"]
            assert f"{one['title']}: every number is that of the unchanged run" in said
        assert "Dual FastSLAM: position error (RMS)" in said
        assert "weighting joint instead of marginal, gate_new 0.9 instead of 0.999999" in said

    def test_numbers_in_sentences_are_those_of_the_table(self, answer):
        numbers = [answer[1]["filters"]["fs2"][way]["numbers"] for way in ("changed", "unchanged")]
        said = next(line for line in answer[1]["said"] if line.startswith("FastSLAM 2.0: position error"))
        errors = [f"{n['position_error_rms_m']:.3g} m" for n in numbers]
        assert said.startswith(f"FastSLAM 2.0: position error (RMS) {errors[0]} instead of {errors[1]}; ")
        counts = [f"{n['ancestors_end']:.0f}" for n in numbers]
        assert f"distinct ancestors left {counts[0]} instead of {counts[1]}" in said

    def test_settings_as_they_are_typed(self):
        typed = ["believed.bearing=0.5", "floor-angle=1", "merge-walls=on", "--resample-below=0", "association=jcbb"]
        found = {setting.name: setting.value for setting in read_settings(typed)}
        assert found == {
            "believed.bearing": math.radians(0.5),
            "floor_angle": math.radians(1.0),
            "merge_walls": True,
            "resample_below": 0.0,
            "association": "jcbb",
        }


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--from", 5), ("--set particles=500",)),
        (("--set", "gate=0.5"), ("--from STEP",)),
        (("--from", 0, "--set", "gate=0.5"), ("--from is 0", "at least 1")),
        (("--from", STEPS + 1, "--set", "gate=0.5"), (f"--from is {STEPS + 1}", f"steps 1 to {STEPS}")),
        (("--from", 5, "--set", "gate=0.5", "--steps", 4), ("--from is 5", "--steps 4", "no step is left")),
        (("--from", 5, "--set", "gate=0.5", "--steps", 999), ("--steps is 999", "paper-line has")),
        (("--from", 5, "--set", "particle=3"), ("'particle'", "did you mean particles?", "inflate_r")),
        (("--from", 5, "--set", "believed.rang=3"), ("did you mean believed.range?",)),
        (("--from", 5, "--set", "particles"), ("--set is 'particles'", "NAME=VALUE")),
        (("--from", 5, "--set", "particles=2.5"), ("--set particles is '2.5'", "a whole number between 1 and")),
        (("--from", 5, "--set", "gate=1"), ("--set gate is 1", "both excluded")),
        (("--from", 5, "--set", "association=neares"), ("--set association", "did you mean nearest?")),
        (("--from", 5, "--set", "merge-walls=yes"), ("merge_walls is 'yes'", "expected on or off")),
        (("--from", 5, "--set", "gate=0.5", "--set", "gate=0.6"), ("gate twice",)),
        (("--from", 5, "--set", "most_new=2"), ("--set most_new does not apply to paper-line", "walls")),
        (("--from", 5, "--set", "noise.missing=0"), ("--set noise.missing does not apply", "one of noise.speed")),
        (("--from", 5, "--set", "believed.odometry=1"), ("--set believed.odometry does not apply",)),
        (("--from", 5, "--set", "believed.range=0"), ("--set believed.range is 0", "0 excluded")),
        (("--from", 5, "--set", "particles=12"), ("--set particles=12", "already", "nothing would change")),
        (("--from", 5, "--set", "gate=0.5", "--layout", "sparse"), ("unknown option --layout",)),
        (("--from", 5, "--set", "gate=0.5", "--record", "x.txt"), ("--record x.txt", ".rrd")),
        (("--from", 5, "--set", "gate=0.5", "--seeds", -1), ("--seeds is -1",)),
    ],
)
def test_refused_in_one_sentence(recorded, capsys, arguments, parts):
    line = refused(capsys, recorded, *arguments)
    for part in parts:
        assert part in line


def test_settings_of_filters_that_are_not_there(place, capsys):
    path = run(place / "ekf.rrd", steps=3, filters=("ekf",))
    assert "it is for dfs, and the recording has ekf" in refused(capsys, path, "--from", 2, "--set", "weighting=joint")
    assert "it is for dfs, fs2 or fs1" in refused(capsys, path, "--from", 2, "--set", "particles=3")


def test_refused_files(recorded, place, capsys):
    question = ("--from", 2, "--set", "gate=0.5")
    assert "missing.rrd cannot be read" in refused(capsys, place / "missing.rrd", *question)
    assert "no branch 'x'; it has none" in refused(capsys, f"{recorded}#x", *question)
    assert "is the input itself" in refused(capsys, recorded, *question, "--record", recorded)
    (place / "text.rrd").write_text("no recording")
    assert "is no Rerun recording" in refused(capsys, place / "text.rrd", *question)


def test_what_holds_already_is_left_out(recorded, place):
    found = asked(recorded, place, "--from", 5, "--set", "particles=12", "temper=0.5")
    assert found["set"] == {"temper": [1.0, 0.5]}
    assert found["warnings"] == ["--set particles=12 is what holds at step 5 already"]


def test_a_damaged_recording_goes_as_far_as_it_can_be_read(tmp_path):
    whole, cut, middle = tmp_path / "whole.rrd", tmp_path / "cut.rrd", 5
    source = build("paper-line")
    params = source.params(particles=12, association="known")
    info = session.make_info(source, [ESTIMATORS["dfs"]], params, seed=SEED, count=STEPS)
    recorder, size = Recorder(whole), 0
    recorder.begin(info)
    for step in session.steps(info):
        recorder.step(step)
        if step.index == middle:
            time.sleep(3 * FLUSH_EVERY)
            size = whole.stat().st_size
    recorder.end()
    for more in range(12_000, 12_300, 100):  # a cut that happens to fall between two chunks is no damage
        cut.write_bytes(whole.read_bytes()[: size + more])
        if Recording(cut).damaged:
            break
    last = int(read_run(cut, "", "cut").steps[-1])
    assert middle <= last < STEPS
    found = asked(cut, tmp_path, "--from", 3, "--set", "temper=0.5")
    assert found["to"] == last
    assert found["warnings"] == [f"{cut} is damaged: it is read as far as that goes, to step {last}"]
    further = asked(cut, tmp_path, "--from", 3, "--set", "temper=0.5", "--steps", STEPS)
    assert (further["to"], further["complete"]) == (STEPS, True)
    errors = [step.filters["dfs"].measures.position_error_m for step in session.steps(info)]
    assert same(further["filters"]["dfs"]["unchanged"]["series"]["position_error_m"], errors[2:])


@pytest.fixture(scope="module")
def odd(place):
    """A recording of which from step 9 on the numbers are others, for a reason that it does not tell."""
    source = build("paper-line")
    params = source.params(particles=12)
    info = session.make_info(source, [ESTIMATORS["dfs"]], params, seed=SEED, count=STEPS)
    recorder = Recorder(place / "odd.rrd")
    recorder.begin(info)
    for step in session.steps(info, [Change(9, dataclasses.replace(params, temper=0.5))]):
        recorder.step(dataclasses.replace(step, changes=()))
    recorder.end()
    return place / "odd.rrd"


class TestAnotherRun:
    """What was recorded is not what is made of it here."""

    def test_before_the_fork_it_stops_and_says_where(self, odd, capsys):
        line = refused(capsys, odd, "--from", 12, "--set", "particles=20")
        assert "odd.rrd cannot be run again: at step 9 it departs from what was recorded" in line
        assert "of Dual FastSLAM is " in line
        assert "processor" in line

    def test_after_it_both_are_told_of_as_they_are_here(self, odd, place):
        found = asked(odd, place, "--from", 8, "--set", "particles=20")
        (warning,) = found["warnings"]
        assert warning.startswith("at step 9 it departs from what was recorded")
        assert found["complete"]

    def test_last_bits_are_no_departure(self, recorded, place, monkeypatch):
        value = METRICS[0].value
        near = METRICS[0]._replace(value=lambda update: value(update) * (1 + 1e-14))
        monkeypatch.setitem(origin._METRICS, "n_eff", near)
        found = asked(recorded, place, "--from", 8, "--set", "temper=0.5")
        (warning,) = found["warnings"]
        assert warning.startswith("only the last bits differ from those recorded, but they do: at step 1")
        assert not Departure(1, "x", 1.0, math.nan).small
        assert not Departure(1, "x", math.inf, 1.0).small
        assert not Departure(1, "x", 100.0, 100.001).small

    def test_other_versions_are_named(self, odd):
        found, departure = read_origin(odd, "", None), Departure(9, "x", 1.0, 2.0)
        old = found._replace(versions={**found.versions, "numpy": "1.0.0"})
        assert "it was made with numpy 1.0.0 (here " in old.apart(departure)
        assert "it was made with" not in found.apart(departure)


class TestFiles:
    def test_world_files_by_path(self, tmp_path, capsys, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert cli.entry(["worlds", "paper-line", "--write", "mine.toml"]) == 0
        path, question = run(tmp_path / "run.rrd", world="mine.toml"), ("--from", 5, "--set", "temper=0.5")
        assert asked(path, tmp_path, *question)["warnings"] == []
        monkeypatch.chdir(tmp_path.parent)
        assert asked(path, tmp_path, *question)["warnings"] == []  # found beside the recording
        text = (tmp_path / "mine.toml").read_text()
        (tmp_path / "mine.toml").rename(tmp_path / "moved.toml")
        line = refused(capsys, path, *question)
        assert "run.rrd was made of mine.toml, which is not there; expected --source" in line
        assert asked(path, tmp_path, *question, "--source", tmp_path / "moved.toml")["warnings"] == []
        (tmp_path / "mine.toml").write_text(text.replace("speed = 3.0", "speed = 2.9", 1))
        line = refused(capsys, path, *question)
        assert "at step 1 it departs" in line
        assert "of the robot is 0.6525 instead of 0.675; perhaps " in line
        assert line.endswith("mine.toml has changed since")
        (tmp_path / "mine.toml").write_text("nonsense")
        assert "was made of mine.toml, which cannot be read" in refused(capsys, path, *question)

    def test_a_log_of_a_laser(self, drive, tmp_path):
        path = run(tmp_path / "drive.rrd", "--keyframe", "0.5,10", world=drive.log, filters=("dfs",), steps=12)
        found = asked(path, tmp_path, "--from", 6, "--set", "particles=20", "--seeds", 1)
        run_ = read_run(path, "", "run")
        one = found["filters"]["dfs"]
        assert found["warnings"] == []
        assert same(one["unchanged"]["series"]["n_eff"], run_.filters["dfs"].series["n_eff"][5:])
        assert one["unchanged"]["numbers"]["position_error_end_m"] is None
        assert "position error" not in found["said"][1]

    def test_noise_is_no_setting_of_a_log(self, drive, tmp_path, capsys):
        path = run(tmp_path / "drive.rrd", world=drive.log, filters=("dfs",), steps=3)
        line = refused(capsys, path, "--from", 2, "--set", "noise.odometry=0.2")
        assert "--set noise.odometry does not apply" in line
        assert "a log has its noise already" in line


def test_a_live_session_with_changes_and_a_branch_of_a_branch(tmp_path):
    path = tmp_path / "live.rrd"
    source = build("paper-line")
    info = session.make_info(
        source, [ESTIMATORS["dfs"]], source.params(particles=12), seed=SEED, command="dualslam live"
    )
    engine = Engine(info, [SessionWriter(partial(FileStream, path))])
    engine.start()
    engine.step(4)
    at(engine, 4)
    change(engine, particles=9, noise__range=0.01, believed__bearing=0.0123456789)
    engine.step(3)
    at(engine, 7)
    change(engine, filters=("dfs", "fs2"))
    engine.step(3)
    at(engine, 10)
    engine.go(8)
    at(engine, 8)
    change(engine, particles=14)
    engine.fork("One")
    engine.step(3)
    at(engine, 11, "One")
    engine.go(10)
    at(engine, 10)
    change(engine, temper=0.5)
    engine.fork("Two")
    engine.step(4)
    at(engine, 14, "Two")
    engine.close()

    trunk = asked(path, tmp_path, "--from", 6, "--set", "inflate_r=4", "particles=20")
    assert trunk["warnings"] == []
    assert trunk["to"] == 10
    assert trunk["set"] == {"inflate_r": [1.0, 4.0], "particles": [9, 20]}
    assert trunk["filters"]["fs2"]["changed"]["particles"] == 20
    two = asked(f"{path}#two", tmp_path, "--from", 9, "--set", "inflate_r=4")
    assert two["warnings"] == []
    assert two["to"] == 14
    recording = Recording(path)
    n_eff = {name: recording.series(f"/branch/{name}/plots/n_eff/fs2")[1] for name in ("one", "two")}
    expected = [*n_eff["one"][:2], *n_eff["two"]]
    assert same(two["filters"]["fs2"]["unchanged"]["series"]["n_eff"], expected)
    assert recording.params("two")["parent"] == "one"


@pytest.mark.parametrize(("after", "steps"), [(FROM - 3, 0), (FROM + 6, 3)])
def test_an_interruption_saves_what_there_is(recorded, tmp_path, capsys, monkeypatch, after, steps):
    def interrupted(plan):
        for count, one in enumerate(made(plan)):
            if count == after:
                raise KeyboardInterrupt
            yield one

    monkeypatch.setattr("app.whatif.execution.made", interrupted)
    out, numbers = tmp_path / "both.rrd", tmp_path / "both.json"
    question = ("--from", FROM, "--set", "temper=0.5", "--seeds", 3)
    assert whatif(recorded, *question, "--record", out, "--summary", numbers) == 130
    assert f"interrupted after {steps} of {STEPS - FROM + 1} steps after the change" in capsys.readouterr().err
    assert not Recording(out).damaged
    assert numbers.exists() == (steps > 0)
    if steps:
        found = json.loads(numbers.read_text())
        assert (found["to"], found["complete"], found["seeds"]) == (FROM + steps - 1, False, 0)
