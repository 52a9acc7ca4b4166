"""`dualslam diagnose FILE.rrd`: from its options to its exit code."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from app import values
from app.errors import UsageError
from app.options import default

if TYPE_CHECKING:
    from app.diagnosis.findings import Diagnosis


@dataclass(frozen=True)
class Diagnose:
    """Say where, when and why the filters of a recording lost diversity, whether they were consistent, what would help.

    FILE.rrd is made by: dualslam run WORLD|LOG --record FILE.rrd, or on the page of dualslam live. A branch of a live
    session is FILE.rrd#BRANCH. A recording whose program was killed is read up to there.

    Example: dualslam diagnose run.rrd --json run.json
    """

    recording: Annotated[tyro.conf.Positional[str], values.word("FILE.rrd"), tyro.conf.arg(help_behavior_hint="")] = ""
    """A recording, or a branch of one."""
    json: Annotated[Path | None, values.path("--json", "OUT.json"), default("the text is printed only")] = None
    """Write all findings with their numbers; the schema is in app/README.md."""

    def __call__(self, own: dict[str, str], command: str) -> int:
        """Diagnose; returns the exit code."""
        if not self.recording:
            raise UsageError("diagnose needs a recording; such as: dualslam diagnose run.rrd")
        if own:
            raise UsageError(f"unknown option {next(iter(own))}; dualslam diagnose --help lists them")
        from app.compare.runs import split_branch
        from app.diagnosis.diagnose import diagnose
        from app.diagnosis.reading import read_cases
        from app.diagnosis.words import SCHEMA, as_dict
        from app.files import check_file

        if self.json is not None:
            check_file("--json", self.json)
        path, branch = split_branch(self.recording)
        read = read_cases(path, branch)
        for warning in read.warnings:
            Console(stderr=True, highlight=False).print(f"warning: {warning}", style="yellow", soft_wrap=True)
        found = [diagnose(case) for case in read.cases]
        if self.json is not None:  # before anything is printed: | head ends a program that prints
            told = {"schema": SCHEMA, "file": self.recording, "command": command, "world": read.world}
            told["filters"] = {one.case.key: as_dict(one) for one in found}
            self.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
        _print(found, read.heading, self.recording)
        return 0


def _print(found: Sequence[Diagnosis], heading: str, name: str) -> None:
    from app.colours import of_filter
    from app.diagnosis.findings import TOPICS
    from app.diagnosis.words import commands

    out = Console(highlight=False)
    out.print(heading, soft_wrap=True, markup=False)
    for one in found:
        colour = "rgb({},{},{})".format(*of_filter(one.case.key))
        out.print()
        out.print(one.case.title, style=f"bold {colour}", markup=False)
        for topic, title in TOPICS.items():
            of_topic = [finding for finding in one.findings if finding.topic == topic]
            if of_topic:
                out.print(f"  {title}", style="bold", markup=False)
            for finding in of_topic:
                mark = "!" if finding.warns else "-"
                out.print(f"    {mark} {finding.text}", soft_wrap=True, markup=False)
                for line in commands(finding, name):
                    out.print(f"        try: {line}", style="dim", soft_wrap=True, markup=False)
