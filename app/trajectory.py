"""`--trajectory DIR`: paths that evo reads, and maps as GeoJSON and SVG.

    <filter>.tum          the path of the best particle's lineage, as it is known at the end
    <filter>-online.tum   the estimate (mean of the mixture) as it was at each step
    truth.tum, odometry.tum
    matching.tum          odometry as scan matching corrects it, where that is on
    <filter>.geojson      map and path of the best particle
    <filter>.svg          a picture of the same, of a laser log over what the laser saw; map.svg: all filters in one

A `.tum` line is `time x y z qx qy qz qw`, one for every observation, with the source's own stamp.  Metres.

Of a laser log these are all its scans, not only the steps: between two steps poses go on by the scans that were matched
on the way, or by odometry, and in `<filter>.tum` fit both; `truth.tum` has the steps whose truth is known.  Lines are
in the order of the stamps.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from app.colours import TRUTH, of_filter
from app.drawing import Layer, draw_map, map_layer, truth_layer
from app.files import write_whole
from app.paths import Paths
from app.scans import all_returns
from app.types import SessionInfo, SessionStep, best_descendant, best_path
from slam.features import Wall
from slam.features.wall import ends
from slam.types import UNKNOWN_TAG, Floats, Ints


class Trajectory:
    """An observer that writes paths and maps when the session ends."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._truth: list[tuple[float, Floats]] = []
        self._paths = Paths()
        self._online: dict[str, list[Floats]] = {}

    def begin(self, info: SessionInfo) -> None:
        """Before the first step."""
        self._info = info
        self._paths.begin(info)
        self._online = {f.key: [] for f in info.filters}

    def step(self, step: SessionStep) -> None:
        """After every observing step."""
        self._paths.step(step)
        if step.truth is not None:
            self._truth.append((float(step.frame.time), step.truth))
        for key, update in step.filters.items():
            self._online[key].append(update.measures.estimate)

    def end(self) -> None:
        """Write everything; nothing if there was no step."""
        last = self._paths.last
        if last is None:
            return
        self.directory.mkdir(parents=True, exist_ok=True)
        truth_times = np.array([time for time, _ in self._truth])
        truth = np.array([pose for _, pose in self._truth]).reshape(-1, 3)
        for name, (stamps, poses) in self._paths.found().items():
            self._write_path(f"{name}.tum", stamps, poses)
        if len(truth):
            self._write("truth.tum", tum(truth_times, truth))
            truth = with_gaps(truth_times, truth)
        layers: dict[str, Layer] = {}
        for estimator in self._info.filters:
            key, update = estimator.key, last.filters[estimator.key]
            k = best_descendant(update)
            path = best_path(update)
            maps = update.trace.resampled.maps
            theta, Sigma, tags = maps.features(k)
            self._write_path(f"{key}-online.tum", *self._paths.every_scan(np.array(self._online[key]), fit=False))
            feature = self._info.source.feature
            mapped = geojson(estimator.title, path, feature, theta, Sigma, tags, maps.indices(k))
            self._write(f"{key}.geojson", mapped)
            layers[key] = map_layer(estimator.title, of_filter(key), path, feature, theta, Sigma)
            self._write(f"{key}.svg", self._picture([layers[key]], truth, self._scanned(path)))
        self._write("map.svg", self._picture(list(layers.values()), truth, np.zeros((0, 2))))

    def _scanned(self, path: Floats) -> Floats:
        """(N, 2) what the laser of a log saw from the poses (T, 3) of the first T steps."""
        source = self._info.source
        if source.scans is None:
            return np.zeros((0, 2))
        return all_returns(source, path)

    def _picture(self, layers: list[Layer], truth: Floats, scanned: Floats) -> str:
        source = self._info.source
        true_map = source.true_map
        backdrop = truth_layer("truth", TRUTH, truth, np.zeros((0, 2)) if true_map is None else true_map.theta)
        return draw_map(f"{source.title}, seed {self._info.seed}", backdrop, layers, scanned)

    def _write_path(self, name: str, stamps: Floats, poses: Floats) -> None:
        """The poses (M, 3), ordered by their stamps (M,)."""
        order = np.argsort(stamps, kind="stable")
        self._write(name, tum(stamps[order], poses[order]))

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


def geojson(title: str, path: Floats, feature: Any, theta: Floats, Sigma: Floats, tags: Ints, indices: Ints) -> str:
    """A FeatureCollection: the path (T, 3), and the features theta (n, D) of a kind with the deviations of Sigma.

    `indices` (n,) are those in the map of the particle, where some may be missing (`Maps.indices`).

    Coordinates are metres in the world's own frame: these maps lie nowhere on the globe.
    """
    deviations = np.sqrt(np.maximum(np.diagonal(Sigma, axis1=1, axis2=2), 0.0))
    mapped = _walls(title, theta, deviations) if isinstance(feature, Wall) else _landmarks(theta, deviations)
    for item, tag, index in zip(mapped, tags, indices, strict=True):
        item["properties"] |= {"index": int(index), "tag": None if tag == UNKNOWN_TAG else int(tag)}
    collection = {
        "type": "FeatureCollection",
        "name": title,
        "units": "metres in the frame of the world, x forward at the start unless the source says otherwise",
        "features": [_item("LineString", path[:, :2], kind="path", filter=title), *mapped],
    }
    return json.dumps(collection, allow_nan=False, ensure_ascii=False) + "\n"


def _landmarks(theta: Floats, deviations: Floats) -> list[dict[str, Any]]:
    """A point for each (n, 2)."""
    return [
        _item(
            "Point",
            place,
            kind="landmark",
            index=None,
            tag=None,
            x_deviation_m=round(float(x_deviation), 9),
            y_deviation_m=round(float(y_deviation), 9),
        )
        for place, (x_deviation, y_deviation) in zip(theta, deviations, strict=True)
    ]


def _walls(title: str, theta: Floats, deviations: Floats) -> list[dict[str, Any]]:
    """A line for each (n, 8), with whoever sees it on the left; where no end was seen, the wall may go on."""
    return [
        _item(
            "LineString",
            a_b,
            kind="wall",
            filter=title,
            index=None,
            tag=None,
            observations=int(row[7]),
            start_seen=bool(row[5]),
            end_seen=bool(row[6]),
            lateral_deviation_m=round(float(lateral), 9),
            angle_deviation_rad=round(float(angle), 9),
        )
        for row, a_b, (lateral, angle) in zip(theta, ends(theta), deviations, strict=True)
    ]


def _item(geometry: str, places: Floats, **properties: Any) -> dict[str, Any]:
    coordinates = np.round(places, 6).tolist()
    return {
        "type": "Feature",
        "geometry": {"type": geometry, "coordinates": coordinates},
        "properties": properties,
    }
