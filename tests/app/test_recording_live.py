"""Recordings of live sessions: what is left out when there is no time, whose ends are not known, what is looked at."""

from __future__ import annotations

import collections
import dataclasses
import itertools
import os
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from app import session
from app.live.engine import Begun, Stepped
from app.recording.program import Program
from app.recording.reading import Recording, open_reader
from app.recording.session import DUTY, FILE_DUTY, PICTURES, SessionWriter
from app.recording.stream import FileStream
from app.recording.writer import Detail, Writer
from app.types import SessionInfo, SessionStep
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from tests.app.test_recording import Watch

STEPS, K, KEYS = 14, 20, ("dfs", "fs2")

PICTURED = ("/world/", "/weights/", "/hypotheses/", "/genealogy/")
"""Where there is what is not a number."""

AGAIN = [f"/{entity}" for key in KEYS for entity in (
    f"world/{key}/map", f"world/{key}/path", f"genealogy/{key}/lags", f"genealogy/{key}/words",
)]  # fmt: skip
"""What a file that is closed may have of its last step once more, since it is written with what lies behind."""

NO_COMPONENTS = ("stage", "step", "sim_time", "rerun.controls.RowId")


@pytest.fixture(scope="module")
def info() -> SessionInfo:
    source = build("paper-line")
    params = source.params(particles=K, association="known")
    return session.make_info(source, [ESTIMATORS[key] for key in KEYS], params, seed=3, count=STEPS)


@pytest.fixture(scope="module")
def steps(info: SessionInfo) -> list[SessionStep]:
    watch = Watch()
    session.run(info, [watch])
    return watch.steps


def written(info: SessionInfo, path: Path, steps: list[tuple[SessionStep, Detail]]) -> Recording:
    writer = Writer(info, partial(FileStream, path))
    for step, detail in steps:
        writer.step(step, detail)
    writer.close()
    return Recording(path)


def moments(recording: Recording, entity: str) -> dict[str, list[int]]:
    """By component, the moments ("stage") at which an entity has something, as often as it has."""
    found: dict[str, list[int]] = {}
    for chunk in recording.chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and not chunk.is_static:
            times = batch.column("stage").cast(pa.int64()).to_pylist()
            for name in (name for name in batch.schema.names if name not in NO_COMPONENTS):
                there = batch.column(name).is_valid().to_pylist()
                found.setdefault(name, []).extend(itertools.compress(times, there))
    return {name: sorted(times) for name, times in found.items()}


def repeated(recording: Recording) -> dict[tuple[str, int], int]:
    """How often an entity has anything of a moment, where that is more than once."""
    found = {}
    for entity in recording.entities:
        for times in moments(recording, entity).values():
            often = {moment: count for moment, count in collections.Counter(times).items() if count > 1}
            found |= {(entity, moment): max(count, found.get((entity, moment), 0)) for moment, count in often.items()}
    return found


# How much of a step ---------------------------------------------------------------------------------------------------


def test_of_a_step_there_may_be_its_particles_alone(
    info: SessionInfo, steps: list[SessionStep], tmp_path: Path
) -> None:
    """The first and the fifth are whole; of the others there are numbers, and what the step itself shows.  When the
    file is closed there is of the last one what lies behind, and what grows with that, the map and the path, again."""
    whole = {1, 5}
    recording = written(info, tmp_path / "a.rrd", [(s, "usual" if s.index in whole else "present") for s in steps])
    resampled = {key: {s.index for s in steps if s.filters[key].trace.did_resample} for key in KEYS}
    assert 0 < len(resampled["dfs"] - whole) < STEPS - len(whole)  # of both kinds there are some
    for key in KEYS:
        rows = recording.rows(f"/world/{key}/particles", "Points3D:positions", "stage")
        moments = {3 * i - 1 for i in range(1, STEPS + 1)} | {3 * i for i in resampled[key]}
        moments |= {3 * i - k for i in whole for k in range(3)}
        assert [moment for moment, _ in rows] == sorted(moments)
        for moment, positions in rows:
            trace = steps[(moment - 1) // 3].filters[key].trace
            shown = (trace.predicted, trace.weighted, trace.resampled)[(moment - 1) % 3]
            np.testing.assert_allclose(np.array(positions)[:, :2], shown.s[:, :2], atol=1e-5)
        for entity, component in (
            (f"/world/{key}/maps", "Points3D:positions"),
            (f"/world/{key}/lineages", "LineStrips3D:strips"),
            (f"/genealogy/{key}", "LineStrips2D:strips"),
        ):
            assert [moment for moment, _ in recording.rows(entity, component, "step")] == sorted({*whole, STEPS})
        for entity, component, again in (
            (f"/world/{key}/map", "Points3D:positions", [STEPS]),
            (f"/world/{key}/path", "LineStrips3D:strips", [STEPS]),
            (f"/world/{key}/associations", "LineStrips3D:strips", []),
            (f"/weights/{key}", "BarChart:values", []),
            (f"/plots/n_eff/{key}", "Scalars:scalars", []),
        ):
            rows = recording.rows(entity, component, "step")
            assert [moment for moment, _ in rows] == [*range(1, STEPS + 1), *again]
            assert rows[-1][1] == rows[STEPS - 1][1]  # the same, if it is there again
    assert repeated(recording) == dict.fromkeys([(entity, 3 * STEPS) for entity in (*AGAIN, "/genealogy/cursor")], 2)


def test_numbers_are_without_any_picture(info: SessionInfo, steps: list[SessionStep], tmp_path: Path) -> None:
    """But of the last step, when the file is closed: there is what the step shows, and then what lies behind."""
    recording = written(info, tmp_path / "a.rrd", [(step, "numbers") for step in steps])
    pictures = [e for e in recording.entities if e.startswith(PICTURED) and recording.timelines(e)]
    assert len(pictures) > 20
    for entity in pictures:
        at = {moment for times in moments(recording, entity).values() for moment in times}
        assert at <= {3 * STEPS - 1, 3 * STEPS}, entity
    surroundings = ["odometry/path", "scan", "truth/path", "truth/robot"]
    again = [*AGAIN, *(f"/world/{entity}" for entity in surroundings)]
    assert repeated(recording) == dict.fromkeys([(entity, 3 * STEPS) for entity in again], 2)
    for key in KEYS:
        resampled = [3 * STEPS] if steps[-1].filters[key].trace.did_resample else []
        assert moments(recording, f"/world/{key}/particles")["Points3D:positions"] == [3 * STEPS - 1, *resampled]
        for entity, component in (
            (f"/world/{key}/maps", "Points3D:positions"),
            (f"/world/{key}/lineages", "LineStrips3D:strips"),
            (f"/genealogy/{key}", "LineStrips2D:strips"),
        ):
            assert moments(recording, entity)[component] == [3 * STEPS]
        assert len(recording.series(f"/plots/n_eff/{key}")[0]) == STEPS
    assert recording.events()


@pytest.mark.parametrize(("live", "share", "else_"), [(False, FILE_DUTY, "present"), (True, DUTY, "numbers")])
def test_pictures_take_no_more_than_their_share_of_the_time(
    info: SessionInfo, monkeypatch: pytest.MonkeyPatch, live: bool, share: float, else_: Detail
) -> None:
    """A whole step takes two seconds, any other a tenth of one; there is one every second."""
    clock, details = SimpleNamespace(now=100.0), []

    class Told:
        def __init__(self, *_: Any, **__: Any) -> None: ...

        def step(self, step: int, detail: Detail) -> None:
            details.append(detail)
            clock.now += 0.1 if detail == else_ else 2.0

        def close(self) -> None: ...

    monkeypatch.setattr("app.recording.session.Writer", Told)
    monkeypatch.setattr("app.recording.session.monotonic", lambda: clock.now)
    writer = SessionWriter(None, live)  # type: ignore[arg-type]
    settings = SimpleNamespace(filters=KEYS, params=info.params, noise=info.noise)
    writer.begun(Begun(info, settings, 0))  # type: ignore[arg-type]
    for i in range(400):
        clock.now = max(clock.now, 100.0 + i)
        writer.stepped(Stepped("", i, settings, ()))  # type: ignore[arg-type]
    assert details[0] == ("all" if live else "usual")
    assert set(details) == {details[0], else_}
    assert 2.0 * details.count(details[0]) / 400.0 == pytest.approx(share, rel=0.1)


@pytest.mark.parametrize(("live", "expected"), [(False, 100), (True, 10)])
def test_quick_pictures_are_shown_no_more_often_than_anybody_sees_them(
    info: SessionInfo, monkeypatch: pytest.MonkeyPatch, live: bool, expected: int
) -> None:
    """They take no time at all; there are a hundred steps, ten times as many in a second as pictures for viewers."""
    clock, details = SimpleNamespace(now=100.0), []
    told = SimpleNamespace(step=lambda step, detail: details.append(detail), close=lambda: None)
    monkeypatch.setattr("app.recording.session.Writer", lambda *_, **__: told)
    monkeypatch.setattr("app.recording.session.monotonic", lambda: clock.now)
    writer = SessionWriter(None, live)  # type: ignore[arg-type]
    settings = SimpleNamespace(filters=KEYS, params=info.params, noise=info.noise)
    writer.begun(Begun(info, settings, 0))  # type: ignore[arg-type]
    for i in range(100):
        clock.now = 100.0 + (i + 1e-3) / (10.0 * PICTURES)
        writer.stepped(Stepped("", i, settings, ()))  # type: ignore[arg-type]
    assert len([detail for detail in details if detail in ("all", "usual")]) == pytest.approx(expected, abs=1)


# A particle that somebody looks at ------------------------------------------------------------------------------------


def test_a_picked_particle_says_what_it_weighs(info: SessionInfo, steps: list[SessionStep], tmp_path: Path) -> None:
    chosen = [("dfs", 7), ("dfs", int(steps[1].filters["dfs"].measures.best)), ("fs2", 3), ("fs2", K), None]
    shown = [(dataclasses.replace(step, picked=pick), "usual") for step, pick in zip(steps, chosen, strict=False)]
    recording = written(info, tmp_path / "a.rrd", shown)  # type: ignore[arg-type]
    labels = {key: dict(recording.rows(f"/world/{key}/picked", "Points3D:labels", "step")) for key in ("dfs", "fs2")}
    for step, key in ((1, "dfs"), (2, "dfs"), (3, "fs2")):
        _, particle = chosen[step - 1]  # type: ignore[misc]
        weight = K * np.exp(steps[step - 1].filters[key].trace.weighted.log_w[particle])
        assert labels[key][step] == [f"particle {particle}, weight times K: {weight:.3g}"]
    heaviest = labels["dfs"][2][0]
    assert float(heaviest.rpartition(" ")[2]) > 1.0
    assert set(labels["fs2"]) == {3}  # there is no particle K


# Files and the program ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", [True, False])
def test_a_file_without_an_index_holds_the_same(
    info: SessionInfo, steps: list[SessionStep], tmp_path: Path, index: bool
) -> None:
    path = tmp_path / "a.rrd"
    writer = Writer(info, partial(FileStream, path) if index else partial(FileStream, path, index=False))
    for step in steps:
        writer.step(step)
    writer.close()
    reader = open_reader(path)
    if index:
        assert reader.store().schema().entity_paths()
    else:
        with pytest.raises(RuntimeError):
            reader.store()
    recording = Recording(path)
    for key in KEYS:
        _, n_eff = recording.series(f"/plots/n_eff/{key}")
        np.testing.assert_array_equal(n_eff, [step.filters[key].measures.n_eff for step in steps])
    assert recording.params()["seed"] == info.seed
    assert len(reader.blueprints()) == 1


def test_what_the_program_leaves_lying_about_goes_with_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Also from a program that has to be ended."""
    monkeypatch.setattr("app.recording.program.binary", lambda: Path("/bin/sh"))
    program = Program(["-c", 'mkdir "$TMPDIR/deep"; date > "$TMPDIR/deep/left"; echo "$TMPDIR"; exec sleep 100'])
    until = time.monotonic() + 20.0
    while not program.said() and time.monotonic() < until:
        time.sleep(0.01)
    folder = Path(program.said())
    assert (folder / "deep" / "left").exists()
    assert folder.name.startswith("dualslam-")
    assert folder != Path(os.environ.get("TMPDIR", "/tmp"))
    assert program.alive
    program.close()
    assert not program.alive
    assert not folder.exists()
    program.close()
