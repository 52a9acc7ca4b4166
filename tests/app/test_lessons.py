"""Lessons: what they say is so, over several seeds; their texts; and what the command makes of them."""

from __future__ import annotations

import base64
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from app import cli
from app.lessons import LESSONS
from app.lessons.equations import EQUATIONS
from app.lessons.running import run_all
from app.lessons.watching import Ran
from app.live import lessons
from app.live.engine import Engine
from app.live.trend import Trend
from app.panel.panel import Lessons, Panel
from app.recording.reading import Recording
from app.types import SessionInfo
from scenarios.registry import build, worlds

ROOT = Path(__file__).parent.parent.parent

SEEDS = {"good-sensor": 3, "improved-proposal": 3, "dual-idea": 3, "corridor": 3, "rotation": 3}
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
    lesson, seeds = LESSONS[name], given(name)
    filters = {run: list(ran.summary.filters) for run, ran in seeds[0].items()}
    names = [run for run in filters if filters[run] == filters[lesson.variants[1].name]]
    exchanged = [runs | {to: runs[of] for to, of in zip(names, (*names[1:], names[0]), strict=True)} for runs in seeds]
    assert not lesson.phenomenon(exchanged).seen
    alike = [{run: runs[names[0]] if run in names else ran for run, ran in runs.items()} for runs in seeds]
    assert not lesson.phenomenon(alike).seen


def test_it_would_not_be_so_of_other_filters(given):
    """The one lesson with a single run is about how its filters differ."""
    lesson, other = LESSONS["loop"], {"dfs": "fs1", "fs1": "dfs"}
    each = [lesson.numbers(runs) for runs in given("loop")]
    medians = {of: float(np.median([numbers[of] for numbers in each])) for of in each[0]}
    assert lesson.claim(medians).seen
    assert not lesson.claim({(run, other.get(key, key), of): x for (run, key, of), x in medians.items()}).seen


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
    (["--no-browser"], ["--no-browser", "--live"]),
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
    while not (recording.exists() and recording.stat().st_size > 700_000) and time.monotonic() - began < 60:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert re.search(r"interrupted after \d+ of 184 steps of '\d+ particles?'; everything up to there is saved", err)
    assert "Traceback" not in err
    assert "## The point" not in out
    assert not Recording(recording).damaged
    assert "What came out" not in (tmp_path / "out" / "rotation.md").read_text(encoding="utf-8")


@pytest.fixture
def page():
    """The panel in the first run of a lesson, as `--live` opens it."""
    name = "one-landmark-too-many: one landmark"
    engine = Engine(lessons.open_lesson(name, 3))
    engine.start()
    offered = Lessons(lessons.NAMES, lessons.open_lesson, lessons.text_of)
    panel = Panel(engine, Trend(), NoRecords(), list(worlds()), build, lessons=offered, lesson=name)
    yield engine, panel
    panel.close()
    engine.close(20.0)


class NoRecords:
    """Nothing is recorded."""

    running = False

    def start(self, name: str) -> str:
        return name

    def stop(self) -> str:
        return ""

    def describe(self) -> str:
        return ""


def choose(page, name: str, number: int) -> SessionInfo:
    """Choose a lesson and press Reset; the session that begins, the number-th."""
    engine, panel = page
    panel.lesson.value = name
    panel._reset()
    info = engine.wait(lambda status: status.number == number).info
    began = time.monotonic()
    while panel._built != number and time.monotonic() - began < 20:
        time.sleep(0.02)
    return info


def test_lessons_on_the_page(page):
    info = choose(page, "corridor: 30 particles", 1)
    assert (info.source.name, info.steps, info.seed, info.params.particles) == ("corridor", 100, 3, 30)
    assert info.command == "dualslam live corridor --doors none --particles 30 --steps 100 --seed 3"
    assert page[1]._lesson == page[1].lesson.value == "corridor: 30 particles"
    page[0].desk.change({"particles": 7})
    assert choose(page, "corridor: 30 particles", 2).params.particles == 7  # begins again, as it is now
    assert choose(page, "nothing of the kind", 3).source.name == "corridor"
    assert page[1]._lesson == ""
    info = choose(page, "one-landmark-too-many: three, R times 16", 4)
    assert (info.params.weighting, info.params.inflate_r) == ("joint", 16.0)
    page[1].world.value = "loop"
    assert choose(page, page[1].lesson.value, 5).source.name == "loop"
    assert page[1].lesson.value == "-"


@pytest.mark.parametrize("name", lessons.NAMES)
def test_text_on_the_page(name):
    pieces = lessons.text_of(name)
    pictures = "".join(html for _, html in pieces)
    assert pictures.count("<img") == pictures.count("data:image/svg+xml;base64,") >= 1
    for picture in re.findall(r"base64,([A-Za-z0-9+/=]+)", pictures):
        assert b"</svg>" in base64.b64decode(picture)
    markdown = "".join(text for text, _ in pieces)
    assert "\0" not in markdown
    assert "```" not in markdown
    assert LESSONS[name.partition(":")[0]].point in markdown
