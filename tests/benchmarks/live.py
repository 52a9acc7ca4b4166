"""How fast a live session is while it is recorded and streamed: `python -m tests.benchmarks.live [--particles K]`.

Three filters on landmarks, about five observations a step, as fast as possible: alone, with a file, with a file and the
stream to Rerun's server (no browser: that draws in its own time).  States the steps in a second of each, and what share
of the wall clock the publishers' threads were at work.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from functools import partial
from pathlib import Path
from time import monotonic

import numpy as np

from app import session
from app.live.command import SWITCH
from app.live.engine import Engine
from app.live.publisher import FILE_STEPS, VIEWER_STEPS, Publisher
from app.recording.live import LiveHost, quiet
from scenarios.registry import build
from slam.estimators import ESTIMATORS


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--particles", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=240)
    arguments = parser.parse_args()
    quiet()
    sys.setswitchinterval(SWITCH)
    from app.recording.session import SessionWriter
    from app.recording.stream import FileStream

    source = build("loop", features="landmarks", max_range=7.0)
    seen = np.mean([len(step.frame.z) for step in source.steps[: arguments.steps]])
    print(f"{arguments.particles} particles, {seen:.1f} observations a step, {arguments.steps} steps")
    host = LiveHost()
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "live.rrd"
        for name, with_file, with_stream in (
            ("warm", 0, 0),
            ("alone", 0, 0),
            ("file", 1, 0),
            ("file and stream", 1, 1),
        ):
            publishers = []
            if with_file:
                publishers.append(Publisher(SessionWriter(partial(FileStream, path, index=False)), "wait", FILE_STEPS))
            if with_stream:
                publishers.append(Publisher(SessionWriter(host.open, live=True), "drop", VIEWER_STEPS))
            filters = [ESTIMATORS[key] for key in ("dfs", "fs2", "fs1")]
            info = session.make_info(source, filters, source.params(particles=arguments.particles), seed=1)
            engine = Engine(info, publishers)
            engine.start()
            began = monotonic()
            engine.step(arguments.steps)
            engine.wait(lambda s: s.step == arguments.steps, 600.0)
            made = monotonic() - began
            engine.close(600.0)
            for publisher in publishers:
                publisher.join(600.0)
            done = monotonic() - began
            shares = ", ".join(f"{p.seconds / done:.0%} ({p.published} of {arguments.steps})" for p in publishers)
            made_rate, done_rate = arguments.steps / made, arguments.steps / done
            print(f"{name}: {made_rate:.0f} steps/s made, {done_rate:.0f} with all written; {shares}")
        print(f"file: {path.stat().st_size / 1024 / arguments.steps:.0f} KiB a step")
    host.close()


if __name__ == "__main__":
    main()
