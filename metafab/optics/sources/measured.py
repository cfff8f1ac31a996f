"""Pillars with measured sizes: a table of places and sizes, as from electron micrographs, over the pillars of a mask.

Each measured pillar takes its size. The others take the bias (measured less drawn width and length) of the measured
pillars around them, weighted by the inverse squared distance to the nearest four.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.layout.pillars import PillarMap, resized
from metafab.library import Library
from metafab.mask.measured import read_measured

#: Number of measured pillars that give an unmeasured one its bias.
_NEAREST = 4


def with_measured_sizes(pillars: PillarMap, path: Path, library: Library) -> PillarMap:
    """Return the pillars of a mask, upright as drawn, with the sizes of a table.

    The .csv has the columns x_um and y_um, from the axis, and width_nm and length_nm, or diameter_nm of circles and
    rings. InputError for a table that cannot be read, sizes of another shape, a place without a pillar or given twice,
    or sizes beyond the library; the message states the share of these pillars.
    """
    table = read_measured(path)
    cell = library.unit_cell.cell
    cell.require_sides(path, table.has_diameters)
    cell.require_diameters(path, table.size_nm)
    sites = table.sites(pillars)
    table.require_each_once(sites)
    site = (sites[:, 0], sites[:, 1])
    index, drawn_nm = pillars.to_array(), pillars.size_nm()
    bias_nm = table.size_nm - drawn_nm[index[site]]
    x_um, y_um = pillars.lattice.x_um(), pillars.lattice.y_um()
    tree = cKDTree(table.place_um)
    count = min(_NEAREST, len(table.place_um))

    def sizes_nm(band: slice) -> FloatArray:
        """Drawn sizes plus the bias around each site of a band of rows; measured sizes where there are any."""
        here = index[band]
        size_nm = np.moveaxis(drawn_nm[here], -1, 0).copy()
        row, column = np.nonzero(here)
        places = np.stack([x_um[column], y_um[band][row]], axis=1)
        distance, near = tree.query(places, k=range(1, count + 1))
        weight = 1.0 / np.maximum(distance, 1e-6) ** 2
        bias = (bias_nm[near] * weight[..., None]).sum(axis=1) / weight.sum(axis=1)[:, None]
        size_nm[:, row, column] += bias.T
        inside = (site[0] >= band.start) & (site[0] < band.stop)
        size_nm[:, site[0][inside] - band.start, site[1][inside]] = table.size_nm[inside].T
        return size_nm

    made = resized(pillars, sizes_nm)
    _require_known(made, library, path)
    return made


def _require_known(pillars: PillarMap, library: Library, path: Path) -> None:
    """Refuse sizes beyond those of the library."""
    size_nm = pillars.size_nm()
    used = pillars.numbers()
    beyond = np.zeros(len(size_nm), dtype=bool)
    for axis, known_nm in ((0, library.width_nm), (1, library.length_nm)):
        beyond |= (size_nm[:, axis] < known_nm[0] - 1e-6) | (size_nm[:, axis] > known_nm[-1] + 1e-6)
    if not used[beyond].any():
        return
    spans = " x ".join(f"{known_nm[0]:g} to {known_nm[-1]:g}" for known_nm in (library.width_nm, library.length_nm))
    worst = size_nm[beyond & (used > 0)][0]
    share = 100.0 * used[beyond].sum() / used.sum()
    got = f"{share:.2g} % of the pillars beyond, such as {worst[0]:g} x {worst[1]:g} nm"
    raise InputError.single(str(path), "sizes", f"sizes of the library, {spans} nm", got, "widen its sweep")
