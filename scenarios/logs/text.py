"""Reading columns of numbers from text files, plain or gzipped, so that every complaint names file and line."""

from __future__ import annotations

import math
import re
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenarios.types import SourceError
from slam.types import Floats, Ints

GZIP_MAGIC = b"\x1f\x8b"
HEAD_BYTES = 1 << 16
"""How much of a file is looked at to recognise what it is."""

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class Role(NamedTuple):
    """What a file is in its data set."""

    kind: str
    """Such as `odometry`, in the reader's own words."""
    robot: int = 0
    """Whose it is; 0 for files that all robots share, and where there is but one."""


class Head(NamedTuple):
    """The beginning of a file, as far as it takes to recognise what it is."""

    path: Path
    comments: str
    """The lines that begin with `#`, in lower case."""
    rows: Floats
    """(n, c) the first lines of numbers, all of the commonest length; (0, 0) if there are none."""
    first_line: str
    """The first line that is neither blank nor a comment; empty if there is none."""
    words: frozenset[str] = frozenset()
    """What each line that is neither blank nor a comment begins with."""


@dataclass(frozen=True)
class Table:
    """Columns of finite numbers with the place where each row was read."""

    path: Path
    columns: tuple[str, ...]
    """Name and unit of each column, for messages."""
    values: Floats
    """(N, c)"""
    lines: Ints
    """(N,) line numbers, from 1."""
    warnings: tuple[str, ...] = field(default=())

    def place(self, row: int) -> str:
        """`file:line` of a row."""
        return f"{self.path}:{self.lines[row]}"

    def require(self, column: int, good: NDArray[np.bool_], expected: str) -> None:
        """Raise `SourceError` at the first row of `column` that is not `good` (N,)."""
        if not good.all():
            row = int(np.argmin(good))
            value = float(self.values[row, column])
            raise SourceError(f"{self.place(row)}: {self.columns[column]} is {value:.10g}; expected {expected}")

    def require_time_order(self) -> None:
        """Raise `SourceError` where the first column, time, runs backwards; equal times are in order.

        For streams that are merged with others by time: there, no order but that of time can be kept.
        """
        t = self.values[:, 0]
        backwards = np.flatnonzero(np.diff(t) < 0)
        if len(backwards):
            row = int(backwards[0]) + 1
            raise SourceError(
                f"{self.place(row)}: time runs backwards, from {t[row - 1]:.3f} s to {t[row]:.3f} s; "
                f"expected times in order, because this file is merged with others by time"
            )


def read_head(path: Path) -> Head:
    """The first `HEAD_BYTES` of a file.  Raises `SourceError` if it cannot be opened; content is not judged here."""
    data = _open_and_read(path, HEAD_BYTES)
    whole = len(data) < HEAD_BYTES
    if data.startswith(GZIP_MAGIC):
        inflate = zlib.decompressobj(wbits=31)
        try:
            data = inflate.decompress(data, HEAD_BYTES)
        except zlib.error:
            data = b""
        whole = inflate.eof
    lines = data.decode("utf-8-sig", errors="replace").splitlines()
    if not whole and len(lines) > 1:
        lines.pop()  # most likely only half of a line
    comments = [line for line in lines if line.lstrip().startswith("#")]
    content = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    rows = [[float(f) for f in fields] for fields in map(str.split, content) if all(map(NUMBER.fullmatch, fields))]
    lengths = [len(row) for row in rows]
    width = max(set(lengths), key=lengths.count, default=0)
    return Head(
        path=path,
        comments="\n".join(comments).lower(),
        rows=np.array([row for row in rows if len(row) == width], dtype=float).reshape(lengths.count(width), width),
        first_line=content[0].strip() if content else "",
        words=frozenset(line.split(None, 1)[0] for line in content),
    )


def read_table(path: Path, columns: tuple[str, ...]) -> Table:
    """All rows of a file, each of `len(columns)` finite numbers.  Blank lines and `#` comments are passed over.

    A last line that is cut short, and gzip data that end too early, become warnings.  Raises `SourceError`, naming
    file and line, for anything else that is not such a row, and for a file that cannot be read or has no row.
    """
    data, cut = read_all(path)
    if b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise SourceError(f"{path}:{line}: binary data; expected text with {_expected(columns)}")
    text = [line.decode("utf-8", errors="replace") for line in data.removeprefix(b"\xef\xbb\xbf").splitlines()]
    numbers = [i for i, line in enumerate(text) if (head := line.lstrip()) and head[0] != "#"]
    rows = [text[i] for i in numbers]
    warnings = []
    ended = data.endswith((b"\n", b"\r"))
    if cut:
        if rows and not ended and numbers[-1] == len(text) - 1:
            rows.pop()
        warnings.append(f"{path}:{max(len(text), 1)}: the gzip data are cut short after {len(rows)} rows")
    elif rows and _is_cut_short(rows, ended, len(columns)):
        warnings.append(
            f"{path}:{numbers[-1] + 1}: the last line {_shown(rows[-1])} is cut short and left out; "
            f"expected {_expected(columns)}"
        )
        rows.pop()
    if not rows:
        why = "; its gzip data are cut short" if cut else ""
        raise SourceError(f"{path}: no rows{why}; expected lines with {_expected(columns)}")
    lines = np.array(numbers[: len(rows)], dtype=np.int64) + 1
    return Table(path, columns, _parse(path, rows, lines, columns), lines, tuple(warnings))


def _parse(path: Path, rows: list[str], lines: Ints, columns: tuple[str, ...]) -> Floats:
    """(N, c).  In bulk; line by line only to find out which line is wrong."""
    try:
        values = np.loadtxt(rows, ndmin=2, comments="#")
        if values.shape[1] == len(columns) and np.isfinite(values).all():
            return values
    except ValueError:
        pass
    parsed = []
    for row, line in zip(rows, lines, strict=True):
        fields = row.split("#")[0].split()
        for text in fields:
            if not NUMBER.fullmatch(text) or not math.isfinite(float(text)):
                wrong = f"{_shown(text)} is not a finite number"
                raise SourceError(f"{path}:{line}: {wrong}; expected {_expected(columns)}")
        if len(fields) != len(columns):
            raise SourceError(f"{path}:{line}: {len(fields)} columns in {_shown(row)}; expected {_expected(columns)}")
        parsed.append([float(text) for text in fields])
    return np.array(parsed)


def _is_cut_short(rows: list[str], ended: bool, width: int) -> bool:
    """Whether the last row was not written to its end.

    A row with too few columns is, whatever follows it.  Without a line end, so is one with a fragment of a number, or
    with fewer decimals in its last column than the row above: `0.177` cut to `0.1` would otherwise pass as a number.
    """
    fields = rows[-1].split("#")[0].split()
    if len(fields) < width and all(map(NUMBER.fullmatch, fields[:-1])):
        return len(rows) > 1 or not ended
    if ended or len(fields) != width:
        return False
    if not NUMBER.fullmatch(fields[-1]):
        return fields[-1] in ("+", "-", ".", "-.", "+.") or bool(re.fullmatch(r"\S*\d\.?[eE][+-]?", fields[-1]))
    return len(rows) > 1 and _decimals(fields[-1]) < _decimals(rows[-2].split("#")[0].split()[-1])


def _decimals(number: str) -> int:
    return len(number.partition(".")[2])


def read_all(path: Path) -> tuple[bytes, bool]:
    """The content of a file, unpacked if it begins like gzip, and whether its gzip data are cut short."""
    data = _open_and_read(path)
    if not data.startswith(GZIP_MAGIC):
        return data, False
    unpacked = []
    while data.startswith(GZIP_MAGIC):  # gzip files may be several, one after the other
        inflate = zlib.decompressobj(wbits=31)
        try:
            unpacked.append(inflate.decompress(data))
        except zlib.error as error:
            raise SourceError(f"{path}: damaged gzip data ({error}); expected a whole file") from error
        if not inflate.eof:
            return b"".join(unpacked), True
        data = inflate.unused_data
    return b"".join(unpacked), False


def _open_and_read(path: Path, count: int = -1) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(count)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read ({error.strerror}); expected a file of a log") from error


def _expected(columns: tuple[str, ...]) -> str:
    return f"{len(columns)} columns: {', '.join(columns)}"


def _shown(text: str) -> str:
    text = text.strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")
