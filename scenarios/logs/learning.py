"""What is wrong with the odometry of a laser log, as its own scans show."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from scenarios.logs.odometry import increments
from scenarios.types import Source
from slam.motion import Odometry
from slam.perception.odometry import worth_matching
from slam.perception.odometry_noise import OdometryNoise, odometry_noise
from slam.types import Noise

Origin = Literal["scans", "guess", "given"]
"""Of what is believed of an odometry: its log shows it, or shows too little of it, or somebody said so."""

GOOD = (
    "{}: its odometry is as good as scan matching (its heading is {:.2g} rad off after a metre), so "
    "--matching auto does not match scans; --matching on does"
)


def with_learned_odometry(source: Source) -> Source:
    """The source with the noise of odometry that some hundred of its scans show, matched with each other.

    For a laser log, before keyframes are chosen.  `Noise.odometry` is then the deviation ahead after one metre, and the
    motion model of each frame has the others.
    """
    scans = [step.frame.scan for step in source.steps if step.frame.scan is not None]
    if source.scans is None or len(scans) < 2:
        return source
    found = odometry_noise(scans, increments(source.scans.odometry[source.scans.kept]))
    motion = Odometry(
        turn_per_metre=found.turn_per_metre / found.along,
        turn_per_radian=found.turn_per_radian / found.along,
        lateral=found.lateral / found.along,
        slip=found.slip / found.along,
        walk=True,
    )
    noise = replace(source.noise, odometry=found.along)
    told = () if worth_matching(motion, noise) else (GOOD.format(source.name, found.turn_per_metre),)
    return replace(
        source,
        motion=motion,
        noise=noise,
        warnings=(*source.warnings, *told),
        steps=tuple(step._replace(frame=step.frame._replace(motion=motion)) for step in source.steps),
    )


def odometry_believed(motion: Any, believed: Noise) -> OdometryNoise | None:
    """What is believed to be wrong with an odometry whose noise was learned; None of any other."""
    if not isinstance(motion, Odometry) or not motion.walk:
        return None
    return OdometryNoise(
        along=believed.odometry,
        lateral=believed.odometry * motion.lateral,
        slip=believed.odometry * motion.slip,
        turn_per_metre=believed.odometry * motion.turn_per_metre,
        turn_per_radian=believed.odometry * motion.turn_per_radian,
    )


def origin_of_belief(source: Source, believed: Noise) -> Origin:
    """Where `odometry_believed` comes from, of a source whose odometry has it."""
    if believed.odometry != source.noise.odometry:
        return "given"
    guess, found = odometry_noise([], np.zeros((0, 3))), odometry_believed(source.motion, believed)
    return "guess" if found is not None and np.allclose(found, guess) else "scans"
