"""Mistakes are told from numbers: each where it is made, and none of a filter that is right."""

from __future__ import annotations

import dataclasses
import io
import math
from collections.abc import Iterable
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from app import session
from app.diagnosis.diagnose import diagnose
from app.diagnosis.evidence import Record, record_of
from app.diagnosis.findings import Case
from app.diagnosis.marks import Marks, marks_of
from app.diagnosis.signatures import LEVEL, SIGNATURES, look
from app.errors import UsageError
from app.live.engine import Engine
from app.live.script import Check, replay_of, script_of
from app.options import MISTAKES as NAMES
from app.panel import now
from app.recording import Recorder
from app.recording.limits import limits_for
from app.recording.reading import Recording
from app.recording.texts import about
from app.report import print_report
from app.run import check_mistake
from app.summary import Summary
from app.types import SessionStep
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.features import Point
from slam.mistakes import MISTAKES, with_mistake
from slam.resampling import SCHEMES
from slam.types import Floats, Noise, Params
from tests.slam import plain

SIBLINGS = ["dfs", "fs2", "fs1"]
PAIRS = [(name, key) for name, mistake in MISTAKES.items() for key in mistake.phases]
FINE = Noise(speed=0.2, turn=0.1, range=0.001, bearing=0.0005)
"""With which densities of a FastSLAM 1.0 particle are below what plain numbers hold."""
START = np.diag([0.1, 0.1, 0.02]) ** 2
COPYING = {
    "temper": 1.0, "inflate_r": 1.0, "gate": 0.9, "gate_new": 0.0, "floor_lateral": 1e-3, "floor_angle": 5e-4,
}  # fmt: skip
"""With which walls are mapped twice."""


def record(
    step: Any, seed: int, noise: Noise = plain.WORLD_NOISE, steps: int = 25, start: Floats = START, **changes: Any
) -> Record:
    params = Params(**{"particles": 20, "believed": noise, "association": "known", **changes})
    state, marks = ESTIMATORS["dfs"].init(Point(), np.zeros(3), start, params), []
    for number, frame in enumerate(plain.simulate(seed=seed, noise=noise, steps=steps).frames):
        state, trace = step(np.random.default_rng(number), state, frame, params)
        marks.append(marks_of(trace, frame, params))
    return record_of(np.arange(1, len(marks) + 1), Marks._fields, np.array(marks), [])


def made_by(key: str, steps: Iterable[SessionStep]) -> Record:
    rows = [step.filters[key].evidence.marks for step in steps]
    return record_of(np.arange(1, len(rows) + 1), Marks._fields, np.array(rows), [])


def of_world(key: str, world: str, steps: int, changes: dict[str, Any], **options: Any) -> Record:
    source = build(world, **options)
    params = source.params(**{"particles": 15, **changes})
    return made_by(key, session.steps(session.make_info(source, [ESTIMATORS[key]], params, seed=2, count=steps)))


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
    found = of_world(key, "field", 20, params) if key == "ekf" else record(ESTIMATORS[key].step, 3, **params)
    assert named(found) == []


@pytest.mark.parametrize("key", SIBLINGS)
@pytest.mark.parametrize("deviation", [1e-9, 1e-12, 1e-14, 1e-16])
def test_draws_that_floating_point_cannot_tell_apart_say_nothing(key: str, deviation: float) -> None:
    """From a start that is known: what is drawn comes out alike, in more and more particles, of poses or of maps."""
    step, exact = ESTIMATORS[key].step, np.zeros((3, 3))
    still = dataclasses.replace(plain.WORLD_NOISE, speed=deviation, turn=deviation)
    sharp = Noise(*4 * [deviation])
    assert named(record(step, 3, start=exact, believed=still)) == []
    assert named(record(step, 3, start=exact, believed=sharp)) == []
    told = {"dfs": sharp, "fs2": sharp, "fs1": still}[key]
    looked = look(record(step, 3, start=exact, believed=told))
    assert ("unsampled-proposal" in looked.open) == (deviation < 1e-11)


@pytest.mark.parametrize("number", range(30))
def test_a_right_filter_is_clean_whatever_its_settings(number: int) -> None:
    """At random, most of them far beyond anything sensible, and changed while it runs."""
    rng = np.random.default_rng(number)

    def one(*choices: Any) -> Any:
        return choices[rng.integers(len(choices))]

    def noise(own: Noise) -> Noise:
        low, high = one((-14, -6), (0, 6), (-12, 4))
        moving = {name: one(0.0, 1.0, 1.0) for name in ("speed", "turn", "odometry")}
        fields = {**moving, "range": 1.0, "bearing": 1.0}
        return one(own, Noise(**{name: share * 10.0 ** rng.uniform(low, high) for name, share in fields.items()}))

    def settings() -> dict[str, Any]:
        return {
            "particles": one(1, 2, 3, 9, 30),
            "association": one("known", "nearest", "jcbb"),
            "gate": one(0.99, 1e-6, 1.0 - 1e-12),
            "gate_known": one(1.0, 0.9, 1e-9),
            "gate_new": one(0.0, 0.999999),
            "weighting": one("marginal", "joint"),
            "proposal_weight": one("integrated", "drawn"),
            "inflate_r": one(1.0, 1e-12, 1e12),
            "temper": one(1.0, 0.1, 1e-300),
            "floor_lateral": one(0.05, 0.0),
            "merge_walls": one(True, False),
            "most_new": one(0, 2),
            "log_p_new": one(0.0, -1e6, 1e6),
            "resampler": one(*SCHEMES),
            "resample_below": one(0.0, 0.75, 1.0),
        }

    source = build(one("paper-line", "field", "corridor", "hall"))
    params = source.params(believed=noise(source.noise), **settings())
    changes = [session.Change(int(at), dataclasses.replace(params, **settings())) for at in rng.integers(2, 12, 2)]
    info = session.make_info(source, list(ESTIMATORS.values()), params, noise(source.noise), seed=number, count=12)
    with np.errstate(all="ignore"):
        steps = list(session.steps(info, changes))
    for key in ESTIMATORS:
        assert named(made_by(key, steps)) == []


def test_huge_log_weights_are_no_contradiction() -> None:
    """Those of particles that are not resampled grow to 1e10, and then a step adds next to nothing."""
    source = build("field")
    believed = dataclasses.replace(source.noise, range=1e-5, bearing=1e-6)
    params = source.params(particles=15, association="known", believed=believed, resample_below=0.0)
    change = session.Change(8, dataclasses.replace(params, temper=1e-9))
    info = session.make_info(source, [ESTIMATORS["fs1"]], params, seed=2, count=12)
    steps = list(session.steps(info, [change]))
    assert steps[-1].filters["fs1"].trace.weighted.log_w.min() < -1e9
    assert named(made_by("fs1", steps)) == []


def test_a_covariance_that_is_as_good_as_singular_stops_nothing() -> None:
    """A sensor that is believed a million times more than it deserves leaves a joint covariance of rounding errors."""
    changes = {"association": "known", "inflate_r": 1e-12}
    source = build("paper-line")
    info = session.make_info(source, [ESTIMATORS["ekf"]], source.params(**changes), seed=0, count=12)
    steps = list(session.steps(info))
    assert any(np.diag(step.filters["ekf"].trace.weighted.P[0]).min() < 0.0 for step in steps)
    assert named(made_by("ekf", steps)) == []


@pytest.mark.parametrize("key", ESTIMATORS)
@pytest.mark.parametrize("world", ["corridor", "hall"])
def test_a_right_filter_on_walls_is_clean(key: str, world: str) -> None:
    assert named(of_world(key, world, 25, {"most_new": 3})) == []


@pytest.mark.parametrize("key", SIBLINGS)
@pytest.mark.parametrize("world", ["corridor", "hall"])
def test_walls_that_are_merged_are_no_mistake(key: str, world: str) -> None:
    source = build(world)
    info = session.make_info(source, [ESTIMATORS[key]], source.params(particles=15, **COPYING), seed=2, count=14)
    steps = list(session.steps(info, [session.Change(10, source.params(particles=15, merge_walls=True))]))
    merged = [step.filters[key].trace.merged for step in steps[9:]]
    assert sum(int((younger >= 0).sum()) for younger in merged if younger is not None) > 20
    assert named(made_by(key, steps)) == []


@pytest.mark.parametrize("key", SIBLINGS)
def test_a_change_of_the_number_of_particles_is_no_mistake(key: str) -> None:
    source = build("field")
    info = session.make_info(source, [ESTIMATORS[key]], source.params(particles=15), seed=2, count=20)
    changes = [
        session.Change(at, dataclasses.replace(info.params, particles=K)) for at, K in ((8, 40), (12, 1), (15, 3))
    ]
    assert named(made_by(key, session.steps(info, changes))) == []


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


def test_one_coincidence_says_nothing() -> None:
    looked = look(made(undrawn=[0.5, 0.1], twins=[1.0, 1.0], gained=[0.0, 0.0]))
    assert not looked.findings
    assert {"unsampled-proposal", "shared-maps"} <= set(looked.clean)


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


@pytest.mark.parametrize("name", list(MISTAKES))
def test_a_run_says_what_is_wrong_and_what_shows_it(name: str) -> None:
    """On the terminal, and on the page of its recording."""
    source = build("paper-line")
    filters = session.estimators([key for key in ("dfs", "fs2", "fs1") if key in MISTAKES[name].phases], name)
    info = session.make_info(source, filters, source.params(particles=4), count=1)._replace(mistake=name)
    summary, out = Summary(), io.StringIO()
    session.run(info, [summary])
    print_report(info, summary, Console(file=out, width=1000))
    for text in (out.getvalue(), about(info, limits_for(1))):
        assert MISTAKES[name].what in text
        assert f"What shows it: {MISTAKES[name].signature}" in text
