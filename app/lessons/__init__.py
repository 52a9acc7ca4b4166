"""Guided demonstrations, `dualslam lesson NAME`: a question, runs that answer it, and the answer in numbers.

A new one is a file with a `Lesson` (`lesson.py`), and one line here.
"""

from app.lessons import (
    corridor,
    dual_idea,
    good_sensor,
    improved_proposal,
    loop,
    one_landmark_too_many,
    overconfidence,
    rotation,
)
from app.lessons.lesson import Lesson

LESSONS: dict[str, Lesson] = {
    module.LESSON.name: module.LESSON
    for module in (
        good_sensor,
        improved_proposal,
        dual_idea,
        corridor,
        rotation,
        one_landmark_too_many,
        loop,
        overconfidence,
    )
}
"""In the order in which they are best taken."""
