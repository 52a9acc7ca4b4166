"""Who descends from whom: as lines, in numbers and in words, the same for recordings and for the panel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app import colours
from app.types import FilterUpdate
from scenarios.words import counted
from slam.genealogy import Branch, Genealogy
from slam.map_store import Maps
from slam.types import Floats, Ints

LINES, COLUMNS = 48, 200
"""Living particles whose ancestry is drawn, and as many that died; and the steps at which, in a long run."""

A_DECADE = 12
"""Lags of a curve that lie between one and ten times it."""

RECENT = 50
"""[steps] back, of which the words tell."""


class Tree(NamedTuple):
    """Lines of descent: those that died out first, so that the others lie above them."""

    points: Floats
    """(n, 2) of (step, height in (0, 1)), line after line."""
    lengths: list[int]
    """(m,) points of each."""
    tones: Floats
    """(m, 3) in 0..255: that of the filter of what all share, and that of the founder of all else, dim if it died
    out."""
    share: Floats
    """(m,) of the living that descend through it; 0 of what died out."""


def tree(genealogy: Genealogy, rgb: colours.RGB) -> Tree:
    """The ancestry picture of the run up to now; in the colour of the filter is what all have in common."""
    strips = sorted(genealogy.layout(LINES, COLUMNS), key=lambda s: (s.alive, s.living))
    founders, living = (np.array([getattr(s, name) for s in strips], np.int64) for name in ("founder", "living"))
    alive = np.array([s.alive for s in strips], bool)
    return Tree(
        np.concatenate([s.points for s in strips] or [np.zeros((0, 2))]),
        [len(s.points) for s in strips],
        _tones(genealogy, founders, living, np.where(alive, 0.0, 0.68), rgb),
        np.where(alive, living / genealogy.particles, 0.0),
    )


def of_branches(genealogy: Genealogy, branches: list[Branch], rgb: colours.RGB) -> Floats:
    """(n, 3) colours of surviving paths, the same as in the picture: the more of the living share one, the brighter it
    is; in the colour of the filter what all have in common."""
    founders = np.array([b.founder for b in branches], np.int64)
    living = np.array([b.living for b in branches], np.int64)
    return _tones(genealogy, founders, living, 0.5 - 0.45 * np.sqrt(living / max(living, default=1)), rgb)


def _tones(genealogy: Genealogy, founders: Ints, living: Ints, faded: Floats, rgb: colours.RGB) -> Floats:
    """(n, 3) of lines of founders (n,) that so many living descend through (n,), with a share (n,) of the background.

    A founder has the colour of its number.  Of the last of them, no more than there are colours, no two have the same:
    one whose colour is taken has the next that is free.
    """
    count = len(colours.FOUNDERS)
    last = np.unique(genealogy.founders)
    chosen = np.arange(max(founders.max(initial=0), last[-1]) + 1) % count
    if len(last) <= count:
        free = list(range(count))
        for founder in last:
            chosen[founder] = min(free, key=lambda colour: (colour - founder) % count)
            free.remove(chosen[founder])
    own = np.array(colours.FOUNDERS, float)[chosen[founders]]
    own[living == genealogy.particles] = rgb
    return own + faded[:, None] * (np.array(colours.BACKGROUND) - own)


def lags(steps: int) -> Ints:
    """(n,) steps back, from 0 to the beginning of a run of so many: every one at first, then ever fewer."""
    decades = np.log10(max(steps, 1))
    spread = np.logspace(0.0, decades, max(2, round(A_DECADE * decades)))
    return np.unique(np.minimum([0, *np.rint(spread).astype(np.int64), steps], steps))


def brief(update: FilterUpdate) -> str:
    """How many founders are left, in few words."""
    return counted(int(np.count_nonzero(np.bincount(update.genealogy.lineage))), "founder")


def words(update: FilterUpdate) -> str:
    """How many ancestors are left, and when the living had one in common."""
    genealogy, age = update.genealogy, update.genealogy.common_ancestor_age()
    if genealogy.particles == 1:
        return "1 particle"
    text = f"{genealogy.particles} particles, "
    if age is not None and age <= RECENT:
        return text + f"all from one of {counted(age, 'step')} ago"
    if genealogy.steps > RECENT:
        (left,) = genealogy.distinct([RECENT])
        text += f"from {left} of {RECENT} steps ago and "
    return text + (f"from {brief(update)}" if age is None else f"all from one of {counted(age, 'step')} ago")


def scarcest(maps: Maps) -> str:
    """The feature that the fewest hypotheses are left of; nothing is said of maps without features."""
    copies, holders = maps.hypotheses()
    there = np.flatnonzero(holders)
    if not len(there):
        return ""
    i = int(there[np.argmin(copies[there] / holders[there])])
    said = f"feature {i} has the fewest hypotheses left, {copies[i]} in {counted(int(holders[i]), 'map')}"
    return said if len(there) == 1 else f"{said} (median of all features: {np.median(copies[there]):.0f})"
