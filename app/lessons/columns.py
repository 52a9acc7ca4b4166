"""The numbers that several lessons show."""

from __future__ import annotations

import numpy as np

from app.lessons.lesson import Column, count, metres, percent
from app.lessons.watching import Ran
from slam.metrics import rms
from slam.types import Floats


def diversity(step: int) -> Column:
    """Share of the particles with a founder of their own after a step; -1 is the last."""
    when = f"after {step} steps" if step > 0 else "at the end"
    return Column(
        f"diversity {step}", f"diversity {when}", lambda ran, key: ran.at(ran.series(key, "diversity"), step), percent
    )


def _n_eff_share(ran: Ran, key: str) -> float:
    """The median of N_eff by K."""
    filters = ran.summary.filters[key]
    return _median(filters.array("n_eff") / max(filters.particles, 1))


def _median(values: Floats) -> float:
    """Of those that are known; infinite ones count."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if len(known) else np.nan


def _rms(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return rms(known) if len(known) else np.nan


N_EFF = Column("n_eff", "N_eff / K", _n_eff_share, percent)
"""Median over the steps."""

NEES = Column("nees", "NEES", lambda ran, key: _median(ran.series(key, "nees")), count)
"""Of the position, median over the steps."""

ERROR = Column("error", "error", lambda ran, key: _rms(ran.series(key, "position_error_m")), metres)
"""Of the position, RMS over the steps."""

ERROR_END = Column(
    "error end", "error at the end", lambda ran, key: ran.at(ran.series(key, "position_error_m"), -1), metres
)

RESAMPLINGS = Column("resamplings", "resamplings", lambda ran, key: float(ran.series(key, "resampled").sum()), count)

DUPLICATES = Column(
    "duplicates", "mapped twice", lambda ran, key: ran.at(ran.series(key, "duplicates_so_far"), -1), count
)

POSE = Column("pose", "pose, in one particle", lambda ran, key: ran.at(np.array(ran.beliefs.pose_m[key]), -1), metres)
"""What one particle leaves open of the position at the end."""

MAP = Column("map", "landmark, in one map", lambda ran, key: ran.at(np.array(ran.beliefs.map_m[key]), -1), metres)
"""What the map of one particle leaves open of a feature's place at the end."""


def deviation(axis: int, step: int, title: str) -> Column:
    """What a filter believes of its error in x or y after a step; -1 is the last."""
    name = "xy"[axis]
    return Column(
        f"{name} {step}",
        title,
        lambda ran, key: ran.at(np.array(ran.beliefs.deviation[key]).reshape(-1, 3)[:, axis], step),
        metres,
    )


ODOMETRY = Column(
    "odometry", "of dead reckoning", lambda ran, key: ran.at(np.array(ran.beliefs.odometry_m), -1), metres
)
"""Error at the end, the same for all filters."""
