"""A live session without any page: settings, time travel, branches, events, replay."""

from __future__ import annotations

import dataclasses
import json
import math
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from app import session
from app.errors import UsageError
from app.events import Watch
from app.live.engine import Begun, Engine, Forked, named_after
from app.live.history import MOST_BRANCHES, History, Snapshot, Snapshots
from app.live.script import Check, replay_of, script_of
from app.live.settings import MOST, Desk, Settings, changed, described, first_settings
from app.live.trend import Trend
from app.summary import dump
from app.types import heaviest_descendant
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.perception.matching import START
from slam.types import Noise, Params
from tests.app.live import PATIENCE, Notes, at, change

KEYS = ("dfs", "fs2", "fs1")


@pytest.fixture(scope="module")
def source():
    return build("paper-line")


def info_of(source, keys=KEYS, seed=3, particles=20, **changes):
    filters = [ESTIMATORS[key] for key in keys]
    return session.make_info(source, filters, source.params(particles=particles, **changes), seed=seed, command="")


@pytest.fixture
def live(source):
    notes, made = Notes(), []

    def start(info=None, listeners=(), **options):
        engine = Engine(info or info_of(source), [notes, *listeners], **options)
        made.append(engine)
        engine.start()
        return engine, notes

    yield start
    for engine in made:
        engine.close(30.0)
        assert not engine._thread.is_alive()


def poses(stepped, key="dfs"):
    return stepped.step.filters[key].trace.weighted.s


# Settings -----------------------------------------------------------------------------------------------------------


def some_settings():
    return Settings(Params(particles=50), Noise(), ("dfs", "fs2"))


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("particles", 70, 70),
        ("particles", 70.4, 70),
        ("particles", 0, 1),
        ("particles", -1e300, 1),
        ("particles", 10**400, MOST),
        ("particles", math.inf, MOST),
        ("gate", 2.0, 1.0 - 1e-9),
        ("gate", 0.0, 1e-9),
        ("temper", 0.5, 0.5),
        ("temper", -3, 1e-9),
        ("resample_below", 7, 1.0),
        ("association", "nearest", "nearest"),
        ("orthogonal", True, True),
        ("log_p_new", -math.inf, -1e6),
    ],
)
def test_a_value_is_brought_between_its_limits(name, value, expected):
    found = getattr(changed(some_settings(), {name: value}).params, name)
    assert found == pytest.approx(expected)
    assert type(found) is type(getattr(Params(), name))


@pytest.mark.parametrize(
    "changes",
    [
        {"particles": math.nan},
        {"particles": "many"},
        {"particles": None},
        {"particles": True},
        {"particles": [1]},
        {"association": "telepathy"},
        {"association": 3},
        {"orthogonal": 1},
        {"believed": 3.0},
        {"believed.nothing": 3.0},
        {"noise.__class__": 3.0},
        {"noise.range": "x"},
        {"nothing": 1.0},
        {"": 1.0},
        {"filters": "dfs"},
        {"filters": []},
        {"filters": ["nothing", 3]},
        {"filters": None},
    ],
)
def test_what_is_no_value_changes_nothing(changes):
    assert changed(some_settings(), changes) == some_settings()


def test_changes_of_noise_belief_and_filters():
    settings = changed(some_settings(), {"noise.range": 0.2, "believed.range": 0.0, "filters": ["ekf", "dfs", "x"]})
    assert settings.noise.range == 0.2
    assert 0.0 < settings.params.believed.range < 1e-6  # no filter can believe in a perfect sensor
    assert settings.filters == ("dfs", "ekf")
    assert changed(settings, {"noise.missing": 3}).noise.missing == 1.0
    told = described(some_settings(), settings)
    assert told == (
        f"believed.range: 0.003 -> {settings.params.believed.range}",
        "noise.range: 0.003 -> 0.2",
        "filters: dfs fs2 -> dfs ekf",
    )
    assert named_after(40, some_settings(), settings) == "40-range-1e-09-range-0.2-more"
    assert named_after(40, some_settings(), some_settings()) == "40-again"


def test_a_desk_keeps_changes_of_many_threads():
    desk = Desk(some_settings())
    names = ("speed", "turn", "range", "bearing", "odometry")

    def write(name):
        for i in range(200):
            desk.change({f"noise.{name}": i / 1000})

    threads = [threading.Thread(target=write, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {getattr(desk.read().noise, name) for name in names} == {0.199}


# The engine ---------------------------------------------------------------------------------------------------------


def test_without_changes_it_is_the_session_of_a_run(live, source):
    engine, notes = live()
    engine.step(12)
    at(engine, 12)
    plain = list(session.steps(info_of(source)._replace(steps=12)))
    assert isinstance(notes.all[0], Begun)
    assert [stepped.step.index for stepped in notes.steps] == list(range(1, 13))
    for stepped, step in zip(notes.steps, plain, strict=True):
        for key in KEYS:
            np.testing.assert_array_equal(poses(stepped, key), step.filters[key].trace.weighted.s)


def test_a_change_holds_from_the_next_step_on_and_is_told(live):
    engine, notes = live()
    engine.step(3)
    at(engine, 3)
    change(engine, particles=77, noise__range=0.05)
    engine.step()
    status = at(engine, 4)
    last = notes.steps[-1]
    assert len(poses(last)) == 77
    assert last.step.noise.range == 0.05
    assert last.step.changes == ("particles: 20 -> 77", "noise.range: 0.003 -> 0.05")
    assert [event.text for _, _, event in status.told][-2:] != []
    assert any("particles: 20 -> 77" in event.text for _, _, event in status.told)
    assert all(stepped.step.changes == () for stepped in notes.steps[:3])


def test_every_step_has_one_set_of_parameters_while_a_slider_is_dragged(live):
    """Particles and belief are always changed together; every step has a pair that belongs together."""
    engine, notes = live(info_of(build("loop", features="landmarks"), particles=10))
    engine.speed(200.0)  # so that it does not come to the end of the world before
    engine.play()
    for i in range(200):
        engine.put({"particles": 10 + i, "believed.speed": 0.01 * (10 + i)})
        if i % 10 == 0:  # however slow the machine is, steps come in between
            made = engine.status.step
            engine.wait(lambda s, made=made: s.step > made or not s.playing)
    engine.speed(None)
    engine.wait(lambda s: not s.playing)
    engine.close(30.0)
    seen = {stepped.settings.params.particles for stepped in notes.steps}
    assert len(seen) > 5
    for stepped in notes.steps[1:]:
        params = stepped.settings.params
        assert stepped.step.params is params
        assert len(poses(stepped)) == params.particles
        if params.particles != 10:
            assert params.believed.speed == pytest.approx(0.01 * params.particles)


def test_it_pauses_at_the_end_and_says_so(live, source):
    engine, notes = live()
    engine.play()
    status = engine.wait(lambda s: "ends here" in s.message)
    assert not status.playing
    assert status.step == status.newest == len(source.steps) == len(notes.steps)


def test_run_to_an_event(live):
    engine, notes = live()
    engine.play(("resampled",))
    status = engine.wait(lambda s: bool(s.message))
    assert not status.playing
    assert "resampled" in status.message
    assert status.step == next(
        stepped.step.index
        for stepped in notes.steps
        if any(u.trace.did_resample for u in stepped.step.filters.values())
    )


def test_speed(live):
    engine, notes = live()
    engine.speed(20.0)
    engine.step()
    at(engine, 1)
    began = time.monotonic()
    engine.play()
    engine.wait(lambda s: s.step >= 11)
    assert time.monotonic() - began > 0.4
    engine.pause()
    engine.wait(lambda s: not s.playing)
    count = len(notes.steps)
    time.sleep(0.2)
    assert len(notes.steps) == count
    engine.speed(None)


def test_a_step_of_the_past_is_what_it_was(live):
    engine, notes = live()
    engine.step(10)
    at(engine, 10)
    change(engine, particles=33, filters=("dfs", "ekf"))
    engine.step(10)
    at(engine, 20)
    for index in (1, 7, 10, 11, 19, 20):
        engine.go(index)
        status = at(engine, index)
        was = notes.steps[index - 1].step
        assert status.taken.step.changes == was.changes
        assert list(status.taken.step.filters) == list(was.filters)
        for key in was.filters:
            now = status.taken.step.filters[key]
            np.testing.assert_array_equal(now.trace.weighted.s, was.filters[key].trace.weighted.s)
            np.testing.assert_array_equal(now.trace.weighted.log_w, was.filters[key].trace.weighted.log_w)
            assert now.measures.features == was.filters[key].measures.features
    assert len(notes.steps) == 20  # nothing of it was a new step
    engine.go(0)
    status = at(engine, 0)
    assert status.taken is None
    engine.go(10**9)
    at(engine, 20)
    engine.go(-5)
    at(engine, 0)


def test_a_filter_that_is_switched_on_late_is_what_it_would_have_been(live, source):
    engine, notes = live()
    engine.step(8)
    at(engine, 8)
    change(engine, filters=("dfs", "ekf"), particles=31)
    engine.step(8)
    at(engine, 16)
    change(engine, filters=("dfs", "fs2", "ekf"))
    engine.step(4)
    at(engine, 20)
    params = source.params(particles=20)
    later = dataclasses.replace(params, particles=31)
    info = info_of(source, ("dfs", "fs2", "ekf"))._replace(steps=20)
    plain = list(session.steps(info, [session.Change(9, later)]))
    for key in ("dfs", "fs2", "ekf"):
        np.testing.assert_array_equal(poses(notes.steps[-1], key), plain[-1].filters[key].trace.weighted.s)
    assert list(notes.steps[-1].step.filters) == ["dfs", "fs2", "ekf"]


def test_a_change_in_the_past_makes_a_branch(live, source):
    engine, notes = live()
    engine.step(20)
    at(engine, 20)
    engine.go(12)
    at(engine, 12)
    change(engine, particles=44)
    engine.step(3)
    status = at(engine, 15)
    assert status.branch == "12-particles-44"
    forked = next(item for item in notes.all if isinstance(item, Forked))
    assert (forked.name, forked.parent, forked.at) == ("12-particles-44", "", 12)
    assert status.branches == (("", "", 0, 20), ("12-particles-44", "", 12, 15))
    params = source.params(particles=20)
    changes = [session.Change(13, dataclasses.replace(params, particles=44))]
    plain = list(session.steps(info_of(source)._replace(steps=15), changes))
    np.testing.assert_array_equal(poses(notes.steps[-1]), plain[-1].filters["dfs"].trace.weighted.s)
    engine.to_branch("")
    status = at(engine, 20, "")
    assert status.settings.params.particles == 20
    engine.step()
    assert at(engine, 21, "").branches[1] == ("12-particles-44", "", 12, 15)
    engine.to_branch("12-particles-44")
    engine.go(14)
    at(engine, 14)
    engine.fork()
    engine.step()
    status = at(engine, 15, "14-again")
    assert status.branches[-1] == ("14-again", "12-particles-44", 14, 15)
    np.testing.assert_array_equal(poses(notes.steps[-1]), plain[-1].filters["dfs"].trace.weighted.s)


def test_a_branch_from_before_its_parent_began_is_one_of_the_grandparent(live):
    engine, _ = live()
    engine.step(10)
    at(engine, 10)
    engine.go(6)
    at(engine, 6)
    engine.fork("a")
    engine.step(2)
    at(engine, 8, "a")
    engine.go(3)
    at(engine, 3)
    engine.fork("b")
    engine.step()
    assert at(engine, 4, "b").branches[-1] == ("b", "", 3, 4)


def test_playing_through_the_past_makes_nothing_new(live):
    engine, notes = live()
    engine.step(10)
    at(engine, 10)
    engine.go(4)
    at(engine, 4)
    engine.step(6)
    status = at(engine, 10)
    assert status.branches == (("", "", 0, 10),)
    assert len(notes.steps) == 10
    engine.step()
    at(engine, 11)
    assert len(notes.steps) == 11


def test_from_a_branch_back_to_the_first_run_and_on(live, source):
    """Where the branch stands one step before the end of the first run, it is not taken for it."""
    engine, notes = live()
    engine.step(20)
    at(engine, 20)
    engine.go(10)
    at(engine, 10)
    change(engine, particles=35)
    engine.step(9)
    at(engine, 19)
    engine.to_branch("")
    status = at(engine, 20, "")
    plain = list(session.steps(info_of(source)._replace(steps=22)))
    now = status.taken.step.filters["dfs"].trace.weighted.s
    np.testing.assert_array_equal(now, plain[19].filters["dfs"].trace.weighted.s)
    engine.step(2)
    at(engine, 22, "")
    np.testing.assert_array_equal(poses(notes.steps[-1]), plain[21].filters["dfs"].trace.weighted.s)


def test_events_of_the_past_are_those_that_were_told(live, monkeypatch):
    """Also what depends on what was before, such as loops that close; and nothing is lost by having gone back."""
    monkeypatch.setattr("app.live.history.SNAPSHOTS", 1)  # so that most steps lie between two of them
    world = build("loop", features="landmarks")
    engine, notes = live(info_of(world, ("dfs",), particles=20))
    engine.step(240)
    at(engine, 240)
    engine.go(100)
    at(engine, 100)
    engine.go_newest()
    at(engine, 240)
    engine.step(10)
    at(engine, 250)
    told = {stepped.step.index: stepped.events for stepped in notes.steps}
    watch, plain = Watch({"dfs": "Dual FastSLAM"}), session.steps(info_of(world, ("dfs",), particles=20))
    expected = [(step.index, event) for step in plain if step.index <= 250 for event in watch.step(step)]
    assert any(event.kind == "loop closed" for _, event in expected)
    assert [(index, event) for index, events in told.items() for event in events] == expected
    for index in {index for index, event in expected if event.kind == "loop closed"}:
        engine.go(index)
        assert at(engine, index).taken.events == told[index]


def test_only_the_last_place_counts(live):
    """Of those that were asked for while the session was busy; the others are not even computed."""
    engine, _ = live()
    engine.step(30)
    at(engine, 30)
    gate, gone = threading.Event(), []

    def watched(history):
        go = history.go
        history.go = lambda index, *more: (gone.append(index), go(index, *more))[1]
        gate.wait(PATIENCE)

    engine.call(watched)
    for index in range(29, 3, -1):
        engine.go(index)
    gate.set()
    assert at(engine, 4).step == 4
    assert gone == [4]


def test_a_particle_is_followed_to_its_heaviest_descendant():
    """Resampled to (0, 2, 2, 3), then, for another number of particles, to its numbers 1, 2, 3 in this order."""
    before = SimpleNamespace(trace=SimpleNamespace(weighted=SimpleNamespace(log_w=np.zeros(4)), selected=[0, 2, 2, 3]))
    before.trace.selected = np.array(before.trace.selected)
    weighted = SimpleNamespace(log_w=np.log([0.2, 0.5, 0.3]))
    after = SimpleNamespace(trace=SimpleNamespace(weighted=weighted, resized=np.array([1, 2, 3])))
    found = [heaviest_descendant(before, after, particle) for particle in (-1, 0, 1, 2, 3, 4)]
    assert found == [None, None, None, 1, 2, None]


def test_there_are_not_too_many_branches(live):
    engine, _ = live()
    engine.step(2)
    at(engine, 2)
    for _ in range(40):
        engine.fork()
    engine.step()
    status = engine.wait(lambda s: s.step == 3)
    assert len(status.branches) == MOST_BRANCHES


def test_reset(live):
    engine, notes = live()
    engine.step(5)
    at(engine, 5)
    change(engine, particles=7)
    engine.reset(seed=9)
    status = engine.wait(lambda s: s.number == 1)
    assert (status.step, status.info.seed, status.settings.params.particles) == (0, 9, 7)
    engine.step(2)
    at(engine, 2)
    assert len(poses(notes.steps[-1])) == 7
    engine.reset(source=build("loop", features="landmarks"))
    status = engine.wait(lambda s: s.number == 2)
    assert status.info.source.name == "loop"
    engine.step()
    at(engine, 1)
    assert [type(item) for item in notes.all].count(Begun) == 3


def test_snapshots_are_bounded_and_the_past_is_exact_all_the_same(source):
    world = build("loop", features="landmarks")
    info = info_of(world, ("dfs",), particles=5)
    settings = first_settings(world, ("dfs",), info.params, info.noise)
    history = History(info, settings)
    steps = min(len(world.steps), 250)
    seen = [history.advance(settings).step for _ in range(steps)]
    assert len(history.branch.snapshots) <= 96
    for index in (3, 47, steps // 2 + 1, steps - 1):
        again = history.go(index)
        np.testing.assert_array_equal(
            again.step.filters["dfs"].trace.weighted.s, seen[index - 1].filters["dfs"].trace.weighted.s
        )


def test_snapshots_are_fewer_the_longer_the_ancestry_that_they_hold(monkeypatch):
    """A megabyte for all of them, and particles that hardly take any."""
    monkeypatch.setattr("app.live.history.SNAPSHOT_BYTES", 1e6)

    def kept(*sizes):
        """How many of 400, whose ancestries are so large [bytes], one for each filter."""
        particles = SimpleNamespace(s=np.zeros((1, 3)), maps=SimpleNamespace(counts=np.zeros(1)))
        filters = {f"{i}": (particles, SimpleNamespace(nbytes=size)) for i, size in enumerate(sizes)}
        snapshots = Snapshots()
        for index in range(400):
            snapshots.keep(Snapshot(SimpleNamespace(done=index, filters=filters, track=None), Watch({})))
        return len(snapshots)

    assert kept(0) > 48
    assert 20 < kept(24_600) <= 40  # of 25 000 bytes, with those of the particle
    assert kept(12_100, 12_100) == kept(24_600)
    assert 4 <= kept(10**9) <= 8


def test_snapshots_are_fewer_with_scans_to_be_matched_with(monkeypatch):
    monkeypatch.setattr("app.live.history.SNAPSHOT_BYTES", 1e6)
    kept = {}
    for points in (0, 7, 70):
        track, snapshots = START._replace(scans=(np.zeros((points, 4)),) * 100), Snapshots()
        for index in range(400):
            snapshots.keep(Snapshot(SimpleNamespace(done=index, filters={}, track=track), Watch({})))
        kept[points] = len(snapshots)
    assert kept[0] > 48
    assert 20 < kept[7] <= 45  # 22 kB each
    assert kept[70] <= 8


def test_a_listener_that_fails_is_told_no_more(live):
    class Broken(Notes):
        def stepped(self, stepped):
            super().stepped(stepped)
            raise OSError(28, "No space left on device")

    broken = Broken()
    engine, notes = live(listeners=[broken])
    engine.step(3)
    at(engine, 3)
    assert len(broken.steps) == 1
    assert len(notes.steps) == 3


def test_trends(live):
    trend = Trend(length=5)
    engine, _ = live(listeners=[trend])
    engine.step(8)
    at(engine, 8)
    found = trend.of("", 8)
    np.testing.assert_array_equal(found.steps, [4, 5, 6, 7, 8])
    assert set(found.n_eff) == set(KEYS)
    assert np.all((found.n_eff["dfs"] > 0) & (found.n_eff["dfs"] <= 1))
    np.testing.assert_array_equal(trend.of("", 6).steps, [2, 3, 4, 5, 6])
    engine.go(6)
    at(engine, 6)
    engine.fork("x")
    change(engine, filters=("dfs",))
    engine.step()
    at(engine, 7, "x")
    found = trend.of("x", 7)
    np.testing.assert_array_equal(found.steps, [3, 4, 5, 6, 7])
    assert np.isnan(found.error["fs1"][-1])
    assert trend.of("nothing", 7).steps.shape == (0,)


# Replay -------------------------------------------------------------------------------------------------------------


def twenty_changes(engine):
    rng = np.random.default_rng(0)
    filters = (("dfs", "fs2"), ("dfs",), KEYS, ("ekf", "fs1"))
    for i in range(20):
        engine.put(
            {
                "particles": int(rng.integers(1, 60)),
                "noise.range": float(rng.uniform(0.001, 0.1)),
                "believed.range": float(rng.uniform(0.001, 0.1)),
                "resample_below": float(rng.uniform(0, 1)),
                "filters": filters[i % 4],
            }
        )
        engine.step()
        at(engine, i + 1)


def test_a_replay_is_the_session_bit_for_bit(live, source):
    engine, notes = live()
    twenty_changes(engine)
    engine.go(9)
    at(engine, 9)
    change(engine, particles=13, filters=("fs1", "ekf"))
    engine.step(4)
    at(engine, 13)
    texts = []
    engine.call(lambda history: texts.append(dump(script_of(history))))
    engine.step()
    at(engine, 14)
    script = json.loads(texts[0])
    assert [branch["steps"] for branch in script["branches"]] == [20, 13]
    assert len(script["branches"][0]["changes"]) == 20
    for name in (branch["name"] for branch in script["branches"]):
        replay = replay_of(script, name, "here")
        check = Check(replay)
        filters = tuple(ESTIMATORS[key] for key in replay.filters)
        first = replay.changes[0][1]
        info = info_of(source)._replace(
            filters=filters, params=first.params, noise=first.noise, seed=replay.seed, steps=replay.steps
        )
        session.run(info, [check], replay.session_changes())
        assert "bit for bit" in check.told()
        assert check.same
        was = {s.step.index: s for s in notes.steps if s.branch == name}
        last = list(session.steps(info, replay.session_changes()))[-1]
        for key, update in was[replay.steps].step.filters.items():
            np.testing.assert_array_equal(update.trace.weighted.s, last.filters[key].trace.weighted.s)
        other = Check(replay._replace(digest="0"))
        session.run(info, [other], replay.session_changes())
        assert "NOT" in other.told()
        assert not other.same


@pytest.mark.parametrize(
    "damage",
    [
        lambda s: s.pop("seed"),
        lambda s: s.update(seed=-1),
        lambda s: s.update(branches=3),
        lambda s: s["branches"][0]["changes"].clear(),
        lambda s: s["branches"][0]["changes"][0].update(step=4),
        lambda s: s["branches"][0]["changes"][0]["params"].update(particles=0),
        lambda s: s["branches"][0]["changes"][0]["params"].update(nothing=0),
        lambda s: s["branches"][0]["changes"][0].update(filters=["dfs", "x"]),
        lambda s: s["branches"][0].update(parent=""),
        lambda s: s.update(schema=7),
    ],
)
def test_a_damaged_session_is_one_sentence(source, damage):
    info = info_of(source)
    history = History(info, first_settings(source, KEYS, info.params, info.noise))
    history.advance(history.branch.settings(1))
    script = json.loads(json.dumps(script_of(history)))
    replay_of(script, "", "x.json")
    damage(script)
    with pytest.raises(UsageError, match=r"--replay x.json"):
        replay_of(script, "", "x.json")


def test_an_unknown_branch_suggests_one(source):
    info = info_of(source)
    history = History(info, first_settings(source, KEYS, info.params, info.noise))
    history.advance(history.branch.settings(1))
    with pytest.raises(UsageError, match="it has no branches"):
        replay_of(script_of(history), "x", "x.json")
    history.fork("40-particles-9", history.branch.settings(1))
    with pytest.raises(UsageError, match="40-particles-9"):
        replay_of(script_of(history), "40-particle-9", "x.json")
