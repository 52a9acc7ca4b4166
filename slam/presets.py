"""Sets of parameters (`slam.types.Params` fields) that go together."""

from __future__ import annotations

from typing import Any

PAPER: dict[str, Any] = {
    "temper": 1.0,
    "inflate_r": 1.0,
    "log_p_new": 0.0,
    "gate_known": 1.0,
    "gate_new": 0.0,
    "weighting": "marginal",
    "proposal_weight": "drawn",
    "resampler": "stratified",
    "resample_below": 0.75,
}
"""The honest R, every observation counted in full, one gate; the rest as in the paper's baseline code."""

BUILDING: dict[str, Any] = {"temper": 0.1, "inflate_r": 9.0, "gate": 0.99999, "gate_new": 0.99999999}
"""For walls that a laser sees scan after scan (ours).

Scans of one wall are no independent evidence, and particles are to differ when a loop closes: hence `temper` and
`inflate_r`.  The gates are wide because odometry that reports a turn too small reports a deviation too small as well,
and a particle that loses all walls in a corner draws the next ones at a wrong angle.
"""

LOG: dict[str, Any] = {**BUILDING, "temper": 0.03, "matching": "auto"}
"""For the logs of real lasers (ours).

The wall of an observation is seen in some thirty of them (19 to 52, over three logs), and what is wrong with it, or
with the way it is read, is wrong in all: so all of them together count as one.
"""
