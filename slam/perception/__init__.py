"""From what a laser measured to what a filter observes."""

from __future__ import annotations

import numpy as np

from slam.perception.segments import STANDARD, Extraction, Segments, extract
from slam.types import UNKNOWN_TAG, Frame, Ints, Params

__all__ = ["STANDARD", "Extraction", "Segments", "extract", "perceive", "tags_of"]


def perceive(frame: Frame, params: Params, settings: Extraction = STANDARD) -> Frame:
    """The frame with z (Z, 11), the walls that its scan shows as `slam.features.wall` has them, and their tags (Z,).

    A frame without a scan is returned as it is.
    """
    if frame.scan is None:
        return frame
    segments = extract(frame.scan, params.believed.range, settings)
    return frame._replace(z=segments.z, tags=tags_of(segments, frame.scan.walls))


def tags_of(segments: Segments, walls: Ints | None) -> Ints:
    """(Z,) the tag that more than half of a segment's beams have, else `UNKNOWN_TAG`; walls (B,) is that of each beam.

    Two pieces of one wall (on both sides of what stands against it, say) can't both have its tag, as no two tags in a
    frame are alike: the one of more beams has it.
    """
    tags = np.full(len(segments.z), UNKNOWN_TAG)
    if walls is None or not len(tags):
        return tags
    used = segments.label >= 0
    label, (values, which) = segments.label[used], np.unique(walls[used], return_inverse=True)
    votes = np.bincount(label * len(values) + which, minlength=len(tags) * len(values)).reshape(len(tags), -1)
    beams = votes.sum(axis=1)
    most = votes.argmax(axis=1)
    clear = 2 * votes.max(axis=1) > beams
    taken = {UNKNOWN_TAG}
    for i in np.argsort(-beams, kind="stable"):
        tag = int(values[most[i]])
        if clear[i] and tag not in taken:
            tags[i] = tag
            taken.add(tag)
    return tags
