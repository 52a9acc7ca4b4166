"""The runs of a lesson."""

from __future__ import annotations

from collections.abc import Sequence

from app import session
from app.interrupt import Interrupts
from app.lessons.lesson import Lesson, Variant
from app.lessons.watching import Beliefs, Ran
from app.run import session_of_command
from app.summary import Summary
from app.types import Observer, SessionInfo


def info_of(variant: Variant, seed: int, command: str = "run") -> SessionInfo:
    """The session of a variant, as the command line begins it, `run` or `live`."""
    return session_of_command(f"dualslam {command} {variant.options} --seed {seed}")


def run(info: SessionInfo, ran: Ran, observers: Sequence[Observer] = (), interrupts: Interrupts | None = None) -> None:
    """Run it; `ran` has what came of it, after an interruption too."""
    session.run(info, [ran.summary, ran.beliefs, *observers], interrupts=interrupts)


def empty() -> Ran:
    """To be filled by `run`."""
    return Ran(Summary(), Beliefs())


def run_all(lesson: Lesson, seed: int) -> dict[str, Ran]:
    """All variants of a lesson with one seed, by name."""
    found = {}
    for variant in lesson.variants:
        found[variant.name] = empty()
        run(info_of(variant, seed), found[variant.name])
    return found
