"""Greedy pairing against a plain sorted list."""

from __future__ import annotations

import numpy as np
import pytest

from slam.association.nearest import nearest_first
from slam.types import NEW, Floats, Ints


def pair(obs: Ints, feat: Ints, d2: Floats, n_obs: int) -> Ints:
    out = np.full(n_obs, NEW)
    nearest_first(obs, feat, d2, np.zeros(len(obs), np.bool_), out)
    return out


def brute_force(obs: Ints, feat: Ints, d2: Floats, n_obs: int) -> Ints:
    out, used = np.full(n_obs, NEW), set()
    for _, i, j in sorted(zip(d2, obs, feat, strict=True)):
        if out[i] == NEW and j not in used:
            out[i] = j
            used.add(j)
    return out


def random_pairs(rng: np.random.Generator) -> tuple[Ints, Ints, Floats, int]:
    """Some of all observations with some of all features, no distance twice."""
    n_obs, n_feat = int(rng.integers(1, 8)), int(rng.integers(1, 8))
    chosen = rng.permutation(n_obs * n_feat)[: rng.integers(0, n_obs * n_feat + 1)]
    chosen.sort()
    return chosen // n_feat, chosen % n_feat, rng.permutation(len(chosen)) + rng.random(), n_obs


def test_finds_what_sorting_finds() -> None:
    rng = np.random.default_rng(1)
    unpaired = 0
    for _ in range(2000):
        obs, feat, d2, n_obs = random_pairs(rng)
        out = pair(obs, feat, d2, n_obs)
        np.testing.assert_array_equal(out, brute_force(obs, feat, d2, n_obs))
        paired = out[out != NEW]
        assert len(set(paired)) == len(paired)
        unpaired += len(set(obs)) - len(paired)
    assert unpaired > 1000  # many an observation lost its features to others


def test_the_order_of_observations_and_features_does_not_matter() -> None:
    rng = np.random.default_rng(2)
    for _ in range(500):
        obs, feat, d2, n_obs = random_pairs(rng)
        order, renamed = rng.permutation(len(obs)), rng.permutation(n_obs)
        shuffled = pair(renamed[obs][order], feat[order], d2[order], n_obs)
        np.testing.assert_array_equal(shuffled[renamed], pair(obs, feat, d2, n_obs))


def test_the_nearest_pair_of_all_comes_first() -> None:
    """The first observation would take feature 0; the second one is nearer to it."""
    out = pair(np.array([0, 0, 1]), np.array([0, 1, 0]), np.array([1.0, 3.0, 0.5]), 2)
    np.testing.assert_array_equal(out, [1, 0])
    out = pair(np.array([0, 1]), np.array([0, 0]), np.array([1.0, 0.5]), 3)
    np.testing.assert_array_equal(out, [NEW, 0, NEW])


@pytest.mark.parametrize("left", [NEW, -7])
def test_what_finds_no_feature_is_left_as_it_is(left: int) -> None:
    out = np.full(3, left)
    empty = np.zeros(0, np.int64)
    nearest_first(empty, empty, np.zeros(0), np.zeros(0, np.bool_), out)
    np.testing.assert_array_equal(out, left)
