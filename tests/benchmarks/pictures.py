"""The pictures of the README: `python -m tests.benchmarks.pictures [loop|live|compare ...]`.

Each is made by the commands that stand beside it there, in a temporary folder, and takes the place of the one before.
The page and the viewer draw in software, where there is no other way: some minutes for all three.
"""

from __future__ import annotations

import argparse
import io
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import sleep
from typing import Any

from PIL import Image, ImageChops

from tests.app.browser import DRAWN_AFTER, browser
from tests.app.viewer import Viewer

PLACE = Path(__file__).parents[2] / ".github" / "pictures"

WIDTH, HEIGHT = 1440, 810
"""[pixels]"""

COLOURS = 256

VISIBLE = 8
"""Of 255, a difference that one sees."""

STILL = 10.0
"""[s] after which what has not changed is thought to be complete."""

LATER = 600.0
"""[s] that may take."""

STOP_AT = re.compile(r"step (19|2\d)\d of")
"""What the page says when a person presses Pause: most of the loop is done."""


def main() -> None:
    """Make those that are asked for."""
    made: dict[str, Callable[[Path], bytes]] = {"loop": loop, "live": live, "compare": compare}
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of: {', '.join(made)}; all if none is named")
    names = parser.parse_args().names or list(made)
    if unknown := set(names) - set(made):
        parser.error(f"{', '.join(sorted(unknown))}: expected {', '.join(made)}")
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            found = small(made[name](Path(folder)))
        (PLACE / f"{name}.png").write_bytes(found)
        print(f"{PLACE / name}.png: {len(found) / 1e3:.0f} kB")


def loop(folder: Path) -> bytes:
    """The recording of a run, in the viewer."""
    dualslam(folder, "run loop --filters dfs fs2 fs1 ekf --record loop.rrd")
    with Viewer(folder / "loop.rrd") as viewer:
        viewer.seek("step", 318)
        return still(viewer.screenshot)


def compare(folder: Path) -> bytes:
    """Two of them beside each other."""
    dualslam(folder, "run loop --particles 30 --record before.rrd")
    dualslam(folder, "run loop --particles 100 --record after.rrd")
    dualslam(folder, "compare before.rrd after.rrd --out comparison")
    with Viewer(folder / "comparison" / "compare.rrd") as viewer:
        viewer.seek("step", 300)
        return still(viewer.screenshot)


def live(folder: Path) -> bytes:
    """The page, paused on its way."""
    process = started(folder, "live loop --filters dfs fs2 --paused --no-browser")
    try:
        assert process.stdout is not None
        line = next(line for line in process.stdout if "http://" in line)
        with browser() as chromium:
            tab = chromium.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            tab.goto(line.split()[-1])
            panel = tab.frame_locator("#panel iframe")
            press(panel, "Play")
            panel.get_by_text(STOP_AT).first.wait_for(timeout=1e3 * DRAWN_AFTER)
            press(panel, "Pause")
            panel.get_by_role("tab", name="Diagnosis").click()
            notice = panel.locator(".mantine-Notification-closeButton")  # that it draws in software
            if notice.count():
                notice.first.click()
            return still(lambda: tab.screenshot(timeout=1e3 * DRAWN_AFTER))
    finally:
        process.terminate()
        process.wait()


def press(panel: Any, button: str) -> None:
    """Click on it, as soon as it is there."""
    panel.get_by_role("button", name=button, exact=True).click(timeout=1e3 * DRAWN_AFTER)


def still(screenshot: Callable[[], bytes]) -> bytes:
    """PNG of what does not change any more, but for words such as how late something is."""
    shown = screenshot()
    for _ in range(round(LATER / STILL)):
        sleep(STILL)
        before, shown = shown, screenshot()
        if difference(before, shown) < 1e-3:
            return shown
    raise TimeoutError(f"it still changes after {LATER:.0f} s")


def difference(before: bytes, after: bytes) -> float:
    """Share of the pixels that differ."""
    pictures = [Image.open(io.BytesIO(png)).convert("RGB") for png in (before, after)]
    counts = ImageChops.difference(*pictures).convert("L").histogram()
    return sum(counts[VISIBLE:]) / sum(counts)


def small(png: bytes) -> bytes:
    """The same, as wide as all are, with few colours; grey backgrounds stay grey."""
    drawn = Image.open(io.BytesIO(png)).convert("RGB")
    drawn = drawn.resize((WIDTH, round(WIDTH * drawn.height / drawn.width)), Image.Resampling.LANCZOS)
    file = io.BytesIO()
    drawn.quantize(COLOURS, kmeans=3, dither=Image.Dither.NONE).save(file, "PNG", optimize=True)
    return file.getvalue()


def dualslam(folder: Path, words: str) -> None:
    """Run a command there, to its end."""
    if started(folder, words, subprocess.DEVNULL).wait() != 0:
        raise RuntimeError(f"dualslam {words} has failed")


def started(folder: Path, words: str, output: int = subprocess.PIPE) -> subprocess.Popen[str]:
    """A command there."""
    code = f"import sys; sys.path.insert(0, {str(PLACE.parents[1])!r}); from app.cli import entry; sys.exit(entry())"
    return subprocess.Popen([sys.executable, "-c", code, *words.split()], cwd=folder, stdout=output, text=True)


if __name__ == "__main__":
    main()
