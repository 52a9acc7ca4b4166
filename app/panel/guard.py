"""viser behind a guard: what a page from elsewhere asks, and what no control sends, goes no further.

viser accepts every origin, opens a public tunnel for whoever asks, and lets a client set any attribute of a control.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server
from viser import _messages

_PATCHING = threading.Lock()


def guarded_server(host: str, port: int, label: str) -> viser.ViserServer:
    """A viser server that only pages from itself may talk to, or programs of this machine, which have no origin."""
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # what a client does wrong is its own affair
    with _PATCHING, _own_pages_only():
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    for tunnel in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(tunnel)
    original = server.gui._handle_gui_updates

    async def values_only(client_id: Any, message: Any) -> None:
        if isinstance(message.updates, dict) and set(message.updates) == {"value"}:
            await original(client_id, message)

    server._websock_server.unregister_handler(_messages.GuiUpdateMessage, original)
    server._websock_server.register_handler(_messages.GuiUpdateMessage, values_only)
    return server


@contextmanager
def _own_pages_only() -> Iterator[None]:
    """Servers that are started in here answer 403 to another Host (DNS rebinding) and to another Origin."""
    serve = websockets.asyncio.server.serve

    def guarded(handler: Any, host: Any, port: Any, *, process_request: Any = None, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            at = connection.local_address[1]
            hosts = {f"127.0.0.1:{at}", f"localhost:{at}"}
            origins = {None, *(f"http://{one}" for one in hosts)}
            if request.headers.get("Host") not in hosts or request.headers.get("Origin") not in origins:
                return connection.respond(HTTPStatus.FORBIDDEN, "")
            return process_request(connection, request) if process_request else None

        return serve(handler, host, port, process_request=check, **options)

    websockets.asyncio.server.serve = guarded  # type: ignore[assignment]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve
