"""What `dualslam lesson` prints: the text, and the numbers beside what they should show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table
from rich.text import Text

from app.colours import of_filter
from app.lessons.lesson import Finding, Lesson
from app.lessons.watching import Ran
from app.report import print_whole

WIDTH = 100
"""Letters in a line of text, where the terminal has so many: more are hard to read."""


def print_text(text: str, console: Console) -> None:
    """Markdown, as a terminal has it; as it is, where there is no terminal."""
    if console.is_terminal:
        console.print(Markdown(text, code_theme="ansi_dark"), width=min(console.width, WIDTH))
    else:
        console.print(text, soft_wrap=True, markup=False)


def print_list(lessons: Mapping[str, Lesson], console: Console) -> None:
    """All lessons, a line each."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("lesson", style="bold", no_wrap=True, min_width=max(map(len, lessons)))
    table.add_column("")
    table.add_column("runs", justify="right")
    for lesson in lessons.values():
        table.add_row(lesson.name, lesson.title, str(len(lesson.variants)))
    print_whole(console, table)
    console.print("\nOne of them: dualslam lesson NAME", soft_wrap=not console.is_terminal)


def print_numbers(lesson: Lesson, runs: Mapping[str, Ran], console: Console) -> None:
    """A row for each filter of each run."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for title in ("run", "filter"):
        table.add_column(title, no_wrap=True)
    for column in lesson.columns:
        table.add_column(column.title, justify="right")
    for name, key, title, cells in rows(lesson, runs):
        red, green, blue = of_filter(key)
        table.add_row(name, Text(title, style=f"rgb({red},{green},{blue})"), *cells)
    print_whole(console, table)


def rows(lesson: Lesson, runs: Mapping[str, Ran]) -> list[tuple[str, str, str, Sequence[str]]]:
    """Run, key and title of a filter, and what its columns have; the name of a run stands once."""
    numbers, found = lesson.numbers(runs), []
    for name, ran in runs.items():
        for i, (key, series) in enumerate(ran.summary.filters.items()):
            cells = [column.form(numbers[name, key, column.key]) for column in lesson.columns]
            found.append((name if i == 0 else "", key, series.title, cells))
    return found


def verdict(finding: Finding, seed: int) -> str:
    """A sentence on whether the phenomenon is there in the runs of one seed."""
    if finding.seen:
        return finding.sentence
    return f"With seed {seed} it is not as the lesson says, which happens (see below). {finding.sentence}"


def came_out(lesson: Lesson, runs: Mapping[str, Ran], seed: int) -> str:
    """Markdown: the numbers of one seed, and the sentence on them."""
    head = f"| run | filter | {' | '.join(column.title for column in lesson.columns)} |"
    rule = f"|---|---|{'--:|' * len(lesson.columns)}"
    lines = [f"| {name} | {title} | {' | '.join(cells)} |" for name, _, title, cells in rows(lesson, runs)]
    table = "\n".join([head, rule, *lines])
    return f"Seed {seed}.\n\n{table}\n\n{verdict(lesson.phenomenon([runs]), seed)}"


def is_whole(lesson: Lesson, runs: Mapping[str, Ran]) -> bool:
    """Whether every number of the lesson is there: no run was ended before its time."""
    all_there = len(runs) == len(lesson.variants)
    return all_there and not any(math.isnan(value) for value in lesson.numbers(runs).values())
