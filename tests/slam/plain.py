"""FastSLAM 1.0, FastSLAM 2.0 and Dual FastSLAM once more, as plainly as they can be written, and the world they are
tried in.

An oracle for `slam`: one particle is one simple object, maps are dictionaries, matrices are NumPy's, inverses are
inverses, association is known.  Nothing here calls `slam.phases`, `slam.linalg`, a feature kind or a motion model.

Random numbers are drawn from the same generator in the same order as the filters of `slam` draw them:

    FastSLAM 1.0   (K, 3) normals for the poses, if the start is uncertain;
                   (K, T, 2) normals, particle by particle and tick by tick, (speed, turn)
    FastSLAM 2.0   (K, 3) normals for the poses
    Dual           (K, Z, 2) normals if any observation is of a new feature; those of known ones are thrown away
    all            one uniform number if they resample (systematic)

A normal n becomes a draw from N(mean, C) as mean + L n, L the lower Cholesky factor of C.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from slam.features import Point
from slam.motion import Unicycle
from slam.types import Floats, Frame, Ints, Noise, Params

# The models -----------------------------------------------------------------------------------------------------------


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def move(s: Floats, u: Floats, dt: float) -> Floats:
    """The exact arc of a unicycle, u = (v, w) with w not zero (5)."""
    v, w = u
    x, y, phi = s
    return np.array(
        [
            x + v / w * (math.sin(phi + w * dt) - math.sin(phi)),
            y + v / w * (math.cos(phi) - math.cos(phi + w * dt)),
            wrap(phi + w * dt),
        ]
    )


def move_jacobians(s: Floats, u: Floats, dt: float) -> tuple[Floats, Floats]:
    """H_s (3, 3) and H_u (3, 2) of `move`."""
    v, w = u
    phi, after = s[2], s[2] + u[1] * dt
    along, across = math.sin(after) - math.sin(phi), math.cos(phi) - math.cos(after)
    H_s = np.eye(3)
    H_s[0, 2], H_s[1, 2] = -v / w * across, v / w * along
    H_u = np.array(
        [
            [along / w, v * dt / w * math.cos(after) - v / w**2 * along],
            [across / w, v * dt / w * math.sin(after) - v / w**2 * across],
            [0.0, dt],
        ]
    )
    return H_s, H_u


def observe(s: Floats, theta: Floats) -> Floats:
    """g: range and bearing of a point (45)."""
    dx, dy = theta - s[:2]
    return np.array([math.hypot(dx, dy), wrap(math.atan2(dy, dx) - s[2])])


def observe_jacobians(s: Floats, theta: Floats) -> tuple[Floats, Floats]:
    """G_s (2, 3) and G_theta (2, 2) of `observe` (24)."""
    dx, dy = theta - s[:2]
    r = math.hypot(dx, dy)
    G_theta = np.array([[dx / r, dy / r], [-dy / r**2, dx / r**2]])
    return np.hstack([-G_theta, [[0.0], [-1.0]]]), G_theta


def innovation(z: Floats, s: Floats, theta: Floats) -> Floats:
    """v = z - g(s, theta), the bearing on the circle (23)."""
    v = z - observe(s, theta)
    return np.array([v[0], wrap(v[1])])


def place(s: Floats, z: Floats) -> tuple[Floats, Floats, Floats]:
    """f: the point that an observation creates, F_s (2, 3) and F_z (2, 2) (33, 35)."""
    r, direction = z[0], s[2] + z[1]
    c, q = math.cos(direction), math.sin(direction)
    F_z = np.array([[c, -r * q], [q, r * c]])
    F_s = np.array([[1.0, 0.0, -r * q], [0.0, 1.0, r * c]])
    return np.array([s[0] + r * c, s[1] + r * q]), F_s, F_z


def log_gauss(v: Floats, V: Floats) -> float:
    """log N(v; 0, V)."""
    return -0.5 * (len(v) * math.log(2.0 * math.pi) + np.linalg.slogdet(V)[1] + v @ np.linalg.inv(V) @ v)


def kalman(P: Floats, v: Floats, G: Floats, R: Floats) -> tuple[Floats, Floats]:
    """The correction of a mean, and the new covariance, by an innovation v = z - g with Jacobian G and noise R."""
    V = G @ P @ G.T + R
    K = P @ G.T @ np.linalg.inv(V)
    return K @ v, P - K @ V @ K.T


# One particle, and what the filters do to it --------------------------------------------------------------------------

Seen = list[tuple[int, Floats]]
"""Observations with their tags."""


@dataclass
class Particle:
    s: Floats
    P: Floats
    log_w: float
    features: dict[int, tuple[Floats, Floats]] = field(default_factory=dict)
    """theta and Sigma by tag, in the order of creation."""


def moved_pose(s: Floats, delta: Floats) -> Floats:
    return np.array([s[0] + delta[0], s[1] + delta[1], wrap(s[2] + delta[2])])


def predicted(particle: Particle, frame: Frame, believed: Noise) -> Particle:
    """(21)"""
    s, P = particle.s, particle.P
    for u, dt in zip(frame.u, frame.dt, strict=True):
        H_s, H_u = move_jacobians(s, u, dt)
        s, P = move(s, u, dt), H_s @ P @ H_s.T + H_u @ np.diag([believed.speed**2, believed.turn**2]) @ H_u.T
    return replace(particle, s=s, P=P)


def corrected_pose(particle: Particle, seen: Seen, R: Floats) -> tuple[Particle, float]:
    """(28, 36) by every known feature in turn; also the log likelihood of all together, by the chain rule."""
    s, P, log_p = particle.s, particle.P, 0.0
    for tag, z in seen:
        theta, Sigma = particle.features[tag]
        v, (G_s, G_theta) = innovation(z, s, theta), observe_jacobians(s, theta)
        R_total = G_theta @ Sigma @ G_theta.T + R
        log_p += log_gauss(v, G_s @ P @ G_s.T + R_total)
        delta, P = kalman(P, v, G_s, R_total)
        s = moved_pose(s, delta)
    return replace(particle, s=s, P=P), log_p


def marginal_log_likelihood(particle: Particle, seen: Seen, R: Floats) -> float:
    """(43) to the letter: all innovations at the same pose, as if they were independent."""
    log_p = 0.0
    for tag, z in seen:
        theta, Sigma = particle.features[tag]
        G_s, G_theta = observe_jacobians(particle.s, theta)
        V = G_s @ particle.P @ G_s.T + G_theta @ Sigma @ G_theta.T + R
        log_p += log_gauss(innovation(z, particle.s, theta), V)
    return log_p


def corrected_features(particle: Particle, seen: Seen, R: Floats) -> tuple[Particle, float]:
    """An EKF for each known feature given the pose; also the log likelihood of the observations given the pose."""
    features, log_p = dict(particle.features), 0.0
    for tag, z in seen:
        theta, Sigma = features[tag]
        v, (_, G) = innovation(z, particle.s, theta), observe_jacobians(particle.s, theta)
        log_p += log_gauss(v, G @ Sigma @ G.T + R)
        delta, Sigma = kalman(Sigma, v, G, R)
        features[tag] = (theta + delta, Sigma)
    return replace(particle, features=features), log_p


def with_new_features(particle: Particle, new: Seen, R: Floats) -> Particle:
    """(33)"""
    features = dict(particle.features)
    for tag, z in new:
        theta, _, F_z = place(particle.s, z)
        features[tag] = (theta, F_z @ R @ F_z.T)
    return replace(particle, features=features)


def with_drawn_features(particle: Particle, new: list[tuple[int, Floats, Floats]], R: Floats) -> Particle:
    """(34) and (37), each new feature from the pose Gaussian that the ones before left; (tag, z, normals) each."""
    s, P, features = particle.s, particle.P, dict(particle.features)
    for tag, z, normal in new:
        mean, F_s, F_z = place(s, z)
        theta = mean + np.linalg.cholesky(F_s @ P @ F_s.T + F_z @ R @ F_z.T) @ normal
        features[tag] = (theta, np.zeros((2, 2)))
        delta, P = kalman(P, innovation(z, s, theta), observe_jacobians(s, theta)[0], R)
        s = moved_pose(s, delta)
    return replace(particle, s=s, P=P, features=features)


def drawn_pose(particle: Particle, normal: Floats) -> Particle:
    """(12)"""
    return replace(particle, s=moved_pose(particle.s, np.linalg.cholesky(particle.P) @ normal), P=np.zeros((3, 3)))


# The three filters ----------------------------------------------------------------------------------------------------


def start(s: Floats, P: Floats, K: int) -> list[Particle]:
    return [Particle(s.copy(), P.copy(), -math.log(K)) for _ in range(K)]


def step(
    key: str, rng: np.random.Generator, particles: list[Particle], frame: Frame, params: Params
) -> tuple[list[Particle], Ints]:
    """One observing step of `fs1`, `fs2` or `dfs`: the new particles and the indices of their parents."""
    R = np.diag([params.believed.range**2, params.believed.bearing**2])
    known_tags = set(particles[0].features)
    tagged = [(int(tag), z) for tag, z in zip(frame.tags, frame.z, strict=True)]
    seen = [(tag, z) for tag, z in tagged if tag in known_tags]
    new = [(tag, z) for tag, z in tagged if tag not in known_tags]
    one_step = {"fs1": fastslam1, "fs2": fastslam2, "dfs": dual_fastslam}[key]
    after, log_p = one_step(rng, particles, frame, params, seen, new, params.inflate_r * R, R)

    log_w = np.array([p.log_w for p in particles]) + params.temper * np.array(log_p)
    log_w -= log_w.max()
    log_w -= math.log(np.exp(log_w).sum())
    return resampled(rng, [replace(p, log_w=w) for p, w in zip(after, log_w, strict=True)], params.resample_below)


def fastslam1(
    rng: np.random.Generator, particles: list[Particle], frame: Frame, params: Params,
    seen: Seen, new: Seen, R_known: Floats, R: Floats,
) -> tuple[list[Particle], list[float]]:  # fmt: skip
    K, believed = len(particles), params.believed
    if particles[0].P.any():
        particles = [drawn_pose(p, n) for p, n in zip(particles, rng.standard_normal((K, 3)), strict=True)]
    noise = rng.standard_normal((K, *frame.u.shape)) * [believed.speed, believed.turn]
    after, log_p = [], []
    for particle, own_noise in zip(particles, noise, strict=True):
        s = particle.s
        for u, e, dt in zip(frame.u, own_noise, frame.dt, strict=True):
            s = move(s, u + e, dt)  # (11)
        particle, likelihood = corrected_features(replace(particle, s=s), seen, R_known)
        after.append(with_new_features(particle, new, R))
        log_p.append(likelihood)
    return after, log_p


def fastslam2(
    rng: np.random.Generator, particles: list[Particle], frame: Frame, params: Params,
    seen: Seen, new: Seen, R_known: Floats, R: Floats,
) -> tuple[list[Particle], list[float]]:  # fmt: skip
    after, log_p = [], []
    for particle, normal in zip(particles, rng.standard_normal((len(particles), 3)), strict=True):
        prior = predicted(particle, frame, params.believed)
        proposal, integrated = corrected_pose(prior, seen, R_known)
        drawn = drawn_pose(proposal, normal)
        updated, likelihood = corrected_features(drawn, seen, R_known)
        if params.proposal_weight == "drawn":
            # As the paper's baseline code has it: likelihood x prior / proposal, all at the drawn pose.
            log_p.append(likelihood + log_pose_density(drawn.s, prior) - log_pose_density(drawn.s, proposal))
        else:
            log_p.append(integrated)
        after.append(with_new_features(updated, new, R))
    return after, log_p


def log_pose_density(s: Floats, gaussian: Particle) -> float:
    away = s - gaussian.s
    return log_gauss(np.array([away[0], away[1], wrap(away[2])]), gaussian.P)


def dual_fastslam(
    rng: np.random.Generator, particles: list[Particle], frame: Frame, params: Params,
    seen: Seen, new: Seen, R_known: Floats, R: Floats,
) -> tuple[list[Particle], list[float]]:  # fmt: skip
    normals = rng.standard_normal((len(particles), len(frame.z), 2)) if new else None
    order = {int(tag): i for i, tag in enumerate(frame.tags)}
    after, log_p = [], []
    for k, particle in enumerate(particles):
        prior = predicted(particle, frame, params.believed)
        updated, likelihood = corrected_pose(prior, seen, R_known)
        if params.weighting == "marginal":
            likelihood = marginal_log_likelihood(prior, seen, R_known)
        after.append(with_drawn_features(updated, [(tag, z, normals[k, order[tag]]) for tag, z in new], R))
        log_p.append(likelihood)
    return after, log_p


def resampled(rng: np.random.Generator, particles: list[Particle], below: float) -> tuple[list[Particle], Ints]:
    """(44), systematic: equal strides through the weights laid end to end, from one random offset."""
    K = len(particles)
    w = np.array([math.exp(p.log_w) for p in particles])
    if 1.0 / sum(w**2) >= below * K:
        return particles, np.arange(K)
    parents, offset, cumulative, k = [], rng.random(), w[0], 0
    for i in range(K):
        while (i + offset) / K >= cumulative:
            k += 1
            cumulative += w[k]
        parents.append(k)
    return [replace(particles[k], log_w=-math.log(K)) for k in parents], np.array(parents)


def localise(s: Floats, P: Floats, frame: Frame, landmarks: Floats, believed: Noise) -> tuple[Floats, Floats, float]:
    """EKF localisation in a known map, tags being rows of `landmarks`: the pose, its covariance and log p(z)."""
    exact = {tag: (theta, np.zeros((2, 2))) for tag, theta in enumerate(landmarks)}
    particle = predicted(Particle(s, P, 0.0, exact), frame, believed)
    seen = [(int(tag), z) for tag, z in zip(frame.tags, frame.z, strict=True)]
    particle, log_p = corrected_pose(particle, seen, np.diag([believed.range**2, believed.bearing**2]))
    return particle.s, particle.P, log_p


# The world ------------------------------------------------------------------------------------------------------------


class World(NamedTuple):
    frames: list[Frame]
    truth: Floats
    """(steps + 1, 3) poses, from the start on."""
    landmarks: Floats
    """(N, 2); a tag is a row."""


WORLD_NOISE = Noise(speed=0.2, turn=0.1, range=0.1, bearing=0.02)


def simulate(
    seed: int, steps: int = 24, noise: Noise = WORLD_NOISE, ticks: int = 6, reach: float = 7.0, everything: bool = False
) -> World:
    """A robot on a circle of 4 m radius through a dozen landmarks, of which it sees what is within reach, in all
    directions.

    It turns once around in 25 steps, so headings and bearings cross +-pi.  `everything`: it sees all.
    """
    rng = np.random.default_rng(seed)
    angle = np.arange(12) * 2.0 * math.pi / 12
    radius = np.where(np.arange(12) % 2, 7.0, 1.8)
    landmarks = np.stack([radius * np.cos(angle), 4.0 + radius * np.sin(angle)], axis=1)
    s, dt = np.zeros(3), 0.1
    frames, truth = [], [s]
    for k in range(steps):
        u = np.tile([1.6, 0.4], (ticks, 1))
        for actual in u + [noise.speed, noise.turn] * rng.standard_normal(u.shape):
            s = move(s, actual, dt)
        z = np.array([observe(s, theta) for theta in landmarks])
        tags = np.flatnonzero((z[:, 0] < reach) | everything)
        tags = rng.permutation(tags)
        z = z[tags] + [noise.range, noise.bearing] * rng.standard_normal((len(tags), 2))
        z[:, 1] = [wrap(bearing) for bearing in z[:, 1]]
        frames.append(Frame((k + 1) * ticks * dt, Unicycle(), u, np.full(ticks, dt), Point(), z, tags))
        truth.append(s)
    return World(frames, np.array(truth), landmarks)
