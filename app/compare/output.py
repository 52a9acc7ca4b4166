"""`--out DIR`: the numbers, the plots, and the recordings side by side.

`compare.json`, stable and versioned:

    {"schema": 1, "version": "0.1.0", "command": text,
     "steps": {"first", "last", "count"},    those that all runs have, over which they are compared
     "said": [sentence, ...],                what differs, in words
     "study": [text, ...],                   what to do about luck
     "runs": [{"name", "file", "branch" (null: the run itself), "world", "title", "kind", "seed", "command",
        "mistake": name | null,             that its filters make on purpose
        "steps": n, "asked": n, "damaged": bool,
        "params": {every field of slam.types.Params}, "noise": {...} | null, "options": {...}, "versions": {...},
        "changes": [[step, sentence], ...],
        "differences": {dotted name: [of the first run, of this one], ...},
        "data": {"same": bool, "equal": [...], "other": {what: first step at which it is not equal}} | null}, ...],
     "filters": {key: {
        "title": text, "steps": {"first", "last", "count"}, "step": [...],
        "nees_interval": [low, high],        95 % of the mean over the known steps
        "runs": {name: {
           "particles": K, "same_run": bool, "differs_from_step": n | null, "missing": [series, ...],
           "numbers": {key: number | null, ...}, "nees_infinite": n,
           "differences": {key: number | null, ...},      from the first run that has the filter
           "series": {name: [...], ...}}}}},
     "plots": [name, ...]}                   DIR/<name>.png and DIR/<name>.svg

- SI units and radians; the keys of `numbers` are those of `rows.ROWS`, the series those of `--summary` (and
  `map_error_m`, `common_ancestor_steps` and `seconds`, of a step), with an entry for each of the filter's steps.
- `null` is what is not known, and infinity, which JSON does not have: infinite NEES are counted in `nees_infinite` and
  not in the mean.
- `same_run`: every number of every step but its time is that of the first run that has the filter, bit for bit.
- `missing`: series that the recording does not have, being damaged or of another version; null throughout.
- `data`: of truth, odometry and observations what is equal at all common steps, as exactly as recordings have them
  (single precision).
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from app.compare import plots
from app.compare.numbers import Column, Comparison, Filter
from app.compare.runs import Run, root_of
from app.compare.table import markdown
from app.compare.words import data_of, differences
from app.errors import UsageError
from app.files import check_directory, check_file, write_whole
from app.recording.ground import Extent
from app.recording.merging import Part, merge
from app.recording.stream import check_path
from app.rows import ROWS, known
from app.summary import dump, plain
from app.version import version
from slam.metrics import nees_interval
from slam.types import Ints

SCHEMA = 1
JSON, MERGED = "compare.json", "compare.rrd"

NEEDS = {
    "truth": "position_error_m",
    "heading": "heading_error_rad",
    "map": "map_error_m",
    "tags": "duplicates_so_far",
}
"""What somebody must know (`recording.metrics`), and the series that tells whether somebody does."""


def check(folder: Path, files: list[Path]) -> None:
    """Fail now, with a sentence, if something could not be written later, or is one of the recordings `files`."""
    check_directory("--out", folder)
    for name in (JSON, *plots.names()):
        if (folder / name).exists():
            check_file("--out", folder / name)
    merged = folder / MERGED
    if not merged.exists():
        return
    check_path(merged, "--out")
    if any(file.exists() and merged.samefile(file) for file in files):
        raise UsageError(
            f"--out {folder} would overwrite {merged}, which is to be compared; expected another directory"
        )


class Told(NamedTuple):
    """What is said beside the numbers."""

    said: list[str]
    """Before them: what differs."""
    study: list[str]
    """After them: that one run each is no statistics."""


def write(found: Comparison, told: Told, folder: Path, command: str) -> list[str]:
    """Write everything; sentences on what is where."""
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / JSON).exists():  # plots of an earlier comparison, not all of which may be drawn again
        for name in plots.names():
            (folder / name).unlink(missing_ok=True)
    drawn = plots.draw(found, folder)
    write_whole(folder / JSON, dump(as_dict(found, told, command, drawn)))
    merged = folder / MERGED
    merge(merged, [_part(run, found) for run in found.runs], _extent(found), page(found, told))
    return [
        f"plots: {folder}/{{{','.join(drawn)}}}.{{png,svg}}",
        f"numbers: {folder / JSON}",
        f"recording: {merged}   (open it with: rerun {shlex.quote(str(merged))})",
    ]


def page(found: Comparison, told: Told) -> str:
    """Markdown: what is said and the tables, for the merged recording."""
    said = "\n".join(f"- {sentence}" for sentence in told.said)
    tables = "\n\n".join(markdown(one, found) for one in found.filters)
    luck, *commands = told.study
    study = "\n".join(f"    {command}" for command in commands)
    return f"# {' | '.join(run.name for run in found.runs)}\n\n{said}\n\n{tables}\n\n{luck}\n\n{study}\n"


def as_dict(found: Comparison, told: Told, command: str, drawn: list[str]) -> dict[str, Any]:
    """As the module's docstring lays it out."""
    return plain(
        {
            "schema": SCHEMA,
            "version": version(),
            "command": command,
            "steps": _span(found.steps),
            "said": told.said,
            "study": told.study,
            "runs": [_run(run, found) for run in found.runs],
            "filters": {one.key: _filter(one) for one in found.filters},
            "plots": drawn,
        }
    )


def _run(run: Run, found: Comparison) -> dict[str, Any]:
    first, told = found.runs[0], run.told
    data = None if run is first else data_of(first, run, found.steps)
    return {
        "name": run.name,
        "file": str(run.path),
        "branch": run.branch or None,
        **{name: told[name] for name in ("world", "title", "kind", "seed", "command")},
        "mistake": told.get("mistake"),
        "steps": len(run.steps),
        "asked": told["steps"],
        "damaged": run.damaged,
        "params": told["params"],
        "noise": told["noise"] if told["kind"] == "world" else None,
        "options": told["options"],
        "versions": told["versions"],
        "changes": run.changes,
        "differences": differences(first, run),
        "data": data and data._asdict(),
    }


def _filter(one: Filter) -> dict[str, Any]:
    return {
        "title": one.title,
        "steps": _span(one.steps),
        "step": one.steps,
        "nees_interval": nees_interval(2, max(one.known_steps, 1)),
        "runs": {column.run.name: _column(one, column) for column in one.columns},
    }


def _column(one: Filter, column: Column) -> dict[str, Any]:
    there = [row for row in ROWS if row.series in column.series]
    return {
        "particles": column.particles,
        "same_run": column.parts_at is None,
        "differs_from_step": column.parts_at,
        "missing": sorted(column.missing),
        "numbers": {row.key: column.values[row.key] for row in there},
        "nees_infinite": int(np.isinf(known(column.series["nees"])).sum()),
        "differences": {row.key: one.difference(row, column) for row in there},
        "series": column.series,
    }


def _span(steps: Ints) -> dict[str, int]:
    return {"first": int(steps[0]), "last": int(steps[-1]), "count": len(steps)}


def _part(run: Run, found: Comparison) -> Part:
    columns = [column for one in found.filters if (column := one.column(run))]
    told = {what for what, name in NEEDS.items() if any(len(known(column.series[name])) for column in columns)}
    return Part(run.name, run.path, root_of(run.branch), list(run.filters), frozenset(told), run.walls)


def _extent(found: Comparison) -> Extent:
    """What holds the true map and the ways of all runs: of filters, where nobody knows the truth."""
    lines, share, room = [np.zeros((0, 2))], 0.02, 0.5
    for run in found.runs:
        place = run.place(int(run.steps[-1]))
        of_truth = [*place.truth, *place.true_walls, *place.true_landmarks]
        share, room = (share, room) if of_truth else (0.08, 5.0)  # as where nobody knows what else there is
        lines += of_truth or place.points()
    points = np.concatenate(lines)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.ones(2))
    margin = max(share * float(max(high - low)), room)
    return Extent(low - margin, high + margin)
