"""A map as an SVG picture: paths, landmarks or walls with their 2 sigma, a scale bar, a legend.  y points up."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from html import escape
from typing import Any, NamedTuple

import numpy as np

from slam.features import Wall
from slam.features.wall import ends
from slam.geometry import ellipse_axes
from slam.types import Bools, Floats

WIDTH = 1000
LARGEST_HEIGHT = 1000
MARGIN = 36
TRUTH_OPACITY = 0.35
HEADER, FOOTER = 34, 46
INK, PAPER = "#33373d", "#ffffff"
FONT = "font-family='Helvetica, Arial, sans-serif'"
SCANNED = (205, 208, 212)
"""Of what the laser saw, which is behind everything else."""

ENDS = "dot: an end of a wall that was seen; without it, the wall may go on"


class Walls(NamedTuple):
    """Lines on a map."""

    ends: Floats
    """(n, 2, 2) [m]"""
    seen: Bools
    """(n, 2) which of the ends are marked as such."""
    deviation: Floats
    """(n, 2) [m] of each end, across the wall."""


NO_WALLS = Walls(np.zeros((0, 2, 2)), np.zeros((0, 2), np.bool_), np.zeros((0, 2)))


class Layer(NamedTuple):
    """What one filter, or the truth, knows."""

    title: str
    colour: tuple[int, int, int]
    path: Floats
    """(T, 2 or 3) [m]; a row of NaN interrupts it."""
    landmarks: Floats = np.zeros((0, 2))
    """(n, 2) [m]"""
    Sigma: Floats = np.zeros((0, 2, 2))
    """(n, 2, 2) [m^2]; (0, 2, 2) where there is none."""
    walls: Walls = NO_WALLS

    @property
    def has_walls(self) -> bool:
        """Or else landmarks."""
        return len(self.walls.ends) > 0

    def points(self) -> Floats:
        """(N, 2) [m] all that the picture must hold."""
        return np.concatenate([self.path[:, :2], self.landmarks, self.walls.ends.reshape(-1, 2)])


NO_TRUTH = Layer("", (0, 0, 0), np.zeros((0, 2)))


def truth_layer(title: str, colour: tuple[int, int, int], path: Floats, theta: Floats) -> Layer:
    """True landmarks (n, 2) or walls (n, 4) x0 y0 x1 y1 [m]."""
    if theta.shape[1] == 2:
        return Layer(title, colour, path, theta)
    n = len(theta)
    return Layer(title, colour, path, walls=Walls(theta.reshape(n, 2, 2), np.zeros((n, 2), np.bool_), np.zeros((n, 2))))


def map_layer(
    title: str, colour: tuple[int, int, int], path: Floats, feature: Any, theta: Floats, Sigma: Floats
) -> Layer:
    """Features theta (n, D) of a kind, with covariances Sigma (n, 2, 2) of their uncertain coordinates."""
    if not isinstance(feature, Wall):
        return Layer(title, colour, path, theta, Sigma)
    lever = np.stack([np.ones((len(theta), 2)), theta[:, 3:5]], axis=-1)
    variance = np.einsum("nei,nij,nej->ne", lever, Sigma, lever)
    walls = Walls(ends(theta), theta[:, 5:7] > 0.0, np.sqrt(np.maximum(variance, 0.0)))
    return Layer(title, colour, path, walls=walls)


def draw_map(title: str, truth: Layer, layers: list[Layer], scanned: Floats = NO_TRUTH.path) -> str:
    """The picture of all layers on top of the truth, which is drawn broad and pale, its landmarks as crosses.

    scanned (N, 2) [m]: places that the laser saw, as far as they are within the picture; behind everything.
    """
    points = np.concatenate([layer.points() for layer in (truth, *layers)])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    extent = np.maximum(high - low, 0.02 * max(float((high - low).max()), 1.0))
    scale = min((WIDTH - 2 * MARGIN) / extent[0], (LARGEST_HEIGHT - 2 * MARGIN) / extent[1])
    height = HEADER + FOOTER + 2 * MARGIN + scale * extent[1]
    left = 0.5 * (WIDTH - scale * extent[0])  # a tall map stands in the middle

    def place(p: Floats) -> Floats:
        """(..., 2) picture coordinates of points in metres."""
        x = left + scale * (p[..., 0] - low[0])
        y = HEADER + MARGIN + scale * (high[1] - p[..., 1])
        return np.stack([x, y], axis=-1)

    foot = height - 0.5 * FOOTER
    body = [f"<text x='{MARGIN}' y='26' {FONT} font-size='15' fill='{INK}'>{escape(title)}</text>"]
    body += _cells(place(scanned), height)
    if len(truth.path):
        body.append(_route(place(truth.path), truth.colour, width=2.5 if truth.has_walls else 5, opacity=TRUTH_OPACITY))
    body += _crosses(place(truth.landmarks), truth.colour)
    body += _lines(place(truth.walls.ends), truth.colour, width=5, opacity=TRUTH_OPACITY)
    for layer in layers:
        body.append(_route(place(layer.path), layer.colour, width=1.0 if layer.has_walls else 1.6, opacity=0.95))
        body += _ellipses(layer, place, scale)
        body += _dots(place(layer.landmarks), layer.colour)
        body += _bands(layer, place, scale)
        body += _lines(place(layer.walls.ends), layer.colour, width=1.6, opacity=0.95)
        body += _ends(place(layer.walls.ends)[layer.walls.seen], layer.colour)
    shown = [truth, *layers] if len(truth.points()) else layers
    shown += [Layer("seen by the laser", SCANNED, scanned)] if len(scanned) else []
    body += _legend(shown, truth.title, foot)
    if any(layer.has_walls for layer in layers):
        body.append(f"<text x='{MARGIN}' y='{foot + 19:.0f}' {FONT} font-size='11' fill='{INK}'>{ENDS}</text>")
    body += _scale_bar(scale, foot)
    size = f"width='{WIDTH}' height='{height:.0f}' viewBox='0 0 {WIDTH} {height:.0f}'"
    background = f"<rect width='100%' height='100%' fill='{PAPER}'/>"
    return "\n".join([f"<svg xmlns='http://www.w3.org/2000/svg' {size}>", background, *body, "</svg>"]) + "\n"


def _hex(colour: tuple[int, int, int]) -> str:
    return "#" + "".join(f"{int(part):02x}" for part in colour[:3])


def _cells(points: Floats, height: float) -> Iterator[str]:
    """The pixels that points fall into, as horizontal runs in one element: each with the way from the one before."""
    inside = (points >= [0, HEADER]).all(axis=1) & (points < [WIDTH, height - FOOTER]).all(axis=1)
    cells = np.unique(points[inside].astype(np.int64)[:, ::-1], axis=0)
    if not len(cells):
        return
    begins = np.flatnonzero((np.diff(cells, axis=0, prepend=-2) != [0, 1]).any(axis=1))
    y, x = cells[begins].T
    long = np.diff(begins, append=len(cells))
    dx, dy = np.diff(x, prepend=0) - np.append(0, long[:-1]), np.diff(y, prepend=0)
    d = "".join(f"m{a} {b}h{n}" for a, b, n in zip(dx.tolist(), dy.tolist(), long.tolist(), strict=True))
    yield f"<path class='scanned' d='{d}' transform='translate(0 .5)' stroke='{_hex(SCANNED)}' fill='none'/>"


def _route(points: Floats, colour: tuple[int, int, int], width: float, opacity: float) -> str:
    """One element for all pieces, so that they do not darken where they overlap."""
    pieces = np.split(points, np.flatnonzero(~np.isfinite(points).all(axis=1)))
    lines = (" ".join(f"{x:.1f},{y:.1f}" for x, y in piece if np.isfinite(x)) for piece in pieces)
    return (
        f"<path class='route' d='{' '.join(f'M{line}' for line in lines if line)}' fill='none' stroke='{_hex(colour)}' "
        f"stroke-width='{width}' stroke-opacity='{opacity}' stroke-linejoin='round' stroke-linecap='round'/>"
    )


def _lines(walls: Floats, colour: tuple[int, int, int], width: float, opacity: float) -> Iterator[str]:
    """Walls (n, 2, 2) in one element, so that they do not darken where they overlap."""
    if len(walls):
        d = "".join(f"M{x0:.1f},{y0:.1f}L{x1:.1f},{y1:.1f}" for (x0, y0), (x1, y1) in walls)
        yield (
            f"<path class='walls' d='{d}' fill='none' stroke='{_hex(colour)}' stroke-width='{width}' "
            f"stroke-opacity='{opacity}'/>"
        )


def _bands(layer: Layer, place: Callable[[Floats], Floats], scale: float) -> Iterator[str]:
    """2 sigma to both sides of each wall; bands that are hardly wider than the wall are left out."""
    along = layer.walls.ends[:, 1] - layer.walls.ends[:, 0]
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)
    aside = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
    half = 2.0 * layer.walls.deviation
    wide = scale * half.max(axis=1, initial=0.0) > 1.5
    for a_b, half_widths, normal in zip(layer.walls.ends[wide], half[wide], aside[wide], strict=True):
        sides = half_widths[:, None] * normal
        corners = place(np.concatenate([a_b + sides, (a_b - sides)[::-1]]))
        outline = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        yield f"<polygon points='{outline}' fill='{_hex(layer.colour)}' fill-opacity='0.15'/>"


def _crosses(points: Floats, colour: tuple[int, int, int]) -> Iterator[str]:
    for x, y in points:
        yield (
            f"<path d='M{x - 5:.1f},{y:.1f}h10M{x:.1f},{y - 5:.1f}v10' stroke='{_hex(colour)}' stroke-width='1.3' "
            "stroke-opacity='0.8'/>"
        )


def _dots(points: Floats, colour: tuple[int, int, int]) -> Iterator[str]:
    for x, y in points:
        yield f"<circle cx='{x:.1f}' cy='{y:.1f}' r='2.6' fill='{_hex(colour)}' fill-opacity='0.85'/>"


def _ends(points: Floats, colour: tuple[int, int, int]) -> Iterator[str]:
    """Small dots, in one element: there may be thousands."""
    if len(points):
        d = "".join(f"M{x:.1f},{y:.1f}h0" for x, y in points)
        yield f"<path class='ends' d='{d}' stroke='{_hex(colour)}' stroke-width='3.4' stroke-linecap='round'/>"


def _ellipses(layer: Layer, place: Callable[[Floats], Floats], scale: float) -> Iterator[str]:
    """2 sigma; ellipses too small to be seen are left out."""
    if not len(layer.Sigma):
        return
    half, direction = ellipse_axes(layer.Sigma)
    for (x, y), (a, b), angle in zip(place(layer.landmarks), 2 * scale * half, direction, strict=True):
        if a > 2.6:
            yield (
                f"<ellipse cx='{x:.1f}' cy='{y:.1f}' rx='{a:.1f}' ry='{max(b, 0.5):.1f}' "
                f"transform='rotate({-math.degrees(angle):.1f} {x:.1f} {y:.1f})' fill='{_hex(layer.colour)}' "
                f"fill-opacity='0.12' stroke='{_hex(layer.colour)}' stroke-opacity='0.7'/>"
            )


def _legend(layers: list[Layer], pale: str, y: float) -> Iterator[str]:
    x = float(MARGIN)
    for layer in layers:
        ends = f"x1='{x}' y1='{y:.1f}' x2='{x + 22}' y2='{y:.1f}'"
        opacity = TRUTH_OPACITY if layer.title == pale else 1
        yield f"<line {ends} stroke='{_hex(layer.colour)}' stroke-opacity='{opacity}' stroke-width='5'/>"
        yield f"<text x='{x + 28}' y='{y + 4:.1f}' {FONT} font-size='13' fill='{INK}'>{escape(layer.title)}</text>"
        x += 28 + 7.5 * len(layer.title) + 22


def _scale_bar(scale: float, y: float) -> Iterator[str]:
    """A round number of metres, as long as fits in about a sixth of the width."""
    metres = _round_below(WIDTH / 6 / scale)
    x2, x1 = WIDTH - MARGIN, WIDTH - MARGIN - scale * metres
    yield f"<path d='M{x1:.1f},{y - 5:.1f}v10M{x1:.1f},{y:.1f}H{x2}M{x2},{y - 5:.1f}v10' stroke='{INK}' fill='none'/>"
    yield (
        f"<text x='{0.5 * (x1 + x2):.1f}' y='{y - 8:.1f}' {FONT} font-size='13' fill='{INK}' "
        f"text-anchor='middle'>{metres:g} m</text>"
    )


def _round_below(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not larger."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step for step in (power, 2 * power, 5 * power) if step <= value)
