"""Mapping of one tile: target phases -> the best sizes, and the sums that measure their fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

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


class _Window(NamedTuple):
    """A tile and a halo around it, inside the lattice."""

    first: tuple[int, int]  #: (row, column) of the first site.
    core: tuple[slice, slice]  #: Rows and columns of the tile in the window.
    target_rad: FloatArray  #: Shape (2, n_y, n_x), target phases of x and y polarisation.
    sizes: SizeIndexArray  #: Shape (n_y, n_x), size of each site; improved in place.
    of_lights_rad: FloatArray | None  #: Shape (n_lights, 2, n_y, n_x), targets of several lights; None for one.


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
        window = self._window(corner)
        if self.choice is not None:
            fields = self.choice.improve(window.sizes, window.target_rad)
            tile, sums = self._tile(window)
            return tile, self._among(sums, window, fields)
        tile, sums = self._tile(window)
        if self.lights is not None and window.of_lights_rad is not None:
            each = [
                self._tile(window._replace(target_rad=target_rad), table)[1]
                for target_rad, table in zip(window.of_lights_rad, self.lights.sizes.tables, strict=True)
            ]
            return tile, replace(sums, lights=tuple(each))
        if self.joint is None:
            return tile, sums
        self.joint.improve(window.sizes, window.target_rad, self.aperture.lattice, window.first)
        tile, joint_sums = self._tile(window)
        return tile, replace(joint_sums, each=sums)

    def phase_shifts(self, corner: tuple[int, int]) -> ComplexArray:
        """:meth:`NeighbourChoice.phase_shifts` of the tile whose first site is ``corner``, shape (2, cells, cells)."""
        assert self.choice is not None
        window = self._window(corner)
        return self.choice.phase_shifts(window.sizes, window.target_rad, window.core)

    def sampled(self, corner: tuple[int, int], table: SizeTable) -> TileSums:
        """Sums of the tile whose first site is ``corner`` with the sizes of ``table``, light among neighbours included.

        ``table`` is :attr:`table` shifted for neighbours; :attr:`table` itself chooses sizes for equal neighbours.
        """
        assert self.choice is not None
        lone = self._window(corner)
        target_rad = lone.target_rad
        sampled = lone._replace(sizes=table.sizes_for(target_rad[0], target_rad[1]) * (lone.sizes > 0))
        fields = tuple(self.choice.reached(each.sizes, target_rad) for each in (lone, sampled))
        return self._among(self._tile(sampled)[1], sampled, fields)

    def _among(self, sums: TileSums, window: _Window, fields: Sequence[ComplexArray]) -> TileSums:
        """Add the sums of the fields over the target wave, before and after the choice among neighbours."""
        core, sizes = (slice(None), *window.core), window.sizes
        among = np.array([field[core].sum(axis=(1, 2)) for field in fields])
        power = np.array([np.sum(np.abs(field[core]) ** 2, axis=(1, 2)) for field in fields])
        stands = sizes[window.core] > 0
        square = [np.sum(np.angle(local_mean(field, sizes)[core]) ** 2 * stands) for field in fields]
        return replace(sums, among=among, among_power=power, among_square_error=np.array(square))

    def _window(self, corner: tuple[int, int]) -> _Window:
        """The tile whose first site is ``corner``, (row, column), with its halo and sizes by the look-up."""
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
        inset_y, inset_x = corner[0] - row, corner[1] - column
        core = slice(inset_y, inset_y + self.tile_sites), slice(inset_x, inset_x + self.tile_sites)
        return _Window((row, column), core, target, sizes, of_lights)

    def _tile(self, window: _Window, table: SizeTable | None = None) -> tuple[PillarTile, TileSums]:
        """Cut the tile out of a window; sum its fit by ``table``, by default :attr:`table`."""
        (rows, columns), sizes, lattice = window.core, window.sizes, self.aperture.lattice
        down, right = lattice.reach
        low, left = max(rows.start - down, 0), max(columns.start - right, 0)
        with_neighbours = np.s_[low : rows.stop + down, left : columns.stop + right]
        gaps = smallest_gap(sizes[with_neighbours], self.table.size_dbu, lattice, outline=self.outline)
        counted = np.zeros_like(sizes)
        counted[window.core] = sizes[window.core]
        corner = window.first[0] + rows.start, window.first[1] + columns.start
        tile = PillarTile(*corner, np.ascontiguousarray(sizes[window.core]))
        return tile, TileSums.of(counted, window.target_rad, table or self.table, gaps.smallest_dbu)
