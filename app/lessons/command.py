"""`dualslam lesson [NAME]`: from its options to its exit code."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from app import values
from app.errors import UsageError, listed, suggestion
from app.files import check_directory, write_whole
from app.interrupt import Interrupts
from app.lessons import LESSONS
from app.lessons.lesson import Lesson, Variant
from app.lessons.show import came_out, is_whole, print_list, print_numbers, print_text, verdict
from app.lessons.watching import Ran
from app.options import default
from app.report import ProgressBar
from app.types import Observer
from slam.limits import Interval

if TYPE_CHECKING:
    from app.recording.lesson import LessonRecorder


@dataclass(frozen=True)
class Teach:
    """Guided demonstrations: a question, runs that answer it, the answer in numbers, and the point.

    Without NAME a list of them. Example: dualslam lesson dual-idea --record dual-idea.rrd
    """

    name: Annotated[
        tyro.conf.Positional[str], values.word("NAME"), tyro.conf.arg(help_behavior_hint="(default: a list of all)")
    ] = ""
    """A lesson."""
    list: bool = False
    """Only say which lessons there are."""
    seed: Annotated[int, values.whole("--seed", "N", Interval(0))] = 0
    """Of all random numbers: same seed, same results."""
    record: Annotated[Path | None, values.path("--record", "FILE.rrd"), default("not written")] = None
    """All runs of the lesson with its text, for the Rerun viewer: rerun FILE.rrd."""
    out: Annotated[Path | None, values.path("--out", "DIR"), default("not written")] = None
    """Write NAME.md (the text, with what came out), NAME.rrd (the recording), and a summary of each run (JSON)."""
    live: bool = False
    """Open the workbench with the lesson instead: dualslam live."""
    no_browser: bool = False
    """With --live: only print the address."""

    def __call__(self, own: dict[str, str], command: str) -> int:
        """Teach; returns the exit code."""
        if own:
            raise UsageError(f"unknown option {next(iter(own))}; dualslam lesson --help lists them")
        out = Console(highlight=False)
        if self.no_browser and not self.live:
            raise UsageError("--no-browser is for the page of a lesson; expected --live beside it")
        if self.list or not self.name:
            if self.record or self.out or self.live:
                raise UsageError("lesson needs the NAME of a lesson for that (dualslam lesson --list)")
            print_list(LESSONS, out)
            return 0
        lesson = lesson_named(self.name)
        if self.live:
            return self._live(lesson)
        return Lecture(lesson, self.seed, self._files(lesson), out).give()

    def _files(self, lesson: Lesson) -> Files:
        if self.out is None:
            return Files(self.record)
        if self.record is not None:
            raise UsageError("--out writes a recording as well; expected --record or --out, not both")
        check_directory("--out", self.out)
        return Files(self.out / f"{lesson.name}.rrd", self.out)

    def _live(self, lesson: Lesson) -> int:
        from app.command import parse  # which knows this module
        from app.live.lessons import name_of

        if self.record is not None or self.out is not None:
            raise UsageError("--live has a button that records; expected no --record and no --out beside it")
        words = [*shlex.split(lesson.variants[0].options), "--seed", str(self.seed), "--paused"]
        words += ["--no-browser"] if self.no_browser else []
        workbench, own = parse(["live", *words])
        return workbench(own, shlex.join(["dualslam", "live", *words]), name_of(lesson, lesson.variants[0]))


def lesson_named(name: str) -> Lesson:
    """The lesson; `UsageError` if there is none of that name."""
    if name not in LESSONS:
        raise UsageError(f"there is no lesson {name!r}{suggestion(name, LESSONS)}; expected {listed(LESSONS)}")
    return LESSONS[name]


@dataclass(frozen=True)
class Files:
    """What a lesson writes."""

    record: Path | None = None
    folder: Path | None = None
    """For text and summaries."""

    def recorder(self, lesson: Lesson) -> LessonRecorder | None:
        """What writes the recording; `RecordingError` if that is impossible."""
        if self.record is None:
            return None
        from app.recording.lesson import LessonRecorder  # so does Rerun

        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
        return LessonRecorder(self.record, lesson.text())


class Lecture:
    """A lesson that is given: its text, its runs with a progress bar, and what came out."""

    def __init__(self, lesson: Lesson, seed: int, files: Files, out: Console) -> None:
        self._lesson = lesson
        self._seed = seed
        self._files = files
        self._out = out
        self._err = Console(stderr=True, highlight=False)
        self._runs: dict[str, Ran] = {}
        self._planned = 0
        """Steps of the run that is being made."""

    def give(self) -> int:
        """All of it; returns the exit code."""
        recorder = self._files.recorder(self._lesson)
        print_text(self._lesson.before(), self._out)
        stopped = False
        try:
            with Interrupts() as interrupts:
                try:
                    for variant in self._lesson.variants:
                        self._run(variant, recorder, interrupts)
                except KeyboardInterrupt:
                    stopped = True
                finally:
                    with interrupts.shield():
                        self._save(recorder)
        except KeyboardInterrupt:
            stopped = True
        self._tell(stopped)
        return 130 if stopped else 0

    def _run(self, variant: Variant, recorder: LessonRecorder | None, interrupts: Interrupts) -> None:
        from app.lessons.running import empty, info_of, run  # numba takes its time to load

        info = info_of(variant, self._seed)
        ran = self._runs[variant.name] = empty()
        self._planned = info.steps
        observers: list[Observer] = [ProgressBar(self._err)]
        if recorder is not None:
            recorder.next(variant.name)
            observers.insert(0, recorder)
        run(info, ran, observers, interrupts)

    def _begun(self) -> dict[str, Ran]:
        """Runs that have a step."""
        return {name: ran for name, ran in self._runs.items() if ran.summary.steps}

    def _save(self, recorder: LessonRecorder | None) -> None:
        """What there is, after an interruption too."""
        runs = self._begun()
        found = came_out(self._lesson, runs, self._seed) if is_whole(self._lesson, runs) else ""
        if recorder is not None:
            recorder.close(self._lesson.text(found=found))
        folder = self._files.folder
        if folder is not None and runs:
            from app.recording.writer import slug
            from app.summary import dump

            write_whole(folder / f"{self._lesson.name}.md", self._lesson.text(found=found))
            for name, ran in runs.items():
                write_whole(folder / f"{slug(name)}.json", dump(ran.summary.as_dict()))

    def _tell(self, stopped: bool) -> None:
        runs = self._begun()
        if runs:
            self._out.print()
            print_text("## What came out\n", self._out)
            print_numbers(self._lesson, runs, self._out)
            self._out.print()
            if is_whole(self._lesson, runs):
                sentence = verdict(self._lesson.phenomenon([runs]), self._seed)
                self._out.print(sentence, soft_wrap=not self._out.is_terminal, markup=False, style="bold")
        if stopped:
            last = list(self._runs)[-1] if self._runs else self._lesson.variants[0].name
            done = len(self._runs[last].summary.steps) if self._runs else 0
            saved = "; everything up to there is saved" if runs and self._files.record is not None else ""
            text = f"interrupted after {done} of {self._planned} steps of {last!r}{saved}"
            self._err.print(text, soft_wrap=True, markup=False)
            return
        self._out.print()
        print_text(self._lesson.after(), self._out)
        self._say_where()

    def _say_where(self) -> None:
        told: Sequence[str] = ()
        if self._files.record is not None:
            quoted = shlex.quote(str(self._files.record))
            told = [f"recording: {self._files.record}   (open it with: rerun {quoted})"]
        if self._files.folder is not None:
            told = [*told, f"text and summaries: {self._files.folder}"]
        for line in told:
            self._out.print(line, soft_wrap=True, markup=False)
