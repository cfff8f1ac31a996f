"""Pillars of other sizes at the sites of a mask: printed, etched, measured or corrected ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.layout.pillars import PillarMap

#: Rows of the lattice that are held in memory at a time.
_BAND_ROWS = 512


def bands(size_index: NDArray[np.uint16]) -> Iterator[slice]:
    """Yield bands of rows that cover a lattice whose size indices have the shape (n_y, n_x)."""
    for row in range(0, size_index.shape[0], _BAND_ROWS):
        yield slice(row, min(row + _BAND_ROWS, size_index.shape[0]))


def resized(pillars: PillarMap, sizes_nm: Callable[[slice], FloatArray], step_dbu: int = 1) -> PillarMap:
    """Return the pillars with other sizes, rounded to steps of the database unit.

    Args:
        pillars: upright pillars whose sites are kept.
        sizes_nm: returns the widths and lengths of a band of rows, shape (2, n_rows, n_x); a value that is not finite
            or rounds to 0 leaves the site empty. Values at sites without a pillar are ignored. It is called twice for
            each band, and again for each doubling of the step.
        step_dbu: sizes are whole multiples of this number of database units. The step is doubled until at most 65 535
            sizes are left.
    """
    lattice, index = pillars.lattice, pillars.to_array()
    while True:
        step_nm = step_dbu * lattice.database_unit_nm
        across = max(lattice.cell_dbu) // step_dbu + 1
        used = np.zeros(across * across, dtype=bool)
        for rows in bands(index):
            used[_keys(index[rows], sizes_nm(rows), step_nm, across)] = True
        used[0] = False
        sizes = np.flatnonzero(used)
        if sizes.size <= np.iinfo(np.uint16).max:
            break
        step_dbu *= 2
    number = np.zeros(used.size, dtype=np.uint16)
    number[sizes] = np.arange(1, sizes.size + 1)
    new_index = np.zeros(lattice.shape, dtype=np.uint16)
    for rows in bands(index):
        new_index[rows] = number[_keys(index[rows], sizes_nm(rows), step_nm, across)]
    size_dbu = np.concatenate([[(0, 0)], step_dbu * np.stack(np.divmod(sizes, across), axis=1)]).astype(np.int32)
    return PillarMap.from_array(lattice, size_dbu, new_index, pillars.tile_sites)


def _keys(size_index: NDArray[np.uint16], sizes_nm: FloatArray, step_nm: float, across: int) -> NDArray[np.int64]:
    """One number for each rounded size, 0 without a pillar; sizes end at the unit cell."""
    stand = (size_index > 0) & np.isfinite(sizes_nm).all(axis=0)
    steps = np.rint(np.where(stand, sizes_nm, 0.0) / step_nm).astype(np.int64)
    steps = np.clip(steps, 0, across - 1)
    return np.asarray(np.where((steps > 0).all(axis=0), steps[0] * across + steps[1], 0))
