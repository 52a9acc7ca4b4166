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
from slam.types import Frame, Noise


def add_noise(rng: np.random.Generator, frame: Frame, noise: Noise) -> Frame:
    """The frame as the robot reports it: normal noise on every control tick and every observation.

    Draws one unit normal for each number in `u` (T, m), then in `z` (Z, 2), whatever the deviations: another
    noise level scales the same draws, and zero gives the frame back, bit by bit.  Bearings are wrapped; a range is
    never below `BLIND`, since no sensor reports a negative one.
    """
    u = frame.u + deviation(frame.motion, frame.u, noise) * rng.standard_normal(frame.u.shape)
    z = frame.z + np.array([noise.range, noise.bearing]) * rng.standard_normal(frame.z.shape)
    z = np.stack([np.maximum(z[:, 0], BLIND), wrap_all(z[:, 1])], axis=1)
    return frame._replace(u=u, z=z)


def check_noise(noise: Noise) -> None:
    """Raise `SourceError` unless every deviation is finite and not negative."""
    units = {"speed": "m/s", "range": "m", "odometry": "fraction of the motion"}
    for field in dataclasses.fields(noise):
        name, value = f"noise.{field.name}", getattr(noise, field.name)
        if field.name in units:
            check_number(name, value, units[field.name], least=0)
        else:
            check_angle(name, value, least=0, most=360)
