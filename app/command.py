"""The command line: `dualslam COMMAND ...`, from its words to its exit code."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import io
import operator
import os
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np
import tyro

from app.compare.command import Compare
from app.diagnosis.command import Diagnose
from app.errors import UsageError, listed, sentence, suggestion
from app.lessons.command import Teach
from app.live.command import Live
from app.options import FILTERS
from app.run import Run, SessionOptions
from app.sources import all_world_options, split_world_options
from app.study import STUDIES
from app.version import version
from app.whatif.command import WhatIf
from app.worlds import Worlds
from scenarios.registry import WorldEntry, worlds
from scenarios.types import SourceError

DESCRIPTION = """See inside a SLAM particle filter: Dual FastSLAM beside FastSLAM 1.0, FastSLAM 2.0 and EKF-SLAM.

Examples:
  dualslam live loop                                 the workbench: a panel and Rerun's viewer on one page
  dualslam lesson                                    guided demonstrations: questions, and runs that answer them
  dualslam worlds                                    what there is to run
  dualslam run loop                                  three filters on a simulated world
  dualslam run paper-line --vehicle ackermann --filters dfs fs2 fs1 ekf --record paper.rrd
  dualslam run loop --particles 30 --noise.range 0.05 --summary loop.json --trajectory loop/
  dualslam run ../data/MRCLAM_Dataset6 --robot 3 --association known
  dualslam compare a.rrd b.rrd --out comparison      two recordings: what differs, numbers, plots, side by side
  dualslam diagnose a.rrd                            why particles died, and what would have helped
  dualslam whatif a.rrd --from 143 --set particles=500   the same run, with other parameters from a step on
  dualslam study paper-table --runs 20               the paper's comparison, with standard errors

A run with --record FILE.rrd is opened with: rerun FILE.rrd
"""

_STUDY = functools.reduce(operator.or_, (Annotated[kind, tyro.conf.subcommand(key)] for key, kind in STUDIES.items()))


@dataclasses.dataclass(frozen=True)
class Study:
    """Monte Carlo: many runs, means with their standard errors."""

    study: _STUDY  # type: ignore[valid-type]
    """Which one."""

    def __call__(self, command: str) -> int:
        """Run it; returns the exit code."""
        return self.study(command)


COMMANDS: dict[str, Any] = {
    "live": Live,
    "lesson": Teach,
    "run": Run,
    "compare": Compare,
    "diagnose": Diagnose,
    "whatif": WhatIf,
    "worlds": Worlds,
    "study": Study,
}

EXPECTED = (UsageError, SourceError, OSError, MemoryError)
"""What may go wrong without a fault of the program's: told in a sentence."""


def carry_out(arguments: Sequence[str]) -> int:
    """Run a command; returns the exit code: 0 done, 2 unusable arguments or input."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal without the letter of some unit gets a question mark
    try:
        command, own = parse(arguments)
        line = shlex.join(["dualslam", *arguments])
        return command(line) if isinstance(command, Study) else command(own, line)
    except SystemExit as done:  # after --help; and by rich for `| head`, since that nobody reads any more is no failure
        return 0 if isinstance(done.__context__, BrokenPipeError) else _code(done)
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - for the interpreter's last flush
        return 0
    except EXPECTED as error:
        reason = sentence(error)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        reason = f"the numbers went beyond what can be computed ({sentence(error)}); expected less extreme parameters"
    except ExceptionGroup as errors:
        if errors.split(EXPECTED)[1] is not None:
            raise
        reason = "; ".join(dict.fromkeys(map(sentence, errors.exceptions)))
    print(f"dualslam: {reason}", file=sys.stderr)
    return 2


def _code(done: SystemExit) -> int:
    return done.code if isinstance(done.code, int) else int(done.code is not None)


def parse(arguments: Sequence[str]) -> tuple[Any, dict[str, str]]:
    """The command as an instance of its dataclass, and the options that a world has of its own, as typed."""
    if not arguments:
        arguments = ["--help"]
    name, rest = arguments[0], list(arguments[1:])
    if name == "--version":
        print(f"dualslam {version()}")
        raise SystemExit(0)
    if not name.startswith("-") and name not in COMMANDS:
        raise UsageError(f"unknown command {name!r}{suggestion(name, COMMANDS)}; expected one of {', '.join(COMMANDS)}")
    own: dict[str, str] = {}
    world: WorldEntry | None = None
    if name == "study":
        rest = _known_study(rest)
    elif not {"-h", "--help"}.isdisjoint(arguments):
        world = next((worlds()[word] for word in rest if word in worlds()), None)
    else:
        rest, own = split_world_options(_source_first(rest))
    command, unknown = _tyro([name, *rest], world)
    if unknown:
        raise UsageError(_unexpected(unknown, name, command))
    return command, own


def _known_study(arguments: list[str]) -> list[str]:
    """The arguments of `study`, or its help where there are none."""
    if not arguments:
        return ["--help"]
    name = arguments[0]
    if not name.startswith("-") and name not in STUDIES:
        raise UsageError(f"unknown study {name!r}{suggestion(name, STUDIES)}; expected {listed(STUDIES)}")
    return arguments


def _source_first(arguments: list[str]) -> list[str]:
    """`--filters dfs fs2 loop` as `loop --filters dfs fs2`: a list of names would swallow the world."""
    if "--filters" not in arguments:
        return arguments
    for at in range(arguments.index("--filters") + 2, len(arguments)):
        word = arguments[at]
        if word.startswith("-"):
            break
        if word not in FILTERS and (word in worlds() or Path(word).exists()):
            return [word, *arguments[:at], *arguments[at + 1 :]]
    return arguments


def _tyro(arguments: list[str], world: WorldEntry | None) -> tuple[Any, list[str]]:
    """Parse; tyro's own complaint, a box of several lines, as one sentence."""
    with_world = {name: _with_options_of(COMMANDS[name], world) for name in ("live", "run")} if world else {}
    kinds = {**COMMANDS, **with_world}
    branches = (Annotated[kind, tyro.conf.subcommand(name)] for name, kind in kinds.items())
    union: Any = functools.reduce(operator.or_, branches)
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            return tyro.cli(
                union,
                prog="dualslam",
                description=DESCRIPTION,
                args=arguments,
                return_unknown_args=True,
                config=(
                    tyro.conf.OmitSubcommandPrefixes,
                    tyro.conf.FlagCreatePairsOff,
                    tyro.conf.HelptextFromCommentsOff,
                ),
            )
    except SystemExit as done:
        if done.code in (0, None):
            raise
        raise UsageError(_unboxed(box.getvalue())) from None


def _with_options_of(command: type, world: WorldEntry) -> type:
    """A command with the options of one world, for its help."""
    group = tyro.conf.OmitArgPrefixes[world.options]
    own = (world.name.replace("-", "_"), group, dataclasses.field(default_factory=world.options))
    namespace = {"__doc__": command.__doc__}
    return dataclasses.make_dataclass(command.__name__, [own], bases=(command,), frozen=True, namespace=namespace)


def _unboxed(text: str) -> str:
    lines = [line.strip("│ ") for line in text.splitlines() if not line.startswith(("╭", "╰"))]
    message = " ".join(lines[: next((i for i, line in enumerate(lines) if line.startswith("──")), len(lines))])
    missing = re.search(r"Missing value for argument '(.+?)'", message)
    return f"{missing[1]} needs a value" if missing else message


def _unexpected(unknown: Sequence[str], name: str, command: Any) -> str:
    wrong = next((word for word in unknown if word.startswith("-")), unknown[0]).partition("=")[0]
    kind = type(command)
    if isinstance(command, Study):
        kind = type(command.study)
        name = f"study {next(key for key, study in STUDIES.items() if study is kind)}"
    if not wrong.startswith("-"):
        return f"unexpected argument {wrong!r}; dualslam {name} --help tells what is expected"
    known = option_names(kind) | (all_world_options() if issubclass(kind, SessionOptions) else set())
    return f"unknown option {wrong}{suggestion(wrong, known)}; dualslam {name} --help lists them"


def option_names(kind: Any, prefix: str = "--") -> set[str]:
    """The options of a command, as they are typed."""
    names = set()
    hints = get_type_hints(kind, include_extras=True)
    for field in dataclasses.fields(kind):
        inner, *extras = get_args(hints[field.name]) or [hints[field.name]]
        if dataclasses.is_dataclass(inner):  # its name is a prefix, unless something (OmitArgPrefixes) says otherwise
            names |= option_names(inner, prefix if extras else f"{prefix}{field.name}.")
        elif tyro.conf.Positional not in extras:
            given = (getattr(extra, "name", None) for extra in extras)
            name = next((name for name in given if isinstance(name, str)), field.name)
            names.add(prefix + name.replace("_", "-"))
    return names
