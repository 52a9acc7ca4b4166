"""What every world and every log gives: a `Source`, that is a sequence of frames with the truth as far as it is
known."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from slam.types import Floats, Frame, Ints, Noise, Params


class TrueMap(NamedTuple):
    """The landmarks, or the walls, as they are."""

    tags: Ints
    """(n,) for walls their index; a wall that is seen from behind has a second row, of another tag, turned round."""
    theta: Floats
    """(n, 2) x y of landmarks, (n, 4) x0 y0 x1 y1 of walls [m]"""


class Step(NamedTuple):
    """One observing step of a source."""

    frame: Frame
    """Exact for a world (noise is added later, `scenarios.noise`); as it was logged for a log."""
    truth: Floats | None
    """(3,) true pose at `frame.time`; None where nobody knows.  A heading that is not known is NaN."""


class LogScans(NamedTuple):
    """All scans of a laser log, of which the steps of a source may be a few."""

    stamps: Floats
    """(N,) [s] the log's own, in the order of the file; they may jitter."""
    odometry: Floats
    """(N, 3) [m, m, rad] pose of the robot at each scan, as its odometry reports it."""
    kept: Ints
    """(F,) for each step of the source its scan, increasing."""
    between: tuple[Ints, ...] = ()
    """For each step the scans of `Frame.between`; or nothing at all, if there are none."""


@dataclass(frozen=True)
class Source:
    """A simulated world or a real log, ready to be filtered."""

    name: str
    title: str
    """One line for people."""
    kind: Literal["world", "log"]
    motion: Any
    feature: Any
    steps: tuple[Step, ...]
    start: Floats
    """(3,) pose before the first step."""
    noise: Noise
    """World: what the noise is by default.  Log: what the filter believes by default."""
    start_covariance: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    """(3, 3)"""
    true_map: TrueMap | None = None
    max_range: float = float("inf")
    """[m] of the sensor; for drawing."""
    defaults: dict[str, Any] = field(default_factory=dict)
    """Parameters (`slam.types.Params` fields) that suit this source better than the general defaults."""
    warnings: tuple[str, ...] = ()
    """Sentences on what was odd in the input, each naming file and line."""
    options: dict[str, Any] = field(default_factory=dict)
    """The options that made this source, for `params` in summary and recording."""
    scans: LogScans | None = None
    """Of a laser log, what lies between its steps."""

    @property
    def has_clock(self) -> bool:
        """Whether its times are seconds, and not the numbers of scans, as in laser logs without time stamps."""
        return self.scans is None or bool((np.diff(self.scans.stamps) != 1.0).any())

    def params(self, **changes: Any) -> Params:
        """The parameters for this source: its own defaults and beliefs, then `changes`."""
        return Params(**{"believed": self.noise, **self.defaults, **changes})


class SourceError(ValueError):
    """Input that cannot be used; the message is one sentence that names the value, the place and what was expected."""
