"""How far matched scans drift from the truth in worlds of walls, what they teach of an odometry, how long one takes.

    python -m tests.benchmarks.matching [seeds]

The odometry has white noise and turns 0.06 rad too far in every metre.  Drift is the root mean square error of the pose
20 m on; learning and matching know nothing of the noise.
"""

from __future__ import annotations

import math
import sys
import time
from typing import NamedTuple

import numpy as np

from scenarios.registry import build
from scenarios.types import Step
from slam.geometry import compose, invert
from slam.perception.matching import START, Matcher, match
from slam.perception.odometry_noise import OdometryNoise, odometry_noise
from slam.types import Floats, Scan

WORLDS = (
    ("loop", {"max_range": 30.0}, 0.01, 0.0),
    ("loop", {"max_range": 30.0, "beams": 361}, 0.01, 0.0),
    ("loop", {"max_range": 30.0, "beams": 180}, 0.005, 0.05),
    ("loop", {"doors": "rooms"}, 0.01, 0.0),
    ("hospital", {}, 0.01, 0.0),
    ("hall", {}, 0.01, 0.0),
)
"""Name, options, deviation of a range [m], step of a range [m]."""

NOISE = OdometryNoise(along=0.05, lateral=0.03, slip=0.03, turn_per_metre=0.03, turn_per_radian=0.05)
BIAS = 0.06  # rad/m
STRETCH = 20.0  # m


class Log(NamedTuple):
    """What a robot reports of one run, and the truth."""

    scans: list[Scan]
    increments: Floats
    truth: Floats


def drive(steps: tuple[Step, ...], sigma: float, quantum: float, seed: int) -> Log:
    """The scans that are a quarter of a metre or eight degrees apart, and the increments between them."""
    rng = np.random.default_rng(seed)
    truth = np.array([step.truth for step in steps])
    kept = [0]
    for k in range(1, len(truth)):
        x, y, turned = compose(invert(truth[kept[-1]]), truth[k])
        if math.hypot(x, y) > 0.25 or abs(turned) > math.radians(8):
            kept.append(k)
    u = np.vstack([np.zeros(3), compose(invert(truth[kept[:-1]]), truth[kept[1:]])])
    for one in u[1:]:
        one += np.linalg.cholesky(NOISE.covariance(one)) @ rng.normal(size=3)
        one[2] += BIAS * math.hypot(one[0], one[1])
    scans = []
    for k in kept:
        scan = steps[k].frame.scan
        assert scan is not None
        r = scan.ranges + rng.normal(0.0, sigma, len(scan.ranges))
        r = np.round(r / quantum) * quantum if quantum else r
        scans.append(scan._replace(ranges=np.where(r < scan.max_range, r, np.inf)))
    return Log(scans, u, truth[kept])


def drift(poses: Floats, truth: Floats) -> tuple[float, float]:
    """Root mean square error [m], [rad] of the pose a stretch later."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    later = np.searchsorted(way, way + STRETCH)
    a = np.flatnonzero(later < len(way))
    b = later[a]
    error = compose(invert(compose(invert(truth[a]), truth[b])), compose(invert(poses[a]), poses[b]))
    return math.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))), math.sqrt(np.mean(error[:, 2] ** 2))


def chain(increments: Floats) -> Floats:
    """The poses that increments lead to."""
    poses = [np.zeros(3)]
    for u in increments[1:]:
        poses.append(compose(poses[-1], u))
    return np.array(poses)


def follow(log: Log, noise: OdometryNoise) -> tuple[Floats, float, float]:
    """Matched increments, the share of matches that were used, and the processor time of one [ms]."""
    track, matched, used = START, [], 0
    start = time.process_time()
    for scan, u in zip(log.scans, log.increments, strict=True):
        track, found = match(track, scan, u, noise.covariance(u), Matcher())
        matched.append(found.u)
        used += found.used
    return np.array(matched), used / (len(matched) - 1), (time.process_time() - start) / len(matched) * 1e3


def main(seeds: int = 4) -> None:
    print(
        f"                                        | drift in {STRETCH:.0f} m, of             | learned of the odometry"
    )
    print("world     beams reach sigma step matches | odometry       matches        | along lateral  slip   ", end="")
    print("rad/m rad/rad    used    ms")
    print("                m     m     m            | m       deg    m       deg     |")
    for name, options, sigma, quantum in WORLDS:
        steps, rows, log = build(name, **options).steps, [], None
        for seed in range(seeds):
            log = drive(steps, sigma, quantum, seed)
            noise = odometry_noise(log.scans, log.increments)
            matched, used, ms = follow(log, noise)
            rows.append([*drift(chain(log.increments), log.truth), *drift(chain(matched), log.truth), *noise, used, ms])
        assert log is not None
        (m0, a0, m1, a1), learned, (used, ms) = np.split(np.sqrt(np.mean(np.square(rows), axis=0)), [4, 9])
        scan = log.scans[0]
        print(
            f"{name:9s} {len(scan.ranges):5d} {scan.max_range:5.0f} {sigma:5.3f} {quantum:4.2f} {len(log.scans):7d} | "
            f"{m0:5.2f} {math.degrees(a0):6.1f}   {m1:6.3f} {math.degrees(a1):6.2f}   | "
            + " ".join(f"{value:7.3f}" for value in learned)
            + f" {used:7.3f} {ms:5.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
