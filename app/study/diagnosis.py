"""Whether what the diagnosis says is so: the cause that it names, and the number of particles that it asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

from app import session, values
from app.study.jobs import run_all
from app.study.output import MEDIANS, TITLES, JobsOption, OutOption, RunsOption, SeedOption, begin, empty_table, finish
from app.study.statistics import spread
from scenarios.registry import build

MORE = 10
"""So many times more particles are tried where the diagnosis says that more will not help."""

MOST = 3000
"""Particles that are tried."""

ENOUGH_OF_THEM = ("enough particles", "not for want of particles")
ASKED = ("more particles", "more particles at least")
ADVICE = (*ENOUGH_OF_THEM, *ASKED, "particles for a window", "more particles in vain")


class Setting(NamedTuple):
    """A filter in a world."""

    world: str
    filter: str
    particles: int
    params: Mapping[str, Any] = MappingProxyType({})


SETTINGS = {
    "dual-joint": Setting("paper-line", "dfs", 100, {"weighting": "joint"}),
    "dual-marginal": Setting("paper-line", "dfs", 100),
    "dual-few": Setting("paper-line", "dfs", 15),
    "fastslam2": Setting("paper-line", "fs2", 100),
    "fastslam2-few": Setting("paper-line", "fs2", 30),
    "fastslam1": Setting("paper-line", "fs1", 100),
    "loop-fastslam2": Setting("loop", "fs2", 30),
    "rotation-fastslam2": Setting("rotation-then-corridor", "fs2", 20),
    "rotation-dual": Setting("rotation-then-corridor", "dfs", 15),
    "field-fastslam1": Setting("field", "fs1", 100),
}


class Task(NamedTuple):
    """A setting with a seed."""

    name: str
    seed: int


class Outcome(NamedTuple):
    """What the diagnosis said of a run, and what became of its advice."""

    cause: str
    """Kind of the finding on all losses."""
    shape: float
    """Share of the variance that is laid to the shape of the map."""
    advice: str
    """Kind of the finding on the number of particles."""
    founders: float
    """That are left."""
    particles: int
    """That were tried then: those asked for, or ten times as many; 0 if none were."""
    founders_then: float
    """That were left of these, on another seed of the same world."""
    kept: bool
    """Whether so many are left as the diagnosis promises, or, where it says in vain, that they are not."""


@dataclass(frozen=True)
class DiagnosisStudy:
    """Whether diagnoses hold: the causes they name, and what becomes of runs with the particles they ask for."""

    runs: RunsOption = 10
    """Independent runs, with seeds from --seed on."""
    settings: Annotated[tuple[str, ...], values.choices("--settings", "NAME", tuple(SETTINGS))] = tuple(SETTINGS)
    """Filters in worlds; the table says which."""
    seed: SeedOption = 0
    """The first seed.  What is asked for is tried with others, 1000 further on."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """Every single run."""

    def __call__(self, command: str) -> int:
        """Run, print, save; returns the exit code."""
        jobs = begin(self.out, self.jobs)
        tasks = [Task(name, seed) for name in self.settings for seed in range(self.seed, self.seed + self.runs)]
        found, stopped = run_all(one_run, tasks, jobs, "diagnosis")
        table = empty_table(
            f"Diagnoses, {self.runs} runs each",
            "",
            "cause named most often",
            "shape named",
            "founders left",
            "advice given most often",
            "tried",
            "left then",
            "came true",
        )
        results: dict[str, Any] = {}
        notes = []
        for name in self.settings:
            setting, outcomes = SETTINGS[name], [o for t, o in zip(tasks, found, strict=False) if t.name == name]
            if outcomes:
                table.add_row(name, *_row(outcomes))
                runs = [one._asdict() for one in outcomes]
                results[name] = {**setting._asdict(), "params": dict(setting.params), "runs": runs}
                what = f"{setting.world}, {TITLES[setting.filter]}, K = {setting.particles}{_changes(setting)}"
                notes.append(f"{name}: {what}")
        note = "\n".join([*notes, MEDIANS])
        return finish(
            self,
            "diagnosis",
            command,
            {"settings": results},
            [table] if found else [],
            (len(found), len(tasks)),
            stopped,
            note,
            "runs",
        )


def _row(outcomes: list[Outcome]) -> list[str]:
    causes, advice = ([getattr(one, name) for one in outcomes] for name in ("cause", "advice"))
    tried = [one for one in outcomes if one.particles]
    return [
        _most(causes),
        f"{causes.count('shape of the map')} of {len(outcomes)}",
        spread([one.founders for one in outcomes]),
        _most(advice),
        spread([one.particles for one in tried]) if tried else "",
        spread([one.founders_then for one in tried]) if tried else "",
        f"{sum(one.kept for one in tried)} of {len(tried)}" if tried else "",
    ]


def _changes(setting: Setting) -> str:
    return "".join(f", {name} {value}" for name, value in setting.params.items())


def _most(names: list[str]) -> str:
    most = max(names, key=names.count)
    return f"{most} ({names.count(most)})"


def one_run(task: Task) -> Outcome:
    """A run, its diagnosis, and another one with as many particles as it asks for."""
    from app.diagnosis.ancestry import ENOUGH

    setting = SETTINGS[task.name]
    found = _diagnosed(setting, setting.particles, task.seed)
    causes = [f for f in found.findings if f.topic == "cause" and not f.kind.startswith("loss")]
    advice = next(f for f in found.findings if f.kind in ADVICE)
    left, asked = advice.numbers["founders_left"], int(advice.numbers.get("particles", 0))
    if advice.kind == "more particles in vain":
        asked = MORE * setting.particles
    tried = min(asked, MOST) if advice.kind in (*ASKED, "more particles in vain") else 0
    then = 0.0
    if tried:
        again = _diagnosed(setting, tried, task.seed + 1000)
        then = next(f for f in again.findings if f.kind == "founders").numbers["founders_left"]
    return Outcome(
        causes[0].kind if causes else "none",
        causes[0].numbers["shape"] if causes else 0.0,
        advice.kind,
        left,
        tried,
        then,
        (then < ENOUGH) if advice.kind == "more particles in vain" else then >= ENOUGH,
    )


def _diagnosed(setting: Setting, particles: int, seed: int) -> Any:
    from app.diagnosis.collecting import Collector
    from app.diagnosis.diagnose import diagnose
    from slam.estimators import ESTIMATORS

    source, collector = build(setting.world), Collector()
    params = source.params(particles=particles, **setting.params)
    session.run(session.make_info(source, [ESTIMATORS[setting.filter]], params, None, seed), [collector])
    return diagnose(collector.cases()[0])
