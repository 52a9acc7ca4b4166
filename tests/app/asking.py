"""Runs that are recorded, and questions to them: `dualslam run --record` and `dualslam whatif`, by their commands."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from app import cli

SEED = 3


def record(path: Path, *more: object, filters: Sequence[str], steps: int, world: object = "paper-line") -> Path:
    """A run of twelve particles; `more` are options of it."""
    words = ["run", str(world), "--filters", *filters, "--steps", str(steps), "--seed", str(SEED)]
    assert cli.entry([*words, "--record", str(path), "--particles", "12", *map(str, more)]) == 0
    return path


def whatif(path: Path | str, *arguments: object) -> int:
    """The exit code of a question."""
    return cli.entry(["whatif", str(path), *map(str, arguments)])


def asked(path: Path | str, folder: Path, *arguments: object) -> dict[str, Any]:
    """The summary of a question that has an answer."""
    out = folder / "asked.json"
    assert whatif(path, *arguments, "--summary", out) == 0
    return json.loads(out.read_text())


def refused(capsys: pytest.CaptureFixture[str], path: Path | str, *arguments: object) -> str:
    """What is said of one that has none: one sentence, and nothing else."""
    capsys.readouterr()
    assert whatif(path, *arguments) == 2
    found = capsys.readouterr()
    assert found.out == ""
    (line,) = [line for line in found.err.splitlines() if line.startswith("dualslam: ")]
    return line
