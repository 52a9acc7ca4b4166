"""What the studies of walls let be changed in the filters, and what the world then is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, get_args

from app import values
from app.options import BelievedNoise, FilterOptions, WorldNoise, default, parameters
from scenarios.types import Source
from slam.limits import PARAMS
from slam.types import AssociationName, Noise, Params, WeightingName

_OWN = default("the world's own")


@dataclass(frozen=True)
class Tuning:
    """What is not given is the world's own."""

    association: Annotated[str | None, values.choice("--association", get_args(AssociationName)), _OWN] = None
    """Which wall is it: told by its tag, the nearest, or jointly compatible."""
    weighting: Annotated[str | None, values.choice("--weighting", get_args(WeightingName)), _OWN] = None
    """Dual FastSLAM: how several observations weigh."""
    inflate_r: Annotated[float | None, values.real("--inflate-r", "X", PARAMS["inflate_r"]), _OWN] = None
    """Factor on R for known walls."""
    temper: Annotated[float | None, values.real("--temper", "X", PARAMS["temper"]), _OWN] = None
    """Exponent on the likelihood of an observation."""
    floor_lateral: Annotated[float | None, values.real("--floor-lateral", "M", PARAMS["floor_lateral"]), _OWN] = None
    """Deviation that a known wall is allowed, added to R."""
    floor_angle: Annotated[float | None, values.real("--floor-angle", "DEG", PARAMS["floor_angle"]), _OWN] = None
    """The same of its angle."""


def tuned(source: Source, tuning: Tuning, particles: int, noise: WorldNoise) -> tuple[Noise, Params]:
    """What the world is, and the filters' parameters, which believe it."""
    return parameters(source, FilterOptions(particles=particles, **vars(tuning)), noise, BelievedNoise())
