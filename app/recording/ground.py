"""Where a session takes place: the part of the plane to show, and where its observations point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.types import SessionStep
from scenarios.types import Source
from slam.motion import propagate
from slam.types import Floats, Frame

FIELD = 1.04
"""Height of what a view shows, over the distance of the eye: a viewer's field of view is 55 degrees."""

MARGIN = 1.08


class Extent(NamedTuple):
    """The part of the plane that a map view shows, from corner to corner (2,) [m]."""

    low: Floats
    high: Floats

    def holds(self, xy: Floats) -> bool:
        """Whether all points (n, 2) lie in it."""
        return bool((xy >= self.low).all() and (xy <= self.high).all())

    @property
    def size(self) -> float:
        """[m] the longer side."""
        return float(max(self.high - self.low))

    @property
    def centre(self) -> Floats:
        """(2,) [m]"""
        return 0.5 * (self.low + self.high)

    def eye_height(self, aspect: float) -> float:
        """[m] from where a view, `aspect` times as wide as high, sees all of it."""
        width, height = self.high - self.low
        return float(MARGIN * max(height, width / aspect, 1.0) / FIELD)


class Survey:
    """The part of the plane where a filter has been, for where nobody knows beforehand: dead reckoning goes astray."""

    def __init__(self, extent: Extent) -> None:
        self._shown = extent
        self._low, self._high = np.full(2, np.inf), np.full(2, -np.inf)

    def outgrown(self, step: SessionStep) -> Extent | None:
        """What to show from now on, if an estimate has left what is shown: with room to go on."""
        places = np.array([update.measures.estimate[:2] for update in step.filters.values()]).reshape(-1, 2)
        places = places[np.isfinite(places).all(axis=1)]
        if not len(places):
            return None
        self._low = np.minimum(self._low, places.min(axis=0))
        self._high = np.maximum(self._high, places.max(axis=0))
        if self._shown.holds(places):
            return None
        self._shown = self._with_room(0.5)
        return self._shown

    def found(self) -> Extent | None:
        """What has been visited, with a margin; None if nothing was."""
        return self._with_room(0.08) if np.isfinite(self._low).all() else None

    def _with_room(self, share: float) -> Extent:
        room = max(share * float(max(self._high - self._low)), 5.0)
        return Extent(self._low - room, self._high + room)


def extent_of(source: Source, steps: int) -> Extent:
    """What holds the route and the landmarks or walls; dead reckoning where nobody knows the truth."""
    known = [s.truth[:2] for s in source.steps[:steps] if s.truth is not None]
    places = [source.start[None, :2], np.array(known) if known else _dead_reckoning(source, steps)]
    if source.true_map is not None and len(source.true_map.theta):
        places.append(source.true_map.theta.reshape(-1, 2))  # the two ends of walls
    xy = np.concatenate(places)
    xy = xy[np.isfinite(xy).all(axis=1)]
    low, high = xy.min(axis=0), xy.max(axis=0)
    # where the truth is known in parts only, the rest of the way leads somewhere too
    share = 0.02 if len(known) in (0, min(steps, len(source.steps))) else 0.15
    margin = max(share * float(max(high - low)), 0.5)
    return Extent(low - margin, high + margin)


def _dead_reckoning(source: Source, steps: int) -> Floats:
    s, path = source.start, [source.start]
    for frame, _ in source.steps[:steps]:
        for u, dt in zip(frame.u, frame.dt, strict=True):
            s = np.array(propagate(frame.motion, s, u, dt)[0])
        path.append(s)
    return np.array(path)[:, :2]


def observer(step: SessionStep) -> Floats:
    """(3,) the pose from which observations are drawn: the true one, or the first filter's estimate."""
    if step.truth is not None and np.isfinite(step.truth).all():
        return step.truth
    return next((u.measures.estimate for u in step.filters.values()), step.odometry)


def seen(frame: Frame, s: Floats) -> Floats:
    """(Z, 2) [m] where the observations of a frame lie, seen from the pose s (3,)."""
    ends = [type(frame.feature).inverse(frame.feature, s, z)[0][:2] for z in frame.z]
    return np.array(ends, float).reshape(-1, 2)


def squares(points: Floats, side: float) -> Floats:
    """(n, 2) [m] the middles of the squares, with sides of so many metres, in which some of the points (N, 2) lie."""
    return (np.unique(np.floor(points / side), axis=0) + 0.5) * side


def known(pose: Floats | None) -> bool:
    """Whether a true pose is given, its position at least."""
    return pose is not None and bool(np.isfinite(pose[:2]).all())
