"""Streams of one log merged by time: control ticks up to each observation, truth at the time of each observation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.logs.text import Table
from scenarios.types import SourceError
from scenarios.words import counted, times
from slam.types import Floats

HOLD = 0.5
"""[s] for which an observation may lie before the first or after the last control sample and is still used."""

LONG_GAP = 2.0
"""[s] without a control sample that deserve a warning; the last one is held meanwhile."""


def ticks(times: Floats, controls: Floats, start: float, observed: Floats) -> list[tuple[Floats, Floats]]:
    """For each observation the controls (T, m) and durations (T,) [s] since the observation before.

    times: (N,) [s] of the control samples, in order; each holds until the next one, of equal times the last one holds.
    start: [s] where the first observation's ticks begin.  observed: (F,) [s], strictly increasing, none before start.
    A tick that spans an observation is split there, so that the durations add up exactly.  Before the first sample
    the vehicle is taken to stand still: no tick.
    """
    edges = np.unique(np.concatenate([times[(times > start) & (times < observed[-1])], [start], observed]))
    begin, duration = edges[:-1], np.diff(edges)
    sample = np.searchsorted(times, begin, side="right") - 1
    known = sample >= 0
    begin, duration, sample = begin[known], duration[known], sample[known]
    bounds = np.searchsorted(begin, observed)
    u = controls[sample]
    return [(u[a:b], duration[a:b]) for a, b in zip([0, *bounds[:-1]], bounds, strict=True)]


def with_controls(controls: Table, stamps: Floats, start: float) -> tuple[NDArray[np.bool_], list[str]]:
    """Which observations (F,) at `stamps` have controls, and warnings about those that have none and about gaps."""
    t = controls.values[:, 0]
    early, late = stamps < start, stamps > t[-1] + HOLD
    warnings = []
    if early.any():
        begin = f"{controls.place(0)}: the controls begin at {t[0]:.3f} s"
        warnings.append(
            f"{begin}, so observations at {counted(int(early.sum()), 'time')} before {start:.3f} s are left out"
        )
    if late.any():
        end = f"{controls.place(-1)}: the controls end at {t[-1]:.3f} s"
        warnings.append(
            f"{end}, so observations at {counted(int(late.sum()), 'time')} after {t[-1] + HOLD:.3f} s are left out"
        )
    gaps = np.diff(t)
    if (gaps > LONG_GAP).any():
        row = int(np.argmax(gaps))
        warnings.append(
            f"{controls.place(row)}: {times(int((gaps > LONG_GAP).sum()))} the controls pause for more than "
            f"{LONG_GAP:g} s, here for {gaps[row]:.1f} s; the last control is held meanwhile"
        )
    good = ~early & ~late
    if not good.any():
        raise SourceError(
            f"{controls.path}: controls from {t[0]:.3f} s to {t[-1]:.3f} s, and no observation in that time; "
            f"expected files of the same run"
        )
    return good, warnings


def interpolate(times: Floats, values: Floats, at: Floats, usable: NDArray[np.bool_]) -> list[Floats | None]:
    """Values (c,) at each time `at` (F,), linearly between the samples (N,), (N, c); None where they are not known.

    usable: (N - 1,) for each interval between two samples, whether to interpolate there.
    """
    left = np.clip(np.searchsorted(times, at, side="right") - 1, 0, max(len(times) - 2, 0))
    inside = (at >= times[0]) & (at <= times[-1])
    if len(times) < 2:
        return [values[0].copy() if ok else None for ok in inside]
    span = times[left + 1] - times[left]
    part = (at - times[left]) / np.where(span > 0, span, 1.0)
    mixed = values[left] + part[:, None] * (values[left + 1] - values[left])
    known = inside & (usable[left] | (part == 0))
    return [row if ok else None for row, ok in zip(mixed, known, strict=True)]
