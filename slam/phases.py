"""The phases that the three filters share: one equation per function.

Each takes `Particles` and returns new ones; nothing is written in place.  The loops are compiled, over one particle at
a time, and read as the equations do.  One formula serves all filters: with (s, P) the pose Gaussian of a particle and
(theta, Sigma) a feature,

    V = G_s P G_s^T + G_theta Sigma G_theta^T + R

where FastSLAM 1.0 has P = 0, and Dual FastSLAM has Sigma = 0.  Matched observations are applied one after the other, as
observed; innovation and Jacobians are taken anew at the running mean, in every filter alike; only of walls do particles
have other rows than EKF-SLAM (`slam.features.observable`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from slam._jit import inline, kernel
from slam.association.jcbb import chi_square_gates
from slam.features import (
    compatible,
    displacement,
    distance,
    draw,
    extend,
    extent,
    innovation,
    inverse,
    measurement,
    observable,
    total,
    united,
)
from slam.geometry import wrap
from slam.linalg import (
    LOG_TWO_PI,
    add22,
    add_outer_scaled,
    determinant22,
    distance2,
    dot3,
    factor33,
    kalman_feature,
    kalman_pose,
    load3,
    load22,
    load33,
    log_density,
    sandwich22,
    sandwich23,
    sandwich33,
    store3,
    store22,
    store33,
    times33,
)
from slam.map_store import FAN, LEAF, Maps, MapStore, leaf_of, search
from slam.motion import deviation, propagate
from slam.resampling import effective_sample_size, normalise, resample, wants_resampling
from slam.types import NEW, Floats, Frame, Innovations, Ints, Noise, ObservationNoise, Params, Particles

ZERO = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Matched(NamedTuple):
    """The known features that the observations of a frame are paired with."""

    n: Ints
    """(K, Z) their index in each particle's map, NEW or IGNORED."""
    theta: Floats
    """(K, Z, D); not meaningful where nothing is matched."""
    Sigma: Floats
    """(K, Z, 2, 2); zero in Dual FastSLAM."""


class Weighed(NamedTuple):
    """What the observations of a frame say of each particle."""

    log_p: Floats
    """(K, Z) log N(v; 0, V), or what `Miss` says."""
    innovations: Innovations


def unweighed(n: Ints) -> Weighed:
    """Arrays for the correspondences n (K, Z), to be written into."""
    return Weighed(np.zeros(n.shape), Innovations(np.full((*n.shape, 2), np.nan), np.full((*n.shape, 2, 2), np.nan)))


class Miss(NamedTuple):
    """The log density of an unmatched observation beside its -log |2 pi V|^1/2 (ours); NaN where it is not weighed.

    A match multiplies a weight by a million with an accurate sensor, so particles that disagree on what is new can be
    compared only if a miss has a density too: that at the gate, so that a match never weighs less than a miss under the
    same V, and a large P is not rewarded.
    """

    new: float
    ignored: float


UNWEIGHED = Miss(np.nan, np.nan)


def miss_density(params: Params, n: Ints) -> Miss:
    """What `params` say of unmatched observations n (K, Z); at `gate`, with `log_p_new` added.

    With known association particles agree on what is new, and then it does not count (as in the paper); they may
    disagree after another association, and a tag may be disbelieved by some, at `gate_known`.
    """
    new = _at_gate(params.gate) + params.log_p_new
    if params.association != "known":
        return Miss(new, new)
    agreed = ((n == NEW).all(axis=0) | (n != NEW).all(axis=0)).all()
    return Miss(np.nan if agreed else new, _at_gate(params.gate_known))


def _at_gate(confidence: float) -> float:
    """log exp(-gate / 2); finite, so that several of them can be added, even for a gate that lets everything in."""
    return -0.5 * float(chi_square_gates(min(confidence, 1.0 - 1e-12), 1)[1])


def initial(feature: Any, start: Floats, start_covariance: Floats, params: Params) -> Particles:
    """K particles with the same pose Gaussian, start (3,) and (3, 3), and empty maps."""
    K = params.particles
    return Particles(
        s=np.tile(np.asarray(start, float), (K, 1)),
        P=np.tile(np.asarray(start_covariance, float), (K, 1, 1)),
        log_w=np.full(K, -np.log(K)),
        lineage=np.arange(K),
        maps=MapStore(feature).empty(K),
    )


def observation_noise(frame: Frame, params: Params) -> ObservationNoise:
    """R as the filter believes it (7), the honest one."""
    return type(frame.feature).believed(frame.z, params)


def noise_of_known(frame: Frame, R: ObservationNoise, params: Params) -> ObservationNoise:
    """What is believed where known features match, weigh and correct: `inflate_r` times R, and the floors of walls."""
    return type(frame.feature).of_known(R, params)


# Prediction ---------------------------------------------------------------------------------------------------------


def predict(particles: Particles, frame: Frame, believed: Noise) -> Particles:
    """(21) s := h(s, u), P := H_s P H_s^T + Q with Q = H_u diag(deviation^2) H_u^T, over all control ticks."""
    s, P = np.empty_like(particles.s), np.empty_like(particles.P)
    sigma = deviation(frame.motion, frame.u, believed)
    _predict(frame.motion, particles.s, particles.P, frame.u, frame.dt, sigma, s, P)
    return particles._replace(s=s, P=P)


@kernel
def _predict(motion: Any, s: Any, P: Any, u: Any, dt: Any, sigma: Any, s_out: Any, P_out: Any) -> None:
    for k in range(len(s)):
        sk, Pk = load3(s[k]), load33(P[k])
        for t in range(len(u)):
            sk, H_s, H_u = propagate(motion, sk, u[t], dt[t])
            Pk = add_outer_scaled(sandwich33(H_s, Pk), H_u, sigma[t])
        store3(s_out[k], sk)
        store33(P_out[k], Pk)


def predict_by_sampling(rng: np.random.Generator, particles: Particles, frame: Frame, believed: Noise) -> Particles:
    """(11) s ~ p(s | s, u): every particle draws the noise of every control tick; P stays zero."""
    sigma = deviation(frame.motion, frame.u, believed)
    u = frame.u + sigma * rng.standard_normal((len(particles.s), *frame.u.shape))
    s = np.empty_like(particles.s)
    _predict_by_sampling(frame.motion, particles.s, u, frame.dt, s)
    return particles._replace(s=s)


@kernel
def _predict_by_sampling(motion: Any, s: Any, u: Any, dt: Any, s_out: Any) -> None:
    for k in range(len(s)):
        sk = load3(s[k])
        for t in range(len(dt)):
            sk, _, _ = propagate(motion, sk, u[k, t], dt[t])
        store3(s_out[k], sk)


# Known features -----------------------------------------------------------------------------------------------------


def matched_features(maps: Maps, n: Ints) -> Matched:
    """The features that the correspondences n (K, Z) name."""
    return Matched(n, *maps.take(n))


def weigh_marginal(particles: Particles, frame: Frame, matched: Matched, R: ObservationNoise, miss: Miss) -> Weighed:
    """(43) to the letter: log N(v; 0, V), every v and V taken at the pose as it is.

    Exact for one observation; for several it ignores that their innovations share the pose error. An
    unmatched observation has the density that `miss` says.
    """
    weighed = unweighed(matched.n)
    _weigh(frame.feature, particles.s, particles.P, *matched, frame.z, R, miss, *weighed)
    return weighed


@kernel
def _weigh(
    feature: Any, s: Any, P: Any, n: Any, theta: Any, Sigma: Any, z: Any, R: Any, miss: Any,
    log_p: Any, innovations: Any,
) -> None:  # fmt: skip
    model = load22(R.model)
    for k in range(len(s)):
        sk, Pk = load3(s[k]), load33(P[k])
        for i in range(len(z)):
            Ri = load22(R.sensor[i])
            if n[k, i] >= 0:
                v, G_s, S = measurement(feature, theta[k, i], load22(Sigma[k, i]), sk, Pk, z[i], Ri, model)
                V = add22(sandwich23(G_s, Pk), S)
                log_p[k, i] = log_density(v, V)
                _note(innovations, k, i, v, V)
            else:
                log_p[k, i] = _miss_density(
                    feature, sk, Pk, z[i], Ri, model, miss.new if n[k, i] == NEW else miss.ignored
                )


@inline
def _note(innovations: Any, k: Any, i: Any, v: Any, V: Any) -> None:
    innovations.v[k, i, 0], innovations.v[k, i, 1] = v[0], v[1]
    store22(innovations.V[k, i], V)


@inline
def _miss_density(feature: Any, s: Any, P: Any, z: Any, R: Any, model: Any, constant: Any) -> Any:
    """Log density of an unmatched observation (`Miss`), under this particle's V for a feature that stands exactly where
    the observation would create it."""
    if np.isnan(constant):
        return 0.0
    theta, _, _ = inverse(feature, s, z)
    _, G_s, G_theta = innovation(feature, theta, s, z)
    V = add22(sandwich23(G_s, P), total(feature, R, G_theta, model))
    log_p = constant - LOG_TWO_PI - 0.5 * np.log(determinant22(V))
    return log_p if np.isfinite(log_p) else 0.0  # what is nowhere, such as a range of zero, says nothing


def update_pose(
    particles: Particles, frame: Frame, matched: Matched, R: ObservationNoise, miss: Miss
) -> tuple[Particles, Weighed]:
    """(28, 36) EKF update of the pose by every matched observation in turn.

    Also log N(v; 0, V) of each under the pose that the ones before left: by the chain rule their sum is the
    exact (joint) log likelihood, that is FastSLAM 2.0's weight (14) in its integrated form, which does not depend on
    the draw.
    """
    s, P, weighed = np.empty_like(particles.s), np.empty_like(particles.P), unweighed(matched.n)
    _update_pose(frame.feature, particles.s, particles.P, *matched, frame.z, R, miss, s, P, *weighed)
    return particles._replace(s=s, P=P), weighed


@kernel
def _update_pose(
    feature: Any, s: Any, P: Any, n: Any, theta: Any, Sigma: Any, z: Any, R: Any, miss: Any,
    s_out: Any, P_out: Any, log_p: Any, innovations: Any,
) -> None:  # fmt: skip
    model = load22(R.model)
    for k in range(len(s)):
        sk, Pk = load3(s[k]), load33(P[k])
        for i in range(len(z)):
            Ri = load22(R.sensor[i])
            if n[k, i] >= 0:
                v, G_s, S = measurement(feature, theta[k, i], load22(Sigma[k, i]), sk, Pk, z[i], Ri, model)
                V = add22(sandwich23(G_s, Pk), S)
                log_p[k, i] = log_density(v, V)
                _note(innovations, k, i, v, V)
                if log_p[k, i] > -np.inf:  # what is impossible corrects nothing: its gain times infinity is no pose
                    sk, Pk = kalman_pose(sk, Pk, v, G_s, S, V)
            else:
                log_p[k, i] = _miss_density(
                    feature, sk, Pk, z[i], Ri, model, miss.new if n[k, i] == NEW else miss.ignored
                )
        store3(s_out[k], sk)
        store33(P_out[k], Pk)


def linearised_at(
    particles: Particles, frame: Frame, matched: Matched, R: ObservationNoise, drawn: Particles
) -> Floats:
    """log N(v_i - G_i (s - s_i); 0, S_i) (K, Z): the likelihood that `update_pose` saw, at the drawn poses s.

    s_i is the running mean at which observation i was linearised, S = G_theta Sigma G_theta^T + R.  Every update is
    exact for its linearised model, N(s; s_i, P_i) N(v_i - G_i (s - s_i); 0, S_i) = N(s; s_i+1, P_i+1) N(v_i; 0, V_i),
    so the importance weight likelihood x prior / proposal at the drawn pose is the integrated weight times the true
    likelihood there over this one. No inverse of P is needed, which is of rank 2 after one control tick.  Zero where
    nothing is matched.
    """
    log_p = np.zeros(matched.n.shape)
    _linearised_at(frame.feature, particles.s, particles.P, *matched, frame.z, R, drawn.s, log_p)
    return log_p


@kernel
def _linearised_at(
    feature: Any, s: Any, P: Any, n: Any, theta: Any, Sigma: Any, z: Any, R: Any, drawn: Any, log_p: Any
) -> None:
    model = load22(R.model)
    for k in range(len(s)):
        sk, Pk = load3(s[k]), load33(P[k])
        for i in range(len(z)):
            if n[k, i] >= 0:
                Ri = load22(R.sensor[i])
                v, G_s, S = measurement(feature, theta[k, i], load22(Sigma[k, i]), sk, Pk, z[i], Ri, model)
                V = add22(sandwich23(G_s, Pk), S)
                if log_density(v, V) > -np.inf:  # as in `_update_pose`
                    away = (drawn[k, 0] - sk[0], drawn[k, 1] - sk[1], wrap(drawn[k, 2] - sk[2]))
                    log_p[k, i] = log_density((v[0] - dot3(G_s[0], away), v[1] - dot3(G_s[1], away)), S)
                    sk, Pk = kalman_pose(sk, Pk, v, G_s, S, V)


def draw_pose(rng: np.random.Generator, particles: Particles) -> Particles:
    """(12) FastSLAM 2.0: s ~ N(s, P), then P := 0."""
    s = np.empty_like(particles.s)
    _draw_pose(particles.s, particles.P, rng.standard_normal(particles.s.shape), s)
    return particles._replace(s=s, P=np.zeros_like(particles.P))


@kernel
def _draw_pose(s: Any, P: Any, normal: Any, s_out: Any) -> None:
    for k in range(len(s)):
        delta = times33(factor33(load33(P[k])), load3(normal[k]))
        s_out[k, 0] = s[k, 0] + delta[0]
        s_out[k, 1] = s[k, 1] + delta[1]
        s_out[k, 2] = wrap(s[k, 2] + delta[2])


def update_features(
    particles: Particles, frame: Frame, matched: Matched, R: ObservationNoise, miss: Miss
) -> tuple[Particles, Weighed]:
    """FastSLAM: an EKF for each matched feature, given the pose (P = 0).

    Also log N(v; 0, V), V = G_theta Sigma G_theta^T + R: FastSLAM 1.0's weight, exact because features are
    independent given the path.
    """
    theta, Sigma, weighed = np.empty_like(matched.theta), np.empty_like(matched.Sigma), unweighed(matched.n)
    _update_features(frame.feature, particles.s, *matched, frame.z, R, miss, theta, Sigma, *weighed)
    if (matched.n >= 0).any():
        particles = particles._replace(maps=particles.maps.replace(matched.n, theta, Sigma))
    return particles, weighed


@kernel
def _update_features(
    feature: Any, s: Any, n: Any, theta: Any, Sigma: Any, z: Any, R: Any, miss: Any,
    theta_out: Any, Sigma_out: Any, log_p: Any, innovations: Any,
) -> None:  # fmt: skip
    model = load22(R.model)
    for k in range(len(s)):
        sk = load3(s[k])
        for i in range(len(z)):
            Ri = load22(R.sensor[i])
            if n[k, i] >= 0:
                Sk = load22(Sigma[k, i])
                v, _, G_theta = innovation(feature, theta[k, i], sk, z[i])
                Ri = total(feature, Ri, G_theta, model)
                V = add22(sandwich22(G_theta, Sk), Ri)
                log_p[k, i] = log_density(v, V)
                _note(innovations, k, i, v, V)
                delta, S_new = (0.0, 0.0), Sk
                if log_p[k, i] > -np.inf:  # as in `_update_pose`
                    delta, S_new = kalman_feature(Sk, v, G_theta, Ri, V)
                moved = draw(feature, theta[k, i], delta)
                for m in range(len(moved)):
                    theta_out[k, i, m] = moved[m]
                store22(Sigma_out[k, i], S_new)
            else:
                log_p[k, i] = _miss_density(
                    feature, sk, ZERO, z[i], Ri, model, miss.new if n[k, i] == NEW else miss.ignored
                )


# New features -------------------------------------------------------------------------------------------------------


def add_features(particles: Particles, frame: Frame, n: Ints, R: ObservationNoise) -> Particles:
    """FastSLAM: (33) theta = f(s, z), Sigma = F_z R F_z^T, for every unmatched observation; R (Z, 2, 2), the honest
    one."""
    new = n == NEW
    if not new.any():
        return particles
    theta, Sigma = np.empty((*n.shape, type(frame.feature).dim)), np.empty((*n.shape, 2, 2))
    _add_features(frame.feature, particles.s, new, frame.z, R, theta, Sigma)
    return particles._replace(maps=particles.maps.append(new, theta, Sigma, frame.tags))


@kernel
def _add_features(feature: Any, s: Any, new: Any, z: Any, R: Any, theta_out: Any, Sigma_out: Any) -> None:
    model = load22(R.model)
    for k in range(len(s)):
        sk = load3(s[k])
        for i in range(len(z)):
            if new[k, i]:
                theta, _, F_z = inverse(feature, sk, z[i])
                _, _, G_theta = innovation(feature, theta, sk, z[i])
                Ri = total(feature, load22(R.sensor[i]), G_theta, model)
                for m in range(len(theta)):
                    theta_out[k, i, m] = theta[m]
                store22(Sigma_out[k, i], sandwich22(F_z, Ri))


def draw_features(
    rng: np.random.Generator, particles: Particles, frame: Frame, n: Ints, R: ObservationNoise
) -> Particles:
    """Dual FastSLAM: (34) theta ~ N(f(s, z), F_s P F_s^T + F_z R F_z^T), frozen, then (37) EKF the pose on it.

    Each unmatched observation in turn, drawn from the P that the ones before left; R is the honest one.  The
    paper prints (34) with a bare R, which has not the dimensions of a range-bearing feature: F_z R F_z^T is meant.
    Draws no random number when nothing is new.
    """
    new = n == NEW
    if not new.any():
        return particles
    theta = np.empty((*n.shape, type(frame.feature).dim))
    s, P = np.empty_like(particles.s), np.empty_like(particles.P)
    normal = rng.standard_normal((*n.shape, 2))
    _draw_features(frame.feature, particles.s, particles.P, new, frame.z, R, normal, s, P, theta)
    maps = particles.maps.append(new, theta, np.zeros((*n.shape, 2, 2)), frame.tags)
    return particles._replace(s=s, P=P, maps=maps)


@kernel
def _draw_features(
    feature: Any,
    s: Any,
    P: Any,
    new: Any,
    z: Any,
    R: Any,
    normal: Any,
    s_out: Any,
    P_out: Any,
    theta_out: Any,
) -> None:
    model = load22(R.model)
    for k in range(len(s)):
        sk, Pk = load3(s[k]), load33(P[k])
        for i in range(len(z)):
            if new[k, i]:
                mean, F_s, F_z = inverse(feature, sk, z[i])
                _, _, G_theta = innovation(feature, mean, sk, z[i])
                Ri = total(feature, load22(R.sensor[i]), G_theta, model)
                V = add22(sandwich23(F_s, Pk), sandwich22(F_z, Ri))
                delta = displacement(feature, sk, Pk, z[i], V, Ri, (normal[k, i, 0], normal[k, i, 1]))
                theta = draw(feature, mean, delta)
                for m in range(len(theta)):
                    theta_out[k, i, m] = theta[m]
                v, G_s, _ = innovation(feature, theta, sk, z[i])
                G_s = observable(feature, sk, Pk, z[i], v, G_s, Ri)
                V = add22(sandwich23(G_s, Pk), Ri)
                if log_density(v, V) > -np.inf:
                    sk, Pk = kalman_pose(sk, Pk, v, G_s, Ri, V)
        store3(s_out[k], sk)
        store33(P_out[k], Pk)


# What is not uncertain ---------------------------------------------------------------------------------------------


def extend_features(particles: Particles, frame: Frame, n: Ints) -> Particles:
    """(4.1) A wall reaches as far as it was ever seen: matched pieces extend it, seen from the pose as it is.

    The coordinates that are drawn, or have a Sigma, stay as they are.  Points have no extent.
    """
    if not type(frame.feature).grows or not (n >= 0).any():
        return particles
    theta, Sigma = particles.maps.take(n)
    _extend_features(frame.feature, particles.s, n, frame.z, theta)
    return particles._replace(maps=particles.maps.replace(n, theta, Sigma))


@kernel
def _extend_features(feature: Any, s: Any, n: Any, z: Any, theta: Any) -> None:
    """Overwrites theta (K, Z, D), which is the caller's own copy; of two pieces of one wall the later row has both."""
    for k in range(len(s)):
        sk = load3(s[k])
        for i in range(len(z)):
            if n[k, i] >= 0:
                before = i
                for j in range(i):
                    before = j if n[k, j] == n[k, i] else before
                extended = extend(feature, theta[k, before], sk, z[i])
                for m in range(len(extended)):
                    theta[k, i, m] = extended[m]


MERGE_GATE = float(chi_square_gates(0.99, 1)[1])
"""The squared distance up to which two walls may be one (ours).  `Params.gate` is no measure of it: where that is wide,
it is because odometry is worse than it says, and between two walls beside one piece there is no odometry."""

MERGE_REACH = 0.5
"""[m] No farther from the piece is a wall looked for that another one may be merged with."""


def merge_features(
    particles: Particles, frame: Frame, n: Ints, R: ObservationNoise, params: Params
) -> tuple[Particles, Ints, Ints | None]:
    """(ours) Of two walls in a particle's map that a piece lies along, the younger one is absorbed into the elder one.

    Justified is what this scan shows: the piece is paired with one of the two, is within the gate of both from the
    pose as it is now, and the distance of the two is within `MERGE_GATE`, each as wrong as R, that of known features,
    allows it to be.  Walls are as they were before this piece extends one of them (`extend_features`): it would lie
    along that one whatever it is.  Each wall takes part in one merger a step at the most.  Also the correspondences n
    (K, Z), where the younger ones were now the elder ones, and `Trace.merged`.  Where tags say which wall it is, they
    say as well what is not one.
    """
    if not params.merge_walls or not type(frame.feature).merges or params.association == "known":
        return particles, n, None
    elder, younger = np.full(n.shape, NEW), np.full(n.shape, NEW)
    maps, most = particles.maps, int(particles.maps.counts.max(initial=0))
    theta, Sigma = np.empty((*n.shape, maps.store.dim)), np.empty((*n.shape, 2, 2))
    stack, found = np.empty((FAN * maps.depth + 1, 3), np.int64), np.empty(most, np.int64)
    gate = float(chi_square_gates(params.gate, 1)[1])
    _find_mergers(
        maps.store.pool, maps.roots, maps.counts, maps.depth, frame.feature, particles.s, particles.P, n, frame.z, R,
        gate, stack, found, elder, younger, theta, Sigma,
    )  # fmt: skip
    if not (younger >= 0).any():
        return particles, n, younger
    for i in range(n.shape[1]):
        n = np.where((n == younger[:, i, None]) & (n >= 0), elder[:, i, None], n)
    return particles._replace(maps=maps.replace(elder, theta, Sigma).remove(younger)), n, younger


@kernel
def _find_mergers(
    pool: Any, roots: Any, counts: Any, depth: Any, feature: Any, s: Any, P: Any, n: Any, z: Any, R: Any, gate: Any,
    stack: Any, found: Any, elder: Any, younger: Any, theta: Any, Sigma: Any,
) -> None:  # fmt: skip
    """Into elder, younger (K, Z), which are NEW, and theta, Sigma of the two as one."""
    model = load22(R.model)
    for k in range(len(s)):
        sk, Pk = load3(s[k]), load33(P[k])
        for i in range(len(z)):
            a, Ri = n[k, i], load22(R.sensor[i])
            if a < 0 or _takes_part(elder[k], younger[k], a):
                continue
            row_a, Sigma_a = _entry(pool, roots[k], depth, a)
            if not _may_be_of(feature, row_a, Sigma_a, sk, Pk, z[i], Ri, model, gate):
                continue
            nearest = MERGE_GATE
            new, _, _ = inverse(feature, sk, z[i])
            x0, y0, x1, y1 = extent(feature, new)
            box = (x0 - MERGE_REACH, y0 - MERGE_REACH, x1 + MERGE_REACH, y1 + MERGE_REACH)
            for c in range(search(pool, roots[k], depth, counts[k], box, 0.0, stack, found)):
                b = found[c]
                if b == a or _takes_part(elder[k], younger[k], b):
                    continue
                row_b, Sigma_b = _entry(pool, roots[k], depth, b)
                if not _may_be_of(feature, row_b, Sigma_b, sk, Pk, z[i], Ri, model, gate):
                    continue
                first, Sigma_1, second, Sigma_2 = row_a, Sigma_a, row_b, Sigma_b
                if b < a:
                    first, Sigma_1, second, Sigma_2 = row_b, Sigma_b, row_a, Sigma_a
                d2 = distance(feature, first, Sigma_1, second, Sigma_2, sk, z[i], model)
                if d2 <= nearest:
                    nearest = d2
                    elder[k, i], younger[k, i] = min(a, b), max(a, b)
                    one, Sigma_one = united(feature, first, Sigma_1, second, Sigma_2)
                    for m in range(len(one)):
                        theta[k, i, m] = one[m]
                    store22(Sigma[k, i], Sigma_one)


@inline
def _takes_part(elder: Any, younger: Any, j: Any) -> Any:
    """Whether feature j is in a merger already; elder, younger (Z,)."""
    found = False
    for i in range(len(elder)):
        found |= elder[i] == j or younger[i] == j
    return found


@inline
def _entry(pool: Any, root: Any, depth: Any, j: Any) -> Any:
    """theta, in a row of the pool, and Sigma of feature j."""
    row, dim = pool.data[leaf_of(pool, root, depth, j), j & (LEAF - 1)], pool.data.shape[2] - 4
    return row, ((row[dim], row[dim + 1]), (row[dim + 1], row[dim + 2]))


@inline
def _may_be_of(feature: Any, theta: Any, Sigma: Any, s: Any, P: Any, z: Any, R: Any, model: Any, gate: Any) -> Any:
    """Whether z is individually compatible (27) with a feature."""
    if not compatible(feature, theta, s, P, z):
        return False
    v, G_s, S = measurement(feature, theta, Sigma, s, P, z, R, model)
    return distance2(v, add22(sandwich23(G_s, P), S)) <= gate


# Weights and resampling ---------------------------------------------------------------------------------------------


def reweigh(particles: Particles, log_likelihood: Floats) -> tuple[Particles, tuple[str, ...]]:
    """w := w prod_i p(z_i), normalised, in the log domain; log_likelihood (K, Z).  Also what went wrong, in words."""
    log_w, possible = normalise(particles.log_w + log_likelihood.sum(axis=1))
    events = () if possible else ("every particle is impossible: the weights were made equal again",)
    return particles._replace(log_w=log_w), events


def select(particles: Particles, ancestors: Ints) -> Particles:
    """The chosen particles (K',) with equal weights; maps are shared, not copied."""
    s, P, _, lineage, maps = particles
    log_w = np.full(len(ancestors), -np.log(len(ancestors)))
    return Particles(s[ancestors], P[ancestors], log_w, lineage[ancestors], maps.select(ancestors))


def resize(rng: np.random.Generator, particles: Particles, params: Params) -> tuple[Particles, Ints]:
    """A change of the number of particles is a resampling to the new number.  Also the index of each in the old set."""
    K = len(particles.s)
    if params.particles == K:
        return particles, np.arange(K)
    ancestors = resample(rng, particles.log_w, params.particles, params.resampler)
    return select(particles, ancestors), ancestors


def resample_if_needed(
    rng: np.random.Generator, particles: Particles, params: Params
) -> tuple[Particles, Ints, float, bool]:
    """(44) resample when N_eff < resample_below K.  Also the chosen indices (K,), N_eff, and whether it happened."""
    K = len(particles.s)
    n_eff = effective_sample_size(particles.log_w)
    if not wants_resampling(n_eff, K, params.resample_below):
        return particles, np.arange(K), n_eff, False
    ancestors = resample(rng, particles.log_w, K, params.resampler)
    return select(particles, ancestors), ancestors, n_eff, True
