"""Where a session takes place: the part of the plane to show, and where its observations point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.scans import returns
from app.types import SessionStep
from scenarios.types import Source
from slam.motion import propagate
from slam.types import Floats, Frame

FIELD = 1.04
"""Height of what a view shows, over the distance of the eye: a viewer's field of view is 55 degrees."""

MARGIN = 1.08

UNKNOWN = 0.2
"""Share of the steps in a row of which nobody needs to know the true pose, and yet where a log leads is known."""

MOST_CELLS, FINEST = 20_000, 0.05
"""Of the grid in which the scans of a log are shown, how many; and the size [m] of the smallest."""


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


def around(places: Floats, room: float) -> Extent:
    """What holds places (n, >= 2) [m], with so much of its longer side around it, and 5 m at least."""
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    margin = max(room * float(max(high - low)), 5.0)
    return Extent(low - margin, high + margin)


def is_charted(source: Source, steps: int) -> bool:
    """Whether somebody knows beforehand where it leads: of logs without a true pose, for longer than a short part of
    the steps, dead reckoning alone tells, and goes astray."""
    if source.kind == "world":
        return True
    told = [known(step.truth) for step in source.steps[:steps]]
    gaps = np.diff(np.flatnonzero([True, *told, True])) - 1
    return any(told) and bool(gaps.max() <= UNKNOWN * len(told))


class Survey:
    """The part of the plane where filters have been, for where nobody knows beforehand (`is_charted`)."""

    def __init__(self, extent: Extent, room: float = 0.5) -> None:
        """`extent` is what is shown at first; `room`, a share of what was visited, is left around it to go on."""
        self._shown = extent
        self._room = room
        self._corners = np.zeros((0, 2))

    def outgrown(self, places: Floats) -> Extent | None:
        """What to show from now on, if places (n, >= 2) [m] have left what is shown: with room to go on."""
        places = places[np.isfinite(places[:, :2]).all(axis=1), :2]
        if not len(places):
            return None
        known = np.concatenate([self._corners, places])
        self._corners = np.stack([known.min(axis=0), known.max(axis=0)])
        if self._shown.holds(places):
            return None
        self._shown = around(self._corners, self._room)
        return self._shown

    def found(self) -> Extent | None:
        """What has been visited, with a margin; None if nothing was."""
        return around(self._corners, MARGIN - 1.0) if len(self._corners) else None

    def tightened(self) -> Extent | None:
        """The same, to be shown from now on."""
        found = self.found()
        self._shown = self._shown if found is None else found
        return found


def estimates(step: SessionStep) -> Floats:
    """(n, 3) where the filters are."""
    return np.array([update.measures.estimate for update in step.filters.values()]).reshape(-1, 3)


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


class Scanned:
    """What the scans of a log have met, as the robot sees it, to be placed along any path."""

    def __init__(self, source: Source) -> None:
        self._scans = [frame.scan for frame, _ in source.steps]
        self._met: list[Floats] = []

    def along(self, poses: Floats) -> tuple[Floats, float]:
        """(n, 2) [m] where the scans ended of which the first T were taken at poses (T, 3): the middles of all cells of
        a grid in which one did; and the size of a cell [m], the smallest that leaves no more than `MOST_CELLS`."""
        for scan in self._scans[len(self._met) : len(poses)]:
            self._met.append(np.zeros((0, 2)) if scan is None else returns(scan, np.zeros(3)))
        met = self._met[: len(poses)]
        local = np.concatenate([np.zeros((0, 2)), *met])
        c, s = np.cos(poses[: len(met), 2]), np.sin(poses[: len(met), 2])
        frames = np.column_stack([poses[: len(met), :2], c, s])
        x, y, c, s = np.repeat(frames, [len(ends) for ends in met], axis=0).T
        placed = np.stack([x + c * local[:, 0] - s * local[:, 1], y + s * local[:, 0] + c * local[:, 1]], axis=1)
        return _cells(placed[np.isfinite(placed).all(axis=1)])


def _cells(xy: Floats) -> tuple[Floats, float]:
    """Middles (n, 2) and size [m] of the cells of a grid that hold one of the points (N, 2)."""
    cell, most = FINEST, 1 << 30
    at = np.clip(np.floor(xy / cell), -most, most).astype(np.int64)
    while True:
        codes = np.unique((at[:, 0] << 32) + at[:, 1])
        column = ((codes + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
        at = np.stack([(codes - column) >> 32, column], axis=1)
        if len(at) <= MOST_CELLS:
            return cell * (at.astype(float) + 0.5), cell
        at, cell = at >> 1, 2.0 * cell


def known(pose: Floats | None) -> bool:
    """Whether a true pose is given, its position at least."""
    return pose is not None and bool(np.isfinite(pose[:2]).all())
