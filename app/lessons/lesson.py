"""What a lesson is: runs, a text to read before and after them, and what of it shows in numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from app.lessons.equations import EQUATIONS, Equation, as_text
from app.lessons.watching import Ran

Numbers = Mapping[tuple[str, str, str], float]
"""By the name of a variant, the key of a filter, and that of a column; NaN where a run has nothing of it."""

_EQUATIONS = re.compile(r"^\$[a-z0-9-]+\$$(?:\n+^\$[a-z0-9-]+\$$)*", re.MULTILINE)
"""Lines of a text that stand for some of `EQUATIONS`, one below the other."""


Drawn = Callable[[Sequence[Equation]], str]
"""Makes Markdown of some equations, one below the other."""


class Variant(NamedTuple):
    """One of the runs of a lesson."""

    name: str
    """Unique in the lesson, for people."""
    options: str
    """World and options, as they are typed behind `dualslam run`."""


class Column(NamedTuple):
    """A number of each filter of each run."""

    key: str
    title: str
    value: Callable[[Ran, str], float]
    """Of a run and the key of a filter in it; NaN where that is not known."""
    form: Callable[[float], str]
    """How it is written."""


class Finding(NamedTuple):
    """Whether the phenomenon of a lesson is there."""

    seen: bool
    sentence: str
    """What came out, with the numbers."""


@dataclass(frozen=True)
class Lesson:
    """A guided demonstration.  Texts are Markdown, where a line `$name$` is one of `EQUATIONS`."""

    name: str
    title: str
    idea: str
    """What it is about, with the world and the equations."""
    question: str
    """To answer before anybody looks."""
    watch: str
    """Where to look in the recording or on the page."""
    point: str
    """What is to be remembered."""
    measured: str
    """How often the phenomenon was seen, and over how many seeds that was counted."""
    variants: tuple[Variant, ...]
    columns: tuple[Column, ...]
    claim: Callable[[Numbers], Finding]
    """The phenomenon, in the numbers of one seed or in medians over several."""

    def numbers(self, runs: Mapping[str, Ran]) -> dict[tuple[str, str, str], float]:
        """All columns of the runs of one seed, by the name of the variant."""
        return {
            (name, key, column.key): column.value(ran, key)
            for name, ran in runs.items()
            for key in ran.summary.filters
            for column in self.columns
        }

    def phenomenon(self, seeds: Sequence[Mapping[str, Ran]]) -> Finding:
        """Whether it is there, in the medians over the runs of several seeds."""
        each = [self.numbers(runs) for runs in seeds]
        return self.claim({of: float(np.median([numbers[of] for numbers in each])) for of in each[0]})

    def before(self, equations: Drawn = as_text) -> str:
        """Markdown: what to read before anything is run."""
        return _written(f"# {self.title}\n\n{self.idea}\n\n## Before you look\n\n{self.question}\n", equations)

    def after(self, equations: Drawn = as_text) -> str:
        """Markdown: what to read beside the runs and after them."""
        runs = "\n".join(f"- **{name}**: `dualslam run {options}`" for name, options in self.variants)
        return _written(
            f"## What to watch\n\n{self.watch}\n\n## The point\n\n{self.point}\n\n## How sure is that?\n\n"
            f"{self.measured}\n\n## The runs\n\n{runs}\n",
            equations,
        )

    def text(self, equations: Drawn = as_text, found: str = "") -> str:
        """Markdown: all of it, with what came out, if that is known already."""
        came_out = f"## What came out\n\n{found}\n\n" if found else ""
        return f"{self.before(equations)}\n{came_out}{self.after(equations)}"


def _written(text: str, equations: Drawn) -> str:
    return _EQUATIONS.sub(lambda lines: equations([EQUATIONS[line.strip("$")] for line in lines[0].split()]), text)


def percent(value: float) -> str:
    """`4 %`, `0.1 %`, or `-` for NaN."""
    if math.isnan(value):
        return "-"
    return f"{100 * value:.0f} %" if value == 0.0 or value >= 0.01 else f"{100 * value:.1g} %"


def metres(value: float) -> str:
    """With a unit that suits the size."""
    if math.isnan(value):
        return "-"
    if value >= 0.995:
        return f"{value:.2g} m" if value < 10 else f"{value:.0f} m"
    return f"{100 * value:.2g} cm" if value >= 0.00995 else f"{1000 * value:.2g} mm" if value else "0"


def count(value: float) -> str:
    """Two digits, or all before the point; words for what is infinite."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "infinite"
    return f"{value:.2g}" if value < 10 else f"{value:.0f}" if value < 1e5 else f"{value:.0e}"
