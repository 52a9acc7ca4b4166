"""Whether a filter knows how wrong it is: its errors beside its covariance, its innovations beside what it expected,
and what the luck of its particles adds."""

from __future__ import annotations

import math

import numpy as np

from app.diagnosis.causes import components
from app.diagnosis.findings import Case, Finding, amount, percent, several
from slam.metrics import nees_interval
from slam.types import Bools, Floats

LEAST = 10
"""Steps below which nothing is said."""

TOO_MANY = 0.25
"""Share above the band from which on a filter is called overconfident.  Ten times what is expected: errors of one run
last for many steps, so that far more than 2.5 % may be above it by bad luck alone."""

SOME = 0.1
"""Share above the band that is worth a word."""

MEDIAN = 2.0 * math.log(2.0)
"""Of a chi-square with two degrees of freedom."""

LOW = 3.0
"""Factor between that and the median of a NEES, from which on a filter is called cautious."""

SIGNIFICANT = 4.0
"""Deviations from 1 of a mean squared innovation, from which on it is no accident."""

MATTERS = 1.5
"""Factor between expected and actual squared innovation below which nobody needs to care."""

LUCKY = 0.1
"""Of the variance that a filter reports, how much the luck of its particles may add before that is a warning: as if the
estimate were the mean of ten independent draws.  It can't be many times more: of the five families that it takes to
tell (`slam.ancestry_variance`), .25 at the most if they are equal."""


def findings(case: Case) -> list[Finding]:
    """Of the errors, of the innovations, and of luck."""
    errors, innovations = _errors(case), _innovations(case)
    return [*errors, *innovations, *_unseen(errors, innovations), *_luck(case)]


def _errors(case: Case) -> list[Finding]:
    nees, steps = case.record["nees_position"], case.record.steps
    there = ~np.isnan(nees)
    if there.sum() < LEAST:
        return []
    low, high = nees_interval(2)
    above, below = float((nees[there] > high).mean()), float((nees[there] < low).mean())
    numbers = {"above": above, "below": below, "median": float(np.median(nees[there])), "band": high}
    text = (
        f"The NEES of the position is above its 95 % band in {percent(above)} of the steps (expected: 2.5 %), and its"
    )
    text += f" median is {amount(numbers['median'], 3)} (expected: 1.39)"
    text += ", beside a truth that was measured and has errors of its own" if case.measured else ""
    if above < TOO_MANY:
        kind, more = _verdict(above, below, numbers["median"])
        return [Finding("consistency", kind, f"{text}: {more}. One run says little; more seeds do.", (), numbers)]
    begin, end = _longest(nees[there] > high)
    since, until = (int(steps[there][i]) for i in (begin, end - 1))
    text += ": in this run it is overconfident"
    text += f", longest from step {since} to {until}" if end - begin >= LEAST else ""
    infinite = float(np.isinf(nees[there]).mean())
    if infinite > 0.0:
        text += f"; in {percent(infinite)} its particles agree on one pose altogether"
    return [Finding("consistency", "overconfident", text + ".", (since,), numbers, warns=True)]


def _verdict(above: float, below: float, median: float) -> tuple[str, str]:
    """Of a NEES that is not above its band in many steps: the kind of finding, and the words for it."""
    if below >= TOO_MANY or median < MEDIAN / LOW:
        return "cautious", "errors are smaller than it believes"
    if above > SOME:
        return "consistent", "more than expected, but errors last, so that it may be chance"
    return "consistent", "no sign of overconfidence"


def _longest(above: Bools) -> tuple[int, int]:
    """Where the longest time that it is so begins, and where it has ended; (0, 0) for never."""
    edges = np.diff(np.concatenate([[0], above.astype(int), [0]]))
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    if not len(begins):
        return 0, 0
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest])


def _innovations(case: Case) -> list[Finding]:
    record, found = case.record, []
    for name, what in zip(("nis_first", "nis_second"), components(case), strict=True):
        ratio, deviations, count = mean_ratio(record[name], record["matched"])
        if count < LEAST:
            continue
        numbers = {"ratio": ratio, "deviations": deviations, "steps": float(count)}
        if deviations > SIGNIFICANT and ratio > MATTERS:
            text = f"The squared innovations of {what} are {amount(ratio)} times what the filter expects,"
            text += f" {deviations:.0f} standard deviations above 1: it takes itself or the sensor for"
            text += f" {amount(math.sqrt(ratio))} times better than they are."
            found.append(Finding("consistency", f"{what} off", text, (), numbers, warns=True))
        elif deviations < -SIGNIFICANT and ratio < 1.0 / MATTERS:
            text = f"The squared innovations of {what} are {amount(ratio)} of what the filter expects"
            text += _on_purpose(case)
            found.append(Finding("consistency", f"{what} cautious", text, (), numbers))
        elif ratio > MATTERS:
            worst = int(record.steps[np.nanargmax(record[name])])
            text = f"The squared innovations of {what} are {amount(ratio)} times what the filter expects, but few steps"
            text += f" make that, most of all step {worst}: something was matched wrongly there, or far from where it"
            text += " was expected."
            found.append(Finding("consistency", f"{what} off at times", text, (worst,), numbers, warns=True))
        else:
            text = f"The squared innovations of {what} are {ratio:.2g} times what is expected: "
            near = ratio >= 1.0 / MATTERS
            text += "as they should be." if near else f"less, but in {several(count, 'step')} that may be chance."
            found.append(Finding("consistency", f"{what} as expected", text, (), numbers))
    return found


def _unseen(errors: list[Finding], innovations: list[Finding]) -> list[Finding]:
    """Where errors are larger than a filter believes, but what it sees is not."""
    usual = [finding for finding in innovations if not finding.warns]
    if len(usual) < 2 or not any(finding.kind == "overconfident" for finding in errors):
        return []
    text = "What it sees of known features is as it expects, and its pose is not: an error that pose and map have in"
    text += " common does not show in innovations, only where something old is seen again."
    return [Finding("consistency", "error unseen", text)]


def _on_purpose(case: Case) -> str:
    inflated = float(case.params.get("inflate_r", 1.0))
    if inflated > 1.0:
        floors = " and floors" if case.walls else ""
        return f": known features are allowed more than the noise of the sensor, by inflate_r {inflated:g}{floors}."
    return ": it believes itself or the sensor to be worse than it is, and wastes what it sees."


def _luck(case: Case) -> list[Finding]:
    """How uncertain the estimate is by luck alone, at the last step at which that can be told."""
    record = case.record
    luck, spread = record["monte_carlo_m"], record["spread_m"]
    told = np.flatnonzero((luck > 0.0) & (spread > 0.0))  # neither for a single particle, nor when no founders tell
    if len(told) < LEAST:
        return []
    last = int(told[-1])
    step, added = int(record.steps[last]), float(luck[last] / spread[last]) ** 2
    warns = added > LUCKY
    text = f"By the luck of its particles alone its estimate of the position is uncertain by {luck[last]:.2g} m at step"
    text += f" {step} (one standard deviation, told by who descends from whom), beside the {spread[last]:.2g} m that it"
    text += f" reports: that adds {percent(added)} to the variance of its errors"
    text += ", and less with more particles." if warns else "."
    if last < len(record.steps) - LEAST:
        text += " After that too few founders are left to tell; what luck did to all particles alike, nobody sees."
    numbers = {"luck_m": float(luck[last]), "reported_m": float(spread[last]), "added": added, "step": float(step)}
    return [Finding("consistency", "luck", text, (step,), numbers, warns=warns)]


def mean_ratio(ratios: Floats, weights: Floats) -> tuple[float, float, int]:
    """Mean of squared innovations over their expectation, by how many there were in each step; how many standard
    deviations that is from 1; and in how many steps there were any.

    Those of one step count as one, since they may share the error of the pose.  The deviation is that of a chi-square
    with one degree of freedom or that of the ratios themselves, whichever is larger.
    """
    there = np.isfinite(ratios) & (weights > 0.0)
    count = int(there.sum())
    if count == 0:
        return math.nan, math.nan, 0
    w = weights[there] / weights[there].sum()
    ratio = float(w @ ratios[there])
    own = float(np.sqrt(w @ (ratios[there] - ratio) ** 2)) if ratio > 1.0 else 0.0
    deviation = max(math.sqrt(2.0), own) * math.sqrt(float(w @ w))
    return ratio, (ratio - 1.0) / deviation, count
