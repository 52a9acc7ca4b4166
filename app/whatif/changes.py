"""What held from which step on in a session that was recorded: what it began with, and what its events tell."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_type_hints

from app.compare.runs import CHANGED, root_of
from app.errors import UsageError
from app.recording.reading import Recording
from app.session import Change
from app.whatif.settings import Values, values_of, with_values
from slam.types import Noise, Params


def changes_of(recording: Recording, branch: str, first: int) -> list[Change]:
    """Of a branch, or of the run itself: what it began with, and what its events tell."""
    told = recording.params(branch)
    now = Change(first, _made(Params, told["params"], recording.path), _made(Noise, told["noise"], recording.path))
    found = {first: now}
    for event in recording.events(f"{root_of(branch)}events"):
        name, _, values = event.text.partition(CHANGED)[2].partition(": ")
        if values and name != "filters":
            now = with_values(now, {name: _value(now, name, values.partition(" -> ")[2], recording.path)})
            found[event.step] = now = now._replace(step=event.step)
    return list(found.values())


def filters_at_end(recording: Recording, branch: str) -> list[str]:
    """Keys of those that were on when a branch, or the run itself, ended."""
    keys = [told["key"] for told in recording.params(branch)["filters"]]
    for event in recording.events(f"{root_of(branch)}events"):
        name, _, values = event.text.partition(CHANGED)[2].partition(": ")
        if name == "filters":
            keys = values.partition(" -> ")[2].split()
    return keys


def _made(kind: type[Any], told: Values, path: Path) -> Any:
    """Parameters as they were recorded; those that an earlier version did not have are what they are by default."""
    hints = get_type_hints(kind)
    unknown = next((name for name in told if name not in hints), None)
    if unknown is not None:
        raise UsageError(f"{path} has the parameter {unknown!r}, which this version does not know")
    inner = {name: _made(Noise, value, path) if isinstance(value, dict) else value for name, value in told.items()}
    return kind(**inner)


def _value(now: Change, name: str, text: str, path: Path) -> Any:
    """A parameter as an event tells of it: numbers to the last bit."""
    known = values_of(now)
    try:
        former = known[name]
        if isinstance(former, bool):
            return {"True": True, "False": False}[text]
        return type(former)(text)
    except (KeyError, ValueError):
        raise UsageError(f"{path} says that {name} became {text!r}, which this version does not know") from None
