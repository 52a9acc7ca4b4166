"""One landmark too many: when Dual FastSLAM depletes, and what inflate_R buys."""

from __future__ import annotations

from app.lessons.columns import ERROR, NEES, RESAMPLINGS, diversity
from app.lessons.lesson import Finding, Lesson, Numbers, Variant, count, percent

ONE, TWO, THREE = "one landmark", "two landmarks", "three landmarks"
MARGINAL, INFLATED = "three, marginal weights", "three, R times 16"


def _claim(n: Numbers) -> Finding:
    later, early = "diversity 20", "diversity 5"
    one, three = n[ONE, "dfs", later], n[THREE, "dfs", later]
    first = [n[name, "dfs", early] for name in (ONE, TWO, THREE)]
    marginal, inflated = n[MARGINAL, "dfs", later], n[INFLATED, "dfs", later]
    sure, modest = n[THREE, "dfs", "nees"], n[INFLATED, "dfs", "nees"]
    seen = (
        one >= 0.9
        and n[ONE, "dfs", "resamplings"] == 0
        and three <= 0.12
        and first[0] > first[1] > first[2]
        and min(marginal, inflated) >= 2 * three
        and sure >= 20 * modest
    )
    return Finding(
        seen,
        f"With one, two and three landmarks in view {percent(first[0])}, {percent(first[1])} and {percent(first[2])} "
        f"of the founders are left after five observations. After twenty of three landmarks it is {percent(three)} "
        f"with joint weights, {percent(marginal)} with marginal ones "
        f"and {percent(inflated)} with 16 times R, which takes NEES "
        f"from {count(sure)} to {count(modest)}.",
    )


LESSON = Lesson(
    name="one-landmark-too-many",
    title="One landmark too many: when Dual FastSLAM depletes",
    idea="""\
A Dual FastSLAM particle has a frozen map and a pose with three unknowns (x, y, heading). A landmark gives two
numbers, range and bearing. One landmark: two numbers for three unknowns, and there is always a pose that
fits. Two: four numbers. Three: six, twice as many as the pose has freedom, and what the pose cannot explain
is the **shape** of the map, drawn with an error and frozen. Only the weight is left to judge it:

$joint$

$marginal$

The exact likelihood (joint) weighs each observation after the pose was corrected on those before; the paper
(marginal) weighs all of them at the predicted pose, whose large P forgives much. `--inflate-r X` multiplies R
wherever known landmarks are used, but not where new ones are drawn: the map may be a little wrong.""",
    question="""\
25 particles, a very good sensor, joint weights, known association. How many landmarks in view does it take
until the filter has lost nearly all of its founders after twenty observations? And would a sensor that is
*believed* to be worse help?""",
    watch="""\
- **Diversity** with one, two and three landmarks: a flat line, a slope, a cliff.
- **NEES**: after the cliff the one map that is left is trusted completely, and wrong.
- **Events**: *is depleted* says which observation decided, and that it is not the first of the step.
- The same with `dualslam diagnose FILE.rrd`, which names the cause.""",
    point="""\
What depletes Dual FastSLAM is not the pose but the shape of the map: 2 n - 3 numbers that no pose explains, n
the landmarks in view. Joint weights take them at face value, with the R of the sensor, and the particle whose
drawn triangle is nearest wins everything. Marginal weights hide it behind P; that is not the Bayes posterior,
but with few particles it keeps hypotheses alive. Inflating R says openly what is true of a frozen map: it is
wrong by more than the sensor is. Neither costs accuracy in the median of many seeds.""",
    measured="""\
In 18 of 20 seeds (0 to 19); in the other two the run with 16 times R was sure of something wrong as well.
After five observations one landmark left all founders in every run, two 16 to 52 %, three 8 to 32 %. That the
inflated R costs no accuracy is true of these medians (error 9 cm, with 16 times R 6 cm), not of every run.""",
    variants=(
        Variant(ONE, "paper-line --layout one-far --filters dfs --weighting joint"),
        Variant(TWO, "paper-line --layout two-far --filters dfs --weighting joint"),
        Variant(THREE, "paper-line --filters dfs --weighting joint"),
        Variant(MARGINAL, "paper-line --filters dfs --weighting marginal"),
        Variant(INFLATED, "paper-line --filters dfs --weighting joint --inflate-r 16"),
    ),
    columns=(diversity(5), diversity(20), diversity(-1), RESAMPLINGS, ERROR, NEES),
    claim=_claim,
)
