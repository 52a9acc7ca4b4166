"""A session: the same data for every filter, the same bits for the same seed, and observers that are always ended."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numba
import numpy as np
import pytest

from app import session
from app.compiling import CompileClock, uninterrupted_compilation
from app.interrupt import Interrupts
from app.types import SessionInfo, SessionStep
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.perception import STANDARD, extract
from slam.types import Noise

STEPS = 12
ROOT = Path(__file__).parent.parent.parent


class Watch:
    """Keeps the steps."""

    def __init__(self) -> None:
        self.steps: list[SessionStep] = []
        self.calls: list[str] = []

    def begin(self, info: SessionInfo) -> None:
        self.calls.append("begin")

    def step(self, step: SessionStep) -> None:
        self.steps.append(step)

    def end(self) -> None:
        self.calls.append("end")


class Failing(Watch):
    """Goes wrong in one of its methods."""

    def __init__(self, where: str, error: type[BaseException] = OSError) -> None:
        super().__init__()
        self.where, self.error = where, error

    def _at(self, where: str) -> None:
        if where == self.where:
            raise self.error(f"in {where}")

    def begin(self, info: SessionInfo) -> None:
        super().begin(info)
        self._at("begin")

    def step(self, step: SessionStep) -> None:
        super().step(step)
        self._at("step")

    def end(self) -> None:
        super().end()
        self._at("end")


def watch(
    keys: Sequence[str] = ("dfs", "fs2"),
    particles: int = 10,
    seed: int = 3,
    changes: Sequence[session.Change] = (),
    noise: Noise | None = None,
    features: str = "landmarks",
) -> list[SessionStep]:
    source, watcher = build("loop", features=features), Watch()
    params = source.params(particles=particles, inflate_r=1.0)
    info = session.make_info(source, [ESTIMATORS[key] for key in keys], params, noise, seed, STEPS)
    session.run(info, [watcher], changes)
    return watcher.steps


def world_hash(steps: Sequence[SessionStep]) -> str:
    digest = hashlib.sha256()
    for step in steps:
        for array in (step.frame.u, step.frame.z, step.frame.tags, step.odometry):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def estimates(steps: Sequence[SessionStep], key: str) -> np.ndarray:
    return np.array([step.filters[key].measures.estimate for step in steps])


@pytest.mark.parametrize("features", ["landmarks", "walls"])
def test_neither_the_filters_nor_their_number_of_particles_change_the_world(features):
    worlds = {
        world_hash(watch(keys, particles, features=features))
        for keys in (["dfs"], ["fs1"], ["ekf", "fs2"], ["dfs", "fs2", "fs1", "ekf"])
        for particles in (1, 7, 30)
    }
    assert len(worlds) == 1


def test_a_filter_does_not_notice_the_others():
    alone, together = watch(["fs2"]), watch(["dfs", "fs1", "fs2", "ekf"])
    np.testing.assert_array_equal(estimates(alone, "fs2"), estimates(together, "fs2"))


@pytest.mark.parametrize("features", ["landmarks", "walls"])
@pytest.mark.parametrize("key", list(ESTIMATORS))
def test_same_seed_same_bits(key, features):
    once, again, other = (watch([key], seed=seed, features=features) for seed in (3, 3, 4))
    np.testing.assert_array_equal(estimates(once, key), estimates(again, key))
    assert world_hash(once) == world_hash(again) != world_hash(other)


def test_walls_are_found_in_the_scan_that_the_filters_could_see():
    """With its noise, once for all filters, and with the tags of the walls that were hit."""
    for step in watch(features="walls"):
        frame = step.frame
        assert frame.scan is not None
        found = extract(frame.scan, step.params.believed.range, STANDARD)
        np.testing.assert_array_equal(frame.z, found.z)
        assert 2 <= len(frame.z) == len(frame.tags)
        assert (frame.tags >= 0).mean() > 0.5
        assert len(step.filters["dfs"].trace.n[0]) == len(frame.z)


def test_streams_do_not_repeat():
    draws = {
        session.stream(seed, who, step).standard_normal()
        for seed in range(3)
        for who in ("world", "dfs", "fs2")
        for step in range(3)
    }
    assert len(draws) == 27


def test_without_noise_dead_reckoning_is_the_truth():
    steps = watch(noise=Noise(speed=0, turn=0, range=0, bearing=0, odometry=0))
    for step in steps:
        np.testing.assert_allclose(step.odometry, step.truth, atol=1e-9)


def test_a_log_keeps_its_own_noise():
    source = build("loop", features="landmarks")
    log = dataclasses.replace(source, kind="log")
    watcher = Watch()
    session.run(session.make_info(log, [ESTIMATORS["ekf"]], seed=1, count=STEPS), [watcher])
    for step, exact in zip(watcher.steps, source.steps, strict=False):
        assert step.frame is exact.frame


def test_changes_take_effect_at_the_top_of_their_step_and_are_told():
    params = build("loop", features="landmarks").params(particles=10, inflate_r=1.0)
    changed = dataclasses.replace(
        params, particles=25, inflate_r=4.0, believed=dataclasses.replace(params.believed, range=0.5)
    )
    steps = watch(changes=[session.Change(5, changed)])
    sizes = [len(step.filters["dfs"].trace.weighted.log_w) for step in steps]
    assert sizes == [10] * 4 + [25] * (STEPS - 4)
    assert [step.changes for step in steps[:4]] == [()] * 4
    assert steps[4].changes == ("particles: 10 -> 25", "believed.range: 0.05 -> 0.5", "inflate_r: 1.0 -> 4.0")
    assert steps[4].params is changed
    assert world_hash(steps) == world_hash(watch())


def test_a_session_goes_on_from_any_earlier_state():
    source = build("loop", features="landmarks")
    info = session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=10), seed=3, count=STEPS)
    states = [session.start(info)]
    steps = []
    for _ in range(STEPS):
        state, step = session.advance(info, states[-1], info.params)
        states.append(state)
        steps.append(step)
    middle, again = states[5], []
    for _ in range(5, STEPS):
        middle, step = session.advance(info, middle, info.params)
        again.append(step)
    np.testing.assert_array_equal(estimates(again, "dfs"), estimates(steps[5:], "dfs"))


def test_a_session_is_no_longer_than_its_source():
    source = build("paper-line")
    assert session.make_info(source, [], count=10_000).steps == len(source.steps)


@pytest.mark.parametrize("where", ["begin", "step", "end"])
def test_every_observer_that_was_begun_is_ended(where):
    source = build("paper-line")
    first, failing, last = Watch(), Failing(where), Watch()
    with pytest.raises(OSError, match=f"in {where}"):
        session.run(session.make_info(source, [ESTIMATORS["ekf"]], count=2), [first, failing, last])
    assert first.calls == failing.calls == ["begin", "end"]
    assert last.calls == ([] if where == "begin" else ["begin", "end"])


def test_every_error_is_told():
    source = build("paper-line")
    info = session.make_info(source, [ESTIMATORS["ekf"]], count=2)
    with pytest.raises(ExceptionGroup) as raised:
        session.run(info, [Failing("end"), Failing("step"), Failing("end")])
    assert [str(error) for error in raised.value.exceptions] == ["in step", "in end", "in end"]
    with pytest.raises(OSError, match="in end"):
        session.run(info, [Failing("end"), Failing("step", KeyboardInterrupt)])


def test_observers_are_ended_when_interrupted():
    source, first = build("paper-line"), Watch()
    with pytest.raises(KeyboardInterrupt):
        session.run(
            session.make_info(source, [ESTIMATORS["ekf"]], count=2), [first, Failing("step", KeyboardInterrupt)]
        )
    assert first.calls == ["begin", "end"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_the_end_of_a_shield(number):
    passed: list[str] = []

    def interrupted() -> None:
        with Interrupts() as interrupts:
            with interrupts.shield():
                os.kill(os.getpid(), number)
                passed.append("saved")
            passed.append("forgotten")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert passed == ["saved"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_outside_a_shield_does_not_wait(number):
    passed: list[str] = []

    def interrupted() -> None:
        with Interrupts():
            os.kill(os.getpid(), number)
            passed.append("ignored")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not passed


def test_a_second_signal_does_not_wait_for_the_end_of_a_shield():
    passed: list[str] = []

    def interrupted() -> None:
        with Interrupts() as interrupts, interrupts.shield():
            os.kill(os.getpid(), signal.SIGINT)
            passed.append("first")
            os.kill(os.getpid(), signal.SIGINT)
            passed.append("second")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert passed == ["first"]


def test_an_error_in_a_shield_goes_before_an_interruption():
    def failing() -> None:
        with Interrupts() as interrupts:
            with contextlib.suppress(OSError), interrupts.shield():
                os.kill(os.getpid(), signal.SIGINT)
                raise OSError
            with interrupts.shield():
                pass
            assert interrupts.received

    failing()


class Deaf:
    """A filter in which an interruption gets lost, as in a callback of a library, or becomes another error."""

    def __init__(self, error: bool) -> None:
        self.error = error
        self.inner = ESTIMATORS["ekf"]

    def __getattr__(self, name: str):
        return getattr(self.inner, name)

    def step(self, *arguments):
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        if self.error:
            raise RuntimeError("no compiled object yet")
        return self.inner.step(*arguments)


@pytest.mark.parametrize("error", [False, True])
def test_a_lost_interruption_ends_the_run_all_the_same(error):
    watcher = Watch()
    info = session.make_info(build("paper-line"), [Deaf(error)], count=3)

    def run() -> None:
        with Interrupts() as interrupts:
            session.run(info, [watcher], interrupts=interrupts)

    with pytest.raises(KeyboardInterrupt):
        run()
    assert len(watcher.steps) == (0 if error else 1)
    assert watcher.calls == ["begin", "end"]


def test_an_interruption_waits_for_the_end_of_a_compilation():
    told: list[bool] = []

    def compiling(now: bool) -> None:
        told.append(now)
        if now:
            os.kill(os.getpid(), signal.SIGINT)

    @numba.njit
    def half(x):
        return x / 2

    def interrupted() -> None:
        with Interrupts() as interrupts, uninterrupted_compilation(interrupts), CompileClock(compiling):
            half(1)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert told == [True, False]
    assert half.signatures


def test_former_signal_handlers_come_back():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with Interrupts():
        assert signal.getsignal(signal.SIGINT) != before[0]
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_compilation_is_told_and_counted_once():
    @numba.njit
    def inner(x):
        return x + 1

    @numba.njit
    def outer(x):
        return inner(x) * 2

    told: list[bool] = []
    with CompileClock(told.append) as clock:
        outer(1)
    assert told == [True, False]
    assert clock.seconds > 0
    with CompileClock(told.append) as clock:
        outer(1)
    assert len(told) == 2
    assert clock.seconds == 0


def test_loading_a_compiled_kernel_is_counted_but_not_told(tmp_path):
    """Or the filter that runs first would look slower than the others."""
    program = tmp_path / "kernels.py"
    program.write_text("""
import sys
import numba
from app.compiling import CompileClock

@numba.njit(cache=True)
def half(x):
    return x / 2

told = []
with CompileClock(told.append) as clock:
    half(1)
print(len(told), clock.seconds > 0)
""")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    said = [
        subprocess.run([sys.executable, program], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert said == ["2 True\n", "0 True\n"]
