"""Equations as pictures, for pages that show no TeX."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence

from app.lessons.equations import Equation

SIZE = 11.0
"""[points] of the letters."""

COLOUR = "#e6e6e6"
"""On a dark page."""


def as_pictures(equations: Sequence[Equation]) -> str:
    """HTML: a picture each, which says in letters what it shows to whoever cannot see it."""
    style = "display:block; max-width:96%; margin:0.5em 1em"
    return "".join(
        f'<img src="{_picture(equation)}" alt="{html.escape(" ".join(equation.plain.split()))}" style="{style}">'
        for equation in equations
    )


def _picture(equation: Equation) -> str:
    """An SVG, as an address that has it inside."""
    import matplotlib as mpl
    from matplotlib.font_manager import FontProperties
    from matplotlib.mathtext import math_to_image

    drawn = io.BytesIO()
    with mpl.rc_context({"savefig.transparent": True}):
        math_to_image(f"${equation.tex}$", drawn, prop=FontProperties(size=SIZE), format="svg", color=COLOUR)
    return f"data:image/svg+xml;base64,{base64.b64encode(drawn.getvalue()).decode()}"
