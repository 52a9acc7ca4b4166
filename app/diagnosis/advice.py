"""What would have helped: more particles, or another thing where more of them are in vain."""

from __future__ import annotations

import math

from app.diagnosis import particles
from app.diagnosis.ancestry import great_losses, since_resampling
from app.diagnosis.causes import WIDE
from app.diagnosis.findings import Case, Finding, amount
from app.recording.metrics import LONERS
from slam.limits import PARAMS

STRONGER = 4.0
"""Factor on R that is tried where weights are too sharp."""

WIDER = 0.1
"""Factor on what a gate leaves out, where it leaves out too much."""

WIDEST = 1e-9
"""What a gate leaves out at the least."""


def findings(case: Case, found: list[Finding]) -> list[Finding]:
    """Advice on what was found of the filter."""
    if any(finding.topic == "mistake" for finding in found):
        text = "Repair that first: all else that is told here is of a filter with a mistake in it."
        return [Finding("advice", "repair", text, warns=True)]
    kinds = {finding.kind for finding in found}
    advice = particles.findings(case, kinds)
    advice += _settings(case, kinds)
    advice += _sensor(case, found)
    return advice


def _settings(case: Case, kinds: set[str]) -> list[Finding]:
    """What the cause of the losses calls for."""
    advice, larger = [], (f"--from {_before_losses(case)} --set inflate_r={_inflated(case, STRONGER)}",)
    if "shape of the map" in kinds:
        text = "Weigh with a larger R than features are drawn with, so that the shape of the map counts less."
        tries = larger
        if case.key == "dfs" and case.params.get("weighting") == "joint":
            text = f"Weigh each observation at the predicted pose (marginal): shape hardly counts there. Or w{text[1:]}"
            tries = (f"--from {_before_losses(case)} --set weighting=marginal", *larger)
        advice.append(Finding("advice", "larger R", text, (), {}, tries=tries))
    if "proposal wider than the sensor" in kinds or (case.key == "fs1" and "ignored" in kinds):
        kind, text, tries = "larger R", "", larger
        text = f"Poses or maps are spread more than {WIDE:g} times wider than the sensor: weigh with a larger R."
        if case.key == "fs1":
            text = "FastSLAM 1.0 draws its poses before it looks: use FastSLAM 2.0 or Dual FastSLAM, which look first."
            kind, tries = "better proposal", ()
        advice.append(Finding("advice", kind, text, (), {}, tries=tries))
    if "what was not matched" in kinds or "ignored" in kinds:
        advice += _association(case)
    if case.key in LONERS and "overconfident" in kinds:
        text = (
            "A single Gaussian has one linearisation, and what that makes it believe wrongly stays: a larger R gives it"
        )
        text += " room; a particle filter has several."
        advice.append(Finding("advice", "larger R", text, (), {}, tries=larger))
    return advice


def _inflated(case: Case, factor: float) -> str:
    return f"{min(factor * float(case.params.get('inflate_r', 1.0)), PARAMS['inflate_r'].high):.3g}"


def _association(case: Case) -> list[Finding]:
    """Where what was not matched is the trouble.  Known tags leave nothing to choose but how far they are believed."""
    association, tries, start = case.params.get("association", "jcbb"), [], _before_losses(case)
    gate = "gate_known" if association == "known" else "gate"
    outside = 1.0 - float(case.params.get(gate, 0.99))
    if association != "known":
        tries.append(f"--from {start} --set association={'jcbb' if association == 'nearest' else 'nearest'}")
    if outside * WIDER >= WIDEST:
        tries.append(f"--from {start} --set {gate}={1.0 - WIDER * outside:.12g}")
    if not tries:
        return []
    text = "Tags are not believed beyond their gate: try a wider one."
    if association != "known":
        text = "Much of what is seen is matched by some particles only, or by none: try another association, or a wider"
        text += " gate; if neither helps, it is the poses that are wrong."
    return [Finding("advice", "other association", text, (), {}, tries=tuple(tries))]


def _before_losses(case: Case) -> int:
    """The first of the steps that led to the first great loss."""
    greatest = great_losses(case.record)
    first = since_resampling(case.record, int(greatest.min())).start if len(greatest) else 0
    return int(case.record.steps[first])


def _sensor(case: Case, found: list[Finding]) -> list[Finding]:
    """What innovations say of the noise that is believed; of particles that have died out they say that instead."""
    off = [finding.numbers["ratio"] for finding in found if finding.kind.endswith(" off")]
    few = case.key not in LONERS and case.record["particles"][-1] == 1.0
    if not off or few or any(finding.kind == "depleted" for finding in found):
        return []
    ratio, inflated = max(off), _inflated(case, max(off))
    text = (
        f"Innovations ask for deviations {amount(math.sqrt(ratio))} times larger than is believed, of the motion or of"
    )
    text += f" the sensor; they do not tell which. Try a larger R, {amount(ratio)} times the covariance (inflate_r"
    text += f" {float(case.params.get('inflate_r', 1.0)):g} to {inflated}); or believe in more motion noise"
    text += " (believed.speed and believed.turn, or believed.odometry)."
    tries = (f"--from {case.record.steps[0]} --set inflate_r={inflated}",)
    return [Finding("advice", "larger noise", text, (), {"factor": math.sqrt(ratio)}, tries=tries)]
