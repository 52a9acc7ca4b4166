"""What differs between runs, in sentences: what they were made with, what they saw, and whether they are the same."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from app.compare.numbers import Comparison, Filter
from app.compare.runs import BRANCH_MARK, Run, common_steps
from app.errors import UsageError
from scenarios.words import counted
from slam.estimators import ESTIMATORS
from slam.types import Ints

RADIANS = ("turn", "bearing", "floor_angle")
"""Parameters that are angles."""

OF_A_STUDY = {"--filters", "--particles", "--steps", "--seed", "--seeds", "--jobs", "--out", "--picture"}
"""Options that its command does not take over from those of runs."""

OF_A_SOURCE = ("options.", "noise.")

APART = 1e-6
"""[s] within which two times are one."""


class Data(NamedTuple):
    """Whether two runs saw the same, over the steps that both have."""

    same: bool
    equal: list[str]
    """Of truth, odometry and observations what is equal at all steps at which both recordings have it."""
    other: dict[str, int]
    """What is not, and the first step at which."""


def settings(run: Run) -> dict[str, Any]:
    """Everything that a run was made with and that may change its numbers, by dotted name."""
    told = run.told
    noise = told["noise"] if told["kind"] == "world" else {}
    parts = {"options": told["options"], "noise": noise, "params": told["params"], "versions": told["versions"]}
    found = {"source": told["world"], "kind": told["kind"], "seed": told["seed"], "start": told["start"]}
    if told.get("mistake"):
        found["mistake"] = told["mistake"]
    for name, inner in parts.items():
        found |= _flat(inner, "" if name == "params" else f"{name}.")
    return found


def differences(first: Run, other: Run) -> dict[str, tuple[Any, Any]]:
    """By name what the two were made with, where that is not the same; None for what one of them does not have."""
    a, b = settings(first), settings(other)
    names = [*a, *(name for name in b if name not in a)]
    return {name: (a.get(name), b.get(name)) for name in names if a.get(name) != b.get(name)}


def data_of(first: Run, other: Run, steps: Ints) -> Data:
    """By what the recordings hold of it; where that is too little, by what they say."""
    equal, parted = [], {}
    for name in first.seen._fields:
        a, b = getattr(first.seen, name), getattr(other.seen, name)
        both = [i for i in steps.tolist() if i in a and i in b]
        apart = [i for i in both if not np.array_equal(a[i], b[i])]
        if apart:
            parted[name] = apart[0]
        elif both:
            equal.append(name)
    enough = (
        "observations" in equal or ("odometry" in equal and _one_log(first, other)) or _said_to_be_same(first, other)
    )
    return Data(not parted and enough, equal, parted)


def _one_log(first: Run, other: Run) -> bool:
    """Maybe of different parts: then its steps are not the same, and dead reckoning is not."""
    return first.told["kind"] == "log" and not {"source", "kind"} & differences(first, other).keys()


def _said_to_be_same(first: Run, other: Run) -> bool:
    """Of a log, whose noise is its own, the seed is only that of the filters."""
    what = ("source", "kind", "start", *(("seed",) if first.told["kind"] == "world" else ()))
    names = differences(first, other)
    return not any(name in what or name.startswith(OF_A_SOURCE) for name in names)


def sentences(found: Comparison) -> list[str]:
    """All that is to be said before the numbers."""
    first, *others = found.runs
    said = [*_odd(found.runs), _steps(found)]
    for run in others:
        said.append(_made(first, run))
        said.append(_data(first, run, found.steps))
        said += _moments(first, run, found.steps)
    said += [line for run in found.runs for line in (*_changed(run), *_on_relations(run))]
    said += _same_runs(found)
    return said + list(_missing(found))


def unfinished(runs: Sequence[Run]) -> Iterator[str]:
    """Which recordings end before their time."""
    for run in runs:
        last, asked = int(run.steps[-1]), int(run.told["steps"])
        if run.damaged:
            yield f"{run.path} is damaged: it is read as far as that goes, to step {last} of {asked}"
        elif last < asked:
            yield f"{run.path} ends at step {last} of {asked}"


def _odd(runs: Sequence[Run]) -> Iterator[str]:
    """What was not read as somebody may have expected."""
    for run in runs:
        there = {other.branch for other in runs if other.path == run.path}
        left = [f"{run.path}{BRANCH_MARK}{branch}" for branch in run.branches if branch not in there]
        if left and not run.branch:
            yield f"{run.name} is the first of several runs in {run.path}; {_others(left)}"
        if run.told.get("mistake"):
            yield f"{run.name} is wrong on purpose: {run.told['mistake']}"


def _others(names: list[str]) -> str:
    return f"the other is {names[0]}" if len(names) == 1 else f"the others are {', '.join(names)}"


def _steps(found: Comparison) -> str:
    counts = {run.name: len(run.steps) for run in found.runs}
    low, high = int(found.steps[0]), int(found.steps[-1])
    if len(set(counts.values())) == 1 and len(found.steps) == len(found.runs[0].steps):
        return f"compared over all {counted(len(found.steps), 'step')}, {low} to {high}"
    has = ", ".join(f"{name} has {count}" for name, count in counts.items())
    return f"{has} steps: compared over the {len(found.steps)} that all have, {low} to {high}"


def _made(first: Run, run: Run) -> str:
    apart = differences(first, run)
    if "source" in apart or "kind" in apart:  # then of course
        apart = {name: pair for name, pair in apart.items() if name != "start" and not name.startswith(OF_A_SOURCE)}
    parts = [f"{name} {_pair(name, a, b)}" for name, (a, b) in apart.items()]
    mine, its = set(first.filters), set(run.filters)
    parts += [f"without {', '.join(sorted(mine - its))}"] if mine - its else []
    parts += [f"with {', '.join(sorted(its - mine))}"] if its - mine else []
    if not parts:
        return f"{run.name} was made like {first.name}: source, seed, parameters, filters and versions are the same"
    return f"{run.name} differs from {first.name}: {'; '.join(parts)}"


def _data(first: Run, run: Run, steps: Ints) -> str:
    data = data_of(first, run, steps)
    if data.same and data.equal:
        are = "is" if data.equal in (["truth"], ["odometry"]) else "are"
        return f"{run.name} saw the same data as {first.name}: {_and(data.equal)} {are} equal at every step"
    if data.same:
        return f"{run.name} says it saw the same data as {first.name}; the recordings hold nothing to check that by"
    if not data.other:
        return f"whether {run.name} saw the same data as {first.name} cannot be told from the recordings"
    begins = set(data.other.values())
    names = [name if len(begins) == 1 else f"{name} from step {step} on" for name, step in data.other.items()]
    apart = _and(names) + (f" from step {begins.pop()} on" if len(begins) == 1 else "")
    rest = f"; {_and(data.equal)} the same" if data.equal else ""
    doubt = ", although source, noise and seed are said to be the same" if _said_to_be_same(first, run) else ""
    return f"{run.name} saw other data than {first.name}: other {apart}{rest}{doubt}"


def _moments(first: Run, run: Run, steps: Ints) -> list[str]:
    both = [i for i in steps.tolist() if i in first.times and i in run.times]
    gap = max((abs(first.times[i] - run.times[i]) for i in both), default=0.0)
    if gap <= APART:
        return []
    return [f"the same step is not the same moment in {first.name} and {run.name}: up to {gap:.3g} s lie between"]


def _changed(run: Run) -> Iterator[str]:
    if run.changes:
        told = "; ".join(f"{text} at step {step}" for step, text in run.changes)
        yield f"{run.name} was changed while it ran: {told}"


def _on_relations(run: Run) -> Iterator[str]:
    """What its recording says of the relations that paths were judged by."""
    if run.relations is not None:
        step, means = run.relations
        told = ", ".join(f"{title} {mean} m" for title, mean in means.items())
        yield f"{run.name}, mean error of relations after step {step}: {told or 'none is known'}"


def _same_runs(found: Comparison) -> list[str]:
    """Which filters are one run, bit for bit."""
    said: dict[str, list[str]] = {}
    for one in found.filters:
        for column in one.columns[1:]:
            if column.parts_at is None:
                pair = f"in {one.columns[0].run.name} and {column.run.name}"
                said.setdefault(pair, []).append(one.title)
    return [
        f"{_and(titles)} {'is' if len(titles) == 1 else 'are'} the same run {pair}: every number, bit for bit"
        for pair, titles in said.items()
    ]


def _missing(found: Comparison) -> Iterator[str]:
    """Which rows cannot be there."""
    blind = [run.name for run in found.runs if not _knows(run, found)]
    if len(blind) == len(found.runs):
        yield "nobody knows the truth: there are no errors and no NEES"
    elif blind:
        yield f"nobody knows the truth in {_and(blind)}: no errors and no NEES there"
    compared = {one.key for one in found.filters}
    for key, estimator in ESTIMATORS.items():
        if key not in compared and any(key in run.filters for run in found.runs):
            yield f"{estimator.title} was on at no step that all of them have: it is not compared"
    for one in found.filters:
        for column in one.columns:
            if column.missing:
                yield f"the recording of {column.run.name} lacks {_and(sorted(column.missing))} of {one.title}"
        if len(one.steps) < len(found.steps):
            yield f"{one.title} was not always on: compared over {counted(len(one.steps), 'step')}, {_span(one)}"


def _knows(run: Run, found: Comparison) -> bool:
    columns = [column for one in found.filters if (column := one.column(run))]
    return any(np.isfinite(column.series["position_error_m"]).any() for column in columns)


def _span(one: Filter) -> str:
    return f"{one.steps[0]} to {one.steps[-1]}"


def all_the_same(found: Comparison) -> bool:
    """Whether every filter is one run in all."""
    return all(
        len(one.columns) == len(found.runs) and all(column.parts_at is None for column in one.columns)
        for one in found.filters
    )


def no_statistics(found: Comparison) -> list[str]:
    """That single runs say little, and what would say more: a sentence, then commands."""
    if all_the_same(found):
        return ["nothing differs but the clock: these are the same runs"]
    text = "one run each is no statistics: with another seed a difference may be another one"
    if any(run.branch or run.told.get("mistake") for run in found.runs):  # which no study has
        return [text]
    return [f"{text}; a study says how much:", *study_commands(found.runs)]


def study_commands(runs: Sequence[Run]) -> list[str]:
    """One for all runs, or as many as have different options beside K.

    A study takes no options of worlds; worlds that were given some become files first.
    """
    from app.command import option_names  # which knows this module
    from app.sources import all_world_options
    from app.study import STUDIES

    name = "laser-log" if runs[0].told["kind"] == "log" and runs[0].walls else "log-error"
    taken, of_worlds = option_names(STUDIES[name]), all_world_options()
    groups: dict[tuple[str, tuple[str, ...], tuple[str, ...]], list[Run]] = {}
    for run in runs:
        source, options = _command(run)
        own = tuple(word for option in options if option[0] in of_worlds - taken for word in option)
        kept = tuple(word for option in options if option[0] in taken - OF_A_STUDY for word in option)
        groups.setdefault((source, own, kept), []).append(run)
    part = "--steps" in taken and any("--steps" in run.told["command"] for run in runs)
    steps = ["--steps", f"{common_steps(runs)[-1]}"] if part else []
    commands = []
    for number, ((source, own, kept), group) in enumerate(groups.items(), 1):
        if own:
            file = f"{source}-{number}.toml"
            commands.append(["dualslam", "worlds", source, *own, "--write", file])
            source = file
        keys = [key for key in ESTIMATORS if any(key in run.filters for run in group)]
        many = sorted({int(run.told["params"]["particles"]) for run in group})
        what = ["--filters", *keys, "--particles", *map(str, many), *steps, *kept]
        commands.append(["dualslam", "study", name, source, *what])
    return [shlex.join(words) for words in commands]


def _command(run: Run) -> tuple[str, list[list[str]]]:
    """The source as it was typed, and the options, each with its values; or else its name."""
    from app.command import parse
    from app.run import SessionOptions

    nothing = (run.told["world"], [])
    try:
        _, *words = shlex.split(run.told["command"])
        if words[:1] not in (["run"], ["live"]):
            return nothing
        command, _ = parse(words)
    except (UsageError, ValueError):  # begun from Python, or by another version
        return nothing
    if not isinstance(command, SessionOptions) or not command.source:
        return nothing
    options: list[list[str]] = []
    for word in words[1:]:
        if word.startswith("--"):
            options.append(word.split("=", 1))
        elif options and word != command.source:
            options[-1].append(word)
    return command.source, options


def _and(names: Sequence[str]) -> str:
    *head, last = names or [""]
    return f"{', '.join(head)} and {last}" if head else last


def _pair(name: str, a: Any, b: Any) -> str:
    """Both, with as many digits as it takes to tell them apart."""
    short = [_shown(value, ".9g") for value in (a, b)]
    text = " -> ".join(short if short[0] != short[1] else [_shown(value, "") for value in (a, b)])
    return f"{text} rad" if name.rpartition(".")[2] in RADIANS else text


def _shown(value: Any, form: str) -> str:
    if isinstance(value, list):
        return f"({', '.join(_shown(part, form) for part in value)})"
    return format(value, form) if isinstance(value, float) else "none" if value is None else str(value)


def _flat(value: dict[str, Any], prefix: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, inner in value.items():
        found |= _flat(inner, f"{prefix}{name}.") if isinstance(inner, dict) else {prefix + name: inner}
    return found
