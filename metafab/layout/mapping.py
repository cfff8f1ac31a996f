"""One tile: target phases -> the best sizes, and how well they do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.layout.aperture import Aperture
from metafab.layout.figures import TileFigures
from metafab.layout.gaps import smallest_gap
from metafab.layout.neighbours import JointSizes, reach_sites
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import PillarTile, SizeIndexArray
from metafab.library import SizeTable
from metafab.phase.terms.profile import PhaseProfile


@dataclass(frozen=True)
class Mapping:
    """Everything that a tile needs; small enough to travel to another process.

    Attributes:
        profile: target phases.
        table: sizes and the look-up.
        aperture: which sites carry a pillar.
        offset_rad: constants added to the target phases of x and y polarisation.
        tile_sites: sites a side of a tile.
        joint: chooses sizes jointly, from the look-up's on; None where every pillar keeps the gap by itself.
        outline: of the pillars, for their gaps.
    """

    profile: PhaseProfile
    table: SizeTable
    aperture: Aperture
    offset_rad: tuple[float, float]
    tile_sites: int
    joint: JointSizes | None = None
    outline: Outline = RECTANGLE

    def places(self) -> list[tuple[int, int]]:
        """(row, column) of every tile that holds a pillar, row by row."""
        n_y, n_x = self.aperture.lattice.shape
        step = self.tile_sites
        return [
            (row, column)
            for row in range(0, n_y, step)
            for column in range(0, n_x, step)
            if self.aperture.meets(row, column, step)
        ]

    def __call__(self, place: tuple[int, int]) -> tuple[PillarTile, TileFigures]:
        """Map the tile at (row, column)."""
        lattice = self.aperture.lattice
        halo = np.array(lattice.reach) if self.joint is None else np.add(lattice.reach, reach_sites(lattice))
        first = np.maximum(np.subtract(place, halo), 0).tolist()
        last = np.minimum(np.add(place, self.tile_sites + halo), lattice.shape).tolist()
        target = self.profile(lattice.x_um()[first[1] : last[1]], lattice.y_um()[first[0] : last[0]])
        target += np.reshape(self.offset_rad, (2, 1, 1))
        sizes = self.table.sizes_for(target[0], target[1])
        sizes *= self.aperture.inside(first[0], first[1], sizes.shape)
        if self.joint is None:
            return self._tile(place, first, sizes, target)
        _, plain = self._tile(place, first, sizes, target)
        self.joint.improve(sizes, target, lattice, (first[0], first[1]))
        tile, figures = self._tile(place, first, sizes, target)
        return tile, replace(figures, plain=plain)

    def _tile(
        self, place: tuple[int, int], corner: list[int], sizes: SizeIndexArray, target_rad: FloatArray
    ) -> tuple[PillarTile, TileFigures]:
        """The tile at (row, column) and its figures, from a block with a halo whose first site is ``corner``."""
        row, column = (start - shift for start, shift in zip(place, corner, strict=True))
        core = np.s_[row : row + self.tile_sites, column : column + self.tile_sites]
        down, right = self.aperture.lattice.reach
        low, left = max(row - down, 0), max(column - right, 0)
        beside = np.s_[low : row + self.tile_sites + down, left : column + self.tile_sites + right]
        block, lattice = sizes[beside], self.aperture.lattice
        gap_dbu = smallest_gap(block, self.table.size_dbu, lattice, outline=self.outline).smallest_dbu
        counted = np.zeros_like(sizes)
        counted[core] = sizes[core]
        tile = PillarTile(*place, np.ascontiguousarray(sizes[core]))
        return tile, TileFigures.of(counted, target_rad, self.table, gap_dbu)
