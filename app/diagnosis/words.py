"""A diagnosis as text, as Markdown and as JSON."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from typing import Any

from app.diagnosis.findings import TOPICS, Diagnosis, Finding

SCHEMA = 1


def as_dict(found: Diagnosis) -> dict[str, Any]:
    """As JSON knows it: `particles`, `steps` (first and last), and `findings`, each with `topic`, `kind`, `warns`,
    `text`, `steps`, `numbers` (null where infinite) and `tries`, options of `dualslam whatif`."""
    record = found.case.record
    return {
        "title": found.case.title,
        "particles": None if "particles" in record.missing else int(record["particles"][0]),
        "steps": [int(record.steps[0]), int(record.steps[-1])],
        "findings": [_finding(finding) for finding in found.findings],
    }


def _finding(finding: Finding) -> dict[str, Any]:
    numbers = {name: value if math.isfinite(value) else None for name, value in finding.numbers.items()}
    told = {"topic": finding.topic, "kind": finding.kind, "warns": finding.warns, "text": finding.text}
    return told | {"steps": list(finding.steps), "numbers": numbers, "tries": list(finding.tries)}


def commands(finding: Finding, name: str) -> list[str]:
    """The commands that try what is advised, on the recording of this name."""
    return [f"dualslam whatif {shlex.quote(name)} {options}" for options in finding.tries]


def markdown(diagnoses: Sequence[Diagnosis]) -> str:
    """For the panel: a heading for each filter, and a list for each topic."""
    parts = []
    for found in diagnoses:
        parts.append(f"#### {found.case.title}")
        for topic, title in TOPICS.items():
            lines = [_bullet(finding) for finding in found.findings if finding.topic == topic]
            if lines:
                parts.append(f"**{title}**\n\n" + "\n".join(lines))
    return "\n\n".join(parts)


def _bullet(finding: Finding) -> str:
    return f"- {'**!** ' if finding.warns else ''}{finding.text}"
