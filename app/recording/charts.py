"""What is no map and no plot over time: the ancestry picture, the sorted weights, and what is left of hypotheses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from app import ancestry as descent
from app import colours
from app.diagnosis.evidence import NAMES, Evidence
from app.recording import arrow
from app.recording.limits import Limits, sample
from slam.genealogy import Genealogy
from slam.types import Ints, Particles

WIDTH, HEIGHT, HEADER = 140.0, 100.0, 11.0
"""Of the trees, of all of them together with what is written above each, and of that."""

CURVES, CURVES_WIDTH, CURVES_TOP = WIDTH + 15.0, 54.0, HEADER
"""Where, beside them, the curves of what is left of the ancestors begin, how wide they are, and how far down."""

THINNEST, THICKEST, DEAD = 0.6, 2.2, 0.35
"""[points] radii of lines, by how many of the living descend through them; of those that died out."""


SHORTEST = 60
"""[steps] that the time axis has at least, unless the run is shorter; it doubles whenever it has become too short."""


class Band(NamedTuple):
    """Where the picture of one filter is: time to the right, particles below each other."""

    top: float
    height: float

    @property
    def bottom(self) -> float:
        """Where it ends."""
        return self.top + self.height


def bands(count: int) -> list[Band]:
    """The picture divided among so many filters."""
    height = HEIGHT / count - HEADER
    return [Band(i * HEIGHT / count + HEADER, height) for i in range(count)]


def time_axis(step: int, total: int) -> int:
    """[steps] of the time axis at a step of a run of so many: long enough for it, and not many times longer."""
    axis = SHORTEST
    while axis < step:
        axis *= 2
    return max(min(axis, total), 1)


def ancestry(genealogy: Genealogy, band: Band, axis: int, rgb: colours.RGB) -> rr.LineStrips2D:
    """Lines of descent from the beginning until now, the descendants of a founder all in one colour."""
    tree = descent.tree(genealogy, rgb)
    alive = tree.share > 0.0
    radii = np.where(alive, THINNEST + (THICKEST - THINNEST) * np.sqrt(tree.share), DEAD)
    x, y = tree.points[:, 0] * WIDTH / axis, band.top + band.height * tree.points[:, 1]
    return rr.LineStrips2D.from_fields(
        strips=arrow.strips(np.stack([x, y], axis=1), tree.lengths),
        colors=arrow.colours(tree.tones),
        radii=pa.array(-radii, pa.float32()),  # negative: points on the screen
    )


def ancestry_frame(band: Band, rgb: colours.RGB) -> rr.LineStrips2D:
    """The box of one band, in the colour of its filter."""
    box = _box(0.0, band.top, WIDTH, band.height)
    return rr.LineStrips2D([box], colors=colours.faded(rgb, 0.5), radii=rr.Radius.ui_points(0.5), draw_order=0.0)


def look_of_words(band: Band, rgb: colours.RGB) -> rr.Points2D:
    """Where the words of one band stand: above it."""
    place = [[0.5 * WIDTH, band.top - 0.75 * HEADER]]
    return rr.Points2D.from_fields(positions=place, radii=0.0, colors=rgb, show_labels=True)


def words(text: str) -> rr.Points2D:
    """What is said of one band."""
    return rr.Points2D.from_fields(labels=[text])


def cursor(step: int, axis: int, first: Band, last: Band) -> rr.LineStrips2D:
    """The present step, on the time axis that the picture has."""
    x = WIDTH * min(step / axis, 1.0)
    return rr.LineStrips2D.from_fields(strips=arrow.strips(np.array([[x, first.top], [x, last.bottom]]), [2]))


def look_of_cursor() -> rr.LineStrips2D:
    """How it looks."""
    return rr.LineStrips2D.from_fields(colors=(255, 255, 255), radii=rr.Radius.ui_points(0.5))


def lag_curve(lags: Ints, left: Ints, steps: int, particles: int) -> rr.LineStrips2D:
    """How many distinct ancestors the living had, left (n,), so many steps ago, lags (n,), in a run of so many steps
    and no more than so many particles: both axes logarithmic."""
    x = CURVES + CURVES_WIDTH * np.log10(1.0 + lags) / np.log10(1.0 + max(steps, 1))
    share = np.log10(left) / np.log10(max(particles, 2))
    y = HEIGHT - (HEIGHT - CURVES_TOP) * share
    return rr.LineStrips2D.from_fields(strips=arrow.strips(np.stack([x, y], axis=1), [len(lags)]))


def look_of_lag_curve(rgb: colours.RGB) -> rr.LineStrips2D:
    """In the colour of the filter."""
    return rr.LineStrips2D.from_fields(colors=rgb, radii=rr.Radius.ui_points(1.0))


def lag_frame(steps: int, particles: int) -> tuple[rr.LineStrips2D, rr.Points2D]:
    """The box of the curves, and numbers on their axes; few and short ones, since views are narrow: the lower edge is
    one ancestor."""
    box = _box(CURVES, CURVES_TOP, CURVES_WIDTH, HEIGHT - CURVES_TOP)
    decades = [10**i for i in range(1, 8)]
    at = [d for d in decades if d < steps]
    x = [CURVES + CURVES_WIDTH * float(np.log10(1 + d) / np.log10(1 + max(steps, 1))) for d in at]
    marks = [d for d in decades if d < particles]
    y = [HEIGHT - (HEIGHT - CURVES_TOP) * float(np.log10(d) / np.log10(particles)) for d in marks]
    lines = [[[v, CURVES_TOP], [v, HEIGHT]] for v in x] + [[[CURVES, v], [CURVES + CURVES_WIDTH, v]] for v in y]
    places = [
        [CURVES + 0.5 * CURVES_WIDTH, 0.25 * CURVES_TOP],
        *([CURVES - 4.0, v] for v in y),
        [CURVES, HEIGHT + 4.0],
        *([v, HEIGHT + 4.0] for v in x),
    ]
    labels = ["ancestors", *map(str, marks), "now", *map(str, at)]
    grid = rr.LineStrips2D([box, *lines], colors=(60, 60, 60), radii=rr.Radius.ui_points(0.5), draw_order=0.0)
    return grid, _labels(places, labels, GREY)


def time_marks(last: Band, axis: int) -> rr.Points2D:
    """Numbers below the lowest band; none at its end, where those of the curves beside it begin."""
    every = next(f * 10**i for i in range(8) for f in (1, 2, 5) if axis <= 6 * f * 10**i)
    marks = range(0, axis, every)
    places = [[m * WIDTH / axis, last.bottom + 4.0] for m in marks]
    return _labels(places, [f"{m}" if m else "#0" for m in marks], GREY)


GREY: colours.RGB = (150, 150, 150)


def _box(x: float, y: float, width: float, height: float) -> list[list[float]]:
    return [[x, y], [x + width, y], [x + width, y + height], [x, y + height], [x, y]]


def _labels(places: list[list[float]], labels: list[str], rgb: colours.RGB) -> rr.Points2D:
    return rr.Points2D(places, labels=labels, show_labels=True, radii=0.0, colors=rgb)


def hypothesis_bars(copies: Ints, rgb: colours.RGB) -> rr.BarChart:
    """How many hypotheses of each feature (n,) are left."""
    return rr.BarChart.from_fields(values=arrow.bars(copies.astype(float)), color=rgb)


def weight_bars(p: Particles, shown: Limits, rgb: colours.RGB) -> rr.BarChart:
    """Weights times K, largest first (a sample of them when there are many): all bars 1 high means equal weights."""
    share = np.sort(np.exp(p.log_w))[::-1] * len(p.log_w)
    return rr.BarChart.from_fields(values=arrow.bars(share[sample(len(share), shown.bars)]), color=rgb)


def evidence(found: Evidence) -> arrow.Components:
    """What a diagnosis is made of, for whoever reads the recording; no view shows it."""
    shares, features, widths = found.observations
    return arrow.named(
        numbers=pa.array(found.row, pa.float64()),
        shares=pa.array(shares),
        features=pa.array(features),
        widths=pa.array(widths),
    )


def evidence_names() -> rr.AnyValues:
    """What the numbers of `evidence` are called, in their order."""
    return rr.AnyValues(names=list(NAMES))
