"""Each filter's observing step against the plain C update of `tests/benchmarks`: a second implementation, in another
language, of the same mathematics.  Its speed is not looked at here."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from slam.estimators import ESTIMATORS
from slam.geometry import wrap_all
from tests.benchmarks.reference import as_arrays, compile_reference, has_compiler, make_world

Reference = Callable[..., None]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Reference:
    if not has_compiler() and os.environ.get("CI") != "true":
        pytest.skip("there is no gcc here to compile tests/benchmarks/update.c")
    folder: Path = tmp_path_factory.mktemp("reference")
    return compile_reference(folder)


@pytest.mark.parametrize("heading", [0.1, math.pi - 0.002])
@pytest.mark.parametrize("key", ["fs1", "fs2", "dfs"])
def test_same_numbers_as_plain_c(reference: Reference, key: str, heading: float) -> None:
    """No control tick and no resampling: what is left of the step is the observation update."""
    world = make_world(key, K=60, features=23, heading=heading, orders=3)
    expected = as_arrays(world.particles, world.n)
    before = expected.copy()
    reference(key, world.frame, world.params, expected, np.random.default_rng(8).standard_normal((60, 3)))

    particles, trace = ESTIMATORS[key].step(np.random.default_rng(8), world.particles, world.frame, world.params)
    np.testing.assert_array_equal(trace.n, world.n)
    assert len({tuple(row) for row in world.n}) == 3
    found = as_arrays(particles, world.n)
    np.testing.assert_allclose(wrap_all(found.s - expected.s), 0.0, atol=1e-12)
    np.testing.assert_allclose(found.P, expected.P, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.map[..., :2], expected.map[..., :2], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.map[..., 2:], expected.map[..., 2:], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(trace.log_likelihood.sum(axis=1), expected.log_w - before.log_w, rtol=1e-9, atol=1e-9)
    normalised = expected.log_w - np.log(np.exp(expected.log_w - expected.log_w.max()).sum()) - expected.log_w.max()
    np.testing.assert_allclose(found.log_w, normalised, rtol=1e-9, atol=1e-9)

    # ... and each part of it happened
    assert (found.s != before.s).any() == (key != "fs1")
    assert (found.map != before.map).any() == (key != "dfs")
    assert np.ptp(expected.log_w - before.log_w) > 1.0
