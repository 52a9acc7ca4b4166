"""Arrays in the form in which Rerun stores them.

Rerun takes Python values of many forms and finds out which it was given, strip by strip; for some thousand lines and
points a step that takes several times longer than all the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from slam.types import Floats, Ints

_STRIPS2 = rr.components.LineStrip2DBatch([]).as_arrow_array().type
_STRIPS3 = rr.components.LineStrip3DBatch([]).as_arrow_array().type
_VECTORS = rr.components.Position3DBatch([]).as_arrow_array().type
_TENSOR = rr.components.TensorDataBatch(np.zeros(1, np.float32)).as_arrow_array()
_TRIANGLES = rr.components.TriangleIndicesBatch([]).as_arrow_array().type
_SCALAR = rr.Scalars.descriptor_scalars()

Components = list[rr.DescribedComponentBatch]
"""What an entity is given at one time."""


class _Made(NamedTuple):
    """A batch that has its array already."""

    array: pa.Array

    def as_arrow_array(self) -> pa.Array:
        """For Rerun."""
        return self.array


def scalars(values: Sequence[float]) -> list[Components]:
    """What `rr.Scalars` makes of each of them, for an entity of its own."""
    column = pa.array(values, pa.float64())
    return [[rr.DescribedComponentBatch(_Made(column[i : i + 1]), _SCALAR)] for i in range(len(values))]


def named(**arrays: pa.Array) -> Components:
    """What `rr.AnyValues` makes of them."""
    return [rr.DescribedComponentBatch(_Made(array), rr.ComponentDescriptor(name)) for name, array in arrays.items()]


def vectors(xy: Floats, z: float | Floats = 0.0) -> pa.Array:
    """(n, >= 2) and a height, or (n,) heights, as 3D vectors in single precision."""
    return _fixed(_lifted(xy, z), _VECTORS)


def strips(rows: Floats, lengths: list[int], z: float | None = None) -> pa.Array:
    """Lines through the points rows (n, >= 2), one after the other with so many points, in the plane or at height z."""
    kind, width = (_STRIPS2, 2) if z is None else (_STRIPS3, 3)
    offsets = np.zeros(len(lengths) + 1, np.int32)
    np.cumsum(lengths, out=offsets[1:])
    flat = _fixed(_lifted(rows, z or 0.0)[:, :width], kind.value_type)
    return pa.ListArray.from_arrays(pa.array(offsets), flat, type=kind)


def segments(ends: Floats, z: float) -> pa.Array:
    """Lines between two ends each, (n, 2, 2), at height z."""
    return strips(ends.reshape(-1, 2), [2] * len(ends), z)


def triangles(corners: Ints) -> pa.Array:
    """Triangles (..., 3) of indices of vertices."""
    return _fixed(corners.astype(np.uint32), _TRIANGLES)


def colours(rgb: Floats) -> pa.Array:
    """(n, 3) in 0..255 as packed colours."""
    red, green, blue = np.asarray(rgb).astype(np.uint32).reshape(-1, 3).T
    return pa.array((red << 24) | (green << 16) | (blue << 8) | np.uint32(255))


def bars(heights: Floats) -> pa.Array:
    """(n,) heights of bars in single precision: a tensor, which Rerun stores as a union of all kinds of numbers."""
    shape, names, union = _TENSOR.flatten()
    children = [union.field(i) for i in range(union.type.num_fields)]
    single = union.type_codes[0].as_py()
    children[single] = pa.array([heights.astype(np.float32)], children[single].type)
    numbers = pa.Array.from_buffers(union.type, 1, union.buffers()[:3], children=children)
    return pa.StructArray.from_arrays([pa.array([[len(heights)]], shape.type), names, numbers], fields=[*_TENSOR.type])


def _lifted(xy: Floats, z: float | Floats) -> NDArray[np.float32]:
    out = np.empty((len(xy), 3), np.float32)
    out[:, :2], out[:, 2] = xy[:, :2], z
    return out


def _fixed(rows: NDArray[Any], kind: pa.DataType) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(rows).reshape(-1)), type=kind)
