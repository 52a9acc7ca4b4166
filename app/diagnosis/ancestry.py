"""When diversity was lost, and how many particles would have kept it.

Of all pairs of particles after a step, let r_t be the share that has one parent (`Numbers.related`): 1 / r_t is how
many parents, equal among each other, would do the same.  As long as weights have nothing to do with what a particle
has inherited, the lines of descent are a coalescent (J. F. C. Kingman, "The coalescent", Stoch. Proc. Appl. 13, 1982):
n lines meet at the rate n (n - 1) / 2 for each unit of tau = sum r_t, so that of K founders

    n(tau) = 1 / (1 - (1 - 1 / K) exp(-tau / 2))

are left (in the mean-field approximation dn/dtau = -n (n - 1) / 2).  Since r_t is 1 / K times something that does not
depend on K, so is tau, which says how many particles keep n founders.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from app.diagnosis.evidence import Record
from app.diagnosis.findings import Case, Finding, amount, are, percent, several, were
from slam.types import Floats, Ints

FEW = 0.1
"""Share of K: below it N_eff means depleted, as in the events."""

LEAST_N_EFF = 1.5
"""N_eff below which a filter of any size is depleted."""

ENOUGH = 10
"""Founders that should be left: enough to tell a spread from."""

LUCK = 3.0
"""So many times more are asked for: how many are left differs from run to run, and so does tau, of which there is but
one.  With twice as many, 5 of 10 runs with other seeds kept `ENOUGH` in the worst of the settings of `dualslam study
diagnosis`; how many do now is in app/README.md."""

GREAT_LOSS = 0.1
"""Share of the founders that were left, above which the loss of some is worth a sentence."""


class Losses(NamedTuple):
    """How the founders went, as long as there were as many particles as at the end."""

    founders: Floats
    """(T,) how many are left after each step of the record."""
    start: int
    """Index of the first of its steps that counts: the first one, or that at which K was changed last."""
    first: float
    """How many founders there were before it; or after it, if only that is known."""
    tau: float
    """The sum of r_t since then."""
    per_particle: float
    """The sum of K r_t over the whole record: tau for any K, times K."""

    def expected(self) -> float:
        """n(tau): how many founders are left if weights have nothing to do with what is inherited."""
        return left_of(self.first, self.tau)

    def when(self, share: float) -> int | None:
        """Index of the first step after which no more than this share is left; None if it never was so few."""
        few = np.flatnonzero(self.founders[self.start :] <= share * self.first)
        return self.start + int(few[0]) if len(few) else None


def losses(record: Record) -> Losses:
    """The founders of a record."""
    K, related = record["particles"], np.nan_to_num(record["related"])
    founders, start = np.round(record["diversity"] * K), since_change(record)
    begins = start == 0 and _begins(record, founders)
    tau = float(related[start if begins else start + 1 :].sum())
    return Losses(founders, start, float(K[0] if begins else founders[start]), tau, float((K * related).sum()))


def _begins(record: Record, founders: Floats) -> bool:
    """Whether the first step of a record is the filter's first one: then every particle is a founder, and as many are
    left as have descendants.  Of a part from the middle of a run, more have that."""
    survivors = record["survivors"][0]
    return bool(record.steps[0] == 1 if math.isnan(survivors) else founders[0] == survivors)


def since_change(record: Record) -> int:
    """Index of the first step with as many particles as there are at the end."""
    changed = changes(record)
    return int(changed[-1]) if len(changed) else 0


def changes(record: Record) -> Ints:
    """Indices of the steps that began with another number of particles: a person has changed K."""
    return 1 + np.flatnonzero(np.diff(record["particles"]) != 0.0)


def left_of(founders: float, tau: float) -> float:
    """n(tau), the mean number of lines that so many founders come to."""
    return 1.0 / (1.0 - (1.0 - 1.0 / max(founders, 1.0)) * math.exp(-0.5 * tau))


def parents(K: Floats, related: Floats) -> Floats:
    """How many parents, equal among each other, would do what each step did: K^2 over the sum of squares of their
    numbers of children, 1 / r_t of many particles."""
    return K / (1.0 + related * (K - 1.0))


def particles_for(founders: float, per_particle: float) -> float:
    """K of which so many founders are expected to be left: n(tau) = founders, with tau = `per_particle` / K.

    It is between the founders, if no step takes any, and what 1 / n <= 1 / K + tau / 2 asks for; both with room for
    rounding.
    """
    most = (founders + 1.0) * (1.0 + 0.5 * per_particle)
    found: Any = brentq(lambda K: left_of(K, per_particle / K) - founders, founders - 1.0, most)
    return float(found)


def tau_to_common_ancestors(record: Record) -> float:
    """The mean over the steps of the sum of r_t back to the most recent common ancestor: 2 (1 - 1 / K) of a coalescent.

    From where a run has three times as much behind it; where there is no common ancestor even so, that is all it has.
    """
    before = np.concatenate([[0.0], np.cumsum(np.nan_to_num(record["related"]))])
    ages, steps = record["common_ancestor"], np.arange(len(record.steps))
    then = np.where(np.isfinite(ages), np.maximum(steps + 1 - np.nan_to_num(ages), 0), 0).astype(int)
    sums = (before[1:] - before[then])[before[1:] > 3.0 * 2.0]
    return float(sums.mean()) if len(sums) else math.inf


def great_losses(record: Record) -> Ints:
    """Indices of the steps at which most founders went, the greatest loss first.  Where a person has changed K it is no
    loss by weights."""
    founders = losses(record).founders
    before = np.concatenate([record["particles"][:1], founders[:-1]])
    lost = np.maximum(before - founders, 0.0)
    lost[changes(record)] = 0.0
    if not _begins(record, founders):
        lost[0] = 0.0
    order = np.argsort(-lost, kind="stable")
    return order[lost[order] > GREAT_LOSS * before[order]]


def since_resampling(record: Record, index: int) -> slice:
    """The steps whose weights a resampling at this one goes by: back to the one before, or to a change of K, which
    is one at the beginning of its step."""
    before = np.flatnonzero(record["resampled"][:index] > 0.0)
    changed = changes(record)
    starts = np.concatenate([[0], before[-1:] + 1, changed[changed <= index][-1:]])
    return slice(int(starts.max()), index + 1)


def findings(case: Case) -> list[Finding]:
    """How many are left, since when, and how often the filter was depleted."""
    record = case.record
    if "diversity" in record.missing or not len(record.steps):
        return []
    found = losses(record)
    result = [_changed(record, found)] if found.start else []
    if record["particles"][-1] > 1.0:
        result.append(_founders(record, found))
    depleted = _depleted(record)
    return [*result, depleted] if depleted else result


def _changed(record: Record, found: Losses) -> Finding:
    """That K is not what it was."""
    i, (before, after) = found.start, record["particles"][found.start - 1 : found.start + 1]
    times, step = len(changes(record)), int(record.steps[i])
    text = f"K was changed{f' {times} times, the last time' if times > 1 else ''} from {before:g} to {after:g} at step"
    text += f" {step}, when {several(found.founders[i - 1], 'founder')} {were(found.founders[i - 1])} left: that is no"
    text += " loss by weights. Founders and particles are told of the steps since then."
    return Finding("diversity", "K changed", text, (step,), {"before": float(before), "after": float(after)})


def _founders(record: Record, found: Losses) -> Finding:
    left, last = found.founders[-1], int(record.steps[-1])
    text = f"{left:g} of {several(found.first, 'founder')} {are(left)} left after step {last}"
    marks = {"half": found.when(0.5), "90 %": found.when(0.1)}
    at = {what: int(record.steps[i]) for what, i in marks.items() if i is not None}
    if at:
        text += "; " + ", ".join(f"{what} were gone by step {i}" for what, i in at.items())
    numbers = {"founders_left": float(left), "founders": found.first, "last_step": float(last)}
    if "related" not in record.missing:
        numbers |= {"related": found.tau, "founders_expected": found.expected()}
        if found.tau > 0.0:
            text += f"; as many copies would leave {amount(found.expected())} by chance, if weights were not inherited"
    few = left <= max(FEW * found.first, 1.0)
    return Finding("diversity", "founders", text + ".", tuple(at.values()), numbers, warns=bool(few))


def _depleted(record: Record) -> Finding | None:
    K, n_eff = record["particles"], record["n_eff"]
    depleted = np.flatnonzero((n_eff < np.maximum(FEW * K, LEAST_N_EFF)) & (K > 1.0))
    if not len(depleted):
        return None
    worst = int(depleted[np.argmin(n_eff[depleted] / K[depleted])])
    steps = dict.fromkeys(int(record.steps[i]) for i in (worst, *depleted[:5]))
    limit = f"{percent(FEW)} of K" if FEW * K.min() >= LEAST_N_EFF else f"{LEAST_N_EFF:g} or {percent(FEW)} of K"
    text = f"N_eff was below {limit} in {several(len(depleted), 'step')} of {len(record.steps)}"
    text += f", at the worst {amount(n_eff[worst])} of {K[worst]:g} at step {record.steps[worst]}."
    share = {"share_of_steps": len(depleted) / len(record.steps), "worst_n_eff": float(n_eff[worst])}
    return Finding("diversity", "depleted", text, tuple(steps), share, warns=True)
