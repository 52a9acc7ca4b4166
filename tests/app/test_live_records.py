"""Between a live session and those who take time: queues, files, viewers that are slow."""

from __future__ import annotations

import json
import threading
import time
from functools import partial

import numpy as np
import pytest

from app import session
from app.live.engine import Begun, Engine, Forked, Stepped
from app.live.publisher import Publisher
from app.live.records import Records, safe_name
from app.recording.errors import RecordingError
from app.recording.reading import Recording
from app.recording.session import SessionWriter
from app.recording.stream import FileStream, check_path
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from tests.app.live import PATIENCE, Notes, at, change


class Slow(Notes):
    """A listener that takes its time."""

    def __init__(self, seconds=0.0, fails_at=None):
        super().__init__()
        self.seconds, self.fails_at = seconds, fails_at
        self.gate = threading.Event()
        self.gate.set()

    def stepped(self, stepped):
        self.gate.wait(PATIENCE)
        time.sleep(self.seconds)
        if stepped.step.index == self.fails_at:
            raise OSError(28, "No space left on device")
        super().stepped(stepped)

    @property
    def indices(self):
        return [stepped.step.index for stepped in self.steps]


@pytest.fixture(scope="module")
def source():
    return build("paper-line")


@pytest.fixture
def engine(source):
    info = session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=10), seed=1)
    made = Engine(info)
    made.start()
    yield made
    made.close(PATIENCE)


def test_a_viewer_that_is_slow_loses_the_oldest_steps_and_nothing_else(engine):
    slow = Slow()
    publisher = Publisher(slow, "drop", 4)
    engine.add(publisher)
    slow.gate.clear()
    began = time.monotonic()
    engine.step(30)
    at(engine, 30)
    engine.go(10)
    at(engine, 10)
    engine.fork("x")
    engine.step()
    at(engine, 11)
    assert time.monotonic() - began < 10.0
    slow.gate.set()
    engine.remove(publisher)
    assert publisher.join(PATIENCE)
    assert [type(item) for item in slow.all if not isinstance(item, Stepped)] == [Begun, Forked, type(None)]
    assert slow.indices[-1] == 11
    assert slow.indices[-2] == 30
    assert len(slow.indices) <= 5
    assert publisher.dropped == 31 - len(slow.indices)


def test_a_file_loses_no_step_the_session_waits_for_it(engine):
    slow = Slow(0.01)
    publisher = Publisher(slow, "wait", 3)
    engine.add(publisher)
    engine.step(40)
    at(engine, 40)
    engine.remove(publisher)
    assert publisher.join(PATIENCE)
    assert slow.indices == list(range(1, 41))
    assert (publisher.dropped, publisher.published) == (0, 40)


def test_but_not_for_ever(engine):
    slow = Slow()
    slow.gate.clear()
    publisher = Publisher(slow, "wait", 3, patience=0.5)
    engine.add(publisher)
    engine.step(20)
    at(engine, 20)
    assert "nothing could be written for 0.5 s" in publisher.error
    slow.gate.set()
    engine.remove(publisher)
    assert publisher.join(PATIENCE)
    assert slow.all[-1] is None  # closed, so that what was written is complete


def test_who_fails_is_closed_and_the_session_goes_on(engine):
    slow = Slow(fails_at=3)
    publisher = Publisher(slow, "wait", 10)
    engine.add(publisher)
    engine.step(10)
    at(engine, 10)
    engine.remove(publisher)
    assert publisher.join(PATIENCE)
    assert slow.indices == [1, 2]
    assert publisher.error == "the disk is full"
    assert slow.all[-1] is None


def records_of(engine, directory, make=None):
    return Records(engine, directory, make or (lambda path: SessionWriter(partial(FileStream, path))), check_path)


def test_a_recording_has_every_step_and_the_script_beside_it(engine, tmp_path):
    records = records_of(engine, tmp_path)
    engine.step(3)
    at(engine, 3)
    assert "a-name.rrd" in records.start("../a name")
    assert records.running
    engine.step(20)
    at(engine, 23)
    change(engine, particles=17, filters=("dfs", "fs2"))
    engine.step(2)
    at(engine, 25)
    engine.go(15)
    at(engine, 15)
    change(engine, particles=30)
    engine.step(3)
    at(engine, 18)
    assert "recording" in records.describe()
    assert "saved" in records.stop()
    assert not records.running
    recording = Recording(tmp_path / "a-name.rrd")
    steps, _ = recording.series("/plots/n_eff/dfs")
    np.testing.assert_array_equal(steps, np.arange(4, 26))
    branch = "/branch/15-particles-30/plots/n_eff/dfs"
    np.testing.assert_array_equal(recording.series(branch)[0], [16, 17, 18])
    np.testing.assert_array_equal(recording.series("/plots/n_eff/fs2")[0], [24, 25])
    assert any("particles: 10 -> 17" in event.text for event in recording.events())
    script = json.loads((tmp_path / "a-name.json").read_text())
    assert [b["name"] for b in script["branches"]] == ["", "15-particles-30"]


def test_a_branch_is_recorded_with_its_own_settings(engine, monkeypatch):
    """And not before it has a step."""
    made = []

    class Told:
        def __init__(self, info, *_, judge):
            made.append(("", info))

        def fork(self, info, name, judge):
            made.append((name, info))
            return self

        def step(self, step, detail):
            made.append(step.index)

        def close(self):
            made.append("closed")

    monkeypatch.setattr("app.recording.session.Writer", Told)
    engine.add(SessionWriter(None))
    engine.step(3)
    at(engine, 3)
    engine.fork("nothing comes of it")
    change(engine, particles=33, noise__range=0.25, filters=("dfs", "ekf"))
    engine.go(2)
    at(engine, 2)
    change(engine, particles=33, noise__range=0.25, filters=("dfs", "ekf"))
    engine.step()
    at(engine, 3)
    engine.close(PATIENCE)
    (_, first), *steps, (name, info), last, closed = made
    assert (steps, last, closed) == ([1, 2, 3], 3, "closed")
    assert first.params.particles == 10
    assert name.startswith("2-particles-33")
    assert (info.params.particles, info.noise.range) == (33, 0.25)
    assert [estimator.key for estimator in info.filters] == ["dfs", "ekf"]


def test_a_second_recording_overwrites_nothing(engine, tmp_path):
    records = records_of(engine, tmp_path)
    for expected in ("x.rrd", "x-2.rrd", "x-3.rrd"):
        assert expected in records.start("x")
        assert "already" in records.start("y")
        engine.step()
        at(engine, engine.status.step + 0)
        time.sleep(0.2)
        records.stop()
    assert {path.name for path in tmp_path.glob("*.rrd")} == {"x.rrd", "x-2.rrd", "x-3.rrd"}


def test_a_reset_begins_another_file(engine, tmp_path):
    records = records_of(engine, tmp_path)
    records.start("r")
    engine.step(4)
    at(engine, 4)
    engine.reset(seed=5)
    engine.wait(lambda s: s.number == 1)
    engine.step(2)
    at(engine, 2)
    records.stop()
    first, second = (Recording(tmp_path / name).series("/plots/n_eff/dfs")[0] for name in ("r.rrd", "r-2.rrd"))
    np.testing.assert_array_equal(first, [1, 2, 3, 4])
    np.testing.assert_array_equal(second, [1, 2])
    seeds = [json.loads((tmp_path / name).read_text()) for name in ("r.json", "r-2.json")]
    assert [(script["seed"], script["branches"][0]["steps"]) for script in seeds] == [(1, 4), (5, 2)]


def reset_while_recording(engine, directory, *listeners):
    """A recording of six steps, and another one of the session after a reset; what is said when it is stopped."""
    made = iter(listeners)
    records = records_of(engine, directory, lambda path: next(made))
    records.start("r")
    engine.step(6)
    at(engine, 6)
    engine.reset(seed=5)
    engine.wait(lambda s: s.number == 1)
    engine.step(1)
    at(engine, 1)
    return records.stop()


def test_stopping_waits_for_the_files_of_former_sessions_too(engine, tmp_path):
    first, second = Slow(seconds=0.1), Slow()
    assert reset_while_recording(engine, tmp_path, first, second).startswith("saved")
    assert [slow.indices for slow in (first, second)] == [[1, 2, 3, 4, 5, 6], [1]]


def test_a_former_session_that_was_lost_is_told(engine, tmp_path):
    told = reset_while_recording(engine, tmp_path, Slow(seconds=0.1, fails_at=3), Slow())
    assert "**lost**" in told
    assert "r.rrd" in told
    assert "saved" in told


def test_a_script_that_is_saved_late_is_not_that_of_the_next_session(engine, tmp_path, monkeypatch):
    """It was asked for before the reset, and its turn comes after it."""
    monkeypatch.setattr("app.live.records.KEEP_EVERY", -1.0)
    records, gate = records_of(engine, tmp_path), threading.Event()
    records.start("r")
    engine.step(4)
    at(engine, 4)
    engine.call(lambda history: gate.wait(PATIENCE))
    engine.reset(seed=5)
    keeping = threading.Thread(target=records.keep)
    keeping.start()
    time.sleep(0.2)
    gate.set()
    keeping.join(PATIENCE)
    engine.wait(lambda s: s.number == 1)
    assert json.loads((tmp_path / "r.json").read_text())["seed"] == 1
    records.stop()


def test_a_recording_that_fails_is_told_and_the_session_goes_on(engine, tmp_path):
    slow = Slow(fails_at=2)
    records = records_of(engine, tmp_path, lambda path: slow)
    records.start("f")
    engine.step(5)
    at(engine, 5)
    until = time.monotonic() + PATIENCE
    while "lost" not in records.describe() and time.monotonic() < until:
        time.sleep(0.02)
    assert "the disk is full" in records.describe()
    assert "the disk is full" in records.stop()
    engine.step()
    at(engine, 6)


def test_where_nothing_can_be_written_nothing_is_begun(engine, tmp_path):
    records = records_of(engine, tmp_path / "no such directory")
    with pytest.raises(RecordingError, match="no such directory"):
        records.start("x")
    assert not records.running
    assert "nothing is being recorded" in records.stop()


@pytest.mark.parametrize(
    ("typed", "name"),
    [
        ("session", "session"),
        ("My run 3", "My-run-3"),
        ("../../etc/passwd", "etc-passwd"),
        ("/abs/olute.rrd", "abs-olute"),
        ("..", "session"),
        ("", "session"),
        ("\x00\n", "session"),
        ("ünïcödé", "n-c-d"),
        ("a" * 500, "a" * 64),
        (".hidden", "hidden"),
    ],
)
def test_a_name_from_anybody_stays_in_its_directory(typed, name):
    assert safe_name(typed) == name


def test_a_particle_that_is_picked_stands_out_in_the_recording(engine, tmp_path):
    records = records_of(engine, tmp_path)
    engine.step(2)
    at(engine, 2)
    records.start("p")
    engine.pick("dfs", 4, 2)
    engine.step(3)
    at(engine, 5)
    update = engine.status.taken.step.filters["dfs"]
    key, particle = engine.status.taken.step.picked
    engine.unpick()
    engine.step()
    at(engine, 6)
    assert engine.status.taken.step.picked is None
    for nonsense in (("dfs", 99, 6), ("dfs", -1, 6), ("fs1", 0, 6), ("dfs", 0, 400), ("dfs", 0, -3)):
        engine.pick(*nonsense)
        engine.step()
        engine.wait(lambda s: not s.playing and s.step >= 7, PATIENCE)
    records.stop()
    assert key == "dfs"
    recording = Recording(tmp_path / "p.rrd")
    rows = dict(recording.rows("/world/dfs/picked", "Points3D:positions", "step"))
    np.testing.assert_allclose(rows[5][0][:2], update.trace.weighted.s[particle][:2], atol=1e-5)
    assert {3, 4, 5} <= set(rows)
    assert recording.rows("/world/dfs/picked/map", "Points3D:positions", "step")
