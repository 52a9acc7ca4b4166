"""Typed access to a TOML table: every error names the key by its path, and every key must be a known one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from scenarios.checks import nearest, suggestion
from scenarios.types import SourceError

_NO_DEFAULT: Any = object()


class Table:
    """One table of a parsed file; `end()` complains of keys that nobody asked for."""

    def __init__(self, values: dict[str, Any], path: str = "") -> None:
        self._values = values
        self._path = path
        self._known: list[str] = []

    def __contains__(self, key: str) -> bool:
        """Whether the file has this key; asking makes it a known one."""
        self._known.append(key)
        return key in self._values

    def path(self, key: str) -> str:
        """Of a key, from the top of the file: `route.speed`."""
        return f"{self._path}.{key}" if self._path else key

    def text(self, key: str, default: str = _NO_DEFAULT, words: Iterable[str] = ()) -> str:
        """A string; one of `words` if there are any."""
        value = self._get(key, default, "a text in quotes", str)
        words = list(words)
        if words and value not in words:
            raise SourceError(f"{self.path(key)} is '{value}'; {suggestion(value, words)}")
        return value

    def number(self, key: str, default: float = _NO_DEFAULT) -> float:
        """An integer or float, never NaN."""
        value = self._get(key, default, "a number", int, float)
        return value if value is default else _as_float(self.path(key), value)

    def integer(self, key: str, default: int = _NO_DEFAULT) -> int:
        """A whole number written without a decimal point."""
        return self._get(key, default, "a whole number", int)

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self._values[key] if key in self else None
        if not isinstance(value, bool):
            raise SourceError(f"{self.path(key)} is {_shown(value)}; expected true or false")
        return value

    def angle(self, key: str, default: float = _NO_DEFAULT) -> float:
        """[rad] from `<key>_deg` or, where no number of degrees gives the same bits, `<key>_rad`."""
        degrees, radians = f"{key}_deg", f"{key}_rad"
        if radians in self:
            if degrees in self:
                raise SourceError(f"{self.path(radians)} and {self.path(degrees)} are both there; expected one")
            return self.number(radians)
        if degrees not in self and default is not _NO_DEFAULT:
            return default
        return math.radians(self.number(degrees))

    def numbers(self, key: str, size: int, default: tuple[float, ...] = _NO_DEFAULT) -> tuple[float, ...]:
        """A list of so many numbers."""
        row = self._get(key, default, f"a list of {_numbers(size)}", list)
        return row if row is default else self._row(self.path(key), row, size)

    def points(self, key: str) -> tuple[tuple[float, float], ...]:
        """A list of [x, y]."""
        return tuple((x, y) for x, y in self._rows(key, 2, "[x, y]"))

    def segments(self, key: str) -> tuple[tuple[float, ...], ...]:
        """A list of [x0, y0, x1, y1]."""
        return tuple(self._rows(key, 4, "[x0, y0, x1, y1]"))

    def _rows(self, key: str, size: int, what: str) -> list[tuple[float, ...]]:
        rows = self._get(key, _NO_DEFAULT, f"a list of {what}", list)
        return [self._row(f"{self.path(key)}[{i}]", row, size, what) for i, row in enumerate(rows)]

    def integers(self, key: str) -> list[int]:
        """A list of whole numbers."""
        values = self._get(key, _NO_DEFAULT, "a list of whole numbers", list)
        for i, value in enumerate(values):
            if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 2**63:
                raise SourceError(f"{self.path(key)}[{i}] is {_shown(value)}; expected a whole number")
        return values

    def table(self, key: str, default: dict[str, Any] = _NO_DEFAULT, instead: str = "") -> Table:
        """A table below this one; `instead` is the name of another that would do."""
        other = f" or [{self.path(instead)}]" if instead else ""
        return Table(self._get(key, default, f"a table, [{self.path(key)}]{other}", dict), self.path(key))

    def end(self) -> None:
        """Raise `SourceError` for a key that was not asked for, with the nearest that would have been."""
        for key in self._values:
            if key not in self._known:
                raise SourceError(f"{self.path(key)} is not a known key; {suggestion(key, dict.fromkeys(self._known))}")

    def _get(self, key: str, default: Any, expected: str, *kinds: type) -> Any:
        if key not in self:
            if default is _NO_DEFAULT:
                near = nearest(key, (other for other in self._values if other not in self._known))
                instead = f" ('{near}' is there instead)" if near else ""
                raise SourceError(f"{self.path(key)} is missing{instead}; expected {expected}")
            return default
        value = self._values[key]
        if not isinstance(value, kinds) or isinstance(value, bool):
            raise SourceError(f"{self.path(key)} is {_shown(value)}; expected {expected}")
        return value

    def _row(self, path: str, row: Any, size: int, what: str = "") -> tuple[float, ...]:
        numbers = isinstance(row, list) and all(isinstance(c, int | float) and not isinstance(c, bool) for c in row)
        if not numbers or len(row) != size:
            names = f", {what}" if what else ""
            raise SourceError(f"{path} is {_shown(row)}; expected {_numbers(size)}{names}")
        return tuple(_as_float(path, c) for c in row)


def _numbers(size: int) -> str:
    return f"{size} number{'s' if size != 1 else ''}"


def _as_float(path: str, value: int | float) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.nan
    if math.isnan(number):
        raise SourceError(f"{path} is {_shown(value)}; expected a finite number")
    return number


def _shown(value: Any) -> str:
    """Short enough for one line."""
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**20 else "an enormous number"
    return text if len(text) <= 60 else text[:57] + "..."
