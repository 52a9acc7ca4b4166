"""Several recordings as one: each below a path of its own, on the timelines that they share.

Rerun shows one recording at a time, and only of one can curves lie in one plot.  The entities are those of `recording`,
below `/<name>/` for each that was merged, and

    /comparison             what differs: a page to read
    property `comparison`   that it was merged, so that nobody takes it for a session
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from app import colours
from app.recording.ground import Extent
from app.recording.reading import Recording
from slam.estimators import ESTIMATORS

if TYPE_CHECKING:
    from rerun.chunk import Chunk

    from app.recording.blueprint import Shown

APPLICATION = "dual-fastslam-comparison"
"""Another one than that of sessions, which have another layout."""

PAGE = "comparison"

BANDS = ("/lower", "/upper")
"""Guides in plots that are the same in all recordings; those of the first are enough."""


class Part(NamedTuple):
    """One of the recordings."""

    name: str
    """Unique among them, for people."""
    path: Path
    root: str
    """Of the entities that are merged: `/`, or that of a branch; ends in a slash."""
    filters: Sequence[str]
    """Their keys."""
    known: frozenset[str]
    """What somebody knows (`metrics.known_of`)."""
    walls: bool
    """What its features are, or else landmarks."""


def merge(path: Path, parts: Sequence[Part], extent: Extent, page: str, option: str = "--out") -> None:
    """Write all parts to one file; `page` is Markdown, `extent` what every map shows.

    Raises `RecordingError` where that cannot be written, `RecordingLost` if the disk is full.
    """
    os.environ.setdefault("RUST_LOG", "off")  # Rerun says on stderr what is raised here
    import rerun as rr

    from app.recording.blueprint import layout_of_comparison
    from app.recording.stream import FileStream

    shown = _shown(parts, extent)
    title = " | ".join(part.name for part in parts)
    stream = FileStream(path, layout_of_comparison(shown, PAGE), title, option=option, application=APPLICATION)
    stream.property(PAGE, rr.AnyValues(json=json.dumps([part.name for part in parts])))
    stream.log_static(PAGE, rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN))
    for rank, (part, run) in enumerate(zip(parts, shown, strict=True)):
        stream.send(_moved(Recording(part.path), part, run.prefix, first=rank == 0))
        for entity, look in _curves(run, rank, bands=rank == 0):
            stream.log_static(entity, look)
        stream.check()
    stream.close()


def _shown(parts: Sequence[Part], extent: Extent) -> list[Shown]:
    from app.recording import landmarks, walls
    from app.recording.blueprint import Shown
    from app.recording.writer import slug, unused

    taken, shown = [PAGE], []
    for part in parts:
        taken.append(unused(slug(part.name), taken))
        legend = walls.LEGEND if part.walls else landmarks.LEGEND
        filters = tuple(ESTIMATORS[key] for key in part.filters)
        shown.append(Shown(filters, extent, part.known, legend, f"{taken[-1]}/", part.name))
    return shown


def _moved(recording: Recording, part: Part, prefix: str, first: bool) -> Iterator[Chunk]:
    """All of a part below its prefix, but how its curves look."""
    for chunk in recording.chunks(part.root):
        entity = chunk.entity_path.removeprefix(part.root)
        if entity.startswith("__properties") or (entity.startswith("branch/") and part.root == "/"):
            continue
        of_plots = entity.startswith("plots/")
        band = of_plots and entity.endswith(BANDS)
        if not (of_plots and chunk.is_static) and (first or not band):
            yield chunk.with_entity_path(f"/{prefix}{entity}")


def _curves(run: Shown, rank: int, bands: bool) -> Iterator[tuple[str, object]]:
    """How they look in plots that all runs share: named after the run, in a shade of its own."""
    import rerun as rr

    from app.recording.metrics import METRICS
    from app.recording.writer import BRANCH_WIDTH, GUIDE, GUIDES, WIDTH

    width = WIDTH if rank == 0 else BRANCH_WIDTH
    for estimator in run.filters:
        rgb = colours.of_run(colours.of_filter(estimator.key), rank, on_dark=True)
        look = rr.SeriesLines(names=run.named(estimator.title), colors=rgb, widths=width)
        for metric in METRICS:
            yield f"{run.prefix}plots/{metric.name}/{estimator.key}", look
    for path, name in GUIDES.items():
        if bands or not path.endswith(BANDS):
            title = name if path.endswith(BANDS) else run.named(name)
            yield f"{run.prefix}plots/{path}", rr.SeriesLines(names=title, colors=GUIDE, widths=1.0)
