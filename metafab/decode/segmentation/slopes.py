"""Slopes of tilted segments, measured along their own planes.

A cell of a steep surface holds many depths. Where it holds an outline, or the rim of the field, its depth is that of
this line more than that of its middle, and slopes come out up to 17 % too steep. All pixels of a cell are at one
distance from the plane, if their products are summed along it; these distances correct the plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import box_about
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.planes import Plane, cell_depths, cell_side
from metafab.decode.segmentation.robust_fits import robust_fit
from metafab.decode.segmentation.segments import SegmentDepth

#: Candidates on each side of the plane at which the twins are compared, and corrections of the plane.
_APART, _ROUNDS = 3, 2
#: Fewest cells of a plane, and least part of a cell.
_FEWEST_CELLS, _LEAST_PART = 8, 0.25


def along_planes(
    depths: Sequence[SegmentDepth], inside: NDArray[np.int32], volume: CostVolume, step: int
) -> tuple[SegmentDepth, ...]:
    """Depths of segments whose planes are measured along themselves; flat and curved ones stay.

    Args:
        depths: of the segments.
        inside: shape (n_y, n_x), number of the segment, from 1, that is measured on each pixel; 0 for none.
        volume: cost volume.
        step: frame pixels from one downsampled pixel to the next.
    """
    return tuple(
        _along_plane(one, inside == number, volume, step)
        if one.plane.tilted and not one.plane.curved and not one.of_outline
        else one
        for number, one in enumerate(depths, start=1)
    )


def _along_plane(depth: SegmentDepth, mask: NDArray[np.bool_], volume: CostVolume, step: int) -> SegmentDepth:
    """Depth of a segment with a corrected plane; the same where too few cells of its interior show one."""
    box = rows, columns = box_about(mask)
    row, column = np.nonzero(mask[box])
    side = cell_side(step)
    code = row // side * mask.shape[1] + column // side
    number, cell, pixels = np.unique(code, return_inverse=True, return_counts=True)
    label = np.zeros(mask[box].shape, dtype=np.int32)
    label[row, column] = cell + 1
    whole = pixels >= _LEAST_PART * side**2
    if np.count_nonzero(whole) < _FEWEST_CELLS:
        return depth
    part, plane = volume.within(rows, columns), depth.plane.moved(-rows.start, -columns.start)
    y, x = (
        np.bincount(cell, axis, number.size) / pixels - middle
        for axis, middle in zip((row, column), plane.centre, strict=True)
    )
    design = np.stack([np.ones_like(y), y, x], axis=1)
    for _ in range(_ROUNDS):
        away, error = _distances(part, plane, label, pixels)
        known = whole & np.isfinite(error)
        if np.count_nonzero(known) < _FEWEST_CELLS:
            return depth
        _, change = robust_fit(design[known] / error[known, None], away[known] / error[known])
        rise, down, right = change.tolist()
        slope = plane.slope_per_m[0] + down, plane.slope_per_m[1] + right
        plane = replace(plane, vergence_per_m=plane.vergence_per_m + rise, slope_per_m=slope)
    plane = plane.moved(rows.start, columns.start)
    return replace(depth, vergence_per_m=plane.vergence_per_m, plane=plane)


def _distances(
    volume: CostVolume, plane: Plane, label: NDArray[np.int32], pixels: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Distance of each cell from a plane, and its standard error, in vergence (1/m): shapes (n_cells,).

    Args:
        volume: cost volume, of pictures of the shape (n_y, n_x).
        plane: in these pictures.
        label: shape (n_y, n_x), number of each pixel's cell from 1; 0 for none.
        pixels: shape (n_cells,), of each cell.

    Returns:
        The distances, and their errors: inf where the twins do not agree best near the plane.
    """
    offsets = volume.step_per_m * np.arange(-_APART, _APART + 1.0)
    products = volume.at(plane.over(volume.shape) + offsets[:, None, None])
    along = replace(volume, vergences_per_m=offsets, products=products)
    return cell_depths(along, along.label_sums(label, pixels.size), pixels)
