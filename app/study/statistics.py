"""Means with their standard errors, and how they are written."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slam.types import Floats


class Mean(NamedTuple):
    """The mean of independent runs."""

    value: float
    error: float
    """Standard error of the mean; NaN for a single run."""

    def __str__(self) -> str:
        if math.isnan(self.error):
            return f"{self.value:.3g}"
        # Two digits of the error, and as many decimals for the mean.
        decimals = 2 if self.error == 0 else min(max(1 - math.floor(math.log10(self.error)), 0), 6)
        return self.rounded(decimals)

    def rounded(self, decimals: int) -> str:
        """`.031±.002`."""
        value = _short(f"{self.value:.{decimals}f}")
        return value if math.isnan(self.error) else f"{value}±{_short(f'{self.error:.{decimals}f}')}"


def _short(number: str) -> str:
    """Without the zero before the point."""
    sign = "-" if number.startswith("-") else ""
    digits = number.removeprefix("-")
    return sign + (digits[1:] if digits.startswith("0.") else digits)


def mean(values: Sequence[float] | Floats) -> Mean:
    """Mean and standard error of values of independent runs."""
    array = np.asarray(values, float)
    error = float(np.std(array, ddof=1) / math.sqrt(len(array))) if len(array) > 1 else math.nan
    return Mean(float(np.mean(array)), error)


def spread(values: Sequence[float], form: str = ".3g") -> str:
    """`median (smallest-largest)`; only the median where all are equal."""
    low, middle, high = (f"{value:{form}}" for value in (min(values), float(np.median(values)), max(values)))
    return middle if low == high else f"{middle} ({low}-{high})"
