"""Mapping of one tile: target phases -> the best sizes, and the sums that measure their fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout.aperture import Aperture
from metafab.layout.figures import TileSums
from metafab.layout.gaps import smallest_gap
from metafab.layout.joint import JointSizes, reach_sites
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import PillarTile, SizeIndexArray
from metafab.library import Library, SizeTable
from metafab.library.neighbours.mask.choice import NeighbourChoice, local_mean
from metafab.library.neighbours.mask.windows import HALO_SITES
from metafab.library.use.lights import SizesOfLights
from metafab.phase.terms.profile import PhaseProfile


@dataclass(frozen=True)
class LightTarget:
    """One of several lights that a mask serves."""

    profile: PhaseProfile  #: Target phases.
    library: Library  #: Library at the wavelength of the light.
    weight: float  #: Weight of the field overlap in the choice of each size.


@dataclass(frozen=True)
class LightChoice:
    """Choice of sizes for several lights."""

    profiles: tuple[PhaseProfile, ...]  #: Target phases of each light.
    sizes: SizesOfLights  #: Sizes and their transmission of each light.
    offsets_rad: FloatArray  #: Shape (n_lights, 2), constants added to the target phases of x and y polarisation.

    def target_rad(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Evaluate the target phases, constants included, at x, shape (n_x,), and y, shape (n_y,).

        Returns:
            Shape (n_lights, 2, n_y, n_x).
        """
        return np.stack([profile(x_um, y_um) for profile in self.profiles]) + self.offsets_rad[..., None, None]


@dataclass(frozen=True)
class TileMapping:
    """Everything that is needed to map a tile; small enough to travel to another process."""

    profile: PhaseProfile  #: Target phases.
    table: SizeTable  #: Sizes and their look-up table.
    aperture: Aperture  #: Sites that carry a pillar.
    offset_rad: tuple[float, float]  #: Constants added to the target phases of x and y polarisation.
    tile_sites: int  #: Sites per side of a tile.
    #: Chooses sizes jointly, starting from the look-up table; None where every pillar keeps the gap alone.
    joint: JointSizes | None = None
    #: Chooses sizes by their light among neighbours, starting from the look-up table; None for the library's t alone.
    choice: NeighbourChoice | None = None
    #: Sums of sampled tiles with the light among neighbours, where ``table`` was shifted for neighbours; else None.
    sample: TileSums | None = None
    lights: LightChoice | None = None  #: Chooses sizes for several lights; None for the light of ``profile`` alone.
    outline: Outline = RECTANGLE  #: Outline of the pillars, for their gaps.

    def corners(self) -> list[tuple[int, int]]:
        """(row, column) of every tile that holds a pillar, row by row."""
        all_corners = self.aperture.lattice.tile_corners(self.tile_sites)
        return [(row, column) for row, column in all_corners if self.aperture.meets(row, column, self.tile_sites)]

    def __call__(self, corner: tuple[int, int]) -> tuple[PillarTile, TileSums]:
        """Map the tile whose first site is ``corner``, (row, column)."""
        lattice = self.aperture.lattice
        row, column, target, sizes, of_lights = self._window(corner)
        inset = corner[0] - row, corner[1] - column
        if self.choice is not None:
            fields = self.choice.improve(sizes, target)
            tile, sums = self._tile(corner, inset, sizes, target)
            return tile, self._among(sums, inset, sizes, fields)
        tile, sums = self._tile(corner, inset, sizes, target)
        if self.lights is not None and of_lights is not None:
            each = [
                self._tile(corner, inset, sizes, at, table)[1]
                for at, table in zip(of_lights, self.lights.sizes.tables, strict=True)
            ]
            return tile, replace(sums, lights=tuple(each))
        if self.joint is None:
            return tile, sums
        self.joint.improve(sizes, target, lattice, (row, column))
        tile, joint_sums = self._tile(corner, inset, sizes, target)
        return tile, replace(joint_sums, each=sums)

    def phase_shifts(self, corner: tuple[int, int]) -> ComplexArray:
        """:meth:`NeighbourChoice.phase_shifts` of the tile whose first site is ``corner``, shape (2, cells, cells)."""
        assert self.choice is not None
        row, column, target, sizes, _ = self._window(corner)
        inset = corner[0] - row, corner[1] - column
        core = np.s_[inset[0] : inset[0] + self.tile_sites, inset[1] : inset[1] + self.tile_sites]
        return self.choice.phase_shifts(sizes, target, core)

    def sampled(self, corner: tuple[int, int], table: SizeTable) -> TileSums:
        """Sums of the tile whose first site is ``corner`` with the sizes of ``table``, light among neighbours included.

        ``table`` is :attr:`table` shifted for neighbours; :attr:`table` itself chooses sizes for equal neighbours.
        """
        assert self.choice is not None
        row, column, target, lone, _ = self._window(corner)
        inset = corner[0] - row, corner[1] - column
        sizes = table.sizes_for(target[0], target[1]) * (lone > 0)
        fields = (self.choice.reached(lone, target), self.choice.reached(sizes, target))
        return self._among(self._tile(corner, inset, sizes, target)[1], inset, sizes, fields)

    def _among(
        self,
        sums: TileSums,
        inset: tuple[int, int],
        sizes: SizeIndexArray,
        fields: tuple[ComplexArray, ComplexArray],
    ) -> TileSums:
        """Add the sums of the fields over the target wave, before and after the choice among neighbours."""
        core = np.s_[:, inset[0] : inset[0] + self.tile_sites, inset[1] : inset[1] + self.tile_sites]
        among = np.array([field[core].sum(axis=(1, 2)) for field in fields])
        power = np.array([np.sum(np.abs(field[core]) ** 2, axis=(1, 2)) for field in fields])
        square = [np.sum(np.angle(local_mean(field, sizes)[core]) ** 2 * (sizes[core[1:]] > 0)) for field in fields]
        return replace(sums, among=among, among_power=power, among_square_error=np.array(square))

    def _window(self, corner: tuple[int, int]) -> tuple[int, int, FloatArray, SizeIndexArray, FloatArray | None]:
        """First row and column of a tile with its halo, targets, sizes by the look-up, and targets of all lights."""
        lattice = self.aperture.lattice
        halo = np.array(lattice.reach)
        if self.joint is not None:
            halo += reach_sites(lattice)
        if self.choice is not None:
            halo += HALO_SITES
        row, column = np.maximum(np.subtract(corner, halo), 0).tolist()
        last_row, last_column = np.minimum(np.add(corner, self.tile_sites + halo), lattice.shape).tolist()
        x_um, y_um = lattice.x_um()[column:last_column], lattice.y_um()[row:last_row]
        target = self.profile(x_um, y_um)
        target += np.reshape(self.offset_rad, (2, 1, 1))
        of_lights = None if self.lights is None else self.lights.target_rad(x_um, y_um)
        if self.lights is None or of_lights is None:
            sizes = self.table.sizes_for(target[0], target[1])
        else:
            sizes = self.lights.sizes.best(of_lights)[0]
        sizes *= self.aperture.inside(row, column, sizes.shape)
        return row, column, target, sizes, of_lights

    def _tile(
        self,
        corner: tuple[int, int],
        inset: tuple[int, int],
        sizes: SizeIndexArray,
        target_rad: FloatArray,
        table: SizeTable | None = None,
    ) -> tuple[PillarTile, TileSums]:
        """Cut the tile at ``inset`` out of a block with a halo; sum its fit by ``table``, by default :attr:`table`."""
        row, column = inset
        core = np.s_[row : row + self.tile_sites, column : column + self.tile_sites]
        lattice = self.aperture.lattice
        down, right = lattice.reach
        low, left = max(row - down, 0), max(column - right, 0)
        with_neighbours = np.s_[low : row + self.tile_sites + down, left : column + self.tile_sites + right]
        gaps = smallest_gap(sizes[with_neighbours], self.table.size_dbu, lattice, outline=self.outline)
        counted = np.zeros_like(sizes)
        counted[core] = sizes[core]
        tile = PillarTile(*corner, np.ascontiguousarray(sizes[core]))
        return tile, TileSums.of(counted, target_rad, table or self.table, gaps.smallest_dbu)
