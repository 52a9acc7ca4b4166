"""Reading recordings, also those of a run that was killed or of a disk that was full."""

from __future__ import annotations

import json
import math
import subprocess
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from app.diagnosis.evidence import Observations, Record, record_of
from app.recording.errors import MAGIC, RecordingError
from app.recording.metrics import LONERS
from app.recording.program import binary
from slam.types import Floats, Ints

if TYPE_CHECKING:
    from rerun.chunk import Chunk, LazyChunkStream, RrdReader

SCALAR, PROPERTIES = "Scalars:scalars", "/__properties"
SESSION = f"{PROPERTIES}/session"
MERGED = "/__properties/comparison"
"""What a recording has that `merging` made of others."""

PLOTTED = {
    "n_eff": ("n_eff", 1.0),
    "diversity": ("diversity", 1.0),
    "common_ancestor": ("common_ancestor", 1.0),
    "position_error_m": ("position_error", 1.0),
    "heading_error_rad": ("heading_error", math.radians(1.0)),
    "map_error_m": ("map_error", 1.0),
    "nees_position": ("nees", 1.0),
    "features": ("features", 1.0),
    "duplicates": ("duplicates", 1.0),
}
"""By the name that a diagnosis has for it, what is also plotted, and the factor to SI units and radians."""

PATIENCE = 600.0
"""[s] for the repair of a large file."""


class Event(NamedTuple):
    """A line of `/events`."""

    step: int
    level: str
    text: str


class Recording:
    """What a recording holds.  Reads the file once, when it is opened; a damaged one up to the damage."""

    def __init__(self, path: str | Path, below: Sequence[str] = ()) -> None:
        """`below` are the entities that are wanted, each with all below it, of a large file; by default all."""
        self.path = Path(path)
        _check(self.path)
        with _readable(self.path, below) as (chunks, damaged):
            self.damaged = damaged
            """Whether it ends in the middle of something, and was read up to there."""
            self._chunks: dict[str, list[Chunk]] = {}
            for chunk in chunks:
                self._chunks.setdefault(chunk.entity_path, []).append(chunk)
        if MERGED in self._chunks:
            raise RecordingError(f"{self.path} was merged from several recordings; expected one of these")
        if SESSION not in self._chunks:
            raise RecordingError(f"{self.path} is a Rerun recording, but not one of dualslam")

    @property
    def entities(self) -> list[str]:
        """Paths of all entities, sorted."""
        return sorted(self._chunks)

    def timelines(self, entity: str) -> set[str]:
        """The timelines that an entity has data on; none if it is static only."""
        return {name for chunk in self._chunks.get(entity, ()) for name in chunk.timeline_names}

    def params(self, branch: str = "") -> dict[str, Any]:
        """Everything that the session, or a branch of it, was made with, as `texts.description` gives it."""
        for _, (text,) in self._rows(f"{SESSION}-{branch}" if branch else SESSION, "json"):
            return json.loads(text)
        raise RecordingError(f"{self.path} does not say what it was made with")

    def branches(self) -> list[str]:
        """Of a live session, the names that its branches have in the recording, in alphabetical order."""
        return [entity.removeprefix(f"{SESSION}-") for entity in self.entities if entity.startswith(f"{SESSION}-")]

    def way(self, branch: str) -> list[str]:
        """The run itself (its name is empty), all branches that were left on the way to this one, and this one."""
        way = [branch]
        while way[0]:  # a recording of an earlier version does not say where a branch left: then it was the run itself
            parent = self.params(way[0]).get("parent", "")
            way.insert(0, "" if parent in way else parent)
        return way

    def chunks(self, prefix: str = "/") -> list[Chunk]:
        """Rerun's own pieces of everything below a path that ends in a slash, in no particular order."""
        return [chunk for entity, found in self._chunks.items() if entity.startswith(prefix) for chunk in found]

    def filters(self) -> list[str]:
        """Keys of the filters, in the order in which they were asked for."""
        return [f["key"] for f in self.params()["filters"]]

    def series(self, entity: str, timeline: str = "step") -> tuple[Ints | Floats, Floats]:
        """A plotted series such as `/plots/n_eff/dfs`: times (T,) (steps; seconds for `sim_time`) and values (T,)."""
        rows = [(t, values[0]) for t, values in self._rows(entity, SCALAR, timeline) if len(values)]
        if not rows:
            raise RecordingError(f"{self.path} has no series {entity} on the timeline {timeline}")
        times, values = (np.array(column) for column in zip(*sorted(rows, key=lambda r: r[0]), strict=True))
        return times * 1e-9 if timeline == "sim_time" else times, values.astype(float)

    def ancestors(self, key: str, branch: str = "") -> list[Ints]:
        """Of a filter, for every step from the first: of which particle before it each one after it is a copy, (K,).

        `slam.genealogy` has functions of such a list.  Up to the last step of which there is a number.
        """
        below = f"/branch/{branch}" if branch else ""
        found = dict(self.rows(f"{below}/ancestors/{key}", "ancestors", "step"))
        if 1 not in found:
            raise RecordingError(f"{self.path} does not say which particles of {key} descend from which")
        steps, _ = self.series(f"{below}/plots/n_eff/{key}")
        ancestors, particles = [], 0
        for step in range(1, int(steps[-1]) + 1):
            if step in found:
                ancestors.append(np.array(found[step], np.int64))
                particles = len(ancestors[-1])
            else:  # none died, none was copied
                ancestors.append(np.arange(particles))
        return ancestors

    def events(self, entity: str = "/events") -> list[Event]:
        """All events, in order; those of a branch have another entity."""
        texts = self._rows(entity, "TextLog:text", "step")
        levels = self._rows(entity, "TextLog:level", "step")
        return [Event(int(t), level[0], text[0]) for (t, text), (_, level) in zip(texts, levels, strict=True)]

    def evidence(self, key: str, prefix: str = "") -> Record:
        """What a filter left for a diagnosis; `prefix` is that of the entities of a branch, such as `/branch/six`.

        Of a recording that has none (it is of an earlier version) what its plots tell, with K as it was at the
        beginning; the rest is missing.
        """
        entity, names = f"{prefix}/evidence/{key}", list(self._rows(f"{prefix}/evidence", "names"))
        columns = [dict(self._rows(entity, what, "step")) for what in ("numbers", *Observations._fields)]
        steps = sorted(set.intersection(*map(set, columns)))
        if not names or not steps:
            return self._evidence_of_plots(key, prefix)
        numbers, shares, features, widths = columns
        seen = [
            Observations(np.array(shares[i], float), np.array(features[i], np.int64), np.array(widths[i], float))
            for i in steps
        ]
        return record_of(np.array(steps), names[0][1], np.array([numbers[i] for i in steps], float), seen)

    def _evidence_of_plots(self, key: str, prefix: str) -> Record:
        series = {}
        for name, (metric, unit) in PLOTTED.items():
            rows = self._rows(f"{prefix}/plots/{metric}/{key}", SCALAR, "step")
            series[name] = {step: unit * values[0] for step, values in rows if len(values)}
        steps = sorted(set().union(*series.values()))
        if not steps:
            raise RecordingError(f"{self.path} has no numbers of the filter {key}")
        known = [name for name, found in series.items() if found]
        K = self.params(prefix.rpartition("/")[2])["params"]["particles"] if key not in LONERS else 1
        rows = np.array([[K, *(series[name].get(i, math.nan) for name in known)] for i in steps])
        return record_of(np.array(steps), ["particles", *known], rows, [])

    def rows(self, entity: str, component: str, timeline: str = "stage") -> list[tuple[int, list[Any]]]:
        """Every value of a component such as `Points3D:positions`, with its time, in order of time."""
        return sorted(self._rows(entity, component, timeline), key=lambda row: row[0])

    def points(self, entity: str, component: str, timeline: str = "step") -> dict[int, list[Floats]]:
        """By time, a component of points or of lines such as `LineStrips3D:strips`, in the plane: an array (n, 2) [m]
        for each line, or one for all points; of what is static, at time 0."""
        import pyarrow as pa

        found: dict[int, list[Floats]] = {}
        for chunk in self._chunks.get(entity, ()):
            batch = chunk.to_record_batch()
            if component not in batch.schema.names or not (chunk.is_static or timeline in batch.schema.names):
                continue
            times = [0] if chunk.is_static else batch.column(timeline).cast(pa.int64()).to_pylist()
            for time, value in zip(times, batch.column(component), strict=True):
                if value.is_valid:
                    rows = value.values
                    lines = [line.values for line in rows] if pa.types.is_list(rows.type) else [rows]
                    found[time] = [line.flatten().to_numpy().reshape(-1, 3)[:, :2].copy() for line in lines]
        return found

    def _rows(self, entity: str, component: str, timeline: str | None = None) -> list[tuple[int, list[Any]]]:
        import pyarrow as pa

        found = []
        for chunk in self._chunks.get(entity, ()):
            batch = chunk.to_record_batch()
            if component not in batch.schema.names or (timeline and timeline not in batch.schema.names):
                continue
            times = batch.column(timeline).cast(pa.int64()).to_pylist() if timeline else [0] * batch.num_rows
            values = batch.column(component).to_pylist()
            found += [(t, v) for t, v in zip(times, values, strict=True) if v is not None]
        return found


def read_series(path: str | Path, entity: str, timeline: str = "step") -> tuple[Ints | Floats, Floats]:
    """`Recording.series` of one file."""
    return Recording(path).series(entity, timeline)


def read_params(path: str | Path) -> dict[str, Any]:
    """`Recording.params` of one file."""
    return Recording(path).params()


def repair(path: str | Path, out: str | Path | None = None) -> Path:
    """Write what can be read of a damaged recording to `out`, by default `<name>-repaired.rrd` beside it; say where."""
    path = Path(path)
    _check(path)
    out = path.with_name(f"{path.stem}-repaired.rrd") if out is None else Path(out)
    done = subprocess.run(
        [str(binary()), "rrd", "optimize", str(path), "-o", str(out)],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    if done.returncode != 0 or not out.exists():
        raise RecordingError(f"{path} cannot be read: it is damaged, and nothing in it can be made out")
    return out


def _check(path: Path) -> None:
    try:
        with path.open("rb") as file:
            start = file.read(len(MAGIC))
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}") from None
    if start != MAGIC:
        raise RecordingError(f"{path} is empty" if not start else f"{path} is no Rerun recording")


@contextmanager
def _readable(path: Path, below: Sequence[str]) -> Iterator[tuple[list[Chunk], bool]]:
    """The chunks of a file, and False; of one that is cut in the middle of a chunk, of a repaired copy, and True."""
    try:
        yield _chunks(path, below), False
        return
    except (RuntimeError, ValueError):
        pass
    with tempfile.TemporaryDirectory() as folder:
        repaired = repair(path, Path(folder) / "repaired.rrd")
        try:
            yield _chunks(repaired, below), True
        except (RuntimeError, ValueError):
            raise RecordingError(f"{path} cannot be read: it ends before anything was recorded in it") from None


def _chunks(path: Path, below: Sequence[str] = ()) -> list[Chunk]:
    reader = open_reader(path)
    try:
        return _wanted(reader.store().stream(), below).to_chunks()  # by the index at the end of a complete file
    except RuntimeError:
        return _wanted(reader.stream(), below).to_chunks()


def _wanted(stream: LazyChunkStream, below: Sequence[str]) -> LazyChunkStream:
    return stream.filter(content=[f"+ {entity}/**" for entity in (*below, PROPERTIES)]) if below else stream


def open_reader(path: Path) -> RrdReader:
    """Rerun's reader, without its warning of files that have no index."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return RrdReader(path)
