"""The one page: the panel on the left, Rerun's web viewer on the right, served on 127.0.0.1 only.

The files of the web viewer come from Rerun's own server and pass through here, so that the browser can be told to load
nothing from anywhere else, and so that the page hears of it when the viewer is cut off.
"""

from __future__ import annotations

import errno
import http.client
import json
import re
import secrets
import socket
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from string import Template
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from app.errors import UsageError, sentence

PATIENCE = 10.0
"""[s] that a browser may take to ask or to take, and that Rerun's server may take to answer."""

CHUNK = 1 << 18
"""[bytes]"""

VIEWER_FILES = {
    "": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
    "apple-touch-icon.png": "image/png",
}
"""What the web viewer consists of."""

ADDED_TO_VIEWER = """<script>
{ // The viewer is to ask nobody outside, and the page that holds this frame is told when the stream of data ends.
  const load = window.fetch.bind(window);
  const lost = () => window.parent.postMessage("rerun-lost", window.location.origin);
  const watched = (body) => {
    const reader = body.getReader();
    return new ReadableStream({
      async pull(to) {
        try {
          const { done, value } = await reader.read();
          if (done) { lost(); to.close(); } else to.enqueue(value);
        } catch (error) { lost(); to.error(error); }
      },
      cancel: (reason) => reader.cancel(reason),
    });
  };
  window.fetch = async (what, how) => {
    const to = new URL(what?.url ?? what, window.location);
    if (to.protocol.startsWith("http") && to.hostname !== "127.0.0.1" && to.hostname !== window.location.hostname)
      return new Response(null, { status: 204 });
    if (!to.pathname.endsWith("MessageProxyService/ReadMessages")) return load(what, how);
    try {
      const answer = await load(what, how);
      return new Response(watched(answer.body), answer);
    } catch (error) { lost(); throw error; }
  };
}
</script>"""
OUTSIDE = re.compile(rb"<link\b[^>]*https?://[^>]*>")
"""Fonts of the web viewer that would come from elsewhere; it has others."""


class Viewer(NamedTuple):
    """Where the page finds Rerun."""

    files: str
    """Address of the server that has the files of the web viewer."""
    origin: str
    """Address of the server that has the data, as a browser sees it: `http://127.0.0.1:<port>`."""
    query: str
    """What tells the web viewer where the data is, and how to look."""


class Page:
    """Serves the page until it is closed, in a thread of its own."""

    def __init__(self, panel: str, viewer: Viewer | None = None, port: int = 0) -> None:
        """`panel` is the address of the panel.  Without a viewer it has the page to itself.  Port 0 is a free one.

        A port that cannot be had is a `UsageError`.
        """
        self._server = _open(port)
        self._server.content = _Content(panel, viewer, self._server.server_port)
        self.port: int = self._server.server_port
        self.url = f"http://127.0.0.1:{self.port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name="page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Serve no longer, and free the port."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class _Content:
    """What is served."""

    def __init__(self, panel: str, viewer: Viewer | None, port: int) -> None:
        self.viewer = viewer
        self._panel = panel
        self.hosts = {f"{name}{at}" for name in ("127.0.0.1", "localhost") for at in (f":{port}", *[""] * (port == 80))}
        self._run = secrets.token_hex(8)
        """Another one for each start, so that a page that was left open notices."""
        settings = {"run": self._run, "panel": panel, "view": f"rerun/?{viewer.query}" if viewer else None}
        text = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
        encoded = json.dumps(settings).replace("<", "\\u003c")
        self.page = Template(text.replace("${", "$${")).substitute(SETTINGS=encoded).encode()
        self.page_policy = _policy(
            {
                "script-src": "'unsafe-inline'",
                "style-src": "'unsafe-inline'",
                "img-src": "data:",
                "connect-src": "'self'",
                "frame-src": f"'self' {_origin(panel)}",
                "frame-ancestors": "'none'",
            }
        )
        self.viewer_policy = _policy(
            {
                "script-src": "'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:",
                "worker-src": "'self' blob:",
                "style-src": "'self' 'unsafe-inline'",
                "img-src": "'self' data: blob:",
                "font-src": "'self' data:",
                "connect-src": f"'self' data: blob: {viewer.origin if viewer else ''}",
                "frame-ancestors": "'self'",
            }
        )

    def alive(self) -> bytes:
        """Whether those answer whom the page shows."""
        view = _answers(self.viewer.files) if self.viewer else None
        return json.dumps({"run": self._run, "panel": _answers(self._panel), "view": view}).encode()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = 64
    content: _Content

    def server_bind(self) -> None:
        """Without asking the name servers what this machine is called."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = "127.0.0.1", int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that went away is no news."""


class _Handler(BaseHTTPRequestHandler):
    timeout = PATIENCE
    server_version = "dualslam"
    sys_version = ""

    @property
    def content(self) -> _Content:
        """What is served."""
        assert isinstance(self.server, _Server)
        return self.server.content

    def do_GET(self) -> None:
        """Answer."""
        content = self.content
        if self.headers.get("Host", "").lower() not in content.hosts:  # a name that somebody made lead here
            self._refuse(HTTPStatus.FORBIDDEN)
            return
        path = urlsplit(self.path).path
        if path == "/":
            self._answer(content.page, "text/html; charset=utf-8", content.page_policy)
        elif path == "/alive":
            self._answer(content.alive(), "application/json")
        elif content.viewer and path.startswith("/rerun/") and path.removeprefix("/rerun/") in VIEWER_FILES:
            self._pass_on(content.viewer, path.removeprefix("/rerun/"))
        else:
            self._refuse(HTTPStatus.NOT_FOUND)

    do_HEAD = do_GET

    def refuse_method(self) -> None:
        """There is nothing to change here."""
        self._refuse(HTTPStatus.METHOD_NOT_ALLOWED)

    do_POST = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_TRACE = do_CONNECT = refuse_method

    def log_message(self, format: str, *args: Any) -> None:
        """Nobody wants to read this."""

    def _pass_on(self, viewer: Viewer, name: str) -> None:
        kind, policy = VIEWER_FILES[name], self.content.viewer_policy
        inner = http.client.HTTPConnection(urlsplit(viewer.files).netloc, timeout=PATIENCE)
        try:
            try:
                inner.request("GET", f"/{name}")
                answer = inner.getresponse()
                size = int(answer.headers.get("rerun-final-length") or answer.headers["Content-Length"])
            except (OSError, http.client.HTTPException, KeyError, ValueError, TypeError):
                self._refuse(HTTPStatus.BAD_GATEWAY)
                return
            if answer.status != HTTPStatus.OK:
                self._refuse(HTTPStatus.BAD_GATEWAY)
            elif not name:
                start = answer.read().replace(b"<head>", b"<head>" + ADDED_TO_VIEWER.encode(), 1)
                self._answer(OUTSIDE.sub(b"", start), kind, policy)
            else:
                self._begin(HTTPStatus.OK, kind, size, policy, {"rerun-final-length": str(size)})
                while self.command != "HEAD" and (data := answer.read(CHUNK)):
                    self.wfile.write(data)
        finally:
            inner.close()

    def _answer(self, body: bytes, kind: str, policy: str = "default-src 'none'") -> None:
        self._begin(HTTPStatus.OK, kind, len(body), policy)
        if self.command != "HEAD":
            self.wfile.write(body)

    def _refuse(self, status: HTTPStatus) -> None:
        body = f"{status.value} {status.phrase}\n".encode()
        allowed = {"Allow": "GET, HEAD"} if status is HTTPStatus.METHOD_NOT_ALLOWED else {}
        self._begin(status, "text/plain; charset=utf-8", len(body), "default-src 'none'", allowed)
        if self.command != "HEAD":
            self.wfile.write(body)

    def _begin(
        self, status: HTTPStatus, kind: str, size: int, policy: str, others: dict[str, str] | None = None
    ) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(size),
            "Content-Security-Policy": policy,
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
        }
        for name, value in (headers | (others or {})).items():
            self.send_header(name, value)
        self.end_headers()


def _open(port: int) -> _Server:
    try:
        return _Server(("127.0.0.1", port), _Handler)
    except OverflowError:
        raise UsageError(f"--port {port} is no port; expected 0 to 65535") from None
    except OSError as error:
        reason = (
            "is taken by another program" if error.errno == errno.EADDRINUSE else f"cannot be had: {sentence(error)}"
        )
        raise UsageError(f"--port {port} {reason}; leave it out, and a free one is found") from None


def _policy(rules: dict[str, str]) -> str:
    """What a page may load, and nothing else."""
    everything = {"default-src": "'none'", "base-uri": "'none'", "form-action": "'none'"} | rules
    return "; ".join(f"{what} {where}".strip() for what, where in everything.items())


def _origin(address: str) -> str:
    parts = urlsplit(address)
    return f"{parts.scheme}://{parts.netloc}"


def _answers(address: str) -> bool:
    """Whether somebody listens there."""
    parts = urlsplit(address)
    try:
        socket.create_connection((parts.hostname or "127.0.0.1", parts.port or 80), 1.0).close()
    except OSError:
        return False
    return True
