"""What the page says of the present step: a table, the last event in words, and two small plots."""

from __future__ import annotations

import math

import numpy as np
import viser
import viser.uplot as uplot

from app import colours
from app.live.engine import Status
from app.live.trend import Trends
from app.options import FILTERS
from slam.estimators import ESTIMATORS
from slam.types import Floats

HEIGHT = 130
"""[px] of a plot."""


def headline(status: Status) -> str:
    """Where the session stands and what it does, in a line of markdown."""
    where = f"**{status.info.source.name}**, seed {status.info.seed}: step **{status.step}** of {status.total}"
    if status.branch:
        where += f", branch **{status.branch}**"
    if status.step < status.newest:
        where += f" (the newest is {status.newest})"
    doing = f"{status.rate:.0f} steps/s" if status.playing else "paused"
    return f"{where} - {doing}"


def message(status: Status) -> str:
    """What the person is to know, or the last event."""
    if status.message:
        return bold(status.message)
    if not status.told:
        return "Nothing worth telling has happened yet."
    step, branch, event = status.told[-1]
    where = f" ({branch})" if branch and branch != status.branch else ""
    return f"*{step}{where}: {_safe(event.text)}*"


def bold(text: str) -> str:
    """A sentence that is to be read."""
    return f"**{_safe(text)}**"


def table(status: Status) -> str:
    """A markdown table of the filters' measures."""
    rows = ["| | K | N_eff | diversity | error [m] | NEES | features | ms |", "|---|---|---|---|---|---|---|---|"]
    step = status.taken.step if status.taken else None
    for key, update in (step.filters if step else {}).items():
        m, K = update.measures, len(update.trace.weighted.log_w)
        of_many = (f"{m.n_eff / K:.0%}", f"{m.diversity:.0%}") if key != "ekf" else ("", "")
        title = f"{ESTIMATORS[key].title} ({colours.word(key)})"
        cells = [title, f"{K}", *of_many, _number(m.position_error_m), _number(m.nees_position), f"{m.features}"]
        rows.append(f"| {' | '.join(cells)} | {1e3 * update.seconds:.2g} |")
    return "\n".join(rows)


def _number(value: float) -> str:
    if math.isnan(value):
        return ""
    return "inf" if math.isinf(value) else f"{value:.3g}"


def _safe(text: str) -> str:
    """As text, whatever is in it."""
    return text.replace("<", "&lt;").replace("|", "\\|").replace("`", "'")


class Plot:
    """One measure of all filters over the last steps."""

    def __init__(self, gui: viser.GuiApi, title: str, high: float | None = None) -> None:
        series = [uplot.Series(label="step")]
        for key in FILTERS:
            colour = "rgb({},{},{})".format(*colours.of_filter(key))
            series.append(uplot.Series(label=ESTIMATORS[key].title, stroke=colour, width=2.0))
        scales = {"x": uplot.Scale(time=False)}
        if high is not None:
            scales["y"] = uplot.Scale(range=(0.0, high))
        grid = uplot.Axis_Grid(stroke="rgba(128,128,128,0.25)", width=1.0)
        axis = uplot.Axis(stroke="#aaa", grid=grid)
        self._handle = gui.add_uplot(
            data=_columns(np.zeros(0), {}),
            series=tuple(series),
            title=title,
            scales=scales,
            axes=(axis, axis),
            legend=uplot.Legend(show=False),
            height=HEIGHT,
            aspect=3.0,
        )

    def show(self, steps: Floats, values: dict[str, Floats]) -> None:
        """Steps (T,), and for every filter (T,)."""
        self._handle.data = _columns(steps, values)


def _columns(steps: Floats, values: dict[str, Floats]) -> tuple[Floats, ...]:
    if not len(steps):
        steps, values = np.array([0.0, 1.0]), {}
    return (steps, *(values.get(key, np.full(len(steps), np.nan)) for key in FILTERS))


class Plots:
    """N_eff and error."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._n_eff = Plot(gui, "N_eff / K", 1.02)
        self._error = Plot(gui, "position error [m]")

    def show(self, trends: Trends) -> None:
        """The last steps of the present branch."""
        self._n_eff.show(trends.steps, {k: v for k, v in trends.n_eff.items() if k != "ekf"})
        self._error.show(trends.steps, trends.error)
