"""`dualslam live [WORLD|LOG]`: the workbench in the browser, from its start to its end."""

from __future__ import annotations

import dataclasses
import os
import sys
import webbrowser
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic, sleep
from typing import Annotated, Any, Literal, get_args

from rich.console import Console

from app import values
from app.errors import UsageError, sentence
from app.interrupt import Interrupts
from app.live.settings import MOST
from app.options import default
from app.run import SessionOptions
from app.types import SessionInfo
from scenarios.logs.relations import Relations
from slam.limits import Interval

USUAL = "loop"
"""The world that is shown when nobody says which."""

ViewerName = Literal["web", "native", "none"]

PATIENCE = 30.0
"""[s] that everything may take to end."""

LOOK_EVERY = 0.2
"""[s] after which Ctrl-C takes effect at the latest."""

SWITCH = 5e-4
"""[s] after which a thread gives the interpreter to another one that waits: that of the filters waits for it less than
the usual five thousandths, each time that a kernel is done."""

PORTS = Interval(1024, 65535)


@dataclass(frozen=True)
class Live(SessionOptions):
    """The workbench: a running filter under your hands, on one page with Rerun's viewer.

    WORLD: a name (dualslam worlds) or a world file; loop, if none is given. LOG: the path of a real robot's log.

    It listens on 127.0.0.1, for this machine alone, and ends with Ctrl-C. Worlds have options of their own, such as
    --features or --laps: dualslam live WORLD --help.
    """

    viewer: Annotated[str, values.choice("--viewer", get_args(ViewerName))] = "web"
    """Rerun on the same page (web), in a window of its own (native), or not at all."""
    port: Annotated[int | None, values.whole("--port", "N", PORTS), default("a free one")] = None
    """Of the page."""
    no_browser: bool = False
    """Only print the address."""
    paused: bool = False
    """Do not start until somebody presses Play."""
    record: Annotated[Path | None, values.path("--record", "FILE.rrd"), default("not written")] = None
    """Record from the first step on; FILE.json beside it replays the session: dualslam run --replay FILE.json."""

    def __call__(self, own: dict[str, str], command: str, lesson: str = "") -> int:
        """Serve the page until somebody ends it, with the text of a lesson beside it (`app.live.lessons.NAMES`) if it
        is one; returns the exit code."""
        began = monotonic()
        out = Console(highlight=False)
        out.print("starting ...")
        options = self if self.source else dataclasses.replace(self, source=USUAL)
        info = options.info(own, command if self.source else f"{command} {USUAL}")
        if self.viewer == "native" and not _has_screen():
            raise UsageError("--viewer native needs a screen, and there is none; expected web or none")
        if info.params.particles > MOST:
            raise UsageError(f"--particles is {info.params.particles}; expected at most {MOST} on the page")
        relations = self.relations_to(info.source)
        for warning in (*info.source.warnings, *(relations.warnings if relations else ())):
            out.print(f"warning: {warning}", style="yellow", soft_wrap=True, markup=False)
        sys.setswitchinterval(SWITCH)
        with Interrupts() as interrupts, ExitStack() as stack:
            with interrupts.shield():
                workbench = Workbench(self, info, relations, out, stack, lesson)
            try:
                out.print(f"ready after {monotonic() - began:.1f} s: {workbench.url}", soft_wrap=True, markup=False)
                if not self.no_browser:
                    _open_browser(workbench.url, out)
                out.print("Ctrl-C ends it", soft_wrap=True)
                workbench.serve(interrupts, began)
            except KeyboardInterrupt:
                pass
            finally:
                with interrupts.shield():
                    workbench.end()
        return 0


class Workbench:
    """Everything that runs: the session, the panel, the page, viewers and files; what is opened goes on the stack."""

    def __init__(
        self,
        options: Live,
        info: SessionInfo,
        relations: Relations | None,
        out: Console,
        stack: ExitStack,
        lesson: str = "",
    ) -> None:
        from app.live import lessons
        from app.live.diagnoses import Diagnoses
        from app.live.engine import Engine, Listener
        from app.live.judge import Judge
        from app.live.page import Page, Viewer
        from app.live.publisher import VIEWER_STEPS, Publisher
        from app.live.records import Records
        from app.live.trend import Trend
        from app.panel.panel import Lessons, Panel
        from app.recording.live import LiveHost, quiet
        from app.recording.stream import FileStream, check_path
        from app.sources import LogParts, load
        from scenarios.registry import worlds

        quiet()
        from app.recording.session import SessionWriter

        self._out = out
        if options.record is not None:
            check_path(options.record)
        trend, diagnoses = Trend(), Diagnoses()
        listeners: list[Listener] = [trend, diagnoses]
        self._judge = None if relations is None else Judge(relations, info.source)
        if self._judge is not None:
            listeners.append(self._judge)
        self._publisher: Publisher | None = None
        viewer: Viewer | None = None
        host = None if options.viewer == "none" else LiveHost()
        if host is not None:
            stack.callback(host.close)
            to_viewers = SessionWriter(host.open, live=True, judge=self._judge)
            self._publisher = Publisher(to_viewers, "drop", VIEWER_STEPS)
            listeners.append(self._publisher)
            if options.viewer == "web":
                viewer = Viewer(host.files, host.origin, host.query)
        self.engine = Engine(info, listeners, playing=not options.paused)
        stack.callback(self.engine.close, PATIENCE)
        self.records = Records(
            self.engine,
            options.record.parent if options.record else Path(),
            # without an index, since nobody knows for how long
            lambda path: SessionWriter(partial(FileStream, path, index=False), judge=self._judge),
            check_path,
        )
        if options.record is not None:
            out.print(self.records.start_at(options.record), soft_wrap=True, markup=False)
        self.panel = Panel(
            self.engine,
            trend,
            self.records,
            list(worlds()),
            lambda name: load(name, {}, LogParts()),
            self._view,
            diagnoses,
            self._notes,
            lessons=Lessons(lessons.NAMES, lessons.open_lesson, lessons.text_of),
            lesson=lesson,
        )
        stack.callback(self.panel.close)
        self.page = Page(f"http://127.0.0.1:{self.panel.port}", viewer, options.port or 0)
        stack.callback(self.page.close)
        if host is not None and options.viewer == "native":
            stack.callback(host.open_native().close)
        self.engine.start()

    def _say(self, text: str) -> None:
        """On a terminal that may have been closed."""
        with suppress(OSError):
            self._out.print(text.replace("**", ""), soft_wrap=True, markup=False)

    def _notes(self) -> str:
        """What became of the stream to viewers, where it is not as it should be."""
        if self._publisher is not None and self._publisher.error:
            return f"**the Rerun view shows nothing new: {self._publisher.error}**"
        return ""

    def _view(self, server: Any) -> Any:
        """The top view, whose picks the session follows."""
        from app.panel.scene import TopView

        def picked(key: str, particle: int) -> None:
            if view.pick is not None:
                self.engine.pick(key, particle, view.pick.where.step)

        view = TopView(server, picked, self.engine.unpick, self._judge)
        return view

    @property
    def url(self) -> str:
        """Of the page."""
        return self.page.url

    def serve(self, interrupts: Interrupts, began: float) -> None:
        """Until an interruption; `began` is when the command did."""
        from app.live.engine import COMPILING

        told, shown = False, self._publisher is None
        while True:
            interrupts.check()
            if not told and self.engine.status.message == COMPILING:
                told = True
                self._out.print(COMPILING, soft_wrap=True)
            if not shown and self._publisher is not None and self._publisher.published:
                shown = True
                self._out.print(f"the first step is shown after {monotonic() - began:.1f} s", soft_wrap=True)
            self.records.keep()
            sleep(LOOK_EVERY)

    def end(self) -> None:
        """Save everything, and say so."""
        self._say("ending ...")
        self.engine.pause()
        if self.records.running:
            self._say(self.records.stop())
        self.engine.close(PATIENCE)
        if self._publisher is not None:
            self._publisher.join(PATIENCE)


def _has_screen() -> bool:
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _open_browser(url: str, out: Console) -> None:
    """Open it where there is a screen."""
    try:
        if _has_screen() and webbrowser.open(url):
            return
    except (OSError, webbrowser.Error) as error:
        out.print(f"no browser could be opened ({sentence(error)})", soft_wrap=True, markup=False)
        return
    out.print("no screen here: open the address in a browser", soft_wrap=True)
