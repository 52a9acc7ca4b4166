"""Resampling against its own promises: unbiased, in range, dead stays dead."""

import math

import numpy as np
import pytest

from slam.resampling import (
    BELOW_ONE,
    SCHEMES,
    effective_sample_size,
    normalise,
    resample,
    wants_resampling,
)

W = np.array([0.004, 0.0, 0.3, 0.096, 0.0, 0.15, 0.05, 0.2, 0.1, 0.08, 0.02, 0.0])
SIZES = [1, 5, 12, 40]

each_scheme = pytest.mark.parametrize("scheme", SCHEMES.values(), ids=SCHEMES.keys())
each_size = pytest.mark.parametrize("size", SIZES)


class Extreme:
    """A generator that returns the same number for ever."""

    def __init__(self, value):
        self.value = value

    def random(self, size=None):
        return self.value if size is None else np.full(size, self.value)


def counts_of(scheme, w, size, draws, seed=7):
    rng = np.random.default_rng(seed)
    return np.array([np.bincount(scheme(rng, w, size), minlength=len(w)) for _ in range(draws)])


@each_scheme
@each_size
def test_every_particle_occurs_as_often_as_its_weight_says(scheme, size):
    counts = counts_of(scheme, W, size, draws=4000)
    error = counts.mean(axis=0) - size * W
    standard_error = counts.std(axis=0) / math.sqrt(len(counts))
    # Up to 5 standard errors: with 192 comparisons one in 10 000 suites would fail by chance.
    assert np.all(np.abs(error) <= 5.0 * standard_error + 1e-9)


@each_scheme
def test_unequal_place_equal_chance(scheme):
    """Twelve equal particles, one survivor: 4000 draws, each 1/12 within 5 standard errors, the first not favoured."""
    share = counts_of(scheme, np.full(12, 1 / 12), 1, draws=4000).mean(axis=0)
    assert np.all(np.abs(share - 1 / 12) < 5.0 * math.sqrt(11 / 144 / 4000))


@each_size
def test_systematic_gives_floor_or_ceiling(size):
    counts = counts_of(SCHEMES["systematic"], W, size, draws=500)
    assert np.all(counts >= np.floor(size * W - 1e-9))
    assert np.all(counts <= np.ceil(size * W + 1e-9))


@each_size
def test_stratified_is_less_than_two_away(size):
    assert np.all(np.abs(counts_of(SCHEMES["stratified"], W, size, draws=500) - size * W) < 2.0)


@each_size
def test_residual_gives_the_floor_for_certain(size):
    assert np.all(counts_of(SCHEMES["residual"], W, size, draws=500) >= np.floor(size * W - 1e-9))


def test_variances_are_ordered():
    """Variance of a count: multinomial has size w (1-w); the others less (they are made for that)."""
    variance = {name: counts_of(s, W, 12, draws=4000).var(axis=0).sum() for name, s in SCHEMES.items()}
    exact = float(np.sum(12 * W * (1 - W)))
    assert abs(variance["multinomial"] - exact) < 0.05 * exact  # 5 standard errors: 5 sqrt(2 / (4000 * 9 bins))
    assert variance["systematic"] < variance["stratified"] < variance["multinomial"]
    assert variance["residual"] < variance["multinomial"]


@each_scheme
@pytest.mark.parametrize("value", [0.0, BELOW_ONE])
@pytest.mark.parametrize("size", [1, 3, 7, 1000])
def test_extreme_random_numbers_stay_in_range(scheme, value, size):
    w = np.array([0.0, 0.1, 0.0, 0.2, 0.3, 0.0, 0.0])
    ancestors = scheme(Extreme(value), w, size)
    assert len(ancestors) == size
    assert np.all(w[ancestors] > 0.0)


@each_scheme
def test_weightless_particles_never_survive(scheme):
    counts = counts_of(scheme, W, 30, draws=1000)
    assert not counts[:, W == 0.0].any()


@each_scheme
def test_the_first_particle_can_die(scheme):
    survived = counts_of(scheme, W, 12, draws=500)[:, 0] > 0
    assert survived.mean() < 0.2  # expected 12 * 0.004 = 0.048


@each_scheme
@each_size
def test_shape_order_and_seed(scheme, size):
    first, again = (scheme(np.random.default_rng(3), W, size) for _ in range(2))
    assert first.shape == (size,)
    assert first.dtype == np.int64
    assert np.all(np.diff(first) >= 0)
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize("name", ["systematic", "stratified", "residual"])
def test_equal_weights_leave_everybody_alive(name):
    for K in (1, 3, 25, 49, 1000):
        ancestors = resample(np.random.default_rng(K), np.full(K, -math.log(K)), K, name)
        np.testing.assert_array_equal(ancestors, np.arange(K))


@each_scheme
def test_one_heavy_particle_takes_all(scheme):
    w = np.exp(normalise(np.array([-1e5, 0.0, -1e5]))[0])
    np.testing.assert_array_equal(scheme(np.random.default_rng(0), w, 5), np.ones(5))


@each_scheme
def test_weights_need_not_be_normalised(scheme):
    """A power of two scales exactly, so the draws are the same bit for bit."""
    a, b = (scheme(np.random.default_rng(5), w, 20) for w in (W, 1024.0 * W))
    np.testing.assert_array_equal(a, b)


def test_normalise_sums_to_one_where_densities_underflow():
    log_w, ok = normalise(np.array([-1e4, -1e4 + math.log(3.0), -np.inf]))
    assert ok
    np.testing.assert_allclose(np.exp(log_w), [0.25, 0.75, 0.0], rtol=1e-12)


@pytest.mark.parametrize(
    ("log_w", "w", "ok"),
    [
        ([0.0], [1.0], True),
        ([1e308, -1e308], [1.0, 0.0], True),
        ([np.nan, 2.0, 2.0], [0.0, 0.5, 0.5], True),
        ([np.inf, 5.0, np.inf, -np.inf], [0.5, 0.0, 0.5, 0.0], True),
        ([-np.inf, -np.inf], [0.5, 0.5], False),
        ([np.nan, np.nan, -np.inf, np.nan], [0.25] * 4, False),
    ],
)
def test_normalise_edges(log_w, w, ok):
    given = np.array(log_w)
    result, possible = normalise(given)
    assert possible is ok
    np.testing.assert_allclose(np.exp(result), w, atol=1e-15)
    np.testing.assert_array_equal(given, log_w)  # not written into


def test_effective_sample_size():
    w = np.array([0.5, 0.25, 0.125, 0.125])
    assert effective_sample_size(np.log(w)) == pytest.approx(1.0 / np.sum(w**2), rel=1e-12)
    assert effective_sample_size(np.log(w) - 1e6) == pytest.approx(1.0 / np.sum(w**2), rel=1e-9)
    assert effective_sample_size(np.zeros(40)) == pytest.approx(40.0, rel=1e-12)
    assert effective_sample_size(np.array([0.0, -np.inf, -1e9])) == 1.0
    assert effective_sample_size(np.full(7, -np.inf)) == pytest.approx(7.0, rel=1e-12)


@pytest.mark.parametrize(
    ("n_eff", "below", "wanted"),
    [
        (1.0, 0.0, False),
        (74.9, 0.75, True),
        (75.0, 0.75, False),
        (100.0, 1.0, True),
        (100.0, 2.0, True),
    ],
)
def test_wants_resampling(n_eff, below, wanted):
    assert wants_resampling(n_eff, 100, below) is wanted


def test_resample_survives_impossible_weights():
    ancestors = resample(np.random.default_rng(1), np.full(8, -np.inf), 8)
    np.testing.assert_array_equal(ancestors, np.arange(8))
