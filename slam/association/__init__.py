"""Data association: which feature of each particle's own map an observation is of (4.2, 25-27).

`known` trusts the tags; `nearest` and `jcbb` see only numbers.  Both begin with the same pairs: every feature that the
search over the map finds near an observation, and that passes the individual chi-square gate (27) of the particle's
own innovation covariance V.  Then `nearest` takes pairs greedily, nearest first, each observation and each feature
once; `jcbb` takes the largest jointly compatible set.

What is left unpaired is of something new - or it is the one in a hundred that a gate of 99 % rejects, and would make a
duplicate of a feature that is there (ours): within the wider `gate_new` of a feature that no other observation was
paired with it is ignored.  One scan may add no more than the `most_new` walls that it shows best (ours).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from slam._jit import inline, kernel
from slam.association.jcbb import MAX_NODES, chi_square_gates, joint_compatibility, workspace
from slam.association.nearest import nearest_first, slot_for
from slam.features import Wall, compatible, measurement, region
from slam.linalg import add22, cross23, distance2, load3, load22, load33, sandwich23
from slam.map_store import FAN, LEAF, Maps, leaf_of, search
from slam.types import IGNORED, NEW, UNKNOWN_TAG, Floats, Frame, Ints, ObservationNoise, Params, Particles

MAX_CANDIDATES = 8
"""Features that one observation may choose from: the nearest of those that passed the gate (ours)."""

MAX_PAIRS = 512
"""Pairs of one particle in all, though every observation may keep one: the joint covariance has its square (ours)."""


def associate(particles: Particles, frame: Frame, R: ObservationNoise, params: Params) -> Ints:
    """n (K, Z): for every particle the feature of its map that each observation is of, NEW or IGNORED.

    R is what matching believes, that is with `inflate_r`.  An observation that is not finite
    is IGNORED.
    """
    n = _associated(particles, frame, R, params)
    n[:, ~np.isfinite(frame.z).all(axis=1)] = IGNORED
    limit_new(n, frame, R, params)
    return n


def limit_new(n: Ints, frame: Frame, R: ObservationNoise, params: Params) -> None:
    """Of the NEW walls in each row of n (K, Z) all but the best `most_new` become IGNORED, in place.

    The best are those whose angle is known best: its variance, that of the noise about the line over the sum of squares
    along it, is small for what is long, has many beams and is straight, and a wrong angle is what a wall is wrong with
    far from where it was made.
    """
    if params.most_new == 0 or not isinstance(frame.feature, Wall):
        return
    best_first = np.argsort(R.sensor[:, 1, 1], kind="stable")
    new = n[:, best_first] == NEW
    rank = np.empty_like(n)
    rank[:, best_first] = np.cumsum(new, axis=1)
    n[(n == NEW) & (rank > params.most_new)] = IGNORED


def _associated(particles: Particles, frame: Frame, R: ObservationNoise, params: Params) -> Ints:
    maps = particles.maps
    if params.association == "known":
        n = by_tag(maps, frame.tags)
        if params.gate_known < 1.0:
            theta, Sigma = maps.take(n)
            gate = chi_square_gates(params.gate_known, 1)[1]
            _ignore_outliers(frame.feature, particles.s, particles.P, theta, Sigma, frame.z, R, gate, n)
        return n
    Z, pool = len(frame.z), maps.store.pool
    n = np.full((len(maps), Z), NEW)
    if Z and maps.counts.any():
        gates = chi_square_gates(params.gate, Z)
        work = _workspace(Z, maps.depth, int(maps.counts.max()))
        joint = params.association == "jcbb"
        _associate(
            pool, maps.roots, maps.counts, maps.depth, frame.feature, particles.s, particles.P, frame.z, R, gates,
            ignore_gate(params), joint, work, n,
        )  # fmt: skip
    return n


def by_tag(maps: Maps, tags: Ints) -> Ints:
    """n (K, Z) of known association; what nobody knows is IGNORED, rather than new at every sight."""
    n = maps.find(tags)
    n[:, tags == UNKNOWN_TAG] = IGNORED
    return n


def candidates(Z: int) -> int:
    """How many features each of Z observations may choose from."""
    return max(1, min(MAX_CANDIDATES, MAX_PAIRS // max(Z, 1)))


class _Work(NamedTuple):
    """Work space for the M pairs of one particle."""

    obs: Ints
    feat: Ints
    d2: Floats
    nearest: Floats
    """(Z,) distance of the nearest feature, in the gate or not."""
    free: Any
    v: Floats
    G: Floats
    V: Floats
    C: Floats
    stack: Ints
    found: Ints
    search: Any


def _workspace(Z: int, depth: int, features: int) -> _Work:
    M = Z * candidates(Z)
    return _Work(
        obs=np.empty(M, np.int64),
        feat=np.empty(M, np.int64),
        d2=np.empty(M),
        nearest=np.empty(Z),
        free=np.empty(M, np.bool_),
        v=np.empty((M, 2)),
        G=np.empty((M, 2, 3)),
        V=np.empty((M, 2, 2)),
        C=np.empty((2 * M, 2 * M)),
        stack=np.empty((FAN * depth + 1, 3), np.int64),
        found=np.empty(features, np.int64),
        search=workspace(M, Z),
    )


@kernel
def _ignore_outliers(feature: Any, s: Any, P: Any, theta: Any, Sigma: Any, z: Any, R: Any, gate: Any, n: Any) -> None:
    model = load22(R.model)
    for k in range(len(s)):
        sk, Pk = load3(s[k]), load33(P[k])
        for i in range(len(z)):
            if n[k, i] >= 0:
                Ri = load22(R.sensor[i])
                v, G_s, S = measurement(feature, theta[k, i], load22(Sigma[k, i]), sk, Pk, z[i], Ri, model)
                V = add22(sandwich23(G_s, Pk), S)
                if not distance2(v, V) <= gate:
                    n[k, i] = IGNORED


def ignore_gate(params: Params) -> float:
    """The squared distance from a feature up to which an unmatched observation is ignored; negative for never."""
    return float(chi_square_gates(params.gate_new, 1)[1]) if params.gate_new > params.gate else -1.0


@kernel
def _associate(
    pool: Any, roots: Any, counts: Any, depth: Any, feature: Any, s: Any, P: Any, z: Any, R: Any,
    gates: Any, ignore: Any, joint: Any, work: Any, n: Any,
) -> None:  # fmt: skip
    Z, dim = len(z), pool.data.shape[2] - 4
    obs, feat, d2, nearest, free, v, G, V, C, stack, found, jcbb = work
    reach, model = math.sqrt(max(gates[1], ignore)), load22(R.model)
    for k in range(len(s)):
        sk, Pk = load3(s[k]), load33(P[k])
        M = 0
        for i in range(Z):
            Ri = load22(R.sensor[i])
            box, beyond = region(feature, sk, Pk, z[i], Ri, model, reach)  # (4.3) look where the gate can reach
            first = M
            nearest[i] = np.inf
            for c in range(search(pool, roots[k], depth, counts[k], box, beyond, stack, found)):
                j = found[c]
                row = pool.data[leaf_of(pool, roots[k], depth, j), j & (LEAF - 1)]
                if not compatible(feature, row, sk, Pk, z[i]):
                    continue
                Sigma = ((row[dim], row[dim + 1]), (row[dim + 1], row[dim + 2]))
                vj, G_s, S = measurement(feature, row, Sigma, sk, Pk, z[i], Ri, model)  # (23, 24)
                Vj = add22(sandwich23(G_s, Pk), S)
                distance = distance2(vj, Vj)  # (25)
                nearest[i] = min(nearest[i], distance)
                if not distance <= gates[1]:  # (27)
                    continue
                p = slot_for(d2, first, M, len(obs) // Z, distance)
                if p < 0:
                    continue
                M = max(M, p + 1)
                obs[p], feat[p], d2[p] = i, j, distance
                v[p, 0], v[p, 1] = vj
                for a in range(2):
                    G[p, a, 0], G[p, a, 1], G[p, a, 2] = G_s[a]
                    V[p, a, 0], V[p, a, 1] = Vj[a]
        if joint:
            _joint_covariance(obs, G, V, Pk, C, M)
            joint_compatibility(obs[:M], feat[:M], v[:M], C[: 2 * M, : 2 * M], gates, MAX_NODES, jcbb, n[k])
        else:
            nearest_first(obs[:M], feat[:M], d2[:M], free[:M], n[k])
        for i in range(Z):
            if n[k, i] == NEW and nearest[i] <= ignore and _may_be_known(
                pool, roots[k], counts[k], depth, feature, sk, Pk, z[i], load22(R.sensor[i]), model, ignore,
                n[k], stack, found,
            ):  # fmt: skip
                n[k, i] = IGNORED


@inline
def _may_be_known(
    pool: Any, root: Any, count: Any, depth: Any, feature: Any, s: Any, P: Any, z: Any, R: Any, model: Any,
    ignore: Any, n: Any, stack: Any, found: Any,
) -> Any:  # fmt: skip
    """Whether an unpaired observation is within the gate `ignore` of a feature that is in no pair of n (Z,)."""
    dim = pool.data.shape[2] - 4
    box, beyond = region(feature, s, P, z, R, model, math.sqrt(ignore))
    for c in range(search(pool, root, depth, count, box, beyond, stack, found)):
        j = found[c]
        paired = False
        for other in n:
            paired |= other == j
        if paired:
            continue
        row = pool.data[leaf_of(pool, root, depth, j), j & (LEAF - 1)]
        if not compatible(feature, row, s, P, z):
            continue
        Sigma = ((row[dim], row[dim + 1]), (row[dim + 1], row[dim + 2]))
        v, G_s, S = measurement(feature, row, Sigma, s, P, z, R, model)
        V = add22(sandwich23(G_s, P), S)
        if distance2(v, V) <= ignore:
            return True
    return False


@inline
def _joint_covariance(obs: Any, G: Any, V: Any, P: Any, C: Any, M: Any) -> None:
    """C (2M, 2M) of M stacked innovations: they share the error of the pose and nothing else, because features are
    independent given the pose.  Pairs that exclude each other are left out."""
    for p in range(M):
        for a in range(2):
            C[2 * p + a, 2 * p], C[2 * p + a, 2 * p + 1] = V[p, a, 0], V[p, a, 1]
        Gp = (load3(G[p, 0]), load3(G[p, 1]))
        for q in range(p):
            if obs[p] != obs[q]:
                block = cross23(Gp, P, (load3(G[q, 0]), load3(G[q, 1])))
                for a in range(2):
                    for b in range(2):
                        C[2 * p + a, 2 * q + b] = C[2 * q + b, 2 * p + a] = block[a][b]
