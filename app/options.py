"""The options of the command line that say what the world is, what the filters do and what is written.

None means: not given, so the world's or log's own value holds.  Degrees here are radians everywhere else.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import tyro

from app import values
from app.errors import UsageError
from scenarios.logs.keyframes import USUAL as KEYFRAME
from scenarios.types import Source
from slam import presets
from slam.features import Point
from slam.limits import BELIEVED_SENSOR, DEVIATION, PARAMS, Interval
from slam.motion import Odometry
from slam.types import (
    UNKNOWN_TAG,
    AssociationName,
    Frame,
    MatchingName,
    Noise,
    Params,
    ProposalWeightName,
    ResamplerName,
    WeightingName,
)

FILTERS = ("dfs", "fs2", "fs1", "ekf")

MISTAKES = (
    "shared-maps",
    "weights-not-reset",
    "plain-weights",
    "unwrapped-angles",
    "unsampled-proposal",
    "features-first",
    "resample-always",
    "keep-first",
)
"""The classic ones (`slam.mistakes`)."""

OF_WALLS = ("floor_lateral", "floor_angle", "merge_walls", "most_new", "orthogonal", "matching")
"""Parameters that change nothing where landmarks are seen."""

PRESETS = {"paper": presets.PAPER, "building": presets.BUILDING, "log": presets.LOG}


def default(text: str) -> Any:
    """What the help says of an option that was not given."""
    return tyro.conf.arg(help_behavior_hint=f"(default: {text})")


def named(name: str, text: str) -> Any:
    """An option whose field cannot have its name, and what the help says if it was not given."""
    return tyro.conf.arg(name=name, help_behavior_hint=f"(default: {text})")


_USUAL = {field.name: default(str(field.default)) for field in dataclasses.fields(Params)}
_USUAL["floor_angle"] = default(f"{math.degrees(Params().floor_angle):g}")
_USUAL |= {
    name: default(f"{getattr(Params(), name)}; {value} for logs of a laser") for name, value in presets.LOG.items()
}


@dataclass(frozen=True)
class FilterOptions:
    """What the filters do. Worlds and logs may have defaults of their own: dualslam worlds NAME|LOG."""

    particles: Annotated[int | None, values.whole("--particles", "K", PARAMS["particles"]), _USUAL["particles"]] = None
    """Number of particles."""
    association: Annotated[
        str | None, values.choice("--association", get_args(AssociationName)), _USUAL["association"]
    ] = None
    """Which landmark is it: told by its tag, the nearest, or jointly compatible (JCBB)."""
    gate: Annotated[float | None, values.real("--gate", "P", PARAMS["gate"]), _USUAL["gate"]] = None
    """Confidence of the gates of association."""
    gate_known: Annotated[
        float | None, values.real("--gate-known", "P", PARAMS["gate_known"]), _USUAL["gate_known"]
    ] = None
    """Known association: a tag is believed within this gate, else the observation is ignored; 1 is always."""
    gate_new: Annotated[float | None, values.real("--gate-new", "P", PARAMS["gate_new"]), _USUAL["gate_new"]] = None
    """An unmatched observation within this wider gate of some landmark is ignored, not new; up to --gate is never."""
    weighting: Annotated[str | None, values.choice("--weighting", get_args(WeightingName)), _USUAL["weighting"]] = None
    """Dual FastSLAM: several observations weigh as in the paper (marginal), or by their exact likelihood (joint)."""
    proposal_weight: Annotated[
        str | None, values.choice("--proposal-weight", get_args(ProposalWeightName)), _USUAL["proposal_weight"]
    ] = None
    """FastSLAM 2.0: its proposal is weighed integrated over the draw, or as drawn (the paper's baseline code)."""
    inflate_r: Annotated[float | None, values.real("--inflate-r", "X", PARAMS["inflate_r"]), _USUAL["inflate_r"]] = None
    """Factor on the covariance R wherever known landmarks are used."""
    temper: Annotated[float | None, values.real("--temper", "X", PARAMS["temper"]), _USUAL["temper"]] = None
    """Exponent on the likelihood of an observation; 1 is the paper."""
    floor_lateral: Annotated[
        float | None, values.real("--floor-lateral", "M", PARAMS["floor_lateral"]), _USUAL["floor_lateral"]
    ] = None
    """Walls: deviation that a known wall is allowed, added to R."""
    floor_angle: Annotated[
        float | None, values.real("--floor-angle", "DEG", PARAMS["floor_angle"]), _USUAL["floor_angle"]
    ] = None
    """Walls: the same of their angle."""
    merge_walls: bool = False
    """Walls, unknown association, not EKF-SLAM: two of a particle's map become one where something seen lies along
    both."""
    most_new: Annotated[int | None, values.whole("--most-new", "N", PARAMS["most_new"]), _USUAL["most_new"]] = None
    """Walls: so many new ones at the most from one scan, the best ones; 0 is no limit."""
    orthogonal: bool = False
    """Walls, EKF-SLAM: those that may be parallel or at right angles to the first one are made so."""
    matching: Annotated[str | None, values.choice("--matching", get_args(MatchingName)), _USUAL["matching"]] = None
    """Laser scans are matched with those before, and correct the odometry: always (on), or where it is to be trusted
    (auto)."""
    log_p_new: Annotated[float | None, values.real("--log-p-new", "X", PARAMS["log_p_new"]), _USUAL["log_p_new"]] = None
    """Added to the log weight for every observation taken for a new landmark."""
    resampler: Annotated[str | None, values.choice("--resampler", get_args(ResamplerName)), _USUAL["resampler"]] = None
    """Resampling scheme."""
    resample_below: Annotated[
        float | None, values.real("--resample-below", "X", PARAMS["resample_below"]), _USUAL["resample_below"]
    ] = None
    """Resample when N_eff falls below this fraction of K: 0 never, 1 always."""
    preset: Annotated[str | None, values.choice("--preset", tuple(PRESETS)), default("none")] = None
    """A set of parameters, whatever the world or log suggests: paper is the honest R, temper 1, one gate; building is
    what worlds of walls have by default, tempered and with wide gates; log is what the logs of lasers have."""


@dataclass(frozen=True)
class WorldNoise:
    """What the world is: the deviations of its noise. A log has its noise already."""

    speed: Annotated[float | None, values.real("--noise.speed", "M/S", DEVIATION), default("the world's")] = None
    """Of the speed in a control tick."""
    turn: Annotated[float | None, values.real("--noise.turn", "DEG/S", DEVIATION), default("the world's")] = None
    """Of the turn rate; for an Ackermann vehicle of the steering, in degrees."""
    range: Annotated[float | None, values.real("--noise.range", "M", DEVIATION), default("the world's")] = None
    """Of a measured range."""
    bearing: Annotated[float | None, values.real("--noise.bearing", "DEG", DEVIATION), default("the world's")] = None
    """Of a measured bearing, for landmarks."""
    odometry: Annotated[float | None, values.real("--noise.odometry", "X", DEVIATION), default("the world's")] = None
    """Of an odometry increment, as a fraction of the motion: worlds of walls, seen by a laser."""
    missing: Annotated[float | None, values.real("--noise.missing", "X", Interval(0, 1)), default("the world's")] = None
    """Share of the laser's beams that return nothing."""


_FOLLOWS = default("follows the world")


@dataclass(frozen=True)
class BelievedNoise:
    """What the filters believe: the same deviations, as their Q and R hold them."""

    speed: Annotated[float | None, values.real("--believed.speed", "M/S", DEVIATION), _FOLLOWS] = None
    """Of the speed in a control tick."""
    turn: Annotated[float | None, values.real("--believed.turn", "DEG/S", DEVIATION), _FOLLOWS] = None
    """Of the turn rate; for an Ackermann vehicle of the steering, in degrees."""
    range: Annotated[float | None, values.real("--believed.range", "M", BELIEVED_SENSOR), _FOLLOWS] = None
    """Of a measured range."""
    bearing: Annotated[float | None, values.real("--believed.bearing", "DEG", BELIEVED_SENSOR), _FOLLOWS] = None
    """Of a measured bearing, for landmarks."""
    odometry: Annotated[float | None, values.real("--believed.odometry", "X", DEVIATION), _FOLLOWS] = None
    """Of an odometry increment, as a fraction of the motion: robots that report increments."""


@dataclass(frozen=True)
class LogOptions:
    """Which part of a log."""

    robot: Annotated[int | None, values.whole("--robot", "N", Interval(0)), default("the first")] = None
    """Which robot, for logs of several."""
    first: Annotated[int | None, values.whole("--from", "N", Interval(0)), named("from", "0")] = None
    """First observing step that is used; of a laser log the first scan."""
    last: Annotated[int | None, values.whole("--to", "N", Interval(0)), named("to", "the last")] = None
    """Last observing step that is used; of a laser log the last scan."""
    every: Annotated[int | None, values.whole("--every", "N", Interval(1)), default("1")] = None
    """Use every N-th observing step; of a laser log every N-th scan, before keyframes are chosen."""
    keyframe: Annotated[
        tuple[float, float] | None,
        values.pair("--keyframe", "METRES,DEGREES", Interval(0, 1e6)),
        default(f"{KEYFRAME[0]:g},{math.degrees(KEYFRAME[1]):g} for logs of a laser"),
    ] = None
    """Logs of a laser: of the scans that are used, only those between which the robot has gone or turned that far; 0,0
    is every one."""
    reference: Annotated[Path | None, values.path("--reference", "FILE"), default("what the log has")] = None
    """Logs of a laser: true poses, as lines of scan, time stamp, x, y and heading."""


@dataclass(frozen=True)
class Outputs:
    """What is written."""

    record: Annotated[Path | None, values.path("--record", "FILE.rrd"), default("not written")] = None
    """All that happened, step by step, for the Rerun viewer: rerun FILE.rrd."""
    summary: Annotated[Path | None, values.path("--summary", "FILE.json"), default("not written")] = None
    """Numbers of every step and filter."""
    trajectory: Annotated[Path | None, values.path("--trajectory", "DIR"), default("not written")] = None
    """Paths for evo (.tum), maps as GeoJSON and SVG."""


def parameters(
    source: Source, filters: FilterOptions, noise: WorldNoise, believed: BelievedNoise
) -> tuple[Noise, Params]:
    """What the world is, and the filters' parameters: the source's own, then the preset's, then what was given."""
    world = _typed(noise)
    check_noise(world, source)
    check_belief(_typed(believed), source)
    belief = dataclasses.replace(source.params().believed, **world)
    belief = dataclasses.replace(belief, **_typed(believed))
    for name in ("range", "bearing") if isinstance(source.feature, Point) else ("range",):
        if getattr(belief, name) not in BELIEVED_SENSOR:
            raise UsageError(
                f"--noise.{name} is 0, but no filter can believe in a perfect sensor; "
                f"expected --believed.{name} beside it"
            )
    preset = PRESETS[filters.preset] if filters.preset else {}
    given = _typed(filters)
    given.pop("preset", None)
    for flag in ("merge_walls", "orthogonal"):
        if not given[flag]:  # a flag that is not there says nothing
            given.pop(flag)
    check_walls(given, source)
    params = source.params(**{**preset, **given, "believed": belief})
    if params.association == "known":
        check_known(source)
    return dataclasses.replace(source.noise, **world), params


def check_noise(given: Mapping[str, Any], source: Source) -> None:
    """Raise `UsageError` for what the world cannot be."""
    if source.kind == "log" and given:
        name = next(iter(given))
        raise UsageError(
            f"--noise.{name} does not apply to {source.name}: a log has its noise already; "
            f"--believed.{name} is what the filters believe of it"
        )
    _check_applies("--noise", given, source)


def check_belief(given: Mapping[str, Any], source: Source) -> None:
    """Raise `UsageError` for what there is not to believe in."""
    _check_applies("--believed", given, source)


def check_walls(given: Mapping[str, Any], source: Source) -> None:
    """Raise `UsageError` for a parameter of walls where landmarks are seen."""
    idle = next((name for name in OF_WALLS if name in given), None)
    if idle is not None and isinstance(source.feature, Point):
        raise UsageError(
            f"--{idle.replace('_', '-')} does not apply to {source.name}: it is for walls, and landmarks are seen there"
        )


def check_known(source: Source) -> None:
    """Raise `UsageError` if association cannot be known."""
    if not any(_told(step.frame) for step in source.steps):
        raise UsageError(
            f"--association is known, but nobody knows what was seen in {source.name}; expected nearest or jcbb"
        )


def _told(frame: Frame) -> bool:
    """Whether somebody knows what something in the frame is: what was observed, or what the laser's beams met."""
    if frame.scan is not None:
        return frame.scan.walls is not None and bool((frame.scan.walls != UNKNOWN_TAG).any())
    return bool((frame.tags != UNKNOWN_TAG).any())


def _check_applies(option: str, given: Mapping[str, Any], source: Source) -> None:
    """Raise `UsageError` for a deviation that nothing in the source has: it would change nothing, silently."""
    of_motion = ("odometry",) if isinstance(source.motion, Odometry) else ("speed", "turn")
    of_sensor = ("range", "bearing") if isinstance(source.feature, Point) else ("range", "missing")
    for name in given:
        if name not in (*of_motion, *of_sensor):
            known = [
                f"{option}.{other}" for other in (*of_motion, *of_sensor) if option == "--noise" or other != "missing"
            ]
            raise UsageError(f"{option}.{name} does not apply to {source.name}; expected one of {', '.join(known)}")


def _typed(options: FilterOptions | WorldNoise | BelievedNoise) -> dict[str, Any]:
    """What was given, in SI units and radians."""
    return {name: in_radians(name, value) for name, value in vars(options).items() if value is not None}


def in_radians(name: str, value: Any) -> Any:
    """The value of an option as it is used: angles are typed in degrees."""
    return math.radians(value) if name in ("turn", "bearing", "floor_angle") else value
