"""What would have helped: how many particles, by the numbers; or another thing, where more of them are in vain."""

from __future__ import annotations

import math

import numpy as np

from app.diagnosis.ancestry import ENOUGH, LUCK, Losses, great_losses, losses, particles_for, since_resampling
from app.diagnosis.causes import WIDE
from app.diagnosis.findings import Case, Finding, are, several

PRACTICAL = 10_000
"""Particles: more are no advice."""

BOTTLENECK = 0.25
"""r_t above which a step leaves less than four parents.  Then the sample is too poor to tell what more particles would
do: the sum of K r_t still grows with K, and is a lower bound."""

INHERITED = 2.0
"""Factor between founders expected of the copies that were made and those that are left, from which on weights are told
to depend on what is inherited."""

WINDOW = 100
"""[steps] over which diversity is also asked for, in runs at least twice as long."""


def findings(case: Case, found: list[Finding]) -> list[Finding]:
    """Advice on what was found of the filter."""
    kinds = {finding.kind for finding in found}
    advice = []
    if "related" not in case.record.missing and len(case.record.steps) and case.record["particles"][0] > 1:
        advice.append(_particles(case, "overconfident" in kinds))
    advice += _settings(case, kinds)
    advice += _sensor(case, found)
    return advice


def _particles(case: Case, overconfident: bool) -> Finding:
    record, found = case.record, losses(case.record)
    left, K = found.founders[-1], record["particles"][-1]
    wanted = math.ceil(LUCK * particles_for(ENOUGH, found.per_particle)) if found.per_particle > 0.0 else ENOUGH
    numbers = {"founders_left": float(left), "level": float(ENOUGH), "particles": float(wanted)}
    if left >= ENOUGH:
        text = f"{left:g} founders are left, and {ENOUGH} are enough to tell a spread from"
        if overconfident:
            text += ": more particles will not help, since it is not for want of hypotheses that it is overconfident"
            return Finding("advice", "not for want of particles", f"{text}.", (), numbers, warns=True)
        return Finding("advice", "enough particles", f"{text}: no more particles are needed.", (), numbers)
    in_bottlenecks = record["related"][record["related"] > BOTTLENECK].sum() > 0.5 * found.tau
    if in_bottlenecks or wanted > PRACTICAL:
        return _in_vain(case, found, wanted, numbers)
    rounded = math.ceil(wanted / 10.0) * 10
    text = f"With {rounded} particles {LUCK * ENOUGH:.0f} founders are expected to be left, and {ENOUGH} nearly always"
    kind = "more particles"
    if found.expected() > INHERITED * left:
        kind = "more particles at least"
        rounded = max(rounded, math.ceil(LUCK * ENOUGH * K / left / 10.0) * 10)
        text = f"More particles help less than in proportion: {left:g} {are(left)} left where {found.expected():.2g}"
        text += " are expected of as many copies, so that weights depend on what particles have inherited."
        text += f" {rounded} or more are needed for {ENOUGH} founders"
    elif rounded <= K:
        text = f"{several(left, 'founder')} {are(left)} left by bad luck: with {K:g} particles"
        text += f" {found.expected():.2g} were to be expected"
    numbers["particles"] = float(rounded)
    if len(record.steps) >= 2 * WINDOW:
        window = math.ceil(LUCK * particles_for(ENOUGH, _worst_window(case)) / 10.0) * 10
        text += f"; over any {WINDOW} steps {window} keep as many"
        numbers["particles_for_window"] = float(window)
    tries = (f"--from {record.steps[0]} --set particles={rounded}",) if rounded > K else ()
    return Finding("advice", kind, f"{text}.", (), numbers, tries=tries)


def _in_vain(case: Case, found: Losses, wanted: int, numbers: dict[str, float]) -> Finding:
    worst = case.record["related"].max()
    text = f"More particles will not help: steps leave as little as {1.0 / worst:.2g} parents, however many there are,"
    text += f" and even by these numbers more than {wanted:.2g} would be needed for {ENOUGH} founders"
    return Finding("advice", "more particles in vain", f"{text}.", (), numbers, warns=True)


def _worst_window(case: Case) -> float:
    """The largest sum of K r_t over `WINDOW` steps."""
    sums = np.convolve(case.record["particles"] * np.nan_to_num(case.record["related"]), np.ones(WINDOW), "valid")
    return max(float(sums.max()), 1e-9)


def _settings(case: Case, kinds: set[str]) -> list[Finding]:
    """What the cause of the losses calls for."""
    params, advice = case.params, []
    start = _before_losses(case)
    inflated = f"inflate_r={4.0 * float(params.get('inflate_r', 1.0)):g}"
    if "shape of the map" in kinds:
        text = "Weigh with a larger R than features are drawn with, so that the shape of the map counts less"
        tries = [f"--from {start} --set {inflated}"]
        if case.key == "dfs" and params.get("weighting") == "joint":
            text = f"Weigh each observation at the predicted pose (marginal): shape hardly counts there. Or w{text[1:]}"
            tries.insert(0, f"--from {start} --set weighting=marginal")
        advice.append(Finding("advice", "larger R", f"{text}.", (), {}, tries=tuple(tries)))
    if "proposal wider than the sensor" in kinds or (case.key == "fs1" and "ignored" in kinds):
        text = f"Poses or maps are spread more than {WIDE:g} times wider than the sensor: weigh with a larger R."
        kind, tries = "larger R", (f"--from {start} --set {inflated}",)
        if case.key == "fs1":
            text = "FastSLAM 1.0 draws its poses before it looks: use FastSLAM 2.0 or Dual FastSLAM, which look first."
            kind = "better proposal"
        advice.append(Finding("advice", kind, text, (), {}, tries=tries))
    if "what was not matched" in kinds or "ignored" in kinds:
        text = "Particles match different things: try another association, or a wider gate"
        other = "nearest" if params.get("association") == "jcbb" else "jcbb"
        gate = 1.0 - 0.1 * (1.0 - float(params.get("gate", 0.99)))
        tries = (f"--from {start} --set association={other}", f"--from {start} --set gate={gate:g}")
        advice.append(Finding("advice", "other association", f"{text}.", (), {}, tries=tries))
    return advice


def _before_losses(case: Case) -> int:
    """The first of the steps that led to the first great loss."""
    greatest = great_losses(case.record)
    first = since_resampling(case.record, int(greatest.min())).start if len(greatest) else 0
    return int(case.record.steps[first])


def _sensor(case: Case, found: list[Finding]) -> list[Finding]:
    """What innovations say of the noise that is believed."""
    off = [finding.numbers["ratio"] for finding in found if finding.kind.endswith(" off")]
    if not off:
        return []
    ratio = max(off)
    factor = float(case.params.get("inflate_r", 1.0)) * ratio
    text = (
        f"Innovations ask for {math.sqrt(ratio):.2g} times more noise than is believed, of the motion or of the sensor"
    )
    tries = (f"--from {case.record.steps[0]} --set inflate_r={factor:.2g}",)
    return [Finding("advice", "larger noise", f"{text}.", (), {"factor": math.sqrt(ratio)}, tries=tries)]
