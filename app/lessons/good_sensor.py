"""The good sensor that starves FastSLAM 1.0."""

from __future__ import annotations

from app.lessons.columns import ERROR, N_EFF, RESAMPLINGS, diversity
from app.lessons.lesson import Finding, Lesson, Numbers, Variant, percent

COARSE, FINE, MANY = "coarse sensor", "fine sensor", "fine sensor, 1000 particles"


def _claim(n: Numbers) -> Finding:
    coarse, fine = n[COARSE, "fs1", "diversity 5"], n[FINE, "fs1", "diversity 5"]
    few, many = n[FINE, "fs1", "n_eff"], n[MANY, "fs1", "n_eff"]
    seen = coarse >= 5 * fine and fine <= 0.08 and few <= 0.08 and many <= 0.01
    return Finding(
        seen,
        f"After five observations FastSLAM 1.0 has {percent(coarse)} of its founders with the coarse sensor and "
        f"{percent(fine)} with the fine one; there N_eff is {25 * few:.1f} of 25 particles in the median, and "
        f"{1000 * many:.1f} of 1000.",
    )


LESSON = Lesson(
    name="good-sensor",
    title="The good sensor that starves FastSLAM 1.0",
    idea="""\
A robot drives 40 m past five landmarks (`paper-line`, the simulation of the Dual FastSLAM paper). It knows
which landmark is which. Its odometry is poor; its sensor is either coarse (30 cm, 1 degree) or very good (3
mm, 0.003 degrees).

FastSLAM 1.0 moves each particle by the controls alone, somewhere within the noise of the odometry,

$drawn-from-controls$

and then asks the observations how good the guess was:

$weight$

With P = 0, V is as small as the sensor is good. N_eff tells how many particles still count:

$n-eff$""",
    question="""\
Everything but the sensor is the same. With which one does FastSLAM 1.0 keep more of its 25 particles alive,
the coarse or the hundred times better one? And if one of them starves it, how many particles would help: 50,
100, 1000?""",
    watch="""\
- **Particles** at the first steps, on the timeline `stage`: *predicted* is a cloud some centimetres wide,
  *weighted* a single bright dot. The place where the likelihood is large is millimetres wide; whoever is
  nearest takes all.
- **N_eff and diversity**: N_eff close to one at every step, diversity 1/K within a few steps.
- **Ancestry**: one line, with everything else cut off at once.""",
    point="""\
A particle filter that proposes without looking at the observation needs particles as dense as the sensor is
precise. A better sensor makes it **worse** at keeping hypotheses: forty times as many particles still leave
one. The pose error need not show it at once. What is lost are the other possible pasts, and with them the way
back out of an error. Do not cure it by blaming the sensor: propose better (lesson `improved-proposal`), or do
not sample the pose at all (lesson `dual-idea`).""",
    measured="""\
In 20 of 20 seeds (0 to 19). After five observations the coarse sensor left 44 to 100 % of the founders, the
fine one a single founder in every run, with 25 particles as well as with 1000. Weights are kept as
logarithms: it is not underflow.""",
    variants=(
        Variant(COARSE, "paper-line --filters fs1 --noise.range 0.3 --noise.bearing 1"),
        Variant(FINE, "paper-line --filters fs1"),
        Variant(MANY, "paper-line --filters fs1 --particles 1000"),
    ),
    columns=(diversity(5), diversity(20), N_EFF, RESAMPLINGS, ERROR),
    claim=_claim,
)
