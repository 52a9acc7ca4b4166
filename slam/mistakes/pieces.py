"""Phases that are wrong, each in one way, with the arguments and results of the right one (`slam.phases`)."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, cast

import numpy as np

from slam.phases import (
    UNWEIGHED,
    Matched,
    Miss,
    Weighed,
    add_features,
    draw_features,
    draw_pose,
    extend_features,
    matched_features,
    predict_by_sampling,
    resample_if_needed,
    resize,
    select,
    unweighed,
    update_features,
    update_pose,
)
from slam.resampling import normalise
from slam.types import IGNORED, Floats, Frame, Ints, Noise, ObservationNoise, Params, Particles

# Maps that are shared -------------------------------------------------------------------------------------------------


def turns(lineage: Ints) -> tuple[Ints, Ints]:
    """Who writes when, if particles of one lineage (K,) have one map between them.

    Also for each particle the number of its map, of G: the particles (turns, G) that have their turn at the same time,
    one for each map, or -1 for none.  Copies of a particle refer to its map, copies of copies to the same one: so the
    map is that which their ancestor at time zero was given.
    """
    _, of = np.unique(lineage, return_inverse=True)
    order = np.argsort(of, kind="stable")
    sizes = np.bincount(of)
    turn = np.arange(len(of)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    rows = np.full((int(sizes.max()), len(sizes)), -1)
    rows[turn, of[order]] = order
    return of, rows


class _Sharing:
    """The particles of a phase, one after the other on maps of which there is one for each lineage."""

    def __init__(self, particles: Particles, n: Ints) -> None:
        self._n = n
        self._of, self._turns = turns(particles.lineage)
        self._s, self._P = particles.s.copy(), particles.P.copy()
        self._particles = particles
        self._maps = particles.maps.select(self._turns[0])

    def __iter__(self) -> Any:
        """For each turn the particles that have it, with the maps as those before have left them, and their n; and who
        they are, with -1 for a map that nobody is left to write into."""
        for rows in self._turns:
            s, P, log_w, lineage, _ = self._particles
            n = np.where((rows >= 0)[:, None], self._n[rows], IGNORED)
            yield Particles(s[rows], P[rows], log_w[rows], lineage[rows], self._maps), n, rows

    def put(self, rows: Ints, written: Particles) -> None:
        """What those that had their turn have made of their poses and of the maps."""
        there = rows >= 0
        self._s[rows[there]], self._P[rows[there]] = written.s[there], written.P[there]
        self._maps = written.maps

    def result(self) -> Particles:
        """All particles after their turns."""
        return self._particles._replace(s=self._s, P=self._P, maps=self._maps.select(self._of))


def update_shared_features(
    particles: Particles, frame: Frame, matched: Matched, R: ObservationNoise, miss: Miss
) -> tuple[Particles, Weighed]:
    """Each particle corrects features that its copies have corrected already, with the same observation."""
    sharing, weighed = _Sharing(particles, matched.n), unweighed(matched.n)
    for some, n, rows in sharing:
        written, of_some = update_features(some, frame, matched_features(some.maps, n), R, miss)
        sharing.put(rows, written)
        there = rows >= 0
        weighed.log_p[rows[there]] = of_some.log_p[there]
        for whole, part in zip(weighed.innovations, of_some.innovations, strict=True):
            whole[rows[there]] = part[there]
    return sharing.result(), weighed


def add_shared_features(particles: Particles, frame: Frame, n: Ints, R: ObservationNoise) -> Particles:
    """Each particle adds what is new to it to the map of all its copies."""
    sharing = _Sharing(particles, n)
    for some, its_n, rows in sharing:
        sharing.put(rows, add_features(some, frame, its_n, R))
    return sharing.result()


def draw_shared_features(
    rng: np.random.Generator, particles: Particles, frame: Frame, n: Ints, R: ObservationNoise
) -> Particles:
    """The same of Dual FastSLAM."""
    sharing = _Sharing(particles, n)
    for some, its_n, rows in sharing:
        sharing.put(rows, draw_features(rng, some, frame, its_n, R))
    return sharing.result()


def extend_shared_features(particles: Particles, frame: Frame, n: Ints) -> Particles:
    """Each particle extends the walls of all its copies."""
    sharing = _Sharing(particles, n)
    for some, its_n, rows in sharing:
        sharing.put(rows, extend_features(some, frame, its_n))
    return sharing.result()


# Weights and resampling -----------------------------------------------------------------------------------------------


def keep_weights(rng: np.random.Generator, particles: Particles, params: Params) -> tuple[Particles, Ints, float, bool]:
    """Copies keep the weight for which they were copied: it counts twice."""
    resampled, ancestors, n_eff, did = resample_if_needed(rng, particles, params)
    return _with_old_weights(resampled, particles, ancestors), ancestors, n_eff, did


def resize_and_keep_weights(rng: np.random.Generator, particles: Particles, params: Params) -> tuple[Particles, Ints]:
    """The same of a change of the number of particles."""
    resized, ancestors = resize(rng, particles, params)
    return _with_old_weights(resized, particles, ancestors), ancestors


def _with_old_weights(resampled: Particles, particles: Particles, ancestors: Ints) -> Particles:
    return resampled._replace(log_w=normalise(particles.log_w[ancestors])[0])


def multiply_densities(particles: Particles, log_likelihood: Floats) -> tuple[Particles, tuple[str, ...]]:
    """w := w prod_i p(z_i) in plain numbers, which end at 5e-324; where nothing is left all are made equal, and nobody
    is told."""
    with np.errstate(over="ignore", under="ignore", divide="ignore", invalid="ignore"):
        w = np.exp(particles.log_w) * np.exp(log_likelihood).prod(axis=1)
        total = float(w.sum())
        log_w = np.log(w / total)
    if not 0.0 < total < math.inf:
        log_w = np.full(len(w), -math.log(len(w)))
    return particles._replace(log_w=log_w), ()


def resample_always(
    rng: np.random.Generator, particles: Particles, params: Params
) -> tuple[Particles, Ints, float, bool]:
    """Whatever N_eff is."""
    return resample_if_needed(rng, particles, dataclasses.replace(params, resample_below=1.0))


def resample_and_keep_first(
    rng: np.random.Generator, particles: Particles, params: Params
) -> tuple[Particles, Ints, float, bool]:
    """The first place is not filled anew: the particle in it lives on, whatever its weight."""
    resampled, ancestors, n_eff, did = resample_if_needed(rng, particles, params)
    if did:
        ancestors = np.concatenate([[0], ancestors[1:]])
        resampled = select(particles, ancestors)
    return resampled, ancestors, n_eff, did


# Proposals ------------------------------------------------------------------------------------------------------------


class _Unused:
    """A generator whose normal numbers nobody adds: they are drawn, so that all others are those of the right run."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def standard_normal(self, shape: Any) -> Floats:
        """Zeros."""
        return np.zeros_like(self._rng.standard_normal(shape))


def _unused(rng: np.random.Generator) -> np.random.Generator:
    return cast(np.random.Generator, _Unused(rng))


def predict_without_sampling(
    rng: np.random.Generator, particles: Particles, frame: Frame, believed: Noise
) -> Particles:
    """FastSLAM 1.0: every particle moves as the controls say."""
    return predict_by_sampling(_unused(rng), particles, frame, believed)


def take_mean_pose(rng: np.random.Generator, particles: Particles) -> Particles:
    """The mean of the pose Gaussian instead of a draw from it."""
    return draw_pose(_unused(rng), particles)


def take_mean_features(
    rng: np.random.Generator, particles: Particles, frame: Frame, n: Ints, R: ObservationNoise
) -> Particles:
    """Dual FastSLAM: new features are frozen where they were seen."""
    return draw_features(_unused(rng), particles, frame, n, R)


# The order ------------------------------------------------------------------------------------------------------------


def update_features_then_pose(
    particles: Particles, frame: Frame, matched: Matched, R: ObservationNoise, miss: Miss
) -> tuple[Particles, Weighed]:
    """FastSLAM 2.0: features are corrected at the predicted pose, and the pose then on what they have become."""
    particles, _ = update_features(particles, frame, matched, R, UNWEIGHED)
    return update_pose(particles, frame, matched_features(particles.maps, matched.n), R, miss)


def leave_features(
    particles: Particles, frame: Frame, matched: Matched, R: ObservationNoise, miss: Miss
) -> tuple[Particles, Weighed]:
    """They have been corrected before; what they say of the drawn pose is as ever."""
    return particles, update_features(particles, frame, matched, R, miss)[1]
