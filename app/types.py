"""The values that a running session hands to whoever watches it: recorder, summary, progress bar, panel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from app.diagnosis.evidence import Evidence
from scenarios.types import Source
from slam.genealogy import Genealogy
from slam.metrics import Measures
from slam.perception.matching import Match
from slam.types import Estimator, Floats, Frame, Noise, Params, Trace


class FilterUpdate(NamedTuple):
    """What one filter did in one observing step."""

    trace: Trace
    seconds: float
    """[s] that the step took, wall clock."""
    measures: Measures
    """Errors, NEES, N_eff, diversity, features, duplicates ... of this step (`slam.metrics`)."""
    genealogy: Genealogy
    """The ancestry of the particles up to and including this step."""
    evidence: Evidence
    """What a diagnosis is made of."""


def best_descendant(update: FilterUpdate) -> int:
    """Of the particles that the step returned, the one that descends from the heaviest that survived."""
    trace = update.trace
    return int(np.argmax(trace.weighted.log_w[trace.selected]))


def best_path(update: FilterUpdate) -> Floats:
    """(T, 3) the path of its lineage as it is known now, without the pose before the first step."""
    return update.genealogy.path(best_descendant(update))[1:]


def heaviest_descendant(before: FilterUpdate, after: FilterUpdate, particle: int) -> int | None:
    """Of a particle of `Trace.weighted` of `before` its heaviest descendant one step later; None if it died."""
    if not 0 <= particle < len(before.trace.weighted.log_w):
        return None
    parents = before.trace.selected[after.trace.resized]
    children = np.flatnonzero(parents == particle)
    return int(children[np.argmax(after.trace.weighted.log_w[children])]) if len(children) else None


@dataclass(frozen=True)
class SessionStep:
    """One observing step, seen by all filters."""

    index: int
    """From 1."""
    frame: Frame
    """With the noise that the filters saw."""
    truth: Floats | None
    """(3,) or None."""
    odometry: Floats
    """(3,) the pose by dead reckoning from the noisy controls alone."""
    params: Params
    noise: Noise
    """What the world's noise was."""
    filters: dict[str, FilterUpdate]
    """By filter key, in the order they were asked for."""
    changes: tuple[str, ...] = ()
    """Sentences on parameters that changed at the top of this step."""
    matched: Floats | None = None
    """(3,) the pose by the same controls, corrected by scan matching where that is used; None without it."""
    match: Match | None = None
    """What matching the scan has found; None without it."""
    picked: tuple[str, int] | None = None
    """A particle that somebody looks at: its filter, and its index in `Trace.weighted`."""


class SessionInfo(NamedTuple):
    """What is known before the first step."""

    source: Source
    filters: tuple[Estimator, ...]
    params: Params
    noise: Noise
    seed: int
    steps: int
    """Number of observing steps to come."""
    command: str
    """The command line, or the call, that started it."""
    mistake: str = ""
    """That the filters have in them on purpose (`slam.mistakes`), where one can make it in them; empty for none."""


class Observer(Protocol):
    """Watches a session.  Every method is called from the thread that runs the filters."""

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        ...

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        ...

    def end(self) -> None:
        """After the last step, or when the session is interrupted; called once, always."""
        ...
