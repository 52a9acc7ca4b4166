"""Plots of several runs: a panel for each filter in its colour, a line for each run; PNG and SVG."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from app import colours
from app.compare.numbers import Comparison
from app.compare.runs import Run
from app.plotting import BAND, ENDINGS, LETTERS, WIDTH, hexadecimal, readable, save
from slam.metrics import nees_interval
from slam.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DASHES: tuple[Any, ...] = (
    "solid",
    (0, (4, 1.6)),
    (0, (1.2, 1.2)),
    (0, (6, 1.6, 1.2, 1.6)),
    (0, (9, 2)),
    (0, (3, 1.2, 1.2, 1.2, 1.2, 1.2)),
    (0, (2, 3)),
    (0, (12, 2, 2, 2)),
)
"""Of the runs, beside their shades."""

ALIKE = 5.0
"""Factor between the highest values of filters above which each has its own scale: runs are to be compared."""

LOG_FLOOR = 1e-2
"""Of the NEES: what is below is drawn there."""

LOG_TOP = 1e6
"""The same for what is above, infinity included."""


class Plot(NamedTuple):
    """One measure over the steps."""

    name: str
    """Of the files."""
    title: str
    """Of the axis, with the unit."""
    values: Callable[[dict[str, Floats]], Floats]
    population: bool = False
    """Not for a filter of one particle."""
    top: float | None = None
    """Where the axis ends, if that is known."""
    logarithmic: bool = False


def _clipped(nees: Floats) -> Floats:
    return np.clip(nees, LOG_FLOOR, LOG_TOP)


PLOTS = (
    Plot("position-error", "position error [m]", lambda s: s["position_error_m"]),
    Plot("heading-error", "heading error [°]", lambda s: np.degrees(s["heading_error_rad"])),
    Plot(
        "nees",
        "NEES of the position (10⁶: infinite)",
        lambda s: _clipped(s["nees"]),
        logarithmic=True,
    ),
    Plot("n-eff", "N_eff [particles]", lambda s: s["n_eff"], population=True),
    Plot("diversity", "diversity [%]", lambda s: 100.0 * s["diversity"], population=True, top=103.0),
    Plot("features", "features", lambda s: s["features"]),
    Plot("update", "time of a step [ms]", lambda s: 1e3 * s["seconds"], logarithmic=True),
)


def draw(found: Comparison, folder: Path) -> list[str]:
    """Write all plots for which there is something to draw; returns their names without an ending."""
    import matplotlib as mpl

    with mpl.rc_context(LETTERS):
        figures = [(plot.name, figure) for plot in PLOTS if (figure := over_steps(plot, found)) is not None]
        figures.append(("paths", _paths(found)))
        for name, figure in figures:
            save(figure, folder, name)
    return [name for name, _ in figures]


def names() -> list[str]:
    """All files that `draw` may write."""
    return [f"{name}.{ending}" for name in (*(p.name for p in PLOTS), "paths") for ending in ENDINGS]


def over_steps(plot: Plot, found: Comparison) -> Figure | None:
    """A panel for each filter, all with the same axes; None if nobody has a value."""
    from matplotlib.figure import Figure

    shown = [one for one in found.filters if not (plot.population and one.key == "ekf")]
    drawn = [(one, [plot.values(column.series) for column in one.columns]) for one in shown]
    drawn = [(one, values) for one, values in drawn if not all(np.isnan(v).all() for v in values)]
    if not drawn:
        return None
    figure = Figure(figsize=(WIDTH, 0.9 + 1.75 * len(drawn)), layout="constrained")
    shared = plot.logarithmic or _alike([np.nanmax(np.concatenate(values)) for _, values in drawn])
    panels = figure.subplots(len(drawn), 1, sharex=True, sharey=shared, squeeze=False)[:, 0]
    for axes, (one, values) in zip(panels, drawn, strict=True):
        title = one.title if shared else f"{one.title} (a scale of its own)"
        axes.set_title(title, loc="left", color=hexadecimal(readable(one.key)))
        axes.grid(visible=True)
        axes.set_axisbelow(True)
        if plot.name == "nees":
            _band(axes)
        for column, line in zip(one.columns, values, strict=True):
            axes.plot(one.steps, line, **_style(one.key, found.runs.index(column.run)))
        axes.margins(x=0.01)
    for axes in panels:  # when everything is drawn: shared axes fit what was drawn until their limits are set
        if plot.logarithmic:
            axes.set_yscale("log")
        else:
            axes.set_ylim(bottom=0.0, top=plot.top)
    panels[-1].set_xlabel("step")
    figure.supylabel(plot.title, fontsize=9)
    _legend(figure, "upper", [*_keys(found.runs), *([_key_of_band()] if plot.name == "nees" else [])])
    return figure


def _alike(highest: Sequence[float]) -> bool:
    """Whether panels that reach so high can have one scale, without one of them being flat."""
    return max(highest) <= ALIKE * min(highest)


def _paths(found: Comparison) -> Figure:
    """All paths in one map, on what is known of the truth."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    places = [run.place(int(found.steps[-1])) for run in found.runs]
    every = [
        line for place in places for lines in (place.truth, *place.paths.values(), place.true_walls) for line in lines
    ]
    spread = np.ptp(np.concatenate([*every, *(p for place in places for p in place.true_landmarks)]), axis=0)
    height = float(np.clip(WIDTH * spread[1] / max(spread[0], 1e-9), 0.35 * WIDTH, 1.1 * WIDTH))
    figure = Figure(figsize=(WIDTH, height + 0.9), layout="constrained")
    axes = figure.subplots()
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(visible=True)
    axes.set_axisbelow(True)
    for place in _different(places):
        for wall in place.true_walls:
            axes.plot(*wall.T, color="#c3c8ce", linewidth=2.2, solid_capstyle="butt", zorder=1.5)
        for points in place.true_landmarks:
            axes.plot(*points.T, "+", color="#9aa1a9", markersize=6, zorder=1.5)
        for line in place.truth:
            axes.plot(*line.T, color=hexadecimal(colours.TRUTH), linewidth=2.8, alpha=0.45, zorder=1.8)
    for one in found.filters:
        for column in one.columns:
            rank = found.runs.index(column.run)
            for line in places[rank].paths[one.key]:
                axes.plot(*line.T, **_style(one.key, rank))
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    truth = [Line2D([], [], color=hexadecimal(colours.TRUTH), linewidth=2.8, alpha=0.45, label="truth")]
    filters = [
        Line2D([], [], color=hexadecimal(readable(one.key)), linewidth=4, label=one.title) for one in found.filters
    ]
    _legend(figure, "upper", list(_keys(found.runs)))
    _legend(figure, "lower", [*filters, *(truth if any(place.truth for place in places) else [])])
    return figure


def _different(places: Sequence[Any]) -> Iterator[Any]:
    """Those whose truth was not drawn yet: most comparisons are of one world."""
    drawn: list[Any] = []
    for place in places:
        mine = [*place.truth, *place.true_walls, *place.true_landmarks]
        if not any(len(mine) == len(other) and all(map(np.array_equal, mine, other)) for other in drawn):
            drawn.append(mine)
            yield place


def _band(axes: Axes) -> None:
    low, high = nees_interval(2)
    axes.axhspan(max(low, LOG_FLOOR), high, color=BAND, zorder=0.5, linewidth=0)


def _key_of_band() -> Any:
    from matplotlib.patches import Patch

    low, high = nees_interval(2)
    return Patch(color=BAND, label=f"95 % of a consistent filter: {low:.2f} to {high:.2f}")


def _keys(runs: Sequence[Run]) -> Iterator[Any]:
    """The runs in the legend, in grey: their shades and dashes are those of every filter."""
    from matplotlib.lines import Line2D

    for rank, run in enumerate(runs):
        tone = hexadecimal(colours.of_run((128, 128, 128), rank, on_dark=False))
        yield Line2D([], [], color=tone, linestyle=DASHES[rank], linewidth=1.6, label=run.name)


def _legend(figure: Figure, edge: str, keys: Sequence[Any]) -> None:
    """Above or below everything, where there are no lines."""
    place: Any = f"outside {edge} left"
    figure.legend(handles=list(keys), loc=place, ncols=5, frameon=False, handlelength=3.2)


def _style(key: str, rank: int) -> dict[str, Any]:
    rgb = colours.of_run(colours.of_filter(key), rank, on_dark=False)
    return {"color": hexadecimal(rgb), "linestyle": DASHES[rank], "linewidth": 1.1, "zorder": 3.0 - 0.01 * rank}
