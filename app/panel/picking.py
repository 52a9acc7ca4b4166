"""Which particle was picked, what became of it, and what there is to say about it.

A pick is a particle of `Trace.weighted`, which is what the top view shows: the step's weights, before its resampling.
When the session goes on it becomes the heaviest of its descendants; when the session goes back, its ancestor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.live.engine import Status
from app.types import FilterUpdate
from slam.estimators import ESTIMATORS
from slam.types import Floats, Ints

BEGUN_AGAIN = "The session has begun again."
HINT = "Click a particle in the map to look into it."


class Where(NamedTuple):
    """A step of a session."""

    number: int
    """Which session."""
    branch: str
    step: int


class Pick(NamedTuple):
    """A particle that somebody looks at."""

    key: str
    """Of its filter."""
    particle: int
    """Index in `Trace.weighted` of the step."""
    where: Where
    update: FilterUpdate
    """That step."""


class Lost(NamedTuple):
    """Why there is no pick any more."""

    reason: str


def where(status: Status) -> Where | None:
    """Where a session stands; None before its first step."""
    return None if status.taken is None else Where(status.number, status.branch, status.taken.step.index)


def title(key: str) -> str:
    """The name of a filter."""
    return ESTIMATORS[key].title if key in ESTIMATORS else key


def followed(pick: Pick, status: Status) -> Pick | Lost:
    """The pick where the session stands now."""
    now = where(status)
    if now is None or status.taken is None or now.number != pick.where.number:
        return Lost(BEGUN_AGAIN)
    update = status.taken.step.filters.get(pick.key)
    if update is None:
        return Lost(f"{title(pick.key)} is switched off.")
    if now == pick.where:
        return pick._replace(update=update) if pick.particle < len(update.trace.weighted.s) else Lost(GONE)
    shared = shared_steps(status.branches, pick.where.branch, now.branch)
    try:
        found = _found(pick, update, min(shared, pick.where.step, now.step), now.step)
    except IndexError:  # not the history that it was
        return Lost(GONE)
    return found if isinstance(found, Lost) else Pick(pick.key, found, now, update)


GONE = "The particle is no more."


def _found(pick: Pick, update: FilterUpdate, common: int, now: int) -> int | Lost:
    """Its index in the weighted particles of step `now`, by way of the last step that both histories have."""
    trace, begun = pick.update.trace, pick.where.step
    if common < begun:
        ancestor = int(trace.resized[pick.particle])  # among those that the step before returned
        past = pick.update.genealogy.ancestors
        for step in range(begun - 1, common, -1):
            ancestor = int(past[step - 1][ancestor])
        if common == now:
            return int(update.trace.selected[ancestor])
        heirs = np.array([ancestor])
    elif now == begun:
        return pick.particle  # the same step of a branch that leaves later
    else:
        heirs = np.flatnonzero(trace.selected == pick.particle)
        if len(heirs) == 0:
            return _died(pick, begun)
    history = update.genealogy.ancestors
    for step in range(common + 1, now):
        heirs = np.flatnonzero(np.isin(history[step - 1], heirs))
        if len(heirs) == 0:
            return _died(pick, step)
    heirs = np.flatnonzero(np.isin(update.trace.resized, heirs))
    if len(heirs) == 0:
        return _died(pick, now)
    return int(heirs[np.argmax(update.trace.weighted.log_w[heirs])])


def _died(pick: Pick, step: int) -> Lost:
    return Lost(f"Particle {pick.particle} of {title(pick.key)} died in step {step}: no particle descends from it.")


def shared_steps(branches: Sequence[tuple[str, str, int, int]], one: str, other: str) -> int:
    """How many steps two branches have in common; `branches` as in `Status`."""
    ways = _way(branches, one), _way(branches, other)
    return max((min(steps, ways[1][name]) for name, steps in ways[0].items() if name in ways[1]), default=0)


def _way(branches: Sequence[tuple[str, str, int, int]], name: str) -> dict[str, int]:
    """The branches that one comes from, itself included, with the number of steps that it has from each on."""
    parents = {branch: (parent, at) for branch, parent, at, _ in branches}
    way, steps = {name: 1 << 62}, 1 << 62
    while name and name in parents:
        name, at = parents[name]
        if name in way:
            break
        steps = min(steps, at)
        way[name] = steps
    return way


def ancestry(pick: Pick) -> Floats:
    """(m, 3) the poses that led to it, up to its own.

    Only paths to living particles are kept.  That of a particle which has no descendants is drawn along the path that
    it shares with one that lives, as far as they go together, and straight from there.
    """
    trace, genealogy = pick.update.trace, pick.update.genealogy
    own = trace.weighted.s[pick.particle][None]
    heirs = np.flatnonzero(trace.selected == pick.particle)
    if len(heirs):
        return np.concatenate([genealogy.path(int(heirs[0]))[:-1], own])
    at, heir = int(trace.resized[pick.particle]), _one_of_each(trace.ancestors)
    for step in range(pick.where.step - 1, -1, -1):
        if at in heir:
            return np.concatenate([genealogy.path(heir[at])[: step + 1], own])
        if step:
            before = genealogy.ancestors[step - 1]
            at, heir = int(before[at]), {int(before[i]): k for i, k in heir.items()}
    return own


def _one_of_each(ancestors: Ints) -> dict[int, int]:
    """By ancestor, one that descends from it."""
    return dict(zip(ancestors.tolist(), range(len(ancestors)), strict=True))


def described(pick: Pick) -> str:
    """Markdown on a particle: where it is, how sure of it, what it weighs, what it knows, whom it descends from."""
    trace = pick.update.trace
    p, k = trace.weighted, pick.particle
    K = len(p.s)
    x, y, heading = p.s[k]
    with np.errstate(under="ignore"):
        weight = K * float(np.exp(p.log_w[k]))
    founder = int(p.lineage[k])
    kin, living = int(np.count_nonzero(trace.resampled.lineage == founder)), len(trace.resampled.s)
    lines = [
        f"**{title(pick.key)}, particle {k}** of {K}, step {pick.where.step}",
        f"- pose {x:.3f} m, {y:.3f} m, {math.degrees(heading):.2f}°",
        f"- {_deviations(p.P[k])}",
        f"- weight times K: {weight:.3g}",
        f"- {len(p.maps.indices(k))} features in its map",
        f"- {_future(pick)}",
        f"- founder {founder}: {kin} of {living} living particles descend from it",
    ]
    return lines[0] + "\n\n" + "\n".join(lines[1:])


def _deviations(P: Floats) -> str:
    variances = np.diag(P)
    if not np.any(variances > 0.0):
        return "no covariance: its pose is a sample"
    x, y, heading = np.sqrt(np.maximum(variances, 0.0))
    return f"standard deviations {_length(x)}, {_length(y)}, {math.degrees(heading):.2g}°"


def _length(metres: float) -> str:
    return f"{metres:.2g} m" if metres >= 0.1 else f"{1000.0 * metres:.2g} mm"


def _future(pick: Pick) -> str:
    """How many living particles share its path."""
    trace = pick.update.trace
    copies, living = int(np.count_nonzero(trace.selected == pick.particle)), len(trace.selected)
    if not trace.did_resample:
        return f"{copies} of {living} living particles has its path: no resampling" if copies else "it is not kept"
    if copies == 0:
        return "it dies in the resampling of this step"
    return f"{copies} of {living} living particles share{'s' if copies == 1 else ''} its path, after the resampling"
