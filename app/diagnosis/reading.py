"""The cases of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from app.diagnosis.findings import Case
from app.errors import UsageError
from app.recording import RecordingError
from app.recording.reading import Recording
from slam.estimators import ESTIMATORS


class Cases(NamedTuple):
    """What a recording tells of its filters."""

    world: str
    heading: str
    """What was run, in a line."""
    cases: list[Case]
    warning: str
    """That the file is damaged or ends early; empty if it does not."""


def read_cases(path: Path, branch: str = "") -> Cases:
    """The filters of a run, or of a branch of a live session.

    Raises `UsageError` for a branch that is not there, and `RecordingError` for what cannot be read.
    """
    prefix = f"/branch/{branch}" if branch else ""
    recording = Recording(path, below=[f"{prefix}/evidence", f"{prefix}/plots"])
    branches = recording.branches()
    if branch and branch not in branches:
        has = f"it has {', '.join(branches)}" if branches else "it has none"
        raise UsageError(f"{path} has no branch {branch!r}; {has}")
    told = recording.params(branch)
    cases = []
    for key, estimator in ESTIMATORS.items():  # of a live session, also those that were switched on later
        try:
            record = recording.evidence(key, prefix)
        except RecordingError:
            continue
        cases.append(Case(key, estimator.title, told.get("features") == "walls", told["params"], record))
    if not cases:
        raise UsageError(f"{path} has no step of any filter; there is nothing to diagnose")
    last, asked = max(int(case.record.steps[-1]) for case in cases), int(told["steps"])
    heading = f"{told['world']}, seed {told['seed']}, step {last} of {asked}" + (f", branch {branch}" if branch else "")
    warning = ""
    if recording.damaged:
        warning = f"{path} is damaged: it is read as far as that goes, to step {last} of {asked}"
    elif last < asked:
        warning = f"{path} ends at step {last} of {asked}"
    return Cases(told["world"], heading, cases, warning)
