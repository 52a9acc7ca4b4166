"""What `dualslam run` shows: progress while it runs, then a table with a column for each filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from app.colours import of_filter
from app.compiling import CompileClock
from app.relations import PathErrors
from app.summary import FilterSeries, Summary
from app.types import SessionInfo, SessionStep
from slam.features import Point
from slam.metrics import nees_interval, rms
from slam.types import Floats

SHOWN_EVENTS = 3
"""Of each filter."""

COMPILING = "compiling, for this and all later runs ..."


class ProgressBar:
    """An observer that shows how far the session is, on a terminal; elsewhere only that something is compiled."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress: Progress | None = None
        self._task = TaskID(0)
        self._clock = CompileClock(self._compiling)
        self._said = False

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self._clock.__enter__()
        if self._console.is_terminal:
            progress = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed}/{task.total} steps"),
                TimeRemainingColumn(compact=True),
                TextColumn("{task.fields[n_eff]}", markup=True),
                console=self._console,
                transient=True,
            )
            progress.start()
            self._task = progress.add_task(info.source.name, total=info.steps, n_eff="")
            self._progress = progress
        self._name = info.source.name

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        if self._progress:
            particles = {key: len(update.trace.weighted.log_w) for key, update in step.filters.items()}
            shares = {key: step.filters[key].measures.n_eff / K for key, K in particles.items() if K > 1}
            n_eff = " ".join(f"[{_style(key)}]{key}[/] {share:4.0%}" for key, share in shares.items())
            self._progress.update(self._task, completed=step.index, n_eff=f"N_eff {n_eff}" if shares else "")

    def end(self) -> None:
        """After the last step."""
        self._clock.__exit__()
        if self._progress:
            self._progress.stop()
            self._progress = None

    def _compiling(self, now: bool) -> None:
        if self._progress:
            self._progress.update(self._task, description=COMPILING if now else self._name, refresh=True)
        elif now and not self._said:
            self._console.print(COMPILING)
        self._said = True


def print_report(info: SessionInfo, summary: Summary, console: Console) -> None:
    """What was run, the table, and what went wrong on the way."""
    what = f"{len(summary.steps)} steps, {summary.seconds():.0f} s, seed {info.seed}"
    console.print(f"[bold]{escape(info.source.name)}[/]  {escape(info.source.title)}")
    console.print(f"{what}, {info.params.association} association")
    console.print()
    print_whole(console, table(summary))
    console.print()
    if summary.paths is not None:
        print_whole(console, relations_table(summary.paths, {key: s.title for key, s in summary.filters.items()}))
        console.print()
    if summary.steps and not summary.observed:
        thing = "landmark" if isinstance(info.source.feature, Point) else "wall"
        console.print(f"no {thing} was seen in any of these steps: all of this is dead reckoning", style="yellow")
    for key, series in summary.filters.items():
        events = [(step, text) for step, who, text in summary.faults if who == key]
        for step, text in events[:SHOWN_EVENTS]:
            console.print(f"[{_style(key)}]{series.title}[/], step {step}: {escape(text)}", soft_wrap=True)
        if len(events) > SHOWN_EVENTS:
            console.print(f"[{_style(key)}]{series.title}[/]: {len(events) - SHOWN_EVENTS} more events")


def print_whole(console: Console, content: Table) -> None:
    """Print a table as wide as it is: a file or a pipe has no width that it would have to fit.

    A terminal has, but none in which a number would be cut: then its lines are longer, and the terminal breaks them.
    """
    least, natural = content.__rich_measure__(console, console.options.update(width=1000))
    former, console.width = console.width, max(console.width, least if console.is_terminal else natural)
    try:
        console.print(content, crop=False)
    finally:
        console.width = former


def table(summary: Summary) -> Table:
    """Rows are measures, columns are filters."""
    result = Table(box=None, padding=(0, 2, 0, 0), show_edge=False)
    result.add_column("")
    for key, series in summary.filters.items():
        result.add_column(Text(series.title, style=f"bold {_style(key)}"), justify="right")
    for name, cell in _rows(summary):
        cells = [cell(series) for series in summary.filters.values()]
        if any(cells):
            result.add_row(name, *(text or "-" for text in cells))
    return result


def relations_table(paths: PathErrors, titles: Mapping[str, str]) -> Table:
    """A row for odometry and each filter: how far its path is off the relations, and by what angle."""
    result = Table(box=None, padding=(0, 2, 0, 0), show_edge=False)
    result.add_column("relations")
    for name in ("mean", "deviation", "median", "95 %", "largest", "used", "left out"):
        result.add_column(name, justify="right")
    for key, errors in paths.found().items():
        title = Text(titles[key], style=f"bold {_style(key)}") if key in titles else Text(key)
        cells = ["-"] * 5
        if errors.translation_m is not None and errors.rotation_rad is not None:
            both = zip(errors.translation_m, errors.rotation_rad, strict=True)
            cells = [f"{_number(metres)} m {_number(math.degrees(angle))}°" for metres, angle in both]
        result.add_row(title, *cells, str(errors.used), str(errors.left_out))
    return result


def _rows(summary: Summary) -> list[tuple[str, Callable[[FilterSeries], str]]]:
    """Name and content of each row; a row without any content is left out."""
    errors = {series.title: summary.errors(series) for series in summary.filters.values()}

    def known(series: FilterSeries, name: str) -> Floats:
        values = errors[series.title][name]
        return values[~np.isnan(values)]

    def error(name: str, measure: Callable[[Floats], float], unit: str, factor: float = 1.0) -> Any:
        def cell(series: FilterSeries) -> str:
            values = known(series, name)
            return f"{_number(factor * measure(values))} {unit}" if len(values) else ""

        return cell

    def consistency(series: FilterSeries) -> str:
        values = known(series, "nees")
        finite = values[np.isfinite(values)]
        if not len(values):
            return ""
        mean = float(np.mean(finite)) if len(finite) else math.inf
        text = _number(mean) if mean < 1e6 else "inf" if math.isinf(mean) else "> 10⁶"
        return text + (f" ({len(values) - len(finite)} inf)" if len(finite) < len(values) else "")

    def association(series: FilterSeries) -> str:
        return " / ".join(str(n) for n in series.association.values()) if series.association else ""

    def last(name: str, form: Callable[[float], str]) -> Callable[[FilterSeries], str]:
        def cell(series: FilterSeries) -> str:
            value = series.array(name)[-1]
            return "" if math.isnan(value) else form(value)

        return cell

    def milliseconds(measure: Callable[[Floats], float]) -> Callable[[FilterSeries], str]:
        return lambda series: f"{1e3 * measure(np.array(series.seconds)):.3g} ms"

    lengths = {len(known(series, "nees")) for series in summary.filters.values()}
    low, high = nees_interval(2, max(lengths, default=1) or 1)
    return [
        ("particles", lambda s: str(s.particles)),
        ("position error, end", error("position_error_m", lambda v: v[-1], "m")),
        ("position error, RMS", error("position_error_m", rms, "m")),
        ("position MSE", error("position_error_m", lambda v: float(np.mean(v**2)), "m²")),
        ("best particle, RMS", error("best_position_error_m", rms, "m")),
        ("heading error, RMS", error("heading_error_rad", rms, "°", math.degrees(1))),
        (f"NEES ({low:.2f} to {high:.2f})", consistency),
        ("diversity, end", last("diversity", lambda v: f"{100 * v:.3g} %")),
        ("N_eff, median", lambda s: f"{np.median(s.array('n_eff')):.3g}"),
        ("resamplings", lambda s: str(int(s.array("resampled").sum()))),
        ("features", last("features", lambda v: f"{v:.0f}")),
        ("duplicates", last("duplicates_so_far", lambda v: f"{v:.0f}")),
        ("right/wrong/missed", association),
        ("update, median", milliseconds(np.median)),
        ("update, p95", milliseconds(lambda v: float(np.percentile(v, 95)))),
        ("times real time", lambda s: f"{_number(summary.seconds() / max(sum(s.seconds), 1e-12))} x"),
    ]


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _style(key: str) -> str:
    red, green, blue = of_filter(key)
    return f"rgb({red},{green},{blue})"
