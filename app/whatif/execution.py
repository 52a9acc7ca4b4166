"""One question from its first step to its answer: both ways are run, checked, counted, recorded and told of."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from app.compare.table import filter_table
from app.errors import UsageError
from app.files import is_stdout, write_whole
from app.interrupt import Interrupts
from app.report import ProgressBar, print_whole
from app.session import interruptible
from app.summary import dump
from app.types import SessionStep
from app.whatif.fork import Made, Plan, made
from app.whatif.former import Former
from app.whatif.numbers import Tallies, side_by_side, spreads_of, title
from app.whatif.output import as_dict, spread_table, with_titles
from app.whatif.words import UNTOLD, on_luck, question, sentences

if TYPE_CHECKING:
    from app.recording import Recorder


class Execution:
    """One question, from its steps to its answer."""

    def __init__(
        self, plan: Plan, recorder: Recorder | None, summary: Path | None, warnings: list[str], command: str
    ) -> None:
        self._plan = plan
        self._recorder = recorder
        self._summary = summary
        self._warnings = warnings
        self._command = command
        self._tallies = Tallies(plan)
        self._branch: Callable[[SessionStep], None] | None = None
        self._apart = False
        """Whether the run was found to be another one than the recorded."""
        self._refused = False
        """Whether that was before the fork: then there is no answer, and nothing worth a recording."""
        self._recorded = 0
        """Steps that were given to the recorder."""
        self._err = Console(stderr=True, highlight=False)

    def run(self) -> int:
        """Returns the exit code."""
        warnings, self._warnings = self._warnings, []
        for warning in warnings:
            self._warn(warning)
        try:
            with Interrupts() as interrupts:
                self._run(interrupts)
        except KeyboardInterrupt:
            saved = self._answer()
            done = f"{self._tallies.done} of {self._plan.last - self._plan.first + 1} steps after the change"
            self._err.print(f"interrupted after {done}{'; what there is is saved' if saved else ''}", soft_wrap=True)
            return 130
        except BrokenPipeError:
            raise
        except Exception:  # what was found until then is not lost
            self._answer()
            raise
        self._answer()
        return 0

    def _run(self, interrupts: Interrupts) -> None:
        info, bar = self._plan.info, ProgressBar(self._err)
        bar.begin(info._replace(steps=self._plan.work))
        former: Former | None = None
        try:
            if self._recorder is not None:
                with interrupts.shield():
                    former = self._begin(self._recorder)
            for count, one in enumerate(interruptible(made(self._plan), interrupts), 1):
                with interrupts.shield():
                    self._take(one)
                    bar.step(dataclasses.replace(one.step, index=count))
        finally:
            with interrupts.shield():
                bar.end()
                self._end(former)

    def _begin(self, recorder: Recorder) -> Former:
        """Open the recording; what it writes over."""
        former = Former(recorder.path)
        try:
            recorder.begin(self._plan.info)
        except BaseException:  # nothing was written
            former.forget()
            raise
        return former

    def _end(self, former: Former | None) -> None:
        """Complete the recording, unless it is of no use: then all is as it was before."""
        if self._recorder is None or former is None:
            return
        try:
            self._recorder.end()
        finally:
            if self._useful:
                former.forget()
            else:
                former.restore()

    @property
    def _useful(self) -> bool:
        """Whether there is something in the recording that anybody could want."""
        return self._recorded > 0 and not self._refused

    def _take(self, one: Made) -> None:
        """One more step."""
        if one.draw == 0:
            if not one.changed:
                self._check(one.step)
            self._record(one)
        self._tallies.add(one)

    def _record(self, one: Made) -> None:
        if self._recorder is None:
            return
        self._recorded += 1
        if not one.changed:
            self._recorder.step(one.step)
            return
        if self._branch is None:
            name = f"{self._plan.first}-{title(self._plan).replace('=', '-')}"
            self._branch = self._recorder.fork(self._plan.changed_info, name)
        self._branch(one.step)

    def _check(self, step: SessionStep) -> None:
        """That it is the run that was recorded."""
        departure = self._plan.origin.recorded.departure(step)
        if departure is None:
            return
        if not departure.small and step.index < self._plan.first:
            self._refused = True
            raise UsageError(self._plan.origin.apart(departure))
        if not self._apart:
            self._apart = True
            self._warn(self._plan.origin.differs(departure))

    def _warn(self, text: str) -> None:
        self._warnings.append(text)
        self._err.print(f"warning: {text}", style="yellow", soft_wrap=True, markup=False)

    def _answer(self) -> bool:
        """Say and save what there is; whether anything is saved."""
        if self._tallies.done:
            self._say()
        if self._useful and self._recorder is not None:
            path = self._recorder.path
            self._print(f"recording: {path}   (open it with: rerun {shlex.quote(str(path))})")
        return self._useful or (self._summary is not None and self._tallies.done > 0)

    def _say(self) -> None:
        found = with_titles(side_by_side(self._tallies), self._plan.info)
        spreads = spreads_of(self._tallies)
        count = len(self._tallies.others())
        said = [question(self._plan), *sentences(found, self._plan.first)]
        luck = on_luck(spreads, found, count) if spreads else [UNTOLD]
        if self._summary is not None:
            told = as_dict(found, spreads, self._tallies, self._warnings, [*said, *luck], self._command)
            write_whole(self._summary, dump(told))
        self._print(*said)
        for one in found.filters:
            self._print("")
            print_whole(self._out, filter_table(one, found))
        if spreads:
            self._print("", f"with {count} other random numbers after step {self._plan.first - 1}, median and range:")
        for one in found.filters if spreads else ():
            self._print("")
            print_whole(self._out, spread_table(one, spreads[one.key], count))
        self._print("", *luck)
        if self._summary is not None:
            self._print(f"summary: {self._summary}")

    @property
    def _out(self) -> Console:
        return self._err if is_stdout(self._summary) else Console(highlight=False)  # JSON is not mixed with a table

    def _print(self, *lines: str) -> None:
        for line in lines:
            self._out.print(line, soft_wrap=True, markup=False)
