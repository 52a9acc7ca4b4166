"""`--summary FILE.json`: what each filter did, in numbers.  Stable and versioned.

    {"schema": 1, "version": "0.1.0", "world": name, "title": text, "seed": n,
     "mistake": name (--mistake) | null,
     "steps": n, "complete": bool,      steps done; whether these are all that were asked for
     "params": {every field of slam.types.Params, "noise": {...} | null, "options": {...}, "align": bool,
        "odometry": {"along", "lateral", "slip", "turn_per_metre", "turn_per_radian",
           "from": "scans" | "guess" | "given"} | null},
     "matching": {"steps": n, "used": n, "reasons": {reason: n, ...}} | null,
     "changes": [[step, sentence], ...], "events": [[step, key, sentence], ...],
     "relations": {"file": text, "relations": n, key or "odometry": {"used", "left_out",
        "translation_m": {"mean", "std", "median", "p95", "max"} | null, "rotation_rad": the same}, ...} | null,
     "alone": {"odometry": m, "matching": m} | null,
     "filters": {key: {
        "title": text, "particles": K (at the end),
        arrays, one entry per observing step:
        "step", "time_s", "position_error_m", "best_position_error_m", "heading_error_rad", "diversity", "n_eff",
        "nees" (x, y: 2 degrees of freedom), "nees_pose" (3), "features", "duplicates_so_far", "resampled" (bool),
        numbers:
        "position_mse", "nees_infinite", "nees_pose_infinite", "duplicates", "resamplings",
        "association": {"correct", "wrong", "missed"} | null,
        "update_ms": {"median", "p95", "total_s"}, "real_time_factor"}}}

- SI units and radians; `update_ms` in milliseconds, compiling and loading compiled kernels not counted.
- `time_s`: of a world, since its beginning; of a log, the log's own stamp, or without stamps the number of the scan.
- `position_error_m` is that of the weighted mean, `best_position_error_m` that of the heaviest particle; `position_mse`
  is the mean over steps of the squared position error.
- `diversity`: fraction of the particles with distinct ancestors at time zero, after the step.
- `duplicates`: features that show again what earlier ones show: the same landmark; or of the same wall, half or more of
  the shorter of two features, or half or more of one that several earlier ones cover together.
- `association`: observations whose truth is known, by what the best particle made of them: `missed` are those that it
  did not pair with what its map holds, `wrong` those that it paired with something else.
- `events`: what was depleted, lost, closed or went wrong, and when; each resampling with its reason.  The key is that
  of a filter, or empty for the session: nothing was seen for half a minute.
- `relations`: with `--relations`, of the path of the best particle's lineage at the end, and of the odometry of the
  log alone; `left_out` are those whose scans are not in the part of the log that was run.
- `null`: not known (no truth, no tags).  JSON has no infinity: an infinite NEES, of a collapsed mixture, is null too
  and counted in `nees_infinite`.
- `alone`: of a log, the RMS of the position error without any filter, and of scan matching if scans were matched.
- `odometry`: of a log of a laser, what is believed to be wrong with its odometry: deviations in metres and radians
  after one metre, `slip` and `turn_per_radian` after turning by one radian; `from` its own scans, or a guess where
  these show too little of it, or scaled to what was given (`--believed.odometry`).
- `matching`: at how many steps scans were matched, at how many of these that was used, and why not at the others; null
  if there were none.
- `real_time_factor`: seconds of the source for each second that the filter computed; above 1 is faster than real time;
  null for a log without time stamps.
- With `--align` the errors are those after the best rigid motion of the whole path onto the truth, and NEES is null.
- Same seed, same summary, except `update_ms` and `real_time_factor`: compare with `without_timings`.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.events import Blind, Watch
from app.files import write_whole
from app.paths import Paths
from app.relations import PathErrors
from app.session import flat
from app.types import FilterUpdate, SessionInfo, SessionStep
from app.version import version
from scenarios.logs.learning import odometry_believed, origin_of_belief
from slam.alignment import align_rigid
from slam.geometry import wrap_all
from slam.metrics import rms
from slam.types import UNKNOWN_TAG, Floats

SCHEMA = 1
TIMINGS = ("update_ms", "real_time_factor")


class FilterSeries:
    """What one filter did, step by step."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.particles = 0
        self.estimate: list[Floats] = []
        self.best: list[Floats] = []
        self.series: dict[str, list[Any]] = {name: [] for name in _SERIES}
        self.seconds: list[float] = []
        self.association: dict[str, int] | None = None

    def add(self, update: FilterUpdate, tagged: bool) -> None:
        """One step; `tagged`: the true identity of some observation is known."""
        trace, measures = update.trace, update.measures
        self.particles = len(trace.resampled.log_w)
        self.estimate.append(measures.estimate)
        self.best.append(trace.weighted.s[measures.best].copy())
        for name, read in _SERIES.items():
            self.series[name].append(read(update))
        self.seconds.append(update.seconds)
        if tagged:
            totals = self.association or dict.fromkeys(("correct", "wrong", "missed"), 0)
            self.association = {name: totals[name] + getattr(measures, name) for name in totals}

    def array(self, name: str) -> Floats:
        """(T,) one of the series."""
        return np.array(self.series[name], float)


_SERIES = {
    "position_error_m": lambda u: u.measures.position_error_m,
    "best_position_error_m": lambda u: u.measures.best_position_error_m,
    "heading_error_rad": lambda u: u.measures.heading_error_rad,
    "diversity": lambda u: u.measures.diversity,
    "n_eff": lambda u: u.measures.n_eff,
    "nees": lambda u: u.measures.nees_position,
    "nees_pose": lambda u: u.measures.nees_pose,
    "features": lambda u: u.measures.features,
    "duplicates_so_far": lambda u: u.measures.duplicates,
    "resampled": lambda u: u.trace.did_resample,
}


class Summary:
    """An observer that keeps the numbers of a session, none of its arrays, and writes them when it ends."""

    def __init__(self, path: Path | None = None, align: bool = False, paths: PathErrors | None = None) -> None:
        self.path = path
        self.align = align
        self.paths = paths
        """What judges the paths by relations, if somebody gave some."""
        self.steps: list[int] = []
        self.times: list[float] = []
        self.truth: list[Floats] = []
        self.changes: list[tuple[int, str]] = []
        self.events: list[tuple[int, str, str]] = []
        self.faults: list[tuple[int, str, str]] = []
        """Of these, what a filter reported itself: something went wrong with its numbers."""
        self.filters: dict[str, FilterSeries] = {}
        self.observed = 0
        """Observations of all steps."""
        self.unmatched: Counter[str] = Counter()
        """Steps whose scans were matched, by the reason why that was not used; empty where it was."""

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self.info = info
        self._ways = Paths()
        self._ways.begin(info)
        self.filters = {f.key: FilterSeries(f.title) for f in info.filters}
        self._watch = Watch({f.key: f.title for f in info.filters}, info.source.has_clock)
        if self.paths is not None:
            self.paths.begin(info)

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        self.steps.append(step.index)
        self._ways.step(step)
        self.times.append(float(step.frame.time))
        self.truth.append(np.full(3, np.nan) if step.truth is None else step.truth)
        self.changes += [(step.index, sentence) for sentence in step.changes]
        self.events += [
            (step.index, event.who, event.text) for event in self._watch.step(step) if event.kind != "changed"
        ]
        self.observed += len(step.frame.z)
        if step.match is not None:
            self.unmatched[step.match.reason] += 1
        if self.paths is not None:
            self.paths.step(step)
        tagged = bool(np.any(step.frame.tags != UNKNOWN_TAG))
        for key, update in step.filters.items():
            self.filters[key].add(update, tagged)
            self.faults += [(step.index, key, sentence) for sentence in update.trace.events]

    def end(self) -> None:
        """Write what there is, after an interruption too."""
        if self.path is not None:
            write_whole(self.path, dump(self.as_dict()))

    @property
    def blind(self) -> Blind:
        """The longest stretch of half a minute or more in which nothing was seen; of no steps if there was none."""
        return self._watch.blind

    def seconds(self) -> float:
        """[s] of the source that the steps so far cover, their controls included."""
        steps = self.info.source.steps[: len(self.steps)]
        return float(sum(np.sum(s.frame.dt) for s in steps))

    def as_dict(self) -> dict[str, Any]:
        """The summary as the module's docstring lays it out."""
        info = self.info
        params = _nested(flat(info.params))
        params["noise"] = _nested(flat(info.noise)) if info.source.kind == "world" else None
        params["options"] = {name: plain(value) for name, value in info.source.options.items()}
        params["align"] = self.align
        odometry = odometry_believed(info.source.motion, info.params.believed)
        params["odometry"] = None
        if odometry is not None:
            params["odometry"] = {**odometry._asdict(), "from": origin_of_belief(info.source, info.params.believed)}
        return {
            "schema": SCHEMA,
            "version": version(),
            "world": info.source.name,
            "title": info.source.title,
            "seed": info.seed,
            "mistake": info.mistake or None,
            "steps": len(self.steps),
            "complete": len(self.steps) == info.steps,
            "params": params,
            "matching": self._matching(),
            "changes": [list(change) for change in self.changes],
            "events": [list(event) for event in self.events],
            "relations": self._relations(),
            "alone": self.errors_alone() or None,
            "filters": {key: self._filter(series) for key, series in self.filters.items()},
        }

    def _matching(self) -> dict[str, Any] | None:
        if not self.unmatched:
            return None
        reasons = {reason: count for reason, count in self.unmatched.most_common() if reason}
        return {"steps": self.unmatched.total(), "used": self.unmatched[""], "reasons": reasons}

    def errors_alone(self) -> dict[str, float]:
        """[m] RMS of the position error of a log without any filter, by what has it; empty where nobody knows."""
        truth = np.array(self.truth).reshape(-1, 3)[:, :2]
        known = np.isfinite(truth).all(axis=1)
        if self.info.source.kind != "log" or not known.any():
            return {}
        found = {}
        for key, poses in self._ways.alone().items():
            places = poses[known, :2]
            if self.align and len(places) >= 2:
                R, t = align_rigid(places, truth[known])
                places = places @ R.T + t
            found[key] = rms(np.linalg.norm(places - truth[known], axis=1))
        return found

    def _relations(self) -> dict[str, Any] | None:
        if self.paths is None:
            return None
        relations = self.paths.relations
        found = {
            key: {
                "used": errors.used,
                "left_out": errors.left_out,
                "translation_m": errors.translation_m and errors.translation_m._asdict(),
                "rotation_rad": errors.rotation_rad and errors.rotation_rad._asdict(),
            }
            for key, errors in self.paths.found().items()
        }
        return {"file": str(relations.path), "relations": len(relations.times), **found}

    def errors(self, series: FilterSeries) -> dict[str, Floats]:
        """Series (T,) that depend on the truth, after alignment if that was asked for."""
        names = ("position_error_m", "best_position_error_m", "heading_error_rad", "nees", "nees_pose")
        found = {name: series.array(name) for name in (*names, "duplicates_so_far")}
        if self.info.source.kind == "log" and not self.observed:  # nobody knows whose features an empty map lacks
            found["duplicates_so_far"][:] = np.nan
        truth, estimate = np.array(self.truth).reshape(-1, 3), np.array(series.estimate).reshape(-1, 3)
        known = np.isfinite(truth[:, :2]).all(axis=1)
        if self.align and known.sum() >= 2:
            R, t = align_rigid(estimate[known, :2], truth[known, :2])
            best = np.array(series.best).reshape(-1, 3)
            turned = wrap_all(estimate[:, 2] + math.atan2(R[1, 0], R[0, 0]) - truth[:, 2])
            found["position_error_m"] = np.linalg.norm(estimate[:, :2] @ R.T + t - truth[:, :2], axis=1)
            found["best_position_error_m"] = np.linalg.norm(best[:, :2] @ R.T + t - truth[:, :2], axis=1)
            found["heading_error_rad"] = np.abs(turned)
            found["nees"] = found["nees_pose"] = np.full(len(truth), np.nan)
        return found

    def _filter(self, series: FilterSeries) -> dict[str, Any]:
        errors = self.errors(series)
        milliseconds = 1e3 * np.array(series.seconds)
        total = float(np.sum(series.seconds))
        arrays = {name: errors.get(name, series.series[name]) for name in _SERIES}
        arrays["duplicates_so_far"] = [_count(value) for value in errors["duplicates_so_far"]]
        duplicates = arrays["duplicates_so_far"]
        return {
            "title": series.title,
            "particles": series.particles,
            "step": self.steps,
            "time_s": self.times,
            **{name: [plain(v) for v in values] for name, values in arrays.items()},
            "position_mse": plain(nanmean(errors["position_error_m"] ** 2)),
            "nees_infinite": int(np.isinf(errors["nees"]).sum()),
            "nees_pose_infinite": int(np.isinf(errors["nees_pose"]).sum()),
            "duplicates": duplicates[-1] if duplicates else None,
            "resamplings": int(np.sum(series.series["resampled"])),
            "association": series.association,
            "update_ms": {
                "median": plain(np.median(milliseconds)) if total else None,
                "p95": plain(np.percentile(milliseconds, 95)) if total else None,
                "total_s": total,
            },
            "real_time_factor": plain(self.seconds() / total) if total and self.info.source.has_clock else None,
        }


def without_timings(summary: Mapping[str, Any]) -> dict[str, Any]:
    """The summary without what a clock measured: equal for equal seeds."""
    filters = {
        key: {name: value for name, value in numbers.items() if name not in TIMINGS}
        for key, numbers in summary["filters"].items()
    }
    return {**summary, "filters": filters}


def nanmean(values: Floats) -> float:
    """The mean of what is known; NaN where nothing is."""
    known = values[~np.isnan(values)]
    return float(np.mean(known)) if len(known) else math.nan


def _count(value: float) -> int | None:
    """A number of things; None for NaN."""
    return None if math.isnan(value) else int(value)


def dump(value: Any, indent: str = "") -> str:
    """JSON with objects spread over lines and every array on one."""
    if not isinstance(value, dict) or not value:
        return json.dumps(value, allow_nan=False, ensure_ascii=False)
    inner = indent + " "
    lines = [f"{inner}{json.dumps(name)}: {dump(item, inner)}" for name, item in value.items()]
    return "{\n" + ",\n".join(lines) + f"\n{indent}}}" + ("" if indent else "\n")


def plain(value: Any) -> Any:
    """A value that JSON has; None for NaN and infinity."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {str(name): plain(item) for name, item in value.items()}
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def _nested(names: Mapping[str, Any]) -> dict[str, Any]:
    """`{"a.b": 1}` as `{"a": {"b": 1}}`."""
    nested: dict[str, Any] = {}
    for name, value in names.items():
        *outer, last = name.split(".")
        place = nested
        for part in outer:
            place = place.setdefault(part, {})
        place[last] = plain(value)
    return nested
