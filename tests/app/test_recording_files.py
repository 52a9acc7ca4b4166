"""What becomes of the file: paths that cannot be written, a killed run, a full disk, damaged recordings."""

from __future__ import annotations

import dataclasses
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from app import session
from app.recording import Recorder, RecordingError
from app.recording.reading import Recording, read_params, read_series, repair
from app.types import SessionInfo, SessionStep
from scenarios.registry import build
from slam.estimators import ESTIMATORS

ROOT = Path(__file__).resolve().parents[2]


def info_of(steps: int, particles: int = 10) -> SessionInfo:
    source = build("paper-line")
    params = source.params(particles=particles, association="known")
    return session.make_info(source, [ESTIMATORS["dfs"]], params, count=steps)


def record(path: Path, steps: int = 5) -> None:
    session.run(info_of(steps), [Recorder(path)])


class TestPaths:
    """Said before the run begins."""

    def test_a_directory_that_is_not_there(self, tmp_path):
        with pytest.raises(RecordingError, match=r"a\.rrd cannot be written: the directory .*none does not exist"):
            Recorder(tmp_path / "none" / "a.rrd")

    def test_a_directory(self, tmp_path):
        (tmp_path / "a.rrd").mkdir()
        with pytest.raises(RecordingError, match=r"a\.rrd is a directory"):
            Recorder(tmp_path / "a.rrd")

    def test_another_ending(self, tmp_path):
        with pytest.raises(RecordingError, match=r"expected a name that ends in \.rrd"):
            Recorder(tmp_path / "a.txt")

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
    def test_no_permission(self, tmp_path):
        tmp_path.chmod(0o500)
        with pytest.raises(RecordingError, match="permission denied"):
            Recorder(tmp_path / "a.rrd")

    def test_a_file_system_that_cannot_be_written(self):
        with pytest.raises(RecordingError, match="cannot be written"):
            Recorder("/proc/a.rrd")

    def test_nothing_but_a_recording_is_overwritten(self, tmp_path):
        path = tmp_path / "thesis.rrd"
        path.write_text("years of work")
        with pytest.raises(RecordingError, match="exists and is no recording"):
            Recorder(path)
        assert path.read_text() == "years of work"

    def test_a_recording_is_overwritten(self, tmp_path):
        path = tmp_path / "a.rrd"
        path.touch()
        record(path, 3)
        record(path, 5)
        assert len(read_series(path, "/plots/n_eff/dfs")[0]) == 5

    def test_no_file_is_made_before_the_session_begins(self, tmp_path):
        Recorder(tmp_path / "a.rrd")
        assert list(tmp_path.iterdir()) == []

    def test_recording_turned_off_from_outside_is_an_error(self, tmp_path):
        done = run_script(tmp_path / "a.rrd", steps=2, RERUN="off")
        assert "RecordingError: the environment variable RERUN=off turns recording off" in done.stderr
        assert not (tmp_path / "a.rrd").exists()


SCRIPT = """
import sys, time
sys.path[:0] = [{tests!r}]
from test_recording_files import *
from app.recording import Recorder

class Told:
    def begin(self, info): pass
    def step(self, step):
        print(step.index, flush=True)
        time.sleep({pause})
    def end(self): print("ended", flush=True)

session.run(info_of({steps}, {particles}), [Recorder({path!r}), Told()])
"""


def command(path: Path, steps: int, pause: float = 0.0, particles: int = 10) -> list[str]:
    tests = str(Path(__file__).parent)
    code = SCRIPT.format(tests=tests, path=str(path), steps=steps, pause=pause, particles=particles)
    return [sys.executable, "-c", code]


def run_script(
    path: Path, steps: int, pause: float = 0.0, limit: int | None = None, particles: int = 10, **environment: str
):
    """The session above in a process of its own."""
    return run_limited(command(path, steps, pause, particles), limit, **environment)


def run_limited(arguments: list[str], limit: int | None = None, **environment: str):
    """A process whose files may have at most `limit` bytes."""

    def no_larger_files() -> None:
        assert limit is not None
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.run(
        arguments,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        cwd=ROOT,
        env={**os.environ, **environment},
        preexec_fn=no_larger_files if limit else None,
    )


class TestDamage:
    """What was recorded can be read."""

    def test_a_killed_run_keeps_all_but_the_last_second(self, tmp_path):
        path = tmp_path / "killed.rrd"
        process = subprocess.Popen(command(path, 59, 0.1), stdout=subprocess.PIPE, text=True, cwd=ROOT)
        assert process.stdout is not None
        at: dict[int, float] = {}
        for line in process.stdout:
            at[int(line)] = time.monotonic()
            if len(at) == 35:
                break
        killed = time.monotonic()
        process.send_signal(signal.SIGKILL)
        rest, _ = process.communicate()
        told = len(at) + len(rest.split())  # a busy machine may kill late

        due = max(index for index, moment in at.items() if moment < killed - 1.0)
        steps, values = read_series(path, "/plots/n_eff/dfs")
        np.testing.assert_array_equal(steps, np.arange(1, len(steps) + 1))
        assert due <= len(steps) <= told + 1
        assert np.isfinite(values).all()
        assert len(Recording(path).rows("/world/dfs/particles", "Points3D:positions", "stage")) >= 3 * due

        repaired = repair(path)
        assert repaired == tmp_path / "killed-repaired.rrd"
        np.testing.assert_array_equal(read_series(repaired, "/plots/n_eff/dfs"), (steps, values))

    def test_a_file_that_is_cut_anywhere(self, tmp_path):
        whole, cut = tmp_path / "whole.rrd", tmp_path / "cut.rrd"
        record(whole, 59)
        data = whole.read_bytes()
        for share in (0.7, 0.9, 0.99):
            cut.write_bytes(data[: int(share * len(data))])
            assert read_params(cut)["world"] == "paper-line"
            assert Recording(cut).entities

    @pytest.mark.parametrize(
        ("content", "said"),
        [
            (b"", "is empty"),
            (b"not at all", "is no Rerun recording"),
            (b"RRF2" + bytes(4), "cannot be re"),
            (None, "no such"),
        ],
    )
    def test_files_that_are_no_recordings(self, tmp_path, content, said):
        path = tmp_path / "a.rrd"
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(RecordingError, match=said):
            Recording(path)

    def test_a_recording_of_something_else(self, tmp_path):
        import rerun as rr

        rec = rr.RecordingStream("another")
        rec.save(tmp_path / "a.rrd")
        rec.log("x", rr.Scalars(1.0))
        rec.disconnect()
        with pytest.raises(RecordingError, match="not one of dualslam"):
            Recording(tmp_path / "a.rrd")

    def test_a_series_that_is_not_there(self, tmp_path):
        record(tmp_path / "a.rrd", 2)
        with pytest.raises(RecordingError, match="has no series /plots/n_eff/fs9"):
            read_series(tmp_path / "a.rrd", "/plots/n_eff/fs9")

    def test_a_full_disk_ends_the_run_and_keeps_what_there_is(self, tmp_path):
        path = tmp_path / "full.rrd"
        done = run_script(path, steps=59, pause=0.1, limit=600_000)
        told = [line for line in done.stdout.split() if line.isdigit()]
        assert done.returncode == 1
        assert len(told) < 59
        assert done.stdout.endswith("ended\n")
        assert done.stderr.count("RecordingLost: the recording") == 1
        assert "could not be written any further: file too large; what it held" in done.stderr
        assert path.stat().st_size <= 600_000
        assert 3 <= len(read_series(path, "/plots/n_eff/dfs")[0]) <= len(told) + 1

    def test_a_disk_that_is_full_already(self, tmp_path):
        done = run_script(tmp_path / "full.rrd", steps=2, limit=150_000)
        assert "RecordingError: --record" in done.stderr
        assert "full.rrd cannot be written: file too large" in done.stderr
        assert "1\n" not in done.stdout

    @pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a small disk")
    def test_the_reason_is_said_when_the_disk_is_full(self, tmp_path):
        disk = tmp_path / "disk"
        disk.mkdir()
        mounted = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=500k", "none", disk], check=False, capture_output=True
        )
        if mounted.returncode != 0:
            pytest.skip("mounting is not allowed here")
        try:
            done = run_script(disk / "full.rrd", steps=59, pause=0.1)
            assert "any further: the disk is full; what it held until then is kept" in done.stderr
        finally:
            subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("room", [400_000, 500_000, 700_000])
def test_a_full_disk_is_told_once_whenever_it_is_noticed(tmp_path, room):
    """The file is written behind the run's back: a short run may be over before anybody knows."""
    done = run_script(tmp_path / "full.rrd", steps=20, limit=room, particles=400)
    *told, last = done.stdout.split()
    assert done.returncode == 1
    assert last == "ended"
    assert told == [str(i) for i in range(1, len(told) + 1)]
    assert done.stderr.count("RecordingLost: the recording") == 1
    assert "could not be written any further: file too large" in done.stderr
    assert Recording(tmp_path / "full.rrd").filters() == ["dfs"]


AT_THE_END = """
import sys
from pathlib import Path
import numpy as np, rerun as rr, rerun.blueprint as rrb
from app.recording.stream import FileStream

stream = FileStream(Path({path!r}), rrb.Blueprint(), "full")
stream.begun()
rng = np.random.default_rng(0)  # 48 kB a step, which no compression makes much smaller
for stage in range(20):
    stream.set_time(stage)
    stream.log("/points", rr.Points3D(rng.random((4000, 3))))
print("logged", flush=True)
stream.close()
"""


def test_a_full_disk_that_nobody_asked_about_is_told_at_the_end(tmp_path):
    path = tmp_path / "full.rrd"
    done = run_limited([sys.executable, "-c", AT_THE_END.format(path=str(path))], limit=500_000)
    assert done.returncode == 1
    assert done.stdout == "logged\n"
    assert done.stderr.count("RecordingLost: the recording") == 1
    assert path.stat().st_size == 500_000


def test_a_recording_that_nobody_ended_is_complete(tmp_path):
    """The interpreter's exit writes what is left, and does not hang."""
    code = command(tmp_path / "a.rrd", steps=3)[-1].replace("session.run(", "(lambda info, o: o[0].begin(info))(")
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60, cwd=ROOT)
    assert read_params(tmp_path / "a.rrd")["world"] == "paper-line"


def test_a_step_without_truth_and_without_observations(tmp_path):
    info = info_of(3)
    recorder = Recorder(tmp_path / "a.rrd")
    recorder.begin(info)
    for step in session.steps(info):
        recorder.step(blind(step))
    recorder.end()
    recording = Recording(tmp_path / "a.rrd")
    assert "/world/truth/robot" not in recording.entities or not recording.timelines("/world/truth/robot")
    assert len(recording.series("/plots/n_eff/dfs")[0]) == 3


def blind(step: SessionStep) -> SessionStep:
    frame = step.frame._replace(z=np.zeros((0, 2)), tags=np.zeros(0, np.int64))
    filters = {k: u._replace(trace=u.trace._replace(n=u.trace.n[:, :0])) for k, u in step.filters.items()}
    return dataclasses.replace(step, truth=None, frame=frame, filters=filters)
