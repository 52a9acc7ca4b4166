"""A session: one source, several filters on identical data, and whoever watches.

Everything that a session does follows from its `SessionInfo` and the parameters of each step.  Random numbers come from
streams that are named by (seed, who, step): the world draws from its own, every filter from its own, and every step
from a fresh one.  So neither K nor the set of filters changes the world or another filter, and a session can be taken
up again from any earlier `State`, with other parameters, on the same random numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from time import perf_counter
from typing import Any, NamedTuple, TypeVar

import numpy as np

from app.compiling import CompileClock, uninterrupted_compilation
from app.diagnosis.evidence import evidence_of
from app.interrupt import Interrupts
from app.types import FilterUpdate, Observer, SessionInfo, SessionStep
from scenarios.noise import add_noise
from scenarios.types import Source
from slam.estimators import ESTIMATORS
from slam.genealogy import Genealogy
from slam.metrics import measure
from slam.mistakes import MISTAKES, with_mistake
from slam.motion import propagate
from slam.perception import perceive
from slam.perception.matching import Track
from slam.perception.odometry import correct_odometry
from slam.types import Estimator, Floats, Frame, Noise, Params, Particles

Made = TypeVar("Made")

WORLD = "world"
LETTERS = 256
"""Bytes that a name may consist of: what is larger is no part of it."""


class State(NamedTuple):
    """Where a session stands between two steps.  A value: keep it, and go on from it as often as you like."""

    done: int
    """Number of steps."""
    odometry: Floats
    """(3,) dead reckoning."""
    matched: Floats
    """(3,) dead reckoning, corrected by scan matching where that is used."""
    track: Track | None
    """What the next scan is matched with."""
    filters: dict[str, tuple[Any, Genealogy]]
    """What each filter needs for its next step."""


def stream(seed: int, who: str, step: int, draw: int = 0) -> np.random.Generator:
    """The random numbers of one of the players in one step.

    `draw` numbers the streams that it might have had instead; 0 is the one of the session.
    """
    again = (LETTERS + draw,) if draw else ()
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(step, *who.encode(), *again)))


def start(info: SessionInfo) -> State:
    """Before the first step."""
    source = info.source
    states: dict[str, tuple[Any, Genealogy]] = {}
    for estimator in info.filters:
        state = estimator.init(source.feature, source.start, source.start_covariance, info.params)
        particles: Particles = getattr(state, "particles", state)  # an `EkfState` has them inside
        states[estimator.key] = (state, Genealogy.start(particles.s))
    pose = np.array(source.start, float)
    return State(0, pose, pose, None, states)


def advance(info: SessionInfo, state: State, params: Params, draw: int = 0) -> tuple[State, SessionStep]:
    """One observing step, all filters.

    With another `draw` than 0 the filters draw from other streams, and the world from the same: what could have
    happened as well, to the same data.
    """
    index = state.done + 1
    exact, truth = info.source.steps[state.done]
    noisy = info.source.kind == "world"  # a log has its noise already
    frame = add_noise(stream(info.seed, WORLD, index), exact, info.noise) if noisy else exact
    frame = perceive(frame, params)

    odometry = _moved(state.odometry, frame)
    track, frame, match = correct_odometry(state.track, frame, params)
    matched = _moved(state.matched, frame)

    states: dict[str, tuple[Any, Genealogy]] = {}
    updates: dict[str, FilterUpdate] = {}
    for estimator in info.filters:
        before, genealogy = state.filters[estimator.key]
        rng = stream(info.seed, estimator.key, index, draw)
        with CompileClock() as compiling:
            began = perf_counter()
            after, trace = estimator.step(rng, before, frame, params)
            seconds = perf_counter() - began - compiling.seconds
        genealogy = genealogy.grow(trace.ancestors, trace.resampled.s)
        measures = measure(trace, frame, truth, info.source.true_map, genealogy)
        states[estimator.key] = (after, genealogy)
        evidence = evidence_of(trace, measures, frame, params)
        updates[estimator.key] = FilterUpdate(trace, seconds, measures, genealogy, evidence)

    step = SessionStep(
        index,
        frame,
        truth,
        odometry,
        params,
        info.noise,
        updates,
        matched=None if match is None else matched,
        match=match,
    )
    return State(index, odometry, matched, track, states), step


def _moved(pose: Floats, frame: Frame) -> Floats:
    """The pose (3,) after the motion that the frame tells of."""
    for u, dt in zip(frame.u, frame.dt, strict=True):
        pose = np.array(propagate(frame.motion, pose, u, dt)[0])
    return pose


def estimators(keys: Iterable[str], mistake: str = "") -> tuple[Estimator, ...]:
    """Filters by key; with the mistake those in which one can make it."""
    if not mistake:
        return tuple(ESTIMATORS[key] for key in keys)
    made = MISTAKES[mistake].phases
    return tuple(with_mistake(ESTIMATORS[key], mistake) if key in made else ESTIMATORS[key] for key in keys)


class Change(NamedTuple):
    """What holds from the top of a step on."""

    step: int
    params: Params
    noise: Noise | None = None
    """What the world is; None for as before."""


def steps(info: SessionInfo, changes: Sequence[Change] = ()) -> Iterator[SessionStep]:
    """All steps of a session."""
    due = {change.step: change for change in changes}
    state, params = start(info), info.params
    for index in range(1, info.steps + 1):
        sentences: tuple[str, ...] = ()
        if index in due:
            noise = due[index].noise or info.noise
            sentences = describe_change(params, due[index].params) + describe_noise(info.noise, noise)
            info, params = info._replace(noise=noise), due[index].params
        state, step = advance(info, state, params)
        yield dataclasses.replace(step, changes=sentences)


def make_info(
    source: Source,
    filters: Sequence[Estimator],
    params: Params | None = None,
    noise: Noise | None = None,
    seed: int = 0,
    count: int | None = None,
    command: str = "",
) -> SessionInfo:
    """A session on `source`: by default with its own parameters and noise, and to its end (`count` steps at most)."""
    total = len(source.steps) if count is None else min(count, len(source.steps))
    return SessionInfo(source, tuple(filters), params or source.params(), noise or source.noise, seed, total, command)


def run(
    info: SessionInfo,
    observers: Sequence[Observer] = (),
    changes: Sequence[Change] = (),
    interrupts: Interrupts | None = None,
) -> None:
    """Run a session to its end.

    Every observer that was begun is ended, whatever happens; several errors are raised as an `ExceptionGroup`.  With
    `interrupts`, a signal stops the filters at once, but an observer only when it has done its work: unless it is the
    second signal.
    """
    shield = interrupts.shield if interrupts else nullcontext
    begun: list[Observer] = []
    try:
        for observer in observers:
            with shield():
                begun.append(observer)
                observer.begin(info)
        for step in interruptible(steps(info, changes), interrupts or Interrupts()):
            with shield():
                for observer in observers:
                    observer.step(step)
    except Exception as error:
        with shield():
            _raise_all([error, *_end_all(begun)])
    except BaseException:  # an interruption: the caller will say that all is saved, so it must be
        with shield():
            _raise_all(_end_all(begun))
        raise
    else:
        with shield():
            _raise_all(_end_all(begun))


def interruptible(found: Iterator[Made], interrupts: Interrupts) -> Iterator[Made]:
    """The steps, or what else filters make, up to an interruption, even if a library lost it or made another error of
    it."""
    with uninterrupted_compilation(interrupts):
        while True:
            interrupts.check()
            try:
                step = next(found)
            except StopIteration:
                return
            except Exception as error:
                if interrupts.received:
                    raise KeyboardInterrupt from error
                raise
            yield step


def _end_all(observers: Sequence[Observer]) -> list[Exception]:
    """End every observer, whatever happens to the others; returns what went wrong."""
    errors: list[Exception] = []
    for observer in observers:
        try:
            observer.end()
        except Exception as error:
            errors.append(error)
    return errors


def _raise_all(errors: Sequence[Exception]) -> None:
    """Raise an error as it is, several as a group."""
    if len(errors) == 1:
        raise errors[0]
    if errors:
        raise ExceptionGroup("several things went wrong", errors)


def describe_change(before: Params, after: Params) -> tuple[str, ...]:
    """A sentence for every parameter that differs."""
    return tuple(
        f"{name}: {old} -> {new}"
        for (name, old), new in zip(flat(before).items(), flat(after).values(), strict=True)
        if old != new
    )


def describe_noise(before: Noise, after: Noise) -> tuple[str, ...]:
    """The same of what the world is."""
    pairs = zip(flat(before).items(), flat(after).values(), strict=True)
    return tuple(f"noise.{name}: {old} -> {new}" for (name, old), new in pairs if old != new)


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """The fields of nested dataclasses by dotted name: `{"particles": 100, "believed.range": 0.003, ...}`."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(value):
        inner = getattr(value, field.name)
        if dataclasses.is_dataclass(inner):
            found |= flat(inner, f"{prefix}{field.name}.")
        else:
            found[prefix + field.name] = inner
    return found
