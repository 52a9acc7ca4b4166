"""The panel: builds the page, carries out what people ask for, and shows how things stand.

Callbacks run in viser's threads and only pass things on.  One thread of the panel's own shows the status, at most
`RATE` times a second, so that neither a fast filter nor a slow browser makes the other wait.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import monotonic, time
from typing import Any, NamedTuple, Protocol

import rich
import viser

from app.errors import sentence
from app.live.diagnoses import NOTHING, Diagnoses, Place, Teller, Told
from app.live.engine import Engine, Status
from app.live.trend import Trend
from app.options import FILTERS, MISTAKES, PRESETS
from app.panel import now
from app.panel.camera import SHARE
from app.panel.controls import REST, Controls, filter_controls, noise_controls, preset_changes
from app.panel.descent import Ancestry
from app.panel.guard import guarded_server
from app.types import SessionInfo
from scenarios.types import Source
from scenarios.words import counted
from slam.estimators import ESTIMATORS

RATE = 8.0
"""[1/s]"""

WIDTH, HEIGHT = 580, 410
"""[px] of the controls at least, at the lower edge; the picture is above them."""

WIDEST, TALLEST = 760, 1200
"""[px] of the controls at most, in a browser that has room for more."""

SAID = 10.0
"""[s] that the page says what came of something."""

LABEL = "Dual FastSLAM workbench"

SPEEDS: dict[str, float | None] = {
    "1 step/s": 1.0,
    "2 steps/s": 2.0,
    "5 steps/s": 5.0,
    "10 steps/s": 10.0,
    "20 steps/s": 20.0,
    "50 steps/s": 50.0,
    "as fast as possible": None,
}
USUAL_SPEED = "10 steps/s"

UNTIL = {
    "the next resampling": ("resampled",),
    "the next depletion": ("depleted",),
    "the next loop closure": ("loop closed",),
    "lost association": ("association lost",),
    "overconfidence": ("overconfident",),
    "a duplicate in a map": ("duplicate born",),
    "any of these": ("depleted", "loop closed", "association lost", "overconfident", "duplicate born"),
}

NO_PICK = "Click a particle in the picture to see all about it. Drag zooms into a rectangle, the right button moves."

STEP, BACK, RUN_TO = "Step", "Step back", "Run to event"

NO_PRESET, NO_LESSON, NO_MISTAKE = "-", "-", "none"

NO_STEP, NEWEST_STEP = "-", "the newest"
"""Of the steps that a diagnosis names none, and none of them."""

TRUNK = "the first run"
"""What people call the branch without a name."""

MOST_SEED = 2**53 - 1


NEVER: tuple[Any, ...] = ()
"""What the page shows before it shows anything."""


class Records(Protocol):
    """What the panel needs of recording to files."""

    def start(self, name: str) -> str:
        """Record from now on under this name; a sentence on where."""
        ...

    def stop(self) -> str:
        """Stop and save; a sentence on what is where."""
        ...

    @property
    def running(self) -> bool:
        """Whether something is being recorded."""
        ...

    def describe(self) -> str:
        """Markdown: what is recorded, how large it is, what went wrong."""
        ...


class Lessons(NamedTuple):
    """What the panel needs of lessons."""

    names: Sequence[str]
    """Of all their runs."""
    open: Callable[[str, int], SessionInfo]
    """The session of one of them, with this seed."""
    text: Callable[[str], Sequence[tuple[str, str]]]
    """Pieces of Markdown, each with the HTML that follows it."""


class View(Protocol):
    """The panel's own scene."""

    trail: Any
    """A `Listener` that has the whole path, where only some of the steps are shown."""

    def reset(self, info: Any) -> None:
        """Another session."""
        ...

    def show(self, status: Status) -> None:
        """The step where the session stands."""
        ...

    def describe_pick(self, status: Status) -> str:
        """Markdown on the particle that somebody chose; empty for none."""
        ...

    def describe_relations(self) -> str:
        """Markdown on how well the paths fit relations; empty without."""
        ...

    def layers(self, info: Any) -> Sequence[str]:
        """What can be shown or hidden of a session."""
        ...

    def visible(self, layer: str, on: bool) -> None:
        """Show or hide a layer."""
        ...

    def is_visible(self, layer: str) -> bool:
        """Whether it is shown."""
        ...

    def fit(self) -> None:
        """Show the whole map in all browsers."""
        ...


class Panel:
    """A viser server with the controls of an engine."""

    def __init__(
        self,
        engine: Engine,
        trend: Trend,
        records: Records,
        worlds: Sequence[str],
        open_world: Callable[[str], Source],
        view: Callable[[viser.ViserServer], View] | None = None,
        diagnoses: Diagnoses | None = None,
        notes: Callable[[], str] = lambda: "",
        host: str = "127.0.0.1",
        port: int = 0,
        lessons: Lessons | None = None,
        lesson: str = "",
    ) -> None:
        self._lessons = lessons
        self._lesson = lesson
        """The one whose text is shown; empty for none."""
        self._engine = engine
        self._trend = trend
        self._records = records
        self._worlds = list(worlds)
        self._open_world = open_world
        rich.get_console().quiet = True  # viser says there where it listens, and when it stops
        self.server = guarded_server(host, port, LABEL)
        self._gui = self.server.gui
        self._gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        self._gui.main_panel.float(x=0, y=-1, width=WIDTH, height=HEIGHT)
        self._gui.set_panel_label(LABEL)
        self.server.on_client_connect(_place)
        self._view = view(self.server) if view else None
        if self._view is not None:
            engine.add(self._view.trail)
        self._notes = notes
        """What is to be said beside where the session stands."""
        self._link = True
        self._speed = USUAL_SPEED
        self._said, self._said_at = "", 0.0
        """What came of something that was asked for, and when."""
        self._shown = NEVER
        self._built = -1
        """Which session it is about (`Status.number`)."""
        self._source, self._taught = engine.status.info.source, lesson
        """The world and the lesson that it was built for."""
        self._parts: list[Any] = []
        """What it is made of, the outermost only."""
        self._own = threading.local()
        self._closing = threading.Event()
        self._wake = threading.Event()
        self._teller = None if diagnoses is None else Teller(diagnoses, self._wake.set)
        self.engine_speed()
        self._build(engine.status)
        self._thread = threading.Thread(target=self._run, name="panel", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return self.server.get_port()

    def engine_speed(self) -> None:
        """Have the engine go at the speed that the page shows."""
        self._engine.speed(SPEEDS[self._speed])

    def close(self) -> None:
        """Stop showing, and the server."""
        self._closing.set()
        self._wake.set()
        self._thread.join(5.0)
        if self._teller is not None:
            self._teller.close()
        self.server.stop()

    # --- Building ---------------------------------------------------------------------------------------------------

    def _build(self, status: Status) -> None:
        """The whole page, for the world that the session is in."""
        gui, source = self._gui, status.info.source
        while self._parts:  # and not all at once, by which viser would put the panel elsewhere
            self._parts.pop().remove()
        self.controls = Controls(gui, self._put, self._engine.desk.read)
        self.headline = gui.add_markdown(now.headline(status))
        self._build_transport()
        self.message = gui.add_markdown(now.message(status))
        tabs = gui.add_tab_group()
        if self._lessons is not None and self._lesson:
            with tabs.add_tab("Lesson"):
                for markdown, html in self._lessons.text(self._lesson):
                    gui.add_markdown(markdown)
                    if html:
                        gui.add_html(html)
        with tabs.add_tab("Now"):
            self.table = gui.add_markdown(now.table(status))
            self.plots = now.Plots(gui)
        with tabs.add_tab("Diagnosis"):
            self._build_diagnosis()
        with tabs.add_tab("Ancestry"):
            self.ancestry = Ancestry(gui)
        with tabs.add_tab("Run"):
            self._build_run(status)
        with tabs.add_tab("Noise"):
            self._build_noise(source)
        with tabs.add_tab("Filter"):
            self._build_filter(source, status)
        with tabs.add_tab("Time"):
            self._build_travel(status)
        with tabs.add_tab("Record"):
            self._build_record()
        with tabs.add_tab("View"):
            self._build_view(status)
        self._parts += [self.headline, self.play, self.go, self.message, tabs]
        self._built, self._source, self._taught = status.number, source, self._lesson
        if self._view is not None:
            self._view.reset(status.info)

    def _begin_again(self, status: Status) -> None:
        """Another session in the same world: nobody is taken to another tab."""
        _set(self.seed, "value", min(status.info.seed, MOST_SEED))
        _set(self.mistake, "value", status.info.mistake or NO_MISTAKE)
        self._built = status.number
        if self._view is not None:
            self._view.reset(status.info)

    def _build_transport(self) -> None:
        gui, engine = self._gui, self._engine
        self.play = gui.add_button("Play", hint="Go on, or stop after the step that is being made.", color="green")
        self.play.on_click(lambda _: engine.pause() if engine.status.playing else engine.play())
        self.go = gui.add_button_group("one at a time", (STEP, BACK, RUN_TO))
        self.go.on_click(lambda _: self._go(self.go.value))

    def _build_diagnosis(self) -> None:
        gui = self._gui
        self.named: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "look at step", [NO_STEP], hint="Go to one of the steps that are named below, or back to the newest."
        )
        self.named.on_update(lambda _: self._look_at_named())
        self.diagnosis = gui.add_markdown(NOTHING)

    def _build_noise(self, source: Source) -> None:
        gui = self._gui
        if source.kind == "world":
            with gui.add_folder("The world is"):
                self.noise = self.controls.add(noise_controls(source, "noise"))
            self.link = gui.add_checkbox("the belief follows the world", self._link, hint="Change both together.")
            self.link.on_update(lambda _: setattr(self, "_link", bool(self.link.value)))
        else:
            gui.add_markdown("A log has its noise already; only what the filters believe of it can be changed.")
            self.noise = []
        with gui.add_folder("The filter believes"):
            self.believed = self.controls.add(noise_controls(source, "believed"))

    def _build_filter(self, source: Source, status: Status) -> None:
        gui = self._gui
        self.filters = {}
        with gui.add_folder("Which filters run"):
            for key in FILTERS:
                box = gui.add_checkbox(
                    ESTIMATORS[key].title, key in status.settings.filters, hint=ESTIMATORS[key].reference
                )
                box.on_update(lambda event: self._set_filter(event.target))
                self.filters[key] = box
        self.preset = gui.add_dropdown("preset", (NO_PRESET, *PRESETS), hint="A set of parameters that go together.")
        self.preset.on_update(lambda _: self._set_preset())
        self.parameters = self.controls.add(filter_controls(source))

    def _build_travel(self, status: Status) -> None:
        gui, engine = self._gui, self._engine
        gui.add_markdown("Go back to any step, change anything, and run on: that is a branch.")
        self.time = gui.add_slider("step", 0, max(status.total, 1), 1, status.step, hint="Where the session stands.")
        self.time.on_update(lambda _: self._travel(self.time.value))
        self.newest = gui.add_button("To the newest step")
        self.newest.on_click(lambda _: engine.go_newest())
        self.branch = gui.add_button("Branch from here", hint="With the settings as they are now.", color="orange")
        self.branch.on_click(lambda _: engine.fork())
        self.branches: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "branch", [TRUNK], hint="Which run is looked at."
        )
        self.branches.on_update(lambda _: self._set_branch())
        self.tree = gui.add_markdown("")

    def _build_record(self) -> None:
        gui = self._gui
        self.name = gui.add_text("name", "session", hint="Of the file; letters, digits, dots and dashes.")
        self.record = gui.add_button("Record", hint="Write everything from the next step on to a file.", color="red")
        self.record.on_click(lambda _: self._toggle_recording())
        self.recorded = gui.add_markdown(self._records.describe())

    def _build_run(self, status: Status) -> None:
        gui = self._gui
        self.speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value=self._speed, hint="Steps in a second.")
        self.speed.on_update(lambda _: self._set_speed())
        self.until = gui.add_dropdown("run to", tuple(UNTIL), hint="Where 'Run to event' stops.")
        name = status.info.source.name
        words = tuple(dict.fromkeys((name, *self._worlds)))
        self.world = gui.add_dropdown("world", words, initial_value=name, hint="Where the robot drives, after Reset.")
        if self._lessons is not None:
            self.lesson: viser.GuiDropdownHandle[str] = gui.add_dropdown(
                "lesson",
                (NO_LESSON, *self._lessons.names),
                initial_value=self._lesson or NO_LESSON,
                hint="A world with a question and an answer, after Reset.",
            )
        self.mistake = gui.add_dropdown(
            "mistake",
            (NO_MISTAKE, *MISTAKES),
            initial_value=status.info.mistake or NO_MISTAKE,
            hint="A classic one, made on purpose after Reset, in the filters in which one can make it.",
        )
        self.seed = gui.add_number(
            "seed",
            min(status.info.seed, MOST_SEED),
            min=0,
            max=MOST_SEED,
            step=1,
            hint="Of all random numbers: same seed, same run.",
        )
        self.reset = gui.add_button("Reset", hint="Begin again, in the chosen world and with this seed.")
        self.reset.on_click(lambda _: self._reset())
        self.new_seed = gui.add_button("New seed", hint="Begin again with the next seed.")
        self.new_seed.on_click(lambda _: self._engine.reset(seed=(self._engine.status.info.seed + 1) % MOST_SEED))

    def _build_view(self, status: Status) -> None:
        gui = self._gui
        self.pick = gui.add_markdown(NO_PICK)
        self.whole = gui.add_button("Whole map", hint="See everything again, after zooming.")
        self.whole.on_click(lambda _: self._view.fit() if self._view else None)
        self.layers = {}
        with gui.add_folder("What the picture shows"):
            for layer in self._view.layers(status.info) if self._view else ():
                box = gui.add_checkbox(layer, self._view.is_visible(layer) if self._view else True)
                box.on_update(lambda event: self._set_layer(event.target))
                self.layers[layer] = box

    # --- What people ask for: in viser's threads --------------------------------------------------------------------

    def _put(self, changes: dict[str, Any]) -> None:
        if self._link:
            for name, value in list(changes.items()):
                group, _, field = name.rpartition(".")
                if group == "noise":
                    changes[f"believed.{field}"] = value
        self._engine.put(changes)
        self._wake.set()

    def _go(self, what: Any) -> None:
        if what == STEP:
            self._engine.step()
        elif what == BACK:
            self._travel(self._engine.status.step - 1)
        elif what == RUN_TO:
            self._engine.play(UNTIL.get(self.until.value, ()))

    def _set_speed(self) -> None:
        if self.speed.value in SPEEDS:
            self._speed = self.speed.value
            self.engine_speed()

    def _set_filter(self, box: Any) -> None:
        if getattr(self._own, "busy", False):
            return
        for key, own in self.filters.items():
            if own is box:
                others = [other for other in self._engine.desk.read().filters if other != key]
                self._engine.put({"filters": [*others, key] if box.value is True else others})

    def _set_preset(self) -> None:
        if self.preset.value in PRESETS:
            self._engine.put(preset_changes(self.preset.value, self._engine.status.info.source))

    def _set_branch(self) -> None:
        if getattr(self._own, "busy", False):
            return
        name = "" if self.branches.value == TRUNK else self.branches.value
        if name != self._engine.status.branch:
            self._engine.to_branch(name)

    def _set_layer(self, box: Any) -> None:
        if self._view is not None:
            layer = next((layer for layer, own in self.layers.items() if own is box), None)
            if layer is not None:
                self._view.visible(layer, box.value is True)

    def _travel(self, step: Any) -> None:
        if getattr(self._own, "busy", False):
            return
        if isinstance(step, int | float) and not isinstance(step, bool):
            self._engine.go(int(min(max(step, 0), self._engine.status.newest)))

    def _look_at_named(self) -> None:
        if getattr(self._own, "busy", False):
            return
        if self.named.value == NEWEST_STEP:
            self._engine.go_newest()
        elif self.named.value in self.named.options and self.named.value != NO_STEP:
            self._travel(int(self.named.value))

    def _toggle_recording(self) -> None:
        name = self.name.value if isinstance(self.name.value, str) else ""
        self._try(lambda: self._records.stop() if self._records.running else self._records.start(name))

    def _reset(self) -> None:
        def reset() -> str:
            status, seed = self._engine.status, self.seed.value
            given = isinstance(seed, int | float) and not isinstance(seed, bool)
            number = int(min(max(seed, 0), MOST_SEED)) if given else status.info.seed
            if self._begins_lesson(number):
                return ""
            other = self.world.value != status.info.source.name and self.world.value in self._worlds
            mistake = self.mistake.value if self.mistake.value in MISTAKES else ""
            self._engine.reset(number, self._open_world(self.world.value) if other else None, mistake)
            if other:
                self._lesson = ""
            return ""

        self._try(reset)

    def _begins_lesson(self, seed: int) -> bool:
        """Begin the lesson that is chosen, if it is another one than before; whether that is so."""
        if self._lessons is None or self.lesson.value == self._lesson:
            return False
        if self.lesson.value not in self._lessons.names:
            self._lesson = ""
            return False
        info = self._lessons.open(self.lesson.value, seed)
        self._lesson = self.lesson.value
        self._engine.begin(info)
        return True

    def _told(self) -> bool:
        """Whether the page still says what came of something that was asked for."""
        return bool(self._said) and monotonic() - self._said_at < SAID

    def _try(self, what: Callable[[], str]) -> None:
        """Do it, and have the page say what came of it."""
        try:
            self._said = what()
        except Exception as error:
            self._said = sentence(error)
        self._said_at = monotonic()
        self._shown = NEVER
        self._wake.set()

    # --- Showing: in the panel's own thread -------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._closing.is_set():
            self._wake.wait(1.0 / RATE)
            self._wake.clear()
            try:
                self._refresh()
            except Exception as error:  # the page must not stand still because of one number
                self._said, self._said_at = sentence(error), monotonic()
            self._closing.wait(1.0 / RATE)

    def _refresh(self) -> None:
        status = self._engine.status
        recorded = self._records.describe()
        if status.number != self._built:
            same = self._source is status.info.source and self._taught == self._lesson
            (self._begin_again if same else self._build)(status)
        if self._view is not None:
            self._view.show(status)
        pick = self._view.describe_pick(status) if self._view is not None else ""
        judged = self._view.describe_relations() if self._view is not None else ""
        self.controls.show(status.settings)  # always: one that somebody was at is left for later
        self._own.busy = True
        shows = [(box, key in status.settings.filters) for key, box in self.filters.items()]
        for handle, value in [*shows, (self.time, status.step)]:
            if time() - handle.update_timestamp > REST:
                _set(handle, "value", value)
        self._own.busy = False
        place = Place(status.number, status.branch, status.step)
        told = self._teller.told(place, status.playing) if self._teller is not None else None
        shown = (status.changed, recorded, self._told(), pick, judged, told)
        if shown == self._shown and not status.playing:
            return
        self._shown = shown
        self._own.busy = True
        try:
            with self.server.atomic():
                self._show(status, recorded, pick, judged, told)
        finally:
            self._own.busy = False

    def _show(self, status: Status, recorded: str, pick: str, judged: str, told: Told | None) -> None:
        notes = self._notes()
        _set(self.headline, "content", now.headline(status) + (f" - {notes}" if notes else ""))
        _set(self.message, "content", now.bold(self._said) if self._told() else now.message(status))
        _set(self.table, "content", f"{now.table(status)}\n\n{judged}" if judged else now.table(status))
        _set(self.play, "label", "Pause" if status.playing else "Play")
        names = tuple(name or TRUNK for name, *_ in status.branches)
        if tuple(self.branches.options) != names:
            self.branches.options = names
        _set(self.branches, "value", status.branch or TRUNK)
        beside = now.beside_parent(status, self._trend, TRUNK)
        _set(self.tree, "content", f"{_tree(status)}\n\n{beside}" if beside else _tree(status))
        _set(self.record, "label", "Stop recording" if self._records.running else "Record")
        _set(self.recorded, "content", recorded)
        _set(self.pick, "content", pick or NO_PICK)
        self.plots.show(self._trend.of(status.branch, status.step), now.knows_truth(status.info))
        if told is not None:
            _set(self.diagnosis, "content", told.text)
            steps = (NO_STEP, *map(str, told.steps), NEWEST_STEP)
            if tuple(self.named.options) != steps:
                self.named.options = steps
            if self.named.value != str(status.step):  # it can be chosen again
                _set(self.named, "value", NO_STEP)
        self.ancestry.show(status)


def _place(client: viser.ClientHandle) -> None:
    """Give the controls of a browser that comes the room that it has; later a person may drag them as they like."""
    with suppress(AssertionError, TypeError, ValueError, OverflowError):  # it has told nonsense
        width, height = size_in(client.camera.image_width, client.camera.image_height)
        client.gui.main_panel.float(x=0, y=-1, width=width, height=height)


def size_in(width: float, height: float) -> tuple[int, int]:
    """[px] of the controls, in a browser that has so many; the picture keeps its share of the height."""
    return max(WIDTH, min(round(width), WIDEST)), max(HEIGHT, min(round((1.0 - SHARE) * height), TALLEST))


def _set(handle: Any, name: str, value: Any) -> None:
    """Only if it is something else: whatever is set is sent to everybody."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def _tree(status: Status) -> str:
    lines = []
    for name, parent, at, done in status.branches:
        here = " **(here)**" if name == status.branch else ""
        origin = f", left {parent or TRUNK} after step {at}" if name else ""
        lines.append(f"- {name or TRUNK}: {counted(done, 'step')}{origin}{here}")
    return "\n".join(lines)
