"""From what a person typed to a `Source`: a world by name with its own options, a world file, or a log."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import re
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from app.errors import UsageError, listed, suggestion
from scenarios.indoor import WALLS_ONLY
from scenarios.logs import part, read_log
from scenarios.logs.keyframes import USUAL, keyframes
from scenarios.logs.learning import with_learned_odometry
from scenarios.logs.reference import with_reference
from scenarios.logs.silence import with_silence_told
from scenarios.registry import WorldEntry, build, worlds
from scenarios.types import Source, SourceError

WORLD_FILE = ".toml"
RECORDING = ".rrd"


class LogParts(NamedTuple):
    """Which part of a log."""

    robot: int | None = None
    first: int | None = None
    last: int | None = None
    every: int | None = None
    keyframe: tuple[float, float] | None = None
    """[m, degrees]"""
    reference: Path | None = None


class WorldOption(NamedTuple):
    """An option that a world has of its own."""

    option: str
    """As it is typed, `--max-range`."""
    metavar: str
    default: str
    doc: str


def load(name: str, own: Mapping[str, str], parts: LogParts) -> Source:
    """The source called `name`; `own` are a world's options as typed.  Raises `SourceError`, `UsageError`."""
    if name in worlds():
        _only_for_logs(name, parts)
        values = world_values(worlds()[name], own)
        with options_as_typed(own):
            return build(name, **values)
    for option in own:
        owners = [entry.name for entry in worlds().values() if option in option_names(entry)]
        raise UsageError(f"{option} does not apply to {name}; it is an option of {listed(owners)}")
    path = Path(name).expanduser()
    if not path.exists():
        raise UsageError(_unknown(name))
    if path.suffix.lower() == WORLD_FILE:
        _only_for_logs(name, parts)
        return build(str(path))
    if path.suffix.lower() == RECORDING:
        raise UsageError(f"{name} is a recording; open it with: rerun {shlex.quote(name)}")
    with _as_typed({f"robot {parts.robot}": f"robot {parts.robot} (--robot)"}):
        log = read_log(path, robot=parts.robot)
    if log.scans is None:
        _not_for(name, {"--keyframe": parts.keyframe, "--reference": parts.reference}, "logs of a laser")
    if parts.reference is not None:
        log = with_reference(log, parts.reference)
    with _as_typed({"last frame": "--to", "first frame": "--from"}):
        log = part(log, parts.first, parts.last, parts.every or 1)
    if log.scans is None:
        return log
    distance, turn = USUAL if parts.keyframe is None else (parts.keyframe[0], math.radians(parts.keyframe[1]))
    return keyframes(with_learned_odometry(with_silence_told(log)), distance, turn)


@contextmanager
def options_as_typed(own: Mapping[str, str]) -> Iterator[None]:
    """Complaints name a world's options as they were typed, `--layout-seed` instead of `layout_seed` or `seed`."""
    fields = {option: option.removeprefix("--").replace("-", "_") for option in own}
    names = {f"{field} is": f"{option} is" for option, field in fields.items()}
    names |= {f"{field.rpartition('_')[2]} is": f"{option} is" for option, field in fields.items()}
    with _as_typed(names):
        yield


@contextmanager
def _as_typed(names: Mapping[str, str]) -> Iterator[None]:
    """In the message of a `SourceError`, the first of `names` that stands there becomes what was typed."""
    try:
        yield
    except SourceError as error:
        text = str(error)
        for name, typed in names.items():
            if re.search(rf"\b{re.escape(name)}\b", text):
                raise SourceError(re.sub(rf"\b{re.escape(name)}\b", typed, text, count=1)) from None
        raise


def _unknown(name: str) -> str:
    if "/" in name or Path(name).suffix:
        return f"{name}: no such file or directory; expected a log, a world file, or a world ({', '.join(worlds())})"
    return f"there is no world or file {name!r}{suggestion(name, worlds())}; the worlds are {', '.join(worlds())}"


def _only_for_logs(name: str, parts: LogParts) -> None:
    options = ("--robot", "--from", "--to", "--every", "--keyframe", "--reference")
    _not_for(name, dict(zip(options, parts, strict=True)), "logs")


def _not_for(name: str, options: Mapping[str, Any], kind: str) -> None:
    for option, value in options.items():
        if value is not None:
            raise UsageError(f"{option} does not apply to {name}: it is for {kind}")


def option_names(entry: WorldEntry) -> dict[str, str]:
    """Field of the world's options by option as typed."""
    return {f"--{field.name.replace('_', '-')}": field.name for field in dataclasses.fields(entry.options)}


def all_world_options() -> set[str]:
    """Every option that some world has of its own."""
    return {option for entry in worlds().values() for option in option_names(entry)}


def split_world_options(arguments: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """The arguments without the worlds' own options, and these with their values."""
    known, rest, own = all_world_options(), [], {}
    waiting = iter(arguments)
    for argument in waiting:
        option, equals, value = argument.partition("=")
        option = option.replace("_", "-")
        if option not in known:
            rest.append(argument)
        elif equals:
            own[option] = value
        else:
            try:
                own[option] = next(waiting)
            except StopIteration:
                raise UsageError(f"{option} needs a value") from None
    return rest, own


def world_values(entry: WorldEntry, own: Mapping[str, str]) -> dict[str, Any]:
    """The values of a world's options, from what was typed."""
    fields, hints = option_names(entry), get_type_hints(entry.options)
    found = {}
    for option, text in own.items():
        if option not in fields:
            owners = [e.name for e in worlds().values() if option in option_names(e)]
            raise UsageError(f"{option} does not apply to {entry.name}; it is an option of {listed(owners)}")
        found[fields[option]] = _value(option, text, hints[fields[option]])
    if found.get("features") == "landmarks":
        idle = next((option for option in own if fields[option] in WALLS_ONLY), None)
        if idle is not None:
            raise UsageError(f"{idle} does not apply to {entry.name} with --features landmarks: it is for walls")
    return found


def _value(option: str, text: str, hint: Any) -> Any:
    if get_origin(hint) is Literal:
        if text not in get_args(hint):
            raise UsageError(
                f"{option} is {text!r}{suggestion(text, get_args(hint))}; expected {listed(get_args(hint))}"
            )
        return text
    kinds = [kind for kind in get_args(hint) or (hint,) if kind is not type(None)]
    kind = kinds[0]
    if kind is str:
        return text
    try:
        return kind(text)
    except ValueError:
        raise UsageError(f"{option} is {text!r}; expected {'a whole number' if kind is int else 'a number'}") from None


def describe_options(entry: WorldEntry) -> list[WorldOption]:
    """The options of a world, for people."""
    docs, hints = field_docs(entry.options), get_type_hints(entry.options)
    described = []
    for option, name in option_names(entry).items():
        hint = hints[name]
        if get_origin(hint) is Literal:
            metavar = "|".join(get_args(hint))
        else:
            metavar = "N" if int in (get_args(hint) or (hint,)) else "X"
        value = next(field.default for field in dataclasses.fields(entry.options) if field.name == name)
        described.append(WorldOption(option, metavar, "" if value is None else f"{value}", docs.get(name, "")))
    return described


def field_docs(kind: type) -> dict[str, str]:
    """The docstrings under the fields of a dataclass, on one line each."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    docs = {}
    for field, doc in zip(body.body, body.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            text = doc.value.value if isinstance(doc, ast.Expr) and isinstance(doc.value, ast.Constant) else ""
            docs[field.target.id] = " ".join(str(text).split())
    return docs
