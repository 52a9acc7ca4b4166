"""The runs of a study: spread over processes, the same results whatever their number, and interruptible."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from app.compiling import CompileClock, uninterrupted_compilation
from app.interrupt import Interrupts
from app.report import COMPILING


def cores() -> int:
    """How many processes may run at once."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_all(function: Callable[[Any], Any], tasks: Sequence[Any], jobs: int, title: str) -> tuple[list[Any], bool]:
    """The results of function(task) for each task, in order, and whether an interruption left some out.

    `function` must be at the top level of a module, and its result follow from the task alone.
    """
    console = Console(stderr=True, highlight=False)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total} runs"))
    results: dict[int, Any] = {}
    progress = Progress(
        *columns,
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    interrupted = False
    try:
        with Interrupts() as interrupts, uninterrupted_compilation(interrupts), progress:
            bar = progress.add_task(title, total=len(tasks))

            def compiling(now: bool) -> None:
                progress.update(bar, description=COMPILING if now else title, refresh=True)

            # The first runs here, so that what must be compiled is compiled once and not in every process.
            here = len(tasks) if jobs == 1 else 1
            with CompileClock(compiling):
                for index in range(min(here, len(tasks))):
                    results[index] = function(tasks[index])
                    progress.advance(bar)
            if here < len(tasks):
                _spread(function, tasks, here, jobs, results, lambda: progress.advance(bar))
    except KeyboardInterrupt:
        interrupted = True
    return [results[index] for index in sorted(results)], interrupted


def _spread(
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    first: int,
    jobs: int,
    results: dict[int, Any],
    done: Callable[[], None],
) -> None:
    """Run tasks[first:] in other processes; fills `results`."""
    pool = ProcessPoolExecutor(min(jobs, len(tasks) - first), mp_context=multiprocessing.get_context("spawn"))
    try:
        # Ctrl-C goes to every process of a terminal; new ones inherit that it is for us to handle.
        former = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            futures = {pool.submit(function, tasks[index]): index for index in range(first, len(tasks))}
        finally:
            signal.signal(signal.SIGINT, former)
        for future in as_completed(futures):
            results[futures[future]] = future.result()
            done()
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
