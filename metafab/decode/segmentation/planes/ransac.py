"""Planes across the layers of a picture: RANSAC over its cells; planes that continue each other.

Layers of one depth cut a tilted surface into stripes, each too narrow to show the tilt; RANSAC over all cells finds the
plane across them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import box_about
from metafab.decode.segmentation.planes.cells import Cells
from metafab.decode.segmentation.planes.plane import Plane
from metafab.decode.segmentation.planes.robust import DEGENERATE, fit_plane

#: Radius of the neighbourhood that proposes a plane, in sides of a cell (21 cells), and its fewest cells.
_NEIGHBOURHOOD, _FEWEST_NEIGHBOURS = 2.5, 6
#: Distance of an inlier, in standard errors of the cell plus a share of the layers' separation.
_INLIER_ERRORS, _INLIER_SHARE = 2.5, 0.15
#: Fewest inliers of a plane.
FEWEST_INLIERS = 10
#: Most planes.
_MOST_PLANES = 8
#: Refits of a plane to its inliers.
_REFITS = 3
#: Layers that a plane may cross within a cell: an outline between two objects is steeper.
_STEEPEST = 1.5


def ransac_planes(
    cells: Cells, side: int, separation_per_m: float, steepest: float = _STEEPEST, most: int = _MOST_PLANES
) -> list[Plane]:
    """Find at most ``most`` planes that span more than one layer by RANSAC, those of most cells first.

    Cells are those of the whole picture, at most one at a place, of ``side`` downsampled pixels; layers differ by
    ``separation_per_m`` of vergence, and a plane crosses at most ``steepest`` of them within a cell.
    """
    remaining = np.isfinite(cells.error_per_m)
    near = np.hypot(cells.row[:, None] - cells.row, cells.column[:, None] - cells.column) <= _NEIGHBOURHOOD * side
    tolerance = _INLIER_ERRORS * cells.error_per_m + _INLIER_SHARE * separation_per_m
    planes: list[Plane] = []
    while remaining.sum() >= FEWEST_INLIERS and len(planes) < most:
        inliers = _ransac_step(cells, remaining, near, tolerance, side)
        if inliers.sum() < FEWEST_INLIERS:
            break
        remaining = remaining & ~inliers
        plane = fit_plane(cells.chosen(inliers))
        if plane is None:
            continue
        vergence = plane.at(cells.row, cells.column)
        remaining = remaining & (np.abs(cells.vergence_per_m - vergence) > tolerance)
        gentle = np.hypot(*plane.slope_per_m) * side < steepest * separation_per_m
        if np.ptp(vergence[inliers]) > separation_per_m and gentle:
            planes.append(plane)
    return planes


def _ransac_step(
    cells: Cells, remaining: NDArray[np.bool_], near: NDArray[np.bool_], tolerance: FloatArray, side: int
) -> NDArray[np.bool_]:
    """RANSAC step: the largest connected set of cells on one plane; each cell's neighbourhood proposes a plane."""
    design = np.stack([np.ones(cells.row.size), cells.row, cells.column], axis=1)
    weight = np.where(near & remaining, 1.0 / np.where(remaining, tolerance, 1.0) ** 2, 0.0)
    products = design[:, :, None] * design[:, None, :]
    normal = (weight @ products.reshape(-1, 9)).reshape(-1, 3, 3)
    right_side = weight @ (design * np.where(remaining, cells.vergence_per_m, 0.0)[:, None])
    diagonal = np.prod(np.diagonal(normal, axis1=1, axis2=2), axis=1)
    enough = remaining & ((weight > 0.0).sum(axis=1) >= _FEWEST_NEIGHBOURS)
    proposing = enough & (np.linalg.det(normal) > DEGENERATE * diagonal)
    if not proposing.any():
        return np.zeros(remaining.size, dtype=bool)
    planes = np.linalg.solve(normal[proposing], right_side[proposing][..., None])[..., 0]
    vergence = np.where(remaining, cells.vergence_per_m, np.inf)
    agreeing = np.abs(vergence - planes @ design.T) < tolerance
    best = int(agreeing.sum(axis=1).argmax())
    inliers, seed = agreeing[best], int(np.flatnonzero(proposing)[best])
    for _ in range(_REFITS):
        inliers = _connected_to(cells, inliers, seed, side)
        root = inliers / tolerance
        plane = np.linalg.lstsq(design * root[:, None], cells.vergence_per_m * root, rcond=None)[0]
        inliers = np.abs(vergence - design @ plane) < tolerance
    return _connected_to(cells, inliers, seed, side)


def _connected_to(cells: Cells, chosen: NDArray[np.bool_], seed: int, side: int) -> NDArray[np.bool_]:
    """The chosen cells in one connected component with the seed."""
    at = (cells.row // side).astype(np.intp), (cells.column // side).astype(np.intp)
    grid = np.zeros((int(at[0].max()) + 1, int(at[1].max()) + 1), dtype=bool)
    grid[at] = chosen
    grid[at[0][seed], at[1][seed]] = True
    component, _ = connected_components(grid, np.ones((3, 3), dtype=bool))
    return np.asarray(chosen & (component[at] == component[at[0][seed], at[1][seed]]))


def distinct_planes(planes: list[Plane], label: NDArray[np.int32], separation_per_m: float) -> list[Plane]:
    """Planes without those that continue the plane of a tilted neighbour; the larger segment's plane is kept.

    ``label``, shape (n_y, n_x), holds the numbers of the segments from 1. Planes differ by ``separation_per_m`` of
    vergence; segments nearer than half of it are on one plane.
    """
    sizes = np.bincount(label.ravel(), minlength=len(planes) + 1)[1:]
    kept: list[int] = []
    touching: dict[int, NDArray[np.bool_]] = {}
    for index in sorted(range(len(planes)), key=lambda k: (not planes[k].tilted, -sizes[k])):
        beside = [other for other, numbers in touching.items() if numbers[index + 1]]
        if beside:
            row, column = (axis.astype(np.float64) for axis in np.nonzero(label == index + 1))
            vergence = planes[index].at(row, column)
            away = [np.median(np.abs(planes[other].at(row, column) - vergence)) for other in beside]
            if min(away) < 0.5 * separation_per_m:
                continue
        kept.append(index)
        if planes[index].tilted:
            touching[index] = _touching(label, index + 1, len(planes) + 1)
    return [planes[index] for index in sorted(kept)]


def _touching(label: NDArray[np.int32], number: int, count: int) -> NDArray[np.bool_]:
    """Whether a segment, of the numbers in ``label`` below ``count``, has pixels within two steps of that ``number``.

    Shape (count,).
    """
    mask = label == number
    box = box_about(mask, 2)
    near = label[box][binary_dilation(mask[box], iterations=2)] if mask.any() else label[:0].ravel()
    return np.asarray(np.bincount(near, minlength=count) > 0)
