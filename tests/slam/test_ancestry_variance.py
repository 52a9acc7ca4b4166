"""The variance that ancestry tells of one run, against the variance over many runs on the same data."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from scenarios.registry import build
from slam.ancestry_variance import APART, ancestry_variance, luck_of_pose
from slam.estimators import ESTIMATORS
from slam.genealogy import trace_back
from slam.metrics import mixture_moments, pose_error
from slam.resampling import effective_sample_size, normalise, resample
from slam.types import Floats, Ints, ResamplerName

DRIFT, NOISE, SENSOR = 0.9, 0.5, 1.0
"""Of the toy: x := DRIFT x + NOISE w, seen with SENSOR v."""


class Toy(NamedTuple):
    """A bootstrap filter of the linear-Gaussian toy at its end."""

    x: Floats
    w: Floats
    ancestors: list[Ints]

    @property
    def mean(self) -> float:
        return float(self.w @ self.x)

    def variance(self, lag: int | None = None, apart: float = APART) -> float:
        """By the founders, or by the ancestors so many resamplings back."""
        lag = len(self.ancestors) if lag is None else lag
        families = trace_back(self.ancestors, np.arange(len(self.x)))[-1 - lag]
        return float(ancestry_variance((self.x - self.mean)[:, None], self.w, families, apart)[0])


def seen(steps: int) -> Floats:
    """What all runs of the toy see."""
    rng, x, z = np.random.default_rng(4), 0.0, []
    for _ in range(steps):
        x = DRIFT * x + NOISE * rng.standard_normal()
        z.append(x + SENSOR * rng.standard_normal())
    return np.array(z)


def filtered(
    run: int, z: Floats, sizes: Callable[[int], int], scheme: ResamplerName = "multinomial", below: float = 1.0
) -> Toy:
    """One run; `sizes` says how many particles a step has."""
    rng = np.random.default_rng(1000 + run)
    K = sizes(0)
    x, log_w, ancestors = rng.standard_normal(K), np.full(K, -np.log(K)), []
    for t, seen_now in enumerate(z):
        if t and (len(x) != sizes(t) or effective_sample_size(log_w) < below * len(x)):
            ancestors.append(resample(rng, log_w, sizes(t), scheme))
            x, log_w = x[ancestors[-1]], np.full(sizes(t), -np.log(sizes(t)))
        x = DRIFT * x + NOISE * rng.standard_normal(len(x))
        log_w = normalise(log_w - 0.5 * ((seen_now - x) / SENSOR) ** 2)[0]
    return Toy(x, np.exp(log_w), ancestors)


class TestEquation:
    def test_by_hand(self):
        """Families {0, 2} and {1}: sums .25 x 1 - .25 x 3 = -.5 and .5 x 1 = .5; of the pairs half are apart."""
        f, w = np.array([[1.0], [1.0], [-3.0]]), np.array([0.25, 0.5, 0.25])
        found = ancestry_variance(f, w, np.array([4, 0, 4]), apart=0.5)
        assert found == pytest.approx([(0.25 + 0.25) / 0.5])

    def test_each_a_family_is_importance_sampling(self):
        rng = np.random.default_rng(0)
        f, w = rng.normal(size=(50, 2)), rng.dirichlet(np.full(50, 4.0))
        f -= w @ f
        expected = (w**2) @ f**2 / (1.0 - w @ w)
        np.testing.assert_allclose(ancestry_variance(f, w, np.arange(50)), expected, rtol=1e-12)

    def test_nothing_is_told_by_too_few_families(self):
        f, w = np.ones((12, 3)), np.full(12, 1.0 / 12.0)
        assert np.isfinite(ancestry_variance(f, w, np.arange(12) // 2)).all()  # six families: .83 are apart
        assert np.isnan(ancestry_variance(f, w, np.arange(12) // 3)).all()  # four: .75
        for apart in (0.0, APART):
            assert np.isnan(ancestry_variance(f, w, np.zeros(12, np.int64), apart)).all()
        assert np.isnan(ancestry_variance(f[:1], np.ones(1), np.zeros(1, np.int64))).all()

    def test_share_of_pairs_is_the_factor_of_lee_and_whiteley(self):
        """For multinomial resampling from equal weights: (1 - 1 / K)^(n + 1)."""
        rng, K, n, apart = np.random.default_rng(1), 20, 6, []
        for _ in range(2000):
            founders = np.arange(K)
            for _ in range(n):
                founders = founders[resample(rng, np.zeros(K), K, "multinomial")]
            apart.append(1.0 - ((np.bincount(founders, minlength=K) / K) ** 2).sum())
        assert np.mean(apart) == pytest.approx((1.0 - 1.0 / K) ** (n + 1), abs=0.003)


class TestToy:
    """Means over 500 runs (300); the variance of these has a standard error of 6 % (8)."""

    @pytest.mark.parametrize(
        ("sizes", "scheme", "below"),
        [
            (lambda t: 300, "multinomial", 1.0),
            (lambda t: 300, "systematic", 0.5),  # now and then, so that weights are of several steps
            (lambda t: 400 if t < 5 else 150, "systematic", 0.75),
            (lambda t: 150 if t < 5 else 400, "multinomial", 0.75),
        ],
    )
    def test_founders(self, sizes: Callable[[int], int], scheme: ResamplerName, below: float):
        z = seen(8)
        runs = [filtered(i, z, sizes, scheme, below) for i in range(500)]
        resampled = np.mean([len(run.ancestors) for run in runs])
        assert resampled == 7 if below == 1.0 else 0.5 < resampled < 4
        ratio = np.mean([run.variance() for run in runs]) / np.var([run.mean for run in runs])
        assert ratio == pytest.approx(1.0, abs=0.2)

    def test_later_ancestors_of_a_filter_that_forgets(self):
        """After 60 steps with 80 particles no founders tell anything.  Four steps back enough ancestors are left, and
        what luck did before is forgotten; with the last step alone half of the variance is missing."""
        z = seen(60)
        runs = [filtered(i, z, lambda t: 80) for i in range(300)]
        truth = np.var([run.mean for run in runs])
        assert np.isnan([run.variance() for run in runs]).all()
        ratios = {lag: np.mean([run.variance(lag) for run in runs]) / truth for lag in (0, 4)}
        assert ratios[4] == pytest.approx(1.0, abs=0.25)
        assert ratios[0] < 0.6


class TestFilters:
    @pytest.mark.parametrize("key", ["dfs", "fs2"])
    def test_of_the_pose(self, key: str):
        """Forty steps of the paper's line with 60 particles: 40 runs on the same data.  The deviations of x, y and
        heading are those over the runs, within 1.25; with each a family by itself, they are not at the end."""
        source = build("paper-line")
        params, filter_ = source.params(particles=60), ESTIMATORS[key]
        estimates, told, alone = np.zeros((3, 40, 40, 3))
        for run in range(40):
            rng = np.random.default_rng(run)
            state = filter_.init(source.feature, source.start, source.start_covariance, params)
            for t, (frame, _) in enumerate(source.steps[:40]):
                state, trace = filter_.step(rng, state, frame, params)
                weighted = trace.weighted
                estimates[run, t], _ = mixture_moments(weighted.s, weighted.P, np.exp(weighted.log_w))
                told[run, t] = luck_of_pose(weighted, estimates[run, t])
                alone[run, t] = luck_of_pose(weighted._replace(lineage=np.arange(60)), estimates[run, t])
        truth = pose_error(estimates, estimates[0]).var(axis=0, ddof=1)
        for t in (9, 19, 39):
            ratios = np.sqrt(told[:, t].mean(axis=0) / truth[t])
            assert (np.abs(np.log(ratios)) < np.log(1.25)).all(), ratios
        assert (np.sqrt(alone[:, -1].mean(axis=0) / truth[-1]) < 0.8).all()
