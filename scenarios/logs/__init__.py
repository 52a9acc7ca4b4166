"""Logs of real robots, recognised by what is in the files.  One reader a format, one line here for each."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from scenarios.logs import carmen, dpslam, mrclam, victoria_park
from scenarios.logs.parts import dead_reckoning, part
from scenarios.logs.text import Head, Role, read_head
from scenarios.types import Source, SourceError

__all__ = ["READERS", "dead_reckoning", "is_log", "part", "read_log"]

READERS: tuple[ModuleType, ...] = (mrclam, carmen, dpslam, victoria_park)
"""A reader has `TITLE`, `EXPECTED` (a phrase for messages), `ONE_FILE`, whether a log is one file, `role(head)`, what a
file is in its data set or None, and `read(place, files by role, robot)`.  The one that asks least of a file is last."""


def read_log(
    path: str | Path,
    *,
    robot: int | None = None,
    first: int | None = None,
    last: int | None = None,
    every: int = 1,
) -> Source:
    """The log at `path`: the directory of a data set, or one of its files (plain or gzipped).

    Of the laser logs in a directory that is the one that has not been corrected; of several such the one that is called
    like the directory.

    robot: which one, for logs with several.  first, last, every: a part of the log (see `part`).
    Raises `SourceError` with one sentence that names file and line, value and what was expected.
    """
    place = Path(path)
    reader, files, given = _recognise(place)
    if given is not None and given.robot:
        if robot not in (None, given.robot):
            raise SourceError(f"{place}: a file of robot {given.robot}; expected robot {robot} or the directory")
        robot = given.robot
    return part(reader.read(place, files, robot), first, last, every)


def is_log(path: str | Path) -> bool:
    """Whether `read_log` is the one to read `path`: any directory, and files that look like part of a log."""
    place = Path(path)
    try:
        return place.is_dir() or (place.is_file() and _reader_of(read_head(place)) is not None)
    except (OSError, SourceError):
        return False


def _recognise(place: Path) -> tuple[ModuleType, dict[Role, Path], Role | None]:
    """The reader, what each file of the data set is for it, and what the file at `place` is (None: a directory)."""
    expected = "; or ".join(reader.EXPECTED for reader in READERS)
    try:
        if place.is_dir():
            folder, given = place, None
            heads = _heads(place)
            reader = _reader_of(*heads)
        else:
            folder, given = place.parent, read_head(place)
            reader = _reader_of(given)
            heads = [given] if reader is None else _heads(folder)
    except OSError as error:
        raise SourceError(f"{place}: cannot be read ({error.strerror}); expected a log") from error
    if reader is None and given is not None:
        what = f"begins with {given.first_line[:60]!r}" if given.first_line else "holds no line of text"
        raise SourceError(f"{place}: no log of a known format, it {what}; expected {expected}")
    if reader is None:
        inside = sorted(p.name for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
        hint = f" (its directories: {', '.join(inside[:5])})" if inside else ""
        raise SourceError(f"{place}: no data set in this directory{hint}; expected {expected}")
    if reader.ONE_FILE:
        head = _only_log(place, reader, heads) if given is None else given
        role = reader.role(head)
        return reader, {role: head.path}, role
    # Two files may have one role: Victoria Park comes with variants of its dead reckoning and GPS.  The file that was
    # asked for wins, then one that has the role for its name, then the largest.
    ranked = [
        ((head.path == place, head.path.name.lower().startswith(role.kind), head.path.stat().st_size), role, head.path)
        for head in heads
        if (role := reader.role(head)) is not None
    ]
    files = {role: path for _, role, path in sorted(ranked)}
    return reader, files, None if given is None else reader.role(given)


def _only_log(folder: Path, reader: ModuleType, heads: list[Head]) -> Head:
    """The log that is meant by a directory which may have corrected versions and others beside it."""
    by_kind: dict[str, list[Head]] = {}
    for head in heads:
        if (role := reader.role(head)) is not None:
            by_kind.setdefault(role.kind, []).append(head)
    logs = by_kind.get("log") or next(iter(by_kind.values()))
    like_folder = [head for head in logs if head.path.name.partition(".")[0] == folder.absolute().name]
    exact = [head for head in like_folder if head.path.name.removesuffix(".gz").count(".") < 2]
    for chosen in (logs, like_folder, exact):
        if len(chosen) == 1:
            return chosen[0]
    names = ", ".join(head.path.name for head in logs)
    raise SourceError(f"{folder}: {len(logs)} logs in this directory, {names}; expected one of these files")


def _reader_of(*heads: Head) -> ModuleType | None:
    return next((reader for reader in READERS if any(reader.role(head) for head in heads)), None)


def _heads(folder: Path) -> list[Head]:
    return [read_head(p) for p in sorted(folder.iterdir()) if p.is_file() and not p.name.startswith(".")]
