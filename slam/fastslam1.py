"""FastSLAM 1.0: the particle filter runs over paths, proposed from the controls alone; each feature has its EKF."""

from __future__ import annotations

import numpy as np

from slam.association import associate
from slam.phases import (
    add_features,
    draw_pose,
    extend_features,
    initial,
    matched_features,
    merge_features,
    miss_density,
    noise_of_known,
    observation_noise,
    predict_by_sampling,
    resample_if_needed,
    resize,
    reweigh,
    update_features,
)
from slam.types import Estimator, Frame, Params, Particles, Trace


def step(rng: np.random.Generator, particles: Particles, frame: Frame, params: Params) -> tuple[Particles, Trace]:
    """One observing step: draw the pose, associate, update the map, weigh, resample."""
    particles, resized = resize(rng, particles, params)
    R = observation_noise(frame, params)
    R_known = noise_of_known(frame, R, params)

    if particles.P.any():
        particles = draw_pose(rng, particles)  # an uncertain start
    predicted = predict_by_sampling(rng, particles, frame, params.believed)  # (11)
    n = associate(predicted, frame, R_known, params)  # (23, 25-27), 4.2
    miss = miss_density(params, n)
    matched = matched_features(predicted.maps, n)
    updated, weighed = update_features(predicted, frame, matched, R_known, miss)  # its innovations are the weight
    log_p = params.temper * weighed.log_p
    weighted, events = reweigh(updated, log_p)
    mapped, n, merged = merge_features(weighted, frame, n, R_known, params)  # two walls that are one
    mapped = extend_features(mapped, frame, n)  # 4.1
    mapped = add_features(mapped, frame, n, R)  # (33)
    resampled, selected, n_eff, did = resample_if_needed(rng, mapped, params)  # (44)

    weighted = weighted._replace(maps=mapped.maps)
    return resampled, Trace(
        predicted, weighted, resampled, n, log_p, params.temper, weighed.innovations,
        n_eff, did, resized, selected, events, merged,
    )  # fmt: skip


FASTSLAM1 = Estimator(
    key="fs1",
    title="FastSLAM 1.0",
    reference="Montemerlo, Thrun, Koller, Wegbreit, AAAI 2002, 593-598",
    init=initial,
    step=step,
)
