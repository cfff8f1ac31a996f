"""One tile: target phases -> the best sizes, and how well they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.layout.aperture import Aperture
from metafab.layout.figures import TileFigures
from metafab.layout.gaps import smallest_gap
from metafab.layout.pillars import PillarTile
from metafab.library import SizeTable
from metafab.phase.profile import PhaseProfile


@dataclass(frozen=True)
class Mapping:
    """Everything that a tile needs; small enough to travel to another process.

    Attributes:
        profile: target phases.
        table: sizes and the look-up.
        aperture: which sites carry a pillar.
        offset_rad: constants added to the target phases of x and y polarisation.
        tile_sites: sites a side of a tile.
    """

    profile: PhaseProfile
    table: SizeTable
    aperture: Aperture
    offset_rad: tuple[float, float]
    tile_sites: int

    def places(self) -> list[tuple[int, int]]:
        """(row, column) of every tile that holds a pillar, row by row."""
        n_y, n_x = self.aperture.lattice.shape
        step = self.tile_sites
        found = []
        for row in range(0, n_y, step):
            first = self.aperture.first[row : row + step]
            last = self.aperture.last[row : row + step]
            found += [
                (row, column)
                for column in range(0, n_x, step)
                if np.any((first < column + step) & (last > np.maximum(first, column)))
            ]
        return found

    def __call__(self, place: tuple[int, int]) -> tuple[PillarTile, TileFigures]:
        """Map the tile at (row, column)."""
        lattice = self.aperture.lattice
        bounds = [
            (max(start - 1, 0), start, min(start + self.tile_sites, count), min(start + self.tile_sites + 1, count))
            for start, count in zip(place, lattice.shape, strict=True)
        ]
        (halo_row, row, end_row, halo_end_row), (halo_column, column, end_column, halo_end_column) = bounds
        target = self.profile(lattice.x_um()[halo_column:halo_end_column], lattice.y_um()[halo_row:halo_end_row])
        target += np.reshape(self.offset_rad, (2, 1, 1))
        with_halo = self.table.sizes_for(target[0], target[1])
        with_halo *= self.aperture.inside(halo_row, halo_column, with_halo.shape)
        gap_dbu = smallest_gap(with_halo, self.table.size_dbu, lattice).smallest_dbu
        core = (slice(row - halo_row, end_row - halo_row), slice(column - halo_column, end_column - halo_column))
        counted = np.zeros_like(with_halo)
        counted[core] = with_halo[core]
        figures = TileFigures.of(counted, target, self.table, gap_dbu)
        return PillarTile(row, column, np.ascontiguousarray(with_halo[core])), figures
