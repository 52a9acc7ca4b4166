"""How near the ancestry of one run comes to what luck does to it: `python -m tests.benchmarks.luck [runs [seed]]`.

Filters run many times on the same data with other random numbers.  The variance of their estimates is the truth; beside
it is what each run tells of itself (`slam.ancestry_variance`): by its founders, and by the most recent ancestors that
still tell, as far back as they do.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from app import session
from scenarios.registry import build
from slam.ancestry_variance import ancestry_variance
from slam.estimators import ESTIMATORS
from slam.geometry import wrap_all
from slam.metrics import pose_error
from slam.types import Floats, Ints, Trace

SETTINGS = (("paper-line", 100, 59), ("paper-line", 30, 59), ("field", 100, 120), ("loop", 50, 120))
"""World, particles, steps."""

SHARES = (0.5, 0.67, 0.8, 0.9)
"""Of `slam.ancestry_variance.APART`."""


class Told(NamedTuple):
    """Deviations [m] of the position, (runs, steps), by share."""

    founders: dict[float, Floats]
    later: dict[float, Floats]
    """Where the founders do not tell."""


def position(deviations: Floats, w: Floats, families: Ints, apart: float) -> float:
    """[m] root of the mean of x and y."""
    return float(np.sqrt(ancestry_variance(deviations, w, families, apart)[:2].mean()))


def later(trace: Trace, history: list[Ints], away: Floats, w: Floats, apart: float) -> float:
    """By the ancestors as many steps back as there are enough of them."""
    families, found = np.arange(len(w)), np.nan
    for ancestors in (trace.resized, *reversed(history)):
        told = position(away, w, families, apart)
        if np.isnan(told):
            break
        found, families = told, ancestors[families]
    return found


def measured(world: str, key: str, particles: int, steps: int, runs: int, seed: int) -> tuple[Floats, Told]:
    """The truth [m] (steps,), and what the runs tell."""
    source = build(world)
    info = session.make_info(source, [ESTIMATORS[key]], source.params(particles=particles), None, seed, steps)
    estimates = np.zeros((runs, info.steps, 3))
    told = Told(*({share: np.full((runs, info.steps), np.nan) for share in SHARES} for _ in range(2)))
    for run in range(runs):
        state, history = session.start(info), []
        for t in range(info.steps):
            state, step = session.advance(info, state, info.params, draw=run + 1)
            trace, estimate = step.filters[key].trace, step.filters[key].measures.estimate
            away, w = trace.weighted.s - estimate, np.exp(trace.weighted.log_w)
            away[:, 2] = wrap_all(away[:, 2])
            estimates[run, t] = estimate
            for share in SHARES:
                told.founders[share][run, t] = position(away, w, trace.weighted.lineage, share)
                if np.isnan(told.founders[share][run, t]):
                    told.later[share][run, t] = later(trace, history, away, w, share)
            history.append(trace.ancestors)
    return np.sqrt(pose_error(estimates, estimates[0]).var(axis=0, ddof=1)[:, :2].mean(axis=1)), told


def row(name: str, ratios: Floats, share: float) -> str:
    low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
    half = (ratios < 0.5).mean()
    return f"{name:20} {share:5.2f} {len(ratios):7d} {middle:7.2f} ({low:.2f} to {high:.2f}) {100 * half:10.0f} %"


def main(runs: int = 30, seed: int = 100) -> None:
    ratios: dict[tuple[str, float], list[Floats]] = {}
    for world, particles, steps in SETTINGS:
        for key in ("dfs", "fs2", "fs1"):
            truth, told = measured(world, key, particles, steps, runs, seed)
            for name, found in zip(("founders", "later ancestors"), told, strict=True):
                for share, values in found.items():
                    there = np.isfinite(values) & (truth > 1e-6)
                    ratios.setdefault((name, share), []).append((values / np.maximum(truth, 1e-6))[there])
    print("told by              apart   cases  told / true (8 of 10)  below a half")
    for (name, share), found in ratios.items():
        print(row(name, np.concatenate(found), share))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
