"""The diagnosis of a filter, from its evidence alone: the same of a session that runs and of its recording."""

from __future__ import annotations

from app.diagnosis import advice, ancestry, causes, consistency
from app.diagnosis.findings import TOPICS, Case, Diagnosis, Finding, several
from app.diagnosis.signatures import look
from slam.types import Floats

NEEDED = {
    "deviation": "what the weights differ by",
    "related": "how many particles have one parent",
    "nis_first": "innovations beside what was expected of them",
}
"""Of what a recording may lack, in words."""


def diagnose(case: Case) -> Diagnosis:
    """All that can be told of a filter.  What is not known is said, and nothing is guessed in its place."""
    found = _mistakes(case)
    if (case.record["particles"] > 1).any():
        found += [*ancestry.findings(case), *causes.findings(case)]
    found += [*consistency.findings(case), *_association(case)]
    found += advice.findings(case, found)
    found += _missing(case)
    order = list(TOPICS)
    return Diagnosis(case, tuple(sorted(found, key=lambda finding: order.index(finding.topic))))


def _mistakes(case: Case) -> list[Finding]:
    """What a right filter cannot do; nothing of a recording that has no marks of it."""
    return [
        Finding(
            "mistake", found.mistake, f"{found.text[0].upper()}{found.text[1:]} ({found.mistake}).",
            tuple(found.steps[:5].tolist()), {"steps": float(len(found.steps)), "of": float(found.of)}, warns=True,
        )
        for found in look(case.record).findings
    ]  # fmt: skip


def _association(case: Case) -> list[Finding]:
    record = case.record
    right, wrong, missed = (_sum(record[name]) for name in ("correct", "wrong", "missed"))
    if right + wrong + missed == 0.0:
        return []  # nobody knows, or nothing was seen twice
    bad = record.steps[(record["wrong"] + record["missed"]) > 0.0]
    duplicates = record["duplicates"][-1]
    text = f"Of {right + wrong + missed:g} things seen that its best map knows {right:g} were paired rightly, {wrong:g}"
    text += f" with something else, and {missed:g} not at all"
    if duplicates > 0.0:
        show = "shows" if duplicates == 1.0 else "show"
        text += f"; {several(duplicates, 'feature')} of its best map at the end {show} what another one shows already"
    numbers = {"correct": right, "wrong": wrong, "missed": missed, "duplicates": float(duplicates)}
    kind = "association" if not len(bad) else "association lost"
    return [Finding("association", kind, f"{text}.", tuple(bad[:5].tolist()), numbers, warns=bool(len(bad)))]


def _sum(values: Floats) -> float:
    return float(values[values == values].sum())


def _missing(case: Case) -> list[Finding]:
    record, found = case.record, []
    lacking = [what for name, what in NEEDED.items() if name in record.missing]
    if lacking:
        text = (
            f"This recording does not have {', nor '.join(lacking)}: it is of an earlier version, or damaged, and why"
        )
        found.append(Finding("missing", "evidence", f"{text} particles died cannot be told from it.", warns=True))
    if (record["nees_position"] != record["nees_position"]).all():
        text = "Nobody knows where the robot was: whether the filter was consistent is told by its innovations alone."
        found.append(Finding("missing", "truth", text))
    if _sum(record["matched"]) > 0.0 and not sum(_sum(record[name]) for name in ("correct", "wrong", "missed")):
        text = "Nobody knows what it was that was seen: whether it was paired rightly is not told."
        found.append(Finding("missing", "tags", text))
    return found
