"""The values that a diagnosis is made of: a filter's case, and what was found in it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from app.diagnosis.evidence import Record

Topic = Literal["mistake", "diversity", "cause", "consistency", "association", "advice", "missing"]

TOPICS: dict[Topic, str] = {
    "mistake": "Mistakes",
    "diversity": "Diversity",
    "cause": "What decided",
    "consistency": "Consistency",
    "association": "Association",
    "advice": "What would help",
    "missing": "Not known",
}
"""Their titles, in the order in which they are told."""


class Case(NamedTuple):
    """What is known of one filter in one run."""

    key: str
    """Short name of the filter."""
    title: str
    walls: bool
    """Whether the features are walls, or else landmarks."""
    params: Mapping[str, Any]
    """`slam.types.Params` by name: those of its last step."""
    record: Record
    measured: bool = False
    """Whether where the robot was is a measurement, as in a log, with errors of its own."""


@dataclass(frozen=True)
class Finding:
    """One sentence, and the numbers it stands on."""

    topic: Topic
    kind: str
    """What was found, in a word or two that do not change: "founders", "shape of the map", "overconfident" ..."""
    text: str
    steps: tuple[int, ...] = ()
    """Where to look, the most important first."""
    numbers: dict[str, float] = field(default_factory=dict)
    warns: bool = False
    """Whether something is wrong, or else it is only said."""
    tries: tuple[str, ...] = ()
    """Options of `dualslam whatif` that try it."""


class Diagnosis(NamedTuple):
    """All that was found of one filter."""

    case: Case
    findings: tuple[Finding, ...]

    def kinds(self) -> set[str]:
        """Of its findings."""
        return {finding.kind for finding in self.findings}


def percent(share: float) -> str:
    """A share in words: 93 %; a small one is not none."""
    if not 0.0 < share < 0.005:
        return f"{100.0 * share:.0f} %"
    return f"{100.0 * share:.2g} %" if share > 1e-4 else "less than 0.01 %"


def rounded(value: float, digits: int = 2) -> float:
    """To so many digits, so that {:g} has no more."""
    return float(f"{value:.{digits}g}")


def amount(value: float, digits: int = 2) -> str:
    """A number in words: 2200, 0.062, infinite."""
    if math.isinf(value):
        return "infinite"
    return f"{rounded(value, digits):.10g}" if abs(value) < 1e6 else f"{value:.{digits}g}"


def several(count: float, what: str) -> str:
    """`3 steps`, `1 step`."""
    return f"{count:g} {what}" if count == 1 else f"{count:g} {what}s"


def are(count: float) -> str:
    """`is` of one, `are` of several."""
    return "is" if count == 1 else "are"


def were(count: float) -> str:
    """`was` of one, `were` of several."""
    return "was" if count == 1 else "were"
