"""Who descends from whom: ancestry of the particles over the steps of a run.

The functions take the whole history: a list with, for every step t, the array `ancestors[t]` (K_t+1,) that
says for each particle after the step which one before it is its ancestor (`Trace.ancestors`).  The number of
particles may change.

`Genealogy` is the same history together with the poses, grown step by step.  Most particles of the past have
no living descendant.  Of a fixed number K of particles resampled at every step, the paths of those that have
one meet so soon that the tree which they form has some T + K log K nodes after T steps, against the T K that
ever lived (P. E. Jacob, L. M. Murray, S. Rubenthaler, "Path storage in the particle filter", Stat. Comput.
25, 2015), and only the poses of that tree are kept.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam._jit import kernel
from slam.types import Floats, Ints

Indices = NDArray[np.integer[Any]]

ROOM = 16
"""Steps that fit into a fresh store at least.  Pruning visits every node once; a store is at least doubled by
it, so that a node costs a constant however long the run is."""

JUMP = 16
"""Steps whose ancestors are kept as one, too: who wants to see a long run goes back in long strides."""

DEAD_ROOM = 0.25
"""Height of a line that died at once in the ancestry picture; one of the living has 1, and so would one that died
only now."""

DEAD_END = 0.6
"""Of the way to the next column, how far a line that died is drawn: it lived until the end of its last step."""


# --- The whole history --------------------------------------------------------------------------------------


def trace_back(ancestors: Sequence[Indices], index: int | Indices) -> Ints:
    """The ancestors at every step of the particles `index` that live after the last step.

    Returns (T+1,) for one index, (T+1, m) for m of them; row t is the index after t steps, row 0 at time
    zero.
    """
    index = np.asarray(index, np.int64)
    traced = np.empty((len(ancestors) + 1, *index.shape), np.int64)
    traced[-1] = index
    for t in range(len(ancestors) - 1, -1, -1):
        traced[t] = ancestors[t][traced[t + 1]]
    return traced


def distinct_ancestors(ancestors: Sequence[Indices]) -> Ints:
    """(T+1,) how many distinct ancestors the living particles have, by lag: entry 0 is K, entry T at time
    zero.

    Without any step there is no telling how many live: ValueError.
    """
    if not ancestors:
        raise ValueError("distinct ancestors of no steps: at least one array of ancestors is needed")
    found = np.arange(len(ancestors[-1]))
    counts = [len(found)]
    for step in reversed(ancestors):
        found = np.unique(step[found])
        counts.append(len(found))
    return np.array(counts, np.int64)


def common_ancestor_age(ancestors: Sequence[Indices]) -> int | None:
    """Steps back to the most recent common ancestor of the living (0 for one); None if they have none."""
    found = np.arange(len(ancestors[-1])) if ancestors else np.arange(0)
    for age, step in enumerate(reversed(ancestors)):
        if len(found) == 1:
            return age
        found = np.unique(step[found])
    return len(ancestors) if len(found) == 1 else None


def diversity(lineage: Indices) -> float:
    """The paper's diversity: distinct ancestors at time zero, as a fraction of K; lineage (K,)."""
    return float(np.count_nonzero(np.bincount(lineage)) / len(lineage))


# --- The tree of surviving paths ----------------------------------------------------------------------------


class Branch(NamedTuple):
    """A piece of the tree of surviving paths, between two forks, or a root, or a living particle."""

    poses: Floats
    """(m, 3) [m, m, rad], m >= 2.  Begins with the fork that it leaves, so that branches join."""
    first_step: int
    """The step of poses[0]; poses[i] is of step first_step + i."""
    living: int
    """How many living particles descend through it."""
    founder: int
    """`Genealogy.founders` of the particle that it leads to."""


class Strip(NamedTuple):
    """One line of the ancestry picture."""

    points: Floats
    """(m, 2) of (step, height in (0, 1)), m >= 2."""
    founder: int
    """`Genealogy.founders` of the particle that it leads to: the key of its colour."""
    living: int
    """How many living particles descend through it."""
    alive: bool
    """Whether one of those that are shown does."""


class Genealogy:
    """The tree of all paths that lead to a living particle.

    A value: `grow` returns a new one, and the old one stays valid as it was, also for a reader on another
    thread and when it is grown a second time (a branch in time).  Behind it stands a store that many values
    share: nodes are only ever appended to it, and pruning goes into a new one.
    """

    def __init__(self, store: _Store, nodes: int, particles: int, steps: int) -> None:
        self._store = store
        self._nodes = nodes
        self._particles = particles
        self._steps = steps
        self._coalesced: int | None = None  # step of the common ancestor, -1 for none, None for not yet asked

    @classmethod
    def start(cls, s: Floats) -> Genealogy:
        """K >= 1 particles at time zero with poses s (K, 3) [m, m, rad]."""
        s = np.asarray(s, float)
        K = len(s)
        if s.shape != (K, 3) or K == 0:
            raise ValueError(f"poses of shape {s.shape}: expected (K, 3) with K >= 1")
        store = _Store(ROOM * K)
        founders = _frozen(np.arange(K, dtype=np.int32))
        store.write(0, 0, np.full(K, -1, np.int32), founders, s)
        store.used = K
        store.lineages.append(founders)
        store.founders.append(founders)
        return cls(store, K, K, 0)

    def grow(self, ancestors: Indices, s: Floats) -> Genealogy:
        """After one more step: its `ancestors` (K',) (`Trace.ancestors`) and the poses s (K', 3) that it led
        to.

        ValueError if the shapes disagree or an ancestor is none of this genealogy's particles.
        """
        a = np.array(ancestors, np.int32)
        grown, K = len(a), self._particles
        s = np.asarray(s, float)
        if a.shape != (grown,) or s.shape != (grown, 3) or grown == 0:
            raise ValueError(f"ancestors {a.shape} and poses {s.shape}: expected (K,) and (K, 3) with K >= 1")
        if a.min() < 0 or a.max() >= K:
            raise ValueError(f"ancestors {a.min()} to {a.max()}: there are {K} particles before the step")

        store, first = _claim(self, grown)
        founders = store.founders[self._steps][a]
        if founders.min() == founders.max():
            founders = np.arange(grown, dtype=np.int32)
        store.write(first, self._steps + 1, a + np.int32(first - K), founders, s)
        store.founders.append(_shared(founders, store.founders))
        store.lineages.append(_shared(store.lineages[self._steps][a], store.lineages))
        store.ancestors.append(_shared(a, store.ancestors))
        if len(store.ancestors) % JUMP == 0:
            store.jumps.append(_frozen(_composed(store.ancestors[-JUMP:])))
        new = Genealogy(store, first + grown, grown, self._steps + 1)
        if grown > 1 and self._coalesced is not None and np.bincount(a, minlength=K).min() > 0:
            new._coalesced = self._coalesced  # nobody died, so the paths still meet where they met
        return new

    @property
    def steps(self) -> int:
        """Steps since time zero."""
        return self._steps

    @property
    def nbytes(self) -> int:
        """Memory of the poses behind it, room for later ones included."""
        store = self._store
        return store.parent.nbytes + store.step.nbytes + store.founder.nbytes + store.pose.nbytes

    @property
    def particles(self) -> int:
        """K, how many live."""
        return self._particles

    @property
    def sizes(self) -> Ints:
        """(steps+1,) how many particles lived after each step, from time zero."""
        return np.array([len(lineage) for lineage in self._store.lineages[: self._steps + 1]], np.int64)

    @property
    def nodes(self) -> int:
        """Poses that this value holds on to: those of surviving paths, and some not yet pruned."""
        return self._nodes

    @property
    def ancestors(self) -> tuple[NDArray[np.int32], ...]:
        """(K_t+1,) for each step: the whole history, as the functions of this module take it."""
        return tuple(self._store.ancestors[: self._steps])

    @property
    def lineage(self) -> Ints:
        """(K,) index of the ancestor at time zero of every living particle."""
        return self._store.lineages[self._steps].astype(np.int64)

    @property
    def founders(self) -> Ints:
        """(K,) for each living particle whom its line is named, and coloured, after.

        That is its ancestor at time zero.  Whenever all that live descend from one founder there is nothing left to
        tell apart, and the living become founders themselves, by their index.
        """
        return self._store.founders[self._steps].astype(np.int64)

    def path(self, k: int) -> Floats:
        """(steps+1, 3) [m, m, rad] the poses on the path of living particle k, from time zero."""
        if not 0 <= k < self._particles:
            raise IndexError(f"particle {k}: there are {self._particles}")
        node = self._nodes - self._particles + k
        nodes = np.empty(self._steps + 1, np.int64)
        _walk_back(self._store.parent, node, nodes)
        return self._store.pose[nodes]

    def branches(self, since: int = 0) -> list[Branch]:
        """Every surviving edge exactly once; only edges that end after step `since`, where that is given.

        What lies before the common ancestor never changes, so a picture that grows need draw only
        `branches(since=...)` again.  None before the first step.
        """
        parent, step = self._store.parent[: self._nodes], self._store.step[: self._nodes]
        living = self._living()
        edges = (living > 0) & (step > max(since, 0))
        order, starts = _chains(parent, edges, np.zeros(len(parent), np.bool_))
        poses = self._store.pose[order]
        begins, last = step[order[starts[:-1]]], order[starts[1:] - 1]
        return [
            Branch(poses[a:b], int(begins[i]), int(living[last[i]]), int(self._store.founder[last[i]]))
            for i, (a, b) in enumerate(pairwise(starts.tolist()))
        ]

    def distinct_ancestors(self) -> Ints:
        """(steps+1,) how many distinct ancestors the living have, by lag: K now, then back to time zero."""
        survivors = self._store.step[: self._nodes][self._living() > 0]
        return np.bincount(survivors, minlength=self._steps + 1)[::-1].astype(np.int64, copy=False)

    def distinct(self, lags: Sequence[int] | Ints) -> Ints:
        """(m,) how many distinct ancestors the living had so many steps ago, lags (m,) >= 0; at time zero for longer
        ones.  Costs what lies between here and the common ancestor."""
        lags = np.minimum(np.asarray(lags, np.int64), self._steps)
        if lags.ndim != 1 or lags.min(initial=0) < 0:
            raise ValueError(f"lags {lags.tolist()}: expected numbers of steps, from 0")
        store, counts = self._store, np.ones(int(lags.max(initial=0)) + 1, np.int64)
        found = np.zeros(self._nodes, np.bool_)
        found[self._nodes - self._particles :] = True
        _count_back(store.parent[: self._nodes], store.step[: self._nodes], found, counts)
        return counts[lags]

    def common_ancestor_age(self) -> int | None:
        """Steps back to the most recent common ancestor of the living; None where they have none, 0 for one
        particle.

        The paths up to there, at step `steps - age`, will not change any more.
        """
        if self._coalesced is None:
            parent, step = self._store.parent[: self._nodes], self._store.step[: self._nodes]
            found = np.zeros(self._nodes, np.bool_)
            found[self._nodes - self._particles :] = True
            self._coalesced = int(_coalescence(parent, step, found))
        return None if self._coalesced < 0 else self._steps - self._coalesced

    def layout(self, max_particles: int = 60, max_columns: int = 200) -> list[Strip]:
        """The ancestry picture of the whole run, each edge once: the tree as it is known now.

        Shown are the lines of an even sample of at most `max_particles` living particles, and of as many of all that
        ever died childless, at every step or, in a long run, at most `max_columns` of them.  The living stand one
        above the other, their ancestors in the middle between their descendants, and where lines meet theirs do: no
        two cross.  Those that died have the less room the shorter their line was.  Where a line runs straight on only
        its ends are given.
        """
        marks, sizes, parent = self._columns(max_columns)
        total, K = len(parent), self._particles
        living = slice(total - K, total)
        childless = np.ones(total, np.bool_)
        childless[parent[sizes[0] :]] = False
        died = _sample(np.flatnonzero(childless[: total - K]), max_particles)
        column = np.repeat(np.arange(len(marks)), sizes)
        when = marks[column].astype(float)
        founder = np.concatenate([self._store.founders[t] for t in marks])

        # Every line that died gets an end of its own, behind all others.
        ends = when[died] + DEAD_END * (marks[np.minimum(column[died] + 1, len(marks) - 1)] - when[died])
        parent = np.concatenate([parent, died.astype(np.int32)])
        when, founder = np.concatenate([when, ends]), np.concatenate([founder, founder[died]])
        leaf = np.zeros(len(parent), np.bool_)
        leaf[total:] = True
        leaf[total - K + _sample(np.arange(K), max_particles)] = True
        alive = _descendants(parent, np.flatnonzero(leaf[:total])) > 0
        edges = (_descendants(parent, np.flatnonzero(leaf)) > 0) & (parent >= 0)
        height = np.empty(len(parent))
        _place(parent, when / max(self._steps, 1), leaf, alive, height, np.zeros((5, len(parent))))

        order, starts = _chains(parent, edges, alive)
        points = np.empty((len(order), 2))
        points[:, 0], points[:, 1] = when[order], height[order]
        keep = np.ones(len(order), np.bool_)
        keep[1:-1] = (points[1:-1, 1] != points[:-2, 1]) | (points[1:-1, 1] != points[2:, 1])
        keep[starts[:-1]] = keep[starts[1:] - 1] = True
        counts, last = _descendants(parent, living), order[starts[1:] - 1]
        return [
            Strip(points[a:b][keep[a:b]], int(founder[i]), int(counts[i]), bool(alive[i]))
            for (a, b), i in zip(pairwise(starts.tolist()), last.tolist(), strict=True)
        ]

    def _columns(self, most: int) -> tuple[Ints, Ints, NDArray[np.int32]]:
        """At most so many steps (c,), among them the first and the last; how many particles lived at each (c,); and
        all of these in a row, with the row of the ancestor of each in the column before, -1 in the first."""
        stride = 1
        while self._steps > stride * (most - 1):
            stride *= 2
        marks = np.append(np.arange(0, self._steps, stride), self._steps)
        sizes = np.array([len(self._store.lineages[t]) for t in marks], np.int64)
        before = np.cumsum(sizes) - sizes
        parent = np.full(sizes.sum(), -1, np.int32)
        for (first, last), here, row in zip(pairwise(marks.tolist()), before[1:], before[:-1], strict=True):
            parent[here : here + len(self._store.lineages[last])] = self._between(first, last) + row
        return marks, sizes, parent

    def _between(self, first: int, last: int) -> NDArray[np.int32]:
        """(K,) the ancestors after `first` steps of those that lived after `last` steps, last > first."""
        store, parts, t = self._store, [], first
        while t < last:
            whole = t % JUMP == 0 and t + JUMP <= last
            parts.append(store.jumps[t // JUMP] if whole else store.ancestors[t])
            t += JUMP if whole else 1
        return _composed(parts)

    def _living(self) -> NDArray[np.int32]:
        """(nodes,) how many living particles descend from each node; the living are the last K nodes."""
        leaves = slice(self._nodes - self._particles, self._nodes)
        return _descendants(self._store.parent[: self._nodes], leaves)


class _Store:
    """Nodes of a tree in the order of their steps, so that a parent stands before its children.

    The first `used` nodes are written and never change.  Arrays have the length of the capacity.
    """

    def __init__(self, capacity: int) -> None:
        self.lock = threading.Lock()
        self.used = 0
        self.parent = np.empty(capacity, np.int32)
        self.step = np.empty(capacity, np.int32)
        self.founder = np.empty(capacity, np.int32)
        self.pose = np.empty((capacity, 3))
        self.ancestors: list[NDArray[np.int32]] = []
        self.lineages: list[NDArray[np.int32]] = []
        self.founders: list[NDArray[np.int32]] = []
        self.jumps: list[NDArray[np.int32]] = []

    def write(self, first: int, step: int, parent: Indices, founder: Indices, pose: Floats) -> None:
        """Fill the nodes from `first` on with one step's."""
        last = first + len(pose)
        self.parent[first:last] = parent
        self.step[first:last] = step
        self.founder[first:last] = founder
        self.pose[first:last] = pose


def _claim(genealogy: Genealogy, grown: int) -> tuple[_Store, int]:
    """Room for `grown` nodes more, and where it begins.  The K nodes before are the living particles.

    In the genealogy's own store if it ends there and has the room; in a pruned copy if not.
    """
    store = genealogy._store
    with store.lock:
        first = genealogy._nodes
        if store.used == first and first + grown <= len(store.parent):
            store.used += grown
            return store, first

    survivors = np.flatnonzero(genealogy._living() > 0)
    kept = len(survivors)
    place = np.full(genealogy._nodes + 1, -1, np.int32)  # the last entry answers for the parent -1 of a root
    place[survivors] = np.arange(kept, dtype=np.int32)
    pruned = _Store(kept + max(kept, ROOM * grown))
    pruned.parent[:kept] = place[store.parent[survivors]]
    pruned.step[:kept] = store.step[survivors]
    pruned.founder[:kept] = store.founder[survivors]
    pruned.pose[:kept] = store.pose[survivors]
    pruned.ancestors = store.ancestors[: genealogy._steps]
    pruned.lineages = store.lineages[: genealogy._steps + 1]
    pruned.founders = store.founders[: genealogy._steps + 1]
    pruned.jumps = store.jumps[: genealogy._steps // JUMP]
    pruned.used = kept + grown
    return pruned, kept


def _composed(ancestors: Sequence[NDArray[np.int32]]) -> NDArray[np.int32]:
    """The ancestors of several steps (at least one) in one."""
    found = ancestors[-1]
    for step in reversed(ancestors[:-1]):
        found = step[found]
    return found


def _frozen(values: NDArray[np.int32]) -> NDArray[np.int32]:
    values.flags.writeable = False
    return values


def _shared(values: NDArray[np.int32], history: list[NDArray[np.int32]]) -> NDArray[np.int32]:
    """The newest array of `history` if it is equal: steps without resampling then cost no memory."""
    if history and np.array_equal(values, history[-1]):
        return history[-1]
    return _frozen(values)


def _sample(values: Ints, size: int) -> Ints:
    """At most `size` of the values, evenly spaced."""
    if len(values) <= size:
        return values
    return values[((np.arange(size) + 0.5) * (len(values) / size)).astype(np.int64)]


def _descendants(parent: NDArray[np.int32], leaves: Indices | slice) -> NDArray[np.int32]:
    """(n,) how many of the `leaves` descend from each node, itself included."""
    counts = np.zeros(len(parent), np.int32)
    counts[leaves] = 1
    _add_to_parents(parent, counts)
    return counts


def _chains(parent: NDArray[np.int32], edges: NDArray[np.bool_], kind: NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """Cut a tree into chains without forks: nodes (m,) of chain after chain, and where each starts (chains+1,).

    `edges` (n,) are the nodes whose edge to their parent is wanted.  A chain begins with the parent of its first
    edge; it goes on through a node if just one edge leaves it and the kind (n,) stays the same.
    """
    count = len(parent)
    forks, chain = np.zeros((2, count), np.int32)
    length = np.zeros(count + 1, np.int64)
    chains = _number_chains(parent, edges, kind, forks, chain, length[1:])
    starts = np.cumsum(length[: chains + 1])
    order = np.empty(starts[-1], np.int64)
    _fill_chains(parent, edges, chain, starts[:-1].copy(), starts, order)
    return order, starts


@kernel
def _add_to_parents(parent: Any, counts: Any) -> None:
    """Add the count of every node to its parent's, children before parents."""
    for i in range(len(parent) - 1, -1, -1):
        if parent[i] >= 0:
            counts[parent[i]] += counts[i]


@kernel
def _walk_back(parent: Any, node: Any, nodes: Any) -> None:
    """Fill `nodes` (steps+1,) with those from the root to `node`."""
    for t in range(len(nodes) - 1, -1, -1):
        nodes[t] = node
        node = parent[node]


@kernel
def _coalescence(parent: Any, step: Any, found: Any) -> Any:
    """The last step at which the nodes `found` (n,) of the last step have one ancestor; -1 if never.

    `found` is written over.
    """
    i = len(parent) - 1
    while i >= 0:
        t, end, distinct = step[i], i, 0
        while i >= 0 and step[i] == t:
            distinct += found[i]
            i -= 1
        if distinct == 1:
            return t
        for j in range(i + 1, end + 1):
            if found[j] and parent[j] >= 0:
                found[parent[j]] = True
    return -1


@kernel
def _count_back(parent: Any, step: Any, found: Any, counts: Any) -> None:
    """Fill `counts` (lags,), which comes as ones, with how many distinct ancestors the nodes `found` (n,) of the last
    step have, by lag, as far back as they have more than one.  `found` is written over."""
    i = len(parent) - 1
    for lag in range(len(counts)):
        t, end, distinct = step[i], i, 0
        while i >= 0 and step[i] == t:
            distinct += found[i]
            i -= 1
        counts[lag] = distinct
        if distinct == 1:
            return
        for j in range(i + 1, end + 1):
            if found[j] and parent[j] >= 0:
                found[parent[j]] = True


@kernel
def _place(parent: Any, when: Any, leaf: Any, alive: Any, height: Any, work: Any) -> None:
    """Fill `height` (n,) of all nodes that lead to a leaf (n,), in (0, 1).

    when (n,) is their time, of a run of length 1.  Subtrees lie above each other, with room for their leaves.  A node
    stands in the mean of its leaves; one that is alive (n,) in the mean of those that are.  work (5, n) comes as
    zeros.
    """
    n = len(parent)
    parted, room, begin, total, leaves = work[0], work[1], work[2], work[3], work[4]
    for i in range(n):
        p = parent[i]
        parted[i] = when[i] if alive[i] or p < 0 else parted[p]  # when it left the lines of the living
        if leaf[i]:
            room[i] = 1.0 if alive[i] else DEAD_ROOM + (1.0 - DEAD_ROOM) * (when[i] - parted[i])
    for i in range(n - 1, -1, -1):
        if parent[i] >= 0:
            room[parent[i]] += room[i]
    top = 0.0
    for i in range(n):
        p = parent[i]
        if p < 0:
            begin[i] = top
            top += room[i]
        else:  # the parent's, which moves on for the next of its children
            begin[i] = begin[p]
            begin[p] += room[i]
    for i in range(n - 1, -1, -1):
        p = parent[i]
        if leaf[i]:
            total[i], leaves[i] = (begin[i] + 0.5 * room[i]) / top, 1.0
        height[i] = total[i] / leaves[i] if leaves[i] > 0.0 else 0.0
        if p >= 0 and alive[p] == alive[i]:
            total[p] += total[i]
            leaves[p] += leaves[i]


@kernel
def _number_chains(parent: Any, edges: Any, kind: Any, forks: Any, chain: Any, length: Any) -> Any:
    """The number of chains.  Fills `chain` (n,), that of every edge, and `length` (chains,) in nodes.

    `forks` (n,) and `length` come as zeros.
    """
    for i in range(len(parent)):
        if edges[i]:
            forks[parent[i]] += 1
    chains = 0
    for i in range(len(parent)):
        if edges[i]:
            p = parent[i]
            if edges[p] and forks[p] == 1 and kind[p] == kind[i]:
                chain[i] = chain[p]
            else:
                chain[i] = chains
                length[chains] = 1
                chains += 1
            length[chain[i]] += 1
    return chains


@kernel
def _fill_chains(parent: Any, edges: Any, chain: Any, cursor: Any, starts: Any, order: Any) -> None:
    """Write the nodes of every chain to their place in `order`; `cursor` (chains,) comes as `starts`."""
    for i in range(len(parent)):
        if edges[i]:
            c = chain[i]
            if cursor[c] == starts[c]:
                order[cursor[c]] = parent[i]
                cursor[c] += 1
            order[cursor[c]] = i
            cursor[c] += 1
