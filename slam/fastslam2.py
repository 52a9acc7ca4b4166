"""FastSLAM 2.0: the particle filter runs over paths, with the observation in the proposal; each feature has its EKF."""

from __future__ import annotations

import numpy as np

from slam.association import associate
from slam.phases import (
    UNWEIGHED,
    add_features,
    draw_pose,
    extend_features,
    initial,
    linearised_at,
    matched_features,
    merge_features,
    miss_density,
    noise_of_known,
    observation_noise,
    predict,
    resample_if_needed,
    resize,
    reweigh,
    update_features,
    update_pose,
)
from slam.types import Estimator, Frame, Params, Particles, Trace


def step(rng: np.random.Generator, particles: Particles, frame: Frame, params: Params) -> tuple[Particles, Trace]:
    """One observing step: predict, associate, weigh, correct the pose, draw it, update the map, resample."""
    particles, resized = resize(rng, particles, params)
    R = observation_noise(frame, params)
    R_known = noise_of_known(frame, R, params)

    predicted = predict(particles, frame, params.believed)  # (21)
    n = associate(predicted, frame, R_known, params)  # (23, 25-27), 4.2
    miss = miss_density(params, n)
    matched = matched_features(predicted.maps, n)
    updated, weighed = update_pose(predicted, frame, matched, R_known, miss)  # the proposal; its weight (14)
    drawn = draw_pose(rng, updated)  # (12)
    mapped, of_drawn = update_features(drawn, frame, matched, R_known, UNWEIGHED)
    log_p = weighed.log_p
    if params.proposal_weight == "drawn":
        log_p = log_p + of_drawn.log_p - linearised_at(predicted, frame, matched, R_known, drawn)
    log_p = params.temper * log_p
    mapped, events = reweigh(mapped, log_p)
    mapped, n, merged = merge_features(mapped, frame, n, R_known, params)  # two walls that are one
    mapped = extend_features(mapped, frame, n)  # 4.1
    mapped = add_features(mapped, frame, n, R)  # (33)
    resampled, selected, n_eff, did = resample_if_needed(rng, mapped, params)  # (44)

    weighted = updated._replace(log_w=mapped.log_w, maps=mapped.maps)
    return resampled, Trace(
        predicted, weighted, resampled, n, log_p, params.temper, weighed.innovations,
        n_eff, did, resized, selected, events, merged,
    )  # fmt: skip


FASTSLAM2 = Estimator(
    key="fs2",
    title="FastSLAM 2.0",
    reference="Montemerlo, Thrun, Koller, Wegbreit, IJCAI 2003, 1151-1156",
    init=initial,
    step=step,
)
