"""Colours that viser's client shows as they are meant.

It tone-maps what it draws (three.js' ACES curve, for which no setting is known to viser), and takes colours of single
vertices and instances for linear light, but those of whole lines for sRGB.  Undone here, orange stays orange; only what
is brighter than the curve can reach is a little darker.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.types import Floats

Bytes = NDArray[np.uint8]

_IN = np.linalg.inv([[0.59719, 0.35458, 0.04823], [0.076, 0.90834, 0.01566], [0.0284, 0.13383, 0.83777]])
_OUT = np.linalg.inv([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
_EXPOSURE = 0.6
"""What three.js divides the light by before the curve."""


def whole(rgb: tuple[int, int, int]) -> Bytes:
    """(3,) for a line of one colour."""
    return _bytes(_encoded(_untoned(np.array([rgb]))))[0]


def each(rgb: Floats | Bytes) -> Bytes:
    """(n, 3) 0 .. 255, for vertices and instances that have a colour each."""
    return _bytes(_untoned(np.asarray(rgb)))


def _untoned(rgb: NDArray[np.generic]) -> Floats:
    """(n, 3) linear light that is shown as rgb (n, 3)."""
    level = np.asarray(rgb, float) / 255.0
    light = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    curve = np.clip(light @ _OUT.T, 0.0, 0.99)
    # curve = (v (v + p) - q) / (v (r v + s) + t), solved for v
    a = 1.0 - 0.983729 * curve
    b = 0.0245786 - 0.4329510 * curve
    c = -0.000090537 - 0.238081 * curve
    v = (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    return np.clip(_EXPOSURE * v @ _IN.T, 0.0, 1.0)


def _encoded(light: Floats) -> Floats:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)


def _bytes(level: Floats) -> Bytes:
    return np.rint(255.0 * level).astype(np.uint8)
