"""What the page says of the ancestry: a picture for each filter, and under it the numbers in words."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from app import ancestry, colours
from app.ancestry import Tree
from app.live.engine import Status
from app.options import FILTERS
from app.pace import Pace
from app.types import FilterUpdate
from slam.estimators import ESTIMATORS

WIDTH, HEIGHT = 540, 96
"""[pixels] of a picture."""

DUTY = 0.03
"""Share of the time that pictures may take."""

SHORTEST = 30
"""[steps] that the time axis has at least."""

NOTHING = "*No filter with more than one particle has made a step.*"

EXPLAINED = """From left to right the run until now. Lines are particles of the present and their ancestors, the
thicker the more of the living descend from one; they have the colour of their founder, and that of the filter where all
have them in common. What died out is dim; the white line is the present step."""

THICKER = (0.0, 0.1, 0.5)
"""Shares of the living that descend through a line from which on it is one, two or three pixels thick."""

Pixels = NDArray[np.uint8]


class Ancestry:
    """Pictures and words of all filters; those that are off are hidden."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._pace = Pace(DUTY)
        self._shown: tuple[int, str, int, tuple[str, ...]] | None = None
        """Session, branch, step and filters of the pictures."""
        self.nothing = gui.add_markdown(NOTHING)
        blank = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        self.words, self.pictures = {}, {}
        for key in FILTERS:
            self.words[key] = gui.add_markdown("", visible=False)
            self.pictures[key] = gui.add_image(blank, format="jpeg", jpeg_quality=90, visible=False)
        gui.add_markdown(EXPLAINED)

    def show(self, status: Status) -> None:
        """The step where the session stands; a picture may wait while it runs."""
        step = status.taken.step if status.taken else None
        updates = {k: u for k, u in (step.filters.items() if step else ()) if len(u.trace.weighted.s) > 1}
        now = (status.number, status.branch, status.step, tuple(updates))
        if now == self._shown or (status.playing and not self._pace.due):
            return
        self._shown = now
        with self._pace.kept():
            self.nothing.visible = not updates
            for key in FILTERS:
                self.words[key].visible = self.pictures[key].visible = key in updates
                if key in updates:
                    self.words[key].content = described(key, updates[key])
                    axis = max(status.newest, SHORTEST)
                    tree = ancestry.tree(updates[key].genealogy, colours.of_filter(key))
                    self.pictures[key].image = picture(tree, status.step, axis, colours.of_filter(key))


def described(key: str, update: FilterUpdate) -> str:
    """A line of markdown: how many ancestors are left, and hypotheses of features."""
    left = ancestry.scarcest(update.trace.weighted.maps)
    return f"**{ESTIMATORS[key].title}**: {ancestry.words(update)}" + (f"; {left}" if left else "")


def picture(tree: Tree, step: int, axis: int, rgb: colours.RGB) -> Pixels:
    """(HEIGHT, WIDTH, 3): the tree until `step` on a time axis of `axis` steps, in a frame of the filter's colour."""
    pixels = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    pixels[:] = colours.BACKGROUND
    pixels[[0, -1]] = pixels[:, [0, -1]] = colours.faded(rgb, 0.5)
    present = round((WIDTH - 1) * min(step / axis, 1.0))
    pixels[1:-1, present] = (255, 255, 255)

    x, y = tree.points[:, 0] * ((WIDTH - 1) / axis), 1.0 + tree.points[:, 1] * (HEIGHT - 3)
    line = np.repeat(np.arange(len(tree.lengths)), tree.lengths)
    begins = np.flatnonzero(line[1:] == line[:-1])  # of pieces that are straight
    ends = begins + 1
    count = 1 + np.ceil(np.maximum(np.abs(x[ends] - x[begins]), np.abs(y[ends] - y[begins]))).astype(np.int64)
    piece = np.repeat(np.arange(len(begins)), count)
    along = (np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)) / np.maximum(count - 1, 1)[piece]
    column = np.rint(x[begins][piece] + along * (x[ends] - x[begins])[piece]).astype(np.int64)
    row = np.rint(y[begins][piece] + along * (y[ends] - y[begins])[piece]).astype(np.int64)
    owner = line[begins][piece]
    for beside, least in zip((0, 1, -1), THICKER, strict=True):
        wide = tree.share[owner] >= least
        where = np.clip(row[wide] + beside, 1, HEIGHT - 2)
        pixels[where, np.clip(column[wide], 0, present)] = tree.tones[owner[wide]].astype(np.uint8)
    return pixels
