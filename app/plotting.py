"""What all plots on paper have in common: letters, colours, and files.

Matplotlib draws them: plots want ticks, logarithms and letters that have a size, in pixels as well as in SVG, without a
browser.  It is loaded only where plots are wanted.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app import colours

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 9.0
"""[inches]"""

DOTS = 130
"""[1/inch] of the PNGs."""

ENDINGS = ("png", "svg")

LETTERS: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a8f98",
    "axes.labelcolor": "#33373d",
    "text.color": "#33373d",
    "xtick.color": "#33373d",
    "ytick.color": "#33373d",
    "grid.color": "#e3e6ea",
    "svg.hashsalt": "dualslam",
    "svg.fonttype": "none",
}
"""With letters as letters in SVG, and no random names: the same runs, the same file."""

BAND = "#dfe3e8"
"""Where the numbers of a consistent filter lie."""


def save(figure: Figure, folder: Path, name: str) -> None:
    """As PNG and as SVG, complete or not at all; without a date, so that the same runs give the same files."""
    for ending in ENDINGS:
        path, drawn = folder / f"{name}.{ending}", io.BytesIO()
        metadata: dict[str, Any] = {"Date": None} if ending == "svg" else {"Software": None}
        figure.savefig(drawn, format=ending, dpi=DOTS, metadata=metadata)
        figure.set_layout_engine("none")  # it is laid out; again would take as long
        part = path.with_name(f".{path.name}.part")
        try:
            part.write_bytes(drawn.getvalue())
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)


def readable(key: str) -> colours.RGB:
    """The colour of a filter, dark enough for letters on paper."""
    return colours.mix(colours.of_filter(key), (0, 0, 0), 0.25)


def hexadecimal(rgb: colours.RGB) -> str:
    """A colour as Matplotlib knows it."""
    return "#" + "".join(f"{part:02x}" for part in rgb)
