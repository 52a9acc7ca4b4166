"""Who descends from whom, in a recording: the numbers are those of a plain count of the ancestors that it holds."""

from __future__ import annotations

import dataclasses
import itertools
import math
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from app import ancestry, colours, session
from app.recording import charts
from app.recording.errors import RecordingError
from app.recording.reading import Recording
from app.recording.writer import Detail, Writer
from app.types import SessionInfo, SessionStep
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.genealogy import Genealogy
from slam.types import Floats

STEPS, K, FEWER, CHANGE, AT = 40, 25, 11, 17, 22
KEYS = ("dfs", "fs2", "fs1", "ekf")


@pytest.fixture(scope="module")
def info() -> SessionInfo:
    source = build("paper-line")
    params = source.params(particles=K, association="known")
    return session.make_info(source, [ESTIMATORS[key] for key in KEYS], params, seed=5, count=STEPS)


@pytest.fixture(scope="module")
def steps(info: SessionInfo) -> list[SessionStep]:
    """The number of particles changes on the way."""
    change = session.Change(CHANGE, dataclasses.replace(info.params, particles=FEWER))
    return list(session.steps(info, [change]))


def written(info: SessionInfo, path: Path, steps: list[SessionStep], detail: Detail = "usual") -> Recording:
    from app.recording.stream import FileStream

    writer = Writer(info, partial(FileStream, path))
    for step in steps:
        writer.step(step, detail)
    writer.close()
    return Recording(path)


@pytest.fixture(scope="module")
def recording(info: SessionInfo, steps: list[SessionStep], tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return written(info, tmp_path_factory.mktemp("ancestry") / "run.rrd", steps)


class Count:
    """After the last of these steps: all by going back, particle by particle."""

    def __init__(self, ancestors: list[list[int]]) -> None:
        lines = [[k] for k in range(len(ancestors[-1]))]
        for step in reversed(ancestors):
            for line in lines:
                line.append(step[line[-1]])
        self.left = [len(set(column)) for column in zip(*lines, strict=True)]
        """Distinct ancestors by steps back."""

    @property
    def age(self) -> float:
        return float(self.left.index(1)) if 1 in self.left else math.nan

    @property
    def diversity(self) -> float:
        return self.left[-1] / self.left[0]


@pytest.mark.parametrize("key", KEYS)
def test_the_numbers_are_those_of_the_recorded_ancestors(recording: Recording, key: str) -> None:
    """Diversity, the age of the common ancestor, and ancestors left by lag, at every step."""
    ancestors = [step.tolist() for step in recording.ancestors(key)]
    assert len(ancestors) == STEPS
    counts = [Count(ancestors[:step]) for step in range(1, STEPS + 1)]
    np.testing.assert_array_equal(recording.series(f"/plots/diversity/{key}")[1], [c.diversity for c in counts])
    np.testing.assert_array_equal(recording.series(f"/plots/common_ancestor/{key}")[1], [c.age for c in counts])
    if key == "ekf":
        assert f"/genealogy/{key}/lags" not in recording.entities
        return
    assert len({count.diversity for count in counts}) > 2
    back = recording.rows(f"/genealogy/{key}/lags", "steps_back", "step")
    left = recording.rows(f"/genealogy/{key}/lags", "ancestors", "step")
    assert [step for step, _ in left] == list(range(1, STEPS + 1))
    for count, (step, lags), (_, found) in zip(counts, back, left, strict=True):
        assert lags[0] == 0
        assert lags[-1] == step
        assert found == [count.left[lag] for lag in lags]


GROWS, MORE = 8, 200
"""The step at which there are more particles, and how many."""


@pytest.fixture(scope="module")
def grown(info: SessionInfo) -> list[SessionStep]:
    """Of FEWER particles at first."""
    few = info._replace(filters=(ESTIMATORS["dfs"],), params=dataclasses.replace(info.params, particles=FEWER))
    many = dataclasses.replace(info.params, particles=MORE)
    return list(session.steps(few._replace(steps=2 * GROWS), [session.Change(GROWS, many)]))


def scales(recording: Recording) -> dict[int, list[float]]:
    """By step, how many ancestors the axis of the curves has room for, as its lines and the numbers at them tell."""
    found = {}
    labels = dict(recording.rows("/genealogy/frame/lags", "Points2D:labels", "step"))
    for step, row in recording.rows("/genealogy/frame/lags", "LineStrips2D:strips", "step"):
        box, *lines = np.array(row[0]), *map(np.array, row[1:])
        (bottom, top), marks = (box[:, 1].max(), box[:, 1].min()), [line[0, 1] for line in lines if np.ptp(line[:, 0])]
        numbers = [int(label) for label in labels[step][1 : 1 + len(marks)]]
        found[step] = [
            float(n ** ((bottom - top) / (bottom - height))) for n, height in zip(numbers, marks, strict=True)
        ]
    return found


def shares(recording: Recording, step: int) -> Floats:
    """(n,) heights of a curve on its axis, 1 at the top."""
    (box, *_) = dict(recording.rows("/genealogy/frame/lags", "LineStrips2D:strips", "step"))[
        max(s for s in scales(recording) if s <= step)
    ]
    ((curve,),) = [row for s, row in recording.rows("/genealogy/dfs/lags", "LineStrips2D:strips", "step") if s == step]
    bottom, top = np.array(box)[:, 1].max(), np.array(box)[:, 1].min()
    return (bottom - np.array(curve)[:, 1]) / (bottom - top)


def test_the_curve_has_another_scale_when_there_are_more_particles(
    info: SessionInfo, grown: list[SessionStep], tmp_path: Path
) -> None:
    few = info._replace(params=dataclasses.replace(info.params, particles=FEWER), filters=(ESTIMATORS["dfs"],))
    recording = written(few, tmp_path / "grown.rrd", grown)
    assert list(scales(recording)) == [1, GROWS]
    np.testing.assert_allclose(scales(recording)[1], [FEWER], rtol=1e-4)
    np.testing.assert_allclose(scales(recording)[GROWS], [MORE, MORE], rtol=1e-4)
    for step in (1, GROWS - 1, GROWS, 2 * GROWS):
        left = dict(recording.rows("/genealogy/dfs/lags", "ancestors", "step"))[step]
        most = MORE if step >= GROWS else FEWER
        np.testing.assert_allclose(shares(recording, step), np.log(left) / math.log(most), atol=1e-5)
    assert shares(recording, 2 * GROWS).min() < 0.5


def test_the_scale_of_a_curve_is_not_forgotten(
    info: SessionInfo, steps: list[SessionStep], grown: list[SessionStep], tmp_path: Path
) -> None:
    """When there are fewer again; in a recording that begins after that; and when K grew in steps without pictures."""
    late = written(info, tmp_path / "late.rrd", steps[CHANGE + 3 :])
    for recording, first in ((written(info, tmp_path / "run.rrd", steps), 1), (late, CHANGE + 4)):
        assert list(scales(recording)) == [first]
        np.testing.assert_allclose(scales(recording)[first], [K], rtol=1e-4)
    numbers = written(info._replace(filters=(ESTIMATORS["dfs"],)), tmp_path / "numbers.rrd", grown, "numbers")
    assert list(scales(numbers)) == [2 * GROWS]
    np.testing.assert_allclose(scales(numbers)[2 * GROWS], [MORE, MORE], rtol=1e-4)


@pytest.mark.parametrize("detail", ["present", "numbers"])
def test_no_step_of_the_ancestors_is_missing(
    info: SessionInfo, steps: list[SessionStep], recording: Recording, tmp_path: Path, detail: Detail
) -> None:
    """Whatever else is written of a step; where a recording begins late; and where steps were lost."""
    for i, seen in enumerate((steps, steps[7:], [s for s in steps if s.index % 3 == 0 or s.index == STEPS])):
        found = written(info, tmp_path / f"{i}.rrd", seen, detail)
        for key in KEYS:
            assert found.series(f"/plots/n_eff/{key}")[0].tolist() == [
                s.index for s in seen
            ]  # the time is not left in the past
            whole = steps[-1].filters[key].genealogy.ancestors
            for mine, all_of_it in ((found.ancestors(key), whole), (recording.ancestors(key), whole)):
                assert len(mine) == STEPS
                for a, b in zip(mine, all_of_it, strict=True):
                    np.testing.assert_array_equal(a, b)


def test_steps_in_which_nobody_died_cost_nothing(recording: Recording, steps: list[SessionStep]) -> None:
    for key in KEYS:
        rows = recording.rows(f"/ancestors/{key}", "ancestors", "step")
        changed = [s.index for s in steps if s.filters[key].trace.ancestors.tolist() != list(range(K))[: _size(s, key)]]
        assert [step for step, _ in rows] == sorted({1, *changed})
        assert recording.timelines(f"/ancestors/{key}") == {"step", "sim_time", "stage"}


def _size(step: SessionStep, key: str) -> int:
    return len(step.filters[key].trace.ancestors)


def test_a_branch_has_all_its_ancestors(info: SessionInfo, tmp_path: Path) -> None:
    from app.recording.stream import FileStream

    trunk = Writer(info, partial(FileStream, tmp_path / "run.rrd"))
    state = session.start(info)
    for _ in range(AT):
        state, step = session.advance(info, state, info.params)
        trunk.step(step)
    fewer = dataclasses.replace(info.params, particles=FEWER)
    branch = trunk.fork(info._replace(params=fewer), "fewer")
    for _ in range(AT, STEPS):
        state, step = session.advance(info, state, fewer)
        branch.step(step)
    trunk.close()
    recording = Recording(tmp_path / "run.rrd")
    assert len(recording.ancestors("fs2")) == AT
    for a, b in zip(recording.ancestors("fs2", "fewer"), step.filters["fs2"].genealogy.ancestors, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_recording_without_ancestors_says_so(recording: Recording) -> None:
    with pytest.raises(RecordingError, match="fs3 descend"):
        recording.ancestors("fs3")


@pytest.mark.parametrize("key", KEYS)
def test_hypotheses_of_each_feature(recording: Recording, steps: list[SessionStep], key: str) -> None:
    """Different copies of it, feature by feature; the association is known, so all maps have the same ones."""
    copies = recording.rows(f"/hypotheses/{key}", "copies", "step")
    maps = recording.rows(f"/hypotheses/{key}", "maps", "step")
    of_best = recording.rows(f"/world/{key}/map", "hypotheses", "step")
    bars = recording.rows(f"/hypotheses/{key}", "BarChart:values", "step")
    assert len(copies) == len(bars) == STEPS
    for step, (_, found), (_, holders), (_, shown) in zip(steps, copies, maps, of_best, strict=True):
        weighted = step.filters[key].trace.weighted
        every = [weighted.maps.features(k) for k in range(len(weighted.maps))]
        wanted = [
            len({(theta[i].tobytes(), Sigma[i].tobytes()) for theta, Sigma, _ in every})
            for i in range(len(every[0][0]))
        ]
        assert found == shown == wanted
        assert holders == [len(every)] * len(wanted)


# Colours and words ----------------------------------------------------------------------------------------------------

SEEN = {
    "by most": np.eye(3),
    "without red": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "without green": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "without blue": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
"""Linear RGB as people see it (G. M. Machado et al., IEEE Trans. Vis. Comput. Graph. 15, 2009, severity 1)."""


def perceived(rgb: Floats, seen: Floats) -> Floats:
    """(n, 3) of colours (n, 3) in the space Oklab (B. Ottosson, 2020): distances are as large as they look."""
    c = rgb / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ np.asarray(seen).T, 0.0, 1.0)
    cones = np.array([[0.4122, 0.5363, 0.0514], [0.2119, 0.6807, 0.1074], [0.0883, 0.2817, 0.6300]])
    lab = np.array([[0.2105, 0.7936, -0.0041], [1.9780, -2.4286, 0.4506], [0.0259, 0.7828, -0.8087]])
    return np.cbrt(linear @ cones.T) @ lab.T


@pytest.mark.parametrize("who", SEEN)
def test_founders_can_be_told_apart_by_everybody(who: str) -> None:
    """Black and white are 1 apart."""
    points = perceived(np.array([*colours.FOUNDERS, colours.BACKGROUND], float), np.asarray(SEEN[who], float))
    distances = [math.dist(a, b) for a, b in itertools.combinations(points, 2)]
    assert min(distances) > 0.15


def packed(rgb: Floats) -> set[int]:
    red, green, blue = np.asarray(rgb, np.uint32).T
    return set(((red << 24) | (green << 16) | (blue << 8) | 255).tolist())


def test_a_founder_has_one_colour_in_the_picture_and_in_the_world(
    recording: Recording, steps: list[SessionStep]
) -> None:
    """Dual FastSLAM: some founders are left, no more than there are colours, so no two share one."""
    update = steps[-1].filters["dfs"]
    genealogy, rgb = update.genealogy, colours.of_filter("dfs")
    founders = np.unique(genealogy.founders)
    assert 2 <= len(founders) <= len(colours.FOUNDERS)
    tree = ancestry.tree(genealogy, rgb)
    own = np.array(colours.FOUNDERS)
    drawn = {tuple(tone) for tone, share in zip(tree.tones.tolist(), tree.share, strict=True) if 0.0 < share < 1.0}
    assert len(drawn) == len(founders)
    assert drawn <= {tuple(map(float, rgb)) for rgb in own}
    branches = genealogy.branches()
    tones = ancestry.of_branches(genealogy, branches, rgb)
    background = np.array(colours.BACKGROUND)
    for strip, tone in zip(sorted(genealogy.layout(1000), key=lambda s: (s.alive, s.living)), tree.tones, strict=True):
        if strip.alive:
            same = [t for b, t in zip(branches, tones, strict=True) if b.founder == strip.founder]
            for faded in same:  # the same hue: on the line from the background to the colour
                assert np.linalg.norm(np.cross(faded - background, tone - background)) < 1e-6 * 255**2
    (_, row) = recording.rows("/genealogy/dfs", "LineStrips2D:colors", "step")[-1]
    assert set(row) == packed(tree.tones)
    (_, row) = recording.rows("/world/dfs/lineages", "LineStrips3D:colors", "step")[-1]
    assert set(row) == packed(tones)


def test_the_last_founders_never_share_a_colour() -> None:
    """By their numbers the first, the ninth and the seventeenth would."""
    s, survivors = np.zeros((20, 3)), np.repeat([0, 8, 16], [7, 7, 6])
    genealogy = Genealogy.start(s).grow(survivors, s)
    tree = ancestry.tree(genealogy, colours.of_filter("dfs"))
    drawn = {tuple(tone) for tone, share in zip(tree.tones.tolist(), tree.share, strict=True) if share}
    assert drawn == {tuple(map(float, colours.FOUNDERS[i])) for i in (0, 1, 2)}


def test_what_all_share_has_the_colour_of_the_filter() -> None:
    s = np.zeros((4, 3))
    genealogy = Genealogy.start(s).grow(np.array([0, 0, 2, 3]), s).grow(np.zeros(4, int), s)
    rgb = colours.of_filter("dfs")
    tree = ancestry.tree(genealogy, rgb)
    assert [tuple(tone) for tone, share in zip(tree.tones.tolist(), tree.share, strict=True) if share == 1.0] == [rgb]
    branches = genealogy.branches()
    (common,) = (i for i, b in enumerate(branches) if b.living == 4)
    assert ancestry.of_branches(genealogy, branches, rgb)[common].argmax() == np.argmax(rgb)


def told(*ancestors: list[int]) -> str:
    """What is said of particles with these ancestors in every step."""
    genealogy = Genealogy.start(np.zeros((len(ancestors[0]), 3)))
    for step in ancestors:
        genealogy = genealogy.grow(np.array(step), np.zeros((len(step), 3)))
    return ancestry.words(SimpleNamespace(genealogy=genealogy))  # type: ignore[arg-type]


def test_what_is_said_of_the_ancestry() -> None:
    all_, half, one = [0, 1, 2, 3], [0, 0, 2, 2], [1, 1, 1, 1]
    assert told(half, all_) == "4 particles, from 2 founders"
    assert told(*[half] * 60) == "4 particles, from 2 of 50 steps ago and from 2 founders"
    assert told(half, *[all_] * 60) == "4 particles, from 4 of 50 steps ago and from 2 founders"
    assert told(all_, one, *[all_] * 49) == "4 particles, all from one of 50 steps ago"
    assert told(all_, one, *[all_] * 50, half) == "4 particles, from 2 of 50 steps ago and all from one of 52 steps ago"
    assert told(all_, one) == "4 particles, all from one of 1 step ago"
    assert told([0], [0]) == "1 particle"


def test_what_is_said_of_hypotheses(steps: list[SessionStep]) -> None:
    maps = steps[-1].filters["dfs"].trace.weighted.maps
    copies, holders = maps.hypotheses()
    i = int(np.argmin(copies / holders))
    said = f"feature {i} has the fewest hypotheses left, {copies[i]} in {holders[i]} maps "
    assert ancestry.scarcest(maps) == f"{said}(median of all features: {np.median(copies):.0f})"
    assert ancestry.scarcest(maps.store.empty(3)) == ""


@pytest.mark.parametrize(
    ("copies", "said"),
    [
        ([], ""),
        ([0], ""),
        ([3], "feature 0 has the fewest hypotheses left, 3 in 9 maps"),
        ([0, 1], "feature 1 has the fewest hypotheses left, 1 in 9 maps"),
        ([4, 1, 8], "feature 1 has the fewest hypotheses left, 1 in 9 maps (median of all features: 4)"),
    ],
)
def test_of_a_single_feature_no_half_is_told(copies: list[int], said: str) -> None:
    found = np.array(copies, np.int64)
    maps = SimpleNamespace(hypotheses=lambda: (found, np.where(found > 0, 9, 0)))
    assert ancestry.scarcest(maps) == said  # type: ignore[arg-type]


@pytest.mark.parametrize("steps", [0, 1, 9, 100, 5000])
def test_lags_are_dense_at_first_and_reach_the_beginning(steps: int) -> None:
    lags = ancestry.lags(steps).tolist()
    assert lags[0] == 0
    assert lags[-1] == steps
    assert lags == sorted(set(lags))
    assert lags[:6] == list(range(min(6, steps + 1)))
    assert len(lags) <= 60


@pytest.mark.parametrize(
    ("axis", "labels"), [(60, ["#0", *map(str, range(10, 60, 10))]), (64, ["#0", "20", "40", "60"])]
)
def test_no_number_of_the_time_axis_is_where_the_curves_begin(axis: int, labels: list[str]) -> None:
    marks = charts.time_marks(charts.Band(0.0, 10.0), axis)
    assert marks.labels is not None
    assert marks.labels.as_arrow_array().to_pylist() == labels
