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
from typing import NamedTuple

import numpy as np

from app.diagnosis.evidence import Record
from app.diagnosis.findings import Case, Finding, are, percent, several
from slam.types import Floats, Ints

FEW = 0.1
"""Share of K: below it N_eff means depleted, as in the events."""

ENOUGH = 10
"""Founders that should be left: enough to tell a spread from."""

LUCK = 3.0
"""So many times more are asked for: how many are left differs from run to run, and so does tau, of which there is but
one.  With twice as many, 5 of 10 runs with other seeds kept `ENOUGH` in the worst of the settings of `dualslam study
diagnosis`; how many do now is in app/README.md."""

GREAT_LOSS = 0.1
"""Share of the founders that were left, above which the loss of some is worth a sentence."""


class Losses(NamedTuple):
    """How the founders went."""

    founders: Floats
    """(T,) how many are left after each step."""
    first: float
    """How many there were before the first."""
    tau: float
    """The sum of r_t."""
    per_particle: float
    """The sum of K r_t: tau for any K, times K."""

    def expected(self) -> float:
        """n(tau): how many founders are left if weights have nothing to do with what is inherited."""
        return 1.0 / (1.0 - (1.0 - 1.0 / max(self.first, 1.0)) * math.exp(-0.5 * self.tau))

    def when(self, share: float) -> int | None:
        """Index of the first step after which no more than this share is left; None if it never was so few."""
        few = np.flatnonzero(self.founders <= share * self.first)
        return int(few[0]) if len(few) else None


def losses(record: Record) -> Losses:
    """The founders of a record."""
    K, related = record["particles"], np.nan_to_num(record["related"])
    founders = np.round(record["diversity"] * K)
    return Losses(founders, float(K[0]), float(related.sum()), float((K * related).sum()))


def particles_for(founders: float, per_particle: float) -> float:
    """K at which so many founders are expected to be left: n(tau) = founders with tau = `per_particle` / K, K large."""
    return per_particle / (-2.0 * math.log(1.0 - 1.0 / founders))


def great_losses(record: Record) -> Ints:
    """Indices of the steps at which most founders went, the greatest loss first."""
    founders = losses(record).founders
    before = np.concatenate([record["particles"][:1], founders[:-1]])
    lost = np.maximum(before - founders, 0.0)
    order = np.argsort(-lost, kind="stable")
    return order[lost[order] > GREAT_LOSS * before[order]]


def since_resampling(record: Record, index: int) -> slice:
    """The steps whose weights a resampling at this one goes by: back to the one before."""
    before = np.flatnonzero(record["resampled"][:index] > 0.0)
    return slice(int(before[-1]) + 1 if len(before) else 0, index + 1)


def findings(case: Case) -> list[Finding]:
    """How many are left, since when, and how often the filter was depleted."""
    record = case.record
    if "diversity" in record.missing or not len(record.steps):
        return []
    found, K = losses(record), record["particles"]
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
            text += f"; as many copies, made by weights that are not inherited, would leave {found.expected():.2g}"
    few = left <= max(FEW * found.first, 1.0)
    result = [Finding("diversity", "founders", text + ".", tuple(at.values()), numbers, warns=bool(few))]
    depleted = np.flatnonzero(record["n_eff"] < np.maximum(FEW * K, 1.5))
    worst = int(np.nanargmin(record["n_eff"] / K)) if np.isfinite(record["n_eff"]).any() else 0
    if len(depleted):
        steps = tuple(int(record.steps[i]) for i in (worst, *depleted[:5]) if i in depleted)
        text = f"N_eff was below {percent(FEW)} of K in {several(len(depleted), 'step')} of {len(record.steps)}"
        text += f", at the worst {record['n_eff'][worst]:.2g} of {K[worst]:g} at step {record.steps[worst]}."
        share = {"share_of_steps": len(depleted) / len(record.steps), "worst_n_eff": float(record["n_eff"][worst])}
        result.append(Finding("diversity", "depleted", text, tuple(dict.fromkeys(steps)), share, warns=True))
    return result
