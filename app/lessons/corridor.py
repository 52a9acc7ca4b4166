"""The corridor: what one particle can leave open (Fig. 13)."""

from __future__ import annotations

from app.lessons.columns import ERROR_END, NEES, deviation
from app.lessons.lesson import Finding, Lesson, Numbers, Variant, metres

ONE, MANY = "1 particle", "30 particles"

NEAR, FAR = 13, 100
"""[steps] of 0.4 m: 5 m and 40 m from the start."""


def _claim(n: Numbers) -> Finding:
    near, far = n[ONE, "dfs", f"x {NEAR}"], n[ONE, "dfs", f"x {FAR}"]
    many, fast = n[MANY, "dfs", f"x {FAR}"], n[ONE, "fs2", f"x {FAR}"]
    across = n[ONE, "dfs", f"y {FAR}"], n[MANY, "dfs", f"y {FAR}"]
    seen = far >= 2 * near and abs(far / many - 1) <= 0.1 and fast <= 0.2 * far and across[0] <= 0.7 * across[1]
    return Finding(
        seen,
        f"One particle of Dual FastSLAM believes to be {metres(near)} off along the corridor after 5 m and "
        f"{metres(far)} after 40 m, as 30 particles do ({metres(many)}); one of FastSLAM 2.0 {metres(fast)}. "
        f"Across the corridor one "
        f"Dual particle says {metres(across[0])}, 30 say {metres(across[1])}.",
    )


LESSON = Lesson(
    name="corridor",
    title="The corridor: what one particle can leave open",
    idea="""\
A laser in a long corridor without doors (Fig. 13 of the paper). Both walls tell how far the robot is to the
side and where it looks. Nothing tells how far along it is: a wall is the same after a step along itself. So a
wall observation has two components,

$wall$

and the third direction stays with the odometry, whose error grows from metre to metre:

$predict$""",
    question="""\
How many particles does a filter need to say rightly how uncertain it is along the corridor after 40 m: 30,
300, one? And across? Decide for Dual FastSLAM, FastSLAM 2.0 and FastSLAM 1.0 before you look.""",
    watch="""\
- **The ellipse** of the best particle of Dual FastSLAM: long and narrow, and longer with every metre.
- **NEES** of the runs with one particle: Dual FastSLAM is far less wrong about itself than the others;
  FastSLAM 1.0, which believes nothing at all, is infinitely wrong.
- **The maps of all particles**, with 30 of them: a bundle that opens to the sides along the way. That is the
  uncertainty across, and no single map has it.""",
    point="""\
Along the corridor the uncertainty is in P, and one Dual particle carries it to the end, where the end wall
would settle it in one step. One FastSLAM 2.0 particle draws its pose at every step and forgets what it does
not know; it needs a cloud of others to remember. Across, it is the other way: how far the corridor bends from
the straight line is in the *map*, and that is what Dual FastSLAM samples. Ask of every filter what is sampled
and what is Gaussian, and you know what a single particle can say.""",
    measured="""\
In 20 of 20 seeds (0 to 19). Over 200 seeds the deviation along the corridor that one Dual particle reports
after 40 m is 1.05 +- .05 of its true error, that of one FastSLAM 2.0 particle, past closed doors, .07
(`dualslam study corridor-spread`, with and without `--doors none`). In this corridor there are no doors;
where they stand open to rooms, the way along is in the map as well, and frozen with it.""",
    variants=(
        Variant(ONE, "corridor --doors none --particles 1 --steps 100"),
        Variant(MANY, "corridor --doors none --particles 30 --steps 100"),
    ),
    columns=(
        deviation(0, NEAR, "along, 5 m"),
        deviation(0, FAR, "along, 40 m"),
        deviation(1, FAR, "across, 40 m"),
        ERROR_END,
        NEES,
    ),
    claim=_claim,
)
