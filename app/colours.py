"""One colour for each filter, the same in recording, panel, plots and pictures.

The hues are Okabe and Ito's, which people with any of the common colour deficiencies tell apart, chosen to be
legible on the dark ground of a viewer and on white paper.  What is no filter (truth, odometry) is grey.
"""

from __future__ import annotations

RGB = tuple[int, int, int]

FILTERS: dict[str, RGB] = {
    "dfs": (230, 159, 0),
    "fs2": (86, 180, 233),
    "fs1": (0, 158, 115),
    "ekf": (204, 121, 167),
}
WORDS = {"dfs": "orange", "fs2": "blue", "fs1": "green", "ekf": "pink"}
"""What people call them."""

TRUTH: RGB = (60, 60, 60)
"""On white paper."""

TRUTH_ON_DARK: RGB = (238, 238, 238)
ODOMETRY: RGB = (130, 130, 130)
MATCHING: RGB = (190, 190, 190)
"""Odometry as scan matching corrects it."""
WARNING: RGB = (240, 228, 66)

MATCHED: RGB = (240, 228, 66)
NEW: RGB = (145, 115, 255)
REJECTED: RGB = (238, 60, 60)
"""What became of a piece of wall that was seen.  Told apart by all, and from the filters."""

ASSOCIATION: RGB = (255, 255, 255)

FOUNDERS: tuple[RGB, ...] = (
    (0, 238, 255),
    (221, 170, 0),
    (255, 68, 153),
    (119, 153, 255),
    (238, 238, 136),
    (170, 17, 136),
    (136, 119, 0),
    (102, 0, 255),
)
"""Of lines of descent, on a dark ground, by the number of the founder.  As far apart as eight colours can be for
everybody, the colour-blind included (Oklab)."""

BACKGROUND: RGB = (13, 16, 17)
"""Of dark views; what fades, fades into this."""

TONES_ON_DARK = (0.0, 0.5, -0.45, 0.82, -0.2, 0.4, -0.6, 0.7)
TONES_ON_PAPER = (-0.45, 0.15, -0.7, -0.2, 0.4, -0.55, 0.0, -0.85)
"""Of runs that are compared: how far towards white, or black, neighbours far apart."""

OTHER: RGB = (213, 94, 0)
"""A filter that has no colour of its own."""


def of_filter(key: str) -> RGB:
    """The colour of a filter, also of one that is not listed here."""
    return FILTERS.get(key, OTHER)


def word(key: str) -> str:
    """The word for the colour of a filter."""
    return WORDS.get(key, "red")


def broken(rgb: RGB) -> RGB:
    """Where the path of a filter of this colour breaks relations: lighter than its map, which lies below."""
    return mix(rgb, (255, 255, 255), 0.5)


def mix(a: RGB, b: RGB, share: float) -> RGB:
    """`share` of b and the rest of a."""
    red, green, blue = (round(x + share * (y - x)) for x, y in zip(a, b, strict=True))
    return red, green, blue


def of_run(rgb: RGB, rank: int, on_dark: bool) -> RGB:
    """The shade of a filter's colour in which the run of this rank is drawn, where several runs are compared."""
    tones = TONES_ON_DARK if on_dark else TONES_ON_PAPER
    tone = tones[rank % len(tones)]
    return mix(rgb, (255, 255, 255) if tone > 0 else (0, 0, 0), abs(tone))


def faded(rgb: RGB, share: float) -> RGB:
    """`rgb` with `share` of it replaced by the background: transparency, where a view has none."""
    return mix(rgb, BACKGROUND, share)
