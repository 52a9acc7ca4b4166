"""That every parameter reaches every filter that it is meant for."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from slam.estimators import ESTIMATORS
from slam.features import Point
from slam.limits import PARAMS
from slam.motion import Unicycle
from slam.phases import initial, resize
from slam.resampling import SCHEMES
from slam.types import IGNORED, NEW, UNKNOWN_TAG, Frame, Noise, Params

ALL = list(ESTIMATORS)
SENSOR = Noise(speed=0.0, turn=0.0, range=0.1, bearing=0.05)


def seen(ranges: list[float], tags: list[int] | None = None) -> Frame:
    """Landmarks straight ahead, one behind the other, from a robot that stands still."""
    z = np.column_stack([ranges, np.zeros(len(ranges))])
    known = np.arange(len(ranges)) if tags is None else np.array(tags)
    return Frame(0.0, Unicycle(), np.zeros((1, 2)), np.ones(1), Point(), z, known)


def second_step(key: str, second: Frame, first: Frame | None = None, **changes: Any) -> Any:
    """The trace of the second of two frames; `changes` hold in the second alone."""
    plain = Params(particles=1, believed=SENSOR, association="known", resample_below=0.0)
    estimator, rng = ESTIMATORS[key], np.random.default_rng(0)
    state = estimator.init(Point(), np.zeros(3), np.zeros((3, 3)), plain)
    state, _ = estimator.step(rng, state, first or seen([5.0]), plain)
    return estimator.step(rng, state, second, Params(**{**vars(plain), **changes}))[1]


@pytest.mark.parametrize("key", ALL)
def test_known_association_ignores_what_nobody_knows(key: str) -> None:
    """Rather than map it anew at every sight of it."""
    trace = second_step(key, seen([5.0, 7.0], [0, UNKNOWN_TAG]))
    assert trace.n[0].tolist() == [0, IGNORED]
    assert trace.resampled.maps.counts[0] == 1


@pytest.mark.parametrize("association", ["nearest", "jcbb"])
@pytest.mark.parametrize("key", ALL)
def test_inflate_r_widens_the_gate(key: str, association: Any) -> None:
    """A metre off is ten deviations of R, and with a hundred times R but one; EKF and FastSLAM add their Sigma."""
    far = seen([6.0])
    assert second_step(key, far, association=association, gate_new=0.0).n[0, 0] == NEW
    assert second_step(key, far, association=association, gate_new=0.0, inflate_r=100.0).n[0, 0] == 0


@pytest.mark.parametrize("key", ALL)
def test_gate_new_ignores_what_is_near(key: str) -> None:
    near = seen([5.6])
    trace = second_step(key, near, association="nearest", gate=0.5, gate_new=1.0 - 1e-15)
    assert trace.n[0, 0] == IGNORED
    assert trace.resampled.maps.counts[0] == 1
    assert second_step(key, near, association="nearest", gate=0.5, gate_new=0.5).n[0, 0] == NEW


@pytest.mark.parametrize("association", ["nearest", "jcbb"])
@pytest.mark.parametrize("key", ALL)
def test_what_is_near_a_feature_that_is_seen_itself_is_new(key: str, association: Any) -> None:
    """Two things stand close together, and the map has one of them."""
    both = seen([5.0, 5.6])
    trace = second_step(key, both, association=association, gate=0.5, gate_new=1.0 - 1e-15)
    assert trace.n[0].tolist() == [0, NEW]
    assert trace.resampled.maps.counts[0] == 2


@pytest.mark.parametrize("key", ALL)
def test_gate_known_disbelieves_a_misread_tag(key: str) -> None:
    misread = seen([9.0], tags=[0])
    assert second_step(key, misread).n[0, 0] == 0
    assert second_step(key, misread, gate_known=0.999999).n[0, 0] == IGNORED


@pytest.mark.parametrize("key", ALL)
def test_temper_scales_the_likelihood(key: str) -> None:
    again = seen([5.05])
    full = second_step(key, again).log_likelihood
    assert full[0, 0] != 0.0
    np.testing.assert_allclose(second_step(key, again, temper=0.3).log_likelihood, 0.3 * full, rtol=1e-12)


@pytest.mark.parametrize("key", ["fs1", "fs2", "dfs"])
def test_a_miss_weighs_in_a_step(key: str) -> None:
    """Unknown association: the density at the gate, plus log_p_new; known association, all agreed: none."""
    both = seen([5.0, 20.0])
    gate = -2.0 * math.log(1.0 - 0.99)  # chi-square of two degrees of freedom
    # P = 0 after a standstill without noise, so V is R itself.
    expected = -math.log(2.0 * math.pi * SENSOR.range * SENSOR.bearing) - 0.5 * gate
    trace = second_step(key, both, association="nearest", log_p_new=-1.5)
    assert trace.n.tolist() == [[0, NEW]]
    assert trace.log_likelihood[0, 1] == pytest.approx(expected - 1.5, rel=1e-9)
    assert second_step(key, both).log_likelihood[0, 1] == 0.0


@pytest.mark.parametrize("key", ["fs1", "fs2", "dfs"])
def test_known_association_weighs_misses_where_particles_disagree(key: str) -> None:
    """After another association one particle may hold a thing that another does not."""
    params = Params(particles=2, believed=SENSOR, association="known", resample_below=0.0)
    particles = initial(Point(), np.zeros(3), np.zeros((3, 3)), params)
    theta, Sigma = np.tile([5.0, 0.0], (2, 1, 1)), np.zeros((2, 1, 2, 2))
    maps = particles.maps.append(np.array([[True], [False]]), theta, Sigma, np.zeros(1, np.int64))
    step, rng = ESTIMATORS[key].step, np.random.default_rng(0)
    _, trace = step(rng, particles._replace(maps=maps), seen([5.0]), params)
    assert trace.n.tolist() == [[0], [NEW]]
    gate = -2.0 * math.log(1.0 - 0.99)
    np.testing.assert_allclose(trace.weighted.log_w[0] - trace.weighted.log_w[1], 0.5 * gate, rtol=1e-9)


@pytest.mark.parametrize("scheme", list(SCHEMES))
def test_resize_uses_the_scheme(scheme: Any) -> None:
    particles = initial(Point(), np.zeros(3), np.zeros((3, 3)), Params(particles=40))
    w = np.random.default_rng(3).dirichlet(np.ones(40))
    _, ancestors = resize(
        np.random.default_rng(7), particles._replace(log_w=np.log(w)), Params(particles=25, resampler=scheme)
    )
    np.testing.assert_array_equal(ancestors, SCHEMES[scheme](np.random.default_rng(7), w, 25))


@pytest.mark.parametrize("association", ["known", "nearest", "jcbb"])
@pytest.mark.parametrize("key", ALL)
def test_an_observation_that_is_no_number_is_ignored(key: str, association: Any) -> None:
    frame = seen([5.0, math.nan, math.inf])
    trace = second_step(key, frame, association=association)
    assert trace.n[0].tolist() == [0, IGNORED, IGNORED]
    assert np.isfinite(trace.resampled.s).all()
    assert np.isfinite(trace.weighted.log_w).all()
    assert trace.resampled.maps.counts[0] == 1


def test_every_number_has_its_limits() -> None:
    """And the defaults lie within."""
    numbers = {name: value for name, value in vars(Params()).items() if type(value) in (int, float)}
    assert numbers.keys() == PARAMS.keys()
    assert all(value in PARAMS[name] for name, value in numbers.items())
