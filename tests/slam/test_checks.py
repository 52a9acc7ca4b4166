"""Parts of a step done again: what holds of right filters, and what does not where a trace is made wrong by hand."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from slam.checks import COARSE, contradiction, corrected_before, misplaced_first, twins, undrawn
from slam.estimators import ESTIMATORS
from slam.features import Point, inverse
from slam.phases import noise_of_known, observation_noise
from slam.resampling import SCHEMES, normalise
from slam.types import NEW, Frame, ObservationNoise, Params, ResamplerName, Trace
from tests.slam import plain

SIBLINGS = ["dfs", "fs2", "fs1"]
FASTSLAM = ["fs2", "fs1"]
START = np.diag([0.1, 0.1, 0.02]) ** 2
PARAMS = Params(particles=30, believed=plain.WORLD_NOISE, association="known")
FRAMES = plain.simulate(seed=3, steps=8).frames
SAMPLE = np.arange(30)


def run(key: str, params: Params = PARAMS) -> list[Trace]:
    state, traces = ESTIMATORS[key].init(Point(), np.zeros(3), START, params), []
    for number, frame in enumerate(FRAMES):
        state, trace = ESTIMATORS[key].step(np.random.default_rng(number), state, frame, params)
        traces.append(trace)
    return traces


def noises(frame: Frame, params: Params = PARAMS) -> tuple[ObservationNoise, ObservationNoise]:
    """The honest one, and that of known features."""
    R = observation_noise(frame, params)
    return R, noise_of_known(frame, R, params)


def undrawn_of(trace: Trace, frame: Frame, params: Params = PARAMS) -> float:
    return undrawn(trace, frame, noises(frame, params)[0], params.believed)


@pytest.mark.parametrize("key", SIBLINGS)
def test_right_filters(key: str) -> None:
    told = np.zeros(3)
    for trace, frame in zip(run(key), FRAMES, strict=True):
        found = (
            corrected_before(trace, frame, SAMPLE),
            undrawn_of(trace, frame),
            twins(trace, frame, noises(frame)[1]),
        )
        assert all(math.isnan(value) or value == 0.0 for value in found)
        told += np.isfinite(found)
    np.testing.assert_array_equal(told > 0, [True, True, key != "dfs"])


# Weights --------------------------------------------------------------------------------------------------------------


def test_weights_are_contradicted_by_more_than_rounding() -> None:
    """Beside the largest number that is in them, whichever that is."""
    rng = np.random.default_rng(3)
    for scale, added in ((-4e8, 1.0), (-1.0, -4e8), (-4e8, -4e8), (-1e300, 1.0), (-1.0, -1e300)):
        before, _ = normalise(scale * rng.random(30))
        log_p = added * rng.random((30, 4))
        after, _ = normalise(before + log_p.sum(axis=1))
        assert contradiction(before, after, log_p)[0] < 1e-12
        size = np.abs(log_p).sum(axis=1).max() + np.abs(before).max() + np.abs(after).max()
        after[3] += 1e-6 * size
        assert 1e-7 < contradiction(before, after, log_p)[0] < 1e-5
        after[3] = -np.inf
        assert contradiction(before, after, log_p)[0] == np.inf


def test_what_is_impossible_contradicts_nothing() -> None:
    before, after = np.log([0.5, 0.25, 0.25]), np.log([0.5, 0.25, 0.25])
    assert math.isnan(contradiction(before, after, np.array([[-np.inf], [-np.inf], [0.0]]))[0])
    assert math.isnan(contradiction(before, after, np.array([[np.inf], [0.0], [0.0]]))[0])
    assert math.isnan(contradiction(before, after, np.array([[np.nan], [np.nan], [0.0]]))[0])
    huge = np.array([[1.7e308], [-1.7e308], [1.7e308]])
    after, _ = normalise(before + huge[:, 0])
    assert after[1] == -np.inf
    assert contradiction(before, after, huge)[0] == 0.0


@pytest.mark.parametrize("scheme", SCHEMES)
def test_where_a_scheme_puts_the_first_particle(scheme: ResamplerName) -> None:
    """Over many weights the scheme never misplaces it; that the mistake does shows where the scheme has no choice."""
    rng, caught, due = np.random.default_rng(5), 0, 0
    for _ in range(300):
        w = rng.dirichlet(np.full(12, 0.7))
        selected = SCHEMES[scheme](rng, w, 12)
        assert not misplaced_first(w, selected, scheme) > 0.0
        if selected[0] != 0:
            due += 1
            caught += misplaced_first(w, np.concatenate([[0], selected[1:]]), scheme) == 1.0
    assert due > 50
    least = {"systematic": 0.75, "residual": 0.3}.get(scheme, 0.0)
    assert caught >= least * due
    assert least or not caught


# Corrected before -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", FASTSLAM)
def test_an_innovation_of_the_corrected_feature(key: str) -> None:
    """Of every second particle; the first observation counts, and none that comes later."""
    trace, frame = run(key)[4], FRAMES[4]
    first = (trace.n >= 0).argmax(axis=1)
    v = trace.innovations.v.copy()
    for k in range(0, 30, 2):
        i = first[k]
        theta = trace.weighted.maps.features(k)[0][trace.n[k, i]]
        v[k, i] = plain.innovation(frame.z[i], trace.predicted.s[k], theta)
        v[k, i + 1 :] = 0.0
    wrong = trace._replace(innovations=trace.innovations._replace(v=v))
    assert corrected_before(wrong, frame, SAMPLE) == 0.5
    assert corrected_before(wrong, frame, SAMPLE[::2]) == 1.0
    assert corrected_before(wrong, frame, SAMPLE[1::2]) == 0.0


def test_nothing_is_said_of_what_was_not_matched_or_was_merged() -> None:
    trace, frame = run("fs1")[4], FRAMES[4]
    assert math.isnan(corrected_before(trace._replace(n=np.full_like(trace.n, NEW)), frame, SAMPLE))
    merged = np.full_like(trace.n, NEW)
    assert corrected_before(trace._replace(merged=merged), frame, SAMPLE) == 0.0
    assert math.isnan(corrected_before(trace._replace(merged=np.zeros_like(trace.n)), frame, SAMPLE))


# Draws ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_poses_that_are_their_means(share: float) -> None:
    trace = run("fs2", dataclasses.replace(PARAMS, resample_below=0.0))[3]
    s = trace.resampled.s.copy()
    s[: int(share * 30)] = trace.weighted.s[: int(share * 30)]
    wrong = trace._replace(resampled=trace.resampled._replace(s=s))
    assert undrawn_of(wrong, FRAMES[3]) == share


def test_copies_of_one_draw_count_once() -> None:
    """One of three that live on is its mean, and has most of the places."""
    trace = run("fs2", dataclasses.replace(PARAMS, resample_below=0.0))[3]
    selected = np.repeat([2, 5, 7], [28, 1, 1])
    s = trace.resampled.s[selected]
    s[selected == 2] = trace.weighted.s[2]
    wrong = trace._replace(resampled=trace.resampled._replace(s=s), selected=selected)
    assert undrawn_of(wrong, FRAMES[3]) == pytest.approx(1 / 3)
    one = trace._replace(resampled=trace.resampled._replace(s=s[:28]), selected=selected[:28])
    assert math.isnan(undrawn_of(one, FRAMES[3]))


def test_poses_that_nobody_drew_a_control_for() -> None:
    trace = run("fs1")[3]
    s = trace.predicted.s.copy()
    s[:11] = s[0]
    copied = trace._replace(predicted=trace.predicted._replace(s=s))
    assert undrawn_of(copied, FRAMES[3]) == pytest.approx(10 / 29)
    exact = dataclasses.replace(PARAMS, believed=dataclasses.replace(PARAMS.believed, speed=0.0, turn=0.0))
    assert math.isnan(undrawn_of(copied, FRAMES[3], exact))


@pytest.mark.parametrize("mean", [False, True])
def test_new_features_that_are_where_they_were_seen(mean: bool) -> None:
    trace, frame = run("dfs")[0], FRAMES[0]
    new = trace.n == NEW
    theta = np.stack([trace.weighted.maps.features(k)[0] for k in range(30)])
    if mean:
        for k in range(30):
            theta[k] = [inverse(frame.feature, trace.weighted.s[k], z)[0] for z in frame.z]
    maps = trace.predicted.maps.append(new, theta, np.zeros((*new.shape, 2, 2)), frame.tags)
    wrong = trace._replace(weighted=trace.weighted._replace(maps=maps))
    assert new.all()
    assert undrawn_of(wrong, frame) == float(mean)


@pytest.mark.parametrize("key", SIBLINGS)
@pytest.mark.parametrize(("units", "told"), [(0.01 * COARSE, False), (100.0 * COARSE, True)])
def test_draws_that_floating_point_may_not_tell_from_their_mean(key: str, units: float, told: bool) -> None:
    """Poses are some metres from where they began, with a deviation of so many units in the last place."""
    deviation = units * 2.0**-52
    believed = dataclasses.replace(PARAMS.believed, speed=deviation, turn=deviation)
    if key != "fs1":
        believed = dataclasses.replace(believed, range=deviation, bearing=0.1 * deviation)
    params = dataclasses.replace(PARAMS, believed=believed)
    state: Any = ESTIMATORS[key].init(Point(), np.array([4.0, 3.0, 1.0]), np.zeros((3, 3)), params)
    _, trace = ESTIMATORS[key].step(np.random.default_rng(0), state, FRAMES[0], params)
    assert np.isfinite(undrawn_of(trace, FRAMES[0], params)) == told


# Maps -----------------------------------------------------------------------------------------------------------------


def of_copies(key: str) -> tuple[Trace, Frame]:
    """A step before which all particles were copies of one, so that they have the same map."""
    before, params = run(key)[2].resampled, dataclasses.replace(PARAMS, resample_below=0.0)
    same = np.zeros(30, int)
    s, maps = (before.s, before.maps.select(same))
    state: Any = before._replace(s=s, log_w=np.full(30, -math.log(30)), maps=maps)
    return ESTIMATORS[key].step(np.random.default_rng(0), state, FRAMES[3], params)[1], FRAMES[3]


@pytest.mark.parametrize("key", FASTSLAM)
def test_copies_that_write_into_one_map(key: str) -> None:
    trace, frame = of_copies(key)
    R = noises(frame)[1]
    assert len(np.unique(trace.predicted.s, axis=0)) == 30
    assert twins(trace, frame, R) == 0.0
    shared = trace._replace(weighted=trace.weighted._replace(maps=trace.weighted.maps.select(np.zeros(30, int))))
    assert twins(shared, frame, R) == 29.0
    some = np.arange(30)
    some[:4] = 0
    shared = trace._replace(weighted=trace.weighted._replace(maps=trace.weighted.maps.select(some)))
    assert twins(shared, frame, R) == 3.0
    copies = np.repeat([0, 1, 2, 9], [5, 20, 4, 1])
    s = trace.resampled.s[copies]
    copied = shared._replace(selected=copies, resampled=trace.resampled._replace(s=s))
    assert twins(copied, frame, R) == 2.0


@pytest.mark.parametrize("where", ["predicted", "resampled"])
@pytest.mark.parametrize("key", FASTSLAM)
def test_copies_that_stand_at_one_place_have_the_same_map(key: str, where: str) -> None:
    """Where they were predicted, as if features had been corrected there; or where they are now."""
    trace, frame = of_copies(key)
    shared = trace._replace(weighted=trace.weighted._replace(maps=trace.weighted.maps.select(np.zeros(30, int))))
    particles = getattr(shared, where)
    one = shared._replace(**{where: particles._replace(s=np.tile(particles.s[0], (30, 1)))})
    assert twins(one, frame, noises(frame)[1]) == 0.0


def test_corrections_that_are_less_than_rounding() -> None:
    """A sensor that is believed to be worthless corrects nothing: copies keep what they have."""
    trace, frame = of_copies("fs1")
    shared = trace._replace(weighted=trace.weighted._replace(maps=trace.weighted.maps.select(np.zeros(30, int))))
    worthless = dataclasses.replace(PARAMS, inflate_r=1e12)
    assert twins(shared, frame, noises(frame, worthless)[1]) == 0.0
