"""Change detection between raw frames, before their images are registered.

Square patches of the raw frame are compared, one about each downsampled pixel of either image. They stand on whole
pixels; the rounding does not matter, because it is the same in all frames.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects
from scipy.ndimage import label as connected_components

from metafab.camera.frames.frame import RawFrame
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread
from metafab.decode.matching.levels import Levels
from metafab.decode.matching.mixing import square_blocks_with
from metafab.decode.matching.pooling import window_maxima, window_means
from metafab.decode.registration.downsampling import Downsampling
from metafab.decode.registration.twins import BRIGHTEST, TwinGrid, compilable

#: Side of the window over which changes are pooled, patches.
_WINDOW = 7
#: Largest deviation by noise alone, in standard deviations: the mean square has a longer tail than a Gaussian, and with
#: 6 a false change passes once in some dozen frames of 10^5 pixels.
_DEVIATIONS = 8.0
#: Least noise of a pixel, as a share of that of a lit one: noise leaks from bright neighbours.
_SMALLEST_NOISE = 0.05
#: Sides of changed rectangles, blocks: few sizes, so that their transforms can be kept.
_SIDES = (*range(1, 13), *range(14, 25, 2), 28, 32, 40, 48, 56, 64, 80, 96, 112, 128)
#: Distance from a changed window within which decoded pixels change, as a share of the margin: beyond it and half a
#: window, the filters hold a seventieth of their energy.
_REACH = 0.5


@dataclass(frozen=True)
class PatchMeans:
    """The patches of a frame."""

    #: Shape (2, n_y, n_x), mean of the valid pixels of each patch of both images, margin included, saturated ones at
    #: the level of saturation; 0 for none.
    mean: NDArray[np.float32]
    full: NDArray[np.uint8]  #: Shape (2, n_y, n_x), number of saturated pixels.
    invalid: NDArray[np.uint8]  #: Shape (2, n_y, n_x), number of pixels that are not a number.

    def replaced(self, other: PatchMeans, where: NDArray[np.bool_]) -> PatchMeans:
        """Those of ``other`` where the mask (n_y, n_x) is set, these elsewhere."""
        return PatchMeans(
            np.where(where, other.mean, self.mean),
            np.where(where, other.full, self.full),
            np.where(where, other.invalid, self.invalid),
        )


@dataclass(frozen=True)
class ChangeDetector:
    """Detector of changes between frames of one shape, by their patches."""

    row: NDArray[np.int32]  #: Shape (2, n_y, n_x), first frame row of each patch.
    column: NDArray[np.int32]  #: Shape (2, n_y, n_x), first frame column.
    side: int  #: Side of a patch, pixels.
    margin: int  #: Number of patches beyond each side of the decoded window.

    @classmethod
    def of(cls, grid: TwinGrid, downsampling: Downsampling) -> ChangeDetector:
        """Patches about every downsampled pixel of both images."""
        step = downsampling.step
        twin_row, twin_column = (np.rint(place[::step, ::step]) for place in (grid.twin_row, grid.twin_column))
        own_row, own_column = np.indices(grid.tangent_x.shape)[:, ::step, ::step]
        row, column = np.stack([own_row + grid.row, twin_row]), np.stack([own_column + grid.column, twin_column])
        first_row, first_column = (row - step // 2).astype(np.int32), (column - step // 2).astype(np.int32)
        return cls(first_row, first_column, step, downsampling.margin)

    def patch_means(self, frame: RawFrame) -> PatchMeans:
        """Means of a frame's patches; beyond an edge, the value of the edge is taken."""
        limit = np.inf if frame.saturation_e is None else float(frame.saturation_e)
        shape, counts = self.row.shape, compilable(frame.frame)
        mean, full, invalid = np.empty(shape, np.float32), np.empty(shape, np.uint8), np.empty(shape, np.uint8)
        spread(_patch_means, shape[1], counts, self.row, self.column, self.side, limit, mean, full, invalid)
        return PatchMeans(mean, full, invalid)

    def changed(self, now: PatchMeans, last: PatchMeans, levels: Levels) -> NDArray[np.bool_]:
        """Patches, margin included, in which two frames of one light differ by more than noise: shape (n_y, n_x)."""
        smallest = np.float32(levels.read_noise_e**2 + _SMALLEST_NOISE * levels.noise_variance)
        # Saturated light varies less, never more.
        variance = np.maximum(np.float32(0.5) * (now.mean + last.mean), np.float32(0.0)) + smallest
        if last.invalid.any():
            pixels = np.float32(self.side**2)
            variance *= pixels / np.maximum(pixels - last.invalid, np.float32(1.0))
        change, variance = window_means(np.stack([(now.mean - last.mean) ** 2, variance]), _WINDOW)
        # The difference of two has twice the noise; the mean square of n of them is 1 +- sqrt(2 / n).
        least = 2.0 / self.side**2 * (1.0 + _DEVIATIONS * math.sqrt(2.0) / _WINDOW)
        changed = (change > np.float32(least) * variance) | (now.invalid != last.invalid)
        if (now.full != last.full).any():
            changed |= self._saturation_changed(now.full, last.full)
        return np.asarray(changed.any(axis=0))

    def _saturation_changed(self, now: NDArray[np.uint8], last: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Patches about which the number of saturated pixels changed by more than chance, as with brighter light."""
        pixels = (_WINDOW * self.side) ** 2
        one, other = window_means(np.stack([now, last]).astype(np.float32), _WINDOW) / np.float32(self.side**2)
        share = np.float32(0.5) * (one + other)
        # Binomial variance of each share; the difference has twice that.
        noise = np.float32(2.0 / pixels) * share * (np.float32(1.0) - share)
        return np.asarray((one - other) ** 2 > np.float32(_DEVIATIONS**2) * noise + np.float32(1e-6))

    def affected(self, changed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Downsampled pixels of the window that filters mix with a changed patch, shape (n_y, n_x).

        ``changed`` has the shape (n_y + 2 margin, n_x + 2 margin).
        """
        wide = window_maxima(changed, 2 * math.ceil(_REACH * self.margin) + 1)
        return np.asarray(wide[self.margin : -self.margin, self.margin : -self.margin])


@compiled
def _patch_means(
    first: int,
    stop: int,
    frame: NDArray[Any],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    side: int,
    limit: float,
    mean: NDArray[np.float32],
    full: NDArray[np.uint8],
    invalid: NDArray[np.uint8],
) -> None:
    n_x, last_row, last_column = row.shape[2], frame.shape[0] - 1, frame.shape[1] - 1
    dimmest = min(limit, BRIGHTEST)
    for y in range(first, stop):
        for image in range(2):
            for x in range(n_x):
                total, n_full, n_invalid, above, left = 0.0, 0, 0, row[image, y, x], column[image, y, x]
                is_inside = above >= 0 and left >= 0 and above + side <= last_row + 1 and left + side <= last_column + 1
                dim = 0
                for di in range(side if is_inside else 0):
                    line = frame[above + di]
                    for dj in range(side):
                        value = np.float64(line[left + dj])
                        total += value
                        dim += bool(abs(value) < dimmest)
                if dim < side * side:  # a few patches, which hold a saturated or invalid pixel or lie beyond an edge
                    total = 0.0
                    for di in range(side):
                        i = min(max(above + di, 0), last_row)
                        for dj in range(side):
                            value = np.float64(frame[i, min(max(left + dj, 0), last_column)])
                            valid = abs(value) < BRIGHTEST
                            total += min(value, limit) if valid else 0.0
                            n_full += bool(valid and value >= limit)
                            n_invalid += not valid
                mean[image, y, x] = total / max(side * side - n_invalid, 1)
                full[image, y, x] = n_full
                invalid[image, y, x] = n_invalid


def changed_rectangles(wanted: NDArray[np.bool_], block: int) -> list[tuple[slice, slice]]:
    """Disjoint rectangles of whole blocks that hold all wanted pixels, shape (n_y, n_x).

    The side of a block is ``block`` pixels; the last ones may be cut off by the window's end.
    """
    components, _ = connected_components(square_blocks_with(wanted, block), np.ones((3, 3), dtype=bool))
    counts = [-(-n // block) for n in wanted.shape]
    boxes = [_widened(box, counts) for box in find_objects(components)]
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
    """The rectangle of one of the usual sizes around another, inside the window."""
    wide = []
    for at, count in zip(box, counts, strict=True):
        size = min(count, next((n for n in _SIDES if n >= at.stop - at.start), count))
        start = min(max(0, at.start - (size - (at.stop - at.start)) // 2), count - size)
        wide.append(slice(start, start + size))
    return tuple(wide)


def _overlap(one: tuple[slice, ...], other: tuple[slice, ...]) -> bool:
    return all(a.start < b.stop and b.start < a.stop for a, b in zip(one, other, strict=True))
