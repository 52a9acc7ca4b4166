"""The panel without a browser: through viser's own handles, and as a client of its websocket."""

from __future__ import annotations

import http.client
import math
import time
from contextlib import suppress

import msgspec
import numpy as np
import pytest
import websockets.exceptions
import websockets.sync.client
import zstandard

from app import session
from app.live.engine import Engine
from app.live.settings import MOST
from app.live.trend import Trend
from app.panel.controls import filter_controls, noise_controls
from app.panel.panel import HEIGHT, SPEEDS, TALLEST, TRUNK, UNTIL, WIDEST, WIDTH, Panel, size_in
from scenarios.registry import build, worlds
from slam.estimators import ESTIMATORS
from tests.app.live import at, change

PATIENCE = 20.0


class Records:
    """What the panel sees of recordings."""

    def __init__(self):
        self.running = False
        self.names = []

    def start(self, name):
        if name == "bad":
            raise OSError(28, "No space left on device")
        self.names.append(name)
        self.running = True
        return f"recording to {name}.rrd"

    def stop(self):
        self.running = False
        return "saved"

    def describe(self):
        return f"running: {self.running}"


def make(source, keys=("dfs", "fs2", "fs1")):
    info = session.make_info(source, [ESTIMATORS[key] for key in keys], source.params(particles=50), seed=3)
    trend, records = Trend(), Records()
    engine = Engine(info, [trend])
    engine.start()
    return engine, Panel(engine, trend, records, list(worlds()), build), records


@pytest.fixture(scope="module")
def points():
    return build("paper-line")


@pytest.fixture
def live(points):
    engine, panel, records = make(points)
    yield engine, panel, records
    panel.close()
    engine.close(PATIENCE)


def soon(condition, patience=PATIENCE):
    until = time.monotonic() + patience
    while time.monotonic() < until:
        if condition():
            return
        time.sleep(0.02)
    raise AssertionError("not in time")


def bound(panel, name, slider=True):
    return next(
        b for b in panel.controls.bound if b.control.name == name and getattr(b.control, "slider", slider) == slider
    )


def press(button):
    button.value = True


def go(panel, what):
    panel.go.value = what


def test_every_parameter_that_may_change_has_a_control(points):
    walls = build("corridor", length=30.0)
    from dataclasses import fields

    from slam.types import Params

    names = {control.name for control in filter_controls(walls)}
    assert names == {field.name for field in fields(Params)} - {"believed"}
    assert {c.name for c in filter_controls(points)} == names - {
        "floor_lateral",
        "floor_angle",
        "merge_walls",
        "most_new",
        "orthogonal",
        "matching",
    }
    assert [c.name for c in noise_controls(points, "noise")] == [
        "noise.speed",
        "noise.turn",
        "noise.range",
        "noise.bearing",
    ]
    assert [c.name for c in noise_controls(walls, "believed")] == ["believed.odometry", "believed.range"]
    for control in [*filter_controls(walls), *noise_controls(walls, "noise"), *noise_controls(points, "noise")]:
        assert control.hint
        assert control.label


def test_every_number_and_word_reaches_the_desk(live):
    engine, panel, _ = live
    from app.panel.controls import Choice, Number, Switch, value_of

    for one in panel.controls.bound:
        control = one.control
        if isinstance(control, Number):
            value = control.low + 0.5 * (control.high - control.low)
            one.handle.value = round(value) if isinstance(control.step, int) else value
            expected = pytest.approx(one.handle.value * control.unit)
            soon(lambda c=control, e=expected: value_of(engine.desk.read(), c.name) == e)
        elif isinstance(control, Choice):
            for word in control.words:
                one.handle.value = word
                soon(lambda c=control, w=word: value_of(engine.desk.read(), c.name) == w)
        elif isinstance(control, Switch):
            one.handle.value = True
            soon(lambda c=control: value_of(engine.desk.read(), c.name) is True)


def test_the_belief_follows_the_world_until_the_link_is_cut(live):
    engine, panel, _ = live
    noise = bound(panel, "noise.range")
    noise.handle.value = 0.25
    settings = engine.desk.read()
    assert settings.noise.range == settings.params.believed.range == 0.25
    panel.link.value = False
    noise.handle.value = 0.125
    settings = engine.desk.read()
    assert (settings.noise.range, settings.params.believed.range) == (0.125, 0.25)
    bound(panel, "believed.bearing").handle.value = 2.0
    assert engine.desk.read().params.believed.bearing == pytest.approx(math.radians(2.0))
    assert engine.desk.read().noise.bearing != pytest.approx(math.radians(2.0))


@pytest.mark.parametrize("value", [10**9, -5, 10**300])
def test_numbers_beyond_their_limits_are_brought_back(live, value):
    engine, panel, _ = live
    handle = bound(panel, "particles").handle
    handle.value = value
    engine.step()
    at(engine, 1)
    K = engine.desk.read().params.particles
    assert (MOST if value > 0 else 1) == K
    soon(lambda: bound(panel, "particles", slider=False).handle.value == K)


def test_controls_follow_the_desk(live):
    engine, panel, _ = live
    change(engine, particles=230, resample_below=0.25, noise__range=0.125, resampler="residual", filters=("fs1", "ekf"))
    soon(lambda: bound(panel, "particles").handle.value == 230)
    soon(lambda: bound(panel, "resampler").handle.value == "residual")
    soon(lambda: bound(panel, "particles", slider=False).handle.value == 230)
    soon(lambda: bound(panel, "resample_below").handle.value == 0.25)
    soon(lambda: bound(panel, "noise.range").handle.value == 0.125)
    soon(lambda: [key for key, box in panel.filters.items() if box.value] == ["fs1", "ekf"])
    assert engine.desk.read().filters == ("fs1", "ekf")  # showing it has changed nothing


def test_the_transport(live):
    engine, panel, _ = live
    go(panel, "Step")
    at(engine, 1)
    press(panel.play)
    engine.wait(lambda s: s.playing and s.step >= 3)
    soon(lambda: panel.play.label == "Pause")
    press(panel.play)
    engine.wait(lambda s: not s.playing)
    soon(lambda: panel.play.label == "Play")
    for name in SPEEDS:
        panel.speed.value = name
    panel.until.value = "the next resampling"
    go(panel, "Run to event")
    status = engine.wait(lambda s: "resampled" in s.message or "ends here" in s.message)
    assert not status.playing
    soon(lambda: "resampled" in panel.message.content or "ends here" in panel.message.content)
    panel.speed.value = "at the speed of light"
    panel.until.value = "doomsday"
    go(panel, "Run to event")
    engine.wait(lambda s: "ends here" in s.message, PATIENCE)
    assert set(UNTIL) == set(panel.until.options)


def test_switching_filters(live):
    engine, panel, _ = live
    panel.filters["fs2"].value = False
    panel.filters["ekf"].value = True
    soon(lambda: engine.desk.read().filters == ("dfs", "fs1", "ekf"))
    go(panel, "Step")
    assert list(at(engine, 1).taken.step.filters) == ["dfs", "fs1", "ekf"]
    soon(lambda: "EKF-SLAM" in panel.table.content)
    for key in ("dfs", "fs1", "ekf"):
        panel.filters[key].value = False
    assert engine.desk.read().filters == ("ekf",)  # one is always on
    soon(lambda: panel.filters["ekf"].value is True)


def test_a_preset(live):
    engine, panel, _ = live
    panel.preset.value = "building"
    soon(lambda: engine.desk.read().params.inflate_r == 9.0)
    assert engine.desk.read().params.temper == 0.1
    panel.preset.value = "nothing of the kind"
    soon(lambda: bound(panel, "temper").handle.value == 0.1)


def test_time_travel_and_branches(live):
    engine, panel, _ = live
    engine.step(20)
    at(engine, 20)
    soon(lambda: panel.time.value == 20)
    panel.time.value = 7
    at(engine, 7)
    soon(lambda: "step **7**" in panel.headline.content)
    assert engine.status.newest == 20  # showing it has made nothing new
    go(panel, "Step back")
    at(engine, 6)
    bound(panel, "particles").handle.value = 90
    press(panel.branch)
    engine.wait(lambda s: s.branch == "6-particles-90")
    go(panel, "Step")
    status = at(engine, 7)
    assert len(status.taken.step.filters["dfs"].trace.weighted.s) == 90
    soon(lambda: f"**Beside {TRUNK}**, whose numbers at step 7 are in brackets" in panel.tree.content)
    mine, first = (panel._trend.at(branch, 7)["dfs"] for branch in ("6-particles-90", ""))
    error, n_eff = f"{mine.error:.3g} ({first.error:.3g})", f"{mine.n_eff:.0%} ({first.n_eff:.0%})"
    row = f"| Dual FastSLAM | {error} | {n_eff} | {mine.diversity:.0%} ({first.diversity:.0%}) |"
    assert row in panel.tree.content.splitlines()
    soon(lambda: tuple(panel.branches.options) == (TRUNK, "6-particles-90"))
    soon(lambda: panel.branches.value == "6-particles-90")
    panel.branches.value = TRUNK
    engine.wait(lambda s: s.branch == "" and s.step == 20)
    soon(lambda: "Beside" not in panel.tree.content)
    panel.branches.value = "no such branch"
    soon(lambda: panel.branches.value == TRUNK)
    panel.time.value = 3
    at(engine, 3)
    press(panel.newest)
    at(engine, 20)
    for beyond in (-4, 10**12):
        panel.time.value = beyond
    time.sleep(0.5)
    assert engine.alive
    assert 0 <= engine.status.step <= 20


def test_recording(live):
    _, panel, records = live
    panel.name.value = "my session"
    press(panel.record)
    soon(lambda: records.running and panel.record.label == "Stop recording")
    assert records.names == ["my session"]
    press(panel.record)
    soon(lambda: not records.running and panel.record.label == "Record")
    panel.name.value = "bad"
    press(panel.record)
    soon(lambda: "disk is full" in panel.message.content)
    assert not records.running


def test_reset_seed_and_world(live):
    engine, panel, _ = live
    engine.step(3)
    at(engine, 3)
    panel.seed.value = 11
    press(panel.reset)
    status = engine.wait(lambda s: s.number == 1)
    assert (status.info.seed, status.step) == (11, 0)
    press(panel.new_seed)
    assert engine.wait(lambda s: s.number == 2).info.seed == 12
    soon(lambda: panel._built == 2)
    panel.world.value = "corridor"
    press(panel.reset)
    status = engine.wait(lambda s: s.number == 3, PATIENCE)
    assert status.info.source.name == "corridor"
    soon(lambda: panel._built == 3)
    assert [b.control.name for b in panel.noise] == ["noise.odometry", "noise.range", "noise.missing"]
    panel.world.value = "../../etc/passwd"
    panel.seed.value = -3
    press(panel.reset)
    info = engine.wait(lambda s: s.number == 4).info
    assert (info.source.name, info.seed) == ("corridor", 0)


def test_in_the_same_world_the_page_is_not_built_anew(live):
    """Whoever clicks on New seed is not taken to another tab; the seed is that of the session."""
    engine, panel, _ = live
    seed, reset = panel.seed, panel.reset
    press(panel.new_seed)
    soon(lambda: panel._built == 1)
    assert panel.seed is seed
    assert seed.value == engine.status.info.seed == 4
    panel.mistake.value = "keep-first"
    engine.reset(mistake="plain-weights")  # by somebody else, as a script
    soon(lambda: panel._built == 2)
    soon(lambda: panel.mistake.value == "plain-weights")
    engine.reset(source=build("corridor", length=30.0))
    soon(lambda: panel._built == 3)
    assert panel.seed is not seed
    assert reset._impl.removed


@pytest.mark.parametrize(
    ("browser", "expected"),
    [
        ((580, 720), (WIDTH, HEIGHT)),
        ((760, 1080), (WIDEST, 594)),
        ((2500, 4000), (WIDEST, TALLEST)),
        ((0, 0), (WIDTH, HEIGHT)),
        ((700, 900), (700, 495)),
    ],
)
def test_the_controls_have_the_room_of_a_browser(browser, expected):
    assert size_in(*browser) == expected


def test_the_plots_have_what_the_trend_has(live):
    engine, panel, _ = live
    engine.step(5)
    at(engine, 5)
    soon(lambda: len(panel.plots._n_eff._handle.data[0]) == 5)
    steps, dfs, *_ = panel.plots._n_eff._handle.data
    np.testing.assert_array_equal(steps, [1, 2, 3, 4, 5])
    assert np.all((dfs > 0) & (dfs <= 1))


# As a client of the websocket --------------------------------------------------------------------------------------


class Client:
    """Speaks viser's wire format."""

    def __init__(self, port):
        self._socket = websockets.sync.client.connect(
            f"ws://127.0.0.1:{port}", subprotocols=["viser-v1.1.1"], max_size=None, compression=None
        )

    def send(self, message):
        self._socket.send(msgspec.msgpack.encode(message))

    def raw(self, data):
        self._socket.send(data)

    def camera(self):
        zeros = (0.0, 0.0, 0.0)
        self.send(
            {
                "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 10.0), "fov": 1.0,
                "near": 0.01, "far": 1000.0, "image_height": 100, "image_width": 100, "look_at": zeros,
                "up_direction": (0.0, 1.0, 0.0),
            }
        )  # fmt: skip

    def set(self, handle, value):
        self.send({"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": {"value": value}})

    def receive(self, timeout=5.0):
        data = self._socket.recv(timeout)
        if isinstance(data, bytes) and len(data) > 16:
            return zstandard.ZstdDecompressor().decompress(data[16:], max_output_size=1 << 26)
        return data

    def close(self):
        self._socket.close()


@pytest.fixture
def client(live):
    _, panel, _ = live
    made = Client(panel.port)
    made.camera()
    yield made
    made.close()


def test_a_client_changes_the_particles(live, client):
    engine, panel, _ = live
    client.set(bound(panel, "particles").handle, 500)
    soon(lambda: engine.desk.read().params.particles == 500)
    client.set(panel.go, "Step")
    assert len(at(engine, 1).taken.step.filters["dfs"].trace.weighted.s) == 500


def test_garbage_of_a_client_does_no_harm(live, client):
    engine, panel, _ = live
    particles = bound(panel, "particles").handle
    association = bound(panel, "association").handle
    for value in (10**15, -3, "x", None, [], {}, 1e308, True, "a" * 100_000):
        client.set(particles, value)
        client.set(association, value)
        client.set(panel.time, value)
        client.set(panel.branches, value)
        client.set(panel.filters["dfs"], value)
    client.send({"type": "GuiUpdateMessage", "uuid": "nobody", "updates": {"value": 3}})
    for handle in (particles, panel.time, panel.play):
        for updates in (
            {"nothing": 3},
            {"gui_api": None},
            {"update_cb": []},
            {"removed": True},
            {"value": 1, "label": 2},
        ):
            client.send({"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": updates})
    client.send({"type": "ShareUrlRequest"})
    time.sleep(0.5)
    for strange in ({"type": "NoSuchMessage"}, {}, [1, 2, 3], "x"):
        other = Client(panel.port)
        other.camera()
        other.send(strange)
        with suppress(websockets.exceptions.ConnectionClosed):  # the server may have had enough already
            other.raw(b"\x00\xff\x13garbage")
        time.sleep(0.05)
        other.close()
    assert 1 <= engine.desk.read().params.particles <= MOST
    assert engine.desk.read().params.association in ("nearest", "jcbb", "known")
    late = Client(panel.port)
    late.camera()
    late.set(particles, 60)
    soon(lambda: engine.desk.read().params.particles == 60)
    late.set(panel.go, "Step")
    at(engine, engine.status.step + 0) if engine.status.step else engine.wait(lambda s: s.step >= 1, PATIENCE)
    late.close()


@pytest.mark.parametrize(
    ("header", "value"),
    [("Origin", "https://evil.example"), ("Origin", "http://127.0.0.1:1"), ("Host", "evil.example")],
)
def test_pages_from_elsewhere_are_turned_away(live, header, value):
    _, panel, _ = live
    connection = http.client.HTTPConnection("127.0.0.1", panel.port, timeout=5.0)
    connection.request("GET", "/", headers={header: value})
    assert connection.getresponse().status == 403
    connection.request("GET", "/")
    assert connection.getresponse().status == 200
    connection.close()
    if header == "Origin":
        with pytest.raises(websockets.exceptions.InvalidStatus):
            websockets.sync.client.connect(
                f"ws://127.0.0.1:{panel.port}", subprotocols=["viser-v1.1.1"], origin=value, compression=None
            )


def test_fifty_clients(live):
    engine, panel, _ = live
    clients = [Client(panel.port) for _ in range(50)]
    for one in clients:
        one.camera()
    engine.play()
    engine.wait(lambda s: s.step >= 10, PATIENCE)
    clients[33].set(bound(panel, "particles").handle, 77)
    soon(lambda: engine.desk.read().params.particles == 77)
    assert clients[7].receive()
    for one in clients:
        one.close()
    engine.wait(lambda s: s.step >= 20, PATIENCE)


def test_a_client_that_reads_nothing_slows_nobody(live):
    engine, panel, _ = live
    frozen = Client(panel.port)
    frozen.camera()
    panel.speed.value = "as fast as possible"
    engine.play()
    engine.wait(lambda s: "ends here" in s.message, 60.0)
    frozen.close()


def test_a_slider_that_is_dragged_by_a_client(live, client):
    engine, panel, _ = live
    panel.speed.value = "as fast as possible"
    engine.play()
    handle = bound(panel, "particles").handle
    for i in range(200):
        client.set(handle, 10 + i)
    soon(lambda: engine.desk.read().params.particles == 209)
    engine.wait(lambda s: "ends here" in s.message, 60.0)
    soon(lambda: handle.value == 210 or handle.value == 209)
