"""How many particles would have kept diversity, by the numbers; and whether those can tell it."""

from __future__ import annotations

import math
from collections.abc import Set

import numpy as np

from app.diagnosis.ancestry import ENOUGH, LUCK, Losses, losses, parents, particles_for, tau_to_common_ancestors
from app.diagnosis.evidence import Record
from app.diagnosis.findings import Case, Finding, amount, are, percent, rounded, several
from app.recording.metrics import LONERS

PRACTICAL = 10_000
"""Particles: more are no advice."""

BOTTLENECK = 4.0
"""Parents; a step that leaves less of at least twice as many is too poor a sample to tell what more particles would do:
the sum of K r_t still grows with K, and is a lower bound."""

SMALL = 20
"""Particles; of less, r_t is too rough a number to go by."""

MORE = 10
"""So many times more are tried where the numbers are too rough to tell."""

USUAL = 100
"""Particles to try after one."""

USUAL_BELOW = 0.5
"""Share of K below which N_eff calls for a resampling, by custom."""

INHERITED = 2.0
"""Factor between what is expected of copies that are not inherited and what came of them, from which on weights are
told to depend on what is inherited."""

RENEWED = 10.0
"""tau of a run from which on the mean of `tau_to_common_ancestors` tells: some five common ancestors after another."""

WINDOW = 100
"""[steps] over which diversity is also asked for, in runs at least twice as long."""


def findings(case: Case, kinds: Set[str]) -> list[Finding]:
    """Advice on the number of particles of a filter of which such kinds of things were found."""
    record = case.record
    if "related" in record.missing or case.key in LONERS:
        return []
    if record["particles"][-1] == 1.0:
        text = f"One particle is one hypothesis, and nothing chooses: what it draws wrongly stays. Try {USUAL} or more."
        tries = (f"--from {record.steps[0]} --set particles={USUAL}",)
        return [Finding("advice", "more particles at least", text, (), {"particles": float(USUAL)}, tries=tries)]
    found = losses(record)
    left, carry = float(found.founders[-1]), _carry(record)
    below = float(case.params.get("resample_below", USUAL_BELOW))
    if min(record["particles"][-1], ENOUGH) > carry and below < USUAL_BELOW:
        return [_resample(case, left, carry, below)]
    return [_enough(left, kinds) if left >= ENOUGH else _more(case, found, kinds)]


def _carry(record: Record) -> float:
    """How many particles carry the weight after the last step; after a resampling all do."""
    return float(record["particles"][-1] if record["resampled"][-1] > 0.0 else record["n_eff"][-1])


def _when(below: float) -> str:
    return f"before N_eff is below {percent(below)} of K" if below > 0.0 else "at all"


def _resample(case: Case, left: float, carry: float, below: float) -> Finding:
    text = f"Only {amount(carry)} of {case.record['particles'][-1]:g} particles carry the weight, and they are not"
    text += f" resampled {_when(below)}: the others are in vain. Resample earlier."
    tries = (f"--from {case.record.steps[0]} --set resample_below={USUAL_BELOW:g}",)
    numbers = {"founders_left": left, "level": float(ENOUGH), "carry": carry}
    return Finding("advice", "resample earlier", text, (), numbers, warns=True, tries=tries)


def _enough(left: float, kinds: Set[str]) -> Finding:
    text, numbers = f"{left:g} founders are left, and {ENOUGH} are enough to tell a spread from", _numbers(left)
    if "overconfident" in kinds:
        text += ": that it is overconfident is not for want of founders alone."
        return Finding("advice", "not for want of particles", text, (), numbers, warns=True)
    return Finding("advice", "enough particles", f"{text}: no more particles are needed.", (), numbers)


def _numbers(left: float, wanted: float = math.nan) -> dict[str, float]:
    told = {"founders_left": left, "level": float(ENOUGH)}
    return told if math.isnan(wanted) else told | {"particles": wanted}


def _more(case: Case, found: Losses, kinds: Set[str]) -> Finding:
    record, left = case.record, float(found.founders[-1])
    K, window, why = float(record["particles"][-1]), _window(record), _why_unsure(case, found, kinds)
    wanted = _up(particles_for(LUCK * ENOUGH, found.per_particle))
    if found.expected() > INHERITED * left:
        wanted = max(wanted, _up(LUCK * ENOUGH * K / left))
    if wanted > PRACTICAL:
        return _in_vain(record, wanted, window, left, why)
    kind = "more particles at least" if why else "more particles"
    if why:
        wanted = max(wanted, min(_up(MORE * K), PRACTICAL)) if _rough(record, found) else wanted
        text = (
            f"More particles help, but these numbers do not tell how many: {', and '.join(why)}. Try {wanted} or more,"
        )
        text += " and diagnose that again"
    elif wanted <= K:
        text = f"{several(left, 'founder')} {are(left)} left by bad luck: with {K:g} particles"
        text += f" {amount(found.expected())} were to be expected"
    else:
        text = f"With {wanted} particles {ENOUGH} founders should be left with most seeds"
    numbers = _numbers(left, wanted)
    if window:
        text += f"; for any {WINDOW} steps alone {window}, by the same reckoning"
        numbers["particles_for_window"] = float(window)
    return Finding("advice", kind, f"{text}.", (), numbers, tries=_tries(record, wanted))


def _why_unsure(case: Case, found: Losses, kinds: Set[str]) -> list[str]:
    """Why the coalescent of other weights may not tell; nothing if it may."""
    record, left, expected = case.record, found.founders[-1], found.expected()
    K, why = record["particles"][-1], []
    sooner = _sooner(record)
    if expected > INHERITED * left:
        why.append(
            f"{left:g} {are(left)} left where {amount(expected)} are expected of as many copies, so that weights depend"
            " on what particles have inherited"
        )
    elif sooner > INHERITED:
        why.append(f"lines meet {sooner:.2g} times sooner than as many copies alone would make them")
    elif "shape of the map" in kinds:
        why.append("the shape of a map is inherited, and decides")
    elif expected < INHERITED:
        why.append(f"with {left:g} left, and few expected, they do not show what particles inherit")
    if any(kind.endswith(" off") for kind in kinds):
        why.append("innovations are not what the filter expects")
    if _in_bottlenecks(record, found):
        fewest = float(np.nanmin(parents(record["particles"], record["related"])[found.start :]))
        why.append(f"a step left no more than {several(rounded(fewest), 'parent')} of {K:g}")
    elif K < SMALL:
        why.append(f"{K:g} particles are too few to tell by")
    return why


def _sooner(record: Record) -> float:
    """How many times sooner lines meet than those of weights that are not inherited; 1 where that cannot be told."""
    if float(np.nan_to_num(record["related"]).sum()) < RENEWED:
        return 1.0
    return 2.0 * (1.0 - 1.0 / record["particles"][-1]) / max(tau_to_common_ancestors(record), 1e-9)


def _rough(record: Record, found: Losses) -> bool:
    """Whether the sum of K r_t is too rough a number, and most likely too small."""
    return _in_bottlenecks(record, found) or record["particles"][-1] < SMALL


def _in_bottlenecks(record: Record, found: Losses) -> bool:
    K, related = (record[name][found.start :] for name in ("particles", "related"))
    few = parents(K, related)
    return bool(related[(few < BOTTLENECK) & (few < 0.5 * K)].sum() > 0.5 * found.tau)


def _in_vain(record: Record, wanted: int, window: int, left: float, why: list[str]) -> Finding:
    steps = len(record.steps)
    if 0 < window <= PRACTICAL:
        text = f"Over {steps} steps lines meet whatever their number ({amount(wanted)} particles would be needed for"
        text += f" {ENOUGH} founders), which does no harm by itself; any {WINDOW} steps alone ask for {window}."
        numbers = _numbers(left) | {"particles_for_window": float(window)}
        return Finding("advice", "particles for a window", text, (), numbers, tries=_tries(record, window))
    text = f"More particles will not help: {', and '.join(why) or f'{steps} steps are too many'}. By these numbers more"
    text += f" than {amount(wanted)} would be needed for {ENOUGH} founders."
    return Finding("advice", "more particles in vain", text, (), _numbers(left, wanted), warns=True)


def _tries(record: Record, wanted: int) -> tuple[str, ...]:
    """From the first step on: founders that are gone do not come back."""
    return (f"--from {record.steps[0]} --set particles={wanted}",) if wanted > record["particles"][-1] else ()


def _window(record: Record) -> int:
    """How many particles keep as many lines over any `WINDOW` steps; 0 of a run that is not much longer."""
    if len(record.steps) < 2 * WINDOW:
        return 0
    sums = np.convolve(record["particles"] * np.nan_to_num(record["related"]), np.ones(WINDOW), "valid")
    return _up(particles_for(LUCK * ENOUGH, max(float(sums.max()), 0.0)))


def _up(particles: float) -> int:
    """Rounded up."""
    return math.ceil(particles / 10.0) * 10
