"""Studies of walls: what counts as closed, what is compared with what, and what is saved."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from app import cli, session
from app.study.corridor_spread import Outcome as Deviation
from app.study.corridor_spread import spreads_of, steps_at
from app.study.loop_closure import LAPS, _Watch, fewest_closing, second_pass
from app.study.output import unseen
from app.study.rotation_spread import ratios
from scenarios.registry import build
from slam.dual_fastslam import DUAL_FASTSLAM


def saved(tmp_path, *arguments: str) -> dict:
    path = tmp_path / "study.json"
    assert cli.entry(["study", *arguments, "--out", str(path)]) == 0
    return json.loads(path.read_text())


@pytest.fixture(scope="module")
def loop():
    return build("loop", laps=LAPS)


def test_the_second_pass_is_from_the_start_to_the_first_corner(loop):
    half, second = second_pass(loop)
    truth = np.array([step.truth for step in loop.steps])
    assert list(second) == list(range(second[0], second[-1] + 1))
    start = loop.start[:2]
    corner = start + np.array([6.0 - 1.0, 0.0])  # 1 m is the radius
    step = np.linalg.norm(truth[1] - truth[0])
    assert np.linalg.norm(truth[second[0], :2] - start) < step
    assert np.linalg.norm(truth[second[-1], :2] - corner) < step
    # Right across, on the way back; two rounded corners have saved 0.86 m.
    assert np.linalg.norm(truth[half, :2] - [-start[0] - 0.86, 20.0]) < step


def update_of(n, births, best=0, wrong=(), error=0.1, resized=(0, 1), selected=(0, 1), heading=0.0):
    """A step in which every wall is taken for the feature that was born of it, but those in `wrong`."""
    tags = np.array(n[best], np.int64)
    tags[list(wrong)] += 100
    maps = SimpleNamespace(counts=np.array(births), tags=lambda k: np.arange(births[k]))
    trace = SimpleNamespace(
        n=np.array(n),
        frame_tags=tags,
        weighted=SimpleNamespace(maps=maps),
        resampled=SimpleNamespace(maps=maps),
        resized=np.array(resized),
        selected=np.array(selected),
        did_resample=selected != (0, 1),
    )
    measures = SimpleNamespace(best=best, position_error_m=error, heading_error_rad=heading, features=9, duplicates=0.0)
    return SimpleNamespace(trace=trace, measures=measures, seconds=0.001)


def watched(*updates):
    watch = _Watch("dfs", 0, {2, 3})
    for index, update in enumerate(updates, 1):
        watch.step(
            SimpleNamespace(
                index=index,
                frame=SimpleNamespace(tags=update.trace.frame_tags, z=update.trace.frame_tags),
                filters={"dfs": update},
                truth=np.zeros(3),
                odometry=np.array([3.0, 4.0, 2 * math.pi - 0.1]),
            )
        )
    return watch.outcome()


def test_old_walls_are_those_of_the_particles_own_ancestor():
    # Two particles have 3 and 5 walls after half a lap; then both descend from the second.
    first = update_of([[0, 1], [0, 1]], births=[3, 5])
    crossed = update_of([[0, 1], [0, 1]], births=[3, 5], selected=(1, 1))
    passing = update_of([[4, 5], [4, 2]], births=[9, 9])
    found = watched(first, crossed, passing, passing)
    assert (found.matches, found.share) == (4, 0.5)
    assert not found.closed
    assert found.resamplings == 1
    assert (found.odometry_error_m, found.odometry_heading_error_rad) == (5.0, pytest.approx(0.1))
    # The best particle counts, new and ignored observations do not, nor does what is matched outside of the pass.
    other = update_of([[8, 8], [4, -1]], births=[9, 9], best=1)
    assert watched(first, crossed, other, other, first).share == 1.0


def test_old_walls_are_those_that_were_seen():
    first = update_of([[0, 1], [0, 1]], births=[3, 5])
    passing = update_of([[0, 1, 2, 5], [0, 0, 0, 0]], births=[9, 9], wrong=[1])
    found = watched(first, first, passing, passing)
    assert (found.matches, found.share) == (8, 0.5)  # one of four is new, and one is another


@pytest.mark.parametrize(
    ("errors", "closed"),
    [([0.1, 0.1], True), ([0.9, 0.4], True), ([0.1, 0.5], False), ([0.1, math.nan], False)],
)
def test_closed_needs_the_position_in_the_second_half_of_the_pass(errors, closed):
    first = update_of([[0, 1], [0, 1]], births=[3, 5])
    passing = [update_of([[0, 1], [0, 1]], births=[9, 9], error=error) for error in errors]
    assert watched(first, first, *passing).closed is closed


def test_a_pass_without_a_match_is_not_closed():
    first = update_of([[0, 1], [0, 1]], births=[3, 5])
    blind = update_of(np.empty((2, 0), np.int64), births=[9, 9])
    found = watched(first, first, blind, blind)
    assert (found.closed, found.share, found.matches) == (False, 0.0, 0)


def test_the_fewest_particles_close_every_run():
    good, bad = SimpleNamespace(closed=True), SimpleNamespace(closed=False)
    cells = {("dfs", 10): [good, bad], ("dfs", 100): [good, good], ("dfs", 30): [good, good], ("fs1", 10): [bad]}
    assert fewest_closing("dfs", cells) == 30
    assert fewest_closing("fs1", cells) is None


def test_loop_closure(capsys, tmp_path):
    line = "loop-closure --runs 2 --filters dfs ekf --particles 2 30 --doors rooms --jobs 1 --seed 5"
    found = saved(tmp_path, *line.split())
    out = capsys.readouterr().out
    assert "no wall was ever seen" not in out
    for text in ("loop, doors rooms", "error [m]", "Dual FastSLAM closes all with 30 particles", "2 of 2 seeds"):
        assert text in out
    assert f"dualslam study {line}" in out
    cells = {(cell["filter"], cell["particles"]): cell for cell in found["cells"]}
    assert list(cells) == [("dfs", 2), ("dfs", 30), ("ekf", 1)]
    dual = cells["dfs", 30]
    assert dual["closed"] == sum(run["closed"] for run in dual["runs"]) == 2
    assert found["fewest"]["dfs"] in (2, 30)
    odometry = [[run["odometry_error_m"] for run in cell["runs"]] for cell in cells.values()]
    assert odometry[0] == odometry[1] == odometry[2]
    for run in dual["runs"]:
        assert run["share"] >= 0.8
        assert run["position_worst_m"] < 0.5 < run["odometry_error_m"]
        assert run["matches"] > 13  # more than one a step


def test_without_noise_dead_reckoning_is_right(tmp_path):
    line = "loop-closure --runs 1 --particles 1 --noise.odometry 0.0001 --jobs 1"
    run = saved(tmp_path, *line.split())["cells"][0]["runs"][0]
    assert run["odometry_error_m"] < 0.02
    assert run["closed"]


def test_reported_and_true_deviations():
    # Reported: 1 and 3 m^2 along, 4 and 4 across; true: 2 and -2 along, 0 and 2 across.
    along, across = spreads_of([Deviation((2.0, 0.0), (1.0, 4.0), 9), Deviation((-2.0, 2.0), (3.0, 4.0), 9)])
    assert (along.reported_m, along.true_m) == (pytest.approx(math.sqrt(2)), 2.0)
    assert along.ratio == (pytest.approx(math.sqrt(0.5)), pytest.approx(math.sqrt(0.5) / 2))
    assert (across.reported_m, across.true_m) == (2.0, pytest.approx(math.sqrt(2)))


def test_the_step_that_has_come_so_far():
    source = build("corridor", doors="none")
    at = steps_at(source, (0.1, 5.0, 40.0))
    for step, distance in zip(at, (0.1, 5.0, 40.0), strict=True):
        assert source.steps[step - 1].truth[0] - 1.0 >= distance - 1e-6
        assert step == 1 or source.steps[step - 2].truth[0] - 1.0 < distance


def test_corridor_spread(capsys, tmp_path):
    line = "corridor-spread --runs 3 --filters dfs fs2 --distances 2 6 --doors none --jobs 1"
    found = saved(tmp_path, *line.split())
    out = capsys.readouterr().out
    for text in ("Dual FastSLAM, 1 particle, doors none, 3 runs", "rms error [m]", "3 of 3 seeds", "6 m"):
        assert text in out
    for key in ("dfs", "fs2"):
        assert [row["distance_m"] for row in found["filters"][key]] == [2.0, 6.0]
        for row in found["filters"][key]:
            errors = np.array([run["error_m"] for run in row["runs"]])
            assert row["along"]["true_m"] == pytest.approx(math.sqrt(np.mean(errors[:, 0] ** 2)))
            assert row["across"]["true_m"] == pytest.approx(math.sqrt(np.mean(errors[:, 1] ** 2)))
    # Nothing tells the way along: Dual keeps its uncertainty of 4 cm in every 0.4 m, FastSLAM 2.0 draws it away.
    dual, other = (found["filters"][key][1]["along"]["reported_m"] for key in ("dfs", "fs2"))
    assert dual == pytest.approx(0.04 * math.sqrt(6 / 0.4), rel=0.1)
    assert other == pytest.approx(0.04, rel=0.1)


def test_the_error_is_that_of_the_session(tmp_path):
    line = "corridor-spread --runs 1 --filters dfs --distances 4 --doors closed --jobs 1 --seed 5 --temper 0.5"
    run = saved(tmp_path, *line.split())["filters"]["dfs"][0]["runs"][0]
    source = build("corridor")
    params = source.params(particles=1, temper=0.5)
    *_, last = session.steps(session.make_info(source, [DUAL_FASTSLAM], params, seed=5, count=10))
    measures = last.filters["dfs"].measures
    assert run["error_m"] == pytest.approx(list((measures.estimate - last.truth)[:2]), abs=1e-12)
    assert run["variance_m2"] == pytest.approx(list(np.diag(measures.covariance)[:2]))


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("corridor-spread --distances 5 95", "--distances is 95; expected at most 91 m, where the far wall is in view"),
        ("corridor-spread --far-end open --distances 95", "expected at most 94 m, where the robot stops"),
        ("corridor-spread --distances 0", "--distances is 0"),
        ("loop-closure --noise.turn 3", "--noise.turn does not apply to loop"),
        ("loop-closure --doors ajar", "--doors is 'ajar'"),
        ("rotation-spread --noise.range 0", "no filter can believe in a perfect sensor"),
    ],
)
def test_what_cannot_be_studied(arguments, complaint, capsys):
    assert cli.entry(["study", *arguments.split()]) == 2
    assert complaint in capsys.readouterr().err


def test_ratios_are_to_the_reference_on_the_same_seed():
    reference = [Deviation((0, 0), (4.0, 16.0), 9), Deviation((0, 0), (1.0, 16.0), 9)]
    found = ratios([Deviation((0, 0), (4.0, 4.0), 9), Deviation((0, 0), (4.0, 64.0), 9)], reference)
    np.testing.assert_allclose(found, [[1.0, 0.5], [2.0, 2.0]])


def test_rotation_spread(capsys, tmp_path):
    line = "rotation-spread --runs 2 --filters dfs fs2 --particles 3 20 --reference 20 --jobs 1"
    found = saved(tmp_path, *line.split())
    out = capsys.readouterr().out
    assert "Dual FastSLAM, reference" in out
    assert "2 of 2 seeds" in out
    cells = {(cell["filter"], cell["particles"]): cell for cell in found["cells"]}
    assert list(cells) == [("dfs", 3), ("dfs", 20), ("fs2", 3), ("fs2", 20)]
    reference = [run["variance_m2"] for run in found["reference"]["runs"]]
    assert len(reference) == 2
    for along, across in reference:
        assert across > along  # the heading that the turn made uncertain, over 64 m
    for cell in cells.values():
        variances = [run["variance_m2"] for run in cell["runs"]]
        np.testing.assert_allclose(cell["ratios"], np.sqrt(np.array(variances) / reference))
        assert cell["median_ratio"]["across"] == pytest.approx(np.median(np.array(cell["ratios"])[:, 1]))
    np.testing.assert_allclose(cells["dfs", 20]["ratios"], 1.0)  # the reference itself
    assert not np.allclose(cells["fs2", 20]["ratios"], 1.0)
    # Beside the root of the mean square error that of the reported variances, not their median.
    assert "rms/error" in out
    for cell in (found["reference"], *cells.values()):
        for axis, name in enumerate(("along", "across")):
            errors, variances = (np.array([run[of][axis] for run in cell["runs"]]) for of in ("error_m", "variance_m2"))
            assert cell[name]["reported_m"] == pytest.approx(math.sqrt(np.mean(variances)))
            assert cell[name]["ratio"]["value"] == pytest.approx(math.sqrt(np.mean(variances) / np.mean(errors**2)))


@pytest.mark.parametrize(
    "line",
    [
        "loop-closure --particles 1",
        "rotation-spread --particles 1 --reference 5",
        "corridor-spread --distances 4",
    ],
)
def test_a_study_in_which_no_wall_is_seen_says_so(capsys, line):
    blind = "--noise.missing 1"
    assert cli.entry(["study", *f"{line} --runs 2 --filters dfs --jobs 1 {blind}".split()]) == 0
    assert "warning: no wall was ever seen in any of the runs (2): these are dead reckoning" in capsys.readouterr().out


def test_runs_in_which_no_wall_was_seen():
    assert unseen([3, 9]) == []
    assert unseen([]) == []
    assert unseen([3, 0, 9]) == ["no wall was ever seen in 1 of 3 runs: these are dead reckoning"]
