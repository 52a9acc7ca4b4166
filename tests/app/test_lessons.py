"""Lessons: what they say is so, over several seeds; their texts; and what the command makes of them."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from app import cli
from app.lessons import LESSONS
from app.lessons.equations import EQUATIONS
from app.lessons.running import run_all
from app.lessons.watching import Ran
from app.recording.reading import Recording

ROOT = Path(__file__).parent.parent.parent

SEEDS = {"corridor": 3, "rotation": 3}
"""So many where the numbers hardly differ from seed to seed and a run takes its time; five elsewhere."""

LETTERS = {*map(chr, range(0x20, 0x7F)), *"\n·²°θΣΠπ"}
"""That the fonts of Rerun's viewer have: it ends where one is missing."""


@pytest.fixture(scope="module")
def given():
    """The runs of a lesson, by seed; each lesson is run once for all tests."""
    found: dict[str, list[dict[str, Ran]]] = {}

    def runs(name: str) -> list[dict[str, Ran]]:
        if name not in found:
            found[name] = [run_all(LESSONS[name], seed) for seed in range(SEEDS.get(name, 5))]
        return found[name]

    return runs


@pytest.mark.parametrize("name", LESSONS)
def test_what_a_lesson_says_is_so(given, name):
    finding = LESSONS[name].phenomenon(given(name))
    assert finding.seen, finding.sentence
    assert "nan" not in finding.sentence


@pytest.mark.parametrize("name", [name for name, lesson in LESSONS.items() if len(lesson.variants) > 1])
def test_it_would_not_be_so_of_other_runs(given, name):
    """Each lesson is about how its runs differ."""
    lesson = LESSONS[name]
    names = [variant.name for variant in lesson.variants]
    exchanged = [dict(zip(names, [runs[other] for other in reversed(names)], strict=True)) for runs in given(name)]
    assert not lesson.phenomenon(exchanged).seen
    alike = [dict(zip(names, [runs[names[0]]] * len(names), strict=True)) for runs in given(name)]
    assert not lesson.phenomenon(alike).seen


def test_it_would_not_be_so_of_other_filters(given):
    """The one lesson with a single run is about how its filters differ."""
    for runs in given("loop"):
        for ran in runs.values():
            ran.summary.filters |= {"dfs": ran.summary.filters["fs1"], "fs1": ran.summary.filters["dfs"]}
    try:
        assert not LESSONS["loop"].phenomenon(given("loop")).seen
    finally:
        for runs in given("loop"):
            for ran in runs.values():
                ran.summary.filters |= {"dfs": ran.summary.filters["fs1"], "fs1": ran.summary.filters["dfs"]}


@pytest.mark.parametrize("name", LESSONS)
def test_texts_are_whole_and_can_be_shown_anywhere(name):
    lesson = LESSONS[name]
    text = lesson.text(found="what came out")
    assert set(text) <= LETTERS
    assert not re.search(r"^\$", text, re.MULTILINE)
    for part in ("Before you look", "What came out", "What to watch", "The point", "How sure is that?"):
        assert f"## {part}\n\n" in text
    assert re.search(r"\d+ of \d+ seeds", lesson.measured)
    for variant in lesson.variants:
        assert f"dualslam run {variant.options}`" in text


def test_all_equations_are_used_and_no_others():
    texts = "\n".join(lesson.text(lambda equations: f"<{equations}>") for lesson in LESSONS.values())
    assert {name for name, equation in EQUATIONS.items() if equation.plain in texts} == set(EQUATIONS)


def test_list(capsys):
    assert cli.entry(["lesson", "--list"]) == 0
    out = capsys.readouterr().out
    assert all(lesson.name in out and lesson.title in out for lesson in LESSONS.values())
    assert cli.entry(["lesson"]) == 0
    assert capsys.readouterr().out == out


BAD = [
    (["coridor"], ["there is no lesson 'coridor'", "did you mean corridor?", "good-sensor, improved-proposal"]),
    (["corridor", "--record", "a.txt"], ["--record a.txt", "ends in .rrd"]),
    (["corridor", "--record", "a.rrd", "--out", "b"], ["--record or --out"]),
    (["corridor", "--live", "--record", "a.rrd"], ["--live", "no --record"]),
    (["corridor", "--no-browser"], ["--no-browser", "--live"]),
    (["--live"], ["NAME"]),
    (["corridor", "--seed", "x"], ["--seed is 'x'"]),
    (["corridor", "--sed", "1"], ["unknown option --sed", "did you mean --seed?"]),
    (["corridor", "--doors", "none"], ["--doors", "lesson"]),
]


@pytest.mark.parametrize(("arguments", "said"), BAD, ids=lambda value: " ".join(value) if value[0] else "")
def test_what_is_refused_is_told_in_one_sentence(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert cli.entry(["lesson", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert all(part in err for part in said), err
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """What `--out` writes, and what is printed."""
    folder = tmp_path_factory.mktemp("lesson") / "out"
    command = [sys.executable, "-m", "app.cli", "lesson", "overconfidence", "--seed", "2", "--out", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def test_printed(written):
    folder, out = written
    lesson = LESSONS["overconfidence"]
    places = [out.index(part) for part in (lesson.title, lesson.question[:40], "What came out", lesson.point[:40])]
    assert places == sorted(places)
    assert lesson.phenomenon([run_all(lesson, 2)]).sentence in out
    assert f"recording: {folder / 'overconfidence.rrd'}" in out


def test_recording_has_the_text_and_all_runs(written):
    folder, _ = written
    recording = Recording(folder / "overconfidence.rrd")
    assert not recording.damaged
    assert recording.branches() == ["believes-its-wheels", "one-founder-left"]
    assert recording.params("")["params"]["believed"]["speed"] == pytest.approx(0.3)
    assert recording.params("believes-its-wheels")["params"]["believed"]["speed"] == pytest.approx(0.1)
    for root in ("/", "/branch/believes-its-wheels/", "/branch/one-founder-left/"):
        steps, _ = recording.series(f"{root}plots/nees/dfs")
        assert list(steps) == list(range(1, 60))
    assert "/lesson" in recording.entities


def test_folder_has_the_text_and_a_summary_of_each_run(written):
    folder, _ = written
    names = {"overconfidence.rrd", "overconfidence.md", "honest.json", "believes-its-wheels.json"}
    assert {path.name for path in folder.iterdir()} == names | {"one-founder-left.json"}
    assert "Seed 2." in (folder / "overconfidence.md").read_text(encoding="utf-8")
    assert json.loads((folder / "honest.json").read_text(encoding="utf-8"))["complete"]


def test_interruption_saves_what_is_there(tmp_path):
    command = [sys.executable, "-m", "app.cli", "lesson", "rotation", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    recording = tmp_path / "out" / "rotation.rrd"
    began = time.monotonic()
    while not (recording.exists() and recording.stat().st_size > 300_000) and time.monotonic() - began < 60:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert re.search(r"interrupted after \d+ of 184 steps of '\d+ particles?'; everything up to there is saved", err)
    assert "Traceback" not in err
    assert "## The point" not in out
    assert not Recording(recording).damaged
    assert "What came out" not in (tmp_path / "out" / "rotation.md").read_text(encoding="utf-8")
