"""The diagnosis of a session that runs: of the step where it stands, and of no other session, branch or later step."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterator

import pytest

from app import session
from app.diagnosis.collecting import Collector
from app.diagnosis.diagnose import diagnose
from app.diagnosis.findings import Case, Diagnosis
from app.diagnosis.words import markdown
from app.live.diagnoses import AWAITED, NOTHING, Diagnoses, Place, Teller, Told
from app.live.engine import Begun, Engine, Forked, Stepped
from app.live.settings import Settings
from app.live.trend import Trend
from app.pace import Pace
from app.panel.panel import NEWEST_STEP, NO_STEP, Panel
from app.types import SessionInfo, SessionStep
from scenarios.registry import build, worlds
from slam.estimators import ESTIMATORS
from tests.app.live import at
from tests.app.test_panel import Records, soon

PATIENCE = 20.0


def info_of(K: int = 20, keys: tuple[str, ...] = ("dfs",)) -> SessionInfo:
    source = build("paper-line")
    return session.make_info(source, [ESTIMATORS[key] for key in keys], source.params(particles=K), None, 3)


@pytest.fixture(scope="module")
def info() -> SessionInfo:
    return info_of()


@pytest.fixture(scope="module")
def settings(info: SessionInfo) -> Settings:
    return Settings(info.params, info.noise, ("dfs",))


@pytest.fixture(scope="module")
def steps(info: SessionInfo) -> list[SessionStep]:
    return list(session.steps(info._replace(steps=30)))


@pytest.fixture
def diagnoses(info: SessionInfo, settings: Settings, steps: list[SessionStep]) -> Diagnoses:
    """Of 30 steps, and of a branch that has left after the fifth."""
    made = Diagnoses()
    made.begun(Begun(info, settings, 0))
    for step in steps:
        made.stepped(Stepped("", step, settings, ()))
    made.forked(Forked("other", "", 5, info, settings))
    return made


class TestDiagnoses:
    def test_of_a_step(self, diagnoses: Diagnoses, info: SessionInfo, steps: list[SessionStep]) -> None:
        """As of a run that ends there."""
        collector = Collector()
        collector.begin(info)
        for step in steps[:20]:
            collector.step(step)
        found = [diagnose(case) for case in collector.cases()]
        told = diagnoses.of(Place(0, "", 20))
        assert told is not None
        assert told.of == Place(0, "", 20)
        assert told.text == f"*Up to step 20.*\n\n{markdown(found)}"
        assert set(told.steps) == {step for finding in found[0].findings for step in finding.steps}
        assert list(told.steps) == sorted(told.steps)

    def test_before_the_first_step(self, diagnoses: Diagnoses) -> None:
        assert diagnoses.of(Place(0, "", 0)) == Told(Place(0, "", 0), NOTHING, ())

    def test_a_branch_has_what_was_before_it_and_nothing_that_its_parent_did_later(
        self, diagnoses: Diagnoses, settings: Settings, steps: list[SessionStep]
    ) -> None:
        assert textless(diagnoses, "other", 5) == textless(diagnoses, "", 5)
        diagnoses.stepped(Stepped("other", steps[5], settings, ()))
        for step in steps[6:10]:
            harmed = dataclasses.replace(step, filters={})
            diagnoses.stepped(Stepped("other", harmed, settings, ()))
        assert textless(diagnoses, "other", 10) == textless(diagnoses, "", 6)
        assert textless(diagnoses, "", 10) != textless(diagnoses, "", 6)

    def test_another_session_is_not_told(self, diagnoses: Diagnoses, info: SessionInfo, settings: Settings) -> None:
        """Neither that before, although its status may still be on the page, nor one that has not begun."""
        assert diagnoses.of(Place(1, "", 5)) is None
        diagnoses.begun(Begun(info, settings, 1))
        assert diagnoses.of(Place(0, "", 5)) is None
        assert diagnoses.of(Place(0, "other", 5)) is None
        assert diagnoses.of(Place(1, "other", 5)) is None
        assert diagnoses.of(Place(1, "", 0)) is not None


def textless(diagnoses: Diagnoses, branch: str, step: int) -> str:
    """What is told, without where."""
    told = diagnoses.of(Place(0, branch, step))
    assert told is not None
    return told.text.partition("\n\n")[2]


class Slow:
    """Makes diagnoses when it is let."""

    def __init__(self) -> None:
        self.let, self.begun = threading.Event(), threading.Event()
        self.made: list[Place] = []

    def of(self, place: Place) -> Told | None:
        self.begun.set()
        assert self.let.wait(PATIENCE)
        self.made.append(place)
        if place.branch == "bad":
            raise OSError("no wisdom")
        return Told(place, f"told of {place.step}", ())


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Slow, Teller]]:
    monkeypatch.setattr("app.live.diagnoses.SOON", 0.01)
    source = Slow()
    teller = Teller(source)
    yield source, teller
    source.let.set()
    teller.close()


class TestTeller:
    def test_it_is_said_while_there_is_none_yet_and_the_last_that_was_wanted_comes_first(
        self, slow: tuple[Slow, Teller]
    ) -> None:
        source, teller = slow
        for step in range(1, 6):
            told = teller.told(Place(0, "", step), playing=False)
            assert told == Told(Place(0, "", step), AWAITED, ())
            assert source.begun.wait(PATIENCE)
        source.let.set()
        soon(lambda: teller.told(Place(0, "", 5), playing=False).text == "told of 5")
        assert [place.step for place in source.made] == [1, 5]

    @pytest.mark.parametrize(
        ("place", "playing", "fits"),
        [
            (Place(0, "a", 9), True, True),
            (Place(0, "a", 8), False, True),
            (Place(0, "a", 9), False, False),
            (Place(0, "a", 7), True, False),
            (Place(0, "b", 9), True, False),
            (Place(0, "b", 8), False, False),
            (Place(1, "a", 8), False, False),
            (Place(1, "a", 9), True, False),
        ],
    )
    def test_an_old_one_may_be_shown_while_steps_are_made_and_nothing_else(
        self, slow: tuple[Slow, Teller], place: Place, playing: bool, fits: bool
    ) -> None:
        source, teller = slow
        source.let.set()
        soon(lambda: teller.told(Place(0, "a", 8), playing=False).text == "told of 8")
        source.let.clear()
        assert (teller.told(place, playing).text == "told of 8") == fits
        assert (teller.told(place, playing).text == AWAITED) == (not fits)

    def test_it_takes_no_more_than_its_share_while_steps_are_made(
        self, slow: tuple[Slow, Teller], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """But where an old one does not do it is made at once."""
        monkeypatch.setattr(Pace, "due", False)
        source, teller = slow
        source.let.set()
        for step in range(1, 20):
            teller.told(Place(0, "", step), playing=True)
            soon(lambda: len(source.made) > 0)
        assert [place.step for place in source.made] == [1]
        soon(lambda: teller.told(Place(0, "other", 20), playing=True).text == "told of 20")
        soon(lambda: teller.told(Place(0, "other", 21), playing=False).text == "told of 21")

    def test_one_that_fails_is_a_sentence_and_the_next_is_made(self, slow: tuple[Slow, Teller]) -> None:
        source, teller = slow
        source.let.set()
        expected = "*No diagnosis of this step: no wisdom*"
        soon(lambda: teller.told(Place(0, "bad", 1), playing=False).text == expected)
        soon(lambda: teller.told(Place(0, "", 2), playing=False).text == "told of 2")

    def test_what_was_being_made_when_another_session_began_is_not_shown(
        self, diagnoses: Diagnoses, info: SessionInfo, settings: Settings, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def reset(case: Case) -> Diagnosis:
            monkeypatch.undo()
            diagnoses.begun(Begun(info, settings, 1))
            return diagnose(case)

        monkeypatch.setattr("app.live.diagnoses.diagnose", reset)
        teller = Teller(diagnoses)
        soon(lambda: "Up to step 20." in teller.told(Place(0, "", 20), playing=False).text)  # of the session before
        soon(lambda: teller.told(Place(1, "", 0), playing=False).text == NOTHING)
        assert "Up to" not in teller.told(Place(1, "", 20), playing=True).text
        teller.close()


@pytest.fixture
def live() -> Iterator[tuple[Engine, Panel, Diagnoses]]:
    trend, diagnoses = Trend(), Diagnoses()
    engine = Engine(info_of(100, ("dfs", "fs2")), [trend, diagnoses])
    engine.start()
    panel = Panel(engine, trend, Records(), list(worlds()), build, diagnoses=diagnoses)
    yield engine, panel, diagnoses
    panel.close()
    engine.close(PATIENCE)


def stands(live: tuple[Engine, Panel, Diagnoses], step: int, branch: str | None = None) -> Place:
    """Wait until the session stands there and the page says what there is to say, without any complaint."""
    engine, panel, diagnoses = live
    status = at(engine, step, branch)
    place = Place(status.number, status.branch, step)
    told = diagnoses.of(place)
    assert told is not None
    soon(lambda: panel.diagnosis.content == told.text)
    soon(lambda: list(panel.named.options) == [NO_STEP, *map(str, told.steps), NEWEST_STEP])
    assert "No diagnosis" not in told.text
    assert "nan" not in told.text
    assert panel._said == ""
    return place


def particles(diagnoses: Diagnoses, place: Place, key: str = "dfs") -> list[tuple[int, float]]:
    """The evidence of K, by step."""
    record = next(case for case in diagnoses._branches[place.branch].cases() if case.key == key).record
    return list(zip(record.steps.tolist(), record["particles"].tolist(), strict=True))


def test_a_person_changes_everything_while_it_runs(live: tuple[Engine, Panel, Diagnoses]) -> None:
    """K from 100 to 1, back, and to 500; a filter off and on; branches, and a reset in another world."""
    engine, panel, diagnoses = live
    trunk = stands(live, 0)
    ks = (100, 1, 100, 1, 500)
    for i, K in enumerate(ks):
        engine.put({"particles": K})
        engine.step(4)
        trunk = stands(live, 4 * (i + 1))
    for key in ("dfs", "fs2"):
        assert particles(diagnoses, trunk, key) == [(i + 1, float(ks[i // 4])) for i in range(20)]

    engine.put({"filters": ["fs2"]})
    engine.step(3)
    stands(live, 23)
    assert [step for step, _ in particles(diagnoses, trunk)] == list(range(1, 21))
    engine.put({"filters": ["dfs", "fs2", "ekf"], "particles": 30})
    engine.step(3)
    stands(live, 26)
    assert particles(diagnoses, trunk)[-4:] == [(20, 500.0), (24, 30.0), (25, 30.0), (26, 30.0)]

    engine.go(23)  # the EKF was not there
    stands(live, 23)
    assert "EKF" not in panel.diagnosis.content
    engine.go(6)
    stands(live, 6)
    engine.put({"particles": 40})
    engine.step(2)
    branch = stands(live, 8)
    assert branch.branch != ""
    assert particles(diagnoses, branch) == [(i, 100.0 if i < 5 else 1.0 if i < 7 else 40.0) for i in range(1, 9)]
    engine.to_branch("")
    stands(live, 26, "")

    engine.reset(source=build("corridor", length=30.0))
    engine.step(3)
    place = stands(live, 3)
    assert place == Place(1, "", 3)
    assert "Up to step 3." in panel.diagnosis.content
    assert [step for step, _ in particles(diagnoses, place, "fs2")] == [1, 2, 3]


def test_steps_that_are_named_can_be_looked_at_and_the_newest_again(live: tuple[Engine, Panel, Diagnoses]) -> None:
    engine, panel, _ = live
    engine.step(40)
    stands(live, 40)
    named = [step for step in panel.named.options if step not in (NO_STEP, NEWEST_STEP, "40")]
    for _ in range(2):
        panel.named.value = named[0]
        stands(live, int(named[0]))
        panel.named.value = NEWEST_STEP
        stands(live, 40)
        soon(lambda: panel.named.value == NO_STEP)
    for nonsense in ("1e9", "", "12345"):
        panel.named.value = nonsense
    stands(live, 40)
