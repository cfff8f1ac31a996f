"""Cells: squares of a segment or of a whole picture, each with a depth of its own."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.interpolation import spline_weights
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import spline_peaks, standard_error
from metafab.decode.segmentation.planes.plane import Plane

#: Side of a cell, frame pixels.
CELL_PX = 36
#: Share of a segment's pixels away from the picture's rim from which its depth is measured on them alone.
_LEAST_CLEAR = 0.2


def cell_side(step: int, side_px: int = CELL_PX) -> int:
    """Side of a cell in downsampled pixels, for a downsampling step and a side in frame pixels."""
    return max(2, side_px // step)


def cell_depths(
    sums: FloatArray,
    pixels: NDArray[np.intp],
    samples: float,
    first_per_m: float | FloatArray,
    step_per_m: float | FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """1/depth of cells at the largest correlation of their twins, and its standard error, in 1/m: shapes (n,).

    The error is inf where the twins do not agree, or best at an end of the candidates.

    Args:
        sums: shape (n, 3, n_candidates), products of the twins summed over each cell.
        pixels: shape (n,), of each cell.
        samples: independent samples of a pixel.
        first_per_m: 1/depth of the first candidate, of all cells or each, shape (n,).
        step_per_m: difference of 1/depth from one candidate to the next, likewise.
    """
    peak = spline_peaks(correlation(np.moveaxis(sums, 1, 0)).astype(np.float64))
    error = standard_error(peak.height, peak.curvature / np.square(step_per_m), 1.0)
    error = np.where(peak.inside & (peak.height > 0.0), error / np.sqrt(pixels * samples), np.inf)
    return np.asarray(first_per_m + step_per_m * peak.place), error


@dataclass(frozen=True)
class Cells:
    """Square cells of a segment, each with its own depth."""

    sums: FloatArray  #: Shape (n, 3, n_candidates), products of the twins summed over each cell.
    pixels: FloatArray  #: Shape (n,), pixels of each cell.
    row: FloatArray  #: Shape (n,), row of its centre, downsampled pixels.
    column: FloatArray  #: Shape (n,), column of its centre.
    vergence_per_m: FloatArray  #: Shape (n,), 1/depth at the largest correlation of its twins.
    error_per_m: FloatArray  #: Shape (n,), standard error of the vergence; inf for a cell without a depth.
    #: Shape (3, n_candidates), products summed over the segment, small cells included; without the cells along a rim of
    #: the picture that the segment reaches, beyond which it may continue, unless hardly any others are there.
    whole: FloatArray
    size: int  #: Pixels of ``whole``.

    @classmethod
    def of(cls, volume: CostVolume, mask: NDArray[np.bool_], step: int, side_px: int = CELL_PX) -> Cells:
        """Cells of a mask that hold at least a quarter of a whole cell.

        The mask, shape (n_y, n_x), has downsampled pixels of ``step`` frame pixels; ``side_px`` is the side of a cell
        in frame pixels.
        """
        return cls.of_each(volume, mask.astype(np.int32), 1, step, side_px)[0]

    @classmethod
    def of_each(
        cls, volume: CostVolume, label: NDArray[np.int32], count: int, step: int, side_px: int = CELL_PX
    ) -> list[Cells]:
        """Cells of each segment from 1 to ``count`` of ``label``, shape (n_y, n_x); see :meth:`of`."""
        row, column = np.nonzero(label)
        side = cell_side(step, side_px)
        down, across = (-(-n // side) for n in label.shape)
        # Numbers in the order of segments: the cells of one segment are contiguous.
        code = (label[row, column] * down + row // side) * across + column // side
        sizes = np.bincount(code)
        number = np.flatnonzero(sizes)
        cell, pixels = (np.cumsum(sizes > 0) - 1)[code], sizes[number]
        cell_label = np.zeros(label.shape, dtype=np.int32)
        cell_label[row, column] = cell + 1
        sums = volume.label_sums(cell_label, number.size)
        middle_row, middle_column = (np.bincount(cell, axis, number.size) / pixels for axis in (row, column))
        first_per_m = float(volume.vergences_per_m[0])
        vergence, error = cell_depths(sums, pixels, volume.samples, first_per_m, volume.step_per_m)
        clear = np.ones(number.size, dtype=bool)
        segment = number // (down * across)
        for axis, middle in enumerate((middle_row, middle_column)):
            for rim, near in ((0, middle < side), (-1, middle >= label.shape[axis] - side)):
                reaching = np.zeros(count + 1, dtype=bool)
                reaching[label.take(rim, axis)] = True
                clear &= ~(near & reaching[segment])
        starts = np.searchsorted(segment, np.arange(1, count + 2))
        cells = []
        for start, stop in itertools.pairwise(starts.tolist()):
            measured = start + np.flatnonzero(clear[start:stop])
            if pixels[measured].sum() < _LEAST_CLEAR * pixels[start:stop].sum():
                measured = np.arange(start, stop)
            large = start + np.flatnonzero(pixels[start:stop] >= 0.25 * side**2)
            cells.append(
                cls(
                    sums[large],
                    pixels[large].astype(np.float64),
                    middle_row[large],
                    middle_column[large],
                    vergence[large],
                    error[large],
                    sums[measured].sum(axis=0),
                    int(pixels[measured].sum()),
                )
            )
        return cells

    def chosen(self, which: NDArray[np.bool_]) -> Cells:
        """The cells where ``which``, shape (n,), is set; ``whole`` and ``size`` stay."""
        return Cells(
            self.sums[which],
            self.pixels[which],
            self.row[which],
            self.column[which],
            self.vergence_per_m[which],
            self.error_per_m[which],
            self.whole,
            self.size,
        )

    def sheared(self, volume: CostVolume, plane: Plane) -> FloatArray:
        """Products summed along a plane's tilt: shape (3, n_candidates) over the vergence at its centre."""
        rise = plane.at(self.row, self.column) - plane.vergence_per_m
        nodes = volume.vergences_per_m
        at = np.clip(nodes + rise[:, None], nodes[0], nodes[-1])
        return np.asarray(np.einsum("cvk,cpk->pv", spline_weights(nodes, at), self.sums))
