"""Where a frame differs from an earlier one by more than noise, at a glance: before its twins are brought together.

Squares of the raw frame are compared, one about each compared pixel of either image. The same squares are taken in all
frames, so that it does not matter that they stand on whole pixels.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, maximum_filter
from scipy.ndimage import label as connected

from metafab.camera.frames.frame import RawFrame
from metafab.core.numeric.compiled import HAS_NUMBA, compiled_parallel, prange
from metafab.decode.matching.levels import Levels
from metafab.decode.matching.mixing import touched
from metafab.decode.matching.pooling import window_means
from metafab.decode.registration.reduce import Reduction
from metafab.decode.registration.twins import BRIGHTEST, TwinGrid, readable

#: Side of the window over which changes are pooled, and how many standard deviations of noise a change must pass: its
#: mean square has a longer tail than a Gaussian, and 6 of them let noise pass once in some dozen frames of 10^5 pixels.
_WINDOW = 7
_DEVIATIONS = 8.0
_SMALLEST_NOISE = 0.05
#: Parts of a window have one of these many blocks a side, so that few sizes occur.
_BLOCKS = (*range(1, 13), *range(14, 25, 2), 28, 32, 40, 48, 56, 64, 80, 96, 112, 128)
#: How far a change reaches from the windows that show it, as a share of the margin: with the windows' own half, beyond
#: that the filters have a seventieth of their energy.
_REACH = 0.5


@dataclass(frozen=True)
class Glance:
    """A frame at a glance.

    Attributes:
        mean: shape (2, n_y, n_x), mean of the pixels that are numbers of each square of both images, margin included,
            saturated ones as full; 0 for none.
        full: the same shape, how many pixels of it are saturated.
        unread: the same shape, how many are not a number.
    """

    mean: NDArray[np.float32]
    full: NDArray[np.uint8]
    unread: NDArray[np.uint8]

    def kept(self, last: Glance, anew: NDArray[np.bool_]) -> Glance:
        """``last`` but for the squares (n_y, n_x) that are taken ``anew``."""
        pairs = ((self.mean, last.mean), (self.full, last.full), (self.unread, last.unread))
        return Glance(*(np.where(anew, mine, its) for mine, its in pairs))


@dataclass(frozen=True)
class Squares:
    """The squares of a frame.

    Attributes:
        row: shape (2, n_y, n_x), first row in the frame of each; likewise ``column``.
        side: pixels.
        margin: squares all around the decoded window.
    """

    row: NDArray[np.int32]
    column: NDArray[np.int32]
    side: int
    margin: int

    @classmethod
    def of(cls, grid: TwinGrid, reduction: Reduction) -> Squares:
        """About every compared pixel of both images."""
        every = reduction.every
        twin_row, twin_column = (np.rint(place[::every, ::every]) for place in (grid.twin_row, grid.twin_column))
        own_row, own_column = np.indices(grid.tangent_x.shape)[:, ::every, ::every]
        row, column = np.stack([own_row + grid.row, twin_row]), np.stack([own_column + grid.column, twin_column])
        return cls((row - every // 2).astype(np.int32), (column - every // 2).astype(np.int32), every, reduction.margin)

    def glance(self, frame: RawFrame) -> Glance:
        """Look at a frame; what lies beyond an edge has the edge's values."""
        limit = np.inf if frame.saturation_e is None else float(frame.saturation_e)
        means = _means if HAS_NUMBA else _means_plain
        return Glance(*means(readable(frame.frame), self.row, self.column, self.side, limit))

    def moved(self, now: Glance, last: Glance, levels: Levels) -> NDArray[np.bool_]:
        """Squares, of the margin too, that differ by more than their noise: shape (n_y, n_x).

        Args:
            now: a frame.
            last: an earlier one.
            levels: of either, in the same light.
        """
        # Beside bright pixels some of their noise is mixed in: no pixel counts as quieter than a share of theirs.
        quietest = np.float32(levels.read_noise_e**2 + _SMALLEST_NOISE * levels.noise_variance)
        # What is cut off at the full well varies less than what is not: it needs no variance of its own.
        variance = np.maximum(np.float32(0.5) * (now.mean + last.mean), np.float32(0.0)) + quietest
        if last.unread.any():
            # Means of fewer pixels.
            variance *= np.float32(self.side**2) / np.maximum(np.float32(self.side**2) - last.unread, np.float32(1.0))
        change, variance = window_means(np.stack([(now.mean - last.mean) ** 2, variance]), _WINDOW)
        # The difference of two has twice the noise; the mean square of n of them is 1 +- sqrt(2 / n).
        least = 2.0 / self.side**2 * (1.0 + _DEVIATIONS * math.sqrt(2.0) / _WINDOW)
        changed = (change > np.float32(least) * variance) | (now.unread != last.unread)
        if (now.full != last.full).any():
            changed |= self._filled(now.full, last.full)
        return np.asarray(changed.any(axis=0))

    def _filled(self, now: NDArray[np.uint8], last: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Squares about which more or fewer pixels are full than chance explains.

        Light just at the full well fills every other pixel, and more of it is seen in nothing but in how many.
        """
        pixels = (_WINDOW * self.side) ** 2
        one, other = window_means(np.stack([now, last]).astype(np.float32), _WINDOW) / np.float32(self.side**2)
        share = np.float32(0.5) * (one + other)
        # Pixels that are full by chance are most different where half of them are; the difference has twice the noise.
        noise = np.float32(2.0 / pixels) * share * (np.float32(1.0) - share)
        return np.asarray((one - other) ** 2 > np.float32(_DEVIATIONS**2) * noise + np.float32(1e-6))

    def reached(self, moved: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Compared pixels of the window that filters mix with something that moved."""
        wide = maximum_filter(moved, 2 * math.ceil(_REACH * self.margin) + 1)
        return np.asarray(wide[self.margin : -self.margin, self.margin : -self.margin])


def _means_plain(
    frame: NDArray[Any], row: NDArray[np.int32], column: NDArray[np.int32], side: int, limit: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.uint8]]:
    total, (full, unread) = np.zeros(row.shape), np.zeros((2, *row.shape), dtype=np.uint8)
    for i in range(side):
        for j in range(side):
            at = np.clip(row + i, 0, frame.shape[0] - 1), np.clip(column + j, 0, frame.shape[1] - 1)
            values = frame[at].astype(np.float64)
            with np.errstate(invalid="ignore"):
                number = np.abs(values) < BRIGHTEST
            total += np.minimum(np.where(number, values, 0.0), limit)
            full += number & (values >= limit)
            unread += ~number
    return (total / np.maximum(side**2 - unread.astype(np.int64), 1)).astype(np.float32), full, unread


@compiled_parallel
def _means(
    frame: NDArray[Any], row: NDArray[np.int32], column: NDArray[np.int32], side: int, limit: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.uint8]]:
    _, n_y, n_x = row.shape
    mean = np.empty(row.shape, dtype=np.float32)
    full, unread = np.empty(row.shape, dtype=np.uint8), np.empty(row.shape, dtype=np.uint8)
    last_row, last_column = frame.shape[0] - 1, frame.shape[1] - 1
    for y in prange(n_y):
        for image in range(2):
            for x in range(n_x):
                total, filled, bad = 0.0, 0, 0
                for i in range(row[image, y, x], row[image, y, x] + side):
                    line = frame[min(max(i, 0), last_row)]
                    for j in range(column[image, y, x], column[image, y, x] + side):
                        value = np.float64(line[min(max(j, 0), last_column)])
                        # Chosen, not branched to: it is known too late which way to go.
                        number = abs(value) < BRIGHTEST
                        total += min(value, limit) if number else 0.0
                        filled += bool(number and value >= limit)
                        bad += not number
                mean[image, y, x] = total / max(side * side - bad, 1)
                full[image, y, x] = filled
                unread[image, y, x] = bad
    return mean, full, unread


def parts_of(wanted: NDArray[np.bool_], block: int) -> list[tuple[slice, slice]]:
    """Rectangles of whole blocks that hold all ``wanted`` pixels and do not overlap.

    Args:
        wanted: shape (n_y, n_x).
        block: pixels a side; the last ones may be cut off by the window's end.
    """
    found = find_objects(connected(touched(wanted, block), np.ones((3, 3), dtype=bool))[0])
    counts = [-(-n // block) for n in wanted.shape]
    boxes = [_widened(box, counts) for box in found]
    while overlapping := next((pair for pair in itertools.combinations(boxes, 2) if _overlap(*pair)), None):
        boxes = [box for box in boxes if box not in overlapping]
        both = (slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in zip(*overlapping, strict=True))
        boxes.append(_widened(tuple(both), counts))
    return [
        (
            slice(rows.start * block, min(rows.stop * block, wanted.shape[0])),
            slice(columns.start * block, min(columns.stop * block, wanted.shape[1])),
        )
        for rows, columns in boxes
    ]


def _widened(box: tuple[slice, ...], counts: list[int]) -> tuple[slice, ...]:
    """A rectangle of one of the usual sizes around another, inside of the window."""
    wide = []
    for at, count in zip(box, counts, strict=True):
        size = min(count, next((n for n in _BLOCKS if n >= at.stop - at.start), count))
        start = min(max(0, at.start - (size - (at.stop - at.start)) // 2), count - size)
        wide.append(slice(start, start + size))
    return tuple(wide)


def _overlap(one: tuple[slice, ...], other: tuple[slice, ...]) -> bool:
    return all(a.start < b.stop and b.start < a.stop for a, b in zip(one, other, strict=True))
