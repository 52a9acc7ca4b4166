"""What is no map and no plot over time: the ancestry picture and the sorted weights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from app import colours
from app.diagnosis.evidence import NAMES, Evidence
from app.recording import arrow
from app.recording.limits import Limits, sample
from slam.genealogy import Genealogy, Strip
from slam.types import Floats, Particles

WINDOW = 120
"""[steps] of ancestry that the picture shows."""

LINES = 48
"""Living particles whose ancestry it shows, and as many that died."""

WIDTH, HEIGHT, GAP, LEFT = 165.0, 100.0, 6.0, 66.0
"""Of the whole picture, between the bands of the filters, and of the margin that holds their names."""


class Band(NamedTuple):
    """Where the picture of one filter is: time to the right, particles below each other."""

    top: float
    height: float
    steps: int
    """Length of the time axis."""
    scrolls: bool
    """A run longer than the window: the axis counts back from the present."""

    def place(self, points: Floats, now: int) -> Floats:
        """(m, 2) of (step, slot) to (x, y) of the picture."""
        x = points[:, 0] - (now - self.steps if self.scrolls else 0)
        return np.stack([x * WIDTH / self.steps, self.top + self.height * points[:, 1]], axis=1)


def bands(count: int, steps: int) -> list[Band]:
    """The picture divided among so many filters, for a run of so many steps."""
    height = (HEIGHT - GAP * (count - 1)) / count
    window = min(steps, WINDOW)
    return [Band(i * (height + GAP), height, max(window, 1), steps > WINDOW) for i in range(count)]


def ancestry(genealogy: Genealogy, band: Band, rgb: colours.RGB) -> rr.LineStrips2D:
    """Lines of descent of the last steps: dim where they died out, the descendants of a founder all in one shade."""
    strips = sorted(genealogy.layout(max_particles=LINES, max_steps=band.steps), key=lambda s: s.alive)
    rows = band.place(np.concatenate([s.points for s in strips] or [np.zeros((0, 2))]), genealogy.steps)
    return rr.LineStrips2D.from_fields(
        strips=arrow.strips(rows, [len(s.points) for s in strips]),
        colors=arrow.colours(_shades(strips, rgb)),
        radii=pa.array([-0.75 if s.alive else -0.4 for s in strips], pa.float32()),  # negative: points on the screen
    )


def ancestry_frame(band: Band, title: str, rgb: colours.RGB) -> tuple[rr.LineStrips2D, rr.Points2D]:
    """The box of one band, the name of its filter and marks on its time axis."""
    top, bottom = band.top, band.top + band.height
    box = [[0, top], [WIDTH, top], [WIDTH, bottom], [0, bottom], [0, top]]
    name = rr.Points2D(
        [[-0.5 * LEFT, 0.5 * (top + bottom) - 2.0]], labels=title, show_labels=True, radii=0.0, colors=rgb
    )
    return rr.LineStrips2D([box], colors=(60, 60, 60), radii=rr.Radius.ui_points(0.5), draw_order=0.0), name


def time_marks(last: Band) -> rr.Points2D:
    """Numbers below the lowest band."""
    every = next(e for e in (1, 2, 5, 10, 20, 50) if last.steps / e <= 7)
    marks = range(0, last.steps + 1, every)
    label = (lambda m: f"{m - last.steps}" if m < last.steps else "now") if last.scrolls else (lambda m: f"step {m}")
    return rr.Points2D(
        [[m * WIDTH / last.steps, last.top + last.height + 2.0] for m in marks],
        labels=[label(m) for m in marks],
        show_labels=True,
        radii=0.0,
        colors=(150, 150, 150),
    )


def weight_bars(p: Particles, shown: Limits, rgb: colours.RGB) -> rr.BarChart:
    """Weights times K, largest first (a sample of them when there are many): all bars 1 high means equal weights."""
    share = np.sort(np.exp(p.log_w))[::-1] * len(p.log_w)
    return rr.BarChart.from_fields(values=arrow.bars(share[sample(len(share), shown.bars)]), color=rgb)


def evidence(found: Evidence) -> rr.AnyValues:
    """What a diagnosis is made of, for whoever reads the recording; no view shows it."""
    numbers, (shares, features, widths), marks = found
    return rr.AnyValues(
        numbers=pa.array((*numbers, *marks), pa.float64()),
        shares=pa.array(shares),
        features=pa.array(features),
        widths=pa.array(widths),
    )


def evidence_names() -> rr.AnyValues:
    """What the numbers of `evidence` are called, in their order."""
    return rr.AnyValues(names=list(NAMES))


def _shades(strips: list[Strip], rgb: colours.RGB) -> Floats:
    """(n, 3): neighbouring founders get tones of the filter's hue that are far apart."""
    dark, light = np.array(colours.faded(rgb, 0.35)), np.array(colours.mix(rgb, (255, 255, 255), 0.55))
    tone = np.array([s.root * 0.618034 % 1.0 for s in strips])[:, None]
    alive = np.array([s.alive for s in strips])[:, None]
    return np.where(alive, dark + tone * (light - dark), np.array(colours.faded(rgb, 0.75)))
