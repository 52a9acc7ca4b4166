"""`--set NAME=VALUE`: what is changed, by the names and with the limits that the command line of a run has."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, get_args, get_type_hints

from tyro.constructors import PrimitiveConstructorSpec

from app.errors import UsageError, listed, suggestion
from app.options import (
    BelievedNoise,
    FilterOptions,
    WorldNoise,
    check_belief,
    check_known,
    check_noise,
    check_walls,
    in_radians,
)
from app.session import Change, flat
from scenarios.types import Source

SWITCH = {"on": True, "off": False}

Values = dict[str, Any]
"""By dotted name, such as `believed.range`; SI units and radians."""


class Setting(NamedTuple):
    """One that is asked for."""

    name: str
    """Dotted, with underscores."""
    typed: str
    """As it was typed."""
    value: Any
    """In SI units and radians."""


def _kinds() -> dict[str, Any]:
    """By dotted name, how its value is read: a specification of the command line, or None for on and off."""
    found: dict[str, Any] = {}
    for prefix, kind in (("", FilterOptions), ("believed.", BelievedNoise), ("noise.", WorldNoise)):
        for name, hint in get_type_hints(kind, include_extras=True).items():
            specs = [extra for extra in get_args(hint) if isinstance(extra, PrimitiveConstructorSpec)]
            if name != "preset":  # a name for several of the others
                found[prefix + name] = specs[0] if specs else None
    return found


def read_settings(typed: Sequence[str]) -> list[Setting]:
    """What `--set` asks for; `UsageError` for what is no setting, or beyond its limits."""
    if not typed:
        raise UsageError("whatif needs something to change, such as: --set particles=500")
    found = [_read(text) for text in typed]
    names = [setting.name for setting in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise UsageError(f"--set names {twice} twice; expected each at most once")
    return found


def _read(text: str) -> Setting:
    name, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--set is {text!r}; expected NAME=VALUE, such as particles=500")
    kinds = _kinds()
    plain = name.strip().lstrip("-").replace("-", "_")
    if plain == "filters":
        raise UsageError(f"--set {text}: the filters are those of the recording; dualslam run makes one with others")
    if plain not in kinds:
        raise UsageError(f"--set {text}: there is no setting {name!r}{suggestion(plain, kinds)}; {_expected(kinds)}")
    if kinds[plain] is None:
        if value not in SWITCH:
            raise UsageError(f"--set {plain} is {value!r}{suggestion(value, SWITCH)}; expected {listed(SWITCH)}")
        return Setting(plain, value, SWITCH[value])
    try:
        read = kinds[plain].instance_from_str([value])
    except UsageError as error:
        raise UsageError(_as_set(str(error), plain)) from None
    return Setting(plain, value, in_radians(plain.rpartition(".")[2], read))


def _expected(kinds: Values) -> str:
    return f"expected one of {', '.join(kinds)}"


def _as_set(text: str, name: str) -> str:
    """A complaint about the option of a run, as one about `--set`."""
    return text.replace(f"--{name.replace('_', '-')}", f"--set {name}", 1)


def check_applies(settings: Sequence[Setting], source: Source, filters: Sequence[str]) -> None:
    """Raise `UsageError` for what would change nothing in such a session, or cannot be there."""
    by_group: dict[str, Values] = {"": {}, "believed": {}, "noise": {}}
    for setting in settings:
        group, _, name = setting.name.rpartition(".")
        by_group[group][name] = setting.value
    try:
        check_noise(by_group["noise"], source)
        check_belief(by_group["believed"], source)
        check_walls(by_group[""], source)
        if by_group[""].get("association") == "known":
            check_known(source)
    except UsageError as error:
        text = str(error)
        for setting in settings:
            text = _as_set(text, setting.name)
        raise UsageError(text.replace("--noise.", "noise.").replace("--believed.", "believed.")) from None
    _check_filters(settings, filters)


_MANY = ("dfs", "fs2", "fs1")

OF_FILTERS = {
    "weighting": ("dfs",),
    "proposal_weight": ("fs2",),
    "orthogonal": ("ekf",),
    **dict.fromkeys(("merge_walls", "particles", "resampler", "resample_below"), _MANY),
}
"""Settings that only some filters have."""


def _check_filters(settings: Sequence[Setting], filters: Sequence[str]) -> None:
    for setting in settings:
        owners = OF_FILTERS.get(setting.name)
        if owners and not set(owners) & set(filters):
            raise UsageError(
                f"--set {setting.name} does not apply: it is for {listed(owners)}, and the recording has "
                f"{listed(filters)}"
            )


def values_of(change: Change) -> Values:
    """All parameters that hold from a step on, by dotted name; `noise.` is what the world is."""
    noise = {} if change.noise is None else flat(change.noise, "noise.")
    return flat(change.params) | noise


def with_values(change: Change, values: Values) -> Change:
    """With some of them replaced."""
    own = {name: value for name, value in values.items() if "." not in name}
    believed = {name.partition(".")[2]: value for name, value in values.items() if name.startswith("believed.")}
    of_world = {name.partition(".")[2]: value for name, value in values.items() if name.startswith("noise.")}
    belief = dataclasses.replace(change.params.believed, **believed)
    noise = None if change.noise is None else dataclasses.replace(change.noise, **of_world)
    return Change(change.step, dataclasses.replace(change.params, **own, believed=belief), noise)


def shown(name: str, value: Any) -> str:
    """A value as it would be typed: angles in degrees."""
    field = name.rpartition(".")[2]
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float) and in_radians(field, 1.0) != 1.0:
        return f"{math.degrees(value):.4g}°"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
