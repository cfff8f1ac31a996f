"""Tilted planes that cells all over a picture agree on, whatever segment they are in.

Layers of one depth each cut a tilted surface into stripes, of which each may be too narrow to show its tilt. Here every
cell proposes the plane through its neighbourhood; the one that most cells in one piece lie on is kept, its cells are
taken out, and so on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label as connected

from metafab.core.conventions import FloatArray
from metafab.decode.segmentation.planes import Cells, Plane, fitted_plane

#: A cell's neighbourhood, in sides of a cell: with itself 21 cells.
_REACH = 2.5
_FEWEST_NEIGHBOURS = 6
#: A cell lies on a plane within so many of its standard errors and this share of the layers' separation.
_ERRORS = 2.5
_SHARE = 0.15
_FEWEST_CELLS = 10
_MOST_PLANES = 8
#: Fits to the cells that agree with the one before.
_ROUNDS = 3
#: Layers that a plane may cross within a cell: an outline between two objects is steeper.
_STEEPEST = 1.5


def spanning_planes(cells: Cells, side: int, separation_per_m: float) -> list[Plane]:
    """Planes that span more than one layer, those of most cells first.

    Args:
        cells: of all of the picture, at most one at a place.
        side: of a cell, compared pixels.
        separation_per_m: vergence by which layers differ.
    """
    left = np.isfinite(cells.error_per_m)
    near = np.hypot(cells.row[:, None] - cells.row, cells.column[:, None] - cells.column) <= _REACH * side
    within = _ERRORS * cells.error_per_m + _SHARE * separation_per_m
    found: list[Plane] = []
    while left.sum() >= _FEWEST_CELLS and len(found) < _MOST_PLANES:
        on_it = _most_agreed(cells, left, near, within, side)
        if on_it.sum() < _FEWEST_CELLS:
            break
        left = left & ~on_it
        plane = fitted_plane(cells.chosen(on_it))
        if plane is None:
            continue
        over = plane.at(cells.row, cells.column)
        left = left & (np.abs(cells.vergence_per_m - over) > within)
        if (
            np.ptp(over[on_it]) > separation_per_m
            and np.hypot(*plane.slope_per_m) * side < _STEEPEST * separation_per_m
        ):
            found.append(plane)
    return found


def _most_agreed(
    cells: Cells, left: NDArray[np.bool_], near: NDArray[np.bool_], within: FloatArray, side: int
) -> NDArray[np.bool_]:
    """Of the planes through the neighbourhoods of the cells that are left, the cells in one piece on the best one."""
    place = np.stack([np.ones(cells.row.size), cells.row, cells.column], axis=1)
    weight = np.where(near & left, 1.0 / np.where(left, within, 1.0) ** 2, 0.0)
    normal = np.einsum("cn,ni,nj->cij", weight, place, place)
    side_by_side = np.einsum("cn,ni->ci", weight, place * np.where(left, cells.vergence_per_m, 0.0)[:, None])
    # Of a volume against its edges (Hadamard): cells on one line propose no plane.
    edges = np.prod(np.diagonal(normal, axis1=1, axis2=2), axis=1)
    proposing = left & ((weight > 0.0).sum(axis=1) >= _FEWEST_NEIGHBOURS) & (np.linalg.det(normal) > 1e-9 * edges)
    if not proposing.any():
        return np.zeros(left.size, dtype=bool)
    planes = np.linalg.solve(normal[proposing], side_by_side[proposing][..., None])[..., 0]
    vergence = np.where(left, cells.vergence_per_m, np.inf)
    agreeing = np.abs(vergence - planes @ place.T) < within
    best = int(agreeing.sum(axis=1).argmax())
    chosen, seed = agreeing[best], int(np.flatnonzero(proposing)[best])
    for _ in range(_ROUNDS):
        chosen = _in_one_piece(cells, chosen, seed, side)
        root = chosen / within
        plane = np.linalg.lstsq(place * root[:, None], cells.vergence_per_m * root, rcond=None)[0]
        chosen = np.abs(vergence - place @ plane) < within
    return _in_one_piece(cells, chosen, seed, side)


def _in_one_piece(cells: Cells, chosen: NDArray[np.bool_], seed: int, side: int) -> NDArray[np.bool_]:
    """The chosen cells that hang together with one of them."""
    at = (cells.row // side).astype(np.intp), (cells.column // side).astype(np.intp)
    grid = np.zeros((int(at[0].max()) + 1, int(at[1].max()) + 1), dtype=bool)
    grid[at] = chosen
    grid[at[0][seed], at[1][seed]] = True
    pieces, _ = connected(grid, np.ones((3, 3), dtype=bool))
    return np.asarray(chosen & (pieces[at] == pieces[at[0][seed], at[1][seed]]))
