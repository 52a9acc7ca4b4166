"""The worlds by name, and how to build one from a name or from a world file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from scenarios import corridor, field, hall, hospital, loop, paper_line, rotation_then_corridor
from scenarios.checks import check_options, naming, suggestion
from scenarios.simulate import Scenario, simulate
from scenarios.types import Source, SourceError
from scenarios.world_file import read_scenario, read_world


class WorldEntry(NamedTuple):
    """A world that can be asked for by name."""

    name: str
    title: str
    options: type[Any]
    """Frozen dataclass; its field docstrings say what each option is, and its unit."""
    scenario: Callable[[Any], Scenario]
    """From an instance of `options`."""
    features: tuple[str, ...] = ("landmarks",)
    """What it can show; where that is both, its option `features` says which."""


_BOTH = ("walls", "landmarks")

_WORLDS = (
    WorldEntry("paper-line", paper_line.TITLE, paper_line.PaperLine, paper_line.paper_line),
    WorldEntry("corridor", corridor.TITLE, corridor.Corridor, corridor.corridor, _BOTH),
    WorldEntry("loop", loop.TITLE, loop.Loop, loop.loop, _BOTH),
    WorldEntry(
        "rotation-then-corridor",
        rotation_then_corridor.TITLE,
        rotation_then_corridor.RotationThenCorridor,
        rotation_then_corridor.rotation_then_corridor,
        _BOTH,
    ),
    WorldEntry("hospital", hospital.TITLE, hospital.Hospital, hospital.hospital, ("walls",)),
    WorldEntry("hall", hall.TITLE, hall.Hall, hall.hall, ("walls",)),
    WorldEntry("field", field.TITLE, field.Field, field.field),
)


def worlds() -> dict[str, WorldEntry]:
    """All worlds by name."""
    return {entry.name: entry for entry in _WORLDS}


def landmark_options(name: str) -> dict[str, str]:
    """The options that make a world one of landmarks: none, unless it offers walls too."""
    return {"features": "landmarks"} if len(worlds()[name].features) > 1 else {}


def wall_worlds() -> tuple[str, ...]:
    """The worlds that offer walls, which then is what they show by default."""
    return tuple(entry.name for entry in _WORLDS if "walls" in entry.features)


def is_world(name: str) -> bool:
    """Whether `build` is the one to ask: the name of a world, or a path that ends in `.toml`."""
    return name in worlds() or Path(name).suffix.lower() == ".toml"


def scenario(name: str, **options: Any) -> Scenario:
    """The scenario of a world by name, or of a world file by path (which has no options).

    Raises `SourceError` for an unknown world or option (naming the nearest), an impossible value, a bad file.
    """
    if is_world(name) and name not in worlds():
        if options:
            raise SourceError(f"{name}: a world file takes no options, but '{next(iter(options))}' was given")
        return read_scenario(name)
    if name not in worlds():
        raise SourceError(f"unknown world '{name}'; {suggestion(name, worlds())}")
    entry = worlds()[name]
    known = [f.name for f in dataclasses.fields(entry.options)]
    for option in options:
        if option not in known:
            raise SourceError(f"{name}: unknown option '{option}'; {suggestion(option, known)}")
    chosen = entry.options(**options)
    with naming(name):
        check_options(chosen)
        return entry.scenario(chosen)


def build(name: str, **options: Any) -> Source:
    """The exact frames and the truth of `scenario(name, **options)`; raises `SourceError` like it."""
    if is_world(name) and name not in worlds() and not options:
        return read_world(name)
    made = scenario(name, **options)
    with naming(name):
        return simulate(made)
