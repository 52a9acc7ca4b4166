"""The measures that are plotted: their names in entity paths, their titles, and where they come from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from app.types import FilterUpdate
from scenarios.types import Source
from slam.metrics import nees_interval
from slam.types import UNKNOWN_TAG


class Metric(NamedTuple):
    """One measure of every filter: the series `/plots/<name>/<filter>`."""

    name: str
    title: str
    """Of the view, with the unit."""
    value: Callable[[FilterUpdate], float]
    needs: str = ""
    """What somebody must know for it to have a value: "truth" (of the position), "heading", "map" or "tags"."""
    population: bool = False
    """Says something about many particles: not shown of a filter that has one."""
    band: tuple[float, float] | None = None
    """Between these it is, of a consistent filter, in 95 of 100 cases."""


LONERS = frozenset({"ekf"})
"""Filters of one particle, whatever K is: of those there is no population to show."""

LOG_NEES_RANGE = (-2.0, 6.0)
LOG_COMPONENT_RANGE = (-3.5, 6.0)
"""Of the position, and of one component, whose band reaches further down."""


def log_nees(value: float, plotted: tuple[float, float] = LOG_NEES_RANGE) -> float:
    """The logarithm that is plotted: infinity (a collapsed mixture) and zero lie on the border of the plot."""
    low, high = plotted
    if math.isnan(value):
        return value
    return min(max(math.log10(value) if value > 0.0 else low, low), high)


def _of_component(name: str, title: str, value: Callable[[FilterUpdate], float], needs: str) -> Metric:
    """The NEES of one component of the pose."""
    what = f"log₁₀ NEES of {title} (grey: 95 % band)"
    return Metric(name, what, lambda u: log_nees(value(u), LOG_COMPONENT_RANGE), needs, band=_log_band(1))


def _log_band(freedom: int) -> tuple[float, float]:
    """Of the logarithm of a NEES with so many degrees of freedom."""
    low, high = nees_interval(freedom)
    return math.log10(low), math.log10(high)


METRICS = (
    Metric("n_eff", "N_eff [particles] (grey: resampling below)", lambda u: u.measures.n_eff, population=True),
    Metric("diversity", "Diversity [share of founders left]", lambda u: u.measures.diversity, population=True),
    Metric("nees", "NEES of the position", lambda u: u.measures.nees_position, needs="truth", band=nees_interval(2)),
    Metric(
        "nees_log10",
        "log₁₀ NEES of the position (grey: 95 % band; at the top: infinite)",
        lambda u: log_nees(u.measures.nees_position),
        needs="truth",
        band=_log_band(2),
    ),
    _of_component("nees_x_log10", "x", lambda u: u.evidence.numbers.nees_x, "truth"),
    _of_component("nees_y_log10", "y", lambda u: u.evidence.numbers.nees_y, "truth"),
    _of_component("nees_heading_log10", "the heading", lambda u: u.evidence.numbers.nees_heading, "heading"),
    Metric("position_error", "Position error [m]", lambda u: u.measures.position_error_m, needs="truth"),
    Metric("spread", "Deviation of the position that the filter reports [m]", lambda u: u.evidence.numbers.spread_m),
    Metric(
        "monte_carlo",
        "Deviation of the estimate by the luck of the particles [m] (while founders tell)",
        lambda u: u.evidence.numbers.monte_carlo_m,
        population=True,
    ),
    Metric(
        "heading_error",
        "Heading error [degrees]",
        lambda u: math.degrees(u.measures.heading_error_rad),
        needs="heading",
    ),
    Metric("map_error", "Map error, aligned [m]", lambda u: u.measures.map_error_m, needs="map"),
    Metric(
        "weight_deviation",
        "Deviation of the log weights that a step adds",
        lambda u: u.evidence.numbers.deviation,
        population=True,
    ),
    Metric(
        "first_share",
        "Share of ranges, or lateral offsets, in their variance",
        lambda u: u.evidence.numbers.first,
        population=True,
    ),
    Metric(
        "inside",
        "Share of the particles that the likelihood reaches",
        lambda u: u.evidence.numbers.inside,
        population=True,
    ),
    Metric(
        "proposal_width",
        "Spread of what particles expect to see, over the deviation that each expects",
        lambda u: max(u.evidence.numbers.wide_first, u.evidence.numbers.wide_second),
        population=True,
    ),
    Metric(
        "nis_first",
        "Squared innovations over their expectation (1): ranges, lateral offsets",
        lambda u: u.evidence.numbers.nis_first,
    ),
    Metric(
        "nis_second",
        "The same of bearings, angles",
        lambda u: u.evidence.numbers.nis_second,
    ),
    Metric("features", "Features in the best map", lambda u: float(u.measures.features)),
    Metric("duplicates", "Duplicate features in the best map", lambda u: float(u.measures.duplicates), needs="tags"),
    Metric(
        "common_ancestor",
        "Age of the common ancestor [steps]",
        lambda u: u.measures.common_ancestor_age,
        population=True,
    ),
    Metric("update_ms", "Time of a step [ms]", lambda u: 1e3 * u.seconds),
)


def known_of(source: Source, steps: int) -> frozenset[str]:
    """Of what `Metric.needs` names, what is known of the first steps of a source."""
    poses = [step.truth for step in source.steps[:steps] if step.truth is not None]
    what = {
        "truth": any(np.isfinite(pose[:2]).all() for pose in poses),
        "heading": any(np.isfinite(pose).all() for pose in poses),
        "map": source.true_map is not None,
        "tags": any((step.frame.tags != UNKNOWN_TAG).any() for step in source.steps[:steps]),
    }
    return frozenset(name for name, is_known in what.items() if is_known)


BY_NAME = {metric.name: metric for metric in METRICS}


def populations(keys: Iterable[str]) -> list[str]:
    """The filters whose weights and ancestry are worth a picture; all, if none is."""
    keys = list(keys)
    return [k for k in keys if k not in LONERS] or keys
