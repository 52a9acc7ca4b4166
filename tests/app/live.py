"""What tests of live sessions have in common."""

from __future__ import annotations

from typing import Any

from app.live.engine import Begun, Engine, Forked, Status, Stepped
from app.live.settings import Settings

PATIENCE = 60.0
"""[s]"""


class Notes:
    """A listener that keeps everything."""

    def __init__(self) -> None:
        self.all: list[Begun | Forked | Stepped | None] = []

    def begun(self, begun: Begun) -> None:
        self.all.append(begun)

    def forked(self, forked: Forked) -> None:
        self.all.append(forked)

    def stepped(self, stepped: Stepped) -> None:
        self.all.append(stepped)

    def closed(self) -> None:
        self.all.append(None)

    @property
    def steps(self) -> list[Stepped]:
        return [item for item in self.all if isinstance(item, Stepped)]


def at(engine: Engine, step: int, branch: str | None = None) -> Status:
    """Wait until a session stands there, and has not merely been asked to."""
    return engine.wait(
        lambda s: s.step == step and branch in (None, s.branch) and not s.message.startswith("going"), PATIENCE
    )


def change(engine: Engine, **changes: Any) -> Settings:
    """Settings by name, from the next step on; dots in names are `__`."""
    return engine.put({name.replace("__", "."): value for name, value in changes.items()})
