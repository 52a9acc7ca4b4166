"""Which of the classic mistakes a filter has in it, told from its numbers alone.

A mistake is named if a statement fails that holds for a right filter by construction, or if what happened has a chance
below `LEVEL` in a right one: that most of the draws of a step are exactly their mean, or that the first particle lives
on and on.  Where nothing happened that could have failed, nothing can be said of that mistake.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from app.diagnosis.evidence import Record
from app.diagnosis.marks import Marks
from slam.checks import ROUNDING
from slam.types import Floats, Ints

LEVEL = 1e-6
"""Chance that a right filter, in one run, is said to have a mistake that only chance tells of."""

UNDERFLOW = math.log(5e-324)
"""Below this natural logarithm a plain number is zero."""

MOST = 0.5
"""Share of the draws of a step above which they are no draws.  Of two at least all must be what each is with a chance
of 4e-7 at the most (`slam.checks.COARSE`)."""

SEVERAL = 2
"""Particles that came to the numbers of others: one may be a chance."""


class Finding(NamedTuple):
    """A mistake that a filter has."""

    mistake: str
    """Its name (`slam.mistakes`)."""
    steps: Ints
    """At which it shows."""
    of: int
    """Steps at which it could have shown."""
    chance: float
    """At most, that a right filter shows this: 0 by construction."""
    text: str
    """A sentence with the numbers."""


class Looked(NamedTuple):
    """What the numbers of one filter say of all mistakes."""

    findings: tuple[Finding, ...]
    clean: tuple[str, ...]
    """Mistakes that would have shown, and did not."""
    open: tuple[str, ...]
    """Mistakes of which nothing that happened could have told."""


def look(record: Record) -> Looked:
    """For each mistake whether the filter has it."""
    findings: list[Finding] = []
    clean, undecided = [], []
    for name, signature in SIGNATURES.items():
        found = signature({field: record[field] for field in Marks._fields}, record.steps)
        if isinstance(found, Finding):
            findings.append(found)
        else:
            (clean if found else undecided).append(name)
    return Looked(tuple(findings), tuple(clean), tuple(undecided))


Columns = Mapping[str, Floats]
"""(T,) by the names of `Marks`."""

Signature = Callable[[Columns, Ints], "Finding | bool"]
"""The finding; or whether there was an occasion for it."""


def _shared_maps(marks: Columns, steps: Ints) -> Finding | bool:
    known = np.isfinite(marks["gained"])
    gained, twins = (np.nan_to_num(marks[name]) for name in ("gained", "twins"))
    several = twins >= SEVERAL
    found = (gained > 0) | several
    if not found.any():
        return bool(known.any())
    parts = []
    if gained.any():
        parts.append(f"a map gained {int(gained.max())} features that its particle had not found new")
    if several.any():
        parts.append(f"{int(twins.max())} particles came to the numbers of others that stood elsewhere")
    return _finding(
        "shared-maps", steps, found, known, f"{' and '.join(parts)}: particles write into each other's maps"
    )


def _weights_not_reset(marks: Columns, steps: Ints) -> Finding | bool:
    unequal = marks["unequal"]
    found = unequal > ROUNDING
    factor = math.exp(min(float(np.nanmax(unequal, initial=0.0)), 700.0))
    return _finding(
        "weights-not-reset", steps, found, np.isfinite(unequal),
        f"after a resampling weights differ from 1 / K by a factor of up to {factor:.3g}: what chose the copies counts "
        f"twice",
    )  # fmt: skip


def _plain_weights(marks: Columns, steps: Ints) -> Finding | bool:
    contradicted = marks["contradicted"]
    found = contradicted > ROUNDING
    least = float(np.nanmin(marks["exponent"][found], initial=math.inf))
    return _finding(
        "plain-weights", steps, found, ~np.isnan(contradicted),
        f"weights are zero, or equal, against what the log likelihoods say; products of densities are down to "
        f"e^{least:.0f} there, and plain numbers end at e^{UNDERFLOW:.0f}",
    )  # fmt: skip


def _unwrapped_angles(marks: Columns, steps: Ints) -> Finding | bool:
    angle, otherwise = (np.nan_to_num(marks[name]) for name in ("angle", "otherwise"))
    beyond = angle > math.pi + ROUNDING
    found = beyond | (otherwise > 0)
    if beyond.any():
        text = f"an innovation has an angle of {math.degrees(float(angle.max())):.0f} degrees"
    else:
        text = f"{int(otherwise.sum())} observations were not paired with what is within their gates"
    told = np.isfinite(marks["angle"]) | np.isfinite(marks["otherwise"])
    return _finding("unwrapped-angles", steps, found, told, f"{text}: a difference of angles was not wrapped")


def _unsampled_proposal(marks: Columns, steps: Ints) -> Finding | bool:
    undrawn = marks["undrawn"]
    found = undrawn > MOST
    share = float(np.max(undrawn[found], initial=0.0))
    return _finding(
        "unsampled-proposal", steps, found, np.isfinite(undrawn),
        f"up to {share:.0%} of what should be draws are exactly the mean",
    )  # fmt: skip


def _features_first(marks: Columns, steps: Ints) -> Finding | bool:
    early = marks["early"]
    return _finding(
        "features-first", steps, early > 0, np.isfinite(early),
        "innovations are those of features as the step leaves them, not as it found them: features were corrected "
        "before the pose",
    )  # fmt: skip


def _resample_always(marks: Columns, steps: Ints) -> Finding | bool:
    needless = marks["needless"]
    return _finding(
        "resample-always", steps, needless > 0, np.isfinite(needless),
        "resampled although N_eff was not below the threshold",
    )  # fmt: skip


def _keep_first(marks: Columns, steps: Ints) -> Finding | bool:
    lived = marks["first_lived"]
    resampled = np.isfinite(lived)
    if not resampled.any():
        return False
    if (lived == 0).any():
        return True
    misplaced = marks["misplaced"] > 0
    chances = np.minimum(marks["first_expected"][resampled], 1.0)
    chance = math.exp(max(float(np.log(np.maximum(chances, 1e-300)).sum()), -700.0))
    if misplaced.any():
        text = "it is in a place that the scheme gives to another one, by all the other places"
        chance = 0.0
    elif chance <= LEVEL:
        text = f"the chance of that is at most {chance:.1g}"
    else:
        return False
    unlikely = np.zeros(len(steps), bool)
    unlikely[resampled] = chances < 1.0
    return Finding(
        "keep-first", steps[misplaced if misplaced.any() else unlikely], int(resampled.sum()), chance,
        f"the first particle outlived all of {int(resampled.sum())} resamplings, and {text}",
    )  # fmt: skip


SIGNATURES: dict[str, Signature] = {
    "shared-maps": _shared_maps,
    "weights-not-reset": _weights_not_reset,
    "plain-weights": _plain_weights,
    "unwrapped-angles": _unwrapped_angles,
    "unsampled-proposal": _unsampled_proposal,
    "features-first": _features_first,
    "resample-always": _resample_always,
    "keep-first": _keep_first,
}
"""By the name of the mistake."""


def _finding(mistake: str, steps: Ints, found: np.ndarray, told: np.ndarray, text: str) -> Finding | bool:
    """By construction, at the steps `found` of those that `told`."""
    if not found.any():
        return bool(told.any())
    where = steps[found]
    times = f"at {len(where)} of {int(told.sum())} steps, first at {where[0]}"
    return Finding(mistake, where, int(told.sum()), 0.0, f"{times}: {text}")
