"""How a value is read from the command line: its type, its limits and its complaint, in one place for each kind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tyro.constructors import PrimitiveConstructorSpec

from app.errors import UsageError, listed, suggestion
from slam.limits import Interval


def _spec(metavar: str, read: Any, many: bool = False) -> PrimitiveConstructorSpec[Any]:
    """What tyro needs to know.  None, for an option that was not given, is a default that nobody can type."""
    return PrimitiveConstructorSpec(
        nargs="*" if many else 1,
        metavar=metavar,
        instance_from_str=read if many else lambda texts: read(texts[0]),
        is_instance=lambda value: True,
        str_from_instance=lambda value: [str(v) for v in value] if many else [f"{value}"],
    )


def _number(option: str, text: str, kind: type[int] | type[float], limits: Interval) -> Any:
    noun = "a whole number" if kind is int else "a number"
    expected = noun if str(limits) == "finite" else f"{noun} {limits}"
    try:
        value = kind(text)
    except ValueError:
        raise UsageError(f"{option} is {text!r}; expected {expected}") from None
    if not math.isfinite(value):
        raise UsageError(f"{option} is {text}; expected {expected.replace('a number', 'a finite number')}")
    if value not in limits:
        raise UsageError(f"{option} is {text}; expected {expected}")
    return value


def whole(option: str, metavar: str, limits: Interval) -> Any:
    """A whole number within limits."""
    return _spec(metavar, lambda text: _number(option, text, int, limits))


def real(option: str, metavar: str, limits: Interval) -> Any:
    """A number within limits."""
    return _spec(metavar, lambda text: _number(option, text, float, limits))


def wholes(option: str, metavar: str, limits: Interval) -> Any:
    """One or more whole numbers."""
    return _spec(metavar, lambda texts: tuple(_number(option, t, int, limits) for t in _some(option, texts)), many=True)


def reals(option: str, metavar: str, limits: Interval) -> Any:
    """One or more numbers."""
    return _spec(
        metavar, lambda texts: tuple(_number(option, t, float, limits) for t in _some(option, texts)), many=True
    )


def pair(option: str, metavar: str, limits: Interval) -> Any:
    """Two numbers within limits, with a comma between them."""
    return _spec(metavar, lambda text: _two(option, text, ",", f"two numbers, {metavar}", float, limits))


def spans(option: str, metavar: str, limits: Interval) -> Any:
    """One or more pairs of whole numbers, with a colon between the two."""
    expected = "two whole numbers with a colon between them"

    def read(texts: Sequence[str]) -> tuple[Any, ...]:
        return tuple(_two(option, text, ":", expected, int, limits) for text in _some(option, texts))

    return _spec(metavar, read, many=True)


def _two(option: str, text: str, sign: str, expected: str, kind: type[int] | type[float], limits: Interval) -> Any:
    """Two numbers with a sign between them."""
    found = text.split(sign)
    if len(found) != 2:
        raise UsageError(f"{option} is {text!r}; expected {expected}")
    return _number(option, found[0], kind, limits), _number(option, found[1], kind, limits)


def choice(option: str, names: Sequence[str]) -> Any:
    """One of a few names."""
    return _spec("|".join(names), lambda text: _choose(option, text, names))


def choices(option: str, metavar: str, names: Sequence[str]) -> Any:
    """Some of a few names, each once."""

    def read(texts: Sequence[str]) -> tuple[str, ...]:
        chosen = tuple(_choose(option, text, names) for text in _some(option, texts))
        twice = next((name for name in chosen if chosen.count(name) > 1), None)
        if twice:
            raise UsageError(f"{option} names {twice} twice; expected each at most once")
        return chosen

    return _spec(metavar, read, many=True)


def path(option: str, metavar: str) -> Any:
    """A path to read from or to write to."""

    def read(text: str) -> Path:
        if not text:
            raise UsageError(f"{option} is empty; expected a path")
        return Path(_readable(option, text)).expanduser()

    return _spec(metavar, read)


def word(metavar: str) -> Any:
    """Any text."""
    return _spec(metavar, lambda text: _readable(metavar, str(text)))


def words(metavar: str) -> Any:
    """Any texts, each with something in it."""
    return _spec(
        metavar, lambda texts: tuple(_some_text(metavar, _readable(metavar, text)) for text in texts), many=True
    )


def _readable(name: str, text: str) -> str:
    """A name that was typed as bytes that are no letters could be opened, but neither shown nor saved."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UsageError(f"{name} is {text!r}, with bytes that are no text in UTF-8; expected another name") from None
    return text


def _some_text(name: str, text: str) -> str:
    if not text:
        raise UsageError(f"one of {name} is empty; expected a path")
    return text


def _choose(option: str, text: str, names: Sequence[str]) -> str:
    if text not in names:
        raise UsageError(f"{option} is {text!r}{suggestion(text, names)}; expected {listed(names)}")
    return text


def _some(option: str, texts: Sequence[str]) -> Sequence[str]:
    if not texts:
        raise UsageError(f"{option} needs at least one value")
    return texts
