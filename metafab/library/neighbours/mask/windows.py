"""Corrections of the field of a window of a mask by the neighbours of its pillars: lines along x plus lines along y."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.library.neighbours.mask.open_lines import IndexArray, open_line_corrections, open_line_slopes
from metafab.library.neighbours.mask.size_tables import SizeTables
from metafab.library.neighbours.model import Neighbours

#: Neighbours that a window needs on each side. The coupling falls to 1/e within about five sites; measured on a
#: lens, with 24 the corrections of the sites at a window's end are off by 4.5e-3 (light along) and 2.1e-3 of the field,
#: which is some 5e-4 over a tile of 512.
HALO_SITES = 24


@dataclass(frozen=True)
class NeighbourTables:
    """Tables of the sizes of a mask for both directions of the lines and both polarisations."""

    along_x: tuple[SizeTables, SizeTables]  #: Lines along x, for x and for y polarised light.
    along_y: tuple[SizeTables, SizeTables]  #: Lines along y, likewise.

    @classmethod
    def of(cls, neighbours: Neighbours, size_nm: FloatArray) -> NeighbourTables:
        """Tables of sizes (width, length), shape (n, 2); (0, 0) is no pillar."""
        x, y = (
            [SizeTables.of(neighbours.line(direction, light).model, sizes) for light in POLARISATIONS]
            for direction, sizes in enumerate((size_nm, size_nm[:, ::-1]))
        )
        return cls((x[0], x[1]), (y[0], y[1]))

    def corrections(self, size_index: IndexArray, polarisation: Literal[0, 1]) -> ComplexArray:
        """Corrections t_m - t(s_m) of the inner sites of a window, shape (n_y, n_x); ``polarisation`` 0 is x, 1 is y.

        ``size_index`` has shape (n_y + 2 HALO_SITES, n_x + 2 HALO_SITES).
        """
        inner = slice(HALO_SITES, -HALO_SITES)
        rows = open_line_corrections(self.along_x[polarisation], size_index[inner])[:, inner]
        columns = open_line_corrections(self.along_y[polarisation], size_index[:, inner].T)[:, inner]
        return np.asarray(rows + columns.T)

    def field(self, size_index: IndexArray) -> ComplexArray:
        """Corrections of all sites of a window whose ends have no neighbours, shape (2, n_y, n_x)."""
        pairs = zip(self.along_x, self.along_y, strict=True)
        found = [open_line_corrections(x, size_index) + open_line_corrections(y, size_index.T).T for x, y in pairs]
        return np.asarray(found)

    def slopes(self, size_index: IndexArray, weight: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Corrections of all sites of a window whose ends have no neighbours, and derivatives of their weighted sum.

        ``weight``, shape (2, n_y, n_x), is of the field of x and y polarised light; 0 where no pillar stands.
        Corrections have its shape; derivatives, shape (2, n_y, n_x, 2), per nm, are of the sum over all sites, for each
        polarisation, by width and length of each pillar.
        """
        field = np.empty(weight.shape, dtype=np.complex128)
        slopes = np.empty((*weight.shape, 2), dtype=np.complex128)
        for light in range(2):
            rows, by_rows = open_line_slopes(self.along_x[light], size_index, weight[light])
            columns, by_columns = open_line_slopes(self.along_y[light], size_index.T, weight[light].T)
            field[light] = rows + columns.T
            slopes[light] = by_rows
            slopes[light] += by_columns.transpose(1, 0, 2)[..., ::-1]
        return field, slopes
