"""What the log of a recording tells, and what happens to the file behind its back."""

from __future__ import annotations

import dataclasses
import errno
import os
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from app import session
from app.diagnosis.ancestry import findings
from app.diagnosis.evidence import Numbers, record_of
from app.diagnosis.findings import Case
from app.events import Blind, Watch
from app.loops import Loops, right_matches
from app.recording import Recorder
from app.recording.pipe import Pipe
from app.recording.reading import Recording
from app.types import best_descendant
from scenarios.registry import build, landmark_options
from slam.estimators import ESTIMATORS
from slam.phases import unweighed
from slam.types import IGNORED, NEW, UNKNOWN_TAG, Particles, Trace


def told(world: str, key: str, walls: bool = False, **changes: object) -> list[tuple[int, str]]:
    """Step and text of all events of a run."""
    source = build(world, **{} if walls else landmark_options(world))
    info = session.make_info(source, [ESTIMATORS[key]], source.params(**changes), seed=1)
    watch = Watch({key: ESTIMATORS[key].title})
    return [(step.index, event.text) for step in session.steps(info) for event in watch.step(step)]


@pytest.mark.parametrize("key", ["ekf", "fs2"])
def test_a_loop_is_told_to_close_when_it_does(key: str):
    closed = [step for step, text in told("loop", key, particles=20) if "closed a loop" in text]
    # 0.4 m a step: the start is seen from across the loop after 100 steps, and from itself after 250
    assert min(closed) > 100
    assert any(200 < step < 260 for step in closed)


def test_a_loop_of_walls_is_told_to_close_when_it_does():
    """0.4 m a step: the walls at the start are seen again after some 230 steps, and more of them until 290."""
    closed = [step for step, text in told("loop", "dfs", walls=True, particles=30) if "closed a loop" in text]
    assert min(closed) > 200
    assert any(step < 300 for step in closed)
    assert len(closed) < 10


def test_a_wrong_match_closes_no_loop():
    """The same session; but of everything that is seen it is told that it is something else."""
    source = build("loop")
    info = session.make_info(source, [ESTIMATORS["ekf"]], seed=1, count=300)
    told = {0: [], 1000: []}
    watches = {shift: Watch({"ekf": "EKF-SLAM"}) for shift in told}
    for step in session.steps(info):
        for shift, watch in watches.items():
            frame = step.frame._replace(tags=step.frame.tags + shift)
            told[shift] += [event.kind for event in watch.step(dataclasses.replace(step, frame=frame))]
    assert "loop closed" in told[0]
    assert "loop closed" not in told[1000]


@pytest.mark.parametrize(
    ("seen", "of_map", "right"),
    [
        ([7, 8, 9], [1, 8, 7], [True, False]),
        ([7, 8, UNKNOWN_TAG], [UNKNOWN_TAG, 8, 7], [True, False]),  # what nobody knows, taken for the same
        ([UNKNOWN_TAG] * 3, [UNKNOWN_TAG] * 3, [True, True]),  # a log: nobody knows
        ([UNKNOWN_TAG] * 3, [9, UNKNOWN_TAG, UNKNOWN_TAG], [False, False]),
    ],
)
def test_which_matches_are_right(seen: list[int], of_map: list[int], right: list[bool]):
    """The first is taken for feature 2, the second is new, the third is taken for feature 0."""
    maps = SimpleNamespace(tags=lambda k: np.array(of_map))
    trace = SimpleNamespace(n=np.array([[IGNORED] * 3, [2, NEW, 0]]), weighted=SimpleNamespace(maps=maps))
    assert right_matches(trace, np.array(seen), 1).tolist() == right  # type: ignore[arg-type]


def test_merged_walls_are_told_when_it_begins():
    """Of the best map; and not again at every step, as long as it goes on."""
    source = build("corridor")
    info = session.make_info(
        source, [ESTIMATORS["dfs"]], source.params(particles=2, merge_walls=True), seed=1, count=40
    )
    watch, said = Watch({"dfs": "Dual FastSLAM"}), []
    for step in session.steps(info):
        update = step.filters["dfs"]
        rows = np.full(update.trace.n.shape, NEW)
        rows[
            1 - update.measures.best if step.index < 5 else update.measures.best, : 2 if step.index in (5, 30) else 0
        ] = 3
        if step.index in (6, 7, 14):
            rows[update.measures.best, 0] = 3
        trace = update.trace._replace(merged=rows)
        step = dataclasses.replace(step, filters={"dfs": update._replace(trace=trace)})
        said += [(step.index, event) for event in watch.step(step) if event.kind == "merged"]
    assert [index for index, _ in said] == [5, 30]
    assert said[0][1].level == "INFO"
    assert said[0][1].text.startswith("Dual FastSLAM merged 2 walls of its best map with older ones")


@pytest.mark.parametrize(("world", "walls"), [("paper-line", False), ("corridor", True)])
def test_no_loop_is_told_where_there_is_none(world: str, walls: bool):
    assert not [text for _, text in told(world, "dfs", walls=walls, particles=30) if "closed a loop" in text]


def trace_of(n: list[list[int]], before: list[int], after: list[int], resized: list[int], selected: list[int]) -> Trace:
    """A step of particles with so many features, of which only what `Loops` reads is there."""

    def particles(counts: list[int]) -> Particles:
        return SimpleNamespace(maps=SimpleNamespace(counts=np.array(counts)))  # type: ignore[return-value]

    found, indices = np.array(n), (np.array(which, np.int64) for which in (resized, selected))
    log_p, innovations = unweighed(found)
    return Trace(
        particles(before), particles(after), particles(after), found, log_p, 1.0, innovations, 1.0, False, *indices
    )


def test_gaps_are_those_of_a_particle_and_its_ancestors():
    """Two particles make a feature each, the first of them one more; each goes on with its own."""
    loops, both = Loops(), [0, 1]
    assert loops.step(trace_of([[NEW, NEW], [NEW, IGNORED]], [0, 0], [2, 1], both, both), 0, 10.0).tolist() == []
    assert loops.step(trace_of([[1, NEW], [0, NEW]], [2, 1], [3, 2], both, both), 0, 20.0).tolist() == [10.0]
    assert loops.step(trace_of([[2, NEW], [1, 0]], [3, 2], [4, 2], both, both), 1, 50.0).tolist() == [30.0, 30.0]
    # The second one takes over: its feature 1 was matched a moment ago, that of the first one 40 m ago.
    assert loops.step(trace_of([[3, 2], [1, NEW]], [4, 2], [4, 3], both, [1, 1]), 1, 60.0).tolist() == [10.0]
    # Then there are three, all of its descent.
    assert loops.step(trace_of([[0, 1, 2]] * 3, [3] * 3, [3] * 3, [0, 1, 0], [0]), 2, 95.0).tolist() == [
        45.0,
        35.0,
        35.0,
    ]


def test_any_number_of_features_is_remembered():
    loops = Loops()
    for i in range(100):
        loops.step(trace_of([[NEW]], [i], [i + 1], [0], [0]), 0, float(i))
    gaps = loops.step(trace_of([list(range(100))], [100], [100], [0], [0]), 0, 100.0)
    np.testing.assert_array_equal(gaps, 100.0 - np.arange(100))


def test_what_lasts_is_told_once():
    """FastSLAM 1.0 with too few particles loses association for a long time."""
    lost = [step for step, text in told("loop", "fs1", particles=3, inflate_r=1.0) if "lost association" in text]
    assert lost
    assert min(np.diff(lost), default=99) > 1


def sights(times: list[float], seen: list[int], watch: Watch | None = None) -> list[tuple[float, str, str, str, str]]:
    """Time and event, of a session without filters in which so many things are seen at these times."""
    watch, told = watch or Watch({}), []
    for index, (time, before, count) in enumerate(zip(times, [0.0, *times], seen, strict=False), 1):
        frame = SimpleNamespace(time=time, dt=np.array([time - before]), z=np.zeros((count, 2)))
        step = SimpleNamespace(index=index, frame=frame, changes=(), filters={}, odometry=np.zeros(3), match=None)
        told += [(time, *event) for event in watch.step(step)]  # type: ignore[arg-type]
    return told


def test_it_is_told_once_that_nothing_is_seen_and_when_that_ends():
    times = [0.5 * i for i in range(1, 401)]
    seen = [0 if 20 < time <= 100 or 120 < time <= 149 else 3 for time in times]
    nothing, again = sights(times, seen)
    assert nothing == (50.0, "WARN", "Nothing has been seen since 20.0 s, for 30 s", "", "nothing seen")
    assert again == (100.5, "INFO", "Something is seen again, after 80.5 s", "", "seen again")
    ((time, _, text, *_),) = sights(times, [0] * 400)
    assert (time, text) == (30.0, "Nothing has been seen since 0.0 s, for 30 s")


def test_without_a_clock_scans_are_counted():
    times, seen = [float(i) for i in range(1, 201)], [0 if 20 < i <= 100 else 3 for i in range(1, 201)]
    nothing, again = sights(times, seen, Watch({}, has_clock=False))
    assert (nothing[0], nothing[2]) == (50.0, "Nothing has been seen for 30 scans")
    assert again[2] == "Something is seen again, after 81 scans"


def test_the_longest_blind_stretch_is_kept():
    times = [0.5 * i for i in range(1, 401)]
    for blind, kept in (
        (lambda t: 20 < t <= 60 or 80 < t <= 140 or 150 < t <= 190, Blind(161, 120, 60.0)),
        (lambda t: t > 150, Blind(301, 100, 50.0)),  # to the end
        (lambda t: 20 < t <= 49, Blind()),  # too short to be told
    ):
        watch = Watch({})
        sights(times, [0 if blind(time) else 3 for time in times], watch)
        assert watch.blind == kept


def test_where_one_looks_but_rarely_it_is_not_told():
    """Ten or forty seconds from one look to the next, and every other one sees something."""
    for apart in (10.0, 40.0):
        assert not sights([apart * i for i in range(1, 41)], [3, 0] * 20)
    assert sights([10.0 * i for i in range(1, 41)], [0] * 40)[0][0] == 50.0


def unmatched(used: dict[int, str] | dict[int, str | None], count: int = 40) -> list[tuple[int, str, str, str, str]]:
    """Step and event, of a session without filters whose scans are matched but in those steps, for these reasons; None
    is a step without matching."""
    watch, told = Watch({}), []
    for index in range(1, count + 1):
        frame = SimpleNamespace(time=0.5 * index, dt=np.array([0.5]), z=np.zeros((3, 2)))
        match = SimpleNamespace(used=index not in used, reason=used.get(index, ""))
        if index in used and used[index] is None:
            match = None
        step = SimpleNamespace(index=index, frame=frame, changes=(), filters={}, odometry=np.zeros(3), match=match)
        told += [(index, *event) for event in watch.step(step)]  # type: ignore[arg-type]
    return told


def test_it_is_told_once_that_matching_is_not_used_and_why():
    assert unmatched({}) == []
    assert unmatched({1: "first scan"}) == []  # of which nobody can expect anything else
    reasons = {1: "first scan", 5: "too few points", 6: "does not fit", 16: "does not fit", 27: "too little overlap"}
    assert unmatched(reasons) == [
        (5, "INFO", "Scan matching is not used: too few points", "", "not matched"),
        (26, "INFO", "Scan matching is used again since step 17", "", "matched again"),
        (27, "INFO", "Scan matching is not used: too little overlap", "", "not matched"),
        (37, "INFO", "Scan matching is used again since step 28", "", "matched again"),
    ]


def test_the_first_scan_after_matching_was_off_is_no_complaint():
    """Nor does an end of it come of steps without any matching."""
    off = dict.fromkeys(range(3, 20))
    assert unmatched({1: "first scan", **off, 20: "first scan"}) == []
    assert [step for step, *_ in unmatched({2: "does not fit", **off, 20: "first scan", 22: "does not fit"})] == [
        2,
        22,
        32,
    ]


def test_the_descendant_of_the_best_is_of_the_heaviest_survivor():
    source = build("paper-line")
    params = source.params(particles=20, resampler="multinomial", resample_below=1.0)
    info = session.make_info(source, [ESTIMATORS["fs1"]], params, seed=2)
    for step in session.steps(info):
        trace = step.filters["fs1"].trace
        w = trace.weighted.log_w[trace.selected]
        assert w[best_descendant(step.filters["fs1"])] == w.max()


@pytest.mark.parametrize(("particles", "limit"), [(2, 1.5), (10, 1.5), (40, 4.0)])
def test_depleted_means_the_same_as_in_a_diagnosis(particles: int, limit: float):
    source = build("paper-line")
    info = session.make_info(source, [ESTIMATORS["fs1"]], source.params(particles=particles), seed=1, count=1)
    (step,) = session.steps(info)
    update = step.filters["fs1"]
    for n_eff in (limit - 0.01, limit, limit + 0.01):
        trace = update.trace._replace(n_eff=n_eff)
        numbers = update.evidence.numbers._replace(n_eff=n_eff)
        made = update._replace(trace=trace, evidence=update.evidence._replace(numbers=numbers))
        found = Watch({"fs1": "FastSLAM 1.0"}).step(dataclasses.replace(step, filters={"fs1": made}))
        record = record_of(np.array([1]), Numbers._fields, np.array([numbers]), [made.evidence.observations])
        diagnosed = findings(Case("fs1", "FastSLAM 1.0", False, {}, record))
        depleted = n_eff < limit
        assert ("depleted" in {event.kind for event in found}) is depleted
        assert ("depleted" in {finding.kind for finding in diagnosed}) is depleted


RESAMPLED = re.compile(r"resampled: N_eff (\S+) (?:< (\d+)% of 20|of 20(?:, although not below (\d+)% of K)?); ")


def why_resampled(mistake: str, below: float) -> list[tuple[float, str | None, str | None]]:
    """N_eff, the percentage that it is said to be below, and the one that it is said not to be below."""
    source = build("paper-line")
    params = source.params(particles=20, resample_below=below)
    info = session.make_info(source, session.estimators(["fs1"], mistake), params, seed=1, count=25)
    watch, reasons = Watch({"fs1": "FastSLAM 1.0"}), []
    for step in session.steps(info):
        for text in [event.text for event in watch.step(step) if event.kind == "resampled"]:
            found = RESAMPLED.search(text)
            assert found is not None, text
            n_eff = step.filters["fs1"].trace.n_eff
            assert found[1] == f"{n_eff:.1f}"
            reasons.append((n_eff, found[2], found[3]))
    return reasons


@pytest.mark.parametrize("below", [0.5, 0.75])
@pytest.mark.parametrize("mistake", ["", "resample-always"])
def test_why_it_was_resampled_is_true(mistake: str, below: float):
    reasons, percent = why_resampled(mistake, below), f"{100 * below:.0f}"
    for n_eff, smaller, larger in reasons:
        assert (smaller, larger) == ((percent, None) if n_eff < below * 20 else (None, percent))
    assert len({smaller for _, smaller, _ in reasons}) == (2 if mistake else 1)


def test_no_reason_is_given_where_it_is_always_resampled():
    assert [reason[1:] for reason in why_resampled("", 1.0)] == [(None, None)] * 25


def write(pipe: Pipe, data: bytes) -> None:
    with open(pipe.entrance, "wb") as file:
        pipe.seal()
        file.write(data)
    pipe.join()


def test_two_writers_do_not_share_a_file(tmp_path: Path):
    first = Pipe(tmp_path / "a.rrd")
    with pytest.raises(OSError, match="another run is recording to it"):
        Pipe(tmp_path / "a.rrd")
    write(first, b"mine")
    assert (tmp_path / "a.rrd").read_bytes() == b"mine"
    write(Pipe(tmp_path / "a.rrd"), b"next")


def test_a_drive_that_knows_no_locks_is_written_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def no_locks(file: int, how: int) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr("app.recording.pipe.fcntl.flock", no_locks)
    write(Pipe(tmp_path / "a.rrd"), b"mine")
    assert (tmp_path / "a.rrd").read_bytes() == b"mine"


@pytest.mark.parametrize("replaced", [False, True])
def test_a_deleted_file_is_noticed(tmp_path: Path, replaced: bool):
    pipe = Pipe(tmp_path / "a.rrd")
    os.remove(tmp_path / "a.rrd")
    if replaced:
        (tmp_path / "a.rrd").write_bytes(b"")
    write(pipe, b"gone")
    assert pipe.error is not None
    assert "deleted or replaced" in str(pipe.error)


def test_the_true_path_is_whole_where_observations_are_rare(tmp_path: Path):
    """Ten seconds from one to the next, but the truth is known at each."""
    source = build("loop")
    rare = dataclasses.replace(
        source,
        steps=tuple(s._replace(frame=s.frame._replace(time=10.0 * i)) for i, s in enumerate(source.steps)),
    )
    info = session.make_info(rare, [ESTIMATORS["ekf"]], rare.params(), count=20)
    session.run(info, [Recorder(tmp_path / "a.rrd")])
    _, stretches = Recording(tmp_path / "a.rrd").rows("/world/truth/path", "LineStrips3D:strips", "step")[-1]
    assert [len(stretch) for stretch in stretches] == [20]


def test_the_truth_is_not_shown_where_nobody_knows_it(tmp_path: Path):
    """Its path is interrupted, rather than drawn straight across, and the true robot goes away."""
    source = build("loop", features="landmarks")
    unknown = range(40, 60)  # 10 s
    hidden = tuple(s._replace(truth=None) if i in unknown else s for i, s in enumerate(source.steps))
    blind = dataclasses.replace(source, steps=hidden)
    info = session.make_info(blind, [ESTIMATORS["ekf"]], blind.params(), count=100)
    session.run(info, [Recorder(tmp_path / "a.rrd")])
    recording = Recording(tmp_path / "a.rrd")
    _, stretches = recording.rows("/world/truth/path", "LineStrips3D:strips", "step")[-1]
    assert [len(stretch) for stretch in stretches] == [40, 40]
    cleared = [step for step, _ in recording.rows("/world/truth/robot", "Clear:is_recursive", "step")]
    assert cleared
    assert all(40 < step - 1 < 60 for step in cleared)


def test_overconfidence_is_told_when_it_has_lasted():
    """And once: it goes on.  With the NEES of a run replaced by one that is too high from step 5 to 30."""
    source = build("paper-line")
    info = session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=20), seed=1, count=45)
    watch, said = Watch({"dfs": "Dual FastSLAM"}), []
    for step in session.steps(info):
        update = step.filters["dfs"]
        nees = 9.0 if 5 <= step.index <= 30 else 7.0
        update = update._replace(measures=update.measures._replace(nees_position=nees))
        said += [(step.index, e) for e in watch.step(dataclasses.replace(step, filters={"dfs": update}))]
    found = [(index, event.text) for index, event in said if event.kind == "overconfident"]
    assert [index for index, _ in found] == [14]
    assert "for 10 steps and is 9 now" in found[0][1]


def test_duplicates_are_told_when_they_are_born():
    """Not when the best particle changes, and with it how many its map has."""
    source = build("paper-line")
    info = session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=20), seed=1, count=40)
    watch, born = Watch({"dfs": "Dual FastSLAM"}), []
    of_step = {3: 1.0, 4: 0.0, 5: 1.0, 20: 1.0, 30: 2.0}
    for step in session.steps(info):
        update = step.filters["dfs"]
        measures = update.measures._replace(duplicates=of_step.get(step.index, 0.0))
        events = watch.step(dataclasses.replace(step, filters={"dfs": update._replace(measures=measures)}))
        born += [(step.index, event.text) for event in events if event.kind == "duplicate born"]
    assert [index for index, _ in born] == [3, 30]
    assert "2 features show what another one shows already" in born[1][1]
