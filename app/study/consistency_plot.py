"""The picture of `dualslam study consistency`: NEES averaged over runs, step by step, beside its chi-square band."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from app import colours
from app.diagnosis.findings import several
from app.plotting import BAND, LETTERS, WIDTH, hexadecimal, save
from app.study.output import TITLES
from slam.metrics import nees_interval
from slam.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS = {"position": ("position", 2), "x": ("x", 1), "y": ("y", 1), "heading": ("heading", 1)}
"""By the name of an average: title, and degrees of freedom."""

LOWEST, HIGHEST = 0.1, 30.0
"""What is beyond, infinity included, is drawn there: how far beyond does not matter, and the band stays to be seen."""


def draw(averages: Mapping[str, Mapping[str, Floats]], world: str, particles: int, runs: int, folder: Path) -> str:
    """Write PNG and SVG; returns their name without an ending.

    `averages` has, for each filter, the mean (T,) over so many runs of the NEES of each of `PANELS`.
    """
    import matplotlib as mpl

    folder.mkdir(parents=True, exist_ok=True)
    name = f"consistency-{world}"
    with mpl.rc_context(LETTERS):
        save(figure_of(averages, f"{world}, {several(particles, 'particle')}", runs), folder, name)
    return name


def figure_of(averages: Mapping[str, Mapping[str, Floats]], title: str, runs: int) -> Figure:
    """A panel for the position and one for each component, a line for each filter."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(WIDTH, 1.1 + 1.75 * len(PANELS)), layout="constrained")
    panels = figure.subplots(len(PANELS), 1, sharex=True, sharey=True)
    for axes, (name, (what, freedom)) in zip(panels, PANELS.items(), strict=True):
        low, high = nees_interval(freedom, runs)
        axes.set_title(f"{what}: {freedom} expected, 95 % of means within {low:.2f} to {high:.2f}", loc="left")
        axes.axhspan(low, high, color=BAND, zorder=0.5, linewidth=0)
        axes.axhline(freedom, color="#8a8f98", linewidth=0.7, zorder=0.6)
        for key, of_filter in averages.items():
            _line(axes, key, of_filter[name])
    panels[0].set_yscale("log")
    panels[0].set_ylim(LOWEST / 1.15, HIGHEST * 1.15)
    panels[0].yaxis.set_major_formatter("{x:g}")
    panels[-1].xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    panels[-1].set_xlabel("step")
    figure.supylabel(f"NEES, mean of {several(runs, 'run')} ({HIGHEST:g}: so much or more)", fontsize=9)
    figure.suptitle(title, x=0.01, ha="left", fontsize=9.5)
    keys = [Line2D([], [], color=_tone(key), linewidth=2.0, label=TITLES[key]) for key in averages]
    band = Patch(color=BAND, label="95 % of a consistent filter")
    figure.legend(handles=[*keys, band], loc="outside lower left", ncols=5, frameon=False)
    return figure


def _line(axes: Axes, key: str, values: Floats) -> None:
    steps = np.arange(1, len(values) + 1)
    marker = "o" if len(steps) == 1 else ""  # a line of one point is not to be seen
    axes.plot(steps, np.clip(values, LOWEST, HIGHEST), color=_tone(key), linewidth=1.6, marker=marker, markersize=4)
    axes.margins(x=0.01)
    axes.grid(visible=True)
    axes.set_axisbelow(True)


def _tone(key: str) -> str:
    return hexadecimal(colours.of_filter(key))
