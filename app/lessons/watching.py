"""What lessons tell of a run beyond its summary: what the filters believe, and where it is kept."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from app.summary import Summary
from app.types import SessionInfo, SessionStep
from slam.types import Floats


class Beliefs:
    """An observer that keeps, of every step and filter, what it believes of pose and map."""

    def __init__(self) -> None:
        self.deviation: dict[str, list[Floats]] = {}
        """By filter, (3,) each [m, m, rad]: of the mixture, within and between particles."""
        self.pose_m: dict[str, list[float]] = {}
        """Of the position, within one particle after the step, the root of the mean variance over particles."""
        self.map_m: dict[str, list[float]] = {}
        """Of a feature's place, within the map of one particle, in the root mean square; NaN without features."""
        self.odometry_m: list[float] = []
        """Error of dead reckoning; NaN without truth."""

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        keys = [f.key for f in info.filters]
        self.deviation = {key: [] for key in keys}
        self.pose_m = {key: [] for key in keys}
        self.map_m = {key: [] for key in keys}

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        truth = np.full(3, np.nan) if step.truth is None else step.truth
        self.odometry_m.append(math.dist(step.odometry[:2], truth[:2]))
        for key, update in step.filters.items():
            after = update.trace.resampled
            within = np.trace(after.P[:, :2, :2], axis1=1, axis2=2)
            self.deviation[key].append(np.sqrt(np.diag(update.measures.covariance)))
            self.pose_m[key].append(math.sqrt(float(np.mean(within))))
            _, Sigma, _ = after.maps.features(0)
            of_map = math.sqrt(float(np.mean(np.trace(Sigma, axis1=1, axis2=2)))) if len(Sigma) else math.nan
            self.map_m[key].append(of_map)

    def end(self) -> None:
        """Nothing to do."""


class Ran(NamedTuple):
    """One run of a lesson."""

    summary: Summary
    beliefs: Beliefs

    def series(self, key: str, name: str) -> Floats:
        """(T,) one of the series of the summary, of the filter `key`."""
        return self.summary.filters[key].array(name)

    def at(self, values: Floats, step: int) -> float:
        """A series (T,) after that many steps, -1 for the last one; NaN where the run was ended before."""
        index = step - 1 if step > 0 else self.summary.info.steps - 1
        return float(values[index]) if index < len(values) else math.nan
