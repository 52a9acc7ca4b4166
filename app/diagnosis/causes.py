"""What decided who lived: the variance of the log weights of the steps before a loss, and what it consists of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.diagnosis.ancestry import great_losses, losses, since_resampling
from app.diagnosis.evidence import Observations, Record
from app.diagnosis.findings import Case, Finding, amount, percent
from slam.types import Bools, Floats, Ints

MOST = 0.5
"""Share of the variance from which on something is called the cause."""

FIXES_A_POSE = 2
"""Observations that fix it at the least: two numbers each, against three unknowns.  What more there are say something
of the map, if they are expected as sharply as that."""

SHARP = 2.0
"""Expected deviation over that of the sensor below which the pose has no part in an observation any more."""

WORTH_TELLING = 1.5
"""The same, from which on it is told."""

WIDE = 3.0
"""Spread between particles over what each expects, from which on most are where the likelihood is not."""

DISAGREE = 0.25
"""Share of what is seen that particles neither match nor take for new, from which on that is told."""

TOLD = 3
"""Losses, and features, that are told."""


class Causes(NamedTuple):
    """The parts of the variance of the log weights, summed over some steps; shares are of `variance`."""

    variance: float
    """Sum over the steps of the variance of what each has added."""
    first: float
    second: float
    unmatched: float
    drawn: float
    shape: float
    """Of observations that say something of the map's shape only (`of_the_shape`)."""
    features: dict[int, float]
    """By index in the best map of the step that weighed most (`decisive`): the share of each, the largest first."""
    decisive: int
    """Index of the step whose weights varied most."""
    wide: tuple[float, float]
    """The widest proposal, over the sensor, of these steps: first and second components."""
    inside: float
    """Share of the particles that the likelihood reaches, in the worst of these steps."""


def of_the_shape(seen: Observations, in_turn: float) -> Bools:
    """(Z,) which of the observations are over-determined.

    Where each is weighed at the pose that those before have corrected (`in_turn`: the exact, joint likelihood), the
    first ones are as uncertain as the pose was, and fix it; what later ones expect is as sharp as the sensor, and
    particles differ in them only by the shape of their maps.  Where all are weighed at the predicted pose, or where
    there is no pose uncertainty at all, there are none.
    """
    matched = np.flatnonzero(np.isfinite(seen.widths))
    found = np.zeros(len(seen.widths), bool)
    if len(matched) > FIXES_A_POSE and in_turn != 0.0:
        widths = seen.widths[matched]
        later = np.arange(len(matched)) >= FIXES_A_POSE
        found[matched] = later & (widths < SHARP) & (widths.max() >= SHARP * widths)
    return found


def causes(record: Record, steps: slice | Ints) -> Causes:
    """What the weights of these steps (indices) differ by."""
    variances = np.nan_to_num(record["deviation"][steps]) ** 2
    indices = np.arange(len(record.steps))[steps]
    total = float(variances.sum())

    def share(parts: Floats) -> float:
        return float(variances @ np.nan_to_num(parts)) / total if total > 0.0 else 0.0

    decisive = int(indices[np.argmax(variances)])
    features: dict[int, float] = {}
    shape = np.zeros(len(indices))
    if record.observations:
        shape[:] = [_by_shape(record.observations[i], float(record["in_turn"][i])) for i in indices]
        seen = record.observations[decisive]
        for feature, part in zip(seen.features.tolist(), np.nan_to_num(seen.shares).tolist(), strict=True):
            features[feature] = features.get(feature, 0.0) + part
    return Causes(
        total,
        share(record["first"][steps]),
        share(record["second"][steps]),
        share(record["unmatched"][steps]),
        share(record["drawn"][steps]),
        share(shape),
        dict(sorted(features.items(), key=lambda item: -item[1])),
        decisive,
        (_largest(record["wide_first"][steps]), _largest(record["wide_second"][steps])),
        float(np.nanmin(record["inside"][steps])) if np.isfinite(record["inside"][steps]).any() else np.nan,
    )


def _by_shape(seen: Observations, in_turn: float) -> float:
    """The share of a step that is over-determined."""
    return float(np.nan_to_num(seen.shares)[of_the_shape(seen, in_turn)].sum())


def _largest(values: Floats) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else np.nan


def components(case: Case) -> tuple[str, str]:
    """What the two numbers of an observation are."""
    return ("lateral offsets", "angles") if case.walls else ("ranges", "bearings")


def findings(case: Case) -> list[Finding]:
    """What decided over the whole run, and at each of the greatest losses."""
    record = case.record
    if "deviation" in record.missing or not np.nan_to_num(record["deviation"]).any():
        return []
    greatest = great_losses(record)
    leading = np.zeros(len(record.steps), bool)
    for i in greatest:
        leading[since_resampling(record, int(i))] = True
    whole = causes(record, np.flatnonzero(leading) if len(greatest) else slice(None))
    when = "the losses" if len(greatest) else "all steps"
    found = [_of_all(case, whole, when, tuple(int(record.steps[i]) for i in greatest[:TOLD]))]
    found += [_of_one(case, int(i)) for i in sorted(greatest[:TOLD])]
    ignored = _ignored(record)
    if ignored > DISAGREE:
        text = (
            f"Of what was seen, a particle ignored {percent(ignored)} on the average: too far from what it knows to be"
        )
        text += " matched, and too near to be new. Its pose is not where the likelihood is, or the gate is too narrow."
        found.append(Finding("association", "ignored", text, (), {"share": ignored}, warns=True))
    return found


def _ignored(record: Record) -> float:
    observed = record["observed"].sum()
    return float(1.0 - (record["matched"] + record["new"]).sum() / observed) if observed > 0.0 else 0.0


def kind_of(found: Causes) -> str:
    """The cause in a word or two; "observations" where none stands out."""
    if found.shape >= MOST:
        return "shape of the map"
    if found.unmatched >= MOST:
        return "what was not matched"
    if max(found.wide) >= WIDE:
        return "proposal wider than the sensor"
    return "draw of the pose" if found.drawn >= MOST else "observations"


def _of_all(case: Case, found: Causes, when: str, steps: tuple[int, ...]) -> Finding:
    kind = kind_of(found)
    text = f"Of the variance of the log weights before {when}, {_parts(case, found)}."
    if not steps:
        text = f"No step lost many founders. {text}"
    if kind == "shape of the map":
        text += f" {percent(found.shape)} is due to the over-determined shape of the map: the first observations of a"
        text += " step fix the pose, and in those after them particles differ only by how what they have mapped lies to"
        text += " each other."
    elif kind == "what was not matched":
        text += " Particles disagree on what is known and what is new."
    elif kind == "proposal wider than the sensor":
        text += f" The poses are spread {amount(max(found.wide))} times wider than the sensor tells them apart: in the"
        text += f" worst step {percent(found.inside)} of them are where the likelihood is."
    return Finding("cause", kind, text, steps, _numbers(found), warns=bool(steps) and kind != "observations")


def _numbers(found: Causes) -> dict[str, float]:
    told = {"variance": found.variance, "first": found.first, "second": found.second, "unmatched": found.unmatched}
    return told | {"drawn": found.drawn, "shape": found.shape, "wide": max(found.wide), "inside": found.inside}


def _parts(case: Case, found: Causes) -> str:
    first, second = components(case)
    parts = {first: found.first, second: found.second, "what was not matched": found.unmatched, "the draw": found.drawn}
    ordered = sorted(parts.items(), key=lambda item: -item[1])
    told = [f"{percent(share)} is by {what}" for what, share in ordered if share >= 0.005]
    told += [f"{percent(share)} by {what}, against the others" for what, share in ordered if share <= -0.005]
    return ", ".join(told) or "nothing stands out"


def _of_one(case: Case, index: int) -> Finding:
    record = case.record
    steps, founders = since_resampling(record, index), losses(record).founders
    found = causes(record, steps)
    before = founders[index - 1] if index else record["particles"][0]
    K, step = record["particles"][index], int(record.steps[index])
    first = int(record.steps[steps.start])
    text = f"Step {step}: founders {before:g} to {founders[index]:g}, N_eff {record['n_eff'][index]:.3g} of {K:g}; of"
    text += f" the variance of the log weights since step {first}, {_parts(case, found)}"
    features = {f: share for f, share in found.features.items() if f >= 0}
    great = [(f, share) for f, share in features.items() if share >= 0.1][:TOLD]
    if great:
        named = ", ".join(f"feature {f} {percent(share)}" for f, share in great)
        against = sum(share for share in found.features.values() if share < 0.0)
        named += f", others {percent(against)}, against them" if against <= -0.005 else ""
        text += f"; of that at step {record.steps[found.decisive]}, {named} (of the best map)"
    kind = kind_of(found)
    if kind == "shape of the map":
        text += f"; {percent(found.shape)} by the shape of the map"
    if max(found.wide) >= WORTH_TELLING:
        text += f"; the proposal is {amount(max(found.wide))} times as wide as the sensor"
        text += f", and the likelihood reaches {percent(found.inside)} of the particles"
    numbers = {"founders_before": float(before), "founders_after": float(founders[index]), "since_step": float(first)}
    numbers |= {"n_eff": float(record["n_eff"][index]), "particles": float(K), **_numbers(found)}
    numbers |= {f"feature_{f}": share for f, share in features.items()}
    return Finding("cause", f"loss: {kind}", text + ".", (step,), numbers)
