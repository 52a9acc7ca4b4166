"""What a step of a filter leaves as evidence: the numbers that a diagnosis is made of.

Everything a diagnosis says comes from these, so that it says the same of a session that runs and of its recording.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from app.diagnosis.marks import Marks, marks_of
from slam.ancestry_variance import luck_of_pose
from slam.checks import uncertain
from slam.metrics import Measures
from slam.phases import noise_of_known, observation_noise
from slam.types import Bools, Floats, Frame, Ints, Params, Trace
from slam.weights import innovation_statistics, innovation_widths, mixtures, parents, weight_variance, weights_before


class Numbers(NamedTuple):
    """Of one step of one filter.  All are floats, and NaN where there is nothing to tell."""

    particles: float
    """K, as weighted."""
    n_eff: float
    """(44), of the new weights."""
    n_eff_before: float
    """The same of the weights that the step began with: K after a resampling."""
    heaviest: float
    """Weight of the heaviest particle, 0 to 1."""
    resampled: float
    """1 if it resampled, else 0."""
    threshold: float
    """`Params.resample_below`."""
    survivors: float
    """How many particles of before have a descendant after the step."""
    related: float
    """Of all pairs of particles after the step, the share that has one parent: sum N (N - 1) / (K (K - 1))."""
    diversity: float
    """Share of the founders that are left."""
    common_ancestor: float
    """[steps] back to the most recent common ancestor; NaN while there is none."""
    observed: float
    """Z."""
    matched: float
    """Observations that were matched with something known: a particle's, on the average."""
    new: float
    """Observations that were new: a particle's, on the average."""
    deviation: float
    """Of the log weights that this step added, over the particles (`slam.weights`)."""
    first: float
    """Share of the first components (range, lateral offset) in their variance."""
    second: float
    """Share of the second (bearing, angle), given the first."""
    unmatched: float
    """Share of what was not matched."""
    drawn: float
    """Share of the draw of the pose."""
    inside: float
    """Share of the particles that the likelihood reaches."""
    wide_first: float
    """Deviation of the innovations between particles over that which each expects: first components."""
    wide_second: float
    nis_first: float
    """Squared innovation of the particles together over its expectation: 1 is consistent."""
    nis_second: float
    spread_m: float
    """[m] deviation of the position, of the particles together, root of the mean of x and y."""
    spread_rad: float
    """[rad] of the heading."""
    own_m: float
    """[m] the same of a single particle's own Gaussian, on the average; 0 where poses are drawn."""
    own_rad: float
    position_error_m: float
    heading_error_rad: float
    nees_position: float
    nees_pose: float
    map_error_m: float
    features: float
    duplicates: float
    correct: float
    """Observations that the best particle paired rightly; and wrongly, and not at all although it knows them."""
    wrong: float
    missed: float
    in_turn: float
    """Whether each observation is weighed at the pose that those before it have corrected, and not all at the predicted
    one; 1 or 0."""
    nees_x: float
    """NEES of x, of y and of the heading alone, one degree of freedom each."""
    nees_y: float
    nees_heading: float
    monte_carlo_m: float
    """[m] deviation of the estimate itself by the luck of the particles (`slam.ancestry_variance`), root of the mean of
    x and y; NaN where too few founders are left to tell."""
    monte_carlo_rad: float
    """[rad] of its heading."""


class Observations(NamedTuple):
    """Of the observations of one step."""

    shares: Floats
    """(Z,) of the variance of the log weights."""
    features: Ints
    """(Z,) what the best particle has paired them with: index in its map, or NEW or IGNORED."""
    widths: Floats
    """(Z,) expected deviation over that of the sensor (`slam.weights.innovation_widths`)."""


class Evidence(NamedTuple):
    """One step of one filter."""

    numbers: Numbers
    observations: Observations
    marks: Marks
    """Of mistakes."""

    @property
    def row(self) -> tuple[float, ...]:
        """All single numbers, as `NAMES` calls them."""
        return (*self.numbers, *self.marks)


NAMES = (*Numbers._fields, *Marks._fields)
"""Of all that is one number a step."""


@dataclass(frozen=True)
class Record:
    """The evidence of one filter over a run, or over a part of it."""

    steps: Ints
    """(T,) increasing; of a filter that was switched on and off, not all."""
    numbers: dict[str, Floats]
    """(T,) by `NAMES`."""
    observations: list[Observations]
    """T of them; none in a recording that has no evidence."""
    missing: frozenset[str] = frozenset()
    """The names that whoever made it did not know; they are NaN."""

    def __getitem__(self, name: str) -> Floats:
        return self.numbers[name]

    def part(self, chosen: Ints | Bools | slice) -> Record:
        """Some of its steps."""
        numbers = {name: values[chosen] for name, values in self.numbers.items()}
        indices = np.arange(len(self.steps))[chosen]
        seen = [self.observations[i] for i in indices] if self.observations else []
        return Record(self.steps[chosen], numbers, seen, self.missing)


def joined(records: Sequence[Record]) -> Record:
    """Of one filter, one after the other; what one of them does not know is missing."""
    numbers = {name: np.concatenate([record[name] for record in records]) for name in NAMES}
    complete = all(record.observations for record in records)
    seen = [one for record in records for one in record.observations] if complete else []
    missing = frozenset[str]().union(*(record.missing for record in records))
    return Record(np.concatenate([record.steps for record in records]), numbers, seen, missing)


def record_of(steps: Ints, names: Sequence[str], rows: Floats, observations: list[Observations]) -> Record:
    """From rows (T, n) of numbers that are called so; those that another version had besides are left out."""
    columns = dict(zip(names, rows.T, strict=True))
    nothing = np.full(len(steps), math.nan)
    numbers = {name: columns.get(name, nothing) for name in NAMES}
    return Record(steps, numbers, observations, frozenset(NAMES) - frozenset(names))


def weighed_in_turn(trace: Trace, params: Params) -> bool:
    """`Numbers.in_turn`.  Poses that are drawn before anybody looks have no covariance to correct (FastSLAM 1.0); those
    that are drawn after it have lost theirs by the end of the step (2.0); those that keep it weigh as asked (Dual)."""
    if not uncertain(trace.weighted.P):
        return False
    return params.weighting == "joint" if uncertain(trace.resampled.P) else True


def evidence_of(trace: Trace, measures: Measures, frame: Frame, params: Params) -> Evidence:
    """The numbers of one step."""
    weighted, best, spread = trace.weighted, measures.best, measures.covariance
    mixed = mixtures(trace)
    why, innovations = weight_variance(trace, mixed), innovation_statistics(mixed)
    (n_eff_before, new), (survivors, related) = weights_before(trace), parents(trace.ancestors)
    own = np.exp(weighted.log_w) @ np.diagonal(weighted.P, axis1=1, axis2=2)
    luck = luck_of_pose(weighted, measures.estimate)
    R = noise_of_known(frame, observation_noise(frame, params), params)
    return Evidence(
        Numbers(
            particles=float(len(weighted.log_w)),
            n_eff=trace.n_eff,
            n_eff_before=n_eff_before,
            heaviest=math.exp(weighted.log_w[best]),
            resampled=float(trace.did_resample),
            threshold=params.resample_below,
            survivors=float(survivors),
            related=related,
            diversity=measures.diversity,
            common_ancestor=measures.common_ancestor_age,
            observed=float(trace.n.shape[1]),
            matched=innovations.matched,
            new=new,
            deviation=why.deviation,
            first=why.first,
            second=why.second,
            unmatched=why.unmatched,
            drawn=why.drawn,
            inside=why.inside,
            wide_first=why.wide[0],
            wide_second=why.wide[1],
            nis_first=innovations.first,
            nis_second=innovations.second,
            spread_m=_root(0.5 * (spread[0, 0] + spread[1, 1])),
            spread_rad=_root(spread[2, 2]),
            own_m=_root(0.5 * (own[0] + own[1])),
            own_rad=_root(own[2]),
            position_error_m=measures.position_error_m,
            heading_error_rad=measures.heading_error_rad,
            nees_position=measures.nees_position,
            nees_pose=measures.nees_pose,
            map_error_m=measures.map_error_m,
            features=float(measures.features),
            duplicates=float(measures.duplicates),
            correct=float(measures.correct),
            wrong=float(measures.wrong),
            missed=float(measures.missed),
            in_turn=float(weighed_in_turn(trace, params)),
            nees_x=float(measures.nees_components[0]),
            nees_y=float(measures.nees_components[1]),
            nees_heading=float(measures.nees_components[2]),
            monte_carlo_m=_root(0.5 * (luck[0] + luck[1])),
            monte_carlo_rad=_root(luck[2]),
        ),
        Observations(why.observations, trace.n[best].copy(), innovation_widths(mixed, R.sensor + R.model)),
        marks_of(trace, frame, params),
    )


def _root(variance: float) -> float:
    """The deviation; NaN for a variance that rounding made negative, where a covariance is as good as singular."""
    return math.sqrt(variance) if variance >= 0.0 else math.nan
