"""The study of mistakes: what counts as told, which runs count, and that the tables are those of the single runs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.table import Table

from app import cli
from app.diagnosis.signatures import Looked
from app.study.mistakes import NONE, SENSITIVE, MistakesStudy, Outcome, Task, Watched, one_run

VERDICTS = ("right", "wrong", "undecided")


def outcome(mistake: str = NONE, named: tuple[str, ...] = (), open: tuple[str, ...] = (), **others: Any) -> Outcome:
    usual = {"filter": "dfs", "changed": True, "error_m": 0.1, "n_eff": 0.5, "diversity": 0.2}
    return Outcome(mistake=mistake, named=named, open=open, **(usual | others))


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (outcome(), "right"),
        (outcome(open=("keep-first",)), "right"),  # of a right filter: nothing is named
        (outcome(named=("keep-first",)), "wrong"),
        (outcome("keep-first", named=("keep-first",)), "right"),
        (outcome("keep-first", named=("keep-first",), open=("shared-maps",)), "right"),
        (outcome("keep-first", named=("keep-first", "shared-maps")), "wrong"),
        (outcome("keep-first", named=("shared-maps",), open=("keep-first",)), "wrong"),
        (outcome("keep-first", open=("keep-first",)), "undecided"),
        (outcome("keep-first", open=("shared-maps",)), "wrong"),
        (outcome("keep-first"), "wrong"),
    ],
)
def test_what_was_told_is_right_wrong_or_undecided(found: Outcome, verdict: str) -> None:
    assert found.verdict == verdict


def cells(table: Table) -> dict[tuple[str, str], dict[str, str]]:
    """By mistake and title of the filter, and by column."""
    rows = zip(*(column.cells for column in table.columns), strict=True)
    names = [str(column.header) for column in table.columns]
    return {(str(row[0]), str(row[1])): dict(zip(names[2:], map(str, row[2:]), strict=True)) for row in rows}


STUDY = MistakesStudy(worlds=("field", "hall"), mistakes=("keep-first", "features-first"), filters=("dfs", "fs2"))

MADE = {
    "field": [
        outcome(),
        outcome(named=("keep-first",)),
        outcome(),
        outcome("keep-first", named=("keep-first",), error_m=0.3, n_eff=0.6, diversity=0.4),
        outcome("keep-first", named=("keep-first",), changed=False, error_m=9.0, n_eff=0.9, diversity=0.9),
        outcome("keep-first", open=("keep-first",), error_m=0.5, n_eff=0.7, diversity=0.1),
        outcome(filter="fs2"),
        outcome("features-first", filter="fs2", changed=False),
    ],
    "hall": [outcome(), outcome("keep-first", named=("shared-maps",), error_m=0.7, n_eff=0.8, diversity=0.3)],
}
"""Dual FastSLAM cannot correct features first, and FastSLAM 2.0 was not tried with the other one, nor in the hall."""


def test_rates_are_of_the_runs_that_a_mistake_changes() -> None:
    rows = cells(STUDY._rates(MADE))
    assert rows == {
        ("none", "Dual FastSLAM"): {
            "field": "1 of 3",  # a false alarm
            "hall*": "0 of 1",
            "right": "75.0%",
            "wrong": "25.0%",
            "undecided": "0.0%",
        },
        ("none", "FastSLAM 2.0"): {
            "field": "0 of 1",
            "hall*": "-",
            "right": "100.0%",
            "wrong": "0.0%",
            "undecided": "0.0%",
        },
        ("keep-first", "Dual FastSLAM"): {
            "field": "1 of 2",
            "hall*": "0 of 1",
            "right": "33.3%",
            "wrong": "33.3%",
            "undecided": "33.3%",
        },
        ("features-first", "FastSLAM 2.0"): {
            "field": "-",
            "hall*": "-",
            "right": "-",
            "wrong": "-",
            "undecided": "-",
        },
    }


def test_effects_are_medians_over_the_runs_that_a_mistake_changes() -> None:
    """Each beside the right filter of the same run."""
    assert cells(STUDY._effects(MADE)) == {
        ("keep-first", "Dual FastSLAM"): {
            "changed": "3 of 4",
            "error, m": "0.1 -> 0.5",
            "N_eff": "0.5 -> 0.7",
            "diversity": "0.2 -> 0.3",
        },
        ("features-first", "FastSLAM 2.0"): {
            "changed": "0 of 1",
            "error, m": "-",
            "N_eff": "-",
            "diversity": "-",
        },
    }


@pytest.mark.parametrize(("off", "changed"), [(0.0, False), (0.9 * SENSITIVE, False), (1.1 * SENSITIVE, True)])
def test_a_mistake_changes_a_run_whose_estimate_it_moves(
    monkeypatch: pytest.MonkeyPatch, off: float, changed: bool
) -> None:
    """At a single step; a run of a right filter always counts."""
    right, wrong = np.zeros((5, 2)), np.zeros((5, 2))
    wrong[3, 1] = off
    watched = iter([Watched(Looked((), (), ()), estimates, 0.5, 0.5) for estimates in (right, wrong)])
    monkeypatch.setattr("app.study.mistakes.watch", lambda *_: next(watched))
    study = MistakesStudy(mistakes=("keep-first",), filters=("dfs",), steps=5)
    assert [(o.mistake, o.changed) for o in one_run(Task(study, "paper-line", 0))] == [
        (NONE, True),
        ("keep-first", changed),
    ]


def test_a_run_is_told_and_saved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Dual FastSLAM is changed by both mistakes, FastSLAM 1.0, which is resampled at every step, by none."""
    saved = tmp_path / "study.json"
    options = "--runs 1 --worlds paper-line --filters fs1 dfs --particles 8 --steps 15 --jobs 1"
    mistakes = ("resample-always", "weights-not-reset")
    words = ["study", "mistakes", *options.split(), "--mistakes", *mistakes, "--out", str(saved)]
    assert cli.entry(words) == 0
    told, found = capsys.readouterr().out, json.loads(saved.read_text())
    assert list(found) == ["schema", "study", "command", "options", "seeds", "worlds"]
    assert (found["study"], found["seeds"], list(found["worlds"])) == ("mistakes", 1, ["paper-line"])
    assert found["options"] == {
        "runs": 1,
        "worlds": ["paper-line"],
        "mistakes": list(mistakes),
        "filters": ["fs1", "dfs"],
        "particles": 8,
        "steps": 15,
        "seed": 0,
    }
    outcomes = found["worlds"]["paper-line"]
    assert all(list(o) == [*Outcome._fields, "verdict"] for o in outcomes)
    assert [(o["filter"], o["mistake"], o["changed"]) for o in outcomes] == [
        *(("fs1", mistake, mistake == NONE) for mistake in (NONE, *mistakes)),
        *(("dfs", mistake, True) for mistake in (NONE, *mistakes)),
    ]
    assert [o["verdict"] for o in outcomes if o["filter"] == "dfs"] == ["right"] * 3
    assert all(0.0 < o["error_m"] < 1.0 and 0.0 < o["n_eff"] < 1.0 and 0.0 < o["diversity"] < 1.0 for o in outcomes)
    assert f"1 of 1 seeds\n{found['command']}\n" in told

    printed = [re.split(r"\s{2,}", line.strip()) for line in told.partition("what they do")[0].splitlines()]
    rates = {(row[0], row[1]): row[2:] for row in printed if len(row) == 6}
    for o in outcomes:
        title = {"fs1": "FastSLAM 1.0", "dfs": "Dual FastSLAM"}[o["filter"]]
        shares = rates[o["mistake"] or "none", title][1:]
        counted = [float(o["verdict"] == verdict) for verdict in VERDICTS]
        assert shares == ([f"{share:.1%}" for share in counted] if o["changed"] else ["-"] * 3)
