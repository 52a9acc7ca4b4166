"""Pictures of a folder as small PNGs: `python -m tests.benchmarks.gallery DIR`.

Every SVG in it, such as `dualslam study laser-log --picture DIR` writes, is drawn by a browser and put beside it.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

from PIL import Image

from tests.app.browser import browser

WIDTH = 1000
"""[pixels]"""

LARGEST = 120_000
"""[bytes] of a PNG."""

STYLE = f"<style>body {{margin: 0}} svg {{display: block; width: {WIDTH}px; height: auto}}</style>"

COLOURS = (64, 32, 16, 8)
"""The first number that leaves a picture small enough is taken."""


def main() -> None:
    """Convert, and say how large each has become."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    pictures = sorted(parser.parse_args().folder.glob("*.svg"))
    with browser() as chromium:
        page = chromium.new_page(viewport={"width": WIDTH, "height": WIDTH})
        for path in pictures:
            page.set_content(STYLE + path.read_text())
            found = small(page.locator("svg").screenshot())
            path.with_suffix(".png").write_bytes(found)
            print(f"{path.with_suffix('.png')}: {len(found) / 1e3:.0f} kB, from {path.stat().st_size / 1e3:.0f} kB")


def small(png: bytes) -> bytes:
    """The same picture with so few colours that it is small; rare ones, such as that of the letters, are not lost."""
    drawn = Image.open(io.BytesIO(png)).convert("RGB")
    found = b""
    for colours in COLOURS:
        file = io.BytesIO()
        drawn.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(file, "PNG", optimize=True)
        found = file.getvalue()
        if len(found) <= LARGEST:
            break
    return found


if __name__ == "__main__":
    main()
