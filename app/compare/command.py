"""`dualslam compare A.rrd B.rrd ...`: from its options to its exit code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from app import values
from app.errors import UsageError
from app.options import default
from app.report import print_whole

if TYPE_CHECKING:
    from app.compare.numbers import Comparison
    from app.compare.output import Told

MOST = 8
"""Recordings: more than anybody tells apart in one plot."""


@dataclass(frozen=True)
class Compare:
    """Compare recordings: what differs, a table of numbers, plots, and all of them side by side in Rerun.

    A.rrd is what the others are compared with. FILE.rrd is made by: dualslam run WORLD|LOG --record FILE.rrd, or on the
    page of dualslam live. A branch of a live session is FILE.rrd#BRANCH; without it, its first run is compared.

    Example: dualslam compare before.rrd after.rrd --out comparison
    """

    recordings: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        values.words("A.rrd B.rrd ..."),
        tyro.conf.arg(help_behavior_hint="(2 to 8 of them)"),
    ] = ()
    """Recordings, or branches of them."""
    out: Annotated[Path | None, values.path("--out", "DIR"), default("only the table is printed")] = None
    """Write compare.json (all numbers), plots (PNG and SVG), and compare.rrd, the recordings side by side: rerun
    DIR/compare.rrd."""

    def __call__(self, own: dict[str, str], command: str) -> int:
        """Compare; returns the exit code."""
        if not 2 <= len(self.recordings) <= MOST:
            given = f"{len(self.recordings)} {'was' if len(self.recordings) == 1 else 'were'} given"
            raise UsageError(
                f"compare needs 2 to {MOST} recordings, and {given}; such as: dualslam compare A.rrd B.rrd"
            )
        if own:
            raise UsageError(f"unknown option {next(iter(own))}; dualslam compare --help lists them")
        from app.compare.numbers import compare
        from app.compare.output import Told, check, write
        from app.compare.runs import read_runs, split_branch
        from app.compare.words import no_statistics, sentences, unfinished

        if self.out is not None:
            check(self.out, [split_branch(name)[0] for name in self.recordings])
        runs = read_runs(self.recordings)
        err = Console(stderr=True, highlight=False)
        for warning in unfinished(runs):
            err.print(f"warning: {warning}", style="yellow", soft_wrap=True, markup=False)
        found = compare(runs)
        told = Told(sentences(found), no_statistics(found))
        # Before anything is printed: | head ends a program that prints.
        saved = [] if self.out is None else write(found, told, self.out, command)
        _print(found, told, saved)
        return 0


def _print(found: Comparison, told: Told, saved: Sequence[str]) -> None:
    from app.compare.table import filter_table

    out = Console(highlight=False)
    for sentence in told.said:
        out.print(sentence, soft_wrap=True, markup=False)
    for one in found.filters:
        out.print()
        print_whole(out, filter_table(one, found))
    out.print()
    for line in (*told.study, *saved):
        out.print(line, soft_wrap=True, markup=False)
