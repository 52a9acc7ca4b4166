"""The gallery of mistakes: what classic bugs look like in the numbers."""

from __future__ import annotations

from app.lessons.columns import ERROR, N_EFF, NEES, RESAMPLINGS, diversity
from app.lessons.lesson import Finding, Lesson, Numbers, Variant, count, percent

RIGHT, SHARED, KEPT, UNSAMPLED, FIRST, ALWAYS, PLAIN = (
    "right",
    "shared maps",
    "weights not reset",
    "unsampled proposal",
    "features first",
    "resample always",
    "plain weights",
)


def _claim(n: Numbers) -> Finding:
    nees = {name: n[name, "fs2", "nees"] for name in (RIGHT, SHARED, KEPT, UNSAMPLED, FIRST)}
    times = {name: n[name, "fs2", "resamplings"] for name in (RIGHT, KEPT, ALWAYS)}
    looks = n[UNSAMPLED, "fs2", "n_eff"], n[UNSAMPLED, "fs2", "diversity -1"]
    early = n[FIRST, "fs2", "diversity 10"], n[RIGHT, "fs2", "diversity 10"]
    plain = n[PLAIN, "fs1", "resamplings"], n[RIGHT, "fs1", "resamplings"]
    seen = (
        min(looks) >= 0.99
        and all(nees[name] >= 3 * nees[RIGHT] for name in (SHARED, KEPT, UNSAMPLED, FIRST))
        and times[RIGHT] < times[KEPT] < times[ALWAYS]
        and early[0] <= 0.5 * early[1]
        and plain[0] < plain[1]
    )
    return Finding(
        seen,
        f"The unsampled proposal looks best, N_eff {percent(looks[0])}, diversity {percent(looks[1])}, and has a NEES "
        f"of {count(nees[UNSAMPLED])} where the right filter has {count(nees[RIGHT])}; shared maps have "
        f"{count(nees[SHARED])} and weights that are not reset {count(nees[KEPT])}. Features first leave "
        f"{percent(early[0])} of the founders after ten observations, not {percent(early[1])}. Resamplings: "
        f"{count(times[RIGHT])} if right, {count(times[KEPT])} with weights not reset, {count(times[ALWAYS])} always; "
        f"of FastSLAM 1.0 {count(plain[1])}, with plain weights {count(plain[0])}.",
    )


LESSON = Lesson(
    name="mistakes",
    title="A gallery of mistakes",
    idea="""\
Most particle filters that fail are not unlucky but wrong, and wrong ones run: they draw maps, and their error
may even be small. Here FastSLAM 2.0 is run as it should be, and with five classic mistakes; FastSLAM 1.0,
whose weights are the smallest, with a sixth.

- **shared maps**: the copies of a particle refer to one and the same map.
- **weights not reset**: after a resampling a copy still has the weight for which it was copied.
- **unsampled proposal**: the mean of the proposal is taken in place of a draw.
- **features first**: landmarks are corrected before the pose, which then meets an observation that it has
  seen already.
- **resample always**, whether or not weights differ.
- **plain weights**: products of densities, not sums of logarithms.

$drawn-with-observation$

$weight$

$n-eff$""",
    question="""\
Which of these mistakes would you find by looking at the error of the pose? Which by N_eff? One of them makes
the filter look **healthier** than the right one, by N_eff, by diversity and by how seldom it resamples.
Which?""",
    watch="""\
- **Particles** with the unsampled proposal: one point. All are copies, although each has a founder of its
  own.
- **NEES** of the runs, beside their N_eff.
- **Ancestry** with resampling at every step: lines that end for no reason.
- What `dualslam diagnose FILE.rrd` says of a run that was recorded with `dualslam run ... --mistake NAME
  --record FILE.rrd`: it names mistakes by their numbers.""",
    point="""\
No single number tells whether a filter is right. N_eff is perfect where all particles are the same; the error
is small where the odometry was; diversity is full where nothing is ever resampled. Look at what **must** be
so: weights are equal after a resampling, draws differ from their mean, a map has only what its particle has
seen. And test with truth: NEES finds most of them. Two more of the gallery, `unwrapped-angles` and
`keep-first`, change next to nothing on this road: a mistake that does not bite here waits for a world in
which it does.""",
    measured="""\
In 20 of 20 seeds (0 to 19). How surely `dualslam diagnose` tells each mistake from a right filter, in this
world and in others, is counted by `dualslam study mistakes`.""",
    variants=(
        Variant(RIGHT, "paper-line --vehicle ackermann --filters fs2 fs1"),
        Variant(SHARED, "paper-line --vehicle ackermann --filters fs2 --mistake shared-maps"),
        Variant(KEPT, "paper-line --vehicle ackermann --filters fs2 --mistake weights-not-reset"),
        Variant(UNSAMPLED, "paper-line --vehicle ackermann --filters fs2 --mistake unsampled-proposal"),
        Variant(FIRST, "paper-line --vehicle ackermann --filters fs2 --mistake features-first"),
        Variant(ALWAYS, "paper-line --vehicle ackermann --filters fs2 --mistake resample-always"),
        Variant(PLAIN, "paper-line --vehicle ackermann --filters fs1 --mistake plain-weights"),
    ),
    columns=(diversity(10), diversity(-1), N_EFF, RESAMPLINGS, ERROR, NEES),
    claim=_claim,
)
