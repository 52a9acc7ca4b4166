"""What may change between two steps, as one value: a step sees all of it or nothing."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args, get_type_hints

from app import session
from app.options import FILTERS
from scenarios.types import Source
from slam.features import Point
from slam.limits import BELIEVED_SENSOR, DEVIATION, LARGEST, PARAMS, Interval
from slam.motion import Odometry
from slam.types import Noise, Params

NOISE: dict[str, Interval] = dict.fromkeys(("speed", "turn", "range", "bearing", "odometry"), DEVIATION)
NOISE["missing"] = Interval(0, 1)
"""What the world is."""

BELIEVED: dict[str, Interval] = dict.fromkeys(("speed", "turn", "odometry"), DEVIATION)
BELIEVED |= dict.fromkeys(("range", "bearing"), BELIEVED_SENSOR)
"""What the filters believe."""

FEWEST, MOST = 1, 20_000
"""Particles while somebody waits for the next step; `dualslam run` takes more."""


@dataclass(frozen=True)
class Settings:
    """The parameters of one step."""

    params: Params
    noise: Noise
    """What the world is."""
    filters: tuple[str, ...]
    """Which filters run, by key."""


def first_settings(source: Source, filters: tuple[str, ...], params: Params, noise: Noise) -> Settings:
    """The settings that a session begins with."""
    return Settings(limited_params(params), noise, ordered(filters))


def ordered(filters: tuple[str, ...]) -> tuple[str, ...]:
    """Filters in the order in which they are always shown."""
    return tuple(key for key in FILTERS if key in filters)


def limited_params(params: Params) -> Params:
    """With no more particles than somebody can wait for."""
    return dataclasses.replace(params, particles=min(max(params.particles, FEWEST), MOST))


def applicable(source: Source) -> tuple[str, ...]:
    """The deviations that something in a source has."""
    of_motion = ("odometry",) if isinstance(source.motion, Odometry) else ("speed", "turn")
    return of_motion + (("range", "bearing") if isinstance(source.feature, Point) else ("range", "missing"))


def changed(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """Settings with `changes` by dotted name: "particles", "believed.range", "noise.range", "filters".

    Nothing that a client sends is trusted: numbers are brought between their limits, and what is no number, no known
    word or of an unknown name changes nothing.
    """
    for name, value in changes.items():
        settings = _changed(settings, name, value)
    return settings


def _changed(settings: Settings, name: str, value: Any) -> Settings:
    if name == "filters":
        if not isinstance(value, list | tuple):
            return settings
        keys = ordered(tuple(v for v in value if isinstance(v, str)))
        return dataclasses.replace(settings, filters=keys) if keys else settings
    group, _, field = name.rpartition(".")
    if group == "noise" and field in NOISE:
        noise = _replaced(settings.noise, field, value, NOISE[field])
        return dataclasses.replace(settings, noise=noise)
    if group == "believed" and field in BELIEVED:
        believed = _replaced(settings.params.believed, field, value, BELIEVED[field])
        return dataclasses.replace(settings, params=dataclasses.replace(settings.params, believed=believed))
    if not group and field in _PARAMS and field != "believed":
        limits = Interval(FEWEST, MOST) if field == "particles" else PARAMS.get(field)
        return dataclasses.replace(settings, params=_replaced(settings.params, field, value, limits))
    return settings


_PARAMS = get_type_hints(Params)


def _replaced(whole: Any, field: str, value: Any, limits: Interval | None) -> Any:
    """A dataclass with one field as near to `value` as it may be."""
    kind = get_type_hints(type(whole))[field]
    words = get_args(kind)
    if words:
        return dataclasses.replace(whole, **{field: value}) if isinstance(value, str) and value in words else whole
    if kind is bool:
        return dataclasses.replace(whole, **{field: value}) if isinstance(value, bool) else whole
    if isinstance(value, bool) or not isinstance(value, int | float) or limits is None or value != value:
        return whole
    number = clamped(value, limits)
    return dataclasses.replace(whole, **{field: round(number) if kind is int else number})


def clamped(value: float, limits: Interval) -> float:
    """The nearest number within limits; a little inside of a limit that is excluded."""
    low, high = limits.low, min(limits.high, LARGEST)
    if limits.open_low:
        low += 1e-9
    if limits.open_high:
        high -= 1e-9
    return float(min(max(value, low), high))


def described(before: Settings, after: Settings) -> tuple[str, ...]:
    """A sentence for everything that differs, with the old and the new value."""
    sentences = session.describe_change(before.params, after.params) + session.describe_noise(before.noise, after.noise)
    if before.filters != after.filters:
        sentences += (f"filters: {' '.join(before.filters)} -> {' '.join(after.filters)}",)
    return sentences


def plain(settings: Settings) -> dict[str, Any]:
    """As JSON has it; SI units and radians."""
    return {
        "params": dataclasses.asdict(settings.params),
        "noise": dataclasses.asdict(settings.noise),
        "filters": list(settings.filters),
    }


class Desk:
    """The settings that hold from the next step on: written by many threads, read once at the top of a step."""

    def __init__(self, settings: Settings) -> None:
        self._lock = threading.Lock()
        self._settings = settings

    def change(self, changes: Mapping[str, Any]) -> Settings:
        """All of the changes, or what may be of them (`changed`), at once; returns what holds now."""
        with self._lock:
            self._settings = changed(self._settings, changes)
            return self._settings

    def put(self, settings: Settings) -> None:
        """These and no others."""
        with self._lock:
            self._settings = settings

    def read(self) -> Settings:
        """What holds now."""
        with self._lock:
            return self._settings
