"""Both ways side by side: once with the run's own random numbers, and over others, where luck and effect part."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from app.compare.numbers import Comparison, compare
from app.compare.runs import Numbers, Run, Seen
from app.recording import texts
from app.rows import CLOCKS, NEES, ROWS, Row
from app.whatif.fork import Made, Plan, Tally
from app.whatif.settings import shown
from slam.features import Wall
from slam.types import Floats, Ints

UNCHANGED, CHANGED = "unchanged", "changed"

SURE = 0.05
"""Two-sided: how often luck alone may do as much before it is not told as an effect."""


class Tallies:
    """What all ways did."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._ways: dict[tuple[bool, int], Tally] = {}

    def add(self, made: Made) -> None:
        """One step; those before the fork are not counted."""
        if made.step.index >= self.plan.first:
            self._ways.setdefault((made.changed, made.draw), Tally()).add(made.step)

    @property
    def done(self) -> int:
        """Steps that both ways have, with the run's own random numbers."""
        return min(len(self._ways[way, 0].steps) if (way, 0) in self._ways else 0 for way in (False, True))

    def way(self, changed: bool) -> Tally:
        """One of them, with the run's own random numbers."""
        return self._ways[changed, 0]

    def others(self) -> list[tuple[Tally, Tally]]:
        """Unchanged and changed with each of the other random numbers with which both came to the end."""
        length = self.plan.last - self.plan.first + 1
        pairs = [
            (self._ways[False, draw], self._ways[True, draw])
            for draw in range(1, self.plan.seeds + 1)
            if (True, draw) in self._ways
        ]
        return [pair for pair in pairs if all(len(tally.steps) == length for tally in pair)]


def title(plan: Plan) -> str:
    """Of the changed way, such as `particles=500 believed.range=0.01`."""
    return " ".join(f"{name}={shown(name, value)}" for name, value in plan.values.items())


def side_by_side(tallies: Tallies) -> Comparison:
    """As `dualslam compare` has it, over the steps from the fork on that both ways have."""
    return compare([_run(tallies, changed) for changed in (False, True)])


def _run(tallies: Tallies, changed: bool) -> Run:
    plan, tally, done = tallies.plan, tallies.way(changed), tallies.done
    info = plan.changed_info if changed else plan.origin.info._replace(params=plan.settings(plan.first, False).params)
    steps: Ints = np.array(tally.steps[:done], np.int64)
    return Run(
        name=CHANGED if changed else UNCHANGED,
        path=plan.origin.path,
        branch=plan.origin.branch,
        told=texts.description(info, 0.0),
        filters={key: Numbers(steps, series) for key, series in tally.series(done).items()},
        changes=[],
        times=dict(zip(tally.steps, tally.times, strict=True)),
        seen=Seen({}, {}, {}),
        drawn={},
        true_walls=[],
        true_landmarks=[],
        branches=[],
        damaged=plan.origin.damaged,
        walls=isinstance(info.source.feature, Wall),
    )


class Spread(NamedTuple):
    """A number of a filter over all other random numbers, unchanged and changed."""

    row: Row
    unchanged: Floats
    """(N,) in SI units and radians; infinite where it is."""
    changed: Floats
    """(N,) with the same random numbers."""

    @property
    def lower(self) -> int:
        """How often the changed one is the smaller."""
        return int(np.sum(self.changed < self.unchanged))

    @property
    def higher(self) -> int:
        """How often it is the larger."""
        return int(np.sum(self.changed > self.unchanged))

    @property
    def certain(self) -> bool:
        """Whether there is no luck in it: with all random numbers it is the same, as where nothing is drawn."""
        return bool(np.all(self.unchanged == self.unchanged[0]) and np.all(self.changed == self.changed[0]))

    @property
    def luck(self) -> float:
        """How probable it is that one of the two is the larger as often as this, or more often, were there no effect:
        the sign test, two-sided.  NaN where there is no luck in it."""
        if self.certain:
            return math.nan
        n, most = self.lower + self.higher, max(self.lower, self.higher)
        tail = sum(math.comb(n, k) for k in range(most, n + 1)) / 2.0**n
        return min(1.0, 2.0 * tail)


def spreads_of(tallies: Tallies) -> dict[str, list[Spread]]:
    """By filter, every number that is known."""
    found: dict[str, list[Spread]] = {}
    pairs = [(a.series(), b.series()) for a, b in tallies.others()]
    for key in pairs[0][0] if pairs else ():
        for row in ROWS:
            values = np.array([[_value(row, way[key]) for way in pair] for pair in pairs])
            if row.key not in CLOCKS and not np.isnan(values).any():
                found.setdefault(key, []).append(Spread(row, values[:, 0], values[:, 1]))
    return found


def _value(row: Row, series: dict[str, Floats]) -> float:
    """A NEES that is infinite anywhere is infinite as a whole: the mean of the others would hide that."""
    return math.inf if row.key == NEES and np.isinf(series["nees"]).any() else row.value(series)


def quantiles(values: Floats) -> dict[str, Any]:
    """The median and the range."""
    return {"median": float(np.median(values)), "least": float(values.min()), "most": float(values.max())}
