"""One thing is one, and not some."""

from __future__ import annotations

from scenarios.words import counted, times


def test_one_is_not_many() -> None:
    assert [counted(n, "step") for n in (0, 1, 2)] == ["0 steps", "1 step", "2 steps"]
    assert [times(n) for n in (1, 2)] == ["once", "2 times"]
