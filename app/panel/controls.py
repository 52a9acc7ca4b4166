"""Controls for the settings of a session: each one a line of a table, and all of them kept in step with the desk.

viser runs every callback in some thread of a pool and checks nothing.  So a callback only reads what its control has
now, and puts it on the desk, which brings it between its limits; and the panel's own thread sets controls to what the
desk has, once nobody has touched them for a moment.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import time
from typing import Any, get_args

import viser

from app.live.settings import FEWEST, MOST, Settings, applicable
from app.options import PRESETS
from scenarios.types import Source
from slam.features import Wall
from slam.types import (
    UNKNOWN_TAG,
    AssociationName,
    MatchingName,
    ProposalWeightName,
    ResamplerName,
    WeightingName,
)

REST = 0.6
"""[s] that a control is left alone after somebody has touched it."""

DEGREE = math.pi / 180.0

MANY = 1000
"""The most particles of the slider; the number beside it goes further."""


@dataclass(frozen=True)
class Number:
    """A control for a number."""

    name: str
    """On the desk, dotted."""
    label: str
    """With the unit."""
    hint: str
    low: float
    high: float
    step: float
    unit: float = 1.0
    """What one of the control is on the desk: a degree in radians."""
    slider: bool = True


@dataclass(frozen=True)
class Choice:
    """A control for one of some words."""

    name: str
    label: str
    hint: str
    words: tuple[str, ...]


@dataclass(frozen=True)
class Switch:
    """A control for yes or no."""

    name: str
    label: str
    hint: str


Control = Number | Choice | Switch


def filter_controls(source: Source) -> list[Control]:
    """Everything of `Params` that may change while filters run, but what they believe of the noise."""
    known = any(_told(step) for step in source.steps[:50])
    associations = tuple(word for word in get_args(AssociationName) if known or word != "known")
    controls: list[Control] = [
        Number(
            "particles", "particles K", "How many hypotheses; a change is a resampling to the new number.", 10, MANY, 10
        ),
        Number("particles", "exactly", "Any number of particles; one is allowed.", FEWEST, MOST, 1, slider=False),
        Choice(
            "association",
            "association",
            "Which thing is it that is seen: told by its tag, the nearest, or jointly compatible.",
            associations,
        ),
        Number("gate", "gate", "Confidence of the gates of association.", 0.5, 0.999999, 0.000001, slider=False),
        Number(
            "gate_new",
            "gate, new",
            "What is within this wider gate of something known is ignored rather than new.",
            0.0,
            0.99999999,
            0.00000001,
            slider=False,
        ),
        Number(
            "gate_known",
            "gate, known",
            "Known association: a tag is believed within this gate; 1 is always.",
            0.5,
            1.0,
            0.0001,
            slider=False,
        ),
        Choice(
            "weighting",
            "weighting",
            "Dual FastSLAM: several observations weigh as in the paper, or by their exact likelihood.",
            get_args(WeightingName),
        ),
        Choice(
            "proposal_weight",
            "proposal weight",
            "FastSLAM 2.0: its proposal is weighed integrated over the draw, or as drawn.",
            get_args(ProposalWeightName),
        ),
        Number(
            "inflate_r",
            "inflate R",
            "Factor on the covariance R wherever known features are used.",
            0.1,
            1000.0,
            0.1,
            slider=False,
        ),
        Number("temper", "temper", "Exponent on the likelihood of an observation; 1 is the paper.", 0.01, 1.0, 0.01),
        Number(
            "log_p_new",
            "log p new",
            "Added to the log weight for every observation taken for something new.",
            -1000.0,
            1000.0,
            0.1,
            slider=False,
        ),
        Choice("resampler", "resampling", "Scheme.", get_args(ResamplerName)),
        Number(
            "resample_below",
            "resample below",
            "Resample when N_eff falls below this share of K: 0 never, 1 always.",
            0.0,
            1.0,
            0.01,
        ),
    ]
    if isinstance(source.feature, Wall):
        controls += [
            Choice(
                "matching",
                "scan matching",
                "Each scan is matched with those before and corrects the odometry: on, or where it can be trusted.",
                get_args(MatchingName),
            ),
            Number("floor_lateral", "floor, lateral [m]", "Deviation that a known wall is allowed.", 0.0, 0.5, 0.005),
            Number("floor_angle", "floor, angle [°]", "The same of its angle.", 0.0, 5.0, 0.05, DEGREE),
            Switch(
                "merge_walls",
                "merge walls",
                "Two walls of a map become one where what is seen lies along both; unknown association, not EKF-SLAM.",
            ),
            Number(
                "most_new",
                "most new",
                "So many new walls at the most from one scan, the best ones; 0 is no limit.",
                0,
                100,
                1,
                slider=False,
            ),
            Switch(
                "orthogonal", "right angles", "EKF-SLAM: walls that may be parallel or at right angles are made so."
            ),
        ]
    return controls


_DEVIATIONS = {
    "speed": ("speed [m/s]", "Deviation of the speed in a control tick.", 1.0, 0.01, 1.0),
    "turn": (
        "turn [°/s]",
        "Deviation of the turn rate; of an Ackermann vehicle's steering, in degrees.",
        20.0,
        0.1,
        DEGREE,
    ),
    "odometry": ("odometry [share]", "Deviation of an increment, as a share of the motion.", 0.5, 0.005, 1.0),
    "range": ("range [m]", "Deviation of a measured range.", 0.5, 0.001, 1.0),
    "bearing": ("bearing [°]", "Deviation of a measured bearing.", 10.0, 0.001, DEGREE),
    "missing": ("missing [share]", "Share of the laser's beams that return nothing.", 1.0, 0.01, 1.0),
}


def noise_controls(source: Source, group: str) -> list[Control]:
    """The deviations of "noise", which the world is, or "believed", which the filters believe."""
    names = [name for name in applicable(source) if group == "noise" or name != "missing"]
    return [_deviation(f"{group}.{name}", *_DEVIATIONS[name]) for name in names]


def _deviation(name: str, label: str, hint: str, high: float, step: float, unit: float) -> Number:
    return Number(name, label, hint, 0.0, high, step, unit)


def _told(step: Any) -> bool:
    frame = step.frame
    if frame.scan is not None:
        return frame.scan.walls is not None and bool((frame.scan.walls != UNKNOWN_TAG).any())
    return bool((frame.tags != UNKNOWN_TAG).any())


def value_of(settings: Settings, name: str) -> Any:
    """What the desk has under a dotted name."""
    group, _, field = name.rpartition(".")
    whole = {"": settings.params, "noise": settings.noise, "believed": settings.params.believed}[group]
    return getattr(whole, field)


class Bound:
    """A control on the page, and what it is for."""

    def __init__(self, control: Control, handle: Any) -> None:
        self.control = control
        self.handle = handle

    def show(self, settings: Settings, at_once: bool = False) -> None:
        """Have the control show what the desk has, unless somebody is at it."""
        if not at_once and time() - self.handle.update_timestamp < REST:
            return
        value = value_of(settings, self.control.name)
        if isinstance(self.control, Number):
            value = min(max(value / self.control.unit, self.control.low), self.control.high)
            value = round(value) if isinstance(self.control.step, int) else float(f"{value:.8g}")
            if _close(value, self.handle.value):
                return
        elif value == self.handle.value:
            return
        self.handle.value = value

    def changes(self) -> dict[str, Any]:
        """What the control says now, as the desk has it."""
        value = self.handle.value
        if isinstance(self.control, Number) and isinstance(value, int | float) and not isinstance(value, bool):
            value = value * self.control.unit if self.control.unit != 1.0 else value
        return {self.control.name: value}


def _close(a: float, b: Any) -> bool:
    return isinstance(b, int | float) and math.isclose(a, b, rel_tol=1e-7, abs_tol=1e-12)


class Controls:
    """The controls of some settings."""

    def __init__(self, gui: viser.GuiApi, put: Callable[[dict[str, Any]], Any], read: Callable[[], Settings]) -> None:
        self._gui = gui
        self._put = put
        self._read = read
        self._own = threading.local()
        self.bound: list[Bound] = []

    def add(self, controls: Sequence[Control]) -> list[Bound]:
        """Put them on the page, where the page is being built."""
        made = [Bound(control, self._handle(control)) for control in controls]
        for bound in made:
            bound.show(self._read(), at_once=True)
            bound.handle.on_update(self._callback(bound))
        self.bound += made
        return made

    def show(self, settings: Settings) -> None:
        """Have all controls show these settings; called by the panel's own thread."""
        self._own.busy = True
        try:
            for bound in self.bound:
                bound.show(settings)
        finally:
            self._own.busy = False

    def _callback(self, bound: Bound) -> Callable[[Any], None]:
        def changed(_: Any) -> None:
            if getattr(self._own, "busy", False):
                return  # it was `show`, not a person
            self._put(bound.changes())

        return changed

    def _handle(self, control: Control) -> Any:
        gui = self._gui
        if isinstance(control, Choice):
            return gui.add_dropdown(control.label, control.words, hint=control.hint)
        if isinstance(control, Switch):
            return gui.add_checkbox(control.label, False, hint=control.hint)
        whole = isinstance(control.step, int)
        low, high, step = (int(x) if whole else float(x) for x in (control.low, control.high, control.step))
        if control.slider:
            return gui.add_slider(control.label, low, high, step, low, hint=control.hint)
        return gui.add_number(control.label, low, min=low, max=high, step=step, hint=control.hint)


def preset_changes(name: str, source: Source) -> dict[str, Any]:
    """What a set of parameters puts on the desk; what only other sets speak of is the source's own again."""
    own = source.params()
    others = {field for preset in PRESETS.values() for field in preset}
    return {field: getattr(own, field) for field in sorted(others)} | PRESETS.get(name, {})
