"""The numbers that tables tell of a run: what each is, and how it is written; the same for one run and for several.

They are made of the series of a filter, arrays (T,) with an entry for each step, named and in units as in `summary`;
and `seconds` (T,) [s] that each step took.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from slam.metrics import nees_interval, rms
from slam.types import Floats

NEES, UPDATE = "nees_mean", "update_median_s"
CLOCKS = (UPDATE, "update_p95_s")
"""What is another number each time."""


class Row(NamedTuple):
    """One number of a filter."""

    key: str
    """As JSON has it."""
    title: str
    series: str
    """What it is made of."""
    measure: Callable[[Floats], float]
    """Of that series; NaN where nothing is known."""
    unit: str = ""
    factor: float = 1.0
    """From the measure, in SI units and radians, to the unit."""
    form: Callable[[float], str] = lambda value: number(value)

    def value(self, series: Mapping[str, Floats]) -> float:
        """In SI units and radians; NaN where the series is missing or nothing is known."""
        values = series.get(self.series, np.zeros(0))
        return self.measure(values) if len(values) else math.nan

    def text(self, value: float) -> str:
        """With the unit; empty if it is not known."""
        return "" if math.isnan(value) else f"{self.form(self.factor * value)} {self.unit}".rstrip()


def number(value: float) -> str:
    """Three digits, or all before the point."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def known(values: Floats) -> Floats:
    """Those that are not NaN."""
    return values[~np.isnan(values)]


def nees_title(known_steps: int) -> str:
    """With the interval in which the mean over so many steps should lie."""
    low, high = nees_interval(2, max(known_steps, 1))
    return f"NEES ({low:.2f} to {high:.2f})"


def nees_text(values: Floats) -> str:
    """The mean, and how many of the values were infinite and are not in it; empty if none is known."""
    values = known(values)
    if not len(values):
        return ""
    infinite = int(np.isinf(values).sum())
    return _large(_mean_of_finite(values)) + (f" ({infinite} inf)" if infinite else "")


def _large(mean: float) -> str:
    return number(mean) if mean < 1e6 else "inf" if math.isinf(mean) else "> 10⁶"


def _mean_of_finite(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if len(finite) else math.inf


def _of_known(measure: Callable[[Floats], float]) -> Callable[[Floats], float]:
    def of(values: Floats) -> float:
        values = known(values)
        return measure(values) if len(values) else math.nan

    return of


def _last(values: Floats) -> float:
    return float(values[-1])


def _median(values: Floats) -> float:
    return float(np.median(values))


def _count(value: float) -> str:
    return f"{value:.0f}"


def _digits(value: float) -> str:
    return f"{value:.3g}"


ROWS = (
    Row("position_error_end_m", "position error, end", "position_error_m", _of_known(_last), "m"),
    Row("position_error_rms_m", "position error, RMS", "position_error_m", _of_known(rms), "m"),
    Row("position_mse", "position MSE", "position_error_m", _of_known(lambda v: float(np.mean(v**2))), "m²"),
    Row("best_position_error_rms_m", "best particle, RMS", "best_position_error_m", _of_known(rms), "m"),
    Row("heading_error_rms_rad", "heading error, RMS", "heading_error_rad", _of_known(rms), "°", math.degrees(1)),
    Row("map_error_end_m", "map error, end", "map_error_m", _of_known(_last), "m"),
    Row(NEES, "NEES", "nees", _of_known(_mean_of_finite), form=_large),
    Row("diversity_end", "diversity, end", "diversity", _last, "%", 100.0, _digits),
    Row("ancestors_end", "ancestors left, end", "ancestors", _last, form=_count),
    Row("n_eff_median", "N_eff, median", "n_eff", _median, form=_digits),
    Row("resamplings", "resamplings", "resampled", lambda v: float(np.sum(v)), form=_count),
    Row("features", "features", "features", _last, form=_count),
    Row("duplicates", "duplicates", "duplicates_so_far", _last, form=_count),
    Row(UPDATE, "update, median", "seconds", _median, "ms", 1e3, _digits),
    Row("update_p95_s", "update, p95", "seconds", lambda v: float(np.percentile(v, 95)), "ms", 1e3, _digits),
)
"""In the order in which they are shown."""
