"""The classic mistakes, to be put into a filter on purpose and seen by what they do.

    with_mistake(FASTSLAM2, "shared-maps") -> Estimator

The filters know nothing of this.  A filter with a mistake is its own `step`, word for word, with one or two phases
exchanged for wrong ones (`pieces`), or with a feature kind that is wrong (`unwrapped`): what it reports in `Trace` is
what such a program would report.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np

from slam.mistakes import pieces
from slam.mistakes.unwrapped import unwrapped
from slam.types import Estimator, Frame, Params, Particles, Trace

Phases = Mapping[str, Callable[..., Any]]
"""What stands in the place of phases, by their names in `slam.phases`."""


class Mistake(NamedTuple):
    """One way to get a filter wrong."""

    name: str
    what: str
    """In one sentence."""
    signature: str
    """By what it shows in the numbers of a filter."""
    phases: Mapping[str, Phases]
    """By the key of each filter that one can make it in, what is exchanged."""
    feature: Callable[[Any], Any] | None = None
    """Of the feature kind, if that is what is wrong."""

    @property
    def told(self) -> str:
        """What is wrong, and what shows it."""
        return f"{self.what} What shows it: {self.signature}"


_SHARED: Phases = {
    "update_features": pieces.update_shared_features,
    "extend_features": pieces.extend_shared_features,
    "add_features": pieces.add_shared_features,
}
_KEPT: Phases = {"resample_if_needed": pieces.keep_weights, "resize": pieces.resize_and_keep_weights}


def _everywhere(phases: Phases) -> Mapping[str, Phases]:
    return dict.fromkeys(("dfs", "fs2", "fs1"), phases)


_ALL = (
    Mistake(
        "shared-maps",
        "Copies of a particle refer to one and the same map: what one of them writes, all of them have.",
        "A map gains more features than its particle found new, or particles at different poses have corrected a "
        "feature to the very same numbers.",
        {
            "dfs": {
                "extend_features": pieces.extend_shared_features,
                "draw_features": pieces.draw_shared_features,
            },
            "fs2": _SHARED,
            "fs1": _SHARED,
        },
    ),
    Mistake(
        "weights-not-reset",
        "After a resampling the copies keep the weight for which they were copied, so that it counts again.",
        "The weights after a resampling are not equal.",
        _everywhere(_KEPT),
    ),
    Mistake(
        "plain-weights",
        "Weights are products of plain densities, which underflow to zero where the sensor is accurate.",
        "Weights are zero, or all alike, where log weight and log likelihood say otherwise.",
        _everywhere({"reweigh": pieces.multiply_densities}),
    ),
    Mistake(
        "unwrapped-angles",
        "The difference of two angles is not brought back between -180 and 180 degrees.",
        "The angle of an innovation is beyond 180 degrees, or what is plainly within the gate is not matched.",
        _everywhere({}),
        unwrapped,
    ),
    Mistake(
        "unsampled-proposal",
        "What is to be sampled is put at its mean: the pose in FastSLAM, new features in Dual FastSLAM.",
        "Most of what should be draws is exactly its mean.",
        {
            "dfs": {"draw_features": pieces.take_mean_features},
            "fs2": {"draw_pose": pieces.take_mean_pose},
            "fs1": {"predict_by_sampling": pieces.predict_without_sampling, "draw_pose": pieces.take_mean_pose},
        },
    ),
    Mistake(
        "features-first",
        "Features are corrected before the pose is, so that the pose is corrected on what has seen the observation "
        "already.",
        "Innovations are those of features as they are after the step, not before it.",
        {"fs2": {"update_pose": pieces.update_features_then_pose, "update_features": pieces.leave_features}},
    ),
    Mistake(
        "resample-always",
        "Particles are resampled at every step, whether or not their weights differ.",
        "Resampled although N_eff was not below the threshold.",
        _everywhere({"resample_if_needed": pieces.resample_always}),
    ),
    Mistake(
        "keep-first",
        "The resampler never drops the first particle, whatever its weight.",
        "The first particle is in a place that the resampling scheme gives to another one, or outlives more "
        "resamplings than its weights give it a chance to.",
        _everywhere({"resample_if_needed": pieces.resample_and_keep_first}),
    ),
)

MISTAKES: dict[str, Mistake] = {mistake.name: mistake for mistake in _ALL}


def with_mistake(estimator: Estimator, name: str) -> Estimator:
    """The filter with a mistake, which its title tells; ValueError for a filter that one cannot make it in."""
    mistake = MISTAKES[name]
    if estimator.key not in mistake.phases:
        raise ValueError(f"{name} is no mistake of {estimator.title}")
    step: Any = _with_phases(estimator.step, mistake.phases[estimator.key])
    if mistake.feature is not None:
        step = _with_feature(step, mistake.feature)
    return estimator._replace(title=f"{estimator.title} ({name})", step=step)


def _with_phases(step: Any, phases: Phases) -> Any:
    """The same function, to which some names mean something else; the function itself stays what it is."""
    for name in phases:
        if name not in step.__code__.co_names:
            raise ValueError(f"{step.__module__}.step has no phase {name}")
    return FunctionType(step.__code__, {**step.__globals__, **phases}, step.__name__)


def _with_feature(step: Any, feature: Callable[[Any], Any]) -> Any:
    def mistaken(rng: np.random.Generator, particles: Particles, frame: Frame, params: Params) -> tuple[Any, Trace]:
        return step(rng, particles, frame._replace(feature=feature(frame.feature)), params)

    return mistaken
