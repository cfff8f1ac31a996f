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
from scipy.ndimage import maximum, minimum

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
        The distances, and their errors: inf where the twins do not agree best near the plane and within the calibrated
        range, or where little of that is near the plane.
    """
    nodes, per_m, reach = volume.vergences_per_m, plane.over(volume.shape), _APART * volume.step_per_m
    numbers = np.arange(1, pixels.size + 1)
    # Beyond the calibrated range, products are those at its end: they would draw cells near it towards that.
    first = np.maximum(nodes[0] - minimum(per_m, label, numbers), -reach)
    room = np.minimum(nodes[-1] - maximum(per_m, label, numbers), reach) - first
    enough = room > volume.step_per_m
    step = np.where(enough, room, 2.0 * reach) / (2 * _APART)
    first_there, step_there = (np.append(0.0, each)[label] for each in (first, step))
    candidates = np.arange(2 * _APART + 1.0)[:, None, None]
    along = replace(volume, products=volume.at(per_m + first_there + candidates * step_there))
    away, error = cell_depths(along.label_sums(label, pixels.size), pixels, volume.samples, first, step)
    return away, np.where(enough, error, np.inf)
