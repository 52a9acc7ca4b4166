"""Ctrl-C and SIGTERM in the middle of a run: everything so far is saved, exit code 130."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent.parent
PROGRAM = "import sys; from app.cli import entry; sys.exit(entry())"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_everything_so_far_is_saved(tmp_path, number):
    record, summary, paths = tmp_path / "r.rrd", tmp_path / "s.json", tmp_path / "paths"
    world = ["run", "field", "--length", "1000", "--particles", "300", "--filters", "fs2", "ekf"]
    outputs = ["--record", str(record), "--summary", str(summary), "--trajectory", str(paths)]
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *world, *outputs],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        _wait_for(lambda: record.exists() and record.stat().st_size > 600_000, process)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "interrupted after" in err

    found = json.loads(summary.read_text())
    steps = found["steps"]
    assert not found["complete"]
    assert steps > 0
    assert f"interrupted after {steps} of" in err
    assert len(found["filters"]["fs2"]["n_eff"]) == steps
    assert len(np.loadtxt(paths / "fs2.tum", ndmin=2)) == steps
    assert "FastSLAM 2.0" in out
    assert str(record) in out


TOLD = """
import sys
from app.interrupt import Interrupts

enter = Interrupts.__enter__
Interrupts.__enter__ = lambda self: (enter(self), print("ready", flush=True))[0]
"""
"""The program says when it begins to listen to signals: before that, there is nobody to tell."""


@pytest.mark.parametrize(("number", "delay"), [(signal.SIGINT, 0.0), (signal.SIGTERM, 0.2), (signal.SIGINT, 3.0)])
def test_loading_and_compiling_are_interrupted_too(tmp_path, number, delay):
    """The delays are meant to fall into imports and into the compilation of kernels, but any will do."""
    process = subprocess.Popen(
        [sys.executable, "-c", TOLD + PROGRAM, "run", "field", "--length", "1000"],
        cwd=ROOT,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(delay)
        process.send_signal(number)
        _, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "saved" not in err
    assert err.count("interrupted") == 1


def test_a_reader_that_goes_away_is_no_failure():
    command = [sys.executable, "-c", PROGRAM, "run", "paper-line", "--steps", "3", "--filters", "ekf"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.close()
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "Traceback" not in err
    assert "BrokenPipe" not in err


def _wait_for(ready, process, seconds: float = 120.0):
    until = time.monotonic() + seconds
    while not ready():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until, "it never began"
        time.sleep(0.05)
