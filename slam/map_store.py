"""The persistent map store: many maps that share what they have in common.

A particle's map is a handle (one integer) to the root of a tree: inner nodes of `FAN` children, leaves of `LEAF`
features in the order of their creation.  Nodes and leaves are never changed once the operation that made them is over:
to change a feature is to copy the path to it (log n, a few hundred bytes) and to share all the rest.  Hence

- resampling copies handles, not maps;
- an old step is a cheap snapshot: whoever holds a `Maps` may read it for ever, from any thread;
- a feature keeps its index for ever.  One that is removed leaves its place empty: nobody finds it, and readers of a map
  do not see it;
- every node knows the box around its features, so that the search for what may have been seen (4.3) looks only where
  the sensor does.  Features are made along the robot's way, so neighbours in the tree are neighbours in the world.

When the pool is full, what no living `Maps` can reach is taken back (mark and sweep; counting references instead would
touch every sibling on a copied path, at several times the price of the copy).
"""

from __future__ import annotations

from threading import Lock
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from slam._jit import inline, kernel
from slam.features import extent, spread
from slam.types import UNKNOWN_TAG, Floats, Ints

LEAF = 4
FAN = 32
_LEAF_BITS, _FAN_BITS = 2, 5
_NODES, _LEAVES = 0, 1


class Pool(NamedTuple):
    """All nodes and leaves, as arrays that kernels read and write.  A box is (x_min, y_min, x_max, y_max, spread)."""

    data: Floats
    """(L, LEAF, D + 4) the features: theta (D), Sigma as (s00, s01, s11), and the tag of what was seen, NaN of one
    that was removed."""
    leaf_box: Floats
    """(L, 5); spread is the largest standard deviation of a feature inside."""
    child: Any
    """(N, FAN) int32: nodes, or on the lowest level leaves; -1 none."""
    node_box: Floats
    """(N, 5); that of a root is not used."""
    free_nodes: Any
    """(N,) a stack of unused nodes."""
    free_leaves: Any
    """(L,) a stack of unused leaves."""
    free: Ints
    """(2,) the heights of the two stacks."""


class MapStore:
    """The pool behind the maps of one filter run.  It grows with what lives at the same time, and never shrinks."""

    def __init__(self, feature: Any) -> None:
        self.feature = feature
        self.dim: int = type(feature).dim
        self.pool = _empty_pool(self.dim)
        self.index_of_tag: dict[int, int] = {}
        """The lowest index at which a tag was ever stored, in whichever particle: where `Maps.find` begins to look."""
        self._alive: WeakValueDictionary[int, Maps] = WeakValueDictionary()
        self._lock = Lock()

    def empty(self, K: int) -> Maps:
        """K maps without features."""
        return Maps(self, np.full(K, -1, np.int32), np.zeros(K, np.int64), depth=1)

    def _begin(self, maps: Maps, writes: int, levels: int = 0) -> Any:
        """A copy of the roots for an operation that writes so many features, and room for it on so many levels more.

        Only the thread that runs the filter writes.  Others may read and drop `Maps` meanwhile: the arrays of a node
        that some living `Maps` reaches never change, not even where the pool moves to larger ones.
        """
        nodes, leaves = (2 * levels + 1) * len(maps.roots) + writes * (maps.depth + levels), writes
        if self.pool.free[_NODES] < nodes or self.pool.free[_LEAVES] < leaves:
            self.pool = self._collected(nodes, leaves)
        return maps.roots.copy()

    def _collected(self, nodes: int, leaves: int) -> Pool:
        """The pool with all that is dead on the free stacks, grown until most of it is free."""
        pool = self.pool
        used_nodes, used_leaves = np.zeros(len(pool.child), np.bool_), np.zeros(len(pool.data), np.bool_)
        with self._lock:  # no other thread's `select` may slip in between
            alive = [maps for reference in self._alive.valuerefs() if (maps := reference()) is not None]
        for maps in alive:
            stack = np.empty((FAN * maps.depth + 1, 2), np.int64)
            _mark(pool.child, maps.roots, maps.depth, used_nodes, used_leaves, stack)
        # Half of it free, and room for several operations: then a collection costs little beside the copies that led to
        # it, and the pool stays as small as the processor's caches like it.
        n, m = int(used_nodes.sum()), int(used_leaves.sum())
        N = max(len(pool.child), 2 * n, n + 4 * nodes)
        L = max(len(pool.data), 2 * m, m + 4 * leaves)
        return _with_free(pool, used_nodes, used_leaves, N, L)


class Maps:
    """K maps at one moment.  Immutable; the store keeps their nodes as long as this object lives."""

    __slots__ = ("__weakref__", "counts", "depth", "roots", "store")

    def __init__(self, store: MapStore, roots: Any, counts: Ints, depth: int) -> None:
        self.store = store
        self.roots = roots  # (K,) int32
        self.counts = counts  # (K,) features ever made in each map, and so the index of the next one
        self.depth = depth  # levels of inner nodes, the same for all
        with store._lock:
            store._alive[id(self)] = self

    def __len__(self) -> int:
        return len(self.roots)

    def select(self, ancestors: Ints) -> Maps:
        """The maps of the chosen particles, (K',) indices: no map is copied."""
        return Maps(self.store, self.roots[ancestors], self.counts[ancestors], self.depth)

    def take(self, n: Ints) -> tuple[Floats, Floats]:
        """theta (K, Z, D) and Sigma (K, Z, 2, 2) of the features n (K, Z); not meaningful where n is NEW."""
        theta = np.empty((*n.shape, self.store.dim))
        Sigma = np.empty((*n.shape, 2, 2))
        _take(self.store.pool, self.roots, self.depth, n, theta, Sigma)
        return theta, Sigma

    def replace(self, n: Ints, theta: Floats, Sigma: Floats) -> Maps:
        """The maps with features n (K, Z) changed to theta (K, Z, D), Sigma (K, Z, 2, 2); NEW is passed over."""
        store = self.store
        roots, done = store._begin(self, writes=int(np.count_nonzero(n >= 0))), np.empty(n.shape[1], np.int64)
        _replace(store.pool, store.feature, roots, self.counts, self.depth, n, theta, Sigma, done)
        return Maps(store, roots, self.counts, self.depth)

    def remove(self, n: Ints) -> Maps:
        """The maps without the features n (K, Z), whose indices are nobody's from then on; NEW is passed over."""
        store = self.store
        roots, done = store._begin(self, writes=int(np.count_nonzero(n >= 0))), np.empty(n.shape[1], np.int64)
        _remove(store.pool, store.feature, roots, self.counts, self.depth, n, done)
        return Maps(store, roots, self.counts, self.depth)

    def append(self, new: Any, theta: Floats, Sigma: Floats, tags: Ints) -> Maps:
        """The maps with a feature more wherever new (K, Z) is true; theta (K, Z, D), Sigma (K, Z, 2, 2), tags (Z,)."""
        store = self.store
        counts, depth, levels = self.counts + new.sum(axis=1), self.depth, 0
        while counts.max(initial=0) > LEAF * FAN ** (depth + levels):
            levels += 1
        roots, done = store._begin(self, int(np.count_nonzero(new)), levels), np.empty(new.shape[1], np.int64)
        for _ in range(levels):
            _deepen(store.pool, store.feature, roots, self.counts, depth)
            depth += 1
        _append(store.pool, store.feature, roots, self.counts, depth, new, theta, Sigma, tags, done)
        index = np.where(new, self.counts[:, None] + np.cumsum(new, axis=1) - 1, counts.max(initial=0))
        for i in np.flatnonzero(new.any(axis=0)):
            tag, lowest = int(tags[i]), int(index[:, i].min())
            store.index_of_tag[tag] = min(store.index_of_tag.get(tag, lowest), lowest)
        return Maps(store, roots, counts, depth)

    def find(self, tags: Ints) -> Ints:
        """(K, Z) the first feature with each of the tags (Z,) in each map, or NEW; `UNKNOWN_TAG` is never found."""
        never = np.iinfo(np.int64).max
        begin = np.array([self.store.index_of_tag.get(int(tag), never) for tag in tags], np.int64)
        begin[tags == UNKNOWN_TAG] = never
        n = np.empty((len(self), len(tags)), np.int64)
        _find(self.store.pool, self.roots, self.counts, self.depth, tags, begin, n)
        return n

    def features(self, k: int) -> tuple[Floats, Floats, Ints]:
        """theta (n, D), Sigma (n, 2, 2) and tags (n,) of what map k has, in the order of creation (`indices`)."""
        tags = self._tags(k)
        n = np.flatnonzero(~np.isnan(tags))
        theta, Sigma = np.empty((1, len(n), self.store.dim)), np.empty((1, len(n), 2, 2))
        _take(self.store.pool, self.roots[k : k + 1], self.depth, n[None], theta, Sigma)
        return theta[0], Sigma[0], tags[n].astype(np.int64)

    def indices(self, k: int) -> Ints:
        """(n,) of the features that map k has: all that were ever made, but for those that were removed."""
        return np.flatnonzero(~np.isnan(self._tags(k)))

    def tags(self, k: int) -> Ints:
        """(counts[k],) by index, for those who have correspondences; `UNKNOWN_TAG` for what was removed."""
        tags = self._tags(k)
        return np.where(np.isnan(tags), UNKNOWN_TAG, tags).astype(np.int64)

    def _tags(self, k: int) -> Floats:
        tags = np.empty(int(self.counts[k]))
        _tags(self.store.pool, self.roots[k], self.depth, tags)
        return tags

    def hypotheses(self) -> tuple[Ints, Ints]:
        """For every feature (n,), by index: how many different copies of it there are, and how many maps have it.

        A copy is another one if theta or Sigma differ in any bit.  Maps whose particles descend from one that made the
        feature have it under the same index; where others have something else there, that counts as a copy, too.
        """
        copies, holders = np.zeros((2, int(self.counts.max(initial=0))), np.int64)
        pool = self.store.pool  # one that is moved meanwhile leaves this as it is
        table, owner = np.zeros((2, 2 << len(self).bit_length()), np.int64)
        bits, seen = pool.data.view(np.int64), np.empty((3, len(self)), np.int64)
        _hypotheses(pool, bits, self.roots, self.counts, self.depth, table, owner, seen, copies, holders)
        return copies, holders

    def everything(self, limit: int) -> tuple[Ints, Floats]:
        """owner (N,) and theta (N, D) of the features of all maps, of evenly chosen maps where that exceeds `limit`."""
        total = int(self.counts.sum())
        stride = max(1, -(-total // max(limit, 1)))
        chosen = np.arange(0, len(self), stride)
        parts = [self.features(int(k))[0] for k in chosen]
        owner = np.repeat(chosen, [len(part) for part in parts])
        return owner, np.concatenate(parts) if parts else np.empty((0, self.store.dim))


def _empty_pool(dim: int) -> Pool:
    return Pool(
        data=np.empty((0, LEAF, dim + 4)),
        leaf_box=np.empty((0, 5)),
        child=np.empty((0, FAN), np.int32),
        node_box=np.empty((0, 5)),
        free_nodes=np.empty(0, np.int32),
        free_leaves=np.empty(0, np.int32),
        free=np.zeros(2, np.int64),
    )


def _with_free(pool: Pool, used_nodes: Any, used_leaves: Any, N: int, L: int) -> Pool:
    """A pool of N nodes and L leaves with the same content, everything unused on the free stacks, lowest index on
    top."""

    def longer(array: Any, size: int) -> Any:
        if size == len(array):
            return array
        out = np.empty((size, *array.shape[1:]), array.dtype)
        out[: len(array)] = array
        return out

    def stack(used: Any, size: int) -> tuple[Any, int]:
        unused = np.flatnonzero(~np.concatenate([used, np.zeros(size - len(used), np.bool_)]))[::-1]
        free = np.empty(size, np.int32)
        free[: len(unused)] = unused
        return free, len(unused)

    (free_nodes, n), (free_leaves, m) = stack(used_nodes, N), stack(used_leaves, L)
    return Pool(
        data=longer(pool.data, L),
        leaf_box=longer(pool.leaf_box, L),
        child=longer(pool.child, N),
        node_box=longer(pool.node_box, N),
        free_nodes=free_nodes,
        free_leaves=free_leaves,
        free=np.array([n, m]),
    )


@inline
def leaf_of(pool: Any, root: Any, depth: Any, i: Any) -> Any:
    """The leaf that holds feature i (slot i % LEAF)."""
    node = root
    for level in range(depth - 1, -1, -1):
        node = pool.child[node, (i >> (_LEAF_BITS + _FAN_BITS * level)) & (FAN - 1)]
    return node


@inline
def _new_node(pool: Any, source: Any) -> Any:
    """A writable copy of a node; of -1 an empty one."""
    pool.free[_NODES] -= 1
    node = pool.free_nodes[pool.free[_NODES]]
    if source >= 0:
        for j in range(FAN):
            pool.child[node, j] = pool.child[source, j]
        for j in range(5):
            pool.node_box[node, j] = pool.node_box[source, j]
    else:
        for j in range(FAN):
            pool.child[node, j] = -1
        pool.node_box[node, 0] = pool.node_box[node, 1] = np.inf
        pool.node_box[node, 2] = pool.node_box[node, 3] = -np.inf
        pool.node_box[node, 4] = 0.0
    return node


@inline
def _new_leaf(pool: Any, source: Any) -> Any:
    """A writable copy of a leaf; of -1 a new one."""
    pool.free[_LEAVES] -= 1
    leaf = pool.free_leaves[pool.free[_LEAVES]]
    if source >= 0:
        for j in range(LEAF):
            for m in range(pool.data.shape[2]):
                pool.data[leaf, j, m] = pool.data[source, j, m]
    return leaf


@inline
def _own_leaf(pool: Any, roots: Any, k: Any, depth: Any, done: Any, size: Any, i: Any) -> Any:
    """The leaf of feature i in map k, writable, on a writable path.

    done[:size] are the features of this map that this operation has written before: what their paths share with this
    one are copies already.
    """
    if size == 0:
        roots[k] = _new_node(pool, roots[k])
    node = roots[k]
    for level in range(depth - 1, -1, -1):
        shift = _LEAF_BITS + _FAN_BITS * level
        slot = (i >> shift) & (FAN - 1)
        child = pool.child[node, slot]
        shared = 0
        for j in range(size):
            shared += (done[j] ^ i) >> shift == 0
        if shared == 0:
            if level > 0:
                child = _new_node(pool, child)
            else:
                child = _new_leaf(pool, child)
            pool.child[node, slot] = child
        node = child
    return node


@inline
def _write(pool: Any, leaf: Any, slot: Any, theta: Any, Sigma: Any, k: Any, i: Any) -> None:
    dim = theta.shape[2]
    for m in range(dim):
        pool.data[leaf, slot, m] = theta[k, i, m]
    pool.data[leaf, slot, dim] = Sigma[k, i, 0, 0]
    pool.data[leaf, slot, dim + 1] = Sigma[k, i, 0, 1]
    pool.data[leaf, slot, dim + 2] = Sigma[k, i, 1, 1]


@inline
def _bound(pool: Any, feature: Any, roots: Any, k: Any, depth: Any, i: Any, count: Any) -> None:
    """Box the leaf of feature i anew, and let the boxes above cover it."""
    leaf = leaf_of(pool, roots[k], depth, i)
    first = i - (i & (LEAF - 1))
    dim, last = pool.data.shape[2] - 4, pool.data.shape[2] - 1
    x0, y0, x1, y1, most = np.inf, np.inf, -np.inf, -np.inf, 0.0
    for j in range(min(LEAF, count - first)):
        row = pool.data[leaf, j]
        if np.isnan(row[last]):
            continue
        a, b, c, d = extent(feature, row)
        x0, y0, x1, y1 = min(x0, a), min(y0, b), max(x1, c), max(y1, d)
        most = max(most, spread(feature, row, ((row[dim], row[dim + 1]), (row[dim + 1], row[dim + 2]))))
    box = pool.leaf_box
    box[leaf, 0], box[leaf, 1], box[leaf, 2], box[leaf, 3], box[leaf, 4] = x0, y0, x1, y1, most
    node, box = roots[k], pool.node_box
    for level in range(depth - 1, 0, -1):
        node = pool.child[node, (i >> (_LEAF_BITS + _FAN_BITS * level)) & (FAN - 1)]
        box[node, 0], box[node, 1] = min(box[node, 0], x0), min(box[node, 1], y0)
        box[node, 2], box[node, 3] = max(box[node, 2], x1), max(box[node, 3], y1)
        box[node, 4] = max(box[node, 4], most)


@kernel
def _mark(child: Any, roots: Any, depth: Any, used_nodes: Any, used_leaves: Any, stack: Any) -> None:
    """Mark all nodes and leaves that the roots reach; stack (FAN * depth + 1, 2) is work space."""
    for root in roots:
        if root < 0 or used_nodes[root]:
            continue
        stack[0, 0], stack[0, 1] = root, depth - 1
        height = 1
        while height > 0:
            height -= 1
            node, level = stack[height, 0], stack[height, 1]
            used_nodes[node] = True
            for j in range(FAN):
                below = child[node, j]
                if below >= 0 and level == 0:
                    used_leaves[below] = True
                elif below >= 0 and not used_nodes[below]:
                    stack[height, 0], stack[height, 1] = below, level - 1
                    height += 1


@kernel
def _deepen(pool: Any, feature: Any, roots: Any, counts: Any, depth: Any) -> None:
    """One level more above every root, which makes room for FAN times as many features."""
    for k in range(len(roots)):
        root = roots[k]
        if root >= 0:
            top, below = _new_node(pool, -1), _new_node(pool, root)
            pool.child[top, 0] = below
            roots[k] = top
            for i in range(0, counts[k], LEAF):  # a root's box was not kept
                leaf = leaf_of(pool, top, depth + 1, i)
                for a in range(2):
                    pool.node_box[below, a] = min(pool.node_box[below, a], pool.leaf_box[leaf, a])
                for a in range(2, 5):
                    pool.node_box[below, a] = max(pool.node_box[below, a], pool.leaf_box[leaf, a])


@kernel
def _take(pool: Any, roots: Any, depth: Any, n: Any, theta: Any, Sigma: Any) -> None:
    dim = theta.shape[2]
    for k in range(n.shape[0]):
        for i in range(n.shape[1]):
            if n[k, i] < 0:
                continue
            row = pool.data[leaf_of(pool, roots[k], depth, n[k, i]), n[k, i] & (LEAF - 1)]
            for m in range(dim):
                theta[k, i, m] = row[m]
            Sigma[k, i, 0, 0] = row[dim]
            Sigma[k, i, 0, 1] = Sigma[k, i, 1, 0] = row[dim + 1]
            Sigma[k, i, 1, 1] = row[dim + 2]


@kernel
def _tags(pool: Any, root: Any, depth: Any, tags: Any) -> None:
    last = pool.data.shape[2] - 1
    for i in range(len(tags)):
        tags[i] = pool.data[leaf_of(pool, root, depth, i), i & (LEAF - 1), last]


@kernel
def _replace(
    pool: Any, feature: Any, roots: Any, counts: Any, depth: Any, n: Any, theta: Any, Sigma: Any, done: Any
) -> None:
    for k in range(n.shape[0]):
        size = 0
        for i in range(n.shape[1]):
            if n[k, i] >= 0:
                leaf = _own_leaf(pool, roots, k, depth, done, size, n[k, i])
                _write(pool, leaf, n[k, i] & (LEAF - 1), theta, Sigma, k, i)
                done[size] = n[k, i]
                size += 1
        for j in range(size):
            again = False  # the leaf is boxed once, by the last of its features here
            for later in range(j + 1, size):
                again |= (done[later] ^ done[j]) >> _LEAF_BITS == 0
            if not again:
                _bound(pool, feature, roots, k, depth, done[j], counts[k])


@kernel
def _remove(pool: Any, feature: Any, roots: Any, counts: Any, depth: Any, n: Any, done: Any) -> None:
    last = pool.data.shape[2] - 1
    for k in range(n.shape[0]):
        size = 0
        for i in range(n.shape[1]):
            if n[k, i] >= 0:
                leaf = _own_leaf(pool, roots, k, depth, done, size, n[k, i])
                pool.data[leaf, n[k, i] & (LEAF - 1), last] = np.nan
                done[size] = n[k, i]
                size += 1
                _bound(pool, feature, roots, k, depth, n[k, i], counts[k])


@kernel
def _append(
    pool: Any, feature: Any, roots: Any, counts: Any, depth: Any, new: Any, theta: Any, Sigma: Any, tags: Any, done: Any
) -> None:
    last = pool.data.shape[2] - 1
    for k in range(new.shape[0]):
        size = 0
        for i in range(new.shape[1]):
            if new[k, i]:
                j = counts[k] + size
                leaf = _own_leaf(pool, roots, k, depth, done, size, j)
                _write(pool, leaf, j & (LEAF - 1), theta, Sigma, k, i)
                pool.data[leaf, j & (LEAF - 1), last] = tags[i]
                done[size] = j
                size += 1
                _bound(pool, feature, roots, k, depth, j, j + 1)


@kernel
def _find(pool: Any, roots: Any, counts: Any, depth: Any, tags: Any, begin: Any, n: Any) -> None:
    last = pool.data.shape[2] - 1
    for k in range(n.shape[0]):
        for i in range(n.shape[1]):
            n[k, i] = -1
            for j in range(begin[i], counts[k]):
                if pool.data[leaf_of(pool, roots[k], depth, j), j & (LEAF - 1), last] == tags[i]:
                    n[k, i] = j
                    break


@kernel
def _hypotheses(
    pool: Any,
    bits: Any,
    roots: Any,
    counts: Any,
    depth: Any,
    table: Any,
    owner: Any,
    seen: Any,
    copies: Any,
    holders: Any,
) -> None:
    """Count into `copies` and `holders` (n,), which come as zeros.

    bits is the pool's data as integers.  table and owner (size,) are a hash table, of which an entry counts only
    if it bears the stamp of those who look, and table comes with zeros; size is a power of two and more than twice the
    number of maps.  seen (3, K) is work space.
    """
    mask, stamp, last = len(table) - 1, 0, bits.shape[2] - 1
    leaves, limits, many = seen[0], seen[1], seen[2]
    for first in range(0, len(copies), LEAF):
        stamp += 1
        found = 0
        for k in range(len(roots)):  # leaves, of which many maps may have the same
            if counts[k] <= first:
                continue
            leaf = leaf_of(pool, roots[k], depth, first)
            h = (leaf * 0x9E3779B1) & mask
            while table[h] == stamp and leaves[owner[h]] != leaf:
                h = (h + 1) & mask
            if table[h] == stamp:
                many[owner[h]] += 1
            else:
                table[h], owner[h] = stamp, found
                leaves[found], limits[found], many[found] = leaf, counts[k], 1
                found += 1
        for j in range(min(LEAF, len(copies) - first)):
            stamp += 1
            for u in range(found):
                row = bits[leaves[u], j]
                if first + j >= limits[u] or np.isnan(pool.data[leaves[u], j, last]):
                    continue
                holders[first + j] += many[u]
                h = 0
                for m in range(last):
                    h = (h ^ row[m]) * 0x5851F42D4C957F2D
                    h ^= (h >> 29) & 0x7FFFFFFFF
                h &= mask
                while table[h] == stamp and not _same(bits[leaves[owner[h]], j], row, last):
                    h = (h + 1) & mask
                if table[h] != stamp:
                    table[h], owner[h] = stamp, u
                    copies[first + j] += 1


@inline
def _same(a: Any, b: Any, size: Any) -> Any:
    equal = True
    for m in range(size):
        equal &= a[m] == b[m]
    return equal


@inline
def search(pool: Any, root: Any, depth: Any, count: Any, box: Any, reach: Any, stack: Any, found: Any) -> Any:
    """Indices of the features in leaves that touch `box` grown by `reach` times their spread (4.3); returns how many.

    Not of those that were removed.  stack: (FAN * depth + 1, 3) work space.  At most len(found) are written.
    """
    if root < 0:
        return 0
    size, last = 0, pool.data.shape[2] - 1
    stack[0, 0], stack[0, 1], stack[0, 2] = root, depth - 1, 0
    height = 1
    while height > 0:
        height -= 1
        node, level, base = stack[height, 0], stack[height, 1], stack[height, 2]
        for j in range(FAN):
            child = pool.child[node, j]
            if child < 0:
                continue
            first = base + (j << (_LEAF_BITS + _FAN_BITS * level))
            b = pool.node_box[child] if level > 0 else pool.leaf_box[child]
            slack = reach * b[4]
            if box[0] > b[2] + slack or box[2] < b[0] - slack or box[1] > b[3] + slack or box[3] < b[1] - slack:
                continue
            if level > 0:
                stack[height, 0], stack[height, 1], stack[height, 2] = child, level - 1, first
                height += 1
            else:
                for i in range(first, min(first + LEAF, count)):
                    if size < len(found) and not np.isnan(pool.data[child, i - first, last]):
                        found[size] = i
                        size += 1
    return size
