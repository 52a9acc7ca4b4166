"""Both ways from one step on: the run as it was, and with other parameters; and both again with other random numbers.

Everything but the parameters that are set is the same for both, what a person changed later in a live session too.
Of random numbers, `draw` 0 are those of the run; others are streams of the filters that it might have had instead
(`app.session.stream`), from the fork on.  The world is always the same.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from app.session import Change, State, advance, describe_change, describe_noise, start
from app.types import SessionInfo, SessionStep
from app.whatif.origin import Origin
from app.whatif.settings import Values, with_values
from slam.types import Floats


class Plan(NamedTuple):
    """What is to be run."""

    origin: Origin
    first: int
    """The first step that is made with other parameters."""
    last: int
    values: Values
    """That are set from there on."""
    seeds: int
    """How often both are run again with other random numbers."""

    @property
    def work(self) -> int:
        """Steps that are made in all."""
        return self.first - 1 + 2 * (self.last - self.first + 1) * (1 + self.seeds)

    def settings(self, step: int, changed: bool) -> Change:
        """What holds in a step."""
        now = self.origin.at(step)
        return with_values(now, self.values) if changed and step >= self.first else now

    @property
    def info(self) -> SessionInfo:
        """The unchanged way, which may be run further than it was recorded."""
        info = self.origin.info
        return info._replace(steps=max(info.steps, self.last))

    @property
    def changed_info(self) -> SessionInfo:
        """The changed way, as a session of its own."""
        now = self.settings(self.first, changed=True)
        return self.info._replace(params=now.params, noise=now.noise or self.info.noise)


class Made(NamedTuple):
    """One step."""

    step: SessionStep
    changed: bool
    draw: int


def made(plan: Plan) -> Iterator[Made]:
    """All steps: up to the fork, then both ways in turn, then both again with each of the other random numbers."""
    state = start(plan.origin.info)
    for index in range(1, plan.first):
        state, step = _made(plan, state, index, False, 0)
        yield Made(step, False, 0)
    for draw in range(plan.seeds + 1):
        ways = {False: state, True: state}
        for index in range(plan.first, plan.last + 1):
            for changed in ways:
                ways[changed], step = _made(plan, ways[changed], index, changed, draw)
                yield Made(step, changed, draw)


def _made(plan: Plan, state: State, index: int, changed: bool, draw: int) -> tuple[State, SessionStep]:
    now = plan.settings(index, changed)
    before = plan.settings(index - 1, changed) if index > 1 else now
    info = plan.origin.info._replace(noise=now.noise or plan.origin.info.noise)
    state, step = advance(info, state, now.params, draw)
    said = describe_change(before.params, now.params) + describe_noise(before.noise or info.noise, info.noise)
    return state, dataclasses.replace(step, changes=said)


class Tally:
    """The numbers of one way, from the fork on: of every filter a series for each of them, named as in `app.rows`."""

    def __init__(self) -> None:
        self.steps: list[int] = []
        self.times: list[float] = []
        self.particles: dict[str, int] = {}
        """After the first step: what later ones descend from."""
        self._rows: dict[str, list[dict[str, float]]] = {}

    def add(self, step: SessionStep) -> None:
        """One more step."""
        self.steps.append(step.index)
        self.times.append(float(step.frame.time))
        for key, update in step.filters.items():
            measures, trace = update.measures, update.trace
            self.particles.setdefault(key, len(trace.resampled.log_w))
            ancestors = int(update.genealogy.distinct_ancestors()[len(self.steps) - 1])
            row = {
                "position_error_m": measures.position_error_m,
                "best_position_error_m": measures.best_position_error_m,
                "heading_error_rad": measures.heading_error_rad,
                "map_error_m": measures.map_error_m,
                "nees": measures.nees_position,
                "n_eff": measures.n_eff,
                "n_eff_share": measures.n_eff / len(trace.weighted.log_w),
                "diversity": measures.diversity,
                "ancestors": ancestors,
                "ancestors_share": ancestors / self.particles[key],
                "common_ancestor_steps": measures.common_ancestor_age,
                "features": measures.features,
                "duplicates_so_far": measures.duplicates,
                "resampled": trace.did_resample,
                "seconds": update.seconds,
            }
            self._rows.setdefault(key, []).append({name: float(value) for name, value in row.items()})

    def series(self, count: int | None = None) -> dict[str, dict[str, Floats]]:
        """By filter and name, (T,) of the first `count` steps."""
        return {
            key: {name: np.array([row[name] for row in rows[:count]]) for name in rows[0]}
            for key, rows in self._rows.items()
        }
