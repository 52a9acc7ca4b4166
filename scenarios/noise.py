"""Noise, added to exact frames.

Truth follows the route exactly, and what the filter is told of the controls is noisy: as in the simulator that the
paper ran.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from scenarios.checks import check_angle, check_number
from scenarios.sensors import BLIND
from slam.geometry import wrap_all
from slam.motion import deviation
from slam.types import UNKNOWN_TAG, Frame, Noise, Scan


def add_noise(rng: np.random.Generator, frame: Frame, noise: Noise) -> Frame:
    """The frame as the robot reports it: normal noise on every control tick and every observation.

    Draws one unit normal for each number in `u` (T, m), then in `z` (Z, 2) or, where there is a scan, for each of its
    beams (B,), and a uniform number for each beam: whatever the deviations.  So another noise level scales the same
    draws, a beam that is missing with few is missing with more, and zero gives the frame back, bit by bit.  Bearings
    are wrapped; a range is never below `BLIND`, since no sensor reports a negative one.
    """
    u = frame.u + deviation(frame.motion, frame.u, noise) * rng.standard_normal(frame.u.shape)
    if frame.scan is not None:  # what is seen in it is not yet known
        return frame._replace(u=u, scan=_noisy_scan(rng, frame.scan, noise))
    z = frame.z + np.array([noise.range, noise.bearing]) * rng.standard_normal(frame.z.shape)
    z = np.stack([np.maximum(z[:, 0], BLIND), wrap_all(z[:, 1])], axis=1)
    return frame._replace(u=u, z=z)


def _noisy_scan(rng: np.random.Generator, scan: Scan, noise: Noise) -> Scan:
    """Normal noise on every range; a range that it carries beyond `max_range` is none, and some beams return
    nothing."""
    ranges = np.maximum(scan.ranges + noise.range * rng.standard_normal(scan.ranges.shape), BLIND)
    lost = (ranges > scan.max_range) | (rng.uniform(size=scan.ranges.shape) < noise.missing)
    walls = None if scan.walls is None else np.where(lost, UNKNOWN_TAG, scan.walls)
    return scan._replace(ranges=np.where(lost, np.inf, ranges), walls=walls)


def check_noise(noise: Noise) -> None:
    """Raise `SourceError` unless every deviation is finite and not negative, and `missing` a share."""
    units = {"speed": "m/s", "range": "m", "odometry": "fraction of the motion"}
    for field in dataclasses.fields(noise):
        name, value = f"noise.{field.name}", getattr(noise, field.name)
        if field.name == "missing":
            check_number(name, value, "share of the beams", least=0, most=1)
        elif field.name in units:
            check_number(name, value, units[field.name], least=0)
        else:
            check_angle(name, value, least=0, most=360)
