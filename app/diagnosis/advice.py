"""What would have helped: how many particles, by the numbers; or another thing, where more of them are in vain."""

from __future__ import annotations

import math

import numpy as np

from app.diagnosis.ancestry import (
    ENOUGH,
    LUCK,
    Losses,
    great_losses,
    left_of,
    losses,
    parents,
    particles_for,
    since_resampling,
)
from app.diagnosis.causes import WIDE
from app.diagnosis.evidence import Record
from app.diagnosis.findings import Case, Finding, are, percent, several
from app.recording.metrics import LONERS
from slam.limits import PARAMS

PRACTICAL = 10_000
"""Particles: more are no advice."""

BOTTLENECK = 4.0
"""Parents; a step that leaves less of at least twice as many is too poor a sample to tell what more particles would do:
the sum of K r_t still grows with K, and is a lower bound."""

SMALL = 20
"""Particles; of less, r_t is too rough a number to go by."""

MORE = 10
"""So many times more are tried where there is but a lower bound."""

USUAL_BELOW = 0.5
"""Share of K below which N_eff calls for a resampling, by custom."""

USUAL = 100
"""Particles to try after one."""

INHERITED = 2.0
"""Factor between founders expected of the copies that were made and those that are left, from which on weights are told
to depend on what is inherited."""

WINDOW = 100
"""[steps] over which diversity is also asked for, in runs at least twice as long."""

STRONGER = 4.0
"""Factor on R that is tried where weights are too sharp."""

WIDER = 0.1
"""Factor on what a gate leaves out, where it leaves out too much."""

WIDEST = 1e-9
"""What a gate leaves out at the least."""


def findings(case: Case, found: list[Finding]) -> list[Finding]:
    """Advice on what was found of the filter."""
    kinds = {finding.kind for finding in found}
    advice = []
    if "related" not in case.record.missing and case.key not in LONERS:
        many = case.record["particles"][-1] > 1
        advice.append(_particles(case, "overconfident" in kinds) if many else _one(case))
    advice += _settings(case, kinds)
    advice += _sensor(case, found)
    return advice


def _one(case: Case) -> Finding:
    text = f"One particle is one hypothesis, and never resampled: what it has drawn wrongly stays. Try {USUAL} or more."
    tries = (f"--from {case.record.steps[losses(case.record).start]} --set particles={USUAL}",)
    return Finding("advice", "more particles at least", text, (), {"particles": float(USUAL)}, tries=tries)


def _particles(case: Case, overconfident: bool) -> Finding:
    record, found = case.record, losses(case.record)
    left, K = found.founders[-1], record["particles"][-1]
    wanted, why = _wanted(case, found)
    numbers = {"founders_left": float(left), "level": float(ENOUGH), "particles": float(wanted)}
    carry, below = _carry(record), float(case.params.get("resample_below", USUAL_BELOW))
    if left >= ENOUGH > carry and below < USUAL_BELOW:
        return _resample(case, left, carry, below)
    if left >= ENOUGH:
        text = f"{left:g} founders are left, and {ENOUGH} are enough to tell a spread from"
        if overconfident:
            text += ": more particles will not help, since it is not for want of hypotheses that it is overconfident"
            return Finding("advice", "not for want of particles", f"{text}.", (), numbers, warns=True)
        return Finding("advice", "enough particles", f"{text}: no more particles are needed.", (), numbers)
    if wanted > PRACTICAL:
        return _in_vain(case, found, wanted, why, numbers)
    expected = left_of(wanted, found.per_particle / wanted)
    kind, text = "more particles", f"With {wanted} particles {expected:.2g} founders are expected to be left"
    text += f", so that with most seeds {ENOUGH} are"
    if why:
        kind = "more particles at least"
        text = f"More particles help, but these numbers do not tell how many: {why}. Try {wanted} or more, and diagnose"
        text += f" that again: {ENOUGH} founders should be left"
    elif wanted <= K:
        text = f"{several(left, 'founder')} {are(left)} left by bad luck: with {K:g} particles"
        text += f" {found.expected():.2g} were to be expected"
    window = _window(case, found)
    if window:
        text += f"; for any {WINDOW} steps alone {window}, by the same reckoning"
        numbers["particles_for_window"] = float(window)
    tries = (f"--from {record.steps[found.start]} --set particles={wanted}",) if wanted > K else ()
    return Finding("advice", kind, f"{text}.", (), numbers, tries=tries)


def _carry(record: Record) -> float:
    """How many particles carry the weight after the last step; after a resampling all do."""
    return float(record["particles"][-1] if record["resampled"][-1] > 0.0 else record["n_eff"][-1])


def _resample(case: Case, left: float, carry: float, below: float) -> Finding:
    text = f"{left:g} founders are left, but only {carry:.2g} of {case.record['particles'][-1]:g} particles carry the"
    text += f" weight, and they are not resampled before N_eff is below {percent(below)} of K: the others are in vain."
    tries = (f"--from {case.record.steps[0]} --set resample_below={USUAL_BELOW:g}",)
    numbers = {"founders_left": left, "level": float(ENOUGH), "carry": carry}
    return Finding("advice", "resample earlier", f"{text} Resample earlier.", (), numbers, warns=True, tries=tries)


def _wanted(case: Case, found: Losses) -> tuple[int, str]:
    """How many particles keep `LUCK` times as many founders as should be left; and, if that is a lower bound, why."""
    related, K, left = case.record["related"][found.start :], case.record["particles"][-1], found.founders[-1]
    few = parents(K, related)
    wanted, why = particles_for(LUCK * ENOUGH, found.per_particle), []
    if found.expected() > INHERITED * left:
        wanted = max(wanted, LUCK * ENOUGH * K / left)
        why.append(
            f"{left:g} {are(left)} left where {found.expected():.2g} are expected of as many copies, so that weights "
            f"depend on what particles have inherited"
        )
    if related[(few < BOTTLENECK) & (few < 0.5 * K)].sum() > 0.5 * found.tau:
        wanted = max(wanted, MORE * K)
        why.append(f"steps leave no more than {several(float(f'{np.nanmin(few):.2g}'), 'parent')} of {K:g}")
    elif K < SMALL:
        wanted = max(wanted, MORE * K)
        why.append(f"{K:g} particles are too few to tell by")
    return math.ceil(wanted / 10.0) * 10, ", and ".join(why)


def _in_vain(case: Case, found: Losses, wanted: int, why: str, numbers: dict[str, float]) -> Finding:
    window = _window(case, found)
    if window and window <= PRACTICAL:
        text = f"Over {len(case.record.steps) - found.start} steps lines meet whatever their number ({wanted:.2g} would"
        text += f" be needed for {ENOUGH} founders), which does no harm by itself; over any {WINDOW} steps {window}"
        text += f" particles keep {ENOUGH}."
        K, numbers["particles_for_window"] = case.record["particles"][-1], float(window)
        tries = (f"--from {case.record.steps[found.start]} --set particles={window}",) if window > K else ()
        return Finding("advice", "particles for a window", text, (), numbers, tries=tries)
    why = why or f"{len(case.record.steps)} steps are too many"
    text = f"More particles will not help: {why}. By these numbers more than {wanted:.2g} would be needed for {ENOUGH}"
    text += " founders."
    return Finding("advice", "more particles in vain", text, (), numbers, warns=True)


def _window(case: Case, found: Losses) -> int:
    """How many particles keep as many over any `WINDOW` steps; 0 of a run that is not much longer."""
    K, related = (case.record[name][found.start :] for name in ("particles", "related"))
    if len(K) < 2 * WINDOW:
        return 0
    sums = np.convolve(K * np.nan_to_num(related), np.ones(WINDOW), "valid")
    return math.ceil(particles_for(LUCK * ENOUGH, max(float(sums.max()), 0.0)) / 10.0) * 10


def _settings(case: Case, kinds: set[str]) -> list[Finding]:
    """What the cause of the losses calls for."""
    advice = []
    start = _before_losses(case)
    inflated = f"inflate_r={min(STRONGER * float(case.params.get('inflate_r', 1.0)), PARAMS['inflate_r'].high):g}"
    if "shape of the map" in kinds:
        text = "Weigh with a larger R than features are drawn with, so that the shape of the map counts less"
        tries = [f"--from {start} --set {inflated}"]
        if case.key == "dfs" and case.params.get("weighting") == "joint":
            text = f"Weigh each observation at the predicted pose (marginal): shape hardly counts there. Or w{text[1:]}"
            tries.insert(0, f"--from {start} --set weighting=marginal")
        advice.append(Finding("advice", "larger R", f"{text}.", (), {}, tries=tuple(tries)))
    if "proposal wider than the sensor" in kinds or (case.key == "fs1" and "ignored" in kinds):
        text = f"Poses or maps are spread more than {WIDE:g} times wider than the sensor: weigh with a larger R."
        kind, tries = "larger R", (f"--from {start} --set {inflated}",)
        if case.key == "fs1":
            text = (
                "FastSLAM 1.0 draws its poses before it looks: use FastSLAM 2.0 or Dual FastSLAM, which look first; or"
            )
            text += " weigh with a larger R, which costs precision."
            kind = "better proposal"
        advice.append(Finding("advice", kind, text, (), {}, tries=tries))
    if "what was not matched" in kinds or "ignored" in kinds:
        advice += _association(case, start)
    return advice


def _association(case: Case, start: int) -> list[Finding]:
    """Where what was not matched is the trouble.  Known tags leave nothing to choose but how far they are believed."""
    association, tries = case.params.get("association", "jcbb"), []
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
        text = "Particles match different things: try another association, or a wider gate."
    return [Finding("advice", "other association", text, (), {}, tries=tuple(tries))]


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
    factor = min(float(case.params.get("inflate_r", 1.0)) * ratio, PARAMS["inflate_r"].high)
    text = f"Innovations ask for {math.sqrt(ratio):.2g} times more noise than is believed, of the motion or of the"
    text += " sensor; innovations alone do not tell which. Try a larger R; or believe in more motion noise"
    text += " (believed.speed and believed.turn, or believed.odometry of a log)"
    tries = (f"--from {case.record.steps[0]} --set inflate_r={factor:.2g}",)
    return [Finding("advice", "larger noise", f"{text}.", (), {"factor": math.sqrt(ratio)}, tries=tries)]
