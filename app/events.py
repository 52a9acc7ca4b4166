"""What is worth telling about a step, in sentences with numbers and the reason."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from app.diagnosis.ancestry import FEW, LEAST_N_EFF
from app.loops import Distances, Loops, right_matches
from app.types import FilterUpdate, SessionStep
from scenarios.words import times
from slam.features import Point, Wall
from slam.metrics import nees_interval
from slam.resampling import wants_resampling
from slam.types import Floats, Frame, Trace
from slam.weights import weight_variance

QUIET = 10
"""[steps] that something must have been away before its return is told."""

UNMATCHED = "not matched"

BLIND = 30.0
"""[s] without an observation after which that is told."""

BLIND_STEPS = 5
"""As many steps must have been empty: where one looks but once in half a minute, one of them says little."""

LASTING = 10
"""[steps] that the NEES must have been above its 95 % band before that is told."""

LOOP = 40.0
"""[m] of travel since a feature was last matched, after which matching it again closes a loop: rightly, where anybody
knows."""


class Event(NamedTuple):
    """One line of the log."""

    level: str
    """WARN, INFO, or DEBUG for what happens all the time."""
    text: str
    who: str = ""
    """Key of the filter; none for the session."""
    kind: str = "changed"
    """What happened, in a word or two: "resampled", "depleted", "loop closed", "nothing seen" ..."""


class Blind(NamedTuple):
    """A stretch without any observation."""

    first: int = 0
    """Its first step."""
    steps: int = 0
    lasted: float = 0.0
    """[s] since something was seen; without time stamps in scans."""


class Watch:
    """Turns steps into events.  What lasts, or comes and goes, is told when it begins and not at every step."""

    def __init__(self, titles: dict[str, str], has_clock: bool = True) -> None:
        """`titles` of the filters by key; `has_clock`: times are seconds, and not the numbers of scans."""
        self._titles = titles
        self._has_clock = has_clock
        self.blind = Blind()
        """The longest stretch of those that were told; of no steps if there was none."""
        self._last: dict[tuple[str, str], int] = {}
        """The last step at which something was so."""
        self._seen: float | None = None
        """[s] when something was last observed; before that, when the session began."""
        self._empty = 0
        """Steps since then."""
        self._blind = False
        """Whether that was told."""
        self._matching = False
        """Whether the last scan went to scan matching."""
        self._travelled = 0.0
        self._odometry: Floats | None = None
        self._loops = {key: Loops() for key in titles}
        self._above: dict[str, int] = {}
        """Steps in a row for which the NEES of a filter has been above its band."""
        self._duplicates: dict[str, float] = {}
        """The most that a filter has had."""

    def step(self, step: SessionStep) -> list[Event]:
        """The events of this step, in the order of cause and effect."""
        if self._odometry is not None:
            self._travelled += math.dist(self._odometry[:2], step.odometry[:2])
        self._odometry = step.odometry
        events = [Event("INFO", f"Parameter changed: {change}") for change in step.changes]
        events += self._sight(step.index, step.frame)
        events += self._matched(step)
        for key, update in step.filters.items():
            told = self._of_filter(key, update, step)
            events += [Event(level, f"{self._titles[key]} {text}", key, kind) for kind, level, text in told]
        return events

    def _matched(self, step: SessionStep) -> Iterator[Event]:
        """That scan matching is not used, and when it is used again for as long as that would be told anew."""
        before, self._matching = self._matching, step.match is not None
        # the first scan, also after matching was off, has nothing to be matched with, and says nothing of the next ones
        if step.match is None or not before:
            return
        missed = self._last.get(("", UNMATCHED), -QUIET)
        if self._begins("", UNMATCHED, not step.match.used, step.index):
            yield Event("INFO", f"Scan matching is not used: {step.match.reason}", kind="not matched")
        elif step.match.used and step.index - missed == QUIET:
            yield Event("INFO", f"Scan matching is used again since step {missed + 1}", kind="matched again")

    def _sight(self, index: int, frame: Frame) -> Iterator[Event]:
        """That nothing is seen, when that has lasted; and when it ends."""
        if self._seen is None:
            self._seen = frame.time - float(np.sum(frame.dt))
        gone = frame.time - self._seen
        if len(frame.z) > 0:
            if self._blind:
                after = f"{gone:.1f} s" if self._has_clock else f"{gone:.0f} scans"
                yield Event("INFO", f"Something is seen again, after {after}", kind="seen again")
            self._seen, self._empty, self._blind = frame.time, 0, False
            return
        self._empty += 1
        if not self._blind and gone >= BLIND and self._empty >= BLIND_STEPS:
            self._blind = True
            told = f"since {self._seen:.1f} s, for {gone:.0f} s" if self._has_clock else f"for {gone:.0f} scans"
            yield Event("WARN", f"Nothing has been seen {told}", kind="nothing seen")
        if self._blind and gone > self.blind.lasted:
            self.blind = Blind(index - self._empty + 1, self._empty, gone)

    def _of_filter(self, key: str, update: FilterUpdate, step: SessionStep) -> Iterator[tuple[str, str, str]]:
        """Kind, level and text."""
        trace, measures = update.trace, update.measures
        K = len(trace.weighted.log_w)
        for sentence in trace.events:
            if self._begins(key, sentence, True, step.index):
                yield "reports", "WARN", f"reports: {sentence}"
        if self._begins(key, "association lost", bool(measures.wrong or measures.missed), step.index):
            yield "association lost", "WARN", _association_lost(measures.correct, measures.wrong, measures.missed)
        gaps = self._loops[key].step(trace, measures.best, self._travelled)
        far = gaps >= LOOP
        if far.any():
            far &= right_matches(trace, step.frame.tags, measures.best)
        if self._begins(key, "loop closed", bool(far.any()), step.index):
            yield "loop closed", "INFO", _loop_closed(gaps[far])
        absorbed = 0 if trace.merged is None else int(np.count_nonzero(trace.merged[measures.best] >= 0))
        if self._begins(key, "merged", absorbed > 0, step.index):
            yield "merged", "INFO", _merged(absorbed, measures.features)
        if self._begins(key, "singular", measures.nees_position == math.inf, step.index):
            text = "has an infinite NEES: its particles agree on one position, and the truth is another"
            yield "singular", "WARN", text
        yield from self._consistency(key, update, step.index)
        if measures.duplicates > self._duplicates.get(key, 0.0):
            if self._begins(key, "duplicate born", True, step.index):
                yield "duplicate born", "WARN", _duplicate_born(measures.duplicates, measures.features)
            self._duplicates[key] = measures.duplicates
        if K == 1:
            return
        if self._begins(key, "depleted", trace.n_eff < max(FEW * K, LEAST_N_EFF), step.index):
            yield "depleted", "WARN", _depleted(update, step.frame)
        if trace.did_resample:
            yield "resampled", "DEBUG", _resampled(update, step.params.resample_below)
        if self._begins(key, "one founder", len(np.unique(trace.resampled.lineage)) == 1, step.index):
            text = f"has one founder left: all {K} particles share one past, up to {_age(update)}"
            yield "one founder", "WARN", text

    def _consistency(self, key: str, update: FilterUpdate, index: int) -> Iterator[tuple[str, str, str]]:
        """That a filter has been overconfident for some time."""
        measures = update.measures
        self._above[key] = self._above.get(key, 0) + 1 if measures.nees_position > nees_interval(2)[1] else 0
        if self._begins(key, "overconfident", self._above[key] >= LASTING, index):
            yield "overconfident", "WARN", _overconfident(update)

    def _begins(self, key: str, what: str, present: bool, index: int) -> bool:
        """Whether something is there that was not there in the last steps."""
        if not present:
            return False
        before = self._last.get((key, what))
        self._last[key, what] = index
        return before is None or index - before > QUIET


def _association_lost(correct: int, wrong: int, missed: int) -> str:
    parts = []
    if wrong:
        parts.append(f"{wrong} paired with something else")
    if missed:
        parts.append(f"{missed} not recognised")
    return f"lost association: of {correct + wrong + missed} things seen that its best map knows, {' and '.join(parts)}"


def _overconfident(update: FilterUpdate) -> str:
    measures, numbers = update.measures, update.evidence.numbers
    nees = "infinite" if math.isinf(measures.nees_position) else f"{measures.nees_position:.3g}"
    return (
        f"is overconfident: its NEES has been above the 95 % band for {LASTING} steps and is {nees} now; it is "
        f"{measures.position_error_m:.2g} m off, where it believes in a deviation of {numbers.spread_m:.2g} m"
    )


def _duplicate_born(duplicates: float, features: int) -> str:
    what = "a feature shows" if duplicates == 1.0 else f"{duplicates:.0f} features show"
    return f"has mapped something twice: of the {features} in its best map {what} what another one shows already"


def _loop_closed(gaps: Distances) -> str:
    what = "a feature" if len(gaps) == 1 else f"{len(gaps)} features"
    return f"closed a loop: {what} of its best map matched again after {gaps.max():.0f} m"


def _merged(absorbed: int, left: int) -> str:
    what = "a wall" if absorbed == 1 else f"{absorbed} walls"
    return f"merged {what} of its best map with older ones, since something seen lies along both; it has {left} now"


def _depleted(update: FilterUpdate, frame: Frame) -> str:
    """How far, and what this step had to do with it (`slam.weights`)."""
    trace = update.trace
    K, heaviest = len(trace.weighted.log_w), float(np.exp(trace.weighted.log_w.max()))
    text = f"is depleted: N_eff fell to {trace.n_eff:.1f} of {K}, one particle holds {heaviest:.0%} of the weight"
    why = weight_variance(trace)
    if not why.deviation > 0.0:
        return text
    first, second = COMPONENTS[type(frame.feature)]
    parts = {first: why.first, second: why.second, "what was not matched": why.unmatched, "the draw": why.drawn}
    shares = [f"{share:.0%} by {part}" for part, share in parts.items() if round(share, 2)]
    i = int(np.argmax(why.observations))
    text += f"; in this step {_observation(trace, i, update.measures.best)} of {len(why.observations)} has "
    text += f"{why.observations[i]:.0%} of the variance of the log weights; {', '.join(shares)}"
    if not math.isnan(why.inside):
        text += f"; {why.inside:.0%} of the particles are where the likelihood is"
    return text


COMPONENTS = {Point: ("ranges", "bearings"), Wall: ("lateral offsets", "angles")}
"""Of an observation, by the kind of the feature."""


def _observation(trace: Trace, i: int, best: int) -> str:
    n = trace.n[best, i]
    return f"observation {i + 1}" + (f" (feature {n} of the best map)" if n >= 0 else "")


def _resampled(update: FilterUpdate, threshold: float) -> str:
    trace = update.trace
    K, children = len(trace.weighted.log_w), np.bincount(trace.selected)
    reason = f"of {K}"
    if threshold < 1.0:  # or else always, whatever N_eff is
        below = wants_resampling(trace.n_eff, K, threshold)
        reason = f"< {threshold:.0%} of {K}" if below else f"of {K}, although not below {threshold:.0%} of K"
    return (
        f"resampled: N_eff {trace.n_eff:.1f} {reason}; {np.count_nonzero(children)} live on, "
        f"one {times(int(children.max()))}; {update.measures.diversity:.0%} of the founders left"
    )


def _age(update: FilterUpdate) -> str:
    age = update.measures.common_ancestor_age
    return "the present" if age == 0 else f"{age:.0f} step{'s' if age > 1 else ''} ago"
