"""The dual idea: the map is sampled, the pose is not."""

from __future__ import annotations

from app.lessons.columns import MAP, NEES, POSE, diversity
from app.lessons.lesson import Finding, Lesson, Numbers, Variant, metres, percent

COARSE, GOOD, BETTER = "coarse sensor", "good sensor", "ten times better"


def _claim(n: Numbers) -> Finding:
    end = "diversity -1"
    dual, fast = n[BETTER, "dfs", end], n[BETTER, "fs2", end]
    rough = n[COARSE, "dfs", "diversity 20"], n[COARSE, "fs2", "diversity 20"]
    pose, of_map = n[GOOD, "dfs", "pose"], n[GOOD, "fs2", "map"]
    kinds = pose > 0 and n[GOOD, "dfs", "map"] == 0 and n[GOOD, "fs2", "pose"] == 0 and of_map > 0
    seen = kinds and dual >= 0.8 and fast <= 0.2 and rough[0] < rough[1]
    return Finding(
        seen,
        f"A particle of Dual FastSLAM leaves {metres(pose)} of its pose open and nothing of its map, one of FastSLAM "
        f"2.0 {metres(of_map)} of each landmark and nothing of its pose. With the best sensor Dual FastSLAM ends with "
        f"{percent(dual)} of its founders, FastSLAM 2.0 with {percent(fast)}; with the coarse one they have "
        f"{percent(rough[0])} and {percent(rough[1])} after 20 steps.",
    )


LESSON = Lesson(
    name="dual-idea",
    title="The dual idea: the map is sampled, the pose is not",
    idea="""\
FastSLAM samples the path and keeps, for every path, a Gaussian of each landmark. If the path were known, the
landmarks would be easy. But the reverse holds as well: if the **map** were known, the **pose** would be easy,
one Kalman filter.

$fastslam$

$dual$

Dual FastSLAM samples maps. When a particle sees something new it draws where that is, once, from all that it
does not know of its pose and of the sensor; from then on the landmark stands still, and the pose is tracked
against it:

$new-feature$

$static-map$

$predict$

One formula serves both families, with the one or the other term empty after an observation:

$innovation$""",
    question="""\
Three sensors: coarse (30 cm, 1 degree), good (3 mm, 0.003 degrees), and ten times better than that. FastSLAM
loses its particles the faster the better the sensor is. What would you expect of a filter that samples
landmarks instead of poses? Which of the two suits a sonar, which a laser?""",
    watch="""\
- **Ellipses** around particles at the end of a step: Dual FastSLAM has them, FastSLAM 2.0 has points.
- **Maps of all particles** (the tab of a filter): Dual FastSLAM's are dots that never move; each particle has
  a world of its own, and its ellipse lives in that. FastSLAM's landmarks have ellipses that shrink.
- **Diversity** of the two under the three sensors.""",
    point="""\
What is sampled must be what is known well, since a few particles cannot cover what is not. With a good sensor
a landmark is nearly as certain as the pose from which it was seen, and drawing it costs little: Dual FastSLAM
keeps what the robot does not know in P, where no resampling destroys it. With a coarse sensor it is the other
way round: a map that is drawn from 30 cm of noise and frozen is wrong for ever, and most of them die. There
is no free lunch, there is a better place to put the uncertainty.""",
    measured="""\
In 20 of 20 seeds (0 to 19). With the good sensor, the one in the middle, Dual FastSLAM ended with 16 to 76 %
of its founders and FastSLAM 2.0 with 4 to 28 %. The weights of Dual FastSLAM are the paper's, marginal ones:
with joint weights it depletes here, which is another lesson (`one-landmark-too-many`).""",
    variants=(
        Variant(GOOD, "paper-line --vehicle ackermann --filters dfs fs2"),
        Variant(BETTER, "paper-line --vehicle ackermann --filters dfs fs2 --noise.range 0.0003 --noise.bearing 0.0003"),
        Variant(COARSE, "paper-line --vehicle ackermann --filters dfs fs2 --noise.range 0.3 --noise.bearing 1"),
    ),
    columns=(POSE, MAP, diversity(20), diversity(-1), NEES),
    claim=_claim,
)
