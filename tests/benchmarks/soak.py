"""A live session for long: `python -m tests.benchmarks.soak [--minutes M]`.

Three filters with 200 particles at ten steps a second, recorded to a file, with one browser that looks and one that is
frozen.  Says, and exits with 1 unless: no step is lost in the file; the session keeps its pace; memory stays within
`PROCESS` and `SERVER`.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from app.recording.reading import Recording
from tests.app.browser import browser
from tests.app.sockets import family
from tests.app.test_live import Process

PROCESS = 1500.0
"""[MB] of the process itself, of which snapshots may have a part (`app.live.history`)."""

SERVER = 900.0
"""[MB] of Rerun's server, which keeps 256 MB for viewers who come late."""

PACE = 10.0
"""[1/s]"""


def resident(pid: int) -> float:
    """[MB] that a process holds in memory; 0 if it is no more."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    return next((float(line.split()[1]) / 1024 for line in text.splitlines() if line.startswith("VmRSS")), 0.0)


def main() -> int:
    """Run, print; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=2.0)
    minutes = parser.parse_args().minutes
    laps = str(max(2, int(minutes * 60 * PACE / 150) + 2))
    with tempfile.TemporaryDirectory() as folder, browser() as chromium:
        directory = Path(folder)
        arguments = ["loop", "--laps", laps, "--particles", "200", "--record", "soak.rrd", "--paused"]
        running = Process(arguments, directory)
        pid = running.process.pid
        play, before = opened(chromium, running.url), renderers()
        opened(chromium, running.url)
        frozen = renderers() - before
        for child in frozen:
            os.kill(child, signal.SIGSTOP)
        play.evaluate("button => button.click()")
        began, sizes = monotonic(), []
        while monotonic() - began < 60.0 * minutes:
            sleep(2.0)
            server = max((resident(child) for child in family(pid) if child != pid), default=0.0)
            sizes.append((monotonic() - began, resident(pid), server))
        seconds = monotonic() - began
        for child in frozen:
            with suppress(ProcessLookupError):  # a browser ends a page that does not answer for minutes
                os.kill(child, signal.SIGCONT)
        code = running.end()
        steps = Recording(directory / "soak.rrd").series("/plots/n_eff/dfs")[0].tolist()
        size = (directory / "soak.rrd").stat().st_size / 1024
        said = running.said.read_text()
    quarter = [row for row in sizes if row[0] > 0.25 * seconds]
    growth = (quarter[-1][1] - quarter[0][1]) / max((quarter[-1][0] - quarter[0][0]) / 60.0, 1e-9)
    server = max(row[2] for row in sizes)
    count = max(len(steps), 1)
    print(f"{minutes:g} minutes: {count} steps, {count / seconds:.1f}/s; the file has {size / count:.0f} KiB a step")
    print(f"process: {quarter[0][1]:.0f} to {sizes[-1][1]:.0f} MB, {growth:.1f} MB/min; its server: {server:.0f} MB")
    good = {
        "ended well": code == 0 and "Traceback" not in said,
        "no step lost": bool(steps) and steps == list(range(1, len(steps) + 1)),
        "kept its pace": len(steps) > 0.4 * PACE * seconds,
        "memory of the process": max(row[1] for row in sizes) < PROCESS,
        "memory of the server": server < SERVER,
    }
    for what, so in good.items():
        print(f"{'yes' if so else 'NO '}  {what}")
    return 0 if all(good.values()) else 1


def opened(chromium: Any, url: str) -> Any:
    """The button that plays, of the page in a browser window of its own."""
    tab = chromium.new_context(viewport={"width": 900, "height": 600}).new_page()
    tab.goto(url)
    play = tab.frame_locator("#panel iframe").get_by_role("button", name="Play", exact=True)
    play.wait_for(timeout=120_000)
    return play


def renderers() -> set[int]:
    """The processes that draw pages."""
    found = subprocess.run(["pgrep", "-f", "type=renderer"], capture_output=True, text=True, check=False).stdout.split()
    return {int(pid) for pid in found} & set(family(os.getpid()))


if __name__ == "__main__":
    sys.exit(main())
