"""`dualslam whatif FILE.rrd --from STEP --set NAME=VALUE`: from its options to its exit code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from app import values
from app.errors import UsageError
from app.options import Outputs, default
from slam.limits import Interval

if TYPE_CHECKING:
    from app.recording import Recorder
    from app.whatif.fork import Plan
    from app.whatif.origin import Origin

MUST = "(must be given)"


@dataclass(frozen=True)
class WhatIf:
    """Run a recorded session again from one of its steps, with other parameters, and show both.

    FILE.rrd is made by: dualslam run WORLD|LOG --record FILE.rrd, or on the page of dualslam live. A branch of a live
    session, or a run of a lesson, is FILE.rrd#BRANCH. Up to the step, and without the change after it, the run is the
    recorded one, bit for bit, which is checked. World and random numbers are the same for both.

    Example: dualslam whatif loop.rrd --from 143 --set particles=500 --seeds 10
    """

    recording: Annotated[tyro.conf.Positional[str], values.word("FILE.rrd"), tyro.conf.arg(help_behavior_hint="")] = ""
    """A recording, or a branch of one."""
    first: Annotated[
        int | None, values.whole("--from", "STEP", Interval(1)), tyro.conf.arg(name="from", help_behavior_hint=MUST)
    ] = None
    """The first step with other parameters."""
    changes: Annotated[
        tyro.conf.UseAppendAction[tuple[Annotated[tuple[str, ...], values.words("NAME=VALUE")], ...]],
        tyro.conf.arg(name="set", help_behavior_hint=MUST),
    ] = ()
    """A parameter, by its name on the command line of a run: particles=500, believed.range=0.01, association=nearest,
    merge-walls=on. Several, or this option several times. noise.range and the like are what the world is."""
    steps: Annotated[int | None, values.whole("--steps", "N", Interval(1)), default("as far as recorded")] = None
    """Stop after N observing steps, counted from the beginning of the run."""
    seeds: Annotated[int, values.whole("--seeds", "N", Interval(0, 10_000))] = 0
    """Run both again with N other random numbers for the filters after the step: tells luck and effect apart."""
    source: Annotated[Path | None, values.path("--source", "FILE"), default("where it was")] = None
    """The world file or log that the recording was made of, if it is elsewhere by now."""
    record: Annotated[Path | None, values.path("--record", "OUT.rrd"), default("not written")] = None
    """Both, in one recording: the run, and the changed one as a branch of it."""
    summary: Annotated[Path | None, values.path("--summary", "OUT.json"), default("not written")] = None
    """Numbers of both."""

    def __call__(self, own: dict[str, str], command: str) -> int:
        """Run both; returns the exit code."""
        if own:
            raise UsageError(f"unknown option {next(iter(own))}; dualslam whatif --help lists them")
        if not self.recording:  # which a list of settings before it would swallow
            raise UsageError(
                "whatif needs a recording, before its options, such as: dualslam whatif a.rrd --from 143 --set "
                "particles=500"
            )
        if self.first is None:
            raise UsageError("whatif needs --from STEP, the first step with other parameters")
        from app.compare.runs import split_branch
        from app.run import check_outputs
        from app.whatif.execution import Execution
        from app.whatif.origin import read_origin
        from app.whatif.settings import check_applies, read_settings

        settings = read_settings([text for several in self.changes for text in several])
        path, branch = split_branch(self.recording)
        check_outputs(Outputs(self.record, self.summary), str(path))
        recorder = self._recorder()
        origin = read_origin(path, branch, self.source)
        check_applies(settings, origin.info.source, origin.recorded.keys)
        plan, warnings = self._plan(origin, {setting.name: setting.value for setting in settings})
        return Execution(plan, recorder, self.summary, warnings, command).run()

    def _recorder(self) -> Recorder | None:
        if self.record is None:
            return None
        from app.recording import Recorder

        return Recorder(self.record)

    def _plan(self, origin: Origin, values: dict[str, Any]) -> tuple[Plan, list[str]]:
        """What is to be run, and what is odd about it."""
        from app.whatif.fork import Plan
        from app.whatif.settings import shown, values_of

        assert self.first is not None
        last = origin.last if self.steps is None else self.steps
        if last > len(origin.info.source.steps):
            raise UsageError(
                f"--steps is {last}, and {origin.info.source.name} has {len(origin.info.source.steps)} of them"
            )
        if self.first > origin.last:
            cut = "is damaged, and only " if origin.damaged else ""
            raise UsageError(f"--from is {self.first}; {self.recording} {cut}has steps 1 to {origin.last}")
        if self.first > last:
            raise UsageError(f"--from is {self.first}, and --steps {last}: no step is left to change")
        was = values_of(origin.at(self.first))
        idle = [name for name, value in values.items() if was[name] == value]
        told = [f"--set {name}={shown(name, was[name])} is what holds at step {self.first} already" for name in idle]
        if len(idle) == len(values):
            raise UsageError(f"{'; '.join(told)}: nothing would change")
        warnings = [*origin.info.source.warnings, *told]
        if origin.info.mistake:
            warnings.append(f"{self.recording} was made with --mistake {origin.info.mistake}, and so are both ways")
        if origin.judged:
            warnings.append(f"{self.recording} was judged with --relations, and neither way is judged by them here")
        if origin.damaged:
            warnings.append(f"{origin.path} is damaged: it is read as far as that goes, to step {origin.last}")
        changed = {name: value for name, value in values.items() if name not in idle}
        return Plan(origin, self.first, last, changed, self.seeds), warnings
