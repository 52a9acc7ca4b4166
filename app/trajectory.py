"""`--trajectory DIR`: paths that evo reads, and maps as GeoJSON and SVG.

    <filter>.tum          the path of the best particle's lineage, as it is known at the end
    <filter>-online.tum   the estimate (mean of the mixture) as it was at each step
    truth.tum, odometry.tum
    <filter>.geojson      landmarks and path of the best particle
    <filter>.svg          a picture of the same; map.svg: all filters in one

A `.tum` line is `time x y z qx qy qz qw`, one for every observation, with the source's own stamp.  Metres.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from app.colours import TRUTH, of_filter
from app.drawing import Layer, draw_map
from app.files import write_whole
from app.types import SessionInfo, SessionStep, best_descendant
from slam.types import UNKNOWN_TAG, Floats, Ints


class Trajectory:
    """An observer that writes paths and maps when the session ends."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._times: list[float] = []
        self._truth: list[tuple[float, Floats]] = []
        self._odometry: list[Floats] = []
        self._online: dict[str, list[Floats]] = {}
        self._last: SessionStep | None = None

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self._info = info
        self._online = {f.key: [] for f in info.filters}

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        time = float(step.frame.time)
        self._times.append(time)
        self._odometry.append(step.odometry)
        if step.truth is not None:
            self._truth.append((time, step.truth))
        for key, update in step.filters.items():
            self._online[key].append(update.measures.estimate)
        self._last = step

    def end(self) -> None:
        """Write everything; nothing if there was no step."""
        if self._last is None:
            return
        self.directory.mkdir(parents=True, exist_ok=True)
        truth_times = np.array([time for time, _ in self._truth])
        truth = np.array([pose for _, pose in self._truth]).reshape(-1, 3)
        self._write("odometry.tum", tum(self._times, np.array(self._odometry)))
        if len(truth):
            self._write("truth.tum", tum(truth_times, truth))
            truth = with_gaps(truth_times, truth)
        layers: dict[str, Layer] = {}
        for estimator in self._info.filters:
            key, update = estimator.key, self._last.filters[estimator.key]
            k = best_descendant(update)
            path = update.genealogy.path(k)[1:]  # without the pose before the first step
            theta, Sigma, tags = update.trace.resampled.maps.features(k)
            self._write(f"{key}.tum", tum(self._times, path))
            self._write(f"{key}-online.tum", tum(self._times, np.array(self._online[key])))
            self._write(f"{key}.geojson", geojson(estimator.title, path, theta, Sigma, tags))
            layers[key] = Layer(estimator.title, of_filter(key), path, theta, Sigma)
            self._write(f"{key}.svg", self._picture([layers[key]], truth))
        self._write("map.svg", self._picture(list(layers.values()), truth))

    def _picture(self, layers: list[Layer], truth: Floats) -> str:
        true_map = self._info.source.true_map
        landmarks = np.zeros((0, 2)) if true_map is None else true_map.theta
        backdrop = Layer("truth", TRUTH, truth, landmarks, np.zeros((0, 2, 2)))
        return draw_map(f"{self._info.source.title}, seed {self._info.seed}", backdrop, layers)

    def _write(self, name: str, text: str) -> None:
        write_whole(self.directory / name, text)


def with_gaps(times: Floats, poses: Floats) -> Floats:
    """The poses (T, 3), with a row of NaN wherever nothing is known for long: no line should be drawn there."""
    if len(times) < 2:
        return poses
    between = np.diff(times)
    long = np.flatnonzero(between > max(2.0, 5.0 * float(np.median(between)))) + 1
    return np.insert(poses, long, np.nan, axis=0)


def tum(times: Iterable[float], poses: Floats) -> str:
    """One line `time x y z qx qy qz qw` for each pose (T, 3) [m, m, rad]; a heading that is not known is given as 0."""
    lines = []
    for time, (x, y, heading) in zip(times, poses, strict=True):
        half = 0.5 * (heading if math.isfinite(heading) else 0.0)
        lines.append(f"{time:.6f} {x:.9g} {y:.9g} 0 0 0 {math.sin(half):.9g} {math.cos(half):.9g}\n")
    return "".join(lines)


def geojson(title: str, path: Floats, theta: Floats, Sigma: Floats, tags: Ints) -> str:
    """A FeatureCollection: the path (T, 3) and the landmarks theta (n, 2), with their deviations from Sigma (n, 2, 2).

    Coordinates are metres in the world's own frame: these maps lie nowhere on the globe.
    """
    features: list[dict[str, Any]] = [
        {
            "type": "Feature",
            "geometry": {"type": "LineString", "coordinates": _rounded(path[:, :2])},
            "properties": {"kind": "path", "filter": title},
        }
    ]
    for index, (place, covariance, tag) in enumerate(zip(theta, Sigma, tags, strict=True)):
        x_deviation, y_deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        features.append(
            {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": _rounded(place[:2])},
                "properties": {
                    "kind": "landmark",
                    "index": index,
                    "tag": None if tag == UNKNOWN_TAG else int(tag),
                    "x_deviation_m": round(float(x_deviation), 9),
                    "y_deviation_m": round(float(y_deviation), 9),
                },
            }
        )
    collection = {
        "type": "FeatureCollection",
        "name": title,
        "units": "metres in the frame of the world, x forward at the start unless the source says otherwise",
        "features": features,
    }
    return json.dumps(collection, allow_nan=False, ensure_ascii=False) + "\n"


def _rounded(values: Floats) -> Any:
    return np.round(values, 6).tolist()
