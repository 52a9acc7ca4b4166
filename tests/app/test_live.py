"""`dualslam live` as people start it: a process, a page, a browser, Ctrl-C."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pytest

from app.recording.reading import Recording, open_reader
from tests.app.browser import DRAWN_AFTER, browser, picture, watched
from tests.app.sockets import family, listening

PATIENCE = 120.0
"""[s] a fresh machine compiles first."""

COMMAND = [sys.executable, "-c", "from app.cli import entry; import sys; sys.exit(entry())", "live"]


class Process:
    """A running `dualslam live`, and what it says."""

    def __init__(self, arguments, directory):
        self.said = directory / "said.txt"
        self.file = self.said.open("w")
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2]), "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            [*COMMAND, *arguments, "--no-browser"], cwd=directory, env=environment,
            stdout=self.file, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def wait_for(self, pattern, patience=PATIENCE):
        until = time.monotonic() + patience
        while time.monotonic() < until:
            found = re.search(pattern, self.said.read_text())
            if found:
                return found
            if self.process.poll() is not None:
                break
            time.sleep(0.05)
        raise AssertionError(f"{pattern!r} was not said, but: {self.said.read_text()}")

    @property
    def url(self):
        return self.wait_for(r"ready after [\d.]+ s: (http://127\.0\.0\.1:\d+/)")[1]

    def end(self, signal_number=signal.SIGINT):
        children = family(self.process.pid)
        self.process.send_signal(signal_number)
        code = self.process.wait(PATIENCE)
        until = time.monotonic() + 10.0
        while any(Path(f"/proc/{pid}").exists() for pid in children) and time.monotonic() < until:
            time.sleep(0.05)
        assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]
        return code


@contextmanager
def live(directory, *arguments):
    running = Process(arguments, directory)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.kill()
            running.process.wait()
        running.file.close()


def replayed(directory, script, *more, expected=0):
    code = "from app.cli import entry; import sys; sys.exit(entry())"
    arguments = [sys.executable, "-c", code, "run", "--replay", str(script), *more]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(arguments, cwd=directory, env=environment, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == expected, done.stderr
    return done.stderr + done.stdout


def test_it_starts_plays_listens_here_only_and_ends(tmp_path):
    with live(tmp_path, "paper-line", "--record", "a.rrd", "--particles", "20") as running:
        url = running.url
        addresses = listening(running.process.pid)
        assert len(addresses) >= 4  # the page, the panel, Rerun's server and the relay to it
        assert {address for address, _ in addresses} == {"127.0.0.1"}
        with urllib.request.urlopen(url, timeout=10.0) as answer:
            assert b"iframe" in answer.read()
        time.sleep(2.0)
        assert running.end() == 0
        for _, port in addresses:
            with pytest.raises(OSError, match="refused"):
                urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=2.0)
        assert "Traceback" not in running.said.read_text()
        saved = running.wait_for(r"saved a\.rrd: (\d+) steps", 1.0)
        steps = int(saved[1])
        assert steps > 3
        script = json.loads((tmp_path / "a.json").read_text())
        assert script["branches"][0]["steps"] == steps
        assert Recording(tmp_path / "a.rrd").series("/plots/n_eff/dfs")[0].tolist() == list(range(1, steps + 1))
        with pytest.raises(RuntimeError):
            open_reader(tmp_path / "a.rrd").store()  # of which there would be an index in memory all the time
        assert "bit for bit" in replayed(tmp_path, "a.json")
        script["branches"][0]["digest"] = "0"
        (tmp_path / "other.json").write_text(json.dumps(script))
        assert "NOT" in replayed(tmp_path, "other.json", expected=1)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_before_anything_has_happened(tmp_path, number):
    with live(tmp_path, "loop", "--paused", "--viewer", "none") as running:
        assert running.url
        assert {address for address, _ in listening(running.process.pid)} == {"127.0.0.1"}
        assert running.end(number) == 0


def test_what_cannot_be_is_one_sentence(tmp_path):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for arguments, words in (
            (["paper-line", "--port", str(port)], ["--port", str(port)]),
            (["paper-line", "--port", "80"], ["--port is 80", "between 1024 and 65535"]),
            (["paper-line", "--viewer", "glass"], ["--viewer", "web"]),
            (["paper-line", "--viewer", "native"], ["--viewer native", "screen"]),
            (["paper-line", "--particles", "50000"], ["--particles is 50000", "20000"]),
            (["nowhere"], ["nowhere"]),
            (["paper-line", "--record", "a.txt"], ["--record a.txt", ".rrd"]),
            (["paper-line", "--particles", "0"], ["--particles is 0"]),
        ):
            with live(tmp_path, *arguments) as running:
                assert running.process.wait(PATIENCE) == 2
                said = running.said.read_text()
            assert "Traceback" not in said
            assert all(word in said for word in words), said
            assert said.count("dualslam: ") == 1


def panel_of(tab):
    return tab.frame_locator("#panel iframe")


def press(tab, name):
    panel_of(tab).get_by_role("button", name=name, exact=True).click(timeout=1e3 * DRAWN_AFTER)


def see(tab, text):
    panel_of(tab).get_by_text(re.compile(text)).first.wait_for(timeout=1e3 * DRAWN_AFTER)


def slide(tab, label, presses, key="ArrowRight"):
    """Move the slider that stands beside a label, with the keyboard."""
    frame = panel_of(tab)
    sliders = frame.get_by_role("slider")
    labels = frame.get_by_text(label, exact=True)
    labels.first.wait_for(timeout=1e3 * DRAWN_AFTER)
    y = labels.first.bounding_box()["y"]
    count = sliders.count()
    nearest = min(range(count), key=lambda i: abs((sliders.nth(i).bounding_box() or {"y": 1e9})["y"] - y))
    slider = sliders.nth(nearest)
    slider.focus()
    for _ in range(presses):
        slider.press(key)
    return slider.get_attribute("aria-valuenow")


def test_a_person_with_a_browser(tmp_path):
    """Both halves are drawn; particles and noise change by hand; step, pause, branch, record and reset by click."""
    world = ["loop", "--features", "landmarks", "--laps", "5"]  # longer than a slow browser needs to press Pause
    with live(tmp_path, *world, "--paused", "--particles", "50", "--filters", "dfs", "fs2") as running:
        with browser() as chromium:
            tab = chromium.new_page(viewport={"width": 1440, "height": 900})
            _, errors = watched(tab)
            tab.goto(running.url)
            see(tab, r"step 0 of")
            press(tab, "Step")
            see(tab, r"step 1 of")

            panel_of(tab).get_by_role("tab", name="Record").click()
            press(tab, "Record")
            see(tab, "recording session.rrd")
            panel_of(tab).get_by_role("tab", name="Filter").click()
            assert slide(tab, "particles K", 45) == "500"
            press(tab, "Step")
            see(tab, r"step 2 of")
            panel_of(tab).get_by_role("tab", name="Now").click()
            see(tab, "^500$")

            panel_of(tab).get_by_role("tab", name="Noise").click()
            slide(tab, "range [m]", 10)
            press(tab, "Step")
            see(tab, r"step 3 of")

            press(tab, "Play")
            see(tab, r"step [1-9]\d+ of")
            press(tab, "Pause")
            see(tab, "paused")

            press(tab, "Step back")
            panel_of(tab).get_by_role("tab", name="Time", exact=True).click()
            press(tab, "Branch from here")
            press(tab, "Step")
            see(tab, r"\d+-again")

            shown = picture(tab, "#view")
            tab.screenshot(path=tmp_path / "page.png", timeout=1e3 * DRAWN_AFTER)
            panel_of(tab).get_by_role("tab", name="Record").click()
            press(tab, "Stop recording")
            see(tab, "saved session.rrd")
            panel_of(tab).get_by_role("tab", name="Run").click()
            press(tab, "Reset")
            see(tab, r"step 0 of")
            assert len(shown) > 10_000  # both halves are there: an empty one compresses to nothing
            assert not [error for error in errors if "favicon" not in error]
        assert running.end() == 0
    script = json.loads((tmp_path / "session.json").read_text())
    trunk, branch = script["branches"]
    assert [change["step"] for change in trunk["changes"]] == [1, 2, 3]
    assert trunk["changes"][1]["params"]["particles"] == 500
    before, after = (trunk["changes"][i]["noise"]["range"] for i in (1, 2))
    assert after == pytest.approx(before + 0.01)
    assert trunk["changes"][2]["params"]["believed"]["range"] == after
    assert branch["at"] == trunk["steps"] - 1
    assert "bit for bit" in replayed(tmp_path, "session.json", "--branch", branch["name"])
    recording = Recording(tmp_path / "session.rrd")
    assert recording.series("/plots/n_eff/dfs")[0].tolist() == list(range(2, trunk["steps"] + 1))
    assert any(entity.startswith("/branch/") for entity in recording.entities)
