"""Between the session and whoever takes time: a queue, and a thread that empties it.

Viewers lose steps when they are slow, oldest first, and never make anybody wait.  A file loses none: when its queue is
full the session waits for the disk, but not for ever.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from time import monotonic
from typing import Any, Literal

from app.errors import sentence
from app.live.engine import Begun, Forked, Listener, Stepped

VIEWER_STEPS = 8
"""That wait for a viewer at most."""

FILE_STEPS = 256
"""That wait for a file at most."""

DISK_PATIENCE = 30.0
"""[s] that a session waits for a disk before it gives the recording up."""


class Publisher:
    """A `Listener` that hands everything on to another one, in a thread of its own."""

    def __init__(
        self, to: Listener, full: Literal["drop", "wait", "grow"], steps: int, patience: float = DISK_PATIENCE
    ) -> None:
        self._to = to
        self._full = full
        self._most = steps
        self._patience = patience
        self._items: deque[tuple[str, Any]] = deque()
        self._steps = 0
        self._changed = threading.Condition()
        self._over = False
        self.dropped = 0
        """Steps that nobody had the time for."""
        self.published = 0
        """Steps that were handed on."""
        self.seconds = 0.0
        """[s] of this thread that the handing on took."""
        self.error = ""
        """Why it does not go on; a sentence."""
        self._thread = threading.Thread(target=self._run, name="publisher", daemon=True)
        self._thread.start()

    def begun(self, begun: Begun) -> None:
        """A session has begun."""
        self._put("begun", begun)

    def forked(self, forked: Forked) -> None:
        """It goes on as another branch."""
        self._put("forked", forked)

    def stepped(self, stepped: Stepped) -> None:
        """It has made a new step."""
        self._put("stepped", stepped)

    def closed(self) -> None:
        """It is over."""
        self._put("closed", None)

    def release(self) -> None:
        """Nobody is to wait any more for what takes time, although the queue grows."""
        with self._changed:
            self._full = "grow"
            self._changed.notify_all()

    def join(self, patience: float) -> bool:
        """Wait until everything is handed on; whether it is."""
        self._thread.join(patience)
        return not self._thread.is_alive()

    @property
    def waiting(self) -> int:
        """Steps that are not yet handed on."""
        return self._steps

    def _put(self, what: str, item: Any) -> None:
        with self._changed:
            if self._over:
                return
            if what == "stepped":
                self._make_room()
                if self._over:
                    return
                self._steps += 1
            self._items.append((what, item))
            self._changed.notify_all()

    def _make_room(self) -> None:
        if self._steps < self._most or self._full == "grow":
            return
        if self._full == "wait":
            room = self._changed.wait_for(
                lambda: self._steps < self._most or self._over or self._full == "grow", self._patience
            )
            if not room:
                self._give_up(f"nothing could be written for {self._patience:g} s")
            return
        oldest = next((i for i, (what, _) in enumerate(self._items) if what == "stepped"), None)
        if oldest is None:  # the only one is being handed on
            return
        del self._items[oldest]
        self._steps -= 1
        self.dropped += 1

    def _give_up(self, reason: str) -> None:
        self.error, self._over = reason, True
        self._items.clear()
        self._items.append(("closed", None))
        self._steps = 0

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._items))
                what, item = self._items.popleft()
            began = monotonic()
            self._hand_on(what, item)
            with self._changed:
                if what == "stepped" and self._steps:
                    self._steps -= 1
                    self.published += not self.error
                    self.seconds += monotonic() - began
                if what == "closed":
                    self._over = True
                self._changed.notify_all()
                if self._over and not self._items:
                    return

    def _hand_on(self, what: str, item: Any) -> None:
        tell: dict[str, Callable[[], None]] = {
            "begun": lambda: self._to.begun(item),
            "forked": lambda: self._to.forked(item),
            "stepped": lambda: self._to.stepped(item),
            "closed": self._to.closed,
        }
        if self.error and what != "closed":
            return
        try:
            tell[what]()
        except Exception as error:
            with self._changed:
                if not self.error:
                    self._give_up(sentence(error))
