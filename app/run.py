"""`dualslam run WORLD|LOG`: filters on a world or a log, from the command line."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from tyro.conf import OmitArgPrefixes, Positional

from app import report, session, values
from app.errors import UsageError, listed
from app.files import check_directory, check_file, is_stdout
from app.interrupt import Interrupts
from app.options import (
    FILTERS,
    MISTAKES,
    BelievedNoise,
    FilterOptions,
    LogOptions,
    Outputs,
    WorldNoise,
    default,
    parameters,
)
from app.relations import PathErrors, relations_of
from app.sources import LogParts, load
from app.summary import Summary
from app.types import Observer, SessionInfo, SessionStep
from scenarios.logs.relations import Relations
from scenarios.types import Source
from slam.limits import Interval


@dataclass(frozen=True)
class SessionOptions:
    """What a session needs to begin."""

    source: Annotated[Positional[str], values.word("WORLD|LOG"), tyro.conf.arg(help_behavior_hint="")] = ""
    """A world by name, a world file (.toml), or a log."""
    filters: Annotated[tuple[str, ...], values.choices("--filters", "|".join(FILTERS), FILTERS)] = FILTERS[:3]
    """Some of Dual FastSLAM (dfs), FastSLAM 2.0 (fs2), FastSLAM 1.0 (fs1), EKF-SLAM (ekf)."""
    seed: Annotated[int, values.whole("--seed", "N", Interval(0))] = 0
    """Of all random numbers: same seed, same results."""
    steps: Annotated[int | None, values.whole("--steps", "N", Interval(1)), default("all")] = None
    """Stop after N observing steps."""
    filter: OmitArgPrefixes[FilterOptions] = field(default_factory=FilterOptions)
    noise: WorldNoise = field(default_factory=WorldNoise)
    believed: BelievedNoise = field(default_factory=BelievedNoise)
    log: OmitArgPrefixes[LogOptions] = field(default_factory=LogOptions)
    mistake: Annotated[str | None, values.choice("--mistake", MISTAKES), default("none")] = None
    """Filters that are wrong on purpose, in one of the classic ways, to see what that does: README of app."""
    relations: Annotated[Path | None, values.path("--relations", "FILE"), default("none")] = None
    """Logs of a laser: relations between two scans (Kuemmerle et al., 2009), by which to judge the paths."""

    def info(self, own: dict[str, str], command: str) -> SessionInfo:
        """The session; `own` are the options that the world has of its own, as typed."""
        if self.mistake is not None:
            check_mistake(self.mistake, self.filters)
        source = load(self.source, own, LogParts(*vars(self.log).values()))
        noise, params = parameters(source, self.filter, self.noise, self.believed)
        filters = session.estimators(self.filters, self.mistake or "")
        info = session.make_info(source, filters, params, noise, self.seed, self.steps, command)
        return info._replace(mistake=self.mistake or "")

    def relations_to(self, source: Source) -> Relations | None:
        """The relations by which to judge, if any were given."""
        return None if self.relations is None else relations_of(self.relations, source)


@dataclass(frozen=True)
class Run(SessionOptions):
    """Run filters on a world or a log, on identical data, and report.

    WORLD: a name (dualslam worlds) or a world file. LOG: the path of a real robot's log.

    Worlds have options of their own, such as --features or --laps: dualslam run WORLD --help.
    """

    align: bool = False
    """Move the whole path rigidly onto the truth before errors are taken."""
    replay: Annotated[Path | None, values.path("--replay", "SESSION.json"), default("nothing")] = None
    """Instead of a world: run a live session again, as it was, headless, and say whether it is the same bit for bit."""
    branch: Annotated[str, values.word("NAME"), default("the first run")] = ""
    """Which branch of the session to replay."""
    output: OmitArgPrefixes[Outputs] = field(default_factory=Outputs)

    def __call__(self, own: dict[str, str], command: str) -> int:
        """Run; `own` are the options that the world has of its own, as typed.  Returns the exit code."""
        if self.replay is not None:
            return self._replay(own)
        if self.branch:
            raise UsageError(f"--branch is {self.branch!r}, but there is no --replay whose branch that could be")
        if not self.source:
            raise UsageError(
                "run needs a world or a log, such as: dualslam run loop (dualslam worlds lists the worlds)"
            )
        if self.filter.orthogonal and "ekf" not in self.filters:
            raise UsageError(
                "--orthogonal does not apply to these filters: it is for EKF-SLAM; expected ekf in --filters"
            )
        if self.filter.merge_walls and set(self.filters) == {"ekf"}:
            raise UsageError(
                "--merge-walls does not apply to EKF-SLAM, whose one map has all correlations; expected dfs, fs2 or "
                "fs1 in --filters"
            )
        check_outputs(self.output, self.source)
        return self._show(self.info(own, command))

    def _replay(self, own: dict[str, str]) -> int:
        """The session that was saved, with every filter that was ever on."""
        given = dataclasses.replace(self, replay=None, branch="", output=Outputs(), align=False, relations=None)
        if given != Run() or own:
            raise UsageError(
                "--replay does what the session did; expected no world and no other options beside it than "
                "--branch, --align, --relations, --record, --summary and --trajectory"
            )
        assert self.replay is not None
        check_outputs(self.output, str(self.replay))
        from app.live.script import Check, read_replay

        replay = read_replay(self.replay, self.branch)
        info = session_of_command(replay.command)
        first = replay.changes[0][1]
        filters = session.estimators(replay.filters, replay.mistake)
        steps = min(replay.steps, len(info.source.steps))
        info = info._replace(mistake=replay.mistake)
        info = info._replace(filters=filters, params=first.params, noise=first.noise, seed=replay.seed, steps=steps)
        check = Check(replay)
        code = self._show(info, replay.session_changes(), [check])
        Console(stderr=True, highlight=False).print(check.told(), soft_wrap=True, markup=False)
        return code or int(not check.same)

    def _show(self, info: SessionInfo, changes: Sequence[session.Change] = (), more: Sequence[Observer] = ()) -> int:
        err = Console(stderr=True, highlight=False)
        out = err if is_stdout(self.output.summary) else Console(highlight=False)  # JSON is not mixed with a table
        relations = self.relations_to(info.source)
        for warning in (*info.source.warnings, *(relations.warnings if relations else ())):
            err.print(f"warning: {warning}", style="yellow", soft_wrap=True, markup=False)
        summary = Summary(self.output.summary, self.align, None if relations is None else PathErrors(relations))
        return self._run(info, summary, changes, more, out, err)

    def _run(
        self,
        info: SessionInfo,
        summary: Summary,
        changes: Sequence[session.Change],
        more: Sequence[Observer],
        out: Console,
        err: Console,
    ) -> int:
        outputs = self._outputs(summary)
        observers: list[Observer] = [*outputs, *more, report.ProgressBar(err)]
        if self.output.summary is None:
            observers.insert(0, summary)
        try:
            with Interrupts() as interrupts:
                session.run(info, observers, changes, interrupts)
        except KeyboardInterrupt:
            _report(info, summary, outputs, out)
            done = f"{len(summary.steps)} of {info.steps} steps"
            saved = "; everything up to there is saved" if any(output.saved for output in outputs) else ""
            err.print(f"interrupted after {done}{saved}", soft_wrap=True)
            return 130
        except BrokenPipeError:
            raise
        except Exception:  # what was found until then is not lost
            _report(info, summary, outputs, out)
            raise
        _report(info, summary, outputs, out)
        return 0

    def _outputs(self, summary: Summary) -> list[Output]:
        """What writes something."""
        outputs = []
        if self.output.summary is not None:
            outputs.append(Output("summary", self.output.summary, summary))
        if self.output.record is not None:
            from app.recording import Recorder  # so does Rerun

            judge = None if summary.paths is None else summary.paths.breaks
            outputs.append(Output("recording", self.output.record, Recorder(self.output.record, judge)))
        if self.output.trajectory is not None:
            from app.trajectory import Trajectory

            outputs.append(Output("paths and maps", self.output.trajectory, Trajectory(self.output.trajectory)))
        return outputs


def check_mistake(name: str, filters: Sequence[str]) -> None:
    """Raise `UsageError` unless one can make the mistake in all of the filters."""
    from slam.estimators import ESTIMATORS
    from slam.mistakes import MISTAKES as KNOWN

    able = KNOWN[name].phases
    if unable := [ESTIMATORS[key].title for key in filters if key not in able]:
        raise UsageError(
            f"--mistake is {name}, which one cannot make in {' and '.join(unable)}; expected --filters with "
            f"{listed(list(able))}"
        )


def session_of_command(command: str) -> SessionInfo:
    """The session that a command line begins, `dualslam live ...` or `dualslam run ...`."""
    options, own = options_of_command(command)
    return options.info(own, command)


def options_of_command(command: str) -> tuple[SessionOptions, dict[str, str]]:
    """What such a command line asks for, and the options that the world has of its own, as typed."""
    from app.command import parse  # which knows this module

    try:
        _, *words = shlex.split(command)
    except ValueError:
        words = []
    if not words or words[0] not in ("run", "live"):
        raise UsageError(f"the session was begun by {command!r}; expected dualslam live or dualslam run")
    options, own = parse(words)
    if not isinstance(options, SessionOptions) or not options.source:
        raise UsageError(f"the session was begun by {command!r}; expected a world or a log in it")
    return options, own


class Output:
    """An observer that writes something, and whether it could."""

    def __init__(self, what: str, path: Path, observer: Observer) -> None:
        self.what = what
        self.path = path
        self.saved = False
        self._observer = observer
        self._steps = 0
        self._failed = False

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        with self._watched():
            self._observer.begin(info)

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        self._steps += 1
        with self._watched():
            self._observer.step(step)

    def end(self) -> None:
        """After the last step."""
        with self._watched():
            self._observer.end()
        self.saved = self._steps > 0 and not self._failed

    @contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._failed = True
            raise


def _report(info: SessionInfo, summary: Summary, outputs: Sequence[Output], out: Console) -> None:
    if summary.steps:
        report.print_report(info, summary, out)
    for output in outputs:
        if output.saved:
            how = f"   (open it with: rerun {shlex.quote(str(output.path))})" if output.what == "recording" else ""
            out.print(f"{output.what}: {output.path}{how}", soft_wrap=True, markup=False)


def check_outputs(output: Outputs, source: str) -> None:
    """That everything can be written, before any work is done."""
    files = {"--record": output.record, "--summary": output.summary}
    paths = {option: path for option, path in files.items() if path is not None}
    for option, path in paths.items():
        check_file(option, path)
        if path.exists() and Path(source).exists() and path.samefile(source):
            raise UsageError(f"{option} {path} is the input itself; expected another file")
    if output.summary is not None and _holds_something_else(output.summary):
        raise UsageError(f"--summary {output.summary} exists and is no summary; it is not overwritten")
    if len({path.resolve() for path in paths.values()}) < len(paths):
        raise UsageError(f"--record and --summary are both {output.record}; expected two files")
    if output.trajectory is not None:
        check_directory("--trajectory", output.trajectory)


def _holds_something_else(path: Path) -> bool:
    """Whether something is there that is not JSON, such as a world file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(64).lstrip()[:1] not in (b"", b"{")
