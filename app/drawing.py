"""A map as an SVG picture: paths, landmarks with their 2-sigma ellipses, a scale bar, a legend.  y points up."""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape
from typing import NamedTuple

import numpy as np

from slam.geometry import ellipse_axes
from slam.types import Floats

WIDTH = 900
LARGEST_HEIGHT = 900
MARGIN = 36
TRUTH_OPACITY = 0.35
HEADER, FOOTER = 34, 46
INK, PAPER = "#33373d", "#ffffff"
FONT = "font-family='Helvetica, Arial, sans-serif'"


class Layer(NamedTuple):
    """What one filter, or the truth, knows."""

    title: str
    colour: tuple[int, int, int]
    path: Floats
    """(T, 2 or 3) [m]; a row of NaN interrupts it."""
    landmarks: Floats
    """(n, 2) [m]"""
    Sigma: Floats
    """(n, 2, 2) [m^2]; (0, 2, 2) where there is none."""


def draw_map(title: str, truth: Layer, layers: list[Layer]) -> str:
    """The picture of all layers on top of the truth, which is drawn as a broad pale path and crosses."""
    points = np.concatenate([p[:, :2] for layer in (truth, *layers) for p in (layer.path, layer.landmarks)])
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

    body = [f"<text x='{MARGIN}' y='26' {FONT} font-size='15' fill='{INK}'>{escape(title)}</text>"]
    if len(truth.path):
        body.append(_route(place(truth.path), truth.colour, width=5, opacity=TRUTH_OPACITY))
    body += _crosses(place(truth.landmarks), truth.colour)
    for layer in layers:
        body.append(_route(place(layer.path), layer.colour, width=1.6, opacity=0.95))
        body += _ellipses(layer, place, scale)
        body += _dots(place(layer.landmarks), layer.colour)
    shown = [truth, *layers] if len(truth.path) or len(truth.landmarks) else layers
    body += _legend(shown, truth.title, height - 0.5 * FOOTER)
    body += _scale_bar(scale, height - 0.5 * FOOTER)
    size = f"width='{WIDTH}' height='{height:.0f}' viewBox='0 0 {WIDTH} {height:.0f}'"
    background = f"<rect width='100%' height='100%' fill='{PAPER}'/>"
    return "\n".join([f"<svg xmlns='http://www.w3.org/2000/svg' {size}>", background, *body, "</svg>"]) + "\n"


def _hex(colour: tuple[int, int, int]) -> str:
    return "#" + "".join(f"{int(part):02x}" for part in colour[:3])


def _route(points: Floats, colour: tuple[int, int, int], width: float, opacity: float) -> str:
    """One element for all pieces, so that they do not darken where they overlap."""
    pieces = np.split(points, np.flatnonzero(~np.isfinite(points).all(axis=1)))
    lines = (" ".join(f"{x:.1f},{y:.1f}" for x, y in piece if np.isfinite(x)) for piece in pieces)
    return (
        f"<path class='route' d='{' '.join(f'M{line}' for line in lines if line)}' fill='none' stroke='{_hex(colour)}' "
        f"stroke-width='{width}' stroke-opacity='{opacity}' stroke-linejoin='round' stroke-linecap='round'/>"
    )


def _crosses(points: Floats, colour: tuple[int, int, int]) -> Iterator[str]:
    for x, y in points:
        yield (
            f"<path d='M{x - 5:.1f},{y:.1f}h10M{x:.1f},{y - 5:.1f}v10' stroke='{_hex(colour)}' stroke-width='1.3' "
            "stroke-opacity='0.8'/>"
        )


def _dots(points: Floats, colour: tuple[int, int, int]) -> Iterator[str]:
    for x, y in points:
        yield f"<circle cx='{x:.1f}' cy='{y:.1f}' r='2.6' fill='{_hex(colour)}' fill-opacity='0.85'/>"


def _ellipses(layer: Layer, place: object, scale: float) -> Iterator[str]:
    """2 sigma; ellipses too small to be seen are left out."""
    if not len(layer.Sigma):
        return
    half, direction = ellipse_axes(layer.Sigma)
    for (x, y), (a, b), angle in zip(place(layer.landmarks), 2 * scale * half, direction, strict=True):  # type: ignore[operator]
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
