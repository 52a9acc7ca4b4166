"""The values that travel between the phases of a filter, and between a filter and whoever watches it.

Only immutable values, no behaviour: a step takes `Particles` and a `Frame` and returns new `Particles` and a `Trace`.
Arrays have a leading particle axis K.  SI units, radians.  Nobody writes into an array that is held by one of these.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from slam.map_store import Maps

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

NEW = -1
"""The correspondence n of an observation that is paired with no known feature."""

IGNORED = -2
"""The correspondence of an observation that is too far from every feature to be paired, and too near one to be new."""

UNKNOWN_TAG = -1
"""The tag of an observation whose true identity nobody knows."""

AssociationName = Literal["known", "nearest", "jcbb"]
WeightingName = Literal["marginal", "joint"]
ProposalWeightName = Literal["integrated", "drawn"]
ResamplerName = Literal["systematic", "stratified", "residual", "multinomial"]
MatchingName = Literal["off", "on", "auto"]


class Scan(NamedTuple):
    """A laser scan: what came back to one place, beam by beam, counter-clockwise."""

    ranges: Floats
    """(B,) [m]; inf where nothing came back."""
    bearings: Floats
    """(B,) [rad], increasing; seen from the laser, whose x axis is 0."""
    origin: Floats
    """(3,) [m, m, rad] pose of the laser on the robot."""
    max_range: float
    """[m] beyond which it sees nothing."""
    walls: Ints | None = None
    """(B,) tag of the wall that each beam met, `UNKNOWN_TAG` for none.  Only a simulation knows."""


class Frame(NamedTuple):
    """One observing step: the controls since the observation before, then what the sensor saw.

    `motion` and `feature` say what the numbers in `u` and `z` mean (`slam.motion`, `slam.features`).
    """

    time: float
    """[s] of the observation."""
    motion: Any
    """The motion model of `u`: `Unicycle()`, `Ackermann(...)`, `Odometry()` or `Matched(...)`."""
    u: Floats
    """(T, m) control ticks: (v, w) [m/s, rad/s], (v, steering) [m/s, rad] or increments (dx, dy, dphi) [m, m, rad]."""
    dt: Floats
    """(T,) [s] duration of each tick."""
    feature: Any
    """The feature kind of `z`: `Point()` or `Wall()`."""
    z: Floats
    """(Z, d) observations; for points (range [m], bearing [rad]), for walls see `slam.features.wall`."""
    tags: Ints
    """(Z,) identity of the thing seen, or `UNKNOWN_TAG`.  Read by known association and by scoring, by nothing else.
    No two in one frame are alike, and none exceeds 2^53."""
    scan: Scan | None = None
    """What the laser saw, if there is one: `slam.perception` makes z of it."""
    between: tuple[Scan, ...] = ()
    """Scans on the way here, one after each control tick but the last, or none at all.  Only scan matching asks."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations: what a world adds to its frames, or what a filter believes."""

    speed: float = 0.3
    """[m/s] of the speed in one control tick."""
    turn: float = math.radians(3.0)
    """[rad/s] of the turn rate in one tick; for an Ackermann vehicle [rad] of the steering angle."""
    range: float = 0.003
    """[m] of a measured range."""
    bearing: float = math.radians(0.003)
    """[rad] of a measured bearing (section 5.1 prints 0.003*pi/180: 0.003 degrees)."""
    odometry: float = 0.10
    """Deviation of an odometry increment, as a fraction of the motion."""
    missing: float = 0.0
    """Share of the laser beams, 0 to 1, that return nothing although they should.  No filter asks."""


class ObservationNoise(NamedTuple):
    """R (7), as a filter believes it, for the observations of one frame."""

    sensor: Floats
    """(Z, 2, 2) covariance of each observation."""
    model: Floats
    """(2, 2) covariance of what a feature is beside what it is taken for, in its uncertain coordinates (ours): a wall
    is no perfect line, and what is seen of it far from where it was made is off by more than nearby."""


@dataclass(frozen=True)
class Params:
    """Everything that may change while a filter runs, and nothing else.  Read once at the top of a step."""

    particles: int = 100
    """K.  A step that finds another number of particles first resamples to this one."""
    believed: Noise = field(default_factory=Noise)
    """Q and R as the filter believes them (7)."""
    association: AssociationName = "jcbb"
    gate: float = 0.99
    """Confidence alpha of the chi-square gates (27)."""
    gate_known: float = 1.0
    """Known association only: a tag is believed within this gate of its feature, else the observation is ignored (ours:
    real tags are misread now and then); 1 believes always, as the paper does."""
    gate_new: float = 0.999999
    """Unmatched observations within this (wider) gate of a feature that nothing was matched with are ignored, not new
    (ours; up to `gate`: never)."""
    weighting: WeightingName = "marginal"
    """Dual FastSLAM only: the two readings of (43) for several observations at once."""
    proposal_weight: ProposalWeightName = "integrated"
    """FastSLAM 2.0 only: the weight of its proposal, integrated over the draw (Montemerlo 2003) or at the drawn pose
    (the paper's baseline code).  They differ by what the linearisation neglects."""
    inflate_r: float = 1.0
    """Factor on the covariance R wherever known features are matched, weighed and used to correct (pose and
    feature)."""
    temper: float = 1.0
    """Exponent on the observation likelihood; 1 is the paper."""
    floor_lateral: float = 0.05
    """[m] Walls: deviation that is allowed to a known wall beside R (ours); new ones are drawn with the honest R."""
    floor_angle: float = math.radians(0.2)
    """[rad] The same of its angle."""
    merge_walls: bool = False
    """Walls, unknown association (ours): two walls of a particle's map become one where a piece that is seen lies along
    both, no end that was seen is between them, and the floors allow it.  Not for EKF-SLAM."""
    most_new: int = 0
    """Walls (ours): so many new ones at the most from one scan, in each particle: those whose angle is known best.  The
    others are ignored.  0 is no limit."""
    orthogonal: bool = False
    """EKF-SLAM on walls: a new wall that may be parallel or at right angles to the first one is made so."""
    matching: MatchingName = "off"
    """Laser scans are matched with those before, once for all particles, and the result takes the place of the odometry
    (5.2): "on" wherever there is one, "auto" only where it is to be trusted."""
    log_p_new: float = 0.0
    """Added to the log density of an unmatched observation (unknown association only)."""
    resampler: ResamplerName = "systematic"
    resample_below: float = 0.75
    """Resample when N_eff < this fraction of K (44): 0 never, 1 always."""


class Particles(NamedTuple):
    """K hypotheses: each a pose Gaussian and a map.  FastSLAM ends a step with P = 0, Dual FastSLAM has Sigma = 0."""

    s: Floats
    """(K, 3) pose mean (x, y, heading) [m, m, rad], heading in [-pi, pi)."""
    P: Floats
    """(K, 3, 3) pose covariance."""
    log_w: Floats
    """(K,) log weights, normalised."""
    lineage: Ints
    """(K,) index of the ancestor at time zero."""
    maps: Maps
    """One map for each particle, sharing what they have in common."""


class Innovations(NamedTuple):
    """What was seen of known features beside what was expected, as the weights saw it; NaN where nothing was matched.

    Dual FastSLAM with `weighting` "marginal" and FastSLAM 1.0 take all of them at the predicted pose, the others each
    at the pose that those before have corrected (EKF-SLAM: the map as well).
    """

    v: Floats
    """(K, Z, 2) innovation (23)."""
    V: Floats
    """(K, Z, 2, 2) its covariance (24), pose, feature and sensor together."""


class Trace(NamedTuple):
    """What an observer needs of one step and the next step does not."""

    predicted: Particles
    """After the control ticks.  FastSLAM 1.0 has drawn its poses here already."""
    weighted: Particles
    """After the observation, with the new weights and the maps as the step leaves them, before resampling.  The pose
    is the Gaussian before FastSLAM 2.0 draws from it and before Dual FastSLAM corrects it on new features.  The
    estimate and the NEES are taken here."""
    resampled: Particles
    """The particles that the step returned (`app` calls them so whether or not there was a resampling)."""
    n: Ints
    """(K, Z) correspondences: index of the feature in the particle's own map, NEW or IGNORED.  Of a feature that this
    step merged into another one it is the index of that other one."""
    log_likelihood: Floats
    """(K, Z) what each observation added to the log weight (tempered); unmatched ones that of a miss (EKF-SLAM: 0)."""
    temper: float
    """`Params.temper` of this step."""
    innovations: Innovations
    """(K, Z) of the observations that were matched."""
    n_eff: float
    """Effective sample size (44) of the new weights, before resampling."""
    did_resample: bool
    resized: Ints
    """(K,) for each particle of `predicted` and `weighted` its index in the particles that the step was given."""
    selected: Ints
    """(K',) for each particle of `resampled` its index in `weighted`."""
    events: tuple[str, ...] = ()
    """Sentences on what went wrong or is worth knowing, such as impossible weights."""
    merged: Ints | None = None
    """(K, Z) index of the feature that was merged into the one that an observation is paired with, or NEW for none.
    That index is nobody's from then on.  None where features are not merged."""

    @property
    def ancestors(self) -> Ints:
        """(K',) for each particle that the step returned, its index in the particles that it was given."""
        return self.resized[self.selected]


class Estimator(NamedTuple):
    """A filter: how to begin and how to go on."""

    key: str
    """Short name on the command line and in entity paths: `dfs`, `fs2`, `fs1`, `ekf`."""
    title: str
    reference: str
    """Where the method was published."""
    init: Callable[..., Any]
    """`init(feature, start (3,), start_covariance (3, 3), params) -> state`."""
    step: Callable[..., tuple[Any, Trace]]
    """`step(rng, state, frame, params) -> (state, trace)`.  The state is `Particles` (EKF-SLAM: an `EkfState`)."""
