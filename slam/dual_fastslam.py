"""Dual FastSLAM: the particle filter runs over maps, and each particle tracks the pose with a Kalman filter.

It differs from FastSLAM 2.0 in two lines: the pose is not drawn, and new features are.
"""

from __future__ import annotations

import numpy as np

from slam.association import associate
from slam.phases import (
    draw_features,
    extend_features,
    initial,
    matched_features,
    merge_features,
    miss_density,
    noise_of_known,
    observation_noise,
    predict,
    resample_if_needed,
    resize,
    reweigh,
    update_pose,
    weigh_marginal,
)
from slam.types import Estimator, Frame, Params, Particles, Trace


def step(rng: np.random.Generator, particles: Particles, frame: Frame, params: Params) -> tuple[Particles, Trace]:
    """One observing step: predict, associate, weigh, correct the pose, draw what is new, resample."""
    particles, resized = resize(rng, particles, params)
    R = observation_noise(frame, params)
    R_known = noise_of_known(frame, R, params)

    predicted = predict(particles, frame, params.believed)  # (21)
    n = associate(predicted, frame, R_known, params)  # (23, 25-27), 4.2
    miss = miss_density(params, n)
    matched = matched_features(predicted.maps, n)  # known features: the map is static (29, 30)
    updated, weighed = update_pose(predicted, frame, matched, R_known, miss)  # (28, 36): no draw
    if params.weighting == "marginal":
        weighed = weigh_marginal(predicted, frame, matched, R_known, miss)  # (43), at the predicted pose
    log_p = params.temper * weighed.log_p
    weighted, events = reweigh(updated, log_p)
    mapped, n, merged = merge_features(weighted, frame, n, R_known, params)  # two walls that are one
    mapped = extend_features(mapped, frame, n)  # 4.1
    mapped = draw_features(rng, mapped, frame, n, R)  # (34, 37)
    resampled, selected, n_eff, did = resample_if_needed(rng, mapped, params)  # (44)

    weighted = weighted._replace(maps=mapped.maps)
    return resampled, Trace(
        predicted, weighted, resampled, n, log_p, params.temper, weighed.innovations,
        n_eff, did, resized, selected, events, merged,
    )  # fmt: skip


DUAL_FASTSLAM = Estimator(
    key="dfs",
    title="Dual FastSLAM",
    reference="Rodriguez-Losada, San Segundo, Matia, Pedraza, J. Intell. Robot. Syst. 55 (2009) 109-134",
    init=initial,
    step=step,
)
