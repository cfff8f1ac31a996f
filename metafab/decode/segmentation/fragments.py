"""Fragments: small segments that belong to a larger neighbour of the same depth; neighbours of segments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metafab.decode.segmentation.segments import SegmentDepth

#: Standard errors within which a fragment's depth is that of its neighbour, and their least ratio of sizes.
_SAME_DEPTH, _SIZE_RATIO = 2.5, 4
#: Width of a strip along the picture's rim (frame pixels), and relative difference within which it has its neighbour's
#: depth: in 4 of 12 frames a tilted wall had such a strip, 14 to 28 px wide and 1.4 to 2.7 % off, as windows there miss
#: what lies beyond the rim. Its stated error, 0.1 to 0.7 %, counts the noise alone.
_STRIP_PX, _STRIP_DIFFERENCE = 30, 0.04
#: Share of a strip's pixels that may be farther from the rim, and its least length along the rim over its mean width.
_STRIP_REST, _STRIP_RATIO = 0.1, 3.0


def fragment_targets(depths: Sequence[SegmentDepth], label: NDArray[np.int32], step: int) -> NDArray[np.int32]:
    """The segment that each segment is merged into: itself, or a much larger neighbour of the same depth.

    Along outlines, in shadows and at the picture's rim, narrow strips become segments whose depths have large errors.
    Such a fragment belongs to a neighbour if their depths do not differ significantly. Depths are those of the segments
    from 1, ``label``, shape (n_y, n_x), has 0 for none, on pixels of ``step`` frame pixels; targets have the shape
    (len(depths) + 1,), 0 for 0.
    """
    count = len(depths) + 1
    target = np.arange(count, dtype=np.int32)
    sizes = np.bincount(label.ravel(), minlength=count)
    in_strip = _along_rim(label, count, _STRIP_PX // step)
    adjacent = adjacency(label, count)
    smallest_first: list[int] = (1 + np.argsort(sizes[1:], kind="stable")).tolist()
    for number in smallest_first:
        plane, error = depths[number - 1].plane, depths[number - 1].relative_error
        larger = np.flatnonzero(adjacent[number] & (sizes > _SIZE_RATIO * sizes[number]))
        larger = larger[larger > 0]
        if (plane.tilted and not in_strip[number]) or not larger.size or not sizes[number]:
            continue
        row, column = (np.array(float(axis.mean())) for axis in np.nonzero(label == number))
        vergences = np.array([float(depths[k - 1].plane.at(row, column)) for k in larger.tolist()])
        difference = np.abs(vergences / float(plane.at(row, column)) - 1.0)
        if difference.min() < max(_SAME_DEPTH * error, _STRIP_DIFFERENCE if in_strip[number] else 0.0):
            target[number] = larger[difference.argmin()]
    for number in reversed(smallest_first):  # fragments of a fragment follow it
        target[number] = target[target[number]]
    return target


def _along_rim(label: NDArray[np.int32], count: int, width: int) -> NDArray[np.bool_]:
    """Whether a segment is a strip along a side of the picture, by its number in ``label`` below ``count``.

    A strip touches the side, is long along it, and has nearly all of its pixels within ``width`` pixels of it. An axis
    along which the picture is at most three widths long has none.
    """
    sizes, is_strip = np.bincount(label.ravel(), minlength=count), np.zeros(count, dtype=bool)
    for lines in (label, label.T):
        for from_side in (lines, lines[::-1]) if len(lines) > 3 * width > 0 else ():
            beyond = np.bincount(from_side[width:].ravel(), minlength=count)
            touching = np.bincount(from_side[0], minlength=count) > 0
            for number in np.flatnonzero(touching & (beyond < _STRIP_REST * sizes)).tolist():
                length = np.count_nonzero((from_side[:width] == number).any(axis=0))
                is_strip[number] |= length**2 >= _STRIP_RATIO * sizes[number]
    return is_strip


def adjacency(label: NDArray[np.int32], count: int) -> NDArray[np.bool_]:
    """Whether segments, numbers in ``label`` below ``count``, touch each other: shape (count, count)."""
    adjacent = np.zeros(count * count, dtype=bool)
    for one, other in ((label[:-1], label[1:]), (label[:, :-1], label[:, 1:])):
        codes = np.bincount((one * np.int32(count) + other).ravel(), minlength=count * count)
        adjacent |= codes > 0
    both = adjacent.reshape(count, count)
    return np.asarray(both | both.T)
