"""EKF-SLAM: one Gaussian over the pose and all features, the baseline that the paper's introduction argues against.

Same interface as the particle filters, as one "particle"; beside the marginals that a `Particles` holds it carries the
joint covariance.  R. Smith, M. Self, P. Cheeseman, "Estimating Uncertain Spatial Relationships in Robotics" (1990).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from slam._jit import inline, kernel
from slam.association import by_tag, candidates, ignore_gate, limit_new
from slam.association.jcbb import MAX_NODES, chi_square_gates, joint_compatibility, workspace
from slam.association.nearest import nearest_first, slot_for
from slam.features import Wall, compatible, draw, innovation, inverse, total
from slam.geometry import wrap
from slam.linalg import distance2, dot2, inverse22, load22, load33, log_density, store22
from slam.phases import Weighed, extend_features, initial, noise_of_known, observation_noise, predict, unweighed
from slam.types import IGNORED, NEW, Estimator, Floats, Frame, Ints, ObservationNoise, Params, Particles, Trace

POSE = slice(0, 3)


class EkfState(NamedTuple):
    """The joint Gaussian.  Pose mean, feature means and their marginals are in the one particle."""

    particles: Particles
    """K = 1."""
    covariance: Floats
    """(3 + 2n, 3 + 2n) of the pose and of the two uncertain coordinates of each feature."""


def init(feature: Any, start: Floats, start_covariance: Floats, params: Params) -> EkfState:
    """The pose Gaussian, start (3,) and (3, 3), and an empty map.  `params.particles` does not matter."""
    one = Params(particles=1)
    return EkfState(initial(feature, start, start_covariance, one), np.array(start_covariance, float))


def step(rng: np.random.Generator, state: EkfState, frame: Frame, params: Params) -> tuple[EkfState, Trace]:
    """One observing step: predict, associate, correct pose and map, add what is new.  Draws nothing."""
    R = observation_noise(frame, params)
    R_known = noise_of_known(frame, R, params)

    state = predict_joint(state, frame, params)
    predicted = state.particles
    n = associate_joint(state, frame, R_known, params)
    n[:, ~np.isfinite(frame.z).all(axis=1)] = IGNORED
    limit_new(n, frame, R_known, params)
    state, weighed = update_joint(state, frame, n, R_known)
    state = state._replace(particles=extend_features(state.particles, frame, n))  # 4.1
    state = augment(state, frame, n, R)
    if params.orthogonal and type(frame.feature) is Wall:
        state = constrain_angles(state, frame.feature, int((n[0] == NEW).sum()))

    weighted, one, log_p = state.particles, np.zeros(1, np.int64), params.temper * weighed.log_p
    return state, Trace(
        predicted, weighted, weighted, n, log_p, params.temper, weighed.innovations, 1.0, False, one, one
    )


def predict_joint(state: EkfState, frame: Frame, params: Params) -> EkfState:
    """s := h(s, u); the features stay, their correlation with the pose turns with H_s.

    H_s of every motion model here is that of a displacement given in the robot's frame, so the product over the ticks
    is that of the whole displacement.
    """
    before = state.particles
    after = predict(before, frame, params.believed)
    dx, dy = after.s[0, :2] - before.s[0, :2]
    H_s = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    covariance = state.covariance.copy()
    covariance[POSE, 3:] = H_s @ covariance[POSE, 3:]
    covariance[3:, POSE] = covariance[POSE, 3:].T
    covariance[POSE, POSE] = after.P[0]
    return EkfState(after, covariance)


def associate_joint(state: EkfState, frame: Frame, R: ObservationNoise, params: Params) -> Ints:
    """n (1, Z) as `slam.association.associate`, with the joint covariance of all innovations."""
    maps = state.particles.maps
    if params.association == "known":
        n = by_tag(maps, frame.tags)
        if params.gate_known < 1.0 and maps.counts[0]:
            gate, theta = chi_square_gates(params.gate_known, 1)[1], maps.features(0)[0]
            _ignore_outliers(frame.feature, state.particles.s[0], theta, state.covariance, frame.z, R, gate, n[0])
        return n
    n = np.full((1, len(frame.z)), NEW)
    if not len(frame.z) or not maps.counts[0]:
        return n
    theta, _, _ = maps.features(0)
    gates = chi_square_gates(params.gate, len(frame.z))
    most = len(frame.z) * candidates(len(frame.z))
    obs, feat, d2 = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    v, G, nearest = np.empty((most, 2)), np.empty((most, 2, 5)), np.full(len(frame.z), np.inf)
    s, covariance = state.particles.s[0], state.covariance
    M = _compatible_pairs(frame.feature, s, theta, covariance, frame.z, R, gates[1], obs, feat, d2, v, G, nearest)
    obs, feat, d2, v, G = obs[:M], feat[:M], d2[:M], v[:M], G[:M]
    if params.association == "nearest":
        _choose_nearest(obs, feat, d2, np.empty(M, np.bool_), n[0])
    elif M:
        C = _joint_innovation_covariance(frame.feature, covariance, obs, feat, G, R)
        _choose_jointly(obs, feat, v, C, gates, workspace(M, len(frame.z)), n[0])
    _ignore_near_misses(frame.feature, s, theta, covariance, frame.z, R, ignore_gate(params), nearest, n[0])
    return n


@inline
def _innovation(feature: Any, s: Any, theta: Any, covariance: Any, j: Any, z: Any, R: Any, i: Any) -> Any:
    """v (2,), G = (G_s, G_theta) (2, 5) and V (2, 2) of observation i and feature j, which is correlated with the
    pose."""
    v, G_s, G_theta = innovation(feature, theta[j], s, z[i])
    G = (
        (G_s[0][0], G_s[0][1], G_s[0][2], G_theta[0][0], G_theta[0][1]),
        (G_s[1][0], G_s[1][1], G_s[1][2], G_theta[1][0], G_theta[1][1]),
    )
    (V00, V01), (_, V11) = total(feature, load22(R.sensor[i]), G_theta, load22(R.model))
    for a in range(5):
        row = a if a < 3 else 2 * j + a  # of the joint covariance: the pose, then this feature
        w0, w1 = 0.0, 0.0
        for b in range(5):
            column = b if b < 3 else 2 * j + b
            w0 += covariance[row, column] * G[0][b]
            w1 += covariance[row, column] * G[1][b]
        V00 += G[0][a] * w0
        V01 += G[0][a] * w1
        V11 += G[1][a] * w1
    return v, G, ((V00, V01), (V01, V11))


@kernel
def _ignore_outliers(feature: Any, s: Any, theta: Any, covariance: Any, z: Any, R: Any, gate: Any, n: Any) -> None:
    for i in range(len(z)):
        if n[i] >= 0:
            v, _, V = _innovation(feature, s, theta, covariance, n[i], z, R, i)
            if not distance2(v, V) <= gate:
                n[i] = IGNORED


@kernel
def _ignore_near_misses(
    feature: Any, s: Any, theta: Any, covariance: Any, z: Any, R: Any, ignore: Any, nearest: Any, n: Any
) -> None:
    """IGNORED for what is unpaired but within the gate `ignore` of a feature that is in no pair."""
    pose = load33(covariance)
    for i in range(len(z)):
        if n[i] != NEW or not nearest[i] <= ignore:
            continue
        for j in range(len(theta)):
            paired = False
            for other in n:
                paired |= other == j
            if not paired and compatible(feature, theta[j], s, pose, z[i]):
                v, _, V = _innovation(feature, s, theta, covariance, j, z, R, i)
                if distance2(v, V) <= ignore:
                    n[i] = IGNORED
                    break


@kernel
def _compatible_pairs(
    feature: Any, s: Any, theta: Any, covariance: Any, z: Any, R: Any, gate: Any,
    obs: Any, feat: Any, d2: Any, v: Any, G: Any, nearest: Any,
) -> int:  # fmt: skip
    """M pairs that pass the gate (27): obs (M,), feat (M,), d2 (M,), v (M, 2) and G (M, 2, 5) = (G_s, G_theta).

    nearest (Z,) is lowered to the distance of the nearest feature, in the gate or not.
    """
    M, pose = 0, load33(covariance)
    for i in range(len(z)):
        first = M
        for j in range(len(theta)):
            if not compatible(feature, theta[j], s, pose, z[i]):
                continue
            vj, g, V = _innovation(feature, s, theta, covariance, j, z, R, i)
            distance = distance2(vj, V)  # (25)
            nearest[i] = min(nearest[i], distance)
            if not distance <= gate:
                continue
            p = slot_for(d2, first, M, len(obs) // len(z), distance)
            if p < 0:
                continue
            M = max(M, p + 1)
            obs[p], feat[p], d2[p] = i, j, distance
            v[p, 0], v[p, 1] = vj
            for a in range(5):
                G[p, 0, a], G[p, 1, a] = g[0][a], g[1][a]
    return M


def _joint_innovation_covariance(
    feature: Any, covariance: Floats, obs: Ints, feat: Ints, G: Floats, R: ObservationNoise
) -> Floats:
    """(2M, 2M) of the stacked innovations of M pairs, whose errors share the pose and correlated features."""
    M = len(obs)
    columns = np.concatenate([np.tile([0, 1, 2], (M, 1)), 3 + 2 * feat[:, None] + [0, 1]], axis=1)  # (M, 5)
    H = np.zeros((2 * M, len(covariance)))
    for p in range(M):
        H[2 * p : 2 * p + 2, columns[p]] = G[p]
    C = H @ covariance @ H.T
    _add_noise(feature, obs, G, R, C)
    return C


@kernel
def _add_noise(feature: Any, obs: Any, G: Any, R: Any, C: Any) -> None:
    """Adds R of observations obs (M,), seen with Jacobians G (M, 2, 5), to the blocks of C (2M, 2M)."""
    model = load22(R.model)
    for p in range(len(obs)):
        G_theta = ((G[p, 0, 3], G[p, 0, 4]), (G[p, 1, 3], G[p, 1, 4]))
        Rp = total(feature, load22(R.sensor[obs[p]]), G_theta, model)
        for a in range(2):
            C[2 * p + a, 2 * p] += Rp[a][0]
            C[2 * p + a, 2 * p + 1] += Rp[a][1]


@kernel
def _choose_nearest(obs: Any, feat: Any, d2: Any, free: Any, n: Any) -> None:
    nearest_first(obs, feat, d2, free, n)


@kernel
def _choose_jointly(obs: Any, feat: Any, v: Any, C: Any, gates: Any, work: Any, n: Any) -> None:
    joint_compatibility(obs, feat, v, C, gates, MAX_NODES, work, n)


def update_joint(state: EkfState, frame: Frame, n: Ints, R: ObservationNoise) -> tuple[EkfState, Weighed]:
    """EKF update by every matched observation in turn, linearised at the running mean; also log N(v; 0, V) (1, Z)."""
    weighed = unweighed(n)
    if not (n >= 0).any():
        return state, weighed
    particles = state.particles
    s, covariance = particles.s[0].copy(), state.covariance.copy()
    theta = particles.maps.features(0)[0]
    W, K = np.empty((len(covariance), 2)), np.empty((len(covariance), 2))
    log_p, (seen_v, seen_V) = weighed
    _update_joint(frame.feature, s, theta, covariance, n[0], frame.z, R, log_p[0], seen_v[0], seen_V[0], W, K)
    maps = particles.maps.replace(np.arange(len(theta))[None], theta[None], _feature_blocks(covariance)[None])
    return _with(particles._replace(s=s[None], maps=maps), covariance), weighed


@kernel
def _update_joint(
    feature: Any, s: Any, theta: Any, covariance: Any, n: Any, z: Any, R: Any,
    log_p: Any, seen_v: Any, seen_V: Any, W: Any, K: Any,
) -> None:  # fmt: skip
    """Overwrites s, theta and covariance, which are the caller's own copies; W, K (3 + 2n, 2) are work space.

    Into log_p (Z,), seen_v (Z, 2) and seen_V (Z, 2, 2), where an observation is matched.
    """
    size, model = len(covariance), load22(R.model)
    for i in range(len(z)):
        if n[i] < 0:
            continue
        v, G_s, G_theta = innovation(feature, theta[n[i]], s, z[i])
        f = 3 + 2 * n[i]
        for r in range(size):  # W = covariance G^T, of which only five columns of G are not zero
            for a in range(2):
                pose = covariance[r, 0] * G_s[a][0] + covariance[r, 1] * G_s[a][1] + covariance[r, 2] * G_s[a][2]
                W[r, a] = pose + covariance[r, f] * G_theta[a][0] + covariance[r, f + 1] * G_theta[a][1]
        (V00, V01), (_, V11) = total(feature, load22(R.sensor[i]), G_theta, model)
        for c in range(3):
            V00 += G_s[0][c] * W[c, 0]
            V01 += G_s[0][c] * W[c, 1]
            V11 += G_s[1][c] * W[c, 1]
        for c in range(2):
            V00 += G_theta[0][c] * W[f + c, 0]
            V01 += G_theta[0][c] * W[f + c, 1]
            V11 += G_theta[1][c] * W[f + c, 1]
        V = ((V00, V01), (V01, V11))
        log_p[i] = log_density(v, V)
        seen_v[i, 0], seen_v[i, 1] = v[0], v[1]
        store22(seen_V[i], V)
        if not log_p[i] > -np.inf:
            continue  # what is impossible corrects nothing
        Vi = inverse22(V)
        for r in range(size):
            K[r, 0], K[r, 1] = dot2((W[r, 0], W[r, 1]), Vi[0]), dot2((W[r, 0], W[r, 1]), Vi[1])
        s[0] += K[0, 0] * v[0] + K[0, 1] * v[1]
        s[1] += K[1, 0] * v[0] + K[1, 1] * v[1]
        s[2] = wrap(s[2] + K[2, 0] * v[0] + K[2, 1] * v[1])
        for j in range(len(theta)):
            m = 3 + 2 * j
            delta = (dot2((K[m, 0], K[m, 1]), v), dot2((K[m + 1, 0], K[m + 1, 1]), v))
            moved = draw(feature, theta[j], delta)
            for d in range(len(moved)):
                theta[j, d] = moved[d]
        for r in range(size):  # K W^T = K V K^T is symmetric; computed once for both triangles it stays so
            for c in range(r + 1):
                covariance[r, c] -= K[r, 0] * W[c, 0] + K[r, 1] * W[c, 1]
                covariance[c, r] = covariance[r, c]


def augment(state: EkfState, frame: Frame, n: Ints, R: ObservationNoise) -> EkfState:
    """Add every unmatched observation: theta = f(s, z), with its correlation to pose and map through F_s (33, 35)."""
    particles, covariance = state
    for i in np.flatnonzero(n[0] == NEW):
        theta, F_s, F_z = inverse(frame.feature, particles.s[0], frame.z[i])
        _, G_s, G_theta = innovation(frame.feature, theta, particles.s[0], frame.z[i])
        Ri = np.zeros((2, 2))
        _add_noise(frame.feature, np.array([i]), np.concatenate([G_s, G_theta], axis=1)[None], R, Ri)
        F_s, F_z = np.array(F_s), np.array(F_z)
        size = len(covariance)
        grown = np.empty((size + 2, size + 2))
        grown[:size, :size] = covariance
        grown[size:, :size] = F_s @ covariance[POSE]
        grown[:size, size:] = grown[size:, :size].T
        grown[size:, size:] = F_s @ covariance[POSE, POSE] @ F_s.T + F_z @ Ri @ F_z.T
        covariance = grown
        maps = particles.maps.append(
            np.ones((1, 1), bool), np.array([[theta]]), grown[None, None, size:, size:], frame.tags[i : i + 1]
        )
        particles = particles._replace(maps=maps)
    return _with(particles, covariance)


PARALLEL = math.radians(0.05)
"""[rad] Deviation with which two walls of one building are parallel or at right angles."""

PARALLEL_GATE = 6.635
"""Chi-square of one degree of freedom at 99 %: a wall whose angle is farther off is an oblique one."""


def constrain_angles(state: EkfState, feature: Any, added: int) -> EkfState:
    """Make the last `added` walls parallel or at right angles to the first one, where their angles allow it.

    That phi_j - phi_0 is a multiple of pi/2 enters as an observation, accurate to `PARALLEL`.  Without such knowledge
    of the building the angles of an EKF's walls become inconsistent (the paper's introduction).
    """
    particles, covariance = state.particles, np.array(state.covariance)
    theta = particles.maps.features(0)[0]
    s, first = np.array(particles.s[0], float), POSE.stop + 1  # the row of phi_0
    for j in range(max(len(theta) - added, 1), len(theta)):
        row = first + 2 * j
        difference = theta[j, 2] - theta[0, 2]
        v = wrap(0.5 * math.pi * round(difference / (0.5 * math.pi)) - difference)
        w = covariance[:, row] - covariance[:, first]
        V = w[row] - w[first] + PARALLEL**2
        if v * v > PARALLEL_GATE * V:
            continue
        delta = w * (v / V)
        s += delta[POSE]
        theta = np.array([draw(feature, theta[i], delta[3 + 2 * i : 5 + 2 * i]) for i in range(len(theta))])
        covariance = covariance - np.outer(w, w) / V
    s[2] = wrap(s[2])
    maps = particles.maps.replace(np.arange(len(theta))[None], theta[None], _feature_blocks(covariance)[None])
    return _with(particles._replace(s=s[None], maps=maps), covariance)


def _feature_blocks(covariance: Floats) -> Floats:
    """(n, 2, 2) the marginals of the features."""
    n = (len(covariance) - 3) // 2
    blocks = covariance[3:, 3:].reshape(n, 2, n, 2)
    return blocks[np.arange(n), :, np.arange(n), :]


def _with(particles: Particles, covariance: Floats) -> EkfState:
    return EkfState(particles._replace(P=covariance[None, POSE, POSE].copy()), covariance)


EKF_SLAM = Estimator(
    key="ekf",
    title="EKF-SLAM",
    reference="Smith, Self, Cheeseman, in: Autonomous Robot Vehicles (1990), 167-193",
    init=init,
    step=step,
)
