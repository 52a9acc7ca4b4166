"""The numbers as tables: one for each filter, with a column for each run and its difference from the first."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rich.table import Table
from rich.text import Text

from app.colours import of_filter
from app.compare.numbers import Column, Comparison, Filter
from app.rows import ROWS, Row, number

Cells = tuple[str, list[str]]
"""The title of a row, and what stands in it."""


def header(one: Filter, found: Comparison) -> list[str]:
    """Titles of the columns: the runs, and the differences of all but the first that has the filter."""
    titles = []
    for run in found.runs:
        titles.append(run.name)
        if run is not one.columns[0].run:
            titles.append(f"{run.name} - {one.columns[0].run.name}" if one.column(run) else "")
    return titles


def rows(one: Filter, found: Comparison) -> Iterator[Cells]:
    """Every row in which somebody has a number."""
    yield "particles", _particles(one, found)
    for row in ROWS:
        if any(one.text(row, column) for column in one.columns):
            yield one.title_of(row), _cells(row, one, found)


def difference(row: Row, one: Filter, column: Column) -> str:
    """From the first column, in the unit of the row, and in percent of that; `=` for no difference at all."""
    mine, first = column.values[row.key], one.columns[0].values[row.key]
    if mine == first:
        return "="
    apart = row.factor * one.difference(row, column)
    if math.isnan(apart):
        return ""
    text = f"{'+' if apart > 0 else ''}{_short(apart)}"
    if row.unit == "%":
        return f"{text} points"
    if not first:
        return text
    share = 100.0 * (mine - first) / abs(first)
    return f"{text} ({share:+.0f} %)" if abs(share) < 1000 else text


def filter_table(one: Filter, found: Comparison) -> Table:
    """For a terminal."""
    red, green, blue = of_filter(one.key)
    result = Table(box=None, padding=(0, 2, 0, 0), show_edge=False)
    result.add_column(Text(one.title, style=f"bold rgb({red},{green},{blue})"), no_wrap=True)
    for title in header(one, found):
        result.add_column(Text(title), justify="right", no_wrap=True)
    for title, cells in rows(one, found):
        result.add_row(title, *cells)
    return result


def markdown(one: Filter, found: Comparison) -> str:
    """For a page of a recording."""
    lines = [[one.title, *header(one, found)], ["---", *("---:" for _ in header(one, found))]]
    lines += [[title, *cells] for title, cells in rows(one, found)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _particles(one: Filter, found: Comparison) -> list[str]:
    cells = []
    for run in found.runs:
        column = one.column(run)
        cells.append(str(column.particles) if column else "-")
        if run is not one.columns[0].run:
            apart = column.particles - one.columns[0].particles if column else 0
            cells.append("" if column is None else f"{apart:+d}" if apart else "=")
    return cells


def _cells(row: Row, one: Filter, found: Comparison) -> list[str]:
    cells = []
    for run in found.runs:
        column = one.column(run)
        cells.append((column and one.text(row, column)) or "-")
        if run is not one.columns[0].run:
            cells.append(difference(row, one, column) if column else "")
    return cells


def _short(value: float) -> str:
    return number(value) if abs(value) < 1e6 else f"{value:.1e}"
