"""The persistent map store against a naive one, which copies whole maps."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

from slam.features import Point
from slam.map_store import FAN, LEAF, Maps, MapStore
from slam.types import IGNORED, NEW, UNKNOWN_TAG, Floats, Ints
from tests.slam.linear import uncached_kernels


class Segment(NamedTuple):
    """Five numbers a feature: a frame (x, y, heading) and two ends; only what the store asks of a kind."""

    dim = 5

    spread = Point.spread

    @staticmethod
    def extent(feature: Any, theta: Any) -> Any:
        return theta[0] + theta[3], theta[1] + theta[3], theta[0] + theta[4], theta[1] + theta[4]


class Place(NamedTuple):
    """Three numbers a feature."""

    dim = 3

    spread = Point.spread

    @staticmethod
    def extent(feature: Any, theta: Any) -> Any:
        return theta[0], theta[1], theta[0], theta[1]


KINDS = [Point(), Place(), Segment()]


@pytest.fixture(scope="module", autouse=True)
def _no_cached_kernels() -> Iterator[None]:
    with uncached_kernels():
        yield


# The naive store ----------------------------------------------------------------------------------------------------

Map = dict[str, list[Any]]
"""Lists of equal length: theta, Sigma, tag, None for a tag of what was removed.  Never changed, only copied."""


class Naive(NamedTuple):
    """What `Maps` does, on plain lists."""

    maps: list[Map]

    def select(self, ancestors: Ints) -> Naive:
        return Naive([self.maps[a] for a in ancestors])

    def replace(self, n: Ints, theta: Floats, Sigma: Floats) -> Naive:
        out = []
        for k, old in enumerate(self.maps):
            new = {key: list(values) for key, values in old.items()}
            for i, j in enumerate(n[k]):
                if j >= 0:
                    new["theta"][j], new["Sigma"][j] = theta[k, i].copy(), Sigma[k, i].copy()
            out.append(new)
        return Naive(out)

    def remove(self, n: Ints) -> Naive:
        out = []
        for k, old in enumerate(self.maps):
            gone = {int(j) for j in n[k] if j >= 0}
            out.append({**old, "tag": [None if j in gone else tag for j, tag in enumerate(old["tag"])]})
        return Naive(out)

    def append(self, wanted: Any, theta: Floats, Sigma: Floats, tags: Ints) -> Naive:
        out = []
        for k, old in enumerate(self.maps):
            new = {key: list(values) for key, values in old.items()}
            for i in np.flatnonzero(wanted[k]):
                new["theta"].append(theta[k, i].copy())
                new["Sigma"].append(Sigma[k, i].copy())
                new["tag"].append(int(tags[i]))
            out.append(new)
        return Naive(out)

    def find(self, tags: Ints) -> Ints:
        n = np.full((len(self.maps), len(tags)), NEW)
        for k, m in enumerate(self.maps):
            for i, tag in enumerate(tags):
                if tag != UNKNOWN_TAG and tag in m["tag"]:
                    n[k, i] = m["tag"].index(tag)
        return n

    def hypotheses(self) -> tuple[list[int], list[int]]:
        """By feature: how many copies differ, and how many maps have it."""
        copies, holders = [], []
        for j in range(max((len(m["tag"]) for m in self.maps), default=0)):
            there = [m for m in self.maps if j < len(m["tag"]) and m["tag"][j] is not None]
            copies.append(len({(m["theta"][j].tobytes(), m["Sigma"][j].tobytes()) for m in there}))
            holders.append(len(there))
        return copies, holders


def naive(K: int) -> Naive:
    return Naive([{"theta": [], "Sigma": [], "tag": []} for _ in range(K)])


def assert_same(maps: Maps, model: Naive) -> None:
    """To the bit, feature by feature."""
    assert len(maps) == len(model.maps)
    np.testing.assert_array_equal(maps.counts, [len(m["tag"]) for m in model.maps])
    for k, m in enumerate(model.maps):
        theta, Sigma, tags = maps.features(k)
        there = [j for j, tag in enumerate(m["tag"]) if tag is not None]
        assert theta.shape == (len(there), maps.store.dim)
        assert Sigma.shape == (len(there), 2, 2)
        if there:
            np.testing.assert_array_equal(theta, [m["theta"][j] for j in there])
            np.testing.assert_array_equal(Sigma, [m["Sigma"][j] for j in there])
        np.testing.assert_array_equal(tags, [m["tag"][j] for j in there])
        np.testing.assert_array_equal(maps.indices(k), there)
        np.testing.assert_array_equal(maps.tags(k), [UNKNOWN_TAG if tag is None else tag for tag in m["tag"]])
    for found, wanted in zip(maps.hypotheses(), model.hypotheses(), strict=True):
        np.testing.assert_array_equal(found, wanted)


def values(rng: np.random.Generator, K: int, Z: int, dim: int) -> tuple[Floats, Floats]:
    """theta (K, Z, D) and symmetric Sigma (K, Z, 2, 2)."""
    Sigma = rng.random((K, Z, 2, 2))
    return rng.normal(0, 100, (K, Z, dim)), Sigma + Sigma.swapaxes(2, 3)


def correspondences(rng: np.random.Generator, counts: Ints, Z: int) -> Ints:
    """n (K, Z): features that are there, now and then NEW or IGNORED, now and then one twice."""
    n = (rng.random((len(counts), Z)) * counts[:, None]).astype(np.int64)
    nothing = (rng.random(n.shape) < 0.2) | (counts[:, None] == 0)
    return np.where(nothing, rng.choice([NEW, IGNORED], n.shape), n)


def filled(K: int, n: int, seed: int = 0) -> tuple[Maps, Naive]:
    """K maps of n features each, tags 0 .. n - 1."""
    rng = np.random.default_rng(seed)
    maps, model = MapStore(Point()).empty(K), naive(K)
    theta, Sigma = values(rng, K, n, 2)
    everywhere = np.ones((K, n), np.bool_)
    return (
        maps.append(everywhere, theta, Sigma, np.arange(n)),
        model.append(everywhere, theta, Sigma, np.arange(n)),
    )


# Random operations --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: f"D={type(kind).dim}")
def test_random_operations(kind: Any, seed: int) -> None:
    """1000 operations; old `Maps` are kept for a while, looked at again and dropped, while the pool is collected."""
    rng = np.random.default_rng(seed)
    maps, model = MapStore(kind).empty(4), naive(4)
    old: list[tuple[Maps, Naive]] = []
    collections, pool, most = 0, maps.store.pool, 0
    for step in range(1000):
        K, Z = len(maps), int(rng.integers(1, 7))
        what = rng.choice(
            ["append", "replace", "remove", "select", "find", "take"], p=[0.35, 0.25, 0.05, 0.15, 0.1, 0.1]
        )
        if what == "append":
            Z = int(rng.integers(1, 40)) if rng.random() < 0.05 else Z
            wanted = rng.random((K, Z)) < rng.choice([0.1, 0.5, 1.0])
            tags = rng.integers(-3, 60, Z)  # -1 is nobody's; the others come again and again
            theta, Sigma = values(rng, K, Z, maps.store.dim)
            maps, model = maps.append(wanted, theta, Sigma, tags), model.append(wanted, theta, Sigma, tags)
        elif what == "replace":
            n, (theta, Sigma) = correspondences(rng, maps.counts, Z), values(rng, K, Z, maps.store.dim)
            maps, model = maps.replace(n, theta, Sigma), model.replace(n, theta, Sigma)
        elif what == "remove":
            n = correspondences(rng, maps.counts, Z)
            maps, model = maps.remove(n), model.remove(n)
        elif what == "select":
            ancestors = rng.integers(0, K, rng.integers(1, 9))
            maps, model = maps.select(ancestors), model.select(ancestors)
        elif what == "find":
            tags = rng.integers(-5, 70, Z)
            np.testing.assert_array_equal(maps.find(tags), model.find(tags))
        else:
            n = correspondences(rng, maps.counts, Z)
            theta, Sigma = maps.take(n)
            for k, i in np.argwhere(n >= 0):
                np.testing.assert_array_equal(theta[k, i], model.maps[k]["theta"][n[k, i]])
                np.testing.assert_array_equal(Sigma[k, i], model.maps[k]["Sigma"][n[k, i]])
        collections += maps.store.pool is not pool
        pool, most = maps.store.pool, max(most, int(maps.counts.max()))
        old.append((maps, model))
        if len(old) > 30:
            del old[int(rng.integers(30))]
        if step % 100 == 99:
            for each in old:
                assert_same(*each)
            tags = np.arange(-5, 70)
            for earlier, its_model in old[::7]:
                np.testing.assert_array_equal(earlier.find(tags), its_model.find(tags))
    assert collections > 5
    assert most > LEAF * FAN  # a second level of nodes


@pytest.mark.parametrize("chunk", [150, 5000])
def test_three_levels(chunk: int) -> None:
    """Beyond 4096 features, step by step and at once (which makes two levels in one operation)."""
    rng = np.random.default_rng(3)
    (maps, model), start = filled(3, 2), filled(3, 2)
    total = 2
    while total < 4500:
        wanted = rng.random((3, chunk)) < 0.95
        wanted[2] = total < 1000 and wanted[2]  # one map stays small, on a tree as deep
        theta, Sigma = values(rng, 3, chunk, 2)
        tags = np.arange(total, total + chunk)
        maps, model = maps.append(wanted, theta, Sigma, tags), model.append(wanted, theta, Sigma, tags)
        n, (theta, Sigma) = correspondences(rng, maps.counts, 5), values(rng, 3, 5, 2)
        maps, model = maps.replace(n, theta, Sigma), model.replace(n, theta, Sigma)
        total += chunk
    assert maps.depth == 3
    assert maps.counts[0] > LEAF * FAN**2
    assert_same(maps, model)
    tags = rng.integers(-2, total + 10, 60)
    np.testing.assert_array_equal(maps.find(tags), model.find(tags))
    n = correspondences(rng, maps.counts, 300)
    theta, _ = maps.take(n)
    for k, i in np.argwhere(n >= 0):
        np.testing.assert_array_equal(theta[k, i], model.maps[k]["theta"][n[k, i]])
    assert_same(*start)


# Sharing ------------------------------------------------------------------------------------------------------------


def test_selected_maps_are_not_aliases() -> None:
    """Particles that descend from one map go their own ways."""
    maps, model = filled(3, 50)
    ancestors = np.array([1, 0, 0, 0, 2, 1])
    chosen, its_model = maps.select(ancestors), model.select(ancestors)
    assert_same(chosen, its_model)
    rng = np.random.default_rng(4)
    n, (theta, Sigma) = np.full((6, 2), 7), values(rng, 6, 2, 2)
    n[:, 1] = NEW
    changed = chosen.replace(n, theta, Sigma)
    assert_same(changed, its_model.replace(n, theta, Sigma))
    assert len(np.unique(changed.take(n[:, :1])[0][:, 0, 0])) == 6
    wanted = np.eye(6, dtype=bool)
    theta, Sigma = values(rng, 6, 6, 2)
    grown = changed.append(wanted, theta, Sigma, np.arange(100, 106))
    assert_same(grown, its_model.replace(n, *changed.take(n)).append(wanted, theta, Sigma, np.arange(100, 106)))
    assert_same(chosen, its_model)
    assert_same(maps, model)


def test_select_copies_no_feature() -> None:
    maps, _ = filled(2, 3000)
    before = maps.store.pool.free.copy()
    assert len(maps.select(np.tile([0, 1], 500))) == 1000
    np.testing.assert_array_equal(maps.store.pool.free, before)


def test_one_change_copies_one_path() -> None:
    maps, _ = filled(1, 3000)
    before = maps.store.pool.free.copy()
    maps.replace(np.array([[1234]]), np.zeros((1, 1, 2)), np.zeros((1, 1, 2, 2)))
    np.testing.assert_array_equal(before - maps.store.pool.free, [maps.depth, 1])


def test_changes_side_by_side_share_their_path() -> None:
    """Four features of one leaf and one of its neighbour, in one operation."""
    maps, _ = filled(1, 3000)
    before = maps.store.pool.free.copy()
    maps.replace(np.array([[1232, 1233, 1234, 1236, 1235, 1233]]), np.zeros((1, 6, 2)), np.zeros((1, 6, 2, 2)))
    np.testing.assert_array_equal(before - maps.store.pool.free, [maps.depth, 2])


def test_select_to_other_numbers() -> None:
    maps, model = filled(5, 9)
    for ancestors in (np.array([3]), np.arange(5).repeat(40), np.arange(5), np.zeros(0, np.int64)):
        assert_same(maps.select(ancestors), model.select(ancestors))


# Memory -------------------------------------------------------------------------------------------------------------


def test_the_pool_does_not_grow_while_old_maps_are_dropped() -> None:
    """2000 changes of 5 features in 20 maps write 200 000 leaves; 200 are alive."""
    rng = np.random.default_rng(5)
    maps, _ = filled(20, 40)
    sizes = []
    for _ in range(2000):
        maps = maps.replace(correspondences(rng, maps.counts, 5), *values(rng, 20, 5, 2))
        sizes.append((len(maps.store.pool.child), len(maps.store.pool.data)))
    assert set(sizes) == {sizes[0]}
    # room for four operations as large as the largest, here the one that filled the maps: a leaf and two nodes for each
    # feature, and three nodes for each map
    assert sizes[0][0] <= 4 * (20 * 40 * 2 + 3 * 20)
    assert sizes[0][1] <= 4 * 20 * 40


def test_dropped_snapshots_are_taken_back() -> None:
    rng = np.random.default_rng(6)
    maps, _ = filled(20, 40)

    def changed(maps: Maps) -> Maps:
        return maps.replace(correspondences(rng, maps.counts, 5), *values(rng, 20, 5, 2))

    kept = [maps]
    for _ in range(300):
        kept.append(changed(kept[-1]))
    held, maps = len(maps.store.pool.data), kept[-1]
    assert held > 300 * 60  # nothing of them was lost ...
    kept.clear()
    for _ in range(1000):
        maps = changed(maps)
    assert len(maps.store.pool.data) == held  # ... and all of it serves again


def test_snapshots_survive_the_pool_that_they_were_made_in() -> None:
    """A pool that has grown and been collected a hundred times since."""
    rng = np.random.default_rng(7)
    maps, model = filled(6, 30)
    snapshots = [(maps, model)]
    pools = set()
    for step in range(1500):
        n, (theta, Sigma) = correspondences(rng, maps.counts, 4), values(rng, 6, 4, 2)
        if step % 10 == 0:
            wanted, tags = np.ones((6, 4), np.bool_), np.arange(4) + 4 * step
            maps, model = maps.append(wanted, theta, Sigma, tags), model.append(wanted, theta, Sigma, tags)
        else:
            maps, model = maps.replace(n, theta, Sigma), model.replace(n, theta, Sigma)
        pools.add(id(maps.store.pool.free))
        if step % 150 == 0:
            snapshots.append((maps, model))
    assert len(pools) > 3
    for each in snapshots:
        assert_same(*each)


def test_threads_read_while_the_filter_writes() -> None:
    """Readers look at old `Maps`, select from them and drop them; the writer goes on, collects and grows the pool."""
    rng = np.random.default_rng(8)
    maps, model = filled(4, 12)
    latest, stop, errors, reads = [(maps, model)], threading.Event(), [], [0, 0]

    def read(reader: int) -> None:
        chooser = np.random.default_rng(reader)
        kept: list[tuple[Maps, Naive]] = []
        try:
            while not stop.is_set():
                seen, its_model = latest[0]
                ancestors = chooser.integers(0, 4, 3)
                kept += [(seen, its_model), (seen.select(ancestors), its_model.select(ancestors))]
                for each in kept[-2:] + kept[:2]:
                    assert_same(*each)
                tags = chooser.integers(0, 100, 4)
                np.testing.assert_array_equal(kept[0][0].find(tags), kept[0][1].find(tags))
                del kept[: len(kept) - 20]
                reads[reader] += 1
        except BaseException as error:
            errors.append(error)
            raise

    threads = [threading.Thread(target=read, args=(reader,), daemon=True) for reader in range(2)]
    for thread in threads:
        thread.start()
    collections, pool, step = 0, maps.store.pool, 0
    while not errors and step < 20_000 and (collections < 60 or min(reads) < 60):
        K, Z = 4, 6
        theta, Sigma = values(rng, K, Z, 2)
        if step % 40 == 0:
            wanted, tags = rng.random((K, Z)) < 0.5, rng.integers(0, 100, Z)
            maps, model = maps.append(wanted, theta, Sigma, tags), model.append(wanted, theta, Sigma, tags)
        else:
            n = correspondences(rng, maps.counts, Z)
            maps, model = maps.replace(n, theta, Sigma), model.replace(n, theta, Sigma)
        latest[0] = (maps, model)
        collections += maps.store.pool is not pool
        pool, step = maps.store.pool, step + 1
    stop.set()
    for thread in threads:
        thread.join(timeout=30)
    assert not errors
    assert collections >= 60
    assert min(reads) >= 60


@pytest.fixture
def _hasty_threads() -> Iterator[None]:
    """Change threads every 10 us, which finds in a second what otherwise happens once in a long run."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("_hasty_threads")
def test_a_select_during_a_collection() -> None:
    """Another thread selects from a `Maps` and drops the result, again and again, while the pool is being collected."""
    maps, model = filled(2, 5)
    stop, errors = threading.Event(), []

    def choose() -> None:
        try:
            chosen: list[Maps] = []
            while not stop.is_set():
                chosen.append(maps.select(np.array([1, 0])))
                del chosen[: max(0, len(chosen) - 400)]
        except BaseException as error:
            errors.append(error)
            raise

    thread = threading.Thread(target=choose, daemon=True)
    thread.start()
    for _ in range(800):
        maps.store.pool = maps.store._collected(4, 4)
    stop.set()
    thread.join(timeout=30)
    assert not errors
    assert_same(maps, model)


# Tags ---------------------------------------------------------------------------------------------------------------


def appended(maps: Maps, tags: list[int]) -> Maps:
    """Features with these tags more in every map."""
    K, Z = len(maps), len(tags)
    return maps.append(np.ones((K, Z), np.bool_), np.zeros((K, Z, 2)), np.zeros((K, Z, 2, 2)), np.array(tags))


def test_find_in_branches() -> None:
    """Two `Maps` with the same ancestor store the same tags in another order; neither misleads the other."""
    stem = appended(MapStore(Point()).empty(3), [7, 8, 9])
    one, other = appended(stem, [10, 11, 12, 13]), appended(stem, [13, 11, 14])
    other = appended(other, [10, 12])
    for _ in range(2):  # looking changes nothing
        np.testing.assert_array_equal(one.find(np.array([10, 11, 12, 13, 14, 8])), [[3, 4, 5, 6, NEW, 1]] * 3)
        np.testing.assert_array_equal(other.find(np.array([10, 11, 12, 13, 14, 8])), [[6, 4, 7, 3, 5, 1]] * 3)
        np.testing.assert_array_equal(stem.find(np.array([10, 9])), [[NEW, 2]] * 3)


def test_find_where_particles_disagree() -> None:
    """A tag that was new to some particles only, and at another place in each."""
    maps = MapStore(Point()).empty(3)
    wanted = np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0]], bool)
    maps = maps.append(wanted, np.zeros((3, 3, 2)), np.zeros((3, 3, 2, 2)), np.array([5, 6, 7]))
    expected = [[NEW, 0, 1], [0, NEW, 1], [0, 1, NEW]]
    np.testing.assert_array_equal(maps.find(np.array([5, 6, 7])), expected)
    np.testing.assert_array_equal(maps.select(np.array([2, 0])).find(np.array([7, 5])), [[NEW, 0], [1, NEW]])


def test_find_the_first_of_duplicates() -> None:
    """Also where the tag was stored last, or in a map that never held the first one."""
    stem = appended(MapStore(Point()).empty(2), [1, 2])
    twice = appended(stem, [5, 3, 5])
    np.testing.assert_array_equal(twice.find(np.array([5])), [[2], [2]])
    again = appended(twice, [5, 1])
    np.testing.assert_array_equal(again.find(np.array([5, 1])), [[2, 0], [2, 0]])
    elsewhere = appended(stem, [3, 3, 5, 5])
    np.testing.assert_array_equal(elsewhere.find(np.array([5])), [[4], [4]])
    np.testing.assert_array_equal(again.find(np.array([5])), [[2], [2]])


def test_find_unknown_tags() -> None:
    """An unknown identity is not an identity: two features without one are not the same."""
    maps = appended(MapStore(Point()).empty(1), [UNKNOWN_TAG, 4, UNKNOWN_TAG])
    np.testing.assert_array_equal(maps.find(np.array([UNKNOWN_TAG, 4, 99])), [[NEW, 1, NEW]])
    np.testing.assert_array_equal(maps.features(0)[2], [UNKNOWN_TAG, 4, UNKNOWN_TAG])
    assert maps.find(np.zeros(0, np.int64)).shape == (1, 0)


@pytest.mark.parametrize("tag", [0, -2, -(2**52), 2**52, 2**31, 2**52 - 1])
def test_find_tags_of_any_size(tag: int) -> None:
    """Tags are kept among the floats, which have 53 bits."""
    maps = appended(MapStore(Point()).empty(1), [tag + 1, tag, tag - 1] if tag else [1, 0])
    np.testing.assert_array_equal(maps.find(np.array([tag])), [[1]])
    assert maps.features(0)[2][1] == tag


# Edges --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("K", [0, 1, 4])
def test_empty_maps(K: int) -> None:
    maps = MapStore(Point()).empty(K)
    assert_same(maps, naive(K))
    assert maps.find(np.array([1, 2])).tolist() == [[NEW, NEW]] * K
    assert_same(maps.replace(np.full((K, 2), NEW), *values(np.random.default_rng(0), K, 2, 2)), naive(K))
    nothing = np.zeros((K, 2), np.bool_)
    assert_same(maps.append(nothing, *values(np.random.default_rng(0), K, 2, 2), np.array([1, 2])), naive(K))
    owner, theta = maps.everything(100)
    assert owner.shape == (0,)
    assert theta.shape == (0, 2)


def test_hypotheses_left_after_a_selection() -> None:
    """Of six maps three copies of one and two of another live on; then one of them changes a feature."""
    maps, _ = filled(6, 7)
    copies, holders = maps.hypotheses()
    np.testing.assert_array_equal(copies, np.full(7, 6))
    np.testing.assert_array_equal(holders, np.full(7, 6))
    left = maps.select(np.array([4, 4, 4, 1, 1]))
    np.testing.assert_array_equal(left.hypotheses()[0], np.full(7, 2))
    n = np.array([[NEW], [2], [NEW], [NEW], [NEW]])
    theta, Sigma = values(np.random.default_rng(1), 5, 1, 2)
    changed = left.replace(n, theta, Sigma)
    np.testing.assert_array_equal(changed.hypotheses()[0], [2, 2, 3, 2, 2, 2, 2])
    gone = changed.remove(np.array([[NEW], [2], [NEW], [3], [3]]))
    np.testing.assert_array_equal(gone.hypotheses()[0], [2, 2, 2, 1, 2, 2, 2])
    np.testing.assert_array_equal(gone.hypotheses()[1], [5, 5, 4, 3, 5, 5, 5])


@pytest.mark.parametrize("which", range(5))
def test_a_hypothesis_is_another_one_if_any_number_differs(which: int) -> None:
    """x, y, and the three numbers of Sigma; by the last bit."""
    maps, _ = filled(3, 1)
    theta, Sigma = maps.take(np.zeros((3, 1), np.int64))
    theta[:], Sigma[:] = theta[0], Sigma[0]
    same = maps.replace(np.zeros((3, 1), np.int64), theta, Sigma)
    assert same.hypotheses()[0] == [1]
    if which < 2:
        theta[1, 0, which] = np.nextafter(theta[1, 0, which], 1e9)
    else:
        i, j = ((0, 0), (0, 1), (1, 1))[which - 2]
        Sigma[1, 0, i, j] = Sigma[1, 0, j, i] = np.nextafter(Sigma[1, 0, i, j], 1e9)
    assert maps.replace(np.zeros((3, 1), np.int64), theta, Sigma).hypotheses()[0] == [2]


def test_everything_of_a_few() -> None:
    maps, model = filled(6, 10)
    owner, theta = maps.everything(60)
    np.testing.assert_array_equal(owner, np.arange(6).repeat(10))
    np.testing.assert_array_equal(theta, np.concatenate([m["theta"] for m in model.maps]))


@pytest.mark.parametrize(("limit", "chosen"), [(59, [0, 2, 4]), (30, [0, 2, 4]), (20, [0, 3]), (10, [0]), (0, [0])])
def test_everything_within_a_limit(limit: int, chosen: list[int]) -> None:
    """Whole maps, evenly chosen."""
    maps, model = filled(6, 10)
    owner, theta = maps.everything(limit)
    np.testing.assert_array_equal(owner, np.repeat(chosen, 10))
    np.testing.assert_array_equal(theta, np.concatenate([model.maps[k]["theta"] for k in chosen]))


def test_everything_of_maps_of_unequal_size() -> None:
    maps = MapStore(Point()).empty(3)
    wanted = np.array([[1, 1], [0, 0], [0, 1]], bool)
    maps = maps.append(wanted, np.arange(12.0).reshape(3, 2, 2), np.zeros((3, 2, 2, 2)), np.array([1, 2]))
    owner, theta = maps.everything(100)
    np.testing.assert_array_equal(owner, [0, 0, 2])
    np.testing.assert_array_equal(theta, [[0, 1], [2, 3], [10, 11]])
