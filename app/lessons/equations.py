"""The equations of the lessons, as a terminal can show them and as TeX; numbers are those of the paper.

The font in which Rerun's viewer writes what has a fixed width lacks small raised and lowered letters: with one of them
the viewer ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Equation(NamedTuple):
    """One line of mathematics."""

    plain: str
    """In letters that any terminal has, and Rerun; a dash behind a letter is the transpose."""
    tex: str
    """As Matplotlib's mathtext knows it."""


def as_text(equations: Sequence[Equation]) -> str:
    """Markdown: a block, which keeps their spaces."""
    return "\n".join(["```text", *(equation.plain for equation in equations), "```"])


EQUATIONS = {
    "fastslam": Equation(
        "p(path, map | z, u)  =  p(path | z, u) · Π p(θ_i | path, z)",
        r"p(s_{1:t},\Theta \mid z,u) = p(s_{1:t} \mid z,u)\ \prod_i\, p(\theta_i \mid s_{1:t},z)",
    ),
    "dual": Equation(
        "p(pose, map | z, u)  =  p(map | z, u) · p(pose | map, z, u)",
        r"p(s_t,\Theta \mid z,u) = p(\Theta \mid z,u)\ p(s_t \mid \Theta,z,u)",
    ),
    "innovation": Equation(
        "V = G_s P G_s' + G_θ Σ G_θ' + R                             (23)",
        r"V = G_s P\,G_s^T + G_\theta \Sigma\,G_\theta^T + R\qquad (23)",
    ),
    "weight": Equation(
        "w ~ N(v; 0, V) = |2π V|^(-1/2) · exp(-v' V^-1 v / 2)        (43)",
        r"w \propto N(v;\,0,V) = |2\pi V|^{-1/2}\,\exp(-\frac{1}{2}\,v^T V^{-1} v)\qquad (43)",
    ),
    "n-eff": Equation(
        "N_eff = 1 / Σ w_i²,  resample when N_eff < 0.75 K           (44)",
        r"N_{eff} = 1 \,/\, \sum_i w_i^2,\qquad N_{eff} < 0.75\,K\ \rightarrow\ resample\qquad (44)",
    ),
    "drawn-from-controls": Equation(
        "s ~ h(s, u) + noise,   P = 0                                (11)",
        r"s \sim h(s,u) + noise,\qquad P = 0\qquad (11)",
    ),
    "drawn-with-observation": Equation(
        "s ~ p(s | earlier s, u, z, map),   then P = 0               (12)",
        r"s_t \sim p(s_t \mid s_{t-1},u,z,\Theta),\qquad then\ P = 0\qquad (12)",
    ),
    "predict": Equation(
        "s = h(s, u),   P = H_s P H_s' + Q                           (21)",
        r"s = h(s,u),\qquad P = H_s P\,H_s^T + Q\qquad (21)",
    ),
    "new-feature": Equation(
        "θ ~ N(f(s, z), F_s P F_s' + F_z R F_z'),   then frozen      (34)",
        r"\theta \sim N(f(s,z),\ F_s P\,F_s^T + F_z R\,F_z^T),\qquad then\ frozen\qquad (34)",
    ),
    "static-map": Equation(
        "θ stays as it is,   Σ = 0                              (29, 30)",
        r"\theta_t = \theta_{t-1},\qquad \Sigma = 0\qquad (29, 30)",
    ),
    "marginal": Equation(
        "marginal:   w = N(v_1; 0, V_1) · N(v_2; 0, V_2) · ...        (43)",
        r"marginal:\quad w = \prod_i\, N(v_i;\,0,V_i)\qquad (43)",
    ),
    "joint": Equation(
        "joint:      w = p(z_1) · p(z_2 | z_1) · p(z_3 | z_1, z_2) · ...",
        r"joint:\quad w = p(z_1)\ p(z_2 \mid z_1)\ p(z_3 \mid z_1,z_2)\ \ldots",
    ),
    "wall": Equation(
        "v = (lateral offset, angle) of the piece seen, from the wall of the map",
        r"v = (lateral\ offset,\ angle)",
    ),
    "nees": Equation(
        "NEES = e' P^-1 e,   e = true position - estimate;   2 in the mean",
        r"NEES = e^T P^{-1} e,\qquad e = x - \hat{x},\qquad E[NEES] = 2",
    ),
}
"""By the name that the texts have for them."""
