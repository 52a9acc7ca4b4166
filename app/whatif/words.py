"""What the other parameters changed, in sentences."""

from __future__ import annotations

import math

import numpy as np

from app.compare.numbers import Column, Comparison, Filter
from app.recording.metrics import LONERS
from app.rows import ROWS, Row, number
from app.whatif.fork import Plan
from app.whatif.numbers import SURE, Spread
from app.whatif.settings import shown, values_of
from slam.estimators import ESTIMATORS
from slam.types import Floats

OF_MANY = ("ancestors_end", "diversity_end", "n_eff_median", "resamplings")
"""Rows that say nothing of a filter with one particle."""

SAID = {
    "position_error_rms_m": "position error (RMS)",
    "map_error_end_m": "map error",
    "nees_mean": "NEES",
    "ancestors_end": "distinct ancestors left",
    "features": "features",
    "duplicates": "duplicates",
}
"""The rows of which sentences tell, and by which name."""

SPREAD = ("position_error_rms_m", "map_error_end_m", "ancestors_end", "duplicates")
"""Those of which they tell over other random numbers."""

UNTOLD = "one run each may be luck: --seeds 20 runs both again with other random numbers after that step, and tells"

FEWEST = 6
"""Of other random numbers, with which an effect can be told from luck at all: with five, luck alone has all on one side
in one of 16 cases."""


def question(plan: Plan) -> str:
    """What is asked."""
    was = values_of(plan.settings(plan.first, changed=False))
    changes = [
        f"{name} {shown(name, value)} instead of {shown(name, was[name])}" for name, value in plan.values.items()
    ]
    return f"from step {plan.first} on: {', '.join(changes)}"


def sentences(found: Comparison, first: int) -> list[str]:
    """One for each filter, over the steps from `first` on that both ways have."""
    return [f"{one.title}: {_of_filter(one, first)}" for one in found.filters]


def _of_filter(one: Filter, first: int) -> str:
    before, after = one.columns
    if after.parts_at is None:
        return "every number is that of the unchanged run, so this changes nothing for it here"
    parts = []
    for row in _rows(one.key, tuple(SAID)):
        text = _instead(one.text(row, after), one.text(row, before))
        if row.key == "ancestors_end":
            text += _of_how_many(before, after)
        parts += [f"{SAID[row.key]} {text}"] if text else []
        if row.key == "ancestors_end":
            shares = (float(np.median(column.series["n_eff_share"])) for column in (before, after))
            parts.append("N_eff {1:.0%} of K instead of {0:.0%} (median)".format(*shares))
    if after.parts_at > first:
        parts.append(f"up to step {after.parts_at - 1} it made no difference")
    return "; ".join(parts)


def _of_how_many(before: Column, after: Column) -> str:
    """Where the two have not the same number of particles; no share, which more of them make smaller by itself."""
    counts = [column.series["ancestors"][0] / column.series["ancestors_share"][0] for column in (before, after)]
    return "" if counts[0] == counts[1] else f" (of {counts[1]:.0f} instead of {counts[0]:.0f})"


def _rows(key: str, names: tuple[str, ...]) -> list[Row]:
    return [row for row in ROWS if row.key in names and not (key in LONERS and row.key in OF_MANY)]


def _instead(after: str, before: str) -> str:
    """Empty where one of the two is not known."""
    if not (after and before):
        return ""
    return f"{after} as before" if after == before else f"{after} instead of {before}"


def on_luck(found: dict[str, list[Spread]], one: Comparison, count: int) -> list[str]:
    """What the other random numbers tell: whether it is the parameters or luck."""
    said = []
    for key, spreads in found.items():
        chosen = {row.key for row in _rows(key, SPREAD)}
        parts = [part for spread in spreads if spread.row.key in chosen and (part := _of_spread(spread, count))]
        column = next(filter_.columns[0] for filter_ in one.filters if filter_.key == key)
        fate = [_fate(spread, column.values[spread.row.key], count) for spread in spreads]
        parts += [text for text in fate if text]
        said.append(f"{ESTIMATORS[key].title}: {'; '.join(parts) or 'nothing differs'}")
    return said


def _of_spread(spread: Spread, count: int) -> str:
    if np.array_equal(spread.changed, spread.unchanged):
        return ""
    row = spread.row
    if spread.certain:
        texts = [row.text(float(values[0])) for values in (spread.changed, spread.unchanged)]
        return f"{SAID[row.key]} {_instead(*texts)} with all of them: no luck is in it"
    text = f"{SAID[row.key]} {span(row, spread.changed)} instead of {span(row, spread.unchanged)}"
    less, more = spread.lower, spread.higher
    side = f"lower in {less}" if less >= more else f"higher in {more}"
    return f"{text}, {side} of {count}: {_verdict(spread, count)}"


def _verdict(spread: Spread, count: int) -> str:
    if count < FEWEST:
        return "too few to tell from luck"
    if spread.luck < SURE:
        return f"more than luck (sign test, p = {number(spread.luck)})"
    return f"luck alone may do that (sign test, p = {number(spread.luck)})"


def _fate(spread: Spread, own: float, count: int) -> str:
    """Where the run itself lies among those that could have been."""
    if spread.row.key != "position_error_rms_m" or math.isnan(own) or np.all(spread.unchanged == own):
        return ""
    better = int(np.sum(spread.unchanged < own))
    return f"unchanged, {better} of {count} do better than the run itself ({spread.row.text(own)})"


def span(row: Row, values: Floats) -> str:
    """The median and the range, in the unit of the row."""
    low, middle, high = (row.text(float(value)) for value in (values.min(), np.median(values), values.max()))
    return f"{middle} ({low} to {high})"
