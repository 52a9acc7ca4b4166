"""The page, Rerun's server and the relay between: on 127.0.0.1 only, whole, and gone when they should be."""

from __future__ import annotations

import contextlib
import http.client
import os
import signal
import socket
import subprocess
import sys
import threading
from time import monotonic, sleep

import numpy as np
import pytest

from app import session
from app.errors import UsageError
from app.live.page import Page, Viewer
from app.recording.errors import RecordingLost
from app.recording.live import LiveHost, free_ports
from app.recording.relay import STUCK_AFTER, Relay
from app.types import SessionInfo
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from tests.app.browser import DRAWN_AFTER, browser, picture, watched
from tests.app.sockets import family, listening
from tests.app.viewer import pixels, required_viewer, share_drawn

STEPS = 6
SOON = 10.0
"""[s]"""


@pytest.fixture
def host():
    host = LiveHost()
    yield host
    host.close()


@pytest.fixture
def page(host):
    page = Page("http://127.0.0.1:9/panel", Viewer(host.files, host.origin, host.query))
    yield page
    page.close()


def info(seed: int = 1, particles: int = 20) -> SessionInfo:
    source = build("paper-line")
    filters = [ESTIMATORS[key] for key in ("dfs", "fs2")]
    params = source.params(particles=particles, association="known")
    return session.make_info(source, filters, params, seed=seed, count=STEPS)


def write(writer, info: SessionInfo) -> None:
    for step in session.steps(info):
        writer.step(step)


def until(condition, patience: float = SOON) -> bool:
    limit = monotonic() + patience
    while monotonic() < limit:
        if condition():
            return True
        sleep(0.05)
    return False


def ask(page: Page, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=SOON)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), body


def test_nobody_beyond_this_machine_is_listened_to(page):
    found = listening(os.getpid())
    assert {address for address, _ in found} == {"127.0.0.1"}
    assert ("127.0.0.1", page.port) in found
    assert len(found) == 4  # the page, the relay, and Rerun's server with its two


def test_the_page_shows_panel_and_viewer(page, host):
    status, headers, body = ask(page, "/")
    assert status == 200
    assert b'"panel": "http://127.0.0.1:9/panel"' in body
    assert f'"view": "rerun/?{host.query}"'.encode() in body
    assert b"$SETTINGS" not in body
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "frame-src 'self' http://127.0.0.1:9;" in headers["Content-Security-Policy"]
    assert ask(page, "/?anything=else")[0] == 200


def test_without_a_viewer_the_panel_has_the_page_to_itself():
    page = Page("http://127.0.0.1:9/")
    try:
        assert b'"view": null' in ask(page, "/")[2]
        assert ask(page, "/rerun/")[0] == 404
        assert ask(page, "/alive")[2].endswith(b'"panel": false, "view": null}')
    finally:
        page.close()


def test_the_viewer_comes_whole_and_leads_nowhere_else(page):
    status, headers, start = ask(page, "/rerun/?url=something")
    assert status == 200
    assert b"rerun-lost" in start
    assert b"<link" in start
    assert b"fonts.googleapis" not in start
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    status, headers, program = ask(page, "/rerun/re_viewer_bg.wasm")
    assert (status, headers["Content-Type"]) == (200, "application/wasm")
    assert program[:4] == b"\0asm"
    assert len(program) == int(headers["Content-Length"]) > 1e7
    assert ask(page, "/rerun/re_viewer.js")[0] == 200


@pytest.mark.parametrize("path", ["/etc/passwd", "/rerun", "/rerun/../page.py", "/rerun/%2e%2e/", "/.", "/page.html"])
def test_there_is_nothing_else(page, path):
    assert ask(page, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
def test_there_is_nothing_to_change(page, method):
    status, headers, _ = ask(page, "/", method)
    assert (status, headers["Allow"]) == (405, "GET, HEAD")


def test_a_head_has_no_body(page):
    for path in ("/", "/rerun/", "/rerun/re_viewer_bg.wasm"):
        status, headers, body = ask(page, path, "HEAD")
        assert (status, body) == (200, b"")
        assert int(headers["Content-Length"]) > 1000


@pytest.mark.parametrize("name", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "127.0.0.1:1"])
def test_a_name_that_leads_here_by_somebody_elses_will_is_refused(page, name):
    assert ask(page, "/", Host=name)[0] == 403
    assert ask(page, "/", Host=f"localhost:{page.port}")[0] == 200


def test_garbage_is_survived_in_silence(page, capfd):
    for bytes_sent in (b"\0\xff\n\n", b"GET / HTTP/9.9\r\n\r\n", b"GET /" + b"a" * 70000 + b"\r\n\r\n", b""):
        with socket.create_connection(("127.0.0.1", page.port), SOON) as one:
            one.sendall(bytes_sent)
    assert ask(page, "/")[0] == 200
    assert capfd.readouterr().err == ""


def test_fifty_at_once(page):
    held = [socket.create_connection(("127.0.0.1", page.port), SOON) for _ in range(50)]  # that never say anything
    assert ask(page, "/")[0] == 200
    for one in held:
        one.close()


def test_a_busy_port_is_one_sentence():
    with socket.create_server(("127.0.0.1", 0)) as somebody:
        port = somebody.getsockname()[1]
        with pytest.raises(UsageError, match=f"^--port {port} is taken by another program; [^\n]*$"):
            Page("http://127.0.0.1:9/", port=port)
    Page("http://127.0.0.1:9/", port=port).close()
    Page("http://127.0.0.1:9/", port=port).close()
    with pytest.raises(UsageError, match="--port 70000 is no port"):
        Page("http://127.0.0.1:9/", port=70000)


def test_closing_frees_everything():
    before = listening(os.getpid()), family(os.getpid()), threading.active_count()
    host = LiveHost()
    page = Page("http://127.0.0.1:9/", Viewer(host.files, host.origin, host.query))
    began = monotonic()
    page.close()
    host.close()
    host.close()
    assert monotonic() - began < 2.0
    assert (listening(os.getpid()), family(os.getpid()), threading.active_count()) == before


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_nothing_is_left_behind_whichever_way_it_ends(how):
    program = "from app.recording.live import LiveHost; host = LiveHost(); print(host.files, flush=True); input()"
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    port = int(process.stdout.readline().rpartition(":")[2])
    all_of_it = family(process.pid)
    assert len(all_of_it) >= 3
    process.send_signal(how)
    process.communicate()
    assert until(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in all_of_it))
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), 1.0)


def test_free_ports_differ():
    assert len(set(free_ports(20))) == 20


def test_a_taken_port_is_never_anybody_elses_server(monkeypatch):
    """Somebody takes a port between the search and the start: another is found, or it says so."""
    with socket.create_server(("127.0.0.1", 0)) as somebody:
        taken = somebody.getsockname()[1]
        answers = [[taken, *free_ports(1)], [*free_ports(1), taken], free_ports(2)]
        monkeypatch.setattr("app.recording.live.free_ports", lambda _: answers.pop(0))
        host = LiveHost()
        assert not answers
        assert str(taken) not in (host.files + host.inner)
        host.close()


def test_a_server_that_ends_is_told_once(host):
    from app.recording.writer import Writer

    writer, run = Writer(info(), host.open), info()
    host._program.close()
    assert not host.alive
    with pytest.raises(RecordingLost, match="server has ended"):
        write(writer, run)
    began = monotonic()
    write(writer, run)  # has no effect, and does no harm
    writer.close()
    assert monotonic() - began < SOON


def test_a_late_viewer_gets_everything_and_follows(host):
    from app.recording.writer import Writer

    first = Writer(info(), host.open)
    write(first, info())
    viewer = required_viewer(host.url)
    try:
        assert viewer.timelines() == {"step", "sim_time", "stage"}
        assert until(lambda: viewer.last_step() == STEPS)
        front = [view for view in viewer.views() if view.view_id in viewer.in_front()]
        drawing = next(view for view in front if view.name.startswith("Map:"))
        assert share_drawn(viewer.screenshot(drawing)) > 0.001

        branch = first.fork(info(), "7 particles, as a test")
        write(branch, info())
        assert until(lambda: any(view.origin == "/branch/7-particles-as-a-test/world" for view in viewer.views()))
        sleep(1.0)
        assert not {view.name: view.reports for view in viewer.views() if view.reports}

        second = Writer(info(seed=2), host.open)  # after a reset
        write(second, info(seed=2))
        assert until(lambda: viewer.active() == 1)
        assert until(lambda: not any("branch" in view.origin for view in viewer.views()))
    finally:
        viewer.__exit__()
    first.close()
    second.close()


def talk(port: int) -> socket.socket:
    """A viewer as the server knows it: a browser that asks for everything."""
    viewer = socket.create_connection(("127.0.0.1", port), SOON)
    viewer.sendall(
        b"POST /rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages HTTP/1.1\r\nHost: 127.0.0.1\r\n"
        b"Content-Type: application/grpc-web+proto\r\nX-Grpc-Web: 1\r\nContent-Length: 5\r\n\r\n\0\0\0\0\0"
    )
    return viewer


def test_a_frozen_tab_makes_nobody_wait(host):
    """It takes nothing, for much longer than anything buffers; another one gets all, and logging does not notice."""
    import rerun as rr
    import rerun.blueprint as rrb

    stream = host.open(rrb.Blueprint(), "much")
    port = int(host.origin.rpartition(":")[2])
    frozen, awake = talk(port), talk(port)
    awake.settimeout(SOON)
    got, rng, slowest = 0, np.random.default_rng(1), 0.0

    def read() -> None:
        nonlocal got
        with contextlib.suppress(OSError):
            while data := awake.recv(1 << 20):
                got += len(data)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    rows, rate = 60_000, 30
    for i in range(int((STUCK_AFTER + 5.0) * rate)):  # 22 MB/s, far more than any session makes
        stream.set_time(i)
        points = rng.random((rows, 3), dtype=np.float32)
        began = monotonic()
        stream.log("much", rr.Points3D(points))
        slowest = max(slowest, monotonic() - began)
        sleep(1.0 / rate)
    sleep(1.0)
    assert host.cut_off == 1
    assert slowest < 2.0
    assert got > 0.9 * i * rows * 12
    frozen.close()
    awake.close()
    stream.close()


class Echo:
    """A server that sends back what it gets."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while True:
            try:
                one, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(one,), daemon=True).start()

    def _serve(self, one: socket.socket) -> None:
        try:
            while data := one.recv(1 << 16):
                one.sendall(data)
            one.sendall(b"the end")
        except OSError:
            pass
        one.close()

    def close(self) -> None:
        self._listener.close()


@pytest.fixture
def echo():
    echo = Echo()
    yield echo
    echo.close()


def test_the_relay_changes_nothing(echo):
    relay = Relay(echo.port)
    sent = np.random.default_rng(1).bytes(30_000_000)
    with socket.create_connection(("127.0.0.1", relay.port), SOON) as one:
        threading.Thread(target=lambda: (one.sendall(sent), one.shutdown(socket.SHUT_WR)), daemon=True).start()
        got = bytearray()
        while data := one.recv(1 << 20):
            got += data
    assert bytes(got) == sent + b"the end"
    assert relay.cut_off == 0
    relay.close()


def test_the_relay_ends_with_its_server(echo):
    relay = Relay(free_ports(1)[0])
    with socket.create_connection(("127.0.0.1", relay.port), SOON) as one:
        assert one.recv(1) == b""
    relay.close()
    relay = Relay(echo.port)
    one = socket.create_connection(("127.0.0.1", relay.port), SOON)
    one.sendall(b"x")
    assert one.recv(1) == b"x"
    relay.close()
    assert one.recv(1) == b""
    one.close()


def test_the_page_in_a_browser(host, tmp_path):
    import viser

    from app.recording.blueprint import PAGE_ASPECT
    from app.recording.writer import Writer

    panel = viser.ViserServer("127.0.0.1", 0, verbose=False)
    panel.gui.add_button("Step")
    address = f"http://127.0.0.1:{panel.get_port()}"
    page = Page(f"{address}/", Viewer(host.files, host.origin, host.query))
    writer = Writer(info(), host.open, PAGE_ASPECT)
    write(writer, info())
    try:
        with browser() as chromium:
            tab = chromium.new_page(viewport={"width": 1280, "height": 720})
            asked, errors = watched(tab)
            tab.goto(page.url)
            assert tab.title() == "Dual FastSLAM, live"
            button = tab.frame_locator("#panel iframe").get_by_role("button", name="Step")
            button.wait_for(timeout=1e3 * DRAWN_AFTER)
            assert until(lambda: share_drawn(picture(tab, "#view")) > 0.15, DRAWN_AFTER)
            assert until(lambda: coloured(picture(tab, "#view")) > 30, DRAWN_AFTER)
            assert tab.locator("#panel").bounding_box()["width"] >= 500
            assert not tab.locator("#status").is_visible()

            tab.locator("#divider").focus()
            before = tab.locator("#panel").bounding_box()["width"]
            tab.keyboard.press("ArrowRight")
            assert tab.locator("#panel").bounding_box()["width"] == before + 20

            outside = {one for one in asked if one.startswith("http") and not one.startswith("http://127.0.0.1:")}
            assert not outside
            assert not errors
            port = page.port
            page.close()
            page = Page(f"{address}/", Viewer(host.files, host.origin, host.query), port)  # started again
            with tab.expect_event("domcontentloaded", timeout=1e3 * DRAWN_AFTER):
                pass

            host.close()
            tab.locator("#status").get_by_text("Rerun's server has ended").wait_for(timeout=1e3 * DRAWN_AFTER)
    finally:
        writer.close()
        page.close()
        panel.stop()


def coloured(png: bytes) -> int:
    """Pixels in about the colour of Dual FastSLAM: what a run has drawn."""
    return int((np.abs(pixels(png).astype(int) - (230, 159, 0)).max(axis=2) < 40).sum())
