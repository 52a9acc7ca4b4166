"""The cases of a recording."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from app.compare.runs import root_of
from app.diagnosis.evidence import Record, joined
from app.diagnosis.findings import Case
from app.errors import UsageError
from app.recording import RecordingError
from app.recording.reading import Recording
from app.whatif.changes import changes_of
from slam.estimators import ESTIMATORS


class Cases(NamedTuple):
    """What a recording tells of its filters."""

    world: str
    heading: str
    """What was run, in a line."""
    cases: list[Case]
    warnings: list[str]
    """That the file is damaged or ends early, or that not all of it is understood."""


def read_cases(path: Path, branch: str = "") -> Cases:
    """The filters of a run; or of a branch of a live session, with what was before it left.

    Raises `UsageError` for a branch that is not there, and `RecordingError` for what cannot be read.
    """
    recording = _opened(path, branch)
    branches = recording.branches()
    if branch and branch not in branches:
        has = f"it has {', '.join(branches)}" if branches else "it has none"
        raise UsageError(f"{path} has no branch {branch!r}; {has}")
    told, warnings = recording.params(branch), []
    records = _records(recording, branch)
    if not records:
        raise UsageError(f"{path} has no step of any filter; there is nothing to diagnose")
    last, asked = max(int(record.steps[-1]) for record in records.values()), int(told["steps"])
    if recording.damaged:
        warnings.append(f"{path} is damaged: it is read as far as that goes, to step {last} of {asked}")
    elif last < asked:
        warnings.append(f"{path} ends at step {last} of {asked}")
    try:
        params = _params_at(recording, branch, last)
    except UsageError as error:  # of another version
        params = told["params"]
        warnings.append(f"{error}: what parameters became after the beginning is not gone by")
    walls = told.get("features") == "walls"
    log = told.get("kind") == "log"
    cases = [Case(key, ESTIMATORS[key].title, walls, params, record, log) for key, record in records.items()]
    heading = f"{told['world']}, seed {told['seed']}, step {last} of {asked}" + (f", branch {branch}" if branch else "")
    return Cases(told["world"], heading, cases, warnings)


def _opened(path: Path, branch: str) -> Recording:
    """With what is needed only: plots, most of what is read, where there is no evidence."""
    wanted = ["/evidence", "/events", *(["/branch"] if branch else [])]
    recording = Recording(path, below=wanted)
    if all(f"/evidence/{key}" in recording.entities for key in recording.filters()):
        return recording
    return Recording(path, below=[*wanted, "/plots"])


def _records(recording: Recording, branch: str) -> dict[str, Record]:
    """By filter, in the usual order; of a live session also those that were switched on later."""
    found: dict[str, list[Record]] = {}
    before = math.inf
    for name in reversed(recording.way(branch)):
        here = {key: record for key in ESTIMATORS if (record := _record(recording, key, name, before)) is not None}
        before = min([before, *(int(record.steps[0]) for record in here.values())])
        for key, record in here.items():
            found.setdefault(key, []).insert(0, record)
    return {key: joined(found[key]) for key in ESTIMATORS if key in found}


def _record(recording: Recording, key: str, branch: str, before: float) -> Record | None:
    """What a branch has of a filter before a step; None if it has nothing."""
    try:
        record = recording.evidence(key, root_of(branch).rstrip("/"))
    except RecordingError:
        return None
    early = record.steps < before
    return record.part(early) if early.any() else None


def _params_at(recording: Recording, branch: str, step: int) -> Mapping[str, Any]:
    """The parameters of a step."""
    began = changes_of(recording, branch, 0)
    return dataclasses.asdict([change for change in began if change.step <= step][-1].params)
