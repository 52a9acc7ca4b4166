"""Parts of a log by frame number: from one frame to another, and every so many."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scenarios.logs.odometry import carried
from scenarios.types import Source, SourceError, Step
from slam.geometry import compose, wrap
from slam.motion import propagate
from slam.types import Floats

ALIGN_OVER = 30.0
"""[s] on either side of a part's beginning within which its start pose is fitted, where the truth has no heading."""


def part(source: Source, first: int | None = None, last: int | None = None, every: int = 1) -> Source:
    """The frames `first` to `last` (from 0, both included) of a source, and of these every `every`-th.

    The controls of frames that are left out go to the next frame that is kept.  The start pose is the truth of the
    frame before; where that is not known in full, dead reckoning fitted to the truth within `ALIGN_OVER`, for laser
    logs from the nearest true pose; and where there is none either, dead reckoning from the start of the log, which for
    laser logs is as good and for others deserves a warning, as does an end beyond that of the source.  The title names
    the part.  Raises `SourceError` if no frame is left.
    """
    if first is None and last is None and every == 1:
        return source
    count = len(source.steps)
    begin, end = first or 0, count - 1 if last is None else last
    if every < 1:
        raise SourceError(f"every {every}: expected 1 or more frames")
    if not 0 <= begin < count:
        raise SourceError(f"first frame {begin}: expected 0 to {count - 1}, the frames of {source.name}")
    if end < begin:
        raise SourceError(f"last frame {end}: expected {begin}, the first frame, or more")
    what = "frame" if source.scans is None else "scan"
    beyond = f"{source.name}: its last {what} is {count - 1}, and so that of the part, which was to go on to {end}"
    warnings = (beyond,) if end >= count else ()
    end = min(end, count - 1)
    kept = []
    for i in range(begin, end + 1, every):
        frames = [step.frame for step in source.steps[max(i - every + 1, begin) : i + 1]]
        u, dt = np.concatenate([f.u for f in frames]), np.concatenate([f.dt for f in frames])
        kept.append(Step(source.steps[i].frame._replace(u=u, dt=dt), source.steps[i].truth))
    start, told = (source.start, ()) if begin == 0 else _start(source, begin)
    scans = source.scans and source.scans._replace(kept=source.scans.kept[begin : end + 1 : every])
    options = {"first": begin, "last": end, "every": every}
    return replace(
        source,
        title=f"{source.title}; {what}s {begin} to {end} of it{'' if every == 1 else f', every {_ordinal(every)}'}",
        steps=tuple(kept),
        start=start,
        warnings=(*source.warnings, *warnings, *told),
        scans=scans,
        options={**source.options, **options},
    )


def _ordinal(number: int) -> str:
    """2nd, 3rd, 4th ..."""
    teen = number % 100 in (11, 12, 13)
    return f"{number}{'th' if teen else {1: 'st', 2: 'nd', 3: 'rd'}.get(number % 10, 'th')}"


def dead_reckoning(source: Source) -> Floats:
    """(F, 3) the pose at each frame by the controls alone, from the start of the source."""
    path = np.empty((len(source.steps), 3))
    pose = tuple(map(float, source.start))
    for i, (frame, _) in enumerate(source.steps):
        for u, dt in zip(frame.u.tolist(), frame.dt.tolist(), strict=True):
            pose = propagate(frame.motion, pose, u, dt)[0]
        path[i] = pose
    return path


def _start(source: Source, begin: int) -> tuple[Floats, tuple[str, ...]]:
    """Pose at frame `begin - 1` and warnings."""
    truth = source.steps[begin - 1].truth
    if truth is not None and np.isfinite(truth).all():
        return truth, ()
    if source.scans is not None:
        return _by_odometry(source, begin - 1), ()
    path = dead_reckoning(source)
    now = source.steps[begin - 1].frame.time
    near = [
        i for i, step in enumerate(source.steps) if step.truth is not None and abs(step.frame.time - now) <= ALIGN_OVER
    ]
    if len(near) > 1:
        here = path[near, :2]
        there = np.array([truth[:2] for i in near if (truth := source.steps[i].truth) is not None])
        a, b = here - here.mean(axis=0), there - there.mean(axis=0)
        if np.hypot(*np.ptp(there, axis=0)) > 1.0:  # metres; a standing vehicle shows no heading
            turn = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
            c, s = math.cos(turn), math.sin(turn)
            shift = there.mean(axis=0) - np.array([[c, -s], [s, c]]) @ here.mean(axis=0)
            return compose(np.array([*shift, wrap(turn)]), path[begin - 1]), ()
    return path[begin - 1], (
        f"{source.name}: no truth around frame {begin}, so the part starts where dead reckoning from frame 0 ends",
    )


def _by_odometry(source: Source, frame: int) -> Floats:
    """(3,) the pose of a laser log at a frame, by odometry from the nearest true one; if there is none, as it says."""
    assert source.scans is not None
    odometry = source.scans.odometry[source.scans.kept]
    known = np.array([i for i, step in enumerate(source.steps) if step.truth is not None], np.int64)
    if not len(known):
        return odometry[frame].copy()
    nearest = known[np.argmin(np.abs(known - frame))]
    truth = source.steps[nearest].truth
    assert truth is not None
    return carried(truth, odometry[nearest], odometry[frame])
