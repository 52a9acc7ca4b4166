"""Closing a loop of 100 m with 30 particles (Fig. 10)."""

from __future__ import annotations

from app.lessons.columns import DUPLICATES, ERROR_END, ODOMETRY, diversity
from app.lessons.lesson import Finding, Lesson, Numbers, Variant, count, metres

FEW = "30 particles"


def _claim(n: Numbers) -> Finding:
    dual, second, first = (n[FEW, key, "error end"] for key in ("dfs", "fs2", "fs1"))
    odometry = n[FEW, "dfs", "odometry"]
    twice = n[FEW, "dfs", "duplicates"], n[FEW, "fs1", "duplicates"]
    seen = dual <= 0.5 and odometry >= 4 * dual and twice[1] >= 3 * max(twice[0], 1)
    return Finding(
        seen,
        f"After {DISTANCE:.0f} m dead reckoning is {metres(odometry)} off, Dual FastSLAM {metres(dual)}, FastSLAM 2.0 "
        f"{metres(second)} and FastSLAM 1.0 {metres(first)}; Dual FastSLAM has mapped {count(twice[0])} walls twice, "
        f"FastSLAM 1.0 {count(twice[1])}.",
    )


DISTANCE = 127.0
"""[m] driven: one lap, and on through ground that is known."""

LESSON = Lesson(
    name="loop",
    title="Closing a loop of 100 m with 30 particles",
    idea="""\
A laser, and corridors around a block: 100 m round, then on into ground that was seen at the beginning (Fig.
10 of the paper). Odometry is 10 % off. Which wall is which nobody tells: pieces of wall are matched jointly
(JCBB) with those of each particle's own map, within gates that V makes wide or narrow,

$innovation$

To close the loop, one particle must have a map on which the beginning lies where the robot now sees it. It
must have survived 100 m of resamplings. In worlds of walls all weights are tempered here (`temper` 0.1): scan
after scan of the same wall is no independent evidence.""",
    question="""\
Dead reckoning is metres off after one lap. 30 particles each: which of the three filters will know the first
walls again, and which will map them a second time, beside the first? What would you see in the ancestry of
one that does not?""",
    watch="""\
- **The map** when the robot comes round the last corner: the walls of the beginning are matched (yellow) or
  new (violet).
- **Events**: *closed a loop*, with the distance since the wall was last seen.
- **Ancestry** and diversity just before: how many founders of the first corridor are still there to choose
  from?
- **The maps of all particles**: the bundle opens along the way, and closes with the loop.""",
    point="""\
A loop is closed by what was not thrown away on the way. Dual FastSLAM keeps what the scans do not tell in P,
is seldom forced to resample, and with 30 maps has one that meets its beginning. FastSLAM 1.0 has one founder
left long before; the right past is no longer among its particles, and no cleverness at the end brings it
back. Duplicates, walls that are mapped twice, are the trace that a missed closure leaves.""",
    measured="""\
In 14 of 20 seeds (0 to 19), and in the medians over all of them. Dual FastSLAM ended 5 to 74 cm off, FastSLAM
2.0 10 to 80 cm, dead reckoning 0.7 to 9.2 m. In the six others Dual FastSLAM was more than half a metre off,
dead reckoning was lucky, or FastSLAM 1.0, which now and then closes the loop, had mapped few walls twice.
`dualslam study loop-closure` counts closed loops over more seeds.""",
    variants=(Variant(FEW, "loop --particles 30"),),
    columns=(ERROR_END, ODOMETRY, DUPLICATES, diversity(-1)),
    claim=_claim,
)
