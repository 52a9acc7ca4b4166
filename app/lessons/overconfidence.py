"""Overconfidence: NEES beside N_eff."""

from __future__ import annotations

from app.lessons.columns import ERROR, N_EFF, NEES, diversity
from app.lessons.lesson import Finding, Lesson, Numbers, Variant, count, percent

HONEST, SURE, CLONES = "honest", "believes its wheels", "one founder left"


def _claim(n: Numbers) -> Finding:
    nees = [n[name, "dfs", "nees"] for name in (HONEST, SURE, CLONES)]
    n_eff = [n[name, "dfs", "n_eff"] for name in (HONEST, SURE, CLONES)]
    seen = min(n_eff) >= 0.75 and nees[0] <= 7.4 and nees[1] >= 3 * nees[0] and nees[2] >= 50
    return Finding(
        seen,
        f"N_eff is {percent(n_eff[0])}, {percent(n_eff[1])} and {percent(n_eff[2])} of K: all three look healthy. NEES "
        f"is {count(nees[0])}, {count(nees[1])} and {count(nees[2])}; an honest filter has about 1.4 in the median.",
    )


LESSON = Lesson(
    name="overconfidence",
    title="Overconfidence: look at NEES beside N_eff",
    idea="""\
N_eff compares the particles with each other:

$n-eff$

NEES compares the estimate with the truth, in units of what the filter believes:

$nees$

Three Dual FastSLAM runs on the same 40 m. The first is honest, with one landmark in view at a time. The
second believes that its odometry is three times better than it is (the world is as before). The third is
honest again, but sees three landmarks at once and weighs them exactly, which leaves one founder after a few
steps (lesson `one-landmark-too-many`).""",
    question="""\
N_eff is the number that everybody plots. Which of the three runs will it warn you of? In a run whose
particles are all copies of one, what is N_eff?""",
    watch="""\
- **N_eff** and **NEES** of the three runs, one below the other, with the resampling threshold and the 95 %
  band.
- **Diversity** of the third: it fell before N_eff could tell, and N_eff is high **because** it fell.
- The truth and the ellipses in the close-up: far outside of them, or within.""",
    point="""\
N_eff is blind to what all particles have in common: a belief that is too good, or a past that they share.
Right after a resampling it is K by definition. Overconfidence shows in NEES, where somebody knows the truth,
and otherwise in the innovations (NIS) and the ancestry. A filter that is too sure is more dangerous than one
with a larger error: whoever plans by it does not know that there is anything to be careful about.""",
    measured="""\
In 18 of 20 seeds (0 to 19); in the others the honest run was unlucky, or the sure one lucky. Errors of
successive steps are nearly the same error, so that the NEES of one run, honest or not, is one throw of the
dice: over the runs its median was 0.08 to 9.0 for the honest filter, 1.6 to 110 for the one that believes its
wheels, 290 to 25000 with one founder left. To judge a filter take many runs.""",
    variants=(
        Variant(HONEST, "paper-line --layout sparse --filters dfs"),
        Variant(SURE, "paper-line --layout sparse --filters dfs --believed.speed 0.1 --believed.turn 1"),
        Variant(CLONES, "paper-line --filters dfs --weighting joint"),
    ),
    columns=(N_EFF, diversity(-1), NEES, ERROR),
    claim=_claim,
)
