"""Shades of a filter's colour, by weight and by age, the same in every view that has a dark ground."""

from __future__ import annotations

import math

import numpy as np

from app import colours
from app.colours import RGB
from slam.types import Floats


def faded(rgb: RGB, share: Floats) -> Floats:
    """(n, 3) colours, of which `share` (n,) is replaced by the background."""
    return np.array(rgb) + share[:, None] * (np.array(colours.BACKGROUND) - np.array(rgb))


def brightness(log_w: Floats, particles: int) -> Floats:
    """(n,) in -1..1 of log weights (n,) among so many particles: 0 for the average 1/K, 1 for a hundred times as
    much."""
    with np.errstate(under="ignore"):
        return np.clip((log_w + math.log(particles)) / math.log(100.0), -1.0, 1.0)


def by_brightness(rgb: RGB, brightness: Floats) -> Floats:
    """(n, 3) colours for brightness (n,) in -1..1: faint, the hue itself at 0, white."""
    b = brightness[:, None]
    white = np.array(colours.mix(rgb, (255, 255, 255), 0.85))
    return np.where(b < 0, faded(rgb, -0.7 * brightness), np.array(rgb) + b * (white - np.array(rgb)))
