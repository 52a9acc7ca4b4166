"""The command line: what it refuses, in one sentence each, and what it understands."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from app import cli
from app import command as command_line
from app.options import FILTERS, BelievedNoise, FilterOptions, Outputs, WorldNoise, parameters
from app.report import COMPILING
from app.run import Run
from app.sources import all_world_options
from app.summary import without_timings
from scenarios.registry import build, worlds
from slam.types import Params

ROOT = Path(__file__).parent.parent.parent
RUN = ["run", "paper-line", "--steps", "3", "--particles", "5"]


def refused(capsys, *arguments) -> str:
    """The complaint of a command that must be refused, after checking that it is one line."""
    assert cli.entry([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("dualslam: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err.removeprefix("dualslam: ").rstrip("\n")


BAD = [
    (["rn"], ["unknown command 'rn'", "did you mean run?", "worlds, study"]),
    (["run"], ["needs a world or a log"]),
    (["run", "lop"], ["'lop'", "did you mean loop?", "rotation-then-corridor"]),
    (["run", "no/such/log"], ["no/such/log: no such file"]),
    (["run", "loop.toml"], ["loop.toml: no such file"]),
    (["run", "loop", "corridor"], ["unexpected argument 'corridor'"]),
    (["run", "loop", "--partcles", "5"], ["unknown option --partcles", "did you mean --particles?"]),
    (["run", "--partcles", "5", "loop"], ["unknown option --partcles", "did you mean --particles?"]),
    (["run", "loop", "--noise.sped=5"], ["unknown option --noise.sped", "did you mean --noise.speed?"]),
    (["run", "paper-line", "--vehicel", "ackermann"], ["unknown option --vehicel", "did you mean --vehicle?"]),
    (["run", "loop", "--particles"], ["--particles needs a value"]),
    (["run", "loop", "--particles", "--align"], ["--particles needs a value"]),
    (["run", "loop", "--particles", "many"], ["--particles is 'many'", "a whole number between 1 and 1000000"]),
    (["run", "loop", "--particles", "2.5"], ["--particles is '2.5'", "a whole number"]),
    (["run", "loop", "--particles", "0"], ["--particles is 0", "between 1 and 1000000"]),
    (["run", "loop", "--particles", "1000001"], ["--particles is 1000001"]),
    (["run", "loop", "--particles=-3"], ["--particles is -3"]),
    (["run", "loop", "--seed", "-1"], ["--seed is -1", "at least 0"]),
    (["run", "loop", "--steps", "0"], ["--steps is 0", "at least 1"]),
    (["run", "loop", "--gate", "1"], ["--gate is 1", "between 0 and 1, both excluded"]),
    (["run", "loop", "--gate", "nan"], ["--gate is nan"]),
    (["run", "loop", "--inflate-r", "0"], ["--inflate-r is 0", "between 0 and 1e+12, 0 excluded"]),
    (["run", "loop", "--inflate-r", "inf"], ["--inflate-r is inf", "a finite number"]),
    (["run", "loop", "--temper", "1.5"], ["--temper is 1.5", "between 0 and 1, 0 excluded"]),
    (["run", "loop", "--log-p-new", "-inf"], ["--log-p-new is -inf", "a finite number"]),
    (["run", "loop", "--resample-below", "2"], ["--resample-below is 2", "between 0 and 1"]),
    (["run", "loop", "--resampler", "sistematic"], ["did you mean systematic?", "stratified, residual or multinomial"]),
    (["run", "loop", "--association", "jcb"], ["--association is 'jcb'", "did you mean jcbb?", "known, nearest or"]),
    (["run", "loop", "--weighting", "x"], ["--weighting is 'x'; expected marginal or joint"]),
    (["run", "loop", "--preset", "bilding"], ["--preset is 'bilding'", "building"]),
    (["run", "loop", "--filters", "fs3"], ["--filters is 'fs3'", "dfs, fs2, fs1 or ekf"]),
    (["run", "loop", "--filters"], ["--filters needs at least one value"]),
    (["run", "loop", "--filters", "dfs", "dfs"], ["--filters names dfs twice"]),
    (["run", "loop", "--features", "wals"], ["--features is 'wals'", "did you mean walls?", "walls or landmarks"]),
    (["run", "hall", "--features", "walls"], ["--features does not apply to hall", "corridor, loop or rotation"]),
    (["run", "loop", "--doors", "shut"], ["--doors is 'shut'", "closed, open, rooms or none"]),
    (["run", "loop", "--beams", "0"], ["loop: --beams is 0", "at least 1"]),
    (["run", "loop", "--beams", "1e7"], ["--beams is '1e7'", "a whole number"]),
    (["run", "loop", "--beams", "10000000"], ["loop: --beams is 10000000; expected", "at least 1 and at most 100000"]),
    (["run", "loop", "--laps", "1e7"], ["loop: --laps is 10000000.0; expected a number above 0 and at most 1000"]),
    (["run", "hall", "--people", "10000000"], ["hall: --people is 10000000; expected", "at most 1000"]),
    (
        ["run", "rotation-then-corridor", "--turn-deg", "1e7"],
        [": --turn-deg is 10000000.0; expected a number at least -36000 and at most 36000 [degrees]"],
    ),
    *(
        (
            ["run", world, "--features", "landmarks", *option],
            [f"{option[0]} does not apply to {world} with", "for walls"],
        )
        for world, option in [
            ("loop", ("--beams", "361")),
            ("loop", ("--doors", "rooms")),
            ("loop", ("--recess", "0.5")),
            ("corridor", ("--far-end", "open")),
            ("rotation-then-corridor", ("--lobby-walls", "none")),
        ]
    ),
    (["worlds", "loop", "--doors", "closed", "--features", "landmarks"], ["--doors does not apply to loop with"]),
    (["run", "loop", "--features", "landmarks", "--floor-lateral", "1"], ["--floor-lateral does not apply to loop"]),
    (["run", "paper-line", "--floor-angle", "1"], ["--floor-angle does not apply to paper-line", "for walls"]),
    (["run", "field", "--filters", "ekf", "--orthogonal"], ["--orthogonal does not apply to field", "for walls"]),
    (["run", "field", "--merge-walls"], ["--merge-walls does not apply to field", "for walls"]),
    (["run", "field", "--most-new", "2"], ["--most-new does not apply to field", "for walls"]),
    (["run", "loop", "--most-new", "-1"], ["--most-new is -1", "between 0 and 1000000"]),
    (["run", "loop", "--merge-walls", "--filters", "ekf"], ["--merge-walls does not apply to EKF-SLAM", "dfs, fs2 or"]),
    (["run", "loop", "--orthogonal"], ["--orthogonal does not apply to these filters", "expected ekf in --filters"]),
    (["run", "loop", "--noise.range", "-0.1"], ["--noise.range is -0.1", "between 0 and 1000000"]),
    (["run", "field", "--noise.bearing", "0"], ["--noise.bearing is 0", "expected --believed.bearing"]),
    (["run", "loop", "--noise.range", "0"], ["--noise.range is 0", "expected --believed.range"]),
    (["run", "loop", "--noise.missing", "1.5"], ["--noise.missing is 1.5", "between 0 and 1"]),
    (["run", "loop", "--noise.speed", "1"], ["--noise.speed does not apply to loop", "--noise.odometry"]),
    (["run", "field", "--noise.odometry", "1"], ["--noise.odometry does not apply to field", "--noise.speed"]),
    (["run", "field", "--believed.odometry", "1"], ["--believed.odometry does not apply to field"]),
    (["run", "loop", "--believed.bearing", "1"], ["--believed.bearing does not apply to loop"]),
    (["run", "loop", "--believed.missing", "1"], ["unknown option --believed.missing"]),
    (["run", "loop", "--believed.range", "0"], ["--believed.range is 0", "0 excluded"]),
    (["run", "loop", "--vehicle", "ackermann"], ["--vehicle does not apply to loop", "paper-line"]),
    (["run", "paper-line", "--vehicle", "acerman"], ["--vehicle is 'acerman'", "did you mean ackermann?"]),
    (["run", "paper-line", "--vehicle"], ["--vehicle needs a value"]),
    (["run", "paper-line", "--max-range", "far"], ["--max-range is 'far'", "a number"]),
    (["run", "paper-line", "--max-range", "-5"], ["paper-line: --max-range is -5"]),
    (["run", "loop", "--robot", "3"], ["--robot does not apply to loop", "logs"]),
    (["run", "loop", "--from", "3"], ["--from does not apply to loop"]),
    (["run", "loop", "--summary", "/no/where.json"], ["/no/where.json cannot be written", "/no does not exist"]),
    (["run", "loop", "--record", "/no/where.rrd"], ["/no/where.rrd cannot be written"]),
    (["run", "loop", "--summary", "x", "--record", "x"], ["--record and --summary are both x"]),
    (["run", "loop", "--believed.range", "1e7"], ["--believed.range is 1e7", "1000000"]),
    (["run", "loop", "--noise.range", "inf"], ["--noise.range is inf", "a finite number"]),
    (["run", "field", "--layout-seed", "-1"], ["--layout-seed is -1"]),
    (["run", "loop", "--relations", "x"], ["--relations does not apply to loop", "logs of a laser"]),
    (["run", "loop", "--reference", "x"], ["--reference does not apply to loop: it is for logs"]),
    (["run", "loop", "--keyframe", "0,0"], ["--keyframe does not apply to loop: it is for logs"]),
    (["run", "loop", "--keyframe", "0.25"], ["--keyframe is '0.25'; expected two numbers, METRES,DEGREES"]),
    (["run", "loop", "--keyframe", "1,-8"], ["--keyframe is -8; expected a number between 0 and 1000000"]),
    (["run", "loop", "--matching", "x"], ["--matching is 'x'", "off, on or auto"]),
    (["run", "loop", "--summary", "\udcff.json"], ["--summary is '\\udcff.json'", "UTF-8"]),
    (["run", "\udcff"], ["'\\udcff'", "UTF-8"]),
    (["run", "loop", "--trajectory", "t", "--noise.range", "0"], ["--noise.range is 0"]),
    (["worlds", "loop", "--write", "x.txt"], ["--write is x.txt", "ends in .toml"]),
    (["worlds", "lop"], ["'lop'", "did you mean loop?"]),
    (["worlds", "loop", "corridor"], ["unexpected argument 'corridor'"]),
    (["worlds", "--write", "x.toml"], ["--write needs the NAME of a world"]),
    (["worlds", "loop", "--write", "/no/x.toml"], ["/no/x.toml cannot be written"]),
    (["worlds", "no.toml"], ["no.toml"]),
    (["study", "paper"], ["unknown study 'paper'", "did you mean paper-table?"]),
    (["study", "paper-table", "--run", "3"], ["unknown option --run", "did you mean --runs?"]),
    (["study", "paper-table", "--runs", "0"], ["--runs is 0"]),
    (["study", "paper-table", "--out", "/no/x.json"], ["/no/x.json cannot be written"]),
    (["study", "log-error"], ["needs a log or a world"]),
    (["study", "log-error", "lop"], ["did you mean loop?"]),
    (["study", "association", "--world", "lop"], ["--world is 'lop'", "did you mean loop?"]),
    (["study", "association", "--world", "hall"], ["--world is 'hall'", "loop"]),
]


@pytest.mark.parametrize(("arguments", "parts"), BAD, ids=[" ".join(arguments) for arguments, _ in BAD])
def test_refused_in_one_sentence(capsys, tmp_path, monkeypatch, arguments, parts):
    monkeypatch.chdir(tmp_path)
    complaint = refused(capsys, *arguments)
    for part in parts:
        assert part in complaint
    assert list(tmp_path.iterdir()) == []


def test_refused_files(capsys, tmp_path):
    empty, text, toml = tmp_path / "empty.log", tmp_path / "notes.txt", tmp_path / "world.toml"
    empty.touch()
    text.write_text("dear diary\n")
    toml.write_text("[route]\nspeed = -1\n")
    for path in (empty, text, toml, tmp_path):
        assert str(path) in refused(capsys, "run", path)
    assert "is a directory" in refused(capsys, *RUN, "--summary", tmp_path)
    assert "is a file" in refused(capsys, *RUN, "--trajectory", text)
    assert "is the input itself" in refused(capsys, "run", text, "--record", text)
    assert text.read_text() == "dear diary\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here to play a full disk")
def test_a_full_disk_is_one_sentence_and_the_rest_is_kept(capsys, tmp_path):
    assert cli.entry([*RUN, "--summary", "/dev/full", "--trajectory", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert "/dev/full: the disk is full" in err
    assert "Traceback" not in err
    assert (tmp_path / "dfs.tum").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here to play a full disk")
def test_only_outputs_that_ended_well_are_listed(capsys, tmp_path, monkeypatch):
    def lost(*_):
        raise OSError(errno.ENOSPC, "", "map.svg")

    monkeypatch.setattr("app.trajectory.Trajectory.end", lost)
    assert cli.entry([*RUN, "--summary", "/dev/full", "--trajectory", str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert "dualslam: /dev/full: the disk is full; map.svg: the disk is full\n" in err
    assert "position MSE" in out
    assert "summary:" not in out
    assert "paths and maps:" not in out


def test_help(capsys):
    for arguments in ([], ["--help"], ["run", "--help"], ["worlds", "-h"], ["study"], ["study", "paper-table", "-h"]):
        assert cli.entry(arguments) == 0
        out, err = capsys.readouterr()
        assert "usage: dualslam" in out
        assert err == ""
        assert "{None}" not in out
        assert "type: ignore" not in out


def test_help_of_a_world_shows_its_own_options(capsys):
    assert cli.entry(["run", "paper-line", "--help"]) == 0
    assert "--vehicle" in capsys.readouterr().out
    assert cli.entry(["run", "--help"]) == 0
    assert "--layout" not in capsys.readouterr().out


def test_options_of_worlds_do_not_hide_others():
    assert not all_world_options() & command_line.option_names(Run)


def test_every_parameter_is_an_option():
    options = {field.name for field in dataclasses.fields(FilterOptions)}
    assert {field.name for field in dataclasses.fields(Params)} - {"believed"} <= options


def test_fixed_names():
    """Scripts and lessons rely on these."""
    names = """filters particles seed steps association gate weighting inflate-r temper matching resampler
    resample-below preset robot from to every keyframe reference relations align record summary trajectory
    noise.speed noise.turn
    noise.range noise.bearing
    noise.odometry noise.missing believed.odometry believed.speed believed.turn believed.range believed.bearing"""
    assert {f"--{name}" for name in names.split()} <= command_line.option_names(Run)
    assert {"--vehicle", "--period", "--layout", "--features"} <= all_world_options()


def test_options_reach_the_parameters():
    line = """run paper-line --particles 7 --association nearest --gate 0.9 --weighting joint --inflate-r 4 --temper 0.5
    --log-p-new -2 --resampler residual --resample-below 0.5 --noise.range 0.1 --noise.turn 2 --believed.bearing 0.5
    --proposal-weight drawn --gate-known 0.8 --gate-new 0.7 --vehicle ackermann --filters ekf dfs"""
    command, own = command_line.parse(line.split())
    assert own == {"--vehicle": "ackermann"}
    assert command.filters == ("ekf", "dfs")
    noise, params = parameters(build("paper-line"), command.filter, command.noise, command.believed)
    assert (noise.range, noise.turn, noise.speed) == (0.1, math.radians(2), 0.3)
    expected = dataclasses.replace(noise, bearing=math.radians(0.5))
    assert params == Params(
        particles=7,
        believed=expected,
        association="nearest",
        gate=0.9,
        gate_known=0.8,
        gate_new=0.7,
        weighting="joint",
        proposal_weight="drawn",
        inflate_r=4.0,
        temper=0.5,
        log_p_new=-2.0,
        resampler="residual",
        resample_below=0.5,
    )
    line = """run loop --floor-lateral 0.01 --floor-angle 0.3 --merge-walls --most-new 2 --orthogonal --matching on
    --filters ekf dfs"""
    command, _ = command_line.parse(line.split())
    source = build("loop")
    _, params = parameters(source, command.filter, command.noise, command.believed)
    kept = {"merge_walls": True, "most_new": 2, "orthogonal": True, "matching": "on"}
    floors = {"floor_lateral": 0.01, "floor_angle": math.radians(0.3)}
    assert params == dataclasses.replace(source.params(), **floors, **kept)


def test_what_is_not_given_is_the_worlds_own():
    source = build("paper-line")
    assert parameters(source, FilterOptions(), WorldNoise(), BelievedNoise()) == (source.noise, source.params())


def test_a_preset_comes_between_the_source_and_what_is_given():
    source = dataclasses.replace(build("paper-line"), defaults={"temper": 0.1, "inflate_r": 9.0})
    _, params = parameters(source, FilterOptions(preset="paper", inflate_r=2.0), WorldNoise(), BelievedNoise())
    assert (params.temper, params.inflate_r) == (1.0, 2.0)
    of_landmarks = build("loop", features="landmarks")
    _, params = parameters(of_landmarks, FilterOptions(preset="building", gate=0.9), WorldNoise(), BelievedNoise())
    assert (params.temper, params.inflate_r, params.gate, params.gate_new) == (0.1, 9.0, 0.9, 0.99999999)


def test_the_world_may_stand_behind_the_filters():
    command, _ = command_line.parse(["run", "--filters", "dfs", "fs2", "loop", "--seed", "3"])
    assert (command.source, command.filters, command.seed) == ("loop", ("dfs", "fs2"), 3)


def test_underscores_and_equals_signs():
    command, own = command_line.parse(["run", "--inflate_r=2", "paper-line", "--max_range=20"])
    assert command.filter.inflate_r == 2
    assert own == {"--max-range": "20"}


def test_run_prints_a_table(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.entry([*RUN, "--filters", "dfs", "fs2", "fs1", "ekf"]) == 0
    out = capsys.readouterr().out
    for text in ("Dual FastSLAM", "FastSLAM 2.0", "FastSLAM 1.0", "EKF-SLAM", "particles", "position MSE", "3 steps"):
        assert text in out
    assert max(map(len, out.splitlines())) <= 90


def test_run_writes_what_is_asked_for(capsys, tmp_path):
    summary, paths = tmp_path / "s.json", tmp_path / "paths"
    assert cli.entry([*RUN, "--summary", str(summary), "--trajectory", str(paths), "--vehicle", "ackermann"]) == 0
    found = json.loads(summary.read_text())
    assert found["steps"] == 3
    assert found["params"]["options"]["vehicle"] == "ackermann"
    assert (paths / "dfs-online.tum").exists()
    out = capsys.readouterr().out
    assert str(summary) in out
    assert str(paths) in out


def test_same_seed_same_summary_in_any_company(tmp_path):
    def summary(*more):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.json"
        assert cli.entry([*RUN, "--summary", str(path), *more]) == 0
        return without_timings(json.loads(path.read_text()))

    once = summary()
    assert once == summary()
    assert once["filters"]["fs2"] == summary("--filters", "fs2")["filters"]["fs2"]
    assert once["filters"]["fs2"] != summary("--seed", "1")["filters"]["fs2"]


def test_warnings_of_the_source_are_shown(capsys, monkeypatch):
    source = dataclasses.replace(build("paper-line"), warnings=("log.dat:7: cut short",))
    monkeypatch.setattr("app.run.load", lambda *_: source)
    assert cli.entry(RUN) == 0
    assert "warning: log.dat:7: cut short" in capsys.readouterr().err


def test_memory_that_does_not_suffice_is_a_sentence(capsys, monkeypatch):
    def exhausted(*_):
        raise MemoryError

    monkeypatch.setattr("app.run.load", exhausted)
    assert "not enough memory" in refused(capsys, *RUN)


def test_worlds(capsys):
    assert cli.entry(["worlds"]) == 0
    out = capsys.readouterr().out
    for name in worlds():
        assert name in out


@pytest.mark.parametrize("name", list(worlds()))
def test_one_world(capsys, name):
    assert cli.entry(["worlds", name]) == 0
    out = capsys.readouterr().out
    assert worlds()[name].features[0] in out
    assert ("laser: 181 beams, 1° apart, to 8 m" in out) == ("walls" in worlds()[name].features)
    for option in (f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(worlds()[name].options)):
        assert option in out


@pytest.mark.parametrize(
    ("world", "option", "value"), [("paper-line", "--layout", "sparse"), ("hospital", "--layout-seed", "7")]
)
def test_a_world_can_be_written_and_run(capsys, tmp_path, world, option, value):
    path, summaries = tmp_path / "mine.toml", []
    assert cli.entry(["worlds", world, option, value, "--write", str(path)]) == 0
    for written_or_not in ([str(path)], [world, option, value]):
        summary = tmp_path / "s.json"
        assert cli.entry(["run", *written_or_not, "--particles", "5", "--steps", "3", "--summary", str(summary)]) == 0
        summaries.append(json.loads(summary.read_text())["filters"]["dfs"]["position_error_m"])
    assert summaries[0] == summaries[1]
    assert cli.entry(["worlds", str(path)]) == 0
    capsys.readouterr()
    assert f"{option} does not apply" in refused(capsys, "run", path, option, value)


def test_a_world_replaces_nothing(capsys, tmp_path):
    path = tmp_path / "my world.toml"
    for other in ("dear diary", "[route]\n"):
        path.write_text(other)
        assert "exists already" in refused(capsys, "worlds", "loop", "--write", path)
        assert path.read_text() == other
    path.write_text("")
    assert cli.entry(["worlds", "loop", "--write", str(path)]) == 0
    assert f"dualslam run '{path}'" in capsys.readouterr().out
    assert "waypoints" in path.read_text()


def test_a_full_disk_leaves_no_half_of_a_world(capsys, tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, "")

    path = tmp_path / "mine.toml"
    monkeypatch.setattr("app.files.os.fsync", full)
    assert refused(capsys, "worlds", "loop", "--write", path) == f"{path}: the disk is full"
    assert list(tmp_path.iterdir()) == []


def test_a_summary_replaces_nothing_but_a_summary(capsys, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[route]\n")
    assert "is no summary" in refused(capsys, "run", "paper-line", "--steps", "1", "--summary", path)
    assert path.read_text() == "[route]\n"


@pytest.mark.parametrize("columns", ["40", "60", "200"])
def test_numbers_of_worlds_are_never_cut(capsys, monkeypatch, columns):
    assert cli.entry(["worlds"]) == 0
    piped = capsys.readouterr().out
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("NO_COLOR", "1")
    assert cli.entry(["worlds"]) == 0
    narrow = capsys.readouterr().out
    assert "…" not in piped + narrow
    for line in piped.splitlines()[1 : 1 + len(worlds())]:
        for number in line.split()[1:9]:
            assert number in narrow


def test_version(capsys):
    assert cli.entry(["--version"]) == 0
    assert capsys.readouterr().out.startswith("dualslam ")


def test_a_recording_is_not_run_but_opened(capsys, tmp_path):
    path = tmp_path / "my run.rrd"
    path.write_bytes(b"RRF2")
    assert f"is a recording; open it with: rerun '{path}'" in refused(capsys, "run", path)


def test_numbers_beyond_computing_are_a_sentence(capsys, monkeypatch):
    def overflow(*_):
        raise OverflowError("math range error")

    monkeypatch.setattr("app.run.load", overflow)
    assert "math range error" in refused(capsys, *RUN)


@pytest.mark.parametrize(("code", "expected"), [(None, 0), (0, 0), (3, 3), ("no", 1)])
def test_exit_codes_are_kept(monkeypatch, code, expected):
    def leave(*_):
        raise SystemExit(code)

    monkeypatch.setattr("app.run.load", leave)
    assert cli.entry(RUN) == expected


def test_an_interruption_before_anything_has_begun_is_told(capsys, monkeypatch):
    def interrupted(*_):
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("app.run.load", interrupted)
    assert cli.entry(RUN) == 130
    assert capsys.readouterr() == ("", "interrupted\n")


def test_a_library_that_answers_an_interruption_with_an_error(capsys, monkeypatch):
    def interrupted(*_):
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        raise RuntimeError("no compiled object yet")

    monkeypatch.setattr("app.run.load", interrupted)
    assert cli.entry(RUN) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_summary_where_the_table_would_be(capsys):
    assert cli.entry([*RUN, "--summary", "/dev/stdout"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["steps"] == 3
    assert "position MSE" in err


def test_nobody_reading_is_no_failure(monkeypatch):
    def closed(*_):
        raise BrokenPipeError

    monkeypatch.setattr("app.run.load", closed)
    stdout = sys.stdout
    try:
        assert cli.entry(RUN) == 0
    finally:
        sys.stdout.close()
        sys.stdout = stdout


def test_outputs_need_no_directory_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.entry([*RUN, "--summary", "s.json", "--trajectory", "t"]) == 0
    assert sorted(os.listdir()) == ["s.json", "t"]
    assert Outputs().record is None


def test_a_part_of_a_real_log(shared_data, tmp_path, capsys):
    log, summary = shared_data / "mrclam" / "MRCLAM_Dataset6", tmp_path / "s.json"
    line = ["run", str(log), "--robot", "3", "--from", "100", "--to", "119", "--every", "2", "--filters", "fs2", "ekf"]
    assert cli.entry([*line, "--particles", "10", "--summary", str(summary), "--trajectory", str(tmp_path)]) == 0
    found = json.loads(summary.read_text())
    assert found["steps"] == 10
    assert found["params"]["noise"] is None
    assert found["filters"]["fs2"]["position_error_m"][-1] < 5
    stamps = [line.split()[0] for line in (tmp_path / "fs2.tum").read_text().splitlines()]
    assert [float(stamp) for stamp in stamps] == pytest.approx(found["filters"]["fs2"]["time_s"], abs=1e-6)
    capsys.readouterr()
    assert "--noise.range does not apply" in refused(capsys, *line, "--noise.range", "0.1")
    assert "no robot 9 (--robot)" in refused(capsys, "run", log, "--robot", "9")
    assert "--from 9999999: expected 0 to" in refused(capsys, "run", log, "--robot", "3", "--from", "9999999")
    assert "--to 1: expected 5" in refused(capsys, "run", log, "--robot", "3", "--from", "5", "--to", "1")


def test_known_association_wants_tags(capsys, tmp_path):
    """A log of trees that nobody named."""
    rows = {"dead_reckoning": "{t:.3f} 1.0 0.01", "trees": "{t:.3f} 5.0 1.5 0.4", "gps": "{t:.3f} 1.0 2.0"}
    for name, row in rows.items():
        (tmp_path / f"{name}.txt").write_text("".join(row.format(t=0.025 * k) + "\n" for k in range(200)))
    complaint = refused(capsys, "run", tmp_path, "--association", "known")
    assert "--association is known, but nobody knows what was seen in victoria-park" in complaint
    assert "expected nearest or jcbb" in complaint


def test_known_association_of_walls(capsys):
    """What the beams met is known before any wall is extracted."""
    assert cli.entry(["run", "loop", "--steps", "3", "--particles", "2", "--association", "known"]) == 0
    assert "known association" in capsys.readouterr().out


@pytest.mark.parametrize("blind", [["--noise.missing", "1"], ["--beams", "3"]])
def test_a_run_that_sees_nothing_says_so(capsys, blind):
    line = ["run", "loop", "--steps", "3", "--particles", "2", "--filters", "dfs", "fs2", "fs1", "ekf"]
    assert cli.entry([*line, *blind]) == 0
    assert "no wall was seen in any of these steps" in capsys.readouterr().out
    assert cli.entry(line) == 0
    assert "no wall was seen" not in capsys.readouterr().out


def test_what_was_compiled_once_is_not_compiled_again():
    """Plain Python calls the functions of features too, and nothing that it compiles is kept on disk."""
    run = [sys.executable, "-c", "import sys; from app.cli import entry; sys.exit(entry())", "run", "loop"]
    line = [*run, "--filters", *FILTERS, "--orthogonal", "--steps", "12", "--particles", "3"]
    told = [subprocess.run(line, capture_output=True, text=True, check=True, cwd=ROOT).stderr for _ in range(2)]
    assert COMPILING not in told[1]
