"""The genealogy against plain implementations that keep everything."""

import itertools
import math
import threading

import numpy as np
import pytest

from slam.genealogy import (
    DEAD_END,
    DEAD_ROOM,
    ROOM,
    Genealogy,
    common_ancestor_age,
    distinct_ancestors,
    diversity,
    trace_back,
)


class Naive:
    """Every particle that ever lived, as (ancestor, pose)."""

    def __init__(self, s):
        self.ancestors, self.poses = [], [s]

    def grow(self, a, s):
        self.ancestors.append(a)
        self.poses.append(s)

    def indices(self, k):
        out = [k]
        for a in reversed(self.ancestors):
            out.append(int(a[out[-1]]))
        return out[::-1]

    def living(self):
        return range(len(self.poses[-1]))

    def path(self, k):
        return np.array([self.poses[t][i] for t, i in enumerate(self.indices(k))])

    def distinct(self):
        lines = [self.indices(k) for k in self.living()]
        return [len({line[t] for line in lines}) for t in range(len(self.poses) - 1, -1, -1)]

    def age(self):
        counts = self.distinct()
        return counts.index(1) if 1 in counts else None

    def founders(self):
        """[t][i]: whom the line of particle i after t steps is named after."""
        found = [list(range(len(self.poses[0])))]
        for a in self.ancestors:
            names = [found[-1][i] for i in a]
            found.append(list(range(len(a))) if len(set(names)) == 1 else names)
        return found

    def edges(self):
        """{(step, index): number of living descendants} for every node with an edge to its ancestor."""
        found = {}
        for k in self.living():
            for t, i in list(enumerate(self.indices(k)))[1:]:
                found[t, i] = found.get((t, i), 0) + 1
        return found


def random_history(seed, T, K):
    """Ancestors and poses of T steps: no resampling, mild, severe, permuted, and other numbers of particles."""
    rng = np.random.default_rng(seed)
    yield None, rng.normal(size=(K, 3))
    for _ in range(T):
        kind = rng.integers(6)
        if kind < 2:
            a = np.arange(K)
        elif kind == 2:
            a = rng.permutation(K)
        elif kind == 3:
            a = np.sort(rng.integers(K, size=K))
        elif kind == 4:
            a = np.sort(rng.choice(K, size=K, p=rng.dirichlet(np.full(K, 0.3))))
        else:
            a = rng.integers(K, size=rng.integers(1, 24))
        K = len(a)
        yield a, rng.normal(size=(K, 3))


def neutral(seed, T, K):
    """K particles resampled at every step with random weights."""
    rng = np.random.default_rng(seed)
    for _ in range(T):
        yield np.sort(rng.integers(K, size=K))


def build(seed, T=90, K=15):
    """A naive and a pruned genealogy of the same history."""
    naive = tree = None
    for a, s in random_history(seed, T, K):
        if naive is None or tree is None:
            naive, tree = Naive(s), Genealogy.start(s)
        else:
            naive.grow(a, s)
            tree = tree.grow(a, s)
    return naive, tree


def edges_of(branches, naive):
    """The nodes (step, index) that branches draw, found by their poses, with each branch's numbers."""
    where = {tuple(pose): (t, i) for t, s in enumerate(naive.poses) for i, pose in enumerate(s)}
    for branch in branches:
        nodes = [where[tuple(pose)] for pose in branch.poses]
        assert [t for t, _ in nodes] == list(range(branch.first_step, branch.first_step + len(nodes)))
        for (t, i), (_, j) in zip(nodes[1:], nodes[:-1], strict=True):
            assert naive.ancestors[t - 1][i] == j
            yield (t, i), branch


@pytest.mark.parametrize("seed", range(6))
def test_functions_agree_with_the_naive_ones(seed):
    naive = None
    for step, (a, s) in enumerate(random_history(seed, 40, 12)):
        if naive is None:
            naive = Naive(s)
            continue
        naive.grow(a, s)
        every = np.array([naive.indices(k) for k in naive.living()]).T
        np.testing.assert_array_equal(trace_back(naive.ancestors, np.arange(len(a))), every)
        np.testing.assert_array_equal(trace_back(naive.ancestors, len(a) - 1), every[:, -1])
        np.testing.assert_array_equal(distinct_ancestors(naive.ancestors), naive.distinct())
        assert common_ancestor_age(naive.ancestors) == naive.age()
        assert diversity(every[0]) == len(set(every[0])) / len(a)
        assert step == len(naive.ancestors)


def test_functions_by_hand():
    """Four particles; the last two steps keep (1, 1, 2, 3), then (0, 0, 1, 1)."""
    history = [np.array([1, 1, 2, 3]), np.array([0, 0, 1, 1])]
    np.testing.assert_array_equal(trace_back(history, 3), [1, 1, 3])
    np.testing.assert_array_equal(distinct_ancestors(history), [4, 2, 1])
    assert common_ancestor_age(history) == 2
    assert common_ancestor_age(history[:1]) is None
    assert common_ancestor_age([*history, np.array([2])]) == 0
    assert common_ancestor_age([]) is None
    assert diversity(np.array([1, 1, 2, 3])) == 0.75
    with pytest.raises(ValueError, match="no steps"):
        distinct_ancestors([])


@pytest.mark.parametrize("seed", range(6))
def test_tree_agrees_with_the_naive_one_at_every_step(seed):
    """90 steps of up to 23 particles: several prunings (room is for 16 steps)."""
    naive = tree = None
    for a, s in random_history(seed, 90, 15):
        if naive is None or tree is None:
            naive, tree = Naive(s), Genealogy.start(s)
        else:
            naive.grow(a, s)
            tree = tree.grow(a, s)
        assert (tree.steps, tree.particles) == (len(naive.ancestors), len(s))
        np.testing.assert_array_equal(tree.distinct_ancestors(), naive.distinct())
        assert tree.common_ancestor_age() == naive.age()
        np.testing.assert_array_equal(tree.lineage, [naive.indices(k)[0] for k in naive.living()])
        for k in (0, len(s) // 2, len(s) - 1):
            np.testing.assert_array_equal(tree.path(k), naive.path(k))
    assert tree is not None
    for mine, full in zip(tree.ancestors, naive.ancestors, strict=True):
        np.testing.assert_array_equal(mine, full)


@pytest.mark.parametrize("ask", [True, False])
def test_common_ancestor_age_does_not_depend_on_who_asked_before(ask):
    """The age is handed on through steps in which nobody dies; here also through one that ends with one particle."""
    s = np.zeros((9, 3))
    tree, history = Genealogy.start(s[:3]), []
    for a in ([0, 0, 1], [2, 1, 0, 0], [3, 2, 1, 0], [1], [0], [0, 0, 0], [2, 1, 0], [0, 1, 2, 2], [3, 3, 2]):
        history.append(np.array(a))
        tree = tree.grow(np.array(a), s[: len(a)])
        if ask:
            assert tree.common_ancestor_age() == common_ancestor_age(history)
    assert tree.common_ancestor_age() == common_ancestor_age(history) == 2


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("since", [0, 30, 88, 90])
def test_branches_draw_every_surviving_edge_once(seed, since):
    naive, tree = build(seed)
    wanted = {node: living for node, living in naive.edges().items() if node[0] > since}
    founders = naive.founders()
    drawn = list(edges_of(tree.branches(since), naive))
    assert len(drawn) == len(wanted)
    assert {node: branch.living for node, branch in drawn} == wanted
    for (t, i), branch in drawn:
        if t == branch.first_step + len(branch.poses) - 1:
            assert branch.founder == founders[t][i]
    # As few as can be: one for every edge that leaves a fork, a root or the step from which on to draw.
    children = {}
    for t, i in wanted:
        children.setdefault((t - 1, int(naive.ancestors[t - 1][i])), []).append(i)
    starts = sum(len(c) for (t, _), c in children.items() if t == since or len(c) > 1)
    assert len(tree.branches(since)) == starts


def test_no_branches_at_the_start():
    tree = Genealogy.start(np.zeros((4, 3)))
    assert tree.branches() == []
    assert tree.layout() == []
    np.testing.assert_array_equal(tree.founders, np.arange(4))
    np.testing.assert_array_equal(tree.distinct([0, 7]), [4, 4])
    assert tree.ancestors == ()
    assert tree.common_ancestor_age() is None
    np.testing.assert_array_equal(tree.distinct_ancestors(), [4])
    np.testing.assert_array_equal(tree.path(2), np.zeros((1, 3)))
    assert Genealogy.start(np.zeros((1, 3))).common_ancestor_age() == 0


def test_memory_is_that_of_the_surviving_paths():
    """1500 steps of 60 particles: the tree stays within T + 4 K log K, the store within twice that and its room."""
    K, T = 60, 1500
    s = np.zeros((K, 3))
    tree, largest = Genealogy.start(s), 0
    for a in neutral(5, T, K):
        tree = tree.grow(a, s)
        largest = max(largest, tree.nodes)
    bound = T + 4 * K * math.log(K)
    assert tree.distinct_ancestors().sum() < bound
    assert largest < 2 * bound + 2 * ROOM * K
    assert largest < 0.1 * T * K


def test_how_much_memory_a_value_says_that_it_takes():
    """Of each pose behind it three numbers, its ancestor, its step and its founder; with the room for those to come."""
    K, ROW = 50, 3 * 8 + 3 * 4
    g = Genealogy.start(np.zeros((K, 3)))
    for _ in range(100):
        before = g.nbytes
        g = g.grow(np.arange(K), np.zeros((K, 3)))
        assert ROW * g.nodes <= g.nbytes <= ROW * (2 * g.nodes + (ROOM + 1) * K)
        assert g.nbytes >= before
    whole, g = g.nbytes, g.grow(np.zeros(K, int), np.zeros((K, 3)))
    for _ in range(200):  # nobody lives but one founder, and most of what was is gone
        g = g.grow(np.zeros(K, int), np.zeros((K, 3)))
    assert g.nbytes < whole


def test_steps_without_resampling_share_their_history():
    s = np.zeros((50, 3))
    tree = Genealogy.start(s)
    for _ in range(20):
        tree = tree.grow(np.arange(50), s)
    assert len({id(a) for a in tree.ancestors}) == 1
    with pytest.raises(ValueError, match="read-only"):
        tree.ancestors[0][0] = 3


def test_old_values_stay_as_they_were():
    """Every value of a run is asked again at its end."""
    tree, kept = None, []
    for a, s in random_history(3, 120, 15):
        tree = Genealogy.start(s) if tree is None else tree.grow(a, s)
        k = len(s) // 2
        kept.append((tree, k, tree.path(k), tree.distinct_ancestors(), tree.common_ancestor_age()))
    for old, k, path, distinct, age in kept:
        np.testing.assert_array_equal(old.path(k), path)
        np.testing.assert_array_equal(old.distinct_ancestors(), distinct)
        assert old.common_ancestor_age() == age
        assert len(old.ancestors) == old.steps


def test_a_branch_in_time_leaves_the_other_alone():
    """Grown twice from the same value, at every step of the way: both are right."""
    naive = tree = None
    rng = np.random.default_rng(8)
    for a, s in random_history(4, 60, 10):
        if naive is None or tree is None:
            naive, tree = Naive(s), Genealogy.start(s)
            continue
        before = tree
        tree = before.grow(a, s)
        naive.grow(a, s)
        b, r = rng.integers(before.particles, size=7), rng.normal(size=(7, 3))
        other = before.grow(b, r).grow(np.arange(7), 2.0 * r)
        for k in range(7):
            np.testing.assert_array_equal(other.path(k)[:-2], before.path(int(b[k])))
            np.testing.assert_array_equal(other.path(k)[-2:], [r[k], 2.0 * r[k]])
        np.testing.assert_array_equal(other.ancestors[-2], b)
        for k in (0, len(s) - 1):
            np.testing.assert_array_equal(tree.path(k), naive.path(k))
        np.testing.assert_array_equal(tree.ancestors[-1], a)


def test_a_reader_on_another_thread_sees_one_value():
    K = 40
    rng = np.random.default_rng(2)
    tree = Genealogy.start(rng.normal(size=(K, 3)))
    for a in neutral(1, 30, K):
        tree = tree.grow(a, rng.normal(size=(K, 3)))
    expected = [tree.path(k) for k in range(K)], tree.distinct_ancestors(), len(tree.branches())
    done, wrong = threading.Event(), []

    def read(old):
        while not done.is_set():
            same = all(np.array_equal(old.path(k), expected[0][k]) for k in range(K))
            if not (same and np.array_equal(old.distinct_ancestors(), expected[1])):
                wrong.append("changed")
            if len(old.branches()) != expected[2]:
                wrong.append("branches")

    reader = threading.Thread(target=read, args=(tree,))
    reader.start()
    for a in neutral(9, 400, K):
        tree = tree.grow(a, rng.normal(size=(K, 3)))
    done.set()
    reader.join()
    assert not wrong


def columns(steps, most):
    """The steps of the columns of a picture: every power of two, and the last."""
    stride = next(2**i for i in range(20) if steps <= 2**i * (most - 1))
    return [*range(0, steps, stride), steps]


def test_columns_of_a_picture():
    assert columns(5, 10) == [0, 1, 2, 3, 4, 5]
    assert columns(9, 4) == [0, 4, 8, 9]


class Picture:
    """Strips with, at every column, the straight pieces filled in again; those that died have their ends apart."""

    def __init__(self, strips, marks):
        self.lines = []
        for strip in strips:
            at, heights = strip.points.T
            whole = [t for t in marks if at[0] <= t <= at[-1]]
            self.lines.append((strip, whole, np.interp(whole, at, heights)))

    def crossings(self, marks):
        """How often two lines change places between two columns."""
        count = 0
        for t, u in itertools.pairwise(marks):
            pairs = []
            for _, whole, heights in self.lines:
                if t in whole and u in whole:
                    pairs.append((heights[whole.index(t)], heights[whole.index(u)]))
            rows = np.array(sorted(pairs)).reshape(-1, 2)
            count += int(np.sum(np.diff(rows[:, 1])[np.diff(rows[:, 0]) > 1e-9] < -1e-9))
        return count


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("max_particles", "max_columns"), [(10_000, 200), (5, 200), (10_000, 40), (4, 12)])
def test_layout_draws_the_tree_without_crossings(seed, max_particles, max_columns):
    naive, tree = build(seed)
    marks, founders = columns(90, max_columns), naive.founders()
    strips = tree.layout(max_particles, max_columns)
    picture = Picture(strips, marks)
    assert picture.crossings(marks) == 0
    lines = [naive.indices(k) for k in naive.living()]
    living = {t: {} for t in marks}
    for line in lines:
        for t in marks:
            living[t][line[t]] = living[t].get(line[t], 0) + 1
    for strip, whole, heights in picture.lines:
        assert strip.points[0, 0] == whole[0]
        assert np.all((heights > 0.0) & (heights < 1.0))
        end = int(whole[-1])
        assert strip.founder in founders[end]
        if strip.alive:
            assert strip.living in living[end].values()
            assert strip.points[-1, 0] == end
    tips = [h[-1] for strip, whole, h in picture.lines if strip.alive and whole[-1] == 90]
    shown = min(max_particles, tree.particles)
    assert len(tips) == len(set(tips)) == shown
    if max_particles == 10_000:  # all is shown: at every column as many lines as there are ancestors, and all that died
        for t in marks[:-1]:
            alive = {round(h[w.index(t)], 9) for s, w, h in picture.lines if s.alive and t in w and w[-1] > t}
            assert len(alive) == len(living[t])
        dead = [s for s, _, _ in picture.lines if not s.alive and s.points[-1, 0] % 1.0]
        died = 0
        for t, u in itertools.pairwise(marks):
            survivors = trace_back(naive.ancestors[t:u], np.arange(len(naive.poses[u])))[0]
            died += len(naive.poses[t]) - len(set(survivors.tolist()))
        assert len(dead) == died


@pytest.mark.parametrize("seed", range(3))
def test_layout_puts_ancestors_in_the_middle_of_their_descendants(seed):
    naive, tree = build(seed, T=40)
    strips = tree.layout(10_000)
    height = {}
    tips = sorted(s.points[-1, 1] for s in strips if s.alive and s.points[-1, 0] == 40)
    lines = [naive.indices(k) for k in naive.living()]
    by_root = sorted(lines)
    for line, y in zip(by_root, tips, strict=True):  # in the order of their roots, and below that of their forks
        for t, i in enumerate(line):
            height.setdefault((t, i), []).append(y)
    wanted = {(t, round(float(np.mean(ys)), 9)) for (t, _), ys in height.items()}
    drawn = {
        (float(t), round(float(y), 9)) for s in strips if s.alive for t, y in s.points if t in (s.points[0, 0], 40.0)
    }
    assert drawn <= wanted


def test_layout_by_hand():
    """Of three particles the last dies in the second step; the first has two children there, and lives on in both."""
    tree = Genealogy.start(np.zeros((3, 3)))
    tree = tree.grow(np.arange(3), np.zeros((3, 3))).grow(np.array([0, 0, 1]), np.zeros((3, 3)))
    found = {tuple(map(tuple, s.points.round(6).tolist())): s for s in tree.layout()}
    room = 3.0 + DEAD_ROOM + (1.0 - DEAD_ROOM) * 0.5 * (1.0 + DEAD_END)
    a, b, c, d = (0.5 / room, 1.5 / room, 2.5 / room, (3.0 + room) / 2.0 / room)
    middle = 0.5 * (a + b)
    wanted = {
        ((0.0, middle), (1.0, middle)): (0, 2, True),
        ((1.0, middle), (2.0, a)): (0, 1, True),
        ((1.0, middle), (2.0, b)): (0, 1, True),
        ((0.0, c), (2.0, c)): (1, 1, True),
        ((0.0, d), (1.0 + DEAD_END, d)): (2, 0, False),
    }
    rounded = {tuple((t, round(y, 6)) for t, y in points): what for points, what in wanted.items()}
    assert {points: (s.founder, s.living, s.alive) for points, s in found.items()} == rounded


def test_layout_of_a_long_run_of_many_is_small():
    K, T = 1000, 5000
    rng = np.random.default_rng(4)
    s, quiet = np.zeros((K, 3)), np.arange(K)
    tree = Genealogy.start(s)
    for t in range(T):
        tree = tree.grow(np.sort(rng.integers(K, size=K)) if t % 5 == 0 else quiet, s)
    strips = tree.layout(max_particles=50)
    assert sum(s.points[-1, 0] == T for s in strips) == 50
    assert 50 <= len(strips) <= 4 * 50
    assert sum(len(s.points) for s in strips) < 800


def test_layout_gives_only_the_ends_of_straight_lines():
    tree = Genealogy.start(np.zeros((5, 3)))
    for _ in range(30):
        tree = tree.grow(np.arange(5), np.zeros((5, 3)))
    strips = tree.layout()
    assert len(strips) == 5
    for k, strip in enumerate(strips):
        np.testing.assert_allclose(strip.points, [[0, (k + 0.5) / 5], [30, (k + 0.5) / 5]])
        assert (strip.founder, strip.living, strip.alive) == (k, 1, True)


@pytest.mark.parametrize("seed", range(6))
def test_founders_and_what_they_are_named_after(seed):
    naive, tree = build(seed)
    founders = naive.founders()
    np.testing.assert_array_equal(tree.founders, founders[-1])
    assert sum(len(set(names)) > 1 and names == list(range(len(names))) for names in founders) > 1


@pytest.mark.parametrize("seed", range(6))
def test_distinct_ancestors_at_some_lags(seed):
    naive = tree = None
    for a, s in random_history(seed, 60, 15):
        if naive is None or tree is None:
            naive, tree = Naive(s), Genealogy.start(s)
            continue
        naive.grow(a, s)
        tree = tree.grow(a, s)
        every = naive.distinct()
        lags = [0, 1, 3, 10, 40, 1000]
        np.testing.assert_array_equal(tree.distinct(lags), [every[min(lag, len(every) - 1)] for lag in lags])
    with pytest.raises(ValueError, match="lags"):
        tree.distinct([3, -1])
    assert tree.distinct([]).shape == (0,)


def test_how_many_lived_after_each_step():
    """Of a value that was grown twice, of each branch its own."""
    first = Genealogy.start(np.zeros((3, 3))).grow([0, 1, 2, 2], np.zeros((4, 3)))
    fewer, more = first.grow([3, 3], np.zeros((2, 3))), first.grow([0] * 6, np.zeros((6, 3)))
    assert [g.sizes.tolist() for g in (first, fewer, more)] == [[3, 4], [3, 4, 2], [3, 4, 6]]


def test_what_does_not_fit_is_refused_and_harms_nothing():
    tree = Genealogy.start(np.zeros((3, 3)))
    for ancestors, s in (
        ([0, 3, 1], np.zeros((3, 3))),
        ([0, -1, 1], np.zeros((3, 3))),
        ([0, 1], np.zeros((3, 3))),
        ([], np.zeros((0, 3))),
        ([[0, 1, 2]], np.zeros((1, 3))),
    ):
        with pytest.raises(ValueError, match="ancestors"):
            tree.grow(np.array(ancestors, int), s)
    with pytest.raises(ValueError, match="poses"):
        Genealogy.start(np.zeros((0, 3)))
    with pytest.raises(IndexError, match="particle 3"):
        tree.path(3)
    np.testing.assert_array_equal(tree.grow(np.array([2]), np.ones((1, 3))).path(0), [[0, 0, 0], [1, 1, 1]])
