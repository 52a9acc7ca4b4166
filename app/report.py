"""What `dualslam run` shows: progress while it runs, then a table with a column for each filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from app.colours import of_filter
from app.compiling import CompileClock
from app.events import Blind
from app.paths import MATCHED, ODOMETRY
from app.relations import PathErrors
from app.rows import NEES, ROWS, UPDATE, Row, known, nees_text, nees_title, number
from app.summary import FilterSeries, Summary
from app.types import SessionInfo, SessionStep
from scenarios.logs.learning import Origin, odometry_believed, origin_of_belief
from scenarios.words import counted
from slam.features import Point
from slam.mistakes import MISTAKES
from slam.perception.odometry_noise import OdometryNoise

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
    how_long = f"{summary.seconds():.0f} s" if info.source.has_clock else "no time stamps"
    what = f"{counted(len(summary.steps), 'step')}, {how_long}, seed {info.seed}"
    console.print(f"[bold]{escape(info.source.name)}[/]  {escape(info.source.title)}", soft_wrap=True)
    console.print(f"{what}, {info.params.association} association")
    if info.mistake:
        wrong = f"wrong on purpose, {info.mistake}: {MISTAKES[info.mistake].told}"
        console.print(wrong, style="bold red", soft_wrap=True, markup=False)
    for sentence in on_odometry(info, summary):
        console.print(sentence, soft_wrap=True, markup=False)
    console.print()
    print_whole(console, table(summary))
    console.print()
    if alone := summary.errors_alone():
        errors = ", ".join(f"{key} alone {number(error)} m" for key, error in alone.items())
        console.print(f"position error, RMS, without a filter: {errors}", soft_wrap=True)
        console.print()
    if summary.paths is not None:
        titles = {key: series.title for key, series in summary.filters.items()}
        print_whole(console, relations_table(summary.paths, titles))
        console.print()
        for sentence in on_relations(summary.paths, titles):
            console.print(sentence, style="yellow", soft_wrap=True, markup=False)
    if summary.steps and not summary.observed:
        thing = "landmark" if isinstance(info.source.feature, Point) else "wall"
        console.print(f"no {thing} was seen in any of these steps: all of this is dead reckoning", style="yellow")
    elif summary.blind.steps:
        console.print(on_blindness(summary.blind, info.source.has_clock), style="yellow", soft_wrap=True)
    for key, series in summary.filters.items():
        events = [(step, text) for step, who, text in summary.faults if who == key]
        for step, text in events[:SHOWN_EVENTS]:
            console.print(f"[{_style(key)}]{series.title}[/], step {step}: {escape(text)}", soft_wrap=True)
        if len(events) > SHOWN_EVENTS:
            console.print(f"[{_style(key)}]{series.title}[/]: {counted(len(events) - SHOWN_EVENTS, 'more event')}")


def on_odometry(info: SessionInfo, summary: Summary) -> list[str]:
    """Sentences on the odometry of a log of a laser: what is believed to be wrong with it, and whether matching scans
    corrected it; of a world that only where it did."""
    told = []
    noise = odometry_believed(info.source.motion, info.params.believed)
    if noise is not None:
        told.append(in_words(noise, origin_of_belief(info.source, info.params.believed)))
    steps, used = summary.unmatched.total(), summary.unmatched[""]
    if steps:
        reasons = [f"{reason} ({count})" for reason, count in summary.unmatched.most_common() if reason]
        why = f"; not used: {', '.join(reasons)}" if reasons else ""
        told.append(f"scan matching: used in {used} of {counted(steps, 'step')}{why}")
    elif noise is not None:
        off = info.params.matching == "off"
        told.append(f"scan matching: {'off' if off else 'left alone, since the odometry is as good'}")
    return told


def on_blindness(blind: Blind, has_clock: bool) -> str:
    """A sentence on steps in which nothing was seen."""
    lasted = f"{blind.lasted:.0f} s" if has_clock else f"{blind.lasted:.0f} scans"
    return (
        f"nothing was seen for {lasted}, in {blind.steps} steps from step {blind.first} on (the longest such stretch): "
        "that is dead reckoning"
    )


ORIGINS: dict[Origin, str] = {
    "scans": "as its scans show",
    "guess": "at a guess, since its scans show too little of it",
    "given": "as given",
}
"""Where what is believed of an odometry comes from."""


def in_words(noise: OdometryNoise, origin: Origin) -> str:
    """What is believed to be wrong with an odometry."""
    per_metre, per_radian = math.degrees(noise.turn_per_metre), math.degrees(noise.turn_per_radian)
    return (
        f"odometry, {ORIGINS[origin]}, off by {number(noise.along)} m ahead, {number(noise.lateral)} m sideways and "
        f"{number(per_metre)}° after one metre, {number(noise.slip)} m and {number(per_radian)}° after a radian"
    )


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
            cells = [f"{number(metres)} m {number(math.degrees(angle))}°" for metres, angle in both]
        result.add_row(title, *cells, str(errors.used), str(errors.left_out))
    return result


def on_relations(paths: PathErrors, titles: Mapping[str, str]) -> list[str]:
    """Sentences on what the table does not say: that there was nothing to judge by, and which filters are worse than
    none."""
    found = paths.found()
    means = {key: errors.translation_m.mean for key, errors in found.items() if errors.translation_m is not None}
    if found and not means:
        return [f"none of the {len(paths.relations.times)} relations is between two scans of the part that was run"]
    told = []
    for key in titles:
        for alone in (ODOMETRY, MATCHED):
            if key in means and means[key] > means.get(alone, math.inf):
                told.append(
                    f"{titles[key]} is worse than {alone} alone: {number(means[key])} m against "
                    f"{number(means[alone])} m, in the mean of the relations"
                )
    return told


def _rows(summary: Summary) -> list[tuple[str, Callable[[FilterSeries], str]]]:
    """Name and content of each row; a row without any content is left out."""
    arrays = {
        series.title: {name: series.array(name) for name in series.series}
        | summary.errors(series)
        | {"seconds": np.array(series.seconds)}
        for series in summary.filters.values()
    }

    def cell(row: Row) -> Callable[[FilterSeries], str]:
        if row.key == NEES:
            return lambda series: nees_text(arrays[series.title]["nees"])
        return lambda series: row.text(row.value(arrays[series.title]))

    def association(series: FilterSeries) -> str:
        return " / ".join(str(n) for n in series.association.values()) if series.association else ""

    def speed(series: FilterSeries) -> str:
        if not summary.info.source.has_clock:
            return ""
        return f"{number(summary.seconds() / max(sum(series.seconds), 1e-12))} x"

    found: list[tuple[str, Callable[[FilterSeries], str]]] = [("particles", lambda s: str(s.particles))]
    steps = max((len(known(of["nees"])) for of in arrays.values()), default=0)
    for row in ROWS:
        if row.key == UPDATE:
            found.append(("right/wrong/missed", association))
        found.append((nees_title(steps) if row.key == NEES else row.title, cell(row)))
    return [*found, ("times real time", speed)]


def _style(key: str) -> str:
    red, green, blue = of_filter(key)
    return f"rgb({red},{green},{blue})"
