"""Rotation, then a corridor: when the map begins with an uncertain heading (Fig. 14)."""

from __future__ import annotations

from app.lessons.columns import ERROR_END, NEES, deviation
from app.lessons.lesson import Finding, Lesson, Numbers, Variant, count, metres

ONE, FEW, MANY = "1 particle", "30 particles", "300 particles"


def _claim(n: Numbers) -> Finding:
    one, few, many = (n[name, "dfs", "y -1"] for name in (ONE, FEW, MANY))
    along = n[FEW, "dfs", "x -1"]
    lone, some = n[ONE, "dfs", "nees"], n[FEW, "dfs", "nees"]
    seen = few >= 0.5 * many and one <= 0.1 * many and few >= 2 * along and lone >= 20 * some
    return Finding(
        seen,
        f"At the end of the corridor 30 maps say that the robot may be {metres(few)} to the side ({metres(along)} "
        f"along), 300 maps {metres(many)}; a single map says {metres(one)}, with a NEES of {count(lone)} "
        f"against {count(some)}.",
    )


LESSON = Lesson(
    name="rotation",
    title="Rotation, then a corridor",
    idea="""\
The robot turns once on the spot in a lobby in which it sees nothing, then enters a corridor (Fig. 14 of the
paper). Its odometry is 10 % off, so after 360 degrees it has lost its heading by several degrees: P has a
large entry there.

$predict$

Now it sees the first wall, and every Dual FastSLAM particle draws how that lies:

$new-feature$

The heading was one number in one P; a moment later each particle has a corridor of its own, frozen at its own
angle.""",
    question="""\
The corridor is straight and 60 m long. Where will the particles' corridors end, and what shape has the cloud
of robots at the end of it? Could one particle, with its Gaussian pose, say the same? Sketch it before you
look.""",
    watch="""\
- **Maps of all particles** (the tab of Dual FastSLAM): a fan that opens from the lobby; each blade is a whole
  corridor.
- **The particles** at the end lie on an arc, a banana that no single ellipse would fit. Each has a thin
  ellipse along its own corridor.
- **NEES**: near its band with 30 particles, far beyond it with one.""",
    point="""\
Uncertainty moves: from P into the sampled map at the moment in which something new is drawn. After that the
particles are the only ones that know of it. The shape is not Gaussian in x and y, and need not be; that is
what samples are good for. Thirty are enough for the width, since one angle is a single number to sample; but
they must not be resampled away before something tells which of them is right, and nothing in the corridor
does.""",
    measured="""\
In 20 of 20 seeds (0 to 19). At the end 30 maps said 3.9 to 9.3 m across, 300 maps 6.1 to 7.4 m, a single one
5 cm. True errors were 0.3 to 21 m: in one run by itself NEES may be small or large, since the one error of
the turn decides all of it.""",
    variants=(
        Variant(FEW, "rotation-then-corridor --filters dfs --particles 30"),
        Variant(ONE, "rotation-then-corridor --filters dfs --particles 1"),
        Variant(MANY, "rotation-then-corridor --filters dfs --particles 300"),
    ),
    columns=(deviation(0, -1, "along, end"), deviation(1, -1, "across, end"), ERROR_END, NEES),
    claim=_claim,
)
