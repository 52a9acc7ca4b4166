"""What the studies have in common: options, and how results are shown and saved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app import values
from app.files import check_file, write_whole
from app.options import default
from app.report import print_whole
from app.session import flat
from app.study.jobs import cores
from app.summary import dump, plain
from slam.limits import Interval

SCHEMA = 1

MEANS = "± is the standard error of the mean"
MEDIANS = "median (smallest-largest)"

TITLES = {"dfs": "Dual FastSLAM", "fs2": "FastSLAM 2.0", "fs1": "FastSLAM 1.0", "ekf": "EKF-SLAM"}

RunsOption = Annotated[int, values.whole("--runs", "N", Interval(1))]
JobsOption = Annotated[int | None, values.whole("--jobs", "N", Interval(1, 256)), default("one for each core")]
OutOption = Annotated[Path | None, values.path("--out", "FILE.json"), default("not written")]
SeedOption = Annotated[int, values.whole("--seed", "N", Interval(0))]


def begin(out: Path | None, jobs: int | None) -> int:
    """Check the output before any work is done; returns the number of processes."""
    if out is not None:
        check_file("--out", out)
    return cores() if jobs is None else jobs


def finish(
    study: Any,
    name: str,
    command: str,
    results: dict[str, Any],
    tables: list[Table],
    runs: tuple[int, int],
    stopped: bool,
    note: str = MEANS,
    unit: str = "seeds",
    warnings: Sequence[str] = (),
) -> int:
    """Show the tables and the command that made them, save what there is; returns the exit code.

    runs: how many `unit` were done of how many.  `warnings`: what the tables alone would hide.
    """
    console = Console(highlight=False)
    for table in tables:
        print_whole(console, table)
        console.print()
    for warning in warnings:
        console.print(f"warning: {warning}", style="yellow", soft_wrap=True, markup=False)
    done, asked = runs
    console.print(f"{note}; {done} of {asked} {unit}\n{command}", soft_wrap=True, markup=False)
    if study.out is not None:
        options = {name: value for name, value in flat(study).items() if name not in ("out", "jobs")}
        saved = {"schema": SCHEMA, "study": name, "command": command, "options": options, unit: done, **results}
        write_whole(study.out, dump(plain(saved)))
        console.print(f"saved: {study.out}", soft_wrap=True, markup=False)
    if stopped:
        Console(stderr=True).print(_interrupted(done, asked, unit, saved=study.out is not None), soft_wrap=True)
    return 130 if stopped else 0


def _interrupted(done: int, asked: int, unit: str, saved: bool) -> str:
    if not done:
        return f"interrupted before the first of {asked} {unit} was done"
    return f"interrupted after {done} of {asked} {unit}; these are shown{' and saved' if saved else ''}"


def unseen(observed: Sequence[int]) -> list[str]:
    """A warning if some runs, which observed so many walls each, are nothing but dead reckoning."""
    blind = sum(not walls for walls in observed)
    if not blind:
        return []
    runs = f"{blind} of {len(observed)} runs" if blind < len(observed) else f"any of the runs ({blind})"
    return [f"no wall was ever seen in {runs}: these are dead reckoning"]


def empty_table(title: str, first: str, *columns: str) -> Table:
    """A table with names on the left and numbers on the right."""
    table = Table(title=escape(title), title_justify="left", title_style="bold", box=None, padding=(0, 2, 0, 0))
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(escape(column), justify="right", no_wrap=True)
    return table
