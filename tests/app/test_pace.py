"""Doing what takes long so seldom that it takes no more than a share of the time."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from numba.core import event

from app.compiling import PREPARES
from app.pace import Pace


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr("app.pace.monotonic", lambda: clock.now)
    monkeypatch.setattr("app.compiling.perf_counter", lambda: clock.now)
    return clock


def test_it_waits_for_its_share(clock: SimpleNamespace) -> None:
    pace = Pace(0.1)
    assert pace.due
    with pace.kept():
        clock.now += 2.0
    clock.now += 17.9
    assert not pace.due
    clock.now += 0.2
    assert pace.due


def test_kernels_are_prepared_once_and_that_is_not_waited_for(clock: SimpleNamespace) -> None:
    """Else the second picture would come minutes after the first."""
    pace = Pace(0.1)
    with pace.kept():
        with event.trigger_event(PREPARES):
            clock.now += 30.0
        clock.now += 1.0
    clock.now += 8.9
    assert not pace.due
    clock.now += 0.2
    assert pace.due


def test_what_fails_is_not_tried_again_at_once(clock: SimpleNamespace) -> None:
    pace = Pace(0.5)

    def fail() -> None:
        with pace.kept():
            clock.now += 1.0
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert not pace.due
