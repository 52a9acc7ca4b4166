"""What the studies of walls have in common: what may be changed in the filters and in the world."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, get_args

from tyro.conf import OmitArgPrefixes

from app import values
from app.options import BelievedNoise, FilterOptions, WorldNoise, default, parameters
from app.study.output import JobsOption, OutOption, SeedOption
from scenarios.floorplan import DoorKind
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
    merge_walls: bool = False
    """Unknown association: two walls of a particle's map become one where something seen lies along both."""
    most_new: Annotated[int | None, values.whole("--most-new", "N", PARAMS["most_new"]), _OWN] = None
    """So many new walls at the most from one scan, the best ones; 0 is no limit."""


@dataclass(frozen=True)
class WallStudy:
    """The options that every study of corridors has."""

    doors: Annotated[str, values.choice("--doors", get_args(DoorKind))] = "closed"
    """The doors of the corridor."""
    seed: SeedOption = 0
    """The first seed."""
    jobs: JobsOption = None
    """Processes; results do not depend on it."""
    out: OutOption = None
    """What the tables show, and every single run."""
    tuning: OmitArgPrefixes[Tuning] = field(default_factory=Tuning)
    noise: WorldNoise = field(default_factory=WorldNoise)


def settings(filters: Iterable[str], particles: Iterable[int]) -> list[tuple[str, int]]:
    """Every filter with every number of particles; EKF-SLAM has one."""
    return [(key, K) for key in filters for K in (dict.fromkeys(particles) if key != "ekf" else (1,))]


def tuned(source: Source, tuning: Tuning, particles: int, noise: WorldNoise) -> tuple[Noise, Params]:
    """What the world is, and the filters' parameters, which believe it."""
    return parameters(source, FilterOptions(particles=particles, **vars(tuning)), noise, BelievedNoise())
