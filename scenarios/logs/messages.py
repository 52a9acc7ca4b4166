"""Logs of messages: one a line, which begins with a word that says what it is."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scenarios.logs.text import read_all
from scenarios.types import SourceError
from slam.types import Floats, Ints


class BrokenError(ValueError):
    """What is wrong with one line, without its place."""


class Messages(NamedTuple):
    """A file, line by line."""

    path: Path
    lines: list[bytes]
    by_word: dict[str, list[int]]
    """Which lines begin with a word, blank lines and comments aside."""
    last: int
    """The last of these, which may have been cut short; -1 if there is none."""

    def place(self, index: int) -> str:
        """`file:line`, from an index into the lines."""
        return f"{self.path}:{index + 1}"


class Numbers(NamedTuple):
    """Those of messages of one kind that have as many readings each."""

    rows: Ints
    """(G,) which messages of the kind."""
    n: int
    """Readings in each."""
    readings: Floats
    """(G, n)"""
    rest: Floats
    """(G, ...) what else counts."""


def read_messages(path: Path, known: re.Pattern[str], word: re.Pattern[str]) -> tuple[Messages, list[str]]:
    """The lines of a file by their first word, and warnings.

    `known` are the words that need no warning.  Raises `SourceError` at a line that begins with something that is not
    even such a `word`, unless it is the last one, cut short.
    """
    data, cut = read_all(path)
    lines = data.removeprefix(b"\xef\xbb\xbf").splitlines()
    warnings = []
    if cut:
        if lines and not data.endswith((b"\n", b"\r")):
            lines.pop()
        warnings.append(f"{path}:{max(len(lines), 1)}: the gzip data are cut short here")
    found: dict[bytes, list[int]] = {}
    last = -1
    for index, line in enumerate(lines):
        first = line.split(None, 1)[:1]
        if first and not first[0].startswith(b"#"):
            found.setdefault(first[0], []).append(index)
            last = index
    by_word = {first.decode("utf-8", errors="replace"): at for first, at in found.items()}
    messages = Messages(path, lines, by_word, last)
    return messages, warnings + _odd_words(messages, known, word)


def _odd_words(messages: Messages, known: re.Pattern[str], word: re.Pattern[str]) -> list[str]:
    unknown = {first: at[0] for first, at in messages.by_word.items() if not known.fullmatch(first)}
    broken = min((at for first, at in unknown.items() if not word.fullmatch(first)), default=messages.last + 1)
    if broken < messages.last:
        line = messages.lines[broken].decode("utf-8", errors="replace").strip()
        raise SourceError(
            f"{messages.place(broken)}: {line[:40]!r} is no message; expected one that begins with a word"
        )
    warnings = []
    if messages.last in unknown.values():  # half of a word, or of a number
        warnings.append(f"{messages.place(messages.last)}: the last line is cut short and left out")
    passed = {first: at for first, at in unknown.items() if at != messages.last}
    if passed:
        names = ", ".join(sorted(passed))
        warnings.append(f"{messages.place(min(passed.values()))}: messages that are not known are passed over: {names}")
    return warnings


def numbers(
    messages: Messages, word: str, fields_of: Callable[[Sequence[bytes]], list[bytes]]
) -> tuple[list[Numbers], list[str]]:
    """The numbers of all messages of a kind, and a warning if the last line of the file is one and cut short.

    `fields_of` a line's words are the number of readings n, these, and what else counts; it raises `BrokenError`.  In
    bulk; line by line only to find out which line is wrong.  Raises `SourceError` for that one.
    """
    at, warnings = messages.by_word[word], []
    if at[-1] == messages.last and len(at) > 1:
        try:
            floats(fields_of(messages.lines[at[-1]].split()))
        except BrokenError as broken:
            at = at[:-1]
            warnings.append(f"{messages.place(messages.last)}: the last line is cut short and left out: {broken}")
    groups: dict[tuple[bytes, int], tuple[list[int], list[bytes]]] = {}
    for row, index in enumerate(at):
        try:
            fields = fields_of(messages.lines[index].split())
        except BrokenError as broken:
            raise SourceError(f"{messages.place(index)}: {word}: {broken}") from None
        rows, texts = groups.setdefault((fields[0], len(fields)), ([], []))
        rows.append(row)
        texts.append(b" ".join(fields))
    found = []
    for (count, _), (rows, texts) in groups.items():
        values, n = _parse(messages, word, [at[row] for row in rows], texts), int(count)
        found.append(Numbers(np.array(rows), n, values[:, 1 : 1 + n], values[:, 1 + n :]))
    return found, warnings


def _parse(messages: Messages, word: str, at: Sequence[int], texts: list[bytes]) -> Floats:
    try:
        return np.loadtxt(texts, ndmin=2, comments=None)
    except ValueError:
        for index, text in zip(at, texts, strict=True):
            try:
                floats(text.split())
            except BrokenError as broken:
                raise SourceError(f"{messages.place(index)}: {word}: {broken}") from None
        raise


def count_of(fields: Sequence[bytes], at: int) -> int:
    """The number of readings, as one field tells it.  Raises `BrokenError`."""
    if len(fields) <= at:
        raise BrokenError(f"it ends after {len(fields) - 1} fields")
    if not fields[at].isdigit() or len(fields[at]) > 9:
        raise BrokenError(f"{_shown(fields[at])} is no number of readings")
    return int(fields[at])


def floats(fields: Sequence[bytes]) -> list[float]:
    """The fields as numbers, NaN and infinite ones included.  Raises `BrokenError`."""
    found = []
    for field in fields:
        try:
            found.append(float(field.replace(b"_", b"?")))  # Python would pass over it
        except ValueError:
            raise BrokenError(f"{_shown(field)} is no number") from None
    return found


def _shown(field: bytes) -> str:
    return repr(field.decode("utf-8", errors="replace")[:40])
