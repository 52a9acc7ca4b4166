"""Between Rerun's server and its viewers.

The server waits for its slowest viewer: a browser tab that sleeps, or a process that is stopped, first holds up the
others and in the end whoever logs.  So viewers connect to this relay, which hands bytes on in both directions and ends
the connection of a viewer that takes none for a while, or that falls behind and stays behind.  A viewer that was cut
off may come back whenever it likes; the server then tells it everything again.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
from dataclasses import dataclass, field
from time import monotonic

CHUNK = 1 << 18
"""[bytes] that are read at once."""

WAITING = 1 << 23
"""[bytes] that may wait for one end of a connection; then the other end is not read."""

KERNEL = 1 << 18
"""[bytes] that the system may hold back for a viewer: with more it would seem to take what it does not."""

STUCK_AFTER = 10.0
"""[s] without taking a byte, although some wait."""

BEHIND_AFTER = 20.0
"""[s] during which more waited than may: what a slow machine is given for everything that happened before it came."""

CONNECTIONS = 64
"""That there may be at once; a browser with several tabs needs a few for each of them."""

CONNECT_PATIENCE = 5.0
"""[s] that the server is given to answer."""

LOOK_EVERY = 0.5
"""[s] at which slow viewers are looked for."""


@dataclass(eq=False)
class _End:
    """One end of a connection, and what waits for it."""

    socket: socket.socket
    waiting: bytearray = field(default_factory=bytearray)
    other: _End | None = None
    over: bool = False
    """It will send nothing more."""
    is_viewer: bool = False
    took_at: float = 0.0
    """[s] when it took something, or when nothing waited, last."""
    in_time_at: float = 0.0
    """[s] when no more than may waited, last."""


class Relay:
    """Listens on 127.0.0.1, on a free port, and connects whoever comes to the server on `server_port`."""

    def __init__(self, server_port: int, stuck_after: float = STUCK_AFTER, behind_after: float = BEHIND_AFTER) -> None:
        self._server = ("127.0.0.1", server_port)
        self._stuck_after, self._behind_after = stuck_after, behind_after
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=CONNECTIONS)
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self.cut_off = 0
        """Connections that were ended because the viewer was too slow."""
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._ends: dict[socket.socket, _End] = {}
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="relay", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all connections."""
        if not self._closing:
            self._closing = True
            self._wake.close()
            self._thread.join()

    def _run(self) -> None:
        look_at = monotonic() + LOOK_EVERY
        while not self._closing:
            for key, ready in self._selector.select(LOOK_EVERY):
                if key.fileobj is self._listener:
                    self._accept()
                elif isinstance(key.data, _End) and key.data.socket in self._ends:
                    self._serve(key.data, ready)
            if (now := monotonic()) >= look_at:
                look_at = now + LOOK_EVERY
                self._cut_off_the_slow(now)
        for end in list(self._ends.values()):
            self._drop(end)
        self._selector.close()
        for one in (self._listener, self._woken):
            one.close()

    def _accept(self) -> None:
        try:
            viewer, _ = self._listener.accept()
        except OSError:  # gone already, or there are too many open files
            return
        if len(self._ends) >= 2 * CONNECTIONS:
            viewer.close()
            return
        try:
            viewer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL)
            server = socket.create_connection(self._server, CONNECT_PATIENCE)  # on this machine: at once, or never
        except OSError:
            viewer.close()
            return
        ends = _End(viewer, is_viewer=True), _End(server)
        for end, other in (ends, ends[::-1]):
            end.socket.setblocking(False)
            end.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            end.other = other
            end.took_at = end.in_time_at = monotonic()
            self._ends[end.socket] = end
            self._selector.register(end.socket, selectors.EVENT_READ, end)

    def _serve(self, end: _End, ready: int) -> None:
        try:
            if ready & selectors.EVENT_WRITE:
                self._send(end)
            if ready & selectors.EVENT_READ:
                self._receive(end)
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:
            self._drop(end)
            return
        self._ask_again(end)

    def _receive(self, end: _End) -> None:
        assert end.other is not None
        data = end.socket.recv(CHUNK)
        if not data:
            end.over = True
            self._say_over(end.other)
            return
        other = end.other
        if not other.waiting:
            other.took_at = monotonic()
        other.waiting += data
        with contextlib.suppress(BlockingIOError):
            self._send(other)

    def _send(self, end: _End) -> None:
        while end.waiting:
            sent = end.socket.send(memoryview(end.waiting)[:CHUNK])
            del end.waiting[:sent]
            end.took_at = monotonic()
        self._say_over(end)

    def _say_over(self, end: _End) -> None:
        """Tell one end that the other has ended, when it has got everything."""
        assert end.other is not None
        if end.other.over and not end.waiting:
            if end.over:
                self._drop(end)
            else:
                end.socket.shutdown(socket.SHUT_WR)

    def _ask_again(self, end: _End) -> None:
        """For what each of the two ends is waited for."""
        for one in (end, end.other):
            if one is None or one.socket not in self._ends or one.other is None:
                continue
            full = len(one.other.waiting) > WAITING
            wanted = (selectors.EVENT_READ if not (one.over or full) else 0) | (
                selectors.EVENT_WRITE if one.waiting else 0
            )
            known = self._selector.get_map().get(one.socket)
            if not wanted:
                if known:
                    self._selector.unregister(one.socket)
            elif known is None:
                self._selector.register(one.socket, wanted, one)
            elif known.events != wanted:
                self._selector.modify(one.socket, wanted, one)

    def _cut_off_the_slow(self, now: float) -> None:
        for end in [end for end in self._ends.values() if end.is_viewer]:
            if not end.waiting:
                end.took_at = now
            if len(end.waiting) <= WAITING // 2:
                end.in_time_at = now
            if now - end.took_at > self._stuck_after or now - end.in_time_at > self._behind_after:
                self.cut_off += 1
                self._drop(end)

    def _drop(self, end: _End) -> None:
        for one in (end, end.other):
            if one is not None and self._ends.pop(one.socket, None):
                if one.socket in self._selector.get_map():
                    self._selector.unregister(one.socket)
                one.socket.close()
