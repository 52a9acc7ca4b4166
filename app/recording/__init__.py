"""Recording a session with Rerun, and reading recordings; the only folder that knows Rerun.

A recording has the application id `dual-fastslam`, holds all filters of a session, and opens in any Rerun viewer
(`blueprint`).  Its entities, with <filter> a short name such as `dfs`:

    /world/truth/{robot,path,map}   /world/odometry/path   /world/matching/path
    /world/scan                     what was seen, from the true pose: rays to landmarks, or where a laser met something
    /world/scans                    logs of a laser: what all scans met, along the path of the first filter
    /world/<filter>/particles       positions, coloured by weight, and headings; with walls, the best one's ellipse
    /world/<filter>/ellipses        2-sigma pose covariance of every particle
    /world/<filter>/map             the best particle's map: landmarks with 2-sigma ellipses, or walls, the brighter the
                                    more often they were seen, with `observations`, how often
    /world/<filter>/map/ends        walls: the ends that are known to be ends
    /world/<filter>/map/bands       walls: 2-sigma bands of their lateral offset and angle
    /world/<filter>/maps            features of the maps of all particles; walls that they share are drawn once
    /world/<filter>/segments        walls: the pieces that the best particle saw, coloured: matched, new, rejected
    /world/<filter>/picked          a particle that somebody chose in the panel: pose, ellipse, path,
                                    weight; picked/map its map
    /world/<filter>/associations    from where it saw something to what it took it for; hidden until switched on
    /world/<filter>/path            path of the best particle
    /world/<filter>/relations       --relations: from where that path has the robot to where a relation has it, if
                                    that is more than 0.1 m away
    /world/<filter>/lineages        all paths that lead to a living particle, in the colours of the ancestry picture
    /world/<filter>/{focus,best}    frames of the close-ups: about the estimate, about the best particle
    /plots/<metric>/<filter>        a series for each measure of `metrics`
    /plots/nees/{lower,upper}       95 % chi-square band; the same for nees_log10, and of nees_{x,y,heading}_log10
    /plots/n_eff/threshold          where resampling begins
    /genealogy/<filter>             ancestry of the whole run: the tree that leads to the living, an even sample of
                                    them, and of those that died, dim; the colour is that of the founder
    /genealogy/<filter>/lags        distinct ancestors by steps back, a curve; as numbers `ancestors`, `steps_back`
    /genealogy/<filter>/words       how many founders are left, in words
    /genealogy/cursor               the present step in the picture
    /ancestors/<filter>             `ancestors` (K,): of which particle before the step each one after it is a copy, at
                                    the first step, and at all others where that is not 0, 1 ... K - 1.  Never thinned
    /hypotheses/<filter>            different copies of each feature, by index, among all particles: `copies`; and how
                                    many have it: `maps`.  `hypotheses` of /world/<filter>/map is that of its features
    /weights/<filter>               sorted weights times K
    /evidence/<filter>              what `diagnose` goes by, at every step (`app.diagnosis.evidence`): `numbers`, whose
                                    `names` /evidence has, and by observation its `shares` of the variance of the
                                    log weights, the `features` of the best map, and `widths` of what is expected
    /branch/<name>/...              the same tree for a branch, from its first step on; property `session-<name>`, with
                                    `parent`, the branch that it left (empty for the run itself)
    /relations                      --relations: how well odometry and the filters fit them, and the worst pair of scans
    /lesson                         the text of a lesson; its other runs are branches
    /events, /about, /params        log, and pages to read; property `session`: everything it was made with, as JSON

and timelines

    step        observing steps from 1: particles as weighted, all else as it is after the step
    sim_time    the same by the time of the world or log
    stage       3 i - 2, 3 i - 1, 3 i: particles predicted, weighted and resampled in step i

How much of a long run, or of many particles, is recorded: `limits`.
"""

from app.recording.errors import RecordingError, RecordingLost
from app.recording.recorder import Recorder

__all__ = ["Recorder", "RecordingError", "RecordingLost"]
