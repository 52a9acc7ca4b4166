"""How fast an observation update with known association is, in multiples of plain C (`update.c`), on one core.

    python -m tests.benchmarks.update            # or: python tests/benchmarks/update.py
    python -m tests.benchmarks.update --steps    # whole steps too: number of particles, size of the map

The update is what a step does between prediction and resampling: find the features in the maps, weigh, correct, and for
FastSLAM write the maps anew.  Numbers are compared before times are.  Times are those of the processor, so that a busy
machine disturbs them less.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).parents[2]))

from slam import dual_fastslam, fastslam1, fastslam2
from slam.estimators import ESTIMATORS
from slam.types import Floats
from tests.benchmarks.reference import FLAGS, World, as_arrays, compile_reference, make_world

MODULES: dict[str, Any] = {"fs1": fastslam1, "fs2": fastslam2, "dfs": dual_fastslam}

LIMITS = {"fs1": 4.0, "fs2": 8.0, "dfs": 4.0}
"""Multiples of C that the update should stay below (K = 1000, 5 observations)."""

NOT_UPDATE = {"step", "resize", "predict", "predict_by_sampling", "resample_if_needed"}


class Times(NamedTuple):
    """Seconds of the same update, repeated."""

    in_c: Floats
    """(repetitions,)"""
    phases: dict[str, Floats]
    """(repetitions,) for every phase of the filter's step that is part of the update."""

    @property
    def here(self) -> Floats:
        """(repetitions,) all phases together."""
        return np.sum(list(self.phases.values()), axis=0)


@contextmanager
def timed_phases(module: Any) -> Iterator[dict[str, float]]:
    """Seconds spent in each function that a filter's module calls for its update, since the dictionary was cleared."""
    spent: dict[str, float] = defaultdict(float)
    originals = {name: f for name, f in vars(module).items() if inspect.isfunction(f) and name not in NOT_UPDATE}

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*args: Any) -> Any:
            begin = time.thread_time()
            result = function(*args)
            spent[name] += time.thread_time() - begin
            return result

        return run

    for name, function in originals.items():
        setattr(module, name, timed(name, function))
    try:
        yield spent
    finally:
        for name, function in originals.items():
            setattr(module, name, function)


def check_numbers(key: str, reference: Callable[..., None], world: World, seed: int) -> None:
    """Both do the same mathematics, or there is nothing to compare."""
    expected = as_arrays(world.particles, world.n)
    reference(key, world.frame, world.params, expected, np.random.default_rng(seed).standard_normal(expected.s.shape))
    particles, trace = ESTIMATORS[key].step(np.random.default_rng(seed), world.particles, world.frame, world.params)
    found = as_arrays(particles, trace.n)
    for name in ("n", "s", "P", "map"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-12, err_msg=name)
    log_w = world.particles.log_w + trace.log_likelihood.sum(axis=1)
    np.testing.assert_allclose(log_w, expected.log_w, rtol=1e-9, atol=1e-9)


def update_times(key: str, reference: Callable[..., None], K: int, features: int, seen: int, repetitions: int) -> Times:
    """The update in C and here, in turn, always from the same particles."""
    world = make_world(key, K=K, features=features, seen=seen)
    check_numbers(key, reference, world, seed=0)
    before, rng = as_arrays(world.particles, world.n), np.random.default_rng(0)
    in_c, here = np.empty(repetitions), []
    with timed_phases(MODULES[key]) as spent:
        for r in range(repetitions):
            state, normal = before.copy(), rng.standard_normal((K, 3))
            begin = time.thread_time()
            reference(key, world.frame, world.params, state, normal)
            in_c[r] = time.thread_time() - begin
            spent.clear()
            ESTIMATORS[key].step(rng, world.particles, world.frame, world.params)
            here.append(dict(spent))
    return Times(in_c, {name: np.array([phases[name] for phases in here]) for name in here[0]})


def print_update(reference: Callable[..., None], K: int, features: int, seen: int, repetitions: int) -> bool:
    """The table that `LIMITS` speak of; whether all medians are within them."""
    print(f"\nObservation update, K = {K}, {seen} of {features} features seen: least and median of {repetitions}")
    print("         C [us]           here [us]        ratio          limit   C [ns] per particle and observation")
    times = {key: update_times(key, reference, K, features, seen, repetitions) for key in MODULES}
    within = True
    for key, (in_c, _) in times.items():
        here = times[key].here
        ratios = here.min() / in_c.min(), float(np.median(here) / np.median(in_c))
        within = within and ratios[1] <= LIMITS[key]
        print(
            f"{key:5}{1e6 * in_c.min():7.0f} {1e6 * np.median(in_c):7.0f}  {1e6 * here.min():7.0f} "
            f"{1e6 * np.median(here):7.0f}  {ratios[0]:6.2f} {ratios[1]:6.2f}  {LIMITS[key]:8.0f}"
            f"{1e9 * in_c.min() / K / seen:10.1f}"
        )
    print("\nEach phase, in multiples of the whole update in C (medians)")
    for key, (in_c, phases) in times.items():
        unit = np.median(in_c)
        print(f"{key:5}" + ", ".join(f"{name} {np.median(t) / unit:.2f}" for name, t in phases.items()))
    return within


def step_times(key: str, K: int, features: int, seen: int, steps: int) -> tuple[Floats, float]:
    """(steps,) seconds of whole steps in a row, and the share that resampled.

    The robot stands still for 8 control ticks, sees its points, and the particles are resampled when that is due.
    """
    world = make_world(key, K=K, features=features, seen=seen, ticks=8)
    params = dataclasses.replace(world.params, resample_below=0.75)
    rng, particles, seconds, resampled = np.random.default_rng(0), world.particles, np.empty(steps), 0
    z = world.frame.z + [0.02, 0.002] * rng.standard_normal((steps, seen, 2))
    for t in range(steps):
        frame = world.frame._replace(z=z[t])
        begin = time.thread_time()
        particles, trace = ESTIMATORS[key].step(rng, particles, frame, params)
        seconds[t] = time.thread_time() - begin
        resampled += trace.did_resample
    return seconds, resampled / steps


def print_steps(reference: Callable[..., None], seen: int, steps: int, repetitions: int) -> None:
    """Whole steps: linear in the number of particles, flat in the size of the map."""
    sizes = [(100, 100), (1000, 100), (5000, 100), (1000, 1000), (1000, 10_000)]
    print(f"\nWhole steps, 8 control ticks and {seen} observations: median of {steps}, ratio to the C update of that K")
    print("           K  features       us   us per particle   ratio   resampled")
    for key in MODULES:
        units = {K: float(np.median(update_times(key, reference, K, 100, seen, repetitions).in_c)) for K, _ in sizes}
        for K, features in sizes:
            seconds, share = step_times(key, K, features, seen, steps)
            mid = float(np.median(seconds))
            print(f"{key:5}{K:7}{features:10}{1e6 * mid:9.0f}{1e6 * mid / K:18.2f}{mid / units[K]:8.1f}{share:12.0%}")


def main() -> int:
    """Print the tables; 1 if an update is slower than its limit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, default=1000)
    parser.add_argument("--observations", type=int, default=5)
    parser.add_argument("--features", type=int, default=100, help="in every map")
    parser.add_argument("--repetitions", type=int, default=300)
    parser.add_argument("--steps", action="store_true", help="time whole steps too")
    arguments = parser.parse_args()

    if hasattr(os, "sched_setaffinity"):  # one core, and always the same
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    compiler = subprocess.run(["gcc", "--version"], check=True, capture_output=True, text=True).stdout.splitlines()[0]
    print(f"{compiler}: gcc {' '.join(FLAGS)}")
    with tempfile.TemporaryDirectory() as folder:
        reference = compile_reference(Path(folder))
        a = arguments
        within = print_update(reference, a.particles, a.features, a.observations, a.repetitions)
        if a.steps:
            print_steps(reference, a.observations, steps=60, repetitions=30)
    return 0 if within else 1


if __name__ == "__main__":
    sys.exit(main())
