"""Mistakes are told from numbers: each where it is made, and none of a filter that is right."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest

from app import session
from app.diagnosis.diagnose import diagnose
from app.diagnosis.evidence import Record, record_of
from app.diagnosis.findings import Case
from app.diagnosis.marks import Marks, marks_of, misplaced_first
from app.diagnosis.signatures import LEVEL, SIGNATURES, look
from app.errors import UsageError
from app.live.engine import Engine
from app.live.script import Check, replay_of, script_of
from app.options import MISTAKES as NAMES
from app.panel import now
from app.recording import Recorder
from app.recording.reading import Recording
from app.run import check_mistake
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.features import Point
from slam.mistakes import MISTAKES, with_mistake
from slam.resampling import SCHEMES
from slam.types import Noise, Params, ResamplerName
from tests.slam import plain

PAIRS = [(name, key) for name, mistake in MISTAKES.items() for key in mistake.phases]
FINE = Noise(speed=0.2, turn=0.1, range=0.001, bearing=0.0005)
"""With which densities of a FastSLAM 1.0 particle are below what plain numbers hold."""


def record(step: Any, seed: int, noise: Noise = plain.WORLD_NOISE, steps: int = 25, **changes: Any) -> Record:
    params = Params(**{"particles": 20, "believed": noise, "association": "known", **changes})
    state, marks = ESTIMATORS["dfs"].init(Point(), np.zeros(3), np.diag([0.1, 0.1, 0.02]) ** 2, params), []
    for number, frame in enumerate(plain.simulate(seed=seed, noise=noise, steps=steps).frames):
        state, trace = step(np.random.default_rng(number), state, frame, params)
        marks.append(marks_of(trace, frame, params))
    return record_of(np.arange(1, len(marks) + 1), Marks._fields, np.array(marks), [])


def of_world(key: str, world: str, steps: int, changes: dict[str, Any], **options: Any) -> Record:
    source = build(world, **options)
    info = session.make_info(source, [ESTIMATORS[key]], source.params(particles=15, **changes), seed=2, count=steps)
    rows = [step.filters[key].evidence.marks for step in session.steps(info)]
    return record_of(np.arange(1, steps + 1), Marks._fields, np.array(rows), [])


def named(found: Record) -> list[str]:
    return [finding.mistake for finding in look(found).findings]


def made(**marks: list[float]) -> Record:
    """A run of which only some marks are known."""
    rows = np.array(list(marks.values())).T
    return record_of(np.arange(1, len(rows) + 1), list(marks), rows, [])


def test_there_is_one_for_each_mistake() -> None:
    assert tuple(SIGNATURES) == tuple(MISTAKES) == NAMES


@pytest.mark.parametrize(("name", "key"), [pair for pair in PAIRS if pair[0] != "plain-weights"])
@pytest.mark.parametrize("seed", [3, 4])
def test_a_mistake_is_named_and_no_other(name: str, key: str, seed: int) -> None:
    assert named(record(with_mistake(ESTIMATORS[key], name).step, seed, steps=60)) == [name]


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_underflow(seed: int) -> None:
    (found,) = look(record(with_mistake(ESTIMATORS["fs1"], "plain-weights").step, seed, FINE)).findings
    assert found.mistake == "plain-weights"
    assert found.chance == 0.0
    assert named(record(ESTIMATORS["fs1"].step, seed, FINE)) == []


def test_where_nothing_underflows_there_is_nothing_to_find() -> None:
    looked = look(record(with_mistake(ESTIMATORS["dfs"], "plain-weights").step, 3))
    assert not looked.findings
    assert "plain-weights" in looked.clean


@pytest.mark.parametrize("key", ESTIMATORS)
@pytest.mark.parametrize(
    "changes",
    [
        *({"resampler": name} for name in SCHEMES),
        {"resample_below": 0.0},
        {"resample_below": 1.0},
        {"association": "jcbb", "gate_new": 0.0},
        {"association": "nearest", "temper": 0.1, "inflate_r": 9.0},
        {"weighting": "joint", "proposal_weight": "drawn"},
        {"gate_known": 0.9},
        {"particles": 1},
    ],
)
def test_a_right_filter_is_clean(key: str, changes: dict[str, Any]) -> None:
    params = {"particles": 20, **changes}
    if key == "ekf":
        source = build("field")
        info = session.make_info(source, [ESTIMATORS[key]], source.params(**params), seed=2, count=20)
        rows = [step.filters[key].evidence.marks for step in session.steps(info)]
        assert named(record_of(np.arange(1, 21), Marks._fields, np.array(rows), [])) == []
    else:
        assert named(record(ESTIMATORS[key].step, 3, **params)) == []


@pytest.mark.parametrize("key", ESTIMATORS)
@pytest.mark.parametrize(("world", "merge"), [("corridor", False), ("hall", True)])
def test_a_right_filter_on_walls_is_clean(key: str, world: str, merge: bool) -> None:
    assert named(of_world(key, world, 25, {"merge_walls": merge, "most_new": 3})) == []


def test_a_change_of_the_number_of_particles_is_no_mistake() -> None:
    source = build("field")
    info = session.make_info(source, [ESTIMATORS["fs2"]], source.params(particles=15), seed=2, count=20)
    change = session.Change(8, dataclasses.replace(info.params, particles=40))
    rows = [step.filters["fs2"].evidence.marks for step in session.steps(info, [change])]
    assert named(record_of(np.arange(1, 21), Marks._fields, np.array(rows), [])) == []


# One by one, by hand --------------------------------------------------------------------------------------------------


def test_an_old_recording_has_no_marks() -> None:
    looked = look(record_of(np.arange(1, 4), ["n_eff"], np.ones((3, 1)), []))
    assert not looked.findings
    assert looked.open == NAMES


@pytest.mark.parametrize(("chance", "told"), [(0.5, "open"), (0.01, "named")])
def test_outliving_needs_to_be_unlikely(chance: float, told: str) -> None:
    found = made(first_lived=[1.0] * 4, first_expected=[chance] * 4, misplaced=[0.0] * 4)
    looked = look(found)
    assert ("keep-first" in looked.open) == (told == "open")
    if told == "named":
        (finding,) = looked.findings
        assert finding.chance == pytest.approx(1e-8)
        assert finding.chance < LEVEL
        np.testing.assert_array_equal(finding.steps, [1, 2, 3, 4])
    once = made(first_lived=[1.0] * 9 + [0.0], first_expected=[0.01] * 10, misplaced=[0.0] * 10)
    assert "keep-first" in look(once).clean


@pytest.mark.parametrize("scheme", SCHEMES)
def test_where_a_scheme_puts_the_first_particle(scheme: ResamplerName) -> None:
    """Over many weights the scheme never misplaces it; that the mistake does shows where the scheme has no choice."""
    rng, params, caught, due = np.random.default_rng(5), Params(resampler=scheme), 0, 0
    for _ in range(300):
        w = rng.dirichlet(np.full(12, 0.7))
        selected = SCHEMES[scheme](rng, w, 12)
        assert not misplaced_first(w, selected, params) > 0.0
        if selected[0] != 0:
            due += 1
            caught += misplaced_first(w, np.concatenate([[0], selected[1:]]), params) == 1.0
    assert due > 50
    least = {"systematic": 0.75, "residual": 0.3}.get(scheme, 0.0)
    assert caught >= least * due
    assert least or not caught


@pytest.mark.parametrize(
    ("mistake", "marks", "words"),
    [
        ("weights-not-reset", {"unequal": [0.0, math.log(3.0)]}, "a factor of up to 3"),
        ("plain-weights", {"contradicted": [0.0, math.inf], "exponent": [0.0, -812.0]}, "e^-812"),
        ("unwrapped-angles", {"angle": [0.1, 6.2], "otherwise": [0.0, 0.0]}, "355 degrees"),
        ("unwrapped-angles", {"angle": [0.1, 0.1], "otherwise": [0.0, 2.0]}, "2 observations"),
        ("unsampled-proposal", {"undrawn": [0.0, 1.0]}, "100%"),
        ("features-first", {"early": [0.0, 1.0]}, "before the pose"),
        ("resample-always", {"needless": [0.0, 1.0]}, "N_eff was not below"),
        ("shared-maps", {"gained": [0.0, 7.0], "twins": [0.0, 0.0]}, "gained 7 features"),
        ("shared-maps", {"gained": [0.0, 0.0], "twins": [0.0, 9.0]}, "9 particles"),
    ],
)
def test_what_a_finding_says(mistake: str, marks: dict[str, list[float]], words: str) -> None:
    (found,) = look(made(**marks)).findings
    assert found.mistake == mistake
    np.testing.assert_array_equal(found.steps, [2])
    assert (found.of, found.chance) == (2, 0.0)
    assert words in found.text
    assert not look(made(**{name: values[:1] for name, values in marks.items()})).findings


def test_numbers_that_rounding_explains_say_nothing() -> None:
    found = made(unequal=[1e-13], contradicted=[1e-13], exponent=[0.0], angle=[math.pi], otherwise=[0.0])
    assert not look(found).findings


# From a recording -----------------------------------------------------------------------------------------------------


def test_a_recording_tells_what_is_wrong_with_it(tmp_path: Path) -> None:
    """What it was made with says so, its titles do, and the diagnosis does by its numbers."""
    source, path = build("field"), tmp_path / "wrong.rrd"
    filters = session.estimators(["fs2", "ekf"], "features-first")
    assert [f.title for f in filters] == ["FastSLAM 2.0 (features-first)", "EKF-SLAM"]
    info = session.make_info(source, filters, source.params(particles=10), seed=1, count=15)
    session.run(info._replace(mistake="features-first"), [Recorder(path)])
    recording = Recording(path)
    assert recording.params()["mistake"] == "features-first"
    wrong, right = (recording.evidence(key) for key in ("fs2", "ekf"))
    assert named(wrong) == ["features-first"]
    assert named(right) == []
    case = Case("fs2", "FastSLAM 2.0", False, {}, wrong)
    assert [f.kind for f in diagnose(case).findings if f.topic == "mistake"] == ["features-first"]


# On the command line and live -----------------------------------------------------------------------------------------


def test_where_one_cannot_make_it() -> None:
    with pytest.raises(UsageError, match=r"make in Dual FastSLAM and FastSLAM 1.0; expected --filters with fs2$"):
        check_mistake("features-first", ("dfs", "fs2", "fs1"))
    with pytest.raises(UsageError, match=r"cannot make in EKF-SLAM; expected --filters with dfs, fs2 or fs1$"):
        check_mistake("keep-first", ("dfs", "ekf"))
    check_mistake("features-first", ("fs2",))


def test_a_mistake_is_made_after_a_reset_and_again_in_a_replay() -> None:
    """The same session headless: with the mistake bit for bit, without it not."""
    source = build("paper-line")
    filters = session.estimators(["dfs", "ekf"])
    engine = Engine(session.make_info(source, filters, source.params(particles=10), seed=1))
    engine.start()
    try:
        engine.reset(mistake="resample-always")
        engine.step(6)
        status = engine.wait(lambda status: status.step == 6)
        assert status.info.mistake == "resample-always"
        assert "resample-always" in now.table(status)
        scripts: SimpleQueue[dict[str, Any]] = SimpleQueue()
        engine.call(lambda history: scripts.put(script_of(history)))
        script = scripts.get(timeout=30.0)
        for mistake, kept in ((None, "resample-always"), ("", "")):
            number = engine.status.number
            engine.reset(mistake=mistake)
            assert engine.wait(lambda status, old=number: status.number > old).info.mistake == kept
    finally:
        engine.close()

    replay = replay_of(script, "", "here")
    assert replay.mistake == "resample-always"
    for mistake, same in ((replay.mistake, True), ("", False)):
        info = session.make_info(
            source, session.estimators(replay.filters, mistake), replay.changes[0][1].params, seed=1
        )
        check = Check(replay)
        session.run(info._replace(steps=6), [check])
        assert check.same == same
    with pytest.raises(UsageError, match="is no session"):
        replay_of({**script, "mistake": "none such"}, "", "here")
