"""How a recording opens in any Rerun viewer: which views there are, where, and what they show."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb

from app import colours
from app.recording.charts import CURVES, CURVES_WIDTH, HEIGHT
from app.recording.ground import Extent
from app.recording.metrics import BY_NAME, LOG_COMPONENT_RANGE, LOG_NEES_RANGE, Metric, populations
from app.recording.scene import CLOSE_HEIGHT, nice
from slam.types import Estimator, Floats

MAP_ASPECT = 1.8
"""Width over height of the map view, at the usual 16:9 of a window."""

PAGE_ASPECT = 1.15
"""The same beside the panel of the live page."""

STACKED = 0.8
"""Two maps lie above each other if the place, width over height, is longer than the map view by this factor; below,
the eye is at most 1.6 times as far away as for a map alone, and still tells the layers apart (`scene.LIFT`)."""

COMPARED_ASPECT = 3.5
"""Width over height of all maps of a comparison together."""

LEGEND_LINES = 12
"""Above so many, a legend would hide the plot; a line that is pointed at tells its name."""

BACKGROUND = colours.BACKGROUND

TRUNK = "The run"
"""What the run itself is called beside its branches."""

ON_DEMAND = "associations"
"""What of a filter no view shows until somebody wants to see it."""


class Shown(NamedTuple):
    """What a window shows of a run, or of one of its branches."""

    filters: Sequence[Estimator]
    extent: Extent
    known: frozenset[str]
    """What somebody knows (`metrics.known_of`)."""
    legend: str
    """What the title of a map says of features."""
    prefix: str = ""
    """Of all entities: nothing, or `branch/<name>/`."""
    label: str = ""
    """Name of the branch, for people."""
    aspect: float = MAP_ASPECT
    """Width over height of the map view."""
    lesson: str = ""
    """The page of the lesson that the run is of."""

    def at(self, path: str) -> str:
        """The entity that has this path in a recording of its own."""
        return f"/{self.prefix}{path}"

    def named(self, title: str) -> str:
        """A title that tells the branches apart."""
        return f"{title}, {self.label}" if self.label else title


def layout(
    filters: Sequence[Estimator], extent: Extent, known: frozenset[str], legend: str, prefix: str = ""
) -> rrb.Blueprint:
    """The window: the map with a close-up for each filter on the left, plots and pages on the right.

    `known` is what somebody knows (`metrics.known_of`), `legend` what the title of a map says of features, `prefix`
    that of all entities.
    """
    return layout_of_branches([Shown(filters, extent, known, legend, prefix)])


def layout_of_branches(branches: Sequence[Shown]) -> rrb.Blueprint:
    """The same for a run and its branches, the run first: maps side by side, each measure of all of them in one plot.

    Pages on one branch lie behind tabs; the latest is in front.
    """
    last = branches[-1]
    tabs = [_of_one(f, branch) for branch in reversed(branches) for f in branch.filters]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Tabs(_together(branches), *tabs, active_tab=0),
            rrb.Vertical(_plots(branches), _pages(last, branches), row_shares=[2, 3] if branches[0].lesson else [3, 2]),
            column_shares=[8, 5],
        ),
        rrb.TimePanel(state="collapsed", timeline="step", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def layout_of_comparison(runs: Sequence[Shown], page: str) -> rrb.Blueprint:
    """Several runs, none of which is a branch of another: maps side by side, below them the plots that they share.

    `page` is the entity that says what differs.
    """
    keys = dict.fromkeys(f.key for run in runs for f in run.filters)
    tabs = [_beside([run for run in runs if key in {f.key for f in run.filters}], key) for key in keys]
    pages = rrb.Tabs(
        rrb.TextDocumentView(name="Comparison", origin=page),
        *(_ancestry(run) for run in runs),
        *(_events(run) for run in runs),
        *(rrb.TextDocumentView(name=run.named("Parameters"), origin=run.at("params")) for run in runs),
        active_tab=0,
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Tabs(_beside(runs), *(tabs if len(keys) > 1 else ()), active_tab=0),
            rrb.Horizontal(_plots(runs, rrb.Horizontal), pages, column_shares=[7, 3]),
            row_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline="step", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _beside(runs: Sequence[Shown], key: str = "") -> rrb.Container:
    """The maps of all runs, of all filters or of one, in as many columns as show most."""

    def aspect(columns: int) -> float:
        return COMPARED_ASPECT * math.ceil(len(runs) / columns) / columns

    def distance(columns: int) -> float:
        """Of the eye, over the height of a view."""
        return runs[0].extent.eye_height(aspect(columns)) * math.ceil(len(runs) / columns)

    columns = min(range(1, len(runs) + 1), key=distance)
    placed = [run._replace(aspect=aspect(columns)) for run in runs]
    if not key:
        maps = [_map_of_all(run._replace(legend="")) for run in placed]  # titles are cut where they are long
        return rrb.Grid(*maps, grid_columns=columns, name="All filters")
    estimator = next(f for f in runs[0].filters if f.key == key)
    named = f"{estimator.title}: map, all surviving paths, the maps of all particles"
    maps = [_map_view(f"{run.label}: {named}{run.legend}", run, [estimator], whole=True) for run in placed]
    return rrb.Grid(*maps, grid_columns=columns, name=estimator.title)


def _together(branches: Sequence[Shown]) -> rrb.Container:
    """All filters: of one run, or of the run beside its latest branch."""
    name = "All filters"
    if len(branches) == 1:
        return rrb.Vertical(_map_of_all(branches[0]), _close_ups(branches[0]), row_shares=[5, 3], name=name)
    width, height = branches[0].extent.high - branches[0].extent.low
    stacked = width > STACKED * branches[0].aspect * height
    pair = [
        branch._replace(aspect=branch.aspect * (2.0 if stacked else 0.5), label=branch.label or TRUNK)
        for branch in (branches[0], branches[-1])
    ]
    beside = rrb.Vertical if stacked else rrb.Horizontal
    maps, close_ups = beside(*map(_map_of_all, pair)), rrb.Horizontal(*map(_close_ups, pair))
    return rrb.Vertical(maps, close_ups, row_shares=[5, 2], name=name)


def _map_of_all(branch: Shown) -> rrb.Spatial3DView:
    return _map_view(_legend(branch) + branch.legend, branch, branch.filters)


def _close_ups(branch: Shown) -> rrb.Container:
    return rrb.Horizontal(*(_close_up(f, "focus", branch.named(f.title), branch) for f in branch.filters))


def _of_one(estimator: Estimator, branch: Shown) -> rrb.Container:
    """The tab of one filter: its map with lineages and all hypotheses, its particles, and the best one of them."""
    title = branch.named(estimator.title)
    named = f"{title}: map, all surviving paths, the maps of all particles{branch.legend}"
    return rrb.Vertical(
        _map_view(named, branch, [estimator], whole=True),
        rrb.Horizontal(
            _close_up(estimator, "focus", f"{title}: particles", branch),
            _close_up(estimator, "best", f"{title}: the best particle", branch),
        ),
        row_shares=[5, 3],
        name=title,
    )


def _legend(branch: Shown) -> str:
    named = ", ".join(f"{f.title} {colours.word(f.key)}" for f in branch.filters)
    return f"{branch.label or 'Map'}: {named}, truth white, dead reckoning grey"


def _map_view(name: str, branch: Shown, filters: Sequence[Estimator], whole: bool = False) -> rrb.Spatial3DView:
    """Seen from straight above.  What would crowd the map is there, but switched off: with several filters, much."""
    extent = branch.extent
    grid = nice(extent.size / 12)
    roots = [branch.at(f"world/{f.key}") for f in filters]
    crowd = (ON_DEMAND,) if whole else ("maps", "lineages", "ellipses", ON_DEMAND)
    frames = [f"- {root}/{frame}/**" for root in roots for frame in ("focus", "best")]
    return rrb.Spatial3DView(
        name=f"{name}; grid {grid:g} m",
        origin=branch.at("world"),
        contents=[*_surroundings(branch), *(f"+ {root}/**" for root in roots), *frames],
        overrides={f"{root}/{what}": rrb.EntityBehavior(visible=False) for root in roots for what in crowd},
        background=BACKGROUND,
        line_grid=_grid(grid),
        eye_controls=_eye(extent.centre, extent.eye_height(branch.aspect)),
    )


def _close_up(estimator: Estimator, frame: str, name: str, branch: Shown) -> rrb.Spatial3DView:
    """The frame moves and scales with the particles, so that a fixed eye always has them in sight.

    Observations are shown only if a true pose tells where they were made: drawn from the estimate of one filter, they
    would look wrong beside the particles of another.
    """
    root = branch.at(f"world/{estimator.key}")
    other = {"focus": "best", "best": "focus"}[frame]
    around = _surroundings(branch, with_scans="heading" in branch.known)
    return rrb.Spatial3DView(
        name=name,
        origin=f"{root}/{frame}",
        contents=[
            *around,
            f"+ {root}/**",
            f"- {root}/lineages",
            f"- {root}/maps",
            f"- {root}/relations",
            f"- {root}/{other}/**",
        ],
        overrides={f"{root}/{ON_DEMAND}": rrb.EntityBehavior(visible=False)},
        background=BACKGROUND,
        line_grid=_grid(1.0),
        eye_controls=_eye((0.0, 0.0), CLOSE_HEIGHT),
    )


def _surroundings(branch: Shown, with_scans: bool = True) -> list[str]:
    entities = ("truth/**", "odometry/**", "matching/**", *(("scan", "scans") if with_scans else ()))
    return [f"+ {branch.at(f'world/{what}')}" for what in entities]


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
    "NEES": ("nees_x_log10", "nees_y_log10", "nees_heading_log10"),
    "Weights": ("weight_deviation", "first_share", "inside", "proposal_width"),
    "Innovations": ("nis_first", "nis_second"),
    "Errors": ("position_error", "heading_error", "map_error"),
    "Luck": ("position_error", "spread", "monte_carlo"),
    "Map and cost": ("features", "duplicates", "update_ms"),
}
AXES = {
    "nees_log10": LOG_NEES_RANGE,
    **dict.fromkeys(("nees_x_log10", "nees_y_log10", "nees_heading_log10"), LOG_COMPONENT_RANGE),
    "diversity": (0.0, 1.02),
    "inside": (0.0, 1.02),
    "first_share": (-0.1, 1.1),
}


def _plots(branches: Sequence[Shown], beside: Callable[..., rrb.Container] = rrb.Vertical) -> rrb.Container:
    """One tab for each group, and in each one plot with the legend: the colours are the same in all."""
    known = frozenset().union(*(branch.known for branch in branches))
    tabs = []
    for name, members in GROUPS.items():
        shown = [m for m in (BY_NAME[n] for n in members) if not m.needs or m.needs in known]
        explained = next((m for m in shown if not m.population), shown[0] if shown else None)
        lines = sum(len(branch.filters) for branch in branches)
        if shown:
            plots = [_plot(m, branches, m is explained and lines <= LEGEND_LINES) for m in shown]
            tabs.append(beside(*plots, name=name))
    return rrb.Tabs(*tabs, active_tab=0)


EVERYTHING = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
"""The whole run, not a window around the cursor."""


def _plot(metric: Metric, branches: Sequence[Shown], legend: bool) -> rrb.TimeSeriesView:
    contents = []
    for branch in branches:
        many = populations(f.key for f in branch.filters)
        root = branch.at(f"plots/{metric.name}")
        lonely = [f"- {root}/{f.key}" for f in branch.filters if metric.population and f.key not in many]
        contents += [f"+ {root}/**", *lonely]
    return rrb.TimeSeriesView(
        name=metric.title,
        origin=branches[0].at(f"plots/{metric.name}") if len(branches) == 1 else "/",
        contents=contents,
        axis_y=rrb.ScalarAxis(range=AXES[metric.name]) if metric.name in AXES else None,
        axis_x=rrb.TimeAxis(view_range=EVERYTHING),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=legend),
    )


def _pages(branch: Shown, branches: Sequence[Shown]) -> rrb.Container:
    weights = [
        rrb.BarChartView(
            name=branch.named(f.title), origin=branch.at(f"weights/{f.key}"), plot_legend=rrb.PlotLegend(visible=False)
        )
        for f in _many(branch)
    ]
    lesson = branches[0].lesson
    hypotheses = [
        rrb.BarChartView(
            name=branch.named(f.title),
            origin=branch.at(f"hypotheses/{f.key}"),
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for f in _many(branch)
    ]
    return rrb.Tabs(
        *([rrb.TextDocumentView(name="Lesson", origin=lesson)] if lesson else ()),
        _ancestry(branch),
        rrb.Horizontal(*hypotheses, name="Hypotheses"),
        rrb.Horizontal(*weights, name="Weights times K"),
        *(_events(one) for one in reversed(branches)),
        *(_relations(one) for one in reversed(branches) if "relations" in one.known),
        rrb.TextDocumentView(name="About", origin=branches[0].at("about")),
        *(rrb.TextDocumentView(name=one.named("Parameters"), origin=one.at("params")) for one in reversed(branches)),
        active_tab=0,
    )


def _relations(branch: Shown) -> rrb.TextDocumentView:
    return rrb.TextDocumentView(name=branch.named("Relations"), origin=branch.at("relations"))


def _many(branch: Shown) -> list[Estimator]:
    return [f for f in branch.filters if f.key in populations(f.key for f in branch.filters)]


def _ancestry(branch: Shown) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        name=branch.named("Ancestry"),
        origin=branch.at("genealogy"),
        contents=["+ $origin/frame/**", "+ $origin/cursor", *(f"+ $origin/{f.key}/**" for f in _many(branch))],
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-8.0, CURVES + CURVES_WIDTH + 8.0), y_range=(-1.0, HEIGHT + 12.0)),
    )


def _events(branch: Shown) -> rrb.TextLogView:
    return rrb.TextLogView(
        name=branch.named("Events"),
        origin=branch.at("events"),
        columns=rrb.TextLogColumns(text_log_columns=["loglevel", "body"]),
        rows=rrb.TextLogRows(filter_by_log_level=["INFO", "WARN"]),  # resamplings, at DEBUG, can be switched on
    )
