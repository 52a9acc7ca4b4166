"""What moves in a world and hides its walls: people, as discs that walk to and fro on straight lines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scenarios.checks import LARGEST, check_number
from scenarios.types import SourceError
from slam.types import Floats

MAX_MOVERS = 1000


class Movers(NamedTuple):
    """m discs, each on a path of its own; at the end of it they turn round at once."""

    paths: Floats
    """(m, 4) x0 y0 x1 y1 [m]"""
    speeds: Floats
    """(m,) [m/s]"""
    offsets: Floats
    """(m,) [m] walked at time zero."""
    radii: Floats
    """(m,) [m]"""


NOBODY = Movers(np.empty((0, 4)), np.empty(0), np.empty(0), np.empty(0))


def places(movers: Movers, times: Floats) -> Floats:
    """(S, m, 3) (x, y, radius) [m] of the discs at the times (S,) [s]."""
    way = movers.paths[:, 2:] - movers.paths[:, :2]
    length = np.hypot(way[:, 0], way[:, 1])
    walked = np.mod(movers.offsets + times[:, None] * movers.speeds, 2.0 * length)
    share = np.where(walked > length, 2.0 * length - walked, walked) / length
    at = movers.paths[:, :2] + share[:, :, None] * way
    return np.concatenate([at, np.broadcast_to(movers.radii[:, None], (*share.shape, 1))], axis=2)


def check_movers(movers: Movers) -> None:
    """Raise `SourceError` unless every disc has a path with two ends, a speed, a place on it and a size."""
    paths, *rest = movers
    if len(paths) > MAX_MOVERS:
        raise SourceError(f"movers.paths: there are {len(paths)}; expected at most {MAX_MOVERS}")
    for name, values in zip(Movers._fields[1:], rest, strict=True):
        if len(values) != len(paths):
            raise SourceError(
                f"movers.{name}: there are {len(values)}; expected one for each of the {len(paths)} paths"
            )
    for i, (path, speed, offset, radius) in enumerate(zip(*(values.tolist() for values in movers), strict=True)):
        if not all(abs(c) <= LARGEST for c in path) or np.hypot(path[2] - path[0], path[3] - path[1]) < 1e-3:
            raise SourceError(
                f"movers.paths[{i}] is {path}; expected [x0, y0, x1, y1], finite metres, the two ends a millimetre "
                "apart or more"
            )
        check_number(f"movers.speeds[{i}]", speed, "m/s", least=0)
        check_number(f"movers.offsets[{i}]", offset, "m", least=0)
        check_number(f"movers.radii[{i}]", radius, "m", above=0)
