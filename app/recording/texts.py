"""The pages of a recording: what it is and how to read it, and everything that it was made with."""

from __future__ import annotations

import dataclasses
import json
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from app import colours
from app.recording.limits import Limits
from app.relations import LEAST, Breaks, metres
from app.types import SessionInfo
from slam.features import Wall
from slam.mistakes import MISTAKES

PAPER = (
    "D. Rodriguez-Losada, P. San Segundo, F. Matia, L. Pedraza, *Dual FastSLAM: Dual Factorization of the Particle "
    "Filter Based Solution of the Simultaneous Localization and Mapping Problem*, J. Intell. Robot. Syst. 55 (2009) "
    "109-134"
)
LANDMARKS = """\
**Associations**, thin lines from where the best particle saw a landmark to the one it took it for, are hidden in every
view until they are switched on: open the panel on the left, find `associations` below the view and the filter, and
click on its eye."""

WALLS = """\
**Walls.** What the laser saw is drawn twice. Dim yellow dots are its returns, seen from the true pose. Thick lines are
the pieces of wall that were made of them, where the best particle believes to see them: **yellow** if it matched them
with a wall of its map, **violet** if they are new to it, **red** if it rejected them, too far from any wall to be of it
and too near to one to be new. The map is that of the best particle. A wall is the brighter the more often it was seen;
point at it, and `observations` says how often. A dot is an end that is known to be one; an end without a dot is only as
far as anybody saw. Bands are two standard deviations of where a wall lies; Dual FastSLAM's walls have none, and bands
of up to 2 cm are left out. The true walls are broad and grey. The outlined ellipse is that of the best particle: in a
corridor, that says nothing about the way along it, it is long and narrow. The maps of all particles are a bundle that
opens along the way, and closes when a loop does.

**Associations**, thin lines from the middle of every matched piece to the wall it was matched with, are hidden in every
view until they are switched on: open the panel on the left, find `associations` below the view and the filter, and
click on its eye."""

LOG = """\
**The log.** Faint grey dots are what all scans met, as the path of the best particle of the first filter places them:
where they lie twice, or beside the walls of the map, something is wrong. With `--relations`, thin light lines in the
colour of a filter lead from where its path has the robot to where a relation between two scans has it; the page
*Relations* says how far that is."""

VIEWS = """\
**Plots.** N_eff says how many particles still count; below the grey line the filter resamples. It is
blind to copies: when all particles are clones of one, N_eff is K. Diversity is the share of the particles of the
beginning that have descendants. NEES compares the error with what the filter believes of it:
above the band it is overconfident, below it too modest. At the upper border of its plot it is infinite.

**Ancestry.** From left to right the run until the present step, which is the white line. On the right are the
particles of the present (a sample, if there are many), and the lines lead to them from their ancestors: where two meet
is an ancestor that they have in common. A line is the thicker the more descend from it. Its colour is that of its
founder, the same as of the paths on the map of that filter; what all have in common has the colour of the filter. When
all descend from one founder the living become founders, so that colours begin anew. Dim lines died out. The curves
beside it say how many different ancestors the particles had so many steps back, both on logarithmic scales.

**Hypotheses** counts, for every feature, how many different versions of it are left among the maps of all particles:
one means that all have the same, and that no weight can choose. **Weights** are times K, largest first: equal weights
are a row of ones.

**Timelines.** `step` has one picture for each observing step, with the weights of that step. `stage` has three:
*predicted*, *weighted*, *resampled*; choose it in the panel below and go through them with the arrow keys. `sim_time`
is the time of the world or log."""

PACKAGES = ("dual-fastslam-workbench", "numpy", "scipy", "numba", "rerun-sdk")


def about(info: SessionInfo, shown: Limits) -> str:
    """Markdown: what the recording is, how to read its views, where the methods come from."""
    legend = "\n".join(f"- **{f.title}** is {colours.word(f.key)} (`{f.key}`). {f.reference}." for f in info.filters)
    walls = isinstance(info.source.feature, Wall)
    faint, features = ("lines", WALLS) if walls else ("dots", LANDMARKS)
    if info.source.scans is not None:
        features += f"\n\n{LOG}"
    return f"""\
# {info.source.title}

{len(info.filters)} SLAM filters on identical data: the same controls, the same observations. The truth is white, dead
reckoning grey, observations are dim yellow.

{legend}
{_mistake(info.mistake)}
The Dual FastSLAM paper: {PAPER}.

## How to read it

**Map.** Dots with a line are particles and their headings: faint where the weight is small, white where it is large.
Ellipses are two standard deviations. Filters that agree show as rings around each other. The close-ups follow each
filter's estimate and change their scale by themselves; the size of a square is written below. A filter is overconfident
when the truth lies far outside of its particles. The tab of a filter adds the maps of all particles (faint {faint}) and
all surviving paths: up to where they run together, the particles remember only one past. What the map of all filters
hides for clarity can be switched on in the panel on the left.

{features}

{VIEWS}

## What is recorded

All plots and events. Of the particles of each filter at most {shown.particles} are drawn ({shown.ellipses} with
ellipse). Paths are redrawn every {_steps(shown.paths)}; lineages, ancestry and all maps every {_steps(shown.pictures)},
with at most {shown.hypotheses} features of all maps{" (a wall that particles share counts once)" if walls else ""}.
"""


def _mistake(name: str) -> str:
    """What is wrong on purpose, as a paragraph."""
    return f"\n**This run is wrong on purpose** (`--mistake {name}`). {MISTAKES[name].told}\n" if name else ""


def relations(found: Mapping[str, Breaks], titles: Mapping[str, str], step: int) -> str:
    """Markdown: how well the paths fit the relations that they are judged by, as they are known after a step."""
    rows = "\n".join(_row(titles.get(key, key), breaks) for key, breaks in found.items() if len(breaks.off))
    return f"""\
# Relations after step {step}

How far the second of two scans is from where it should be, seen from the first. On the map a thin line leads from where
the path has the robot to where the relation has it, wherever that is more than {LEAST:g} m.

| path | mean [m] | 95 % [m] | largest [m] | between scans | relations |
|---|--:|--:|--:|---|--:|
{rows or "| none has both scans of any | | | | | |"}
"""


def means_on_relations(page: str) -> dict[str, str]:
    """From such a page back to the mean error [m] of each path, as it stands there."""
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    return {cells[0]: cells[1] for cells in rows[1:] if len(cells) == len(rows[0])}


def _row(title: str, breaks: Breaks) -> str:
    worst = int(np.argmax(breaks.off))
    lengths = (breaks.off.mean(), np.quantile(breaks.off, 0.95), breaks.off[worst])
    one, other = breaks.scans[worst]
    return f"| {title} | {' | '.join(map(metres, lengths))} | {one} and {other} | {len(breaks.off)} |"


def description(info: SessionInfo, time_origin: float) -> dict[str, Any]:
    """Everything that a session was made with, as JSON knows it; SI units and radians."""
    return {
        "schema": 1,
        "world": info.source.name,
        "title": info.source.title,
        "kind": info.source.kind,
        "features": "walls" if isinstance(info.source.feature, Wall) else "landmarks",
        "options": _plain(info.source.options),
        "seed": info.seed,
        "steps": info.steps,
        "command": info.command,
        "filters": [{"key": f.key, "title": f.title, "reference": f.reference} for f in info.filters],
        "mistake": info.mistake or None,
        "params": dataclasses.asdict(info.params),
        "noise": dataclasses.asdict(info.noise),
        "start": [float(x) for x in info.source.start],
        "time_origin_s": time_origin,
        "versions": versions(),
    }


def parameter_page(description: dict[str, Any]) -> str:
    """Markdown: the same as a table."""
    rows = "\n".join(f"| {name} | {_cell(value)} |" for name, value in _flat(description))
    return f"# Parameters\n\nSI units, angles in radians.\n\n| name | value |\n|---|---|\n{rows}\n"


def versions() -> dict[str, str]:
    """Of Python and of the packages whose version may change a result or a recording."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def _steps(every: int) -> str:
    return "step" if every == 1 else f"{every} steps"


def _flat(value: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, inner in value.items():
        if name == "filters":
            rows.append((name, ", ".join(f["title"] for f in inner)))
        elif isinstance(inner, dict):
            rows += _flat(inner, f"{prefix}{name}.")
        else:
            rows.append((prefix + name, inner))
    return rows


def _cell(value: Any) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|").replace("\n", " ")


def _plain(value: Any) -> Any:
    """What JSON has no word for becomes text."""
    return json.loads(json.dumps(value, default=str))
