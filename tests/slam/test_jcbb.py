"""Joint compatibility branch and bound against all hypotheses.

Time of one search on one core, median (range 0.1 m and bearing 0.01 rad, landmarks every 3 m, pose known to 0.5 m
and 0.05 rad): 3 us for 5 observations with 9 pairs, 7 us for 10 with 21, 21 us for 15 with 38; at 1 m and 0.1 rad,
110 us for 15 with 96.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

from slam.association.jcbb import MAX_NODES, chi_square_gates, joint_compatibility, workspace
from slam.types import NEW, Floats, Ints


class Pairs(NamedTuple):
    obs: Ints
    feat: Ints
    v: Floats
    C: Floats
    n_obs: int


def search(pairs: Pairs, gates: Floats, max_nodes: int = MAX_NODES) -> tuple[int, float, int, Ints]:
    out = np.full(pairs.n_obs, -7)
    work = workspace(len(pairs.obs), pairs.n_obs)
    count, d2, nodes = joint_compatibility(*pairs[:4], gates, max_nodes, work, out)
    return count, d2, nodes, out


def brute_force(pairs: Pairs, gates: Floats) -> tuple[int, float, Ints]:
    """Every hypothesis there is: the most pairs, then the smallest distance."""
    options = [[None, *np.flatnonzero(pairs.obs == i)] for i in range(pairs.n_obs)]
    by_size: dict[int, list[list[int]]] = {}
    for choice in itertools.product(*options):
        chosen = [p for p in choice if p is not None]
        if len({int(pairs.feat[p]) for p in chosen}) == len(chosen):
            by_size.setdefault(len(chosen), []).append(chosen)
    for m in sorted(by_size, reverse=True):
        if m == 0:
            break
        rows = (2 * np.array(by_size[m])[:, :, None] + np.arange(2)).reshape(-1, 2 * m)
        v, C = pairs.v.ravel()[rows], pairs.C[rows[:, :, None], rows[:, None, :]]
        d2 = np.einsum("hi,hi->h", v, np.linalg.solve(C, v[..., None])[..., 0])
        best = int(np.argmin(d2))
        if d2[best] <= gates[m]:
            out = np.full(pairs.n_obs, NEW)
            out[pairs.obs[by_size[m][best]]] = pairs.feat[by_size[m][best]]
            return m, float(d2[best]), out
    return 0, 0.0, np.full(pairs.n_obs, NEW)


def compatible(v: Floats, C: Floats, obs: Ints, feat: Ints, n_obs: int, gate: float) -> Pairs:
    """The pairs that pass the individual gate."""
    d2 = [v[p] @ np.linalg.solve(C[2 * p : 2 * p + 2, 2 * p : 2 * p + 2], v[p]) for p in range(len(v))]
    keep = np.flatnonzero(np.array(d2) <= gate)
    rows = (2 * keep[:, None] + np.arange(2)).ravel()
    return Pairs(obs[keep], feat[keep], v[keep], np.ascontiguousarray(C[np.ix_(rows, rows)]), n_obs)


def random_pairs(rng: np.random.Generator, gate: float) -> Pairs:
    """Points seen from a pose that is off, so crowded that most observations could be of several.

    Innovations share the pose error, often far larger than R, and some observations are of nothing in the map.
    """
    n_obs, n_feat = int(rng.integers(1, 6)), int(rng.integers(1, 7))
    P = np.diag(10.0 ** rng.uniform(-2, 0.5, 3) * [1, 1, 0.1]) ** 2
    R = np.diag(10.0 ** rng.uniform(-3, -0.3, 2)) ** 2
    points = rng.uniform(-1, 1, (n_feat, 2)) * rng.uniform(0.5, 5)
    error = rng.multivariate_normal(np.zeros(3), P)
    seen = rng.permutation(max(n_obs, n_feat))[:n_obs]
    obs, feat, v, G = [], [], [], []
    for i in range(n_obs):
        real = seen[i] < n_feat and rng.random() < 0.9
        origin = points[seen[i]] if real else rng.uniform(-1, 1, 2) * 5
        lever = np.array([[-1, 0, origin[1]], [0, -1, -origin[0]]])
        z = origin + lever @ error + rng.multivariate_normal(np.zeros(2), R)
        for j in range(n_feat):
            obs.append(i)
            feat.append(j)
            v.append(z - points[j])
            G.append([[-1, 0, points[j, 1]], [0, -1, -points[j, 0]]])
    stacked = np.vstack(G).astype(float)
    C = stacked @ P @ stacked.T + np.kron(np.eye(len(v)), R)
    return compatible(np.array(v), C, np.array(obs), np.array(feat), n_obs, gate)


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.9999])
def test_finds_what_brute_force_finds(confidence: float) -> None:
    gates = chi_square_gates(confidence, 5)
    rng = np.random.default_rng(4)
    sizes, ambiguous = [], 0
    for _ in range(1500):
        pairs = random_pairs(rng, gates[1])
        count, d2, nodes, out = search(pairs, gates)
        expected_count, expected_d2, expected = brute_force(pairs, gates)
        assert count == expected_count
        assert d2 == pytest.approx(expected_d2, rel=1e-6)  # C has a condition number of up to 1e9
        np.testing.assert_array_equal(out, expected)
        assert nodes < MAX_NODES
        sizes.append(count)
        ambiguous += len(pairs.obs) > count
    assert len(set(sizes)) == 6  # from nothing to all five
    assert ambiguous > 100


def test_does_not_depend_on_the_order_of_observations() -> None:
    gates = chi_square_gates(0.9, 5)
    rng = np.random.default_rng(5)
    for _ in range(200):
        pairs = random_pairs(rng, gates[1])
        place = rng.permutation(pairs.n_obs)
        order = np.lexsort((rng.random(len(pairs.obs)), place[pairs.obs]))
        rows = (2 * order[:, None] + np.arange(2)).ravel()
        shuffled = Pairs(
            place[pairs.obs[order]], pairs.feat[order], pairs.v[order], pairs.C[np.ix_(rows, rows)], pairs.n_obs
        )
        np.testing.assert_array_equal(search(shuffled, gates)[3][place], search(pairs, gates)[3])


def row_of_points(x: list[float], shift: float, deviation: float) -> Pairs:
    """Points at (x, 0), all seen from a pose that is `shift` off along x and believed to be within `deviation`."""
    points = np.array(x)
    obs, feat = np.divmod(np.arange(len(x) ** 2), len(x))
    v = np.stack([points[obs] + shift - points[feat], np.zeros(len(obs))], axis=1)
    along = np.kron(np.ones(len(obs)), [1.0, 0.0])
    C = deviation**2 * np.outer(along, along) + 1e-4 * np.eye(2 * len(obs))
    return compatible(v, C, obs, feat, len(x), gate=chi_square_gates(0.99, 1)[1])


def test_a_common_shift_that_misleads_the_nearest_neighbour() -> None:
    pairs = row_of_points([0.0, 1.0, 2.6], shift=0.7, deviation=0.5)
    distance = np.hypot(*pairs.v.T)
    nearest = [pairs.feat[pairs.obs == i][np.argmin(distance[pairs.obs == i])] for i in range(3)]
    assert nearest == [1, 1, 2]  # feature 1 is 0.3 m from observation 0, when the right one is 0.7 m away
    count, d2, _, out = search(pairs, chi_square_gates(0.99, 3))
    np.testing.assert_array_equal(out, [0, 1, 2])
    assert count == 3
    assert d2 == pytest.approx(0.7**2 / 0.5**2, rel=1e-3)  # all of it explained by one error of the pose


def test_at_the_cap_the_best_so_far_stands() -> None:
    """Points at equal distances: a comb whose teeth fit in many ways."""
    gates = chi_square_gates(0.99, 9)
    pairs = row_of_points([0.5 * i for i in range(9)], shift=0.2, deviation=0.6)
    full_count, full_d2, full_nodes, full = search(pairs, gates)
    np.testing.assert_array_equal(full, np.arange(9))
    counts = []
    for cap in range(full_nodes + 1):
        count, d2, nodes, out = search(pairs, gates, max_nodes=cap)
        assert nodes == cap
        assert np.count_nonzero(out != NEW) == count
        assert count < full_count or d2 >= full_d2
        counts.append(count)
    assert counts[0] == 0
    assert counts[1] == 1
    assert counts[-1] == full_count
    assert (np.diff(counts) >= 0).all()


def test_impossible_numbers_pair_nothing() -> None:
    gates = chi_square_gates(0.99, 2)
    pairs = Pairs(np.array([0, 0, 1]), np.array([0, 1, 1]), np.full((3, 2), 0.1), np.eye(6), 2)
    np.testing.assert_array_equal(search(pairs, gates)[3], [0, 1])
    pairs.v[0, 0] = np.nan  # observation 0 now has feature 1 only, which observation 1 wants as well
    assert search(pairs, gates)[0] == 1
    for bad in (np.nan, -1.0, 0.0):
        C = np.eye(6)
        C[5, 5] = bad
        count, d2, _, out = search(pairs._replace(C=C), gates)
        np.testing.assert_array_equal(out, [1, NEW])
        assert (count, np.isfinite(d2)) == (1, True)
    C = np.eye(6)
    C[2:4, 4:6] = C[4:6, 2:4] = np.eye(2)  # the two innovations are one and the same: singular, and not paired together
    singular = pairs._replace(C=C, feat=np.array([0, 1, 0]))
    assert search(singular, gates)[0] == 1
    nothing = Pairs(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 0)), 2)
    count, _, nodes, out = search(nothing, gates)
    assert (count, nodes, list(out)) == (0, 0, [NEW, NEW])


def test_a_gate_that_lets_everything_pass() -> None:
    gates = chi_square_gates(1.0, 2)
    assert np.isfinite(gates).all()
    pairs = Pairs(np.array([0, 1]), np.array([3, 3]), np.array([[9.0, 0], [99.0, 0]]), np.eye(4), 2)
    np.testing.assert_array_equal(search(pairs, gates)[3], [3, NEW])  # still each feature once


def test_gates_are_chi_square_quantiles() -> None:
    for confidence in (0.5, 0.95, 0.99):
        gates = chi_square_gates(confidence, 12)
        assert gates[0] == 0.0
        np.testing.assert_allclose(gates[1:], chi2.ppf(confidence, 2 * np.arange(1, 13)), rtol=1e-12)
