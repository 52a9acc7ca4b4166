"""Checks of what a person typed; what is wrong is said in one way: the name, the value, what was expected."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from scenarios.types import SourceError

LARGEST = 1e6
"""A length, time or deviation beyond this is a slip of the keyboard: 1000 km, 12 days."""


class Limits(NamedTuple):
    """Of a field of options, as an annotation: `Annotated[float, Limits(above=0, most=1000)]`."""

    above: float = -math.inf
    least: float = -LARGEST
    most: float = LARGEST
    unit: str = ""


@contextmanager
def naming(place: object) -> Iterator[None]:
    """Put the name of a world or file before the message of a `SourceError`."""
    try:
        yield
    except SourceError as error:
        raise SourceError(f"{place}: {error}") from None


def suggestion(word: str, known: Iterable[str]) -> str:
    """What to put behind "unknown ...": the nearest valid word, or all of them."""
    known = list(known)
    near = nearest(word, known)
    return f"did you mean '{near}'?" if near else f"expected one of {', '.join(known)}"


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The word that was probably meant, if any is near."""
    return next(iter(difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)), None)


def check_number(
    name: str,
    value: Any,
    unit: str = "",
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = LARGEST,
    whole: bool = False,
) -> None:
    """Raise `SourceError` unless `value` is a number: above < value, least <= value <= most, whole if asked."""
    kind = int if whole else (int, float)
    if isinstance(value, kind) and not isinstance(value, bool) and above < value and least <= value <= most:
        return
    bounds = [f"above {above:g}"] if above > -math.inf else []
    bounds += [f"at least {least:g}"] if least > -LARGEST else []
    bounds += [f"at most {most:g}"] if most < math.inf and isinstance(value, int | float) and value > most else []
    what = " ".join(["a whole number" if whole else "a number", " and ".join(bounds), unit and f"[{unit}]"])
    raise SourceError(f"{name} is {value!r}; expected {' '.join(what.split())}")


def check_angle(name: str, value: Any, *, above: float = -math.inf, least: float = -math.inf, most: float) -> None:
    """As `check_number` for radians, but said in degrees, as people type it; bounds in degrees too."""
    degrees = round(math.degrees(value), 9) if isinstance(value, int | float) else value
    check_number(f"{name}_deg", degrees, "degrees", above=above, least=least, most=most)


def check_options(options: Any) -> None:
    """Raise `SourceError` unless every field of a dataclass of options holds what its annotation says.

    Numbers must be within their `Limits`, and not absurd where there are none; `Literal` fields must hold one of their
    words.
    """
    hints, annotated = get_type_hints(type(options)), get_type_hints(type(options), include_extras=True)
    for field in dataclasses.fields(options):
        value, hint = getattr(options, field.name), hints[field.name]
        extras = getattr(annotated[field.name], "__metadata__", ())
        limits = next((extra for extra in extras if isinstance(extra, Limits)), Limits())
        words = get_args(hint) if get_origin(hint) is Literal else ()
        kinds = get_args(hint) if not words and get_args(hint) else (hint,)
        if words and value not in words:
            raise SourceError(f"{field.name} is {value!r}; {suggestion(str(value), words)}")
        if value is None and type(None) in kinds:
            continue
        if int in kinds or float in kinds:
            check_number(field.name, value, **limits._asdict(), whole=float not in kinds)


def check_positive(options: Any, *names: str) -> None:
    """Raise `SourceError` unless these fields of `options` are above zero and not absurdly large."""
    for name in names:
        check_number(name, getattr(options, name), above=0)
