"""`--summary OUT.json`: both ways in numbers.  Stable and versioned.

    {"schema": 1, "version": "0.1.0", "command": text,
     "recording": text, "branch": text | null, "world": name, "seed": n,
     "mistake": name | null,                            that all filters make on purpose, in both ways
     "from": step, "to": step, "complete": bool,        whether all steps and seeds that were asked for were made
     "set": {dotted name: [before, after], ...},
     "warnings": [sentence, ...], "said": [sentence, ...],
     "filters": {key: {
        "title": text, "step": [...],
        "differs_from_step": n | null,                  null: the changed way is the unchanged one, bit for bit
        "unchanged": {"particles": K, "numbers": {key: number | null, ...}, "series": {name: [...], ...},
                      "nees_infinite": n},              steps at which it is, which are not in the mean
        "changed": {the same},
        "differences": {key: number | null, ...},       changed - unchanged
        "seeds": {key: {                                empty without --seeds
           "unchanged": {"median", "least", "most"}, "changed": {the same}, "lower": n, "higher": n, "luck": p,
           "values": {"unchanged": [...], "changed": [...]}}, ...}}},
     "seeds": n}                                        how often both were run again with other random numbers

- SI units and radians; the keys of `numbers` and `seeds` are those of `rows.ROWS`, the series those of `compare.json`,
  with `n_eff_share`, of K, and `ancestors`, how many of the particles after step `from` have descendants, and
  `ancestors_share`, of those particles.
- `seeds` has no number of the run's own random numbers: they were chosen for what happened with them.  `lower`: how
  often the changed way had the smaller number with the same random numbers; `luck`: two-sided sign test, null
  where nothing is drawn after the fork.
- `null` is what is not known, and infinity.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from app.colours import of_filter
from app.compare.numbers import Column, Comparison, Filter
from app.recording.metrics import LONERS
from app.rows import ROWS
from app.summary import plain
from app.types import SessionInfo
from app.version import version
from app.whatif.numbers import Spread, Tallies, quantiles
from app.whatif.settings import values_of
from app.whatif.words import OF_MANY, span

SCHEMA = 1


def with_titles(found: Comparison, info: SessionInfo) -> Comparison:
    """The same with the titles that the filters of a session have, which tell of a mistake in them."""
    titles = {one.key: one.title for one in info.filters}
    return found._replace(filters=[one._replace(title=titles[one.key]) for one in found.filters])


def as_dict(
    found: Comparison,
    spreads: dict[str, list[Spread]],
    tallies: Tallies,
    warnings: list[str],
    said: list[str],
    command: str,
) -> dict[str, Any]:
    """As the module's docstring lays it out."""
    plan, others = tallies.plan, len(tallies.others())
    was = values_of(plan.settings(plan.first, changed=False))
    last = int(found.steps[-1])
    return plain(
        {
            "schema": SCHEMA,
            "version": version(),
            "command": command,
            "recording": str(plan.origin.path),
            "branch": plan.origin.branch or None,
            "world": plan.origin.info.source.name,
            "seed": plan.origin.info.seed,
            "mistake": plan.origin.info.mistake or None,
            "from": plan.first,
            "to": last,
            "complete": last == plan.last and others == plan.seeds,
            "set": {name: [was[name], value] for name, value in plan.values.items()},
            "warnings": warnings,
            "said": said,
            "filters": {one.key: _filter(one, spreads.get(one.key, [])) for one in found.filters},
            "seeds": others,
        }
    )


def _filter(one: Filter, spreads: list[Spread]) -> dict[str, Any]:
    before, after = one.columns
    return {
        "title": one.title,
        "step": one.steps,
        "differs_from_step": after.parts_at,
        "unchanged": _column(before),
        "changed": _column(after),
        "differences": {row.key: one.difference(row, after) for row in ROWS},
        "seeds": {spread.row.key: _spread(spread) for spread in spreads},
    }


def _column(column: Column) -> dict[str, Any]:
    numbers = {row.key: column.values[row.key] for row in ROWS}
    infinite = int(np.isinf(column.series["nees"]).sum())
    return {"particles": column.particles, "numbers": numbers, "series": column.series, "nees_infinite": infinite}


def _spread(spread: Spread) -> dict[str, Any]:
    return {
        "unchanged": quantiles(spread.unchanged),
        "changed": quantiles(spread.changed),
        "lower": spread.lower,
        "higher": spread.higher,
        "luck": spread.luck,
        "values": {"unchanged": spread.unchanged, "changed": spread.changed},
    }


def spread_table(one: Filter, spreads: list[Spread], count: int) -> Table:
    """For a terminal: medians and ranges over the other random numbers."""
    red, green, blue = of_filter(one.key)
    result = Table(box=None, padding=(0, 2, 0, 0), show_edge=False)
    result.add_column(Text(one.title, style=f"bold rgb({red},{green},{blue})"), no_wrap=True)
    for name in (*(column.run.name for column in one.columns), f"lower in, of {count}", "higher in"):
        result.add_column(Text(name), justify="right", no_wrap=True)
    for spread in spreads:
        if not (one.key in LONERS and spread.row.key in OF_MANY):
            row = spread.row
            cells = [span(row, spread.unchanged), span(row, spread.changed), str(spread.lower), str(spread.higher)]
            result.add_row(one.title_of(row), *cells)
    return result
