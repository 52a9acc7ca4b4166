"""What the page says of the present step: a table, the last event in words, and two small plots."""

from __future__ import annotations

import math

import numpy as np
import viser
import viser.uplot as uplot

from app import colours
from app.live.engine import Status
from app.live.trend import Now, Trend, Trends
from app.options import FILTERS
from app.recording.ground import known
from app.session import estimators
from app.types import SessionInfo
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
    told = [(step, event) for step, branch, event in status.told if branch == status.branch and step <= status.step]
    if not told:
        return "*nothing worth telling so far*"
    step, _ = told[-1]
    texts = [event.text for at, event in told if at == step]
    more = f" (and {len(texts) - 1} more)" if len(texts) > 1 else ""
    return f"*{step}: {_safe(texts[-1])}{more}*"


def beside_parent(status: Status, trend: Trend, trunk: str) -> str:
    """How a branch differs at the present step from what it left: a markdown table; empty where nothing is to say."""
    parents = {name: (parent, at) for name, parent, at, _ in status.branches}
    parent, left_at = parents.get(status.branch, ("", status.step))
    if not status.branch or status.step <= left_at:
        return ""
    here, there = trend.at(status.branch, status.step), trend.at(parent, status.step)
    both = [key for key in here if key in there]
    if not both:
        return f"*{parent or trunk} has no step {status.step} to compare with*"
    judged = any(not math.isnan(here[key].error) for key in both)
    names = ["", *(("error, m",) if judged else ()), "N_eff", "diversity"]
    lines = [f"**Beside {parent or trunk}**, whose numbers at step {status.step} are in brackets:\n", *_head(names)]
    return "\n".join([*lines, *(_beside(key, here[key], there[key], judged) for key in both)])


def _beside(key: str, here: Now, there: Now, judged: bool) -> str:
    cells = [f"{_number(here.error)} ({_number(there.error)})"] if judged else []
    of_many = (f"{here.n_eff:.0%} ({there.n_eff:.0%})", f"{here.diversity:.0%} ({there.diversity:.0%})")
    cells += of_many if key != "ekf" else ("", "")
    return f"| {ESTIMATORS[key].title} | {' | '.join(cells)} |"


def _head(names: list[str]) -> list[str]:
    """Of a markdown table: the first column is words, the others are numbers."""
    return [f"| {' | '.join(names)} |", "|---" + "|--:" * (len(names) - 1) + "|"]


def bold(text: str) -> str:
    """A sentence that is to be read."""
    return f"**{_safe(text)}**"


def table(status: Status) -> str:
    """A markdown table of the filters' measures."""
    judged = knows_truth(status.info)
    names = ["", "K", "N_eff", "diversity", *(("error, m", "NEES") if judged else ()), "features", "ms"]
    rows = _head(names)
    step = status.taken.step if status.taken else None
    for key, update in (step.filters if step else {}).items():
        m, K = update.measures, len(update.trace.weighted.log_w)
        of_many = (f"{m.n_eff / K:.0%}", f"{m.diversity:.0%}") if key != "ekf" else ("", "")
        (shown,) = estimators([key], status.info.mistake)
        title = f"{shown.title} ({colours.word(key)})"
        errors = (_number(m.position_error_m), _number(m.nees_position)) if judged else ()
        cells = [title, f"{K}", *of_many, *errors, f"{m.features}"]
        rows.append(f"| {' | '.join(cells)} | {_number(1e3 * update.seconds)} |")
    return "\n".join(rows)


def knows_truth(info: SessionInfo) -> bool:
    """Whether somebody knows where the robot is, at some step at least: of many logs nobody does."""
    return info.source.kind == "world" or any(known(step.truth) for step in info.source.steps[: info.steps])


def _number(value: float) -> str:
    if math.isnan(value):
        return ""
    if math.isinf(value):
        return "inf"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def _safe(text: str) -> str:
    """As text, whatever is in it."""
    return text.replace("<", "&lt;").replace("|", "\\|").replace("`", "'")


class Plot:
    """One measure of all filters over the last steps."""

    def __init__(self, gui: viser.GuiApi, title: str, high: float | None = None) -> None:
        self._high = high
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

    def visible(self, on: bool) -> None:
        """Show it, or leave no room for it."""
        if self._handle.visible != on:
            self._handle.visible = on

    def show(self, steps: Floats, values: dict[str, Floats]) -> None:
        """Steps (T,), and for every filter (T,)."""
        if self._high is None:  # the browser finds no range among numbers that are not there
            highest = max((float(np.nanmax(v)) for v in values.values() if np.isfinite(v).any()), default=1.0)
            self._handle.scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(range=(0.0, 1.05 * highest or 1.0))}
        self._handle.data = _columns(steps, values)


def _columns(steps: Floats, values: dict[str, Floats]) -> tuple[Floats, ...]:
    if not len(steps):
        steps, values = np.array([0.0, 1.0]), {}
    return (steps, *(values.get(key, np.full(len(steps), np.nan)) for key in FILTERS))


class Plots:
    """N_eff and error."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._n_eff = Plot(gui, "N_eff / K", 1.05)
        self._error = Plot(gui, "position error [m]")

    def show(self, trends: Trends, judged: bool) -> None:
        """The last steps of the present branch; `judged`, if errors can be known."""
        self._error.visible(judged)
        self._n_eff.show(trends.steps, {k: v for k, v in trends.n_eff.items() if k != "ekf"})
        self._error.show(trends.steps, trends.error)
