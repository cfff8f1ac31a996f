"""Small segments that are no more than a part of their neighbour.

Along outlines, in shadows of texture and at the picture's rim narrow strips come out as segments of their own, with
depths that are hardly known. One that does not differ from a much larger neighbour by more than its own error allows
belongs to it: of the two depths, the neighbour's is the better known by far.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metafab.decode.segmentation.segment import SegmentDepth

#: Standard errors of the smaller segment's depth; a segment that is wrong by more is no part of its neighbour.
_SAME_DEPTH = 2.5
#: A neighbour is so many times as large.
_LARGER = 4


def joined(depths: Sequence[SegmentDepth], label: NDArray[np.int32]) -> NDArray[np.int32]:
    """The segment that each segment belongs to: itself, or a larger neighbour of the same depth.

    Args:
        depths: of the segments from 1.
        label: shape (n_y, n_x), number of each pixel's segment; 0 for none.

    Returns:
        Shape (len(depths) + 1,): old numbers, 0 first.
    """
    count = len(depths) + 1
    target = np.arange(count, dtype=np.int32)
    sizes = np.bincount(label.ravel(), minlength=count)
    beside = _touching(label, count)
    order: list[int] = np.argsort(sizes[1:], kind="stable").tolist()
    for small in order:
        own = depths[small]
        large = np.flatnonzero(beside[small + 1] & (sizes > _LARGER * sizes[small + 1]))
        large = large[large > 0]
        if own.plane.tilted or not large.size or not sizes[small + 1]:
            continue
        row, column = (np.array(float(axis.mean())) for axis in np.nonzero(label == small + 1))
        there = np.array([float(depths[k - 1].plane.at(row, column)) for k in large.tolist()])
        away = np.abs(there / own.vergence_per_m - 1.0)
        if away.min() < _SAME_DEPTH * own.relative_error:
            target[small + 1] = large[away.argmin()]
    for small in reversed(order):  # what a neighbour has joined, its parts join, too
        target[small + 1] = target[target[small + 1]]
    return target


def _touching(label: NDArray[np.int32], count: int) -> NDArray[np.bool_]:
    """Which segments lie side by side: shape (count, count)."""
    beside = np.zeros(count * count, dtype=bool)
    for one, other in ((label[:-1], label[1:]), (label[:, :-1], label[:, 1:])):
        codes = np.bincount((one * np.int32(count) + other).ravel(), minlength=count * count)
        beside |= codes > 0
    both = beside.reshape(count, count)
    return np.asarray(both | both.T)
