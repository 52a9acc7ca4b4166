"""How many walls of random worlds are found, how honest their covariance is, and how long a scan takes.

    python -m tests.benchmarks.perception [scans [seed]]

A wall counts if at least 12 beams meet it, over at least the shortest length of a piece; how many fell to that second
condition is in the column `short`.
"""

from __future__ import annotations

import math
import sys
import time

import numpy as np

from slam.perception import Extraction, extract
from tests.slam.rays import Laser, World, corridor, look, room, score

LASERS = (
    Laser(181, 180.0),
    Laser(180, 180.0),
    Laser(361, 180.0),
    Laser(360, 360.0),
    Laser(361, 360.0),
    Laser(720, 360.0),
    Laser(181, 180.0, reach=30.0),
    Laser(361, 180.0, missing=0.03),
    Laser(181, 180.0, quantum=0.01),
    Laser(181, 180.0, quantum=0.05),
    Laser(361, 180.0, reach=30.0, quantum=0.05),
    Laser(181, 180.0, sigma=0.003, quantum=0.01),
    Laser(181, 180.0, sigma=0.03),
    Laser(181, 180.0, sigma=0.05),
)


def milliseconds(world: World, laser: Laser, scans: int = 50) -> float:
    """Processor time of one scan."""
    rng = np.random.default_rng(0)
    frames = []
    for _ in range(scans):
        walls, place = world(rng)
        frames.append(look(rng, walls, np.array([*place, rng.uniform(-math.pi, math.pi)]), laser))
    settings = Extraction(quantum=laser.quantum)
    start = time.process_time()
    for _ in range(4):
        for scan in frames:
            extract(scan, laser.sigma, settings)
    return (time.process_time() - start) / (4 * scans) * 1e3


def main(scans: int = 300, seed: int = 5) -> None:
    print("world     beams view reach sigma step missing | found of  walls  short false of segments | variance of")
    print(
        "                deg    m     m    m           |     %               %                   | lateral angle   ms"
    )
    for laser in LASERS:
        for world in (room, corridor):
            s = score(world, laser, scans, seed)
            print(
                f"{world.__name__:9s} {laser.beams:5d} {laser.view:4.0f} {laser.reach:5.0f} {laser.sigma:5.3f} "
                f"{laser.quantum:4.2f} {laser.missing:7.2f} | {100 * s.found / s.walls:5.1f} {s.walls:8d} {s.short:6d} "
                f"{100 * s.false / s.segments:5.2f} {s.segments:11d} | {np.mean(s.lateral**2):7.2f} "
                f"{np.mean(s.angle**2):5.2f} {milliseconds(world, laser):4.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
