"""`dualslam worlds`: what there is, with a preview."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app import values
from app.errors import UsageError, listed, suggestion
from app.files import check_file, write_whole
from app.options import default
from app.report import in_words, print_whole
from app.sources import RECORDING, WORLD_FILE, LogParts, describe_options, load, options_as_typed, world_values
from scenarios.logs.learning import odometry_believed, origin_of_belief
from scenarios.preview import WorldRow, driven, preview, world_row
from scenarios.registry import build, scenario, worlds
from scenarios.types import Source
from scenarios.words import counted
from scenarios.world_file import world_text
from slam.motion import Ackermann, Odometry
from slam.types import Scan


@dataclass(frozen=True)
class Worlds:
    """What worlds there are; with a NAME, what it looks like and its options; of a LOG, what is in it.

    A world may be written to a file, changed, and run: dualslam run FILE.toml.
    """

    name: Annotated[
        tyro.conf.Positional[str],
        values.word("NAME|LOG"),
        tyro.conf.arg(help_behavior_hint="(default: a table of all)"),
    ] = ""
    """A world, a world file, or a log."""
    write: Annotated[Path | None, values.path("--write", "FILE.toml"), default("not written")] = None
    """Write the world to a file."""

    def __call__(self, own: dict[str, str], command: str) -> int:
        """Print; returns the exit code."""
        console = Console(highlight=False)
        if not self.name:
            if self.write is not None or own:
                raise UsageError(
                    f"{'--write' if self.write is not None else next(iter(own))} needs the NAME of a world"
                )
            _print_all(console)
            return 0
        if self._is_log():
            if self.write is not None:
                raise UsageError(f"--write does not apply to {self.name}: it is for worlds, and this is a log")
            _print_log(console, load(self.name, own, LogParts()))
            return 0
        values = self._values(own)
        with options_as_typed(own):
            if self.write is None:
                _print_one(console, self.name, build(self.name, **values))
                return 0
            _check_world_file(self.write)
            write_whole(self.write, world_text(scenario(self.name, **values)))
        how = f"run it with: dualslam run {shlex.quote(str(self.write))}"
        console.print(f"world: {self.write}   ({how})", soft_wrap=True, markup=False)
        return 0

    def _is_log(self) -> bool:
        if self.name in worlds() or Path(self.name).suffix.lower() in (WORLD_FILE, RECORDING):
            return False
        return Path(self.name).expanduser().exists()

    def _values(self, own: dict[str, str]) -> dict[str, Any]:
        if self.name in worlds():
            return world_values(worlds()[self.name], own)
        if Path(self.name).suffix.lower() != WORLD_FILE:
            raise UsageError(f"there is no world {self.name!r}{suggestion(self.name, worlds())}; {_expected()}")
        if own:
            raise UsageError(f"{next(iter(own))} does not apply to {self.name}: a world file has no options")
        return {}


def _expected() -> str:
    return f"expected {listed(worlds())}, a file that ends in {WORLD_FILE}, or a log"


def _check_world_file(path: Path) -> None:
    """That a world can be written there, and nothing that somebody wrote is lost."""
    if path.suffix.lower() != WORLD_FILE:
        raise UsageError(f"--write is {path}; expected a name that ends in {WORLD_FILE}, as world files do")
    check_file("--write", path)
    if path.exists() and path.stat().st_size > 0:
        raise UsageError(f"--write {path} exists already and may have been edited; expected a new name")


def _print_all(console: Console) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("world", style="bold", no_wrap=True, min_width=max(map(len, worlds())))
    for name in ("route", "time", "map", "steps", "seen"):
        width = len("81 landmarks") if name == "map" else len("1000 m")
        table.add_column(name, justify="right", no_wrap=True, min_width=max(len(name), width))
    table.add_column("")
    for name in worlds():
        row = world_row(build(name))
        numbers = (
            f"{row.route:.0f} m",
            f"{row.duration:.0f} s",
            _things(row),
            f"{row.steps}",
            f"{row.visible:.1f}",
        )
        table.add_row(name, *numbers, row.title)
    print_whole(console, table)
    hint = "seen: landmarks or walls in view at a step, on average.   One world and its options: dualslam worlds NAME"
    console.print(f"\n{hint}", soft_wrap=not console.is_terminal)


def _print_one(console: Console, name: str, source: Source) -> None:
    row = world_row(source)
    _print_view(console, source)
    console.print(
        f"\n{row.route:.0f} m in {row.duration:.0f} s, {_things(row)}, {row.steps} observing steps with "
        f"{row.visible:.1f} {row.what} in view",
        soft_wrap=True,
    )
    scan = source.steps[0].frame.scan
    if scan is not None:
        console.print(f"laser: {_laser(scan)}", soft_wrap=True)
    console.print(f"noise: {_noise(source)}", soft_wrap=True)
    _print_defaults(console, source)
    entry = worlds().get(name)
    if entry:
        table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
        table.add_column("", style="bold", no_wrap=True)
        for option in describe_options(entry):
            text = f"{option.doc} (default: {option.default})" if option.default else option.doc
            table.add_row(f"{option.option} {option.metavar}", escape(text))
        console.print("\noptions")
        print_whole(console, table)


def _print_view(console: Console, source: Source) -> None:
    console.print(f"[bold]{escape(source.name)}[/]  {escape(source.title)}\n", soft_wrap=True)
    console.print(preview(source, width=min(console.width - 2, 100)), markup=False, soft_wrap=True)


def _print_defaults(console: Console, source: Source) -> None:
    """And what was odd."""
    for warning in source.warnings:
        console.print(f"warning: {warning}", style="yellow", soft_wrap=True, markup=False)
    if source.defaults:
        defaults = ", ".join(f"--{name.replace('_', '-')} {value}" for name, value in source.defaults.items())
        console.print(f"defaults: {defaults}", soft_wrap=True)


def _print_log(console: Console, source: Source) -> None:
    """What a run of the whole log would work on."""
    _print_view(console, source)
    steps, frames = len(source.steps), [step.frame for step in source.steps]
    seconds = sum(float(frame.dt.sum()) for frame in frames)
    duration = f"in {seconds:.0f} s" if source.has_clock else "without time stamps"
    scans = "" if source.scans is None else f"{counted(len(source.scans.stamps), 'scan')}, of which keyframes are "
    console.print(
        f"\n{sum(map(driven, frames)):.0f} m by odometry {duration}, {scans}{counted(steps, 'observing step')}",
        soft_wrap=True,
    )
    scan = max((frame.scan for frame in frames if frame.scan is not None), key=lambda s: len(s.bearings), default=None)
    if scan is not None:
        console.print(f"laser: {_laser(scan)}", soft_wrap=True)
    noise = odometry_believed(source.motion, source.noise)
    what = _noise(source)
    if noise is not None:
        what = f"range {source.noise.range:.3g} m; {in_words(noise, origin_of_belief(source, source.noise))}"
    console.print(f"noise: {what}", soft_wrap=True)
    told = sum(step.truth is not None for step in source.steps)
    truth = "known" if told == steps else f"known at {told} of these steps" if told else "not known"
    console.print(f"truth: {truth}", soft_wrap=True)
    _print_defaults(console, source)


def _things(row: WorldRow) -> str:
    return f"{row.things} {row.what if row.things != 1 else row.what.removesuffix('s')}"


def _laser(scan: Scan) -> str:
    beams = len(scan.bearings)
    view = math.degrees(scan.bearings[-1] - scan.bearings[0])
    apart = f", {view / (beams - 1):.3g}° apart" if beams > 1 else ""
    return f"{beams} beam{'s' if beams > 1 else ''}{apart}, to {scan.max_range:.3g} m"


def _noise(source: Source) -> str:
    noise, steering = source.noise, isinstance(source.motion, Ackermann)
    if isinstance(source.motion, Odometry):
        missing = f", {100 * noise.missing:.3g} % of the beams missing" if noise.missing else ""
        return f"odometry {100 * noise.odometry:.3g} % of the motion, range {noise.range:.3g} m{missing}"
    turn = f"{'steering' if steering else 'turn'} {math.degrees(noise.turn):.3g} {'°' if steering else '°/s'}"
    sensor = f"range {noise.range:.3g} m, bearing {math.degrees(noise.bearing):.3g}°"
    return f"speed {noise.speed:.3g} m/s, {turn}, {sensor}"
