"""Rerun while a session runs: a server on 127.0.0.1 that viewers may join at any time, and streams to it.

The server is Rerun's own program, a process of its own that also has the files of the web viewer.  Late viewers get
everything from its memory, up to a limit.  Viewers reach it through a `relay`, so that none of them can make the others
wait.  Nothing here waits for a viewer, and nothing for ever for the server: when that is ended, logging goes on without
effect.
"""

from __future__ import annotations

import os
import socket
import urllib.error
import urllib.parse
import urllib.request
from contextlib import ExitStack
from time import monotonic, sleep
from typing import TYPE_CHECKING

from app.recording.errors import RecordingError, RecordingLost
from app.recording.program import Program
from app.recording.relay import Relay
from app.recording.stream import FLUSH_LIVE, Stream

if TYPE_CHECKING:
    import rerun.blueprint as rrb

MEMORY = "256MB"
"""That the server keeps for viewers who come late; then it forgets the oldest, but nothing static."""

START_PATIENCE = 20.0
"""[s] that the server is given to start; it takes a tenth of a second."""

TRIES = 5
"""Somebody else may take a free port before the server does."""


def quiet() -> None:
    """Before Rerun is imported: it says on stderr what is raised here as `RecordingLost`."""
    os.environ.setdefault("RUST_LOG", "off")


class LiveHost:
    """The server and what leads to it.  Close it when all is over; whatever happens, it ends with this process."""

    def __init__(self, memory: str = MEMORY) -> None:
        quiet()
        said = ""
        for _ in range(TRIES):
            grpc, web = free_ports(2)
            self._program = Program(
                [
                    "--serve-web",
                    *("--bind", "127.0.0.1"),
                    *("--port", str(grpc), "--web-viewer-port", str(web)),
                    *("--server-memory-limit", memory),
                ]
            )
            if self._started(grpc, web):
                break
            said = self._program.said()
            self._program.close()
        else:
            raise RecordingError(f"Rerun's server does not start: {said or 'it says nothing'}")
        self._inner = address(grpc)
        self.files = f"http://127.0.0.1:{web}"
        """Where the files of the web viewer are."""
        self._relay = Relay(grpc)
        self.url = address(self._relay.port)
        """For viewers, as they want it: `rerun+http://127.0.0.1:<port>/proxy`."""
        self.origin = f"http://127.0.0.1:{self._relay.port}"
        """The same for a browser."""
        self.query = viewer_query(self.url)
        """What the address of the web viewer ends in, so that it shows this and nothing else."""

    def open(self, blueprint: rrb.Blueprint, name: str) -> Stream:
        """A new recording, which becomes the one that viewers show.  An `OpenStream`."""
        return LiveStream(self, blueprint, name)

    @property
    def alive(self) -> bool:
        """Whether the server runs."""
        return self._program.alive

    @property
    def cut_off(self) -> int:
        """Viewers whose connection was ended because they were too slow."""
        return self._relay.cut_off

    @property
    def inner(self) -> str:
        """For those who log."""
        return self._inner

    def open_native(self) -> Program:
        """Rerun's own window, joined to the server; it needs a display, and says so and ends if there is none."""
        (port,) = free_ports(1)  # the window listens, too
        return Program(["--connect", self.url, "--bind", "127.0.0.1", "--port", str(port), "--hide-welcome-screen"])

    def close(self) -> None:
        """End the server and all connections to it; a stream that waits for it does so no longer."""
        self._program.close()
        self._relay.close()

    def _started(self, grpc: int, web: int) -> bool:
        """Whether it is this program that listens on both ports: it ends by itself where it cannot."""
        until = monotonic() + START_PATIENCE
        while monotonic() < until and self._program.alive:
            if _answers(grpc) and _serves(web):
                sleep(0.02)  # one that found a port taken is about to end
                return self._program.alive
            sleep(0.01)
        return False


class LiveStream(Stream):
    """A recording that viewers see as it grows."""

    def __init__(self, host: LiveHost, blueprint: rrb.Blueprint, name: str) -> None:
        self._host = host
        self._told = False
        super().__init__(blueprint, name, FLUSH_LIVE)

    def begun(self) -> None:
        """Nothing: viewers come when they come."""

    def check(self) -> None:
        """`RecordingLost` if the server has ended; once."""
        if not self._host.alive and not self._told:
            self._told = True
            raise RecordingLost("Rerun's server has ended; the Rerun view shows nothing new")

    def close(self) -> None:
        """Send what is left; viewers keep showing it."""
        self._end()

    def _connect(self, blueprint: rrb.Blueprint) -> None:
        self._rec.connect_grpc(self._host.inner)
        self.show(blueprint)  # not as a default: a viewer that shows another recording already would keep that one's


def address(port: int) -> str:
    """Of a server on this machine, as Rerun writes it."""
    return f"rerun+http://127.0.0.1:{port}/proxy"


def viewer_query(url: str) -> str:
    """For the web viewer: what to open, and how to look."""
    return urllib.parse.urlencode({"url": url, "hide_welcome_screen": "1", "theme": "dark", "persist": "0"})


def free_ports(count: int) -> list[int]:
    """So many different ports of 127.0.0.1 on which nobody listens."""
    with ExitStack() as held:
        probes = [held.enter_context(socket.socket()) for _ in range(count)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1.0).close()
    except OSError:
        return False
    return True


def _serves(port: int) -> bool:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/favicon.ico", timeout=1.0):
            return True
    except (OSError, ValueError):
        return False
