"""How surely the classic mistakes are told apart from a right filter by its numbers, and what they do to it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from rich.table import Table

from app import session, values
from app.diagnosis.evidence import record_of
from app.diagnosis.marks import Marks, marks_of
from app.diagnosis.signatures import Looked, look
from app.options import FILTERS, MISTAKES, default
from app.study.jobs import run_all
from app.study.output import TITLES, JobsOption, OutOption, RunsOption, SeedOption, begin, empty_table, finish
from app.types import SessionStep
from scenarios.registry import build
from slam.limits import PARAMS, Interval
from slam.types import Estimator, Floats, Noise


class World(NamedTuple):
    """Where runs take place."""

    name: str
    options: dict[str, str]
    steps: int
    """At most."""
    sensor: dict[str, float]
    """[m, rad] deviations of the sensor, where they are not the world's own."""
    params: dict[str, Any]
    """Of the filters, where they are not the world's own."""


WORLDS: dict[str, World] = {
    "paper-line": World("paper-line", {}, 60, {}, {}),
    "field": World("field", {}, 80, {}, {}),
    "loop": World("loop", {"features": "landmarks"}, 150, {}, {}),
    "field-fine": World("field", {}, 60, {"range": Noise.range, "bearing": Noise.bearing}, {"association": "known"}),
    "corridor": World("corridor", {}, 80, {}, {}),
    "hall": World("hall", {}, 80, {}, {}),
}
"""field-fine has the sensor of paper-line and its known association: plain densities underflow where no gate keeps what
fits badly from being weighed."""

DEVELOPED_ON = ("paper-line", "field", "loop")
"""What the diagnosis looks at, and what it calls a rounding error, was chosen on these."""

SENSITIVE = 1e-3
"""[m] A mistake has changed a run whose estimate is somewhere farther than that from the right one's."""

NONE = ""
"""The name of the mistake of a right filter."""

NOTE = (
    "n of m: told rightly, of the runs that the mistake changes; of right filters, runs with a false alarm; "
    "error, N_eff, diversity: right filter -> with the mistake, medians over changed runs"
)


class Task(NamedTuple):
    """All filters, right and wrong, on one seed of one world."""

    study: MistakesStudy
    world: str
    seed: int


class Outcome(NamedTuple):
    """One filter in one run, with a mistake or without."""

    filter: str
    mistake: str
    changed: bool
    """Whether the mistake changed the result."""
    named: tuple[str, ...]
    """The mistakes that the diagnosis names."""
    open: tuple[str, ...]
    """Those that it cannot tell."""
    error_m: float
    """Of the estimate's position, mean over steps."""
    n_eff: float
    """Of K, mean over steps."""
    diversity: float
    """Share of the founders that are left at the end."""

    @property
    def verdict(self) -> str:
        """right, wrong or undecided."""
        if self.named == ((self.mistake,) if self.mistake else ()):
            return "right"
        return "undecided" if not self.named and self.mistake in self.open else "wrong"


class Watched(NamedTuple):
    """What is kept of one filter's run."""

    looked: Looked
    estimates: Floats
    """(T, 2) [m]"""
    n_eff: float
    diversity: float


@dataclass(frozen=True)
class MistakesStudy:
    """The classic mistakes: how often a filter's numbers tell which one, and how often a right one seems wrong."""

    runs: RunsOption = 20
    """Independent runs in each world, with seeds from --seed on."""
    worlds: Annotated[tuple[str, ...], values.choices("--worlds", "|".join(WORLDS), tuple(WORLDS))] = tuple(WORLDS)
    """Some of the worlds; loop has landmarks, field-fine the sensor and the tags of paper-line."""
    mistakes: Annotated[tuple[str, ...], values.choices("--mistakes", "NAME", MISTAKES)] = MISTAKES
    """Some of the mistakes."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS[:3]), FILTERS[:3])] = FILTERS[:3]
    """Some of dfs, fs2, fs1."""
    particles: Annotated[int, values.whole("--particles", "K", PARAMS["particles"])] = 30
    """Number of particles."""
    steps: Annotated[int | None, values.whole("--steps", "N", Interval(1)), default("60 to 150, by world")] = None
    """Observing steps of each run, at most."""
    seed: SeedOption = 0
    """The first seed."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Every single run."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        seeds = range(self.seed, self.seed + self.runs)
        tasks = [Task(self, world, seed) for seed in seeds for world in self.worlds]
        found, stopped = run_all(one_run, tasks, jobs, "mistakes")
        runs = {
            world: [o for task, outcomes in zip(tasks, found, strict=False) if task.world == world for o in outcomes]
            for world in self.worlds
        }
        results = {world: [{**o._asdict(), "verdict": o.verdict} for o in outcomes] for world, outcomes in runs.items()}
        tables = [self._rates(runs), self._effects(runs)] if found else []
        done = len(found) // len(self.worlds)
        return finish(self, "mistakes", command, {"worlds": results}, tables, (done, self.runs), stopped, NOTE)

    def _rates(self, runs: dict[str, list[Outcome]]) -> Table:
        title = f"{self.particles} particles; * worlds that nothing was chosen on"
        table = empty_table(title, "mistake", "filter", *map(_titled, self.worlds), "right", "wrong", "undecided")
        for mistake, key, of in self._rows(runs):
            cells = [_told([o for o in outcomes if o.changed]) for outcomes in of.values()]
            everything = [o for outcomes in of.values() for o in outcomes if o.changed]
            counts = [sum(o.verdict == verdict for o in everything) for verdict in ("right", "wrong", "undecided")]
            shares = [f"{count / len(everything):.1%}" if everything else "-" for count in counts]
            table.add_row(mistake or "none", TITLES[key], *cells, *shares)
        return table

    def _effects(self, runs: dict[str, list[Outcome]]) -> Table:
        table = empty_table("what they do", "mistake", "filter", "changed", "error, m", "N_eff", "diversity")
        for mistake, key, of in self._rows(runs):
            if mistake == NONE:
                continue
            pairs = [
                (right, wrong)
                for world, outcomes in of.items()
                for right, wrong in zip(_of(runs[world], NONE, key), outcomes, strict=True)
            ]
            changed = [(right, wrong) for right, wrong in pairs if wrong.changed]
            cells = [_from_to(changed, name) for name in ("error_m", "n_eff", "diversity")]
            table.add_row(mistake, TITLES[key], f"{len(changed)} of {len(pairs)}", *cells)
        return table

    def _rows(self, runs: dict[str, list[Outcome]]) -> list[tuple[str, str, dict[str, list[Outcome]]]]:
        """Mistake, filter, and by world what came of them."""
        rows = [
            (mistake, key, {world: _of(outcomes, mistake, key) for world, outcomes in runs.items()})
            for mistake in (NONE, *self.mistakes)
            for key in self.filters
        ]
        return [row for row in rows if any(row[2].values())]


def one_run(task: Task) -> list[Outcome]:
    """All filters and all mistakes on one seed of one world: the frames are the same for all."""
    from slam.estimators import ESTIMATORS
    from slam.mistakes import MISTAKES as KNOWN
    from slam.mistakes import with_mistake

    study, world = task.study, WORLDS[task.world]
    source = build(world.name, **world.options)
    believed = dataclasses.replace(source.params().believed, **world.sensor)
    params = source.params(particles=study.particles, believed=believed, **world.params)
    noise = dataclasses.replace(source.noise, **world.sensor)
    info = session.make_info(source, (), params, noise, task.seed, study.steps or world.steps)
    steps = list(session.steps(info))
    truth = np.array([step.truth[:2] for step in steps if step.truth is not None])
    outcomes = []
    for key in study.filters:
        right = watch(ESTIMATORS[key], task.seed, info, steps)
        wrong = {
            name: watch(with_mistake(ESTIMATORS[key], name), task.seed, info, steps)
            for name in study.mistakes
            if key in KNOWN[name].phases
        }
        for name, watched in {NONE: right, **wrong}.items():
            off = np.linalg.norm(watched.estimates - right.estimates, axis=1).max()
            error = float(np.linalg.norm(watched.estimates - truth, axis=1).mean())
            names = tuple(finding.mistake for finding in watched.looked.findings)
            changed = name == NONE or bool(off > SENSITIVE)
            outcomes.append(
                Outcome(key, name, changed, names, watched.looked.open, error, watched.n_eff, watched.diversity)
            )
    return outcomes


def watch(estimator: Estimator, seed: int, info: Any, steps: Sequence[SessionStep]) -> Watched:
    """One filter on the frames of a session, on the random numbers that are its own, and what its numbers say."""
    from slam.genealogy import diversity
    from slam.metrics import mixture_moments

    source = info.source
    state = estimator.init(source.feature, source.start, source.start_covariance, info.params)
    marks, estimates, n_eff, left = [], [], [], math.nan
    for step in steps:
        rng = session.stream(seed, estimator.key, step.index)
        state, trace = estimator.step(rng, state, step.frame, step.params)
        marks.append(marks_of(trace, step.frame, step.params))
        s, P, log_w, _, _ = trace.weighted
        estimates.append(mixture_moments(s, P, np.exp(log_w))[0][:2])
        n_eff.append(trace.n_eff / len(log_w))
        left = diversity(trace.resampled.lineage)
    record = record_of(np.array([step.index for step in steps]), Marks._fields, np.array(marks), [])
    return Watched(look(record), np.array(estimates), float(np.mean(n_eff)), left)


def _of(outcomes: Sequence[Outcome], mistake: str, key: str) -> list[Outcome]:
    return [o for o in outcomes if o.mistake == mistake and o.filter == key]


def _titled(world: str) -> str:
    return world if world in DEVELOPED_ON else f"{world}*"


def _told(outcomes: Sequence[Outcome]) -> str:
    """How many were told rightly, of those where there was something to tell; of right filters, false alarms."""
    if not outcomes:
        return "-"
    count = sum((o.verdict == "right") == bool(o.mistake) for o in outcomes)
    return f"{count} of {len(outcomes)}"


def _from_to(pairs: Sequence[tuple[Outcome, Outcome]], name: str) -> str:
    if not pairs:
        return "-"
    before, after = (float(np.median([getattr(pair[i], name) for pair in pairs])) for i in (0, 1))
    return f"{before:.2g} -> {after:.2g}"
