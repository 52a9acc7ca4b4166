"""How a recording opens in any Rerun viewer: which views there are, where, and what they show."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from app import colours
from app.recording.charts import HEIGHT, LEFT, WIDTH
from app.recording.ground import Extent
from app.recording.metrics import BY_NAME, LOG_NEES_RANGE, Metric, populations
from app.recording.scene import CLOSE_HEIGHT, nice
from slam.types import Estimator, Floats

MAP_ASPECT = 1.8
"""Width over height of the map view, at the usual 16:9 of a window."""

BACKGROUND = colours.BACKGROUND

ON_DEMAND = "associations"
"""What of a filter no view shows until somebody wants to see it."""


def layout(filters: Sequence[Estimator], extent: Extent, known: frozenset[str], legend: str) -> rrb.Blueprint:
    """The window: the map with a close-up for each filter on the left, plots and pages on the right.

    `known` is what somebody knows (`metrics.known_of`), `legend` what the title of a map says of features.
    """
    oriented = "heading" in known
    together = rrb.Vertical(
        _map_view(_legend(filters) + legend, extent, filters),
        rrb.Horizontal(*(_close_up(f, "focus", f.title, oriented) for f in filters)),
        row_shares=[5, 3],
        name="All filters",
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Tabs(together, *(_of_one(f, extent, oriented, legend) for f in filters), active_tab=0),
            rrb.Vertical(_plots(filters, known), _pages(filters), row_shares=[3, 2]),
            column_shares=[8, 5],
        ),
        rrb.TimePanel(state="collapsed", timeline="step", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _of_one(estimator: Estimator, extent: Extent, oriented: bool, legend: str) -> rrb.Container:
    """The tab of one filter: its map with lineages and all hypotheses, its particles, and the best one of them."""
    title = estimator.title
    named = f"{title}: map, all surviving paths, the maps of all particles{legend}"
    return rrb.Vertical(
        _map_view(named, extent, [estimator], whole=True),
        rrb.Horizontal(
            _close_up(estimator, "focus", f"{title}: particles", oriented),
            _close_up(estimator, "best", f"{title}: the best particle", oriented),
        ),
        row_shares=[5, 3],
        name=title,
    )


def _legend(filters: Sequence[Estimator]) -> str:
    named = ", ".join(f"{f.title} {colours.word(f.key)}" for f in filters)
    return f"Map: {named}, truth white, dead reckoning grey"


def _map_view(name: str, extent: Extent, filters: Sequence[Estimator], whole: bool = False) -> rrb.Spatial3DView:
    """Seen from straight above.  What would crowd the map is there, but switched off: with several filters, much."""
    grid = nice(extent.size / 12)
    roots = [f"/world/{f.key}" for f in filters]
    crowd = (ON_DEMAND,) if whole else ("maps", "lineages", "ellipses", ON_DEMAND)
    frames = [f"- {root}/{frame}/**" for root in roots for frame in ("focus", "best")]
    return rrb.Spatial3DView(
        name=f"{name}; grid {grid:g} m",
        origin="/world",
        contents=[*_surroundings(), *(f"+ {root}/**" for root in roots), *frames],
        overrides={f"{root}/{what}": rrb.EntityBehavior(visible=False) for root in roots for what in crowd},
        background=BACKGROUND,
        line_grid=_grid(grid),
        eye_controls=_eye(extent.centre, extent.eye_height(MAP_ASPECT)),
    )


def _close_up(estimator: Estimator, frame: str, name: str, oriented: bool) -> rrb.Spatial3DView:
    """The frame moves and scales with the particles, so that a fixed eye always has them in sight.

    Observations are shown only if a true pose tells where they were made: drawn from the estimate of one filter, they
    would look wrong beside the particles of another.
    """
    root = f"/world/{estimator.key}"
    other = {"focus": "best", "best": "focus"}[frame]
    return rrb.Spatial3DView(
        name=name,
        origin=f"{root}/{frame}",
        contents=[
            *(_surroundings() if oriented else _surroundings()[:-1]),
            f"+ {root}/**",
            f"- {root}/lineages",
            f"- {root}/maps",
            f"- {root}/{other}/**",
        ],
        overrides={f"{root}/{ON_DEMAND}": rrb.EntityBehavior(visible=False)},
        background=BACKGROUND,
        line_grid=_grid(1.0),
        eye_controls=_eye((0.0, 0.0), CLOSE_HEIGHT),
    )


def _surroundings() -> list[str]:
    return ["+ /world/truth/**", "+ /world/odometry/**", "+ /world/scan"]


def _grid(spacing: float) -> rrb.LineGrid3D:
    return rrb.LineGrid3D(
        visible=True, spacing=spacing, plane=rr.components.Plane3D.XY, stroke_width=0.5, color=(60, 64, 68)
    )


def _eye(centre: Floats | tuple[float, float], distance: float) -> rrb.EyeControls3D:
    """Straight above, north up."""
    x, y = (float(c) for c in centre)
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=(x, y, distance), look_target=(x, y, 0.0), eye_up=(0.0, 1.0, 0.0)
    )


GROUPS = {
    "Consistency": ("n_eff", "diversity", "nees_log10"),
    "Errors": ("position_error", "heading_error", "map_error"),
    "Map and cost": ("features", "duplicates", "update_ms"),
}
AXES = {"nees_log10": LOG_NEES_RANGE, "diversity": (0.0, 1.02)}


def _plots(filters: Sequence[Estimator], known: frozenset[str]) -> rrb.Container:
    """One tab for each group, and in each one plot with the legend: the colours are the same in all."""
    tabs = []
    for name, members in GROUPS.items():
        shown = [m for m in (BY_NAME[n] for n in members) if not m.needs or m.needs in known]
        explained = next((m for m in shown if not m.population), shown[0] if shown else None)
        if shown:
            tabs.append(rrb.Vertical(*(_plot(m, filters, m is explained) for m in shown), name=name))
    return rrb.Tabs(*tabs, active_tab=0)


EVERYTHING = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
"""The whole run, not a window around the cursor."""


def _plot(metric: Metric, filters: Sequence[Estimator], legend: bool) -> rrb.TimeSeriesView:
    many = populations(f.key for f in filters)
    lonely = [f"- /plots/{metric.name}/{f.key}" for f in filters if metric.population and f.key not in many]
    return rrb.TimeSeriesView(
        name=metric.title,
        origin=f"/plots/{metric.name}",
        contents=["+ $origin/**", *lonely],
        axis_y=rrb.ScalarAxis(range=AXES[metric.name]) if metric.name in AXES else None,
        axis_x=rrb.TimeAxis(view_range=EVERYTHING),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=legend),
    )


def _pages(filters: Sequence[Estimator]) -> rrb.Container:
    many = [f for f in filters if f.key in populations(f.key for f in filters)]
    ancestry = rrb.Spatial2DView(
        name="Ancestry",
        origin="/genealogy",
        contents=["+ $origin/frame/**", *(f"+ $origin/{f.key}" for f in many)],
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-LEFT, WIDTH + 6.0), y_range=(-6.0, HEIGHT + 9.0)),
    )
    weights = [
        rrb.BarChartView(name=f.title, origin=f"/weights/{f.key}", plot_legend=rrb.PlotLegend(visible=False))
        for f in many
    ]
    events = rrb.TextLogView(
        name="Events",
        origin="/events",
        columns=rrb.TextLogColumns(text_log_columns=["loglevel", "body"]),
        rows=rrb.TextLogRows(filter_by_log_level=["INFO", "WARN"]),  # resamplings, at DEBUG, can be switched on
    )
    return rrb.Tabs(
        ancestry,
        rrb.Horizontal(*weights, name="Weights times K"),
        events,
        rrb.TextDocumentView(name="About", origin="/about"),
        rrb.TextDocumentView(name="Parameters", origin="/params"),
        active_tab=0,
    )
