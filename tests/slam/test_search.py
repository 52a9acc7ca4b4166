"""The search over the map (4.3), and association through it, against looking at every feature.

Cost of association with JCBB (10 observations, a street with a landmark every 2 m, pose known to 5 cm and 0.3 degrees),
per particle and observation on one core: 0.44 us with 100 features in each map, 0.46 with 400, 0.47 with 1600, 0.50
with 6400.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

from slam.association import MAX_CANDIDATES, associate
from slam.association.jcbb import chi_square_gates
from slam.features import Point
from slam.map_store import FAN, LEAF, Maps, MapStore, search
from slam.motion import Unicycle
from slam.types import IGNORED, NEW, UNKNOWN_TAG, Floats, Frame, Ints, ObservationNoise, Params, Particles
from tests.slam import test_jcbb

PI = math.pi


def maps_of(theta: Floats, Sigma: Floats, chunk: int = 50) -> Maps:
    """theta (K, n, 2), Sigma (K, n, 2, 2), appended a few at a time."""
    K, size = theta.shape[:2]
    maps = MapStore(Point()).empty(K)
    for first in range(0, size, chunk):
        part = slice(first, min(first + chunk, size))
        new = np.ones((K, part.stop - first), np.bool_)
        maps = maps.append(new, theta[:, part], Sigma[:, part], np.full(new.shape[1], UNKNOWN_TAG))
    return maps


def along_a_way(rng: np.random.Generator, K: int, size: int, spread: float) -> tuple[Floats, Floats]:
    """Features as a robot makes them that wanders about; each particle its own.  Sigma is zero or up to spread^2."""
    way = np.cumsum(rng.normal(0, 1.0, (size, 2)), axis=0)
    theta = way + rng.normal(0, 5.0, (size, 2)) + rng.normal(0, 0.1, (K, size, 2))
    root = rng.normal(size=(K, size, 2, 2)) * spread * rng.random((K, size, 1, 1)) ** 3
    return theta, root @ root.swapaxes(2, 3)


# The search ---------------------------------------------------------------------------------------------------------


def found_in(maps: Maps, k: int, box: tuple[float, float, float, float], reach: float, most: int = 100_000) -> Ints:
    stack, found = np.empty((FAN * maps.depth + 1, 3), np.int64), np.full(most, -7)
    size = search(maps.store.pool, maps.roots[k], maps.depth, maps.counts[k], box, reach, stack, found)
    assert size <= most
    assert (found[size:] == -7).all()
    return found[:size]


def must_be_found(maps: Maps, k: int, box: tuple[float, float, float, float], reach: float) -> Ints:
    """Features in the box, grown by `reach` times the deviation of each along its longest axis."""
    theta, Sigma, _ = maps.features(k)
    slack = reach * np.sqrt(np.linalg.eigvalsh(Sigma)[:, -1])
    x0, y0, x1, y1 = box
    x, y = theta.T
    return np.flatnonzero((x >= x0 - slack) & (x <= x1 + slack) & (y >= y0 - slack) & (y <= y1 + slack))


def assert_nothing_omitted(maps: Maps, rng: np.random.Generator, searches: int) -> tuple[int, int]:
    """Random boxes, most of them about a feature, some of no size; returns (looked for, found)."""
    wanted, brought = 0, 0
    for _ in range(searches):
        k = int(rng.integers(len(maps)))
        theta, _, _ = maps.features(k)
        at = theta[rng.integers(len(theta))] + rng.choice([0.0, 3.0]) * rng.normal(size=2)
        half = rng.choice([0.0, 0.5, 3.0, 20.0], 2)
        box = (at[0] - half[0], at[1] - half[1], at[0] + half[0], at[1] + half[1])
        reach = rng.uniform(0, 6)
        found, needed = found_in(maps, k, box, reach), must_be_found(maps, k, box, reach)
        assert len(set(found)) == len(found)
        assert set(needed) <= set(found)
        assert found.min(initial=0) >= 0
        assert found.max(initial=0) < maps.counts[k]
        wanted, brought = wanted + len(needed), brought + len(found)
    return wanted, brought


@pytest.mark.parametrize("spread", [0.0, 1.0])
@pytest.mark.parametrize("size", [1, 5, 130, 600, 4500])
def test_the_search_omits_nothing(size: int, spread: float) -> None:
    """On trees of one, two and three levels, before and after features were moved, near and far."""
    rng = np.random.default_rng(size)
    maps = maps_of(*along_a_way(rng, 2, size, spread))
    assert maps.depth == 1 + (size > LEAF * FAN) + (size > LEAF * FAN**2)
    wanted, brought = assert_nothing_omitted(maps, rng, 150)
    assert wanted > 60
    assert size < 1000 or brought < 0.3 * 150 * size  # and it does not bring everything
    for scale in (0.1, 300.0):
        n = rng.integers(0, size, (2, 6))
        theta, Sigma = maps.take(n)
        maps = maps.replace(n, theta + rng.normal(0, scale, theta.shape), Sigma * rng.choice([0.1, 1.0, 4.0]))
        assert_nothing_omitted(maps, rng, 50)
    maps = maps.select(np.array([1, 1, 0]))
    assert_nothing_omitted(maps, rng, 30)


def test_a_feature_that_moved_is_found_where_it_is() -> None:
    rng = np.random.default_rng(1)
    maps = maps_of(*along_a_way(rng, 1, 700, 0.0))
    moved = maps.replace(np.array([[333]]), np.array([[[1e4, -1e4]]]), np.zeros((1, 1, 2, 2)))
    there = (1e4 - 1, -1e4 - 1, 1e4 + 1, -1e4 + 1)
    assert 333 in found_in(moved, 0, there, 3.0)
    assert len(found_in(moved, 0, there, 3.0)) <= LEAF
    assert len(found_in(maps, 0, there, 3.0)) == 0  # the version before is not touched


def test_features_that_moved_together_are_found_where_they_are() -> None:
    """Two of one leaf, one of its neighbour and one far away, each to a place of its own."""
    n = np.array([[4, 7, 8, 650]])
    maps = maps_of(*along_a_way(np.random.default_rng(1), 1, 700, 0.0))
    theta = 1e4 * np.array([[[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]])
    moved = maps.replace(n, theta, np.zeros((1, 4, 2, 2)))
    for index, (x, y) in zip(n[0], theta[0], strict=True):
        assert index in found_in(moved, 0, (x - 1, y - 1, x + 1, y + 1), 3.0)


@pytest.mark.parametrize("index", [22, 222])
def test_an_uncertain_feature_is_looked_for_far_away(index: int) -> None:
    """One made before the tree had a second level, and one made after."""
    Sigma = np.zeros((1, 300, 2, 2))
    Sigma[0, index] = [[4.0, 0.0], [0.0, 0.0]]
    theta = np.stack([np.arange(300.0), np.zeros(300)], axis=-1)[None]
    maps = maps_of(theta, Sigma)
    for grown in (maps, maps.replace(np.array([[10]]), np.zeros((1, 1, 2)), np.zeros((1, 1, 2, 2)))):
        assert index in found_in(grown, 0, (index, 5.9, index, 5.9), 3.0)
        assert index not in found_in(grown, 0, (index, 6.1, index, 6.1), 3.0)
        assert index not in found_in(grown, 0, (index, 5.9, index, 5.9), 2.5)


def test_the_search_brings_no_more_than_there_is_room_for() -> None:
    maps = maps_of(*along_a_way(np.random.default_rng(2), 1, 500, 0.0))
    everywhere = (-1e9, -1e9, 1e9, 1e9)
    np.testing.assert_array_equal(np.sort(found_in(maps, 0, everywhere, 1.0)), np.arange(500))
    for most in (0, 1, 7):
        assert len(found_in(maps, 0, everywhere, 1.0, most)) == most
    assert len(found_in(MapStore(Point()).empty(1), 0, everywhere, 1.0)) == 0


def test_the_search_looks_at_a_part_of_a_large_map() -> None:
    """10 000 features in a street; a box of 20 m brings those of 20 m, and no more than a leaf at either end."""
    theta = np.stack([0.5 * np.arange(10_000), np.zeros(10_000)], axis=-1)[None]
    maps = maps_of(theta, np.zeros((1, 10_000, 2, 2)), chunk=500)
    for x in (10.0, 2500.0, 4985.0):
        found = found_in(maps, 0, (x - 10, -10.0, x + 10, 10.0), 3.0)
        assert 40 <= len(found) <= 40 + 2 * LEAF


# Association --------------------------------------------------------------------------------------------------------


class Case(NamedTuple):
    """What a filter could be in: how far off its poses are, and what its sensor and its features are worth."""

    position: float
    """[m]"""
    heading: float
    """[rad]"""
    range: float
    """[m]"""
    bearing: float
    """[rad]"""
    spread: float
    """[m] the largest deviation of a feature."""
    density: float
    """Features per square metre."""


def noise(R: Floats) -> ObservationNoise:
    """R (Z, 2, 2) of points."""
    return ObservationNoise(R, np.zeros((2, 2)))


CASES = {
    "dual-accurate": Case(0.02, 0.005, 0.003, 5e-5, 0.0, 0.1),
    "dual-after-a-turn": Case(0.02, 0.1, 0.003, 5e-5, 0.0, 0.1),
    "dual-turned-far": Case(0.1, 0.3, 0.05, 0.01, 0.0, 0.1),
    "dual-lost": Case(2.0, 0.5, 0.1, 0.02, 0.0, 0.02),
    "fastslam-accurate": Case(0.0, 0.0, 0.02, 0.005, 0.05, 0.1),
    "fastslam-coarse": Case(0.0, 0.0, 0.3, 0.1, 1.5, 0.05),
    "fastslam2-coarse": Case(0.3, 0.2, 0.3, 0.1, 1.0, 0.02),
}


def situation(rng: np.random.Generator, case: Case, K: int, Z: int) -> tuple[Particles, Frame, Floats]:
    """A field of features, poses in it (headings of +-pi among them), and observations of some of what is there."""
    side = 60.0
    size = int(case.density * side**2)
    truth = rng.uniform(0, side, (size, 2))
    truth = truth[np.lexsort((truth[:, 1], truth[:, 0] // 5))]  # in strips, as they are met
    root = rng.normal(size=(K, size, 2, 2)) * 0.5 * case.spread * rng.random((K, size, 1, 1))
    theta = truth + (root @ rng.normal(size=(K, size, 2, 1)))[..., 0]
    maps = maps_of(theta, root @ root.swapaxes(2, 3))

    robot = np.array([*rng.uniform(0.3 * side, 0.7 * side, 2), rng.choice([rng.uniform(-PI, PI), PI - 0.01, -PI])])
    error = rng.normal(size=(3, 3)) * np.array([case.position, case.position, case.heading])[:, None] / math.sqrt(3)
    s = robot + rng.normal(size=(K, 3)) @ error.T
    s[:, 2] = (s[:, 2] + PI) % (2 * PI) - PI
    P = np.broadcast_to(error @ error.T, (K, 3, 3)).copy()

    d = truth - robot[:2]
    r = np.hypot(*d.T)
    seen = rng.permutation(np.flatnonzero((r > 0.5) & (r < 25)))[:Z]
    z = np.column_stack([r[seen], np.arctan2(d[seen, 1], d[seen, 0]) - robot[2]])
    z += rng.normal(size=z.shape) * [case.range, case.bearing]
    z[-1] = [rng.uniform(1, 25), rng.uniform(-PI, PI)]  # of nothing in particular
    z[:, 0], z[:, 1] = np.abs(z[:, 0]), (z[:, 1] + PI) % (2 * PI) - PI
    R = np.tile(np.diag([case.range, case.bearing]) ** 2, (len(z), 1, 1))
    frame = Frame(0.0, Unicycle(), np.zeros((0, 2)), np.zeros(0), Point(), z, np.full(len(z), UNKNOWN_TAG))
    return Particles(s, P, np.zeros(K), np.arange(K), maps), frame, R


def every_pair(s: Floats, P: Floats, theta: Floats, Sigma: Floats, z: Floats, R: Floats) -> tuple[Floats, ...]:
    """v (Z, n, 2), V (Z, n, 2, 2), d2 (Z, n) and G_s (n, 2, 3) of every observation with every feature (23-25)."""
    d = theta - s[:2]
    r = np.hypot(*d.T)
    G_theta = np.stack([d / r[:, None], np.column_stack([-d[:, 1], d[:, 0]]) / r[:, None] ** 2], axis=1)
    G_s = np.concatenate([-G_theta, np.broadcast_to([[0.0], [-1.0]], (len(r), 2, 1))], axis=2)
    V = (G_s @ P @ G_s.swapaxes(1, 2) + G_theta @ Sigma @ G_theta.swapaxes(1, 2)) + R[:, None]
    turn = z[:, None, 1] - np.arctan2(d[:, 1], d[:, 0]) + s[2]
    v = np.stack([z[:, None, 0] - r, np.arctan2(np.sin(turn), np.cos(turn))], axis=-1)
    return v, V, np.sum(v * np.linalg.solve(V, v[..., None])[..., 0], axis=-1), G_s


def associated_by_looking_at_all(
    particles: Particles, k: int, frame: Frame, R: Floats, params: Params
) -> tuple[Ints, int]:
    """What `associate` says it does, for particle k, without a search; also how many features passed a gate."""
    Z, s, P = len(frame.z), particles.s[k], particles.P[k]
    theta, Sigma, _ = particles.maps.features(k)
    v, V, d2, G_s = every_pair(s, P, theta, Sigma, frame.z, R)
    gates = chi_square_gates(params.gate, Z)
    pairs = [(i, j) for i in range(Z) for j in np.argsort(d2[i])[:MAX_CANDIDATES] if d2[i, j] <= gates[1]]
    obs, feat = np.array(pairs, np.int64).reshape(-1, 2).T
    n = np.full(Z, NEW)
    if params.association == "nearest":
        for p in np.argsort(d2[obs, feat]):
            if n[obs[p]] == NEW and feat[p] not in n:
                n[obs[p]] = feat[p]
    else:
        stacked = G_s[feat].reshape(-1, 3)
        C = stacked @ P @ stacked.T
        for p in range(len(pairs)):
            C[2 * p : 2 * p + 2, 2 * p : 2 * p + 2] = V[obs[p], feat[p]]
        n = test_jcbb.brute_force(test_jcbb.Pairs(obs, feat, v[obs, feat], C, Z), gates)[2]
    if params.gate_new > params.gate:
        unpaired = ~np.isin(np.arange(d2.shape[1]), n)
        n[(n == NEW) & (d2[:, unpaired].min(axis=1, initial=np.inf) <= chi2.ppf(params.gate_new, 2))] = IGNORED
    return n, int((d2 <= gates[1]).sum())


@pytest.mark.parametrize("gate_new", [0.0, 0.999999])
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("association", ["nearest", "jcbb"])
def test_association_is_that_of_looking_at_all_features(association: str, case: str, gate_new: float) -> None:
    rng = np.random.default_rng(3)
    params = Params(association=association, gate_new=gate_new)
    # all hypotheses of an ambiguous frame are many: fewer observations then
    nearest = association == "nearest"
    K, Z = (12, 10) if nearest else (5, 3)
    matched, looked_at, passed = 0, 0, 0
    for _ in range(8):
        particles, frame, R = situation(rng, CASES[case], K, Z)
        n = associate(particles, frame, noise(R), params)
        for k in range(K):
            expected, in_gate = associated_by_looking_at_all(particles, k, frame, R, params)
            np.testing.assert_array_equal(n[k], expected)
            passed += in_gate
        matched, looked_at = matched + (n >= 0).sum(), looked_at + n.size
    assert matched > (0.6 if nearest else 0.4) * looked_at
    assert passed >= matched


@pytest.mark.parametrize("association", ["nearest", "jcbb"])
@pytest.mark.parametrize("direction", [0.0, PI / 4, PI / 2, PI, -PI / 2])
def test_a_feature_far_along_the_arc_is_found(association: str, direction: float) -> None:
    """The heading is 0.8 rad off, of which it believes 0.3, and the feature 20 m away: 6 m off the tangent."""
    s, P = np.array([[3.0, -2.0, direction - 0.8]]), np.diag([0.02, 0.02, 0.3]) ** 2
    for sign in (-1, 1):
        at = s[0, :2] + 20.0 * np.array([math.cos(direction), math.sin(direction)])
        maps = maps_of(at[None, None], np.zeros((1, 1, 2, 2)))
        s[0, 2] = direction + sign * 0.8
        frame = Frame(
            0.0, Unicycle(), np.zeros((0, 2)), np.zeros(0), Point(), np.array([[20.0, 0.0]]), np.array([UNKNOWN_TAG])
        )
        particles = Particles(s, P[None], np.zeros(1), np.arange(1), maps)
        n = associate(particles, frame, noise(np.diag([0.003, 0.003])[None] ** 2), Params(association=association))
        assert n.tolist() == [[0]]


def test_a_crowd_does_not_hide_the_right_feature() -> None:
    """2000 features within the region of search, in an order that has nothing to do with where they are."""
    rng = np.random.default_rng(4)
    theta = rng.uniform(-20, 20, (1, 2000, 2))
    right = 1234
    theta[0, right] = [10.0, 0.0]
    maps = maps_of(theta, np.zeros((1, 2000, 2, 2)))
    P = np.diag([1.5, 1.5, 0.3]) ** 2
    frame = Frame(0.0, Unicycle(), np.zeros((0, 2)), np.zeros(0), Point(), np.array([[10.0, 0.0]]), np.array([7]))
    particles = Particles(np.zeros((1, 3)), P[None], np.zeros(1), np.arange(1), maps)
    R = np.diag([0.01, 0.001])[None] ** 2
    assert associate(particles, frame, noise(R), Params(association="nearest")).tolist() == [[right]]


def test_a_feature_where_the_robot_stands_spoils_nothing() -> None:
    """Its innovation has no bearing and is not a number; the others are found all the same."""
    maps = maps_of(np.array([[[0.0, 0.0], [5.0, 0.0]]]), np.zeros((1, 2, 2, 2)))
    frame = Frame(0.0, Unicycle(), np.zeros((0, 2)), np.zeros(0), Point(), np.array([[5.0, 0.0]]), np.array([7]))
    particles = Particles(np.zeros((1, 3)), np.diag([2.0, 2.0, 0.1])[None], np.zeros(1), np.arange(1), maps)
    for association in ("nearest", "jcbb"):
        params = Params(association=association)
        assert associate(particles, frame, noise(np.diag([0.1, 0.01])[None] ** 2), params).tolist() == [[1]]


@pytest.mark.parametrize("association", ["known", "nearest", "jcbb"])
def test_nothing_seen_and_nothing_known(association: str) -> None:
    params = Params(association=association)
    for Z, size in [(0, 3), (2, 0), (0, 0)]:
        theta = np.zeros((3, size, 2))
        frame = Frame(0.0, Unicycle(), np.zeros((0, 2)), np.zeros(0), Point(), np.ones((Z, 2)), np.arange(Z))
        maps = maps_of(theta, np.zeros((3, size, 2, 2)))
        particles = Particles(np.zeros((3, 3)), np.zeros((3, 3, 3)), np.zeros(3), np.arange(3), maps)
        n = associate(particles, frame, noise(np.tile(np.eye(2), (Z, 1, 1))), params)
        assert n.tolist() == [[NEW] * Z] * 3
