"""The lessons as the page has them: each of their runs can be chosen, and its text is beside it."""

from __future__ import annotations

import functools
import re

from app.lessons import LESSONS
from app.lessons.drawn import as_pictures
from app.lessons.lesson import Lesson, Variant
from app.lessons.running import info_of
from app.types import SessionInfo

SEPARATOR = ": "


def name_of(lesson: Lesson, variant: Variant) -> str:
    """What people call one of the runs."""
    return f"{lesson.name}{SEPARATOR}{variant.name}"


_ALL = {name_of(lesson, variant): (lesson, variant) for lesson in LESSONS.values() for variant in lesson.variants}

NAMES = tuple(_ALL)
"""Of all runs of all lessons."""


def open_lesson(name: str, seed: int) -> SessionInfo:
    """The session of one of `NAMES`."""
    return info_of(_ALL[name][1], seed, "live")


@functools.cache
def text_of(name: str) -> tuple[tuple[str, str], ...]:
    """The text of its lesson: pieces of Markdown, each with what follows, equations as HTML.

    Headings are smaller than in the text: the panel is narrow.
    """
    text = _ALL[name][0].text(lambda equations: f"{_MARK}{as_pictures(equations)}{_MARK}")
    pieces = re.sub(r"^#", "###", text, flags=re.MULTILINE).split(_MARK)
    return tuple(zip(pieces[::2], [*pieces[1::2], ""], strict=True))


_MARK = "\0"
