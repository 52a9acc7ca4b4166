"""Which features are of one thing, by their tags."""

from __future__ import annotations

import numpy as np

from slam.types import UNKNOWN_TAG, Ints


def known_pairs(tags: Ints, true_tags: Ints) -> tuple[Ints, Ints]:
    """(m,) which of the features of tags (n,) are in the truth, and (m,) where in it, by true_tags.

    A tag should occur once in the truth.
    """
    order = np.argsort(true_tags, kind="stable")
    order = order[true_tags[order] != UNKNOWN_TAG]
    if len(tags) == 0 or len(order) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    at = order[np.minimum(np.searchsorted(true_tags[order], tags), len(order) - 1)]
    found = np.flatnonzero(true_tags[at] == tags)
    return found, at[found]
