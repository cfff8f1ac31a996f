"""What leaves the metasurface: the written pillars through their library, or the target phases themselves.

Amplitudes are normalised to power: |a|^2 is the flux through the lens plane per incident flux, so that a
propagation that conserves the integral of |a|^2 makes efficiencies add up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout.pillars import Lattice, PillarMap, SizeIndexArray
from metafab.library.library import Library
from metafab.library.use.amplitudes import power_amplitudes, turned_jones
from metafab.spec import Device
from metafab.spec.outline import encloses

_IDEAL_TILE_SITES = 256


@dataclass(frozen=True)
class FieldTile:
    """A rectangular block of sites: indices into a table of amplitudes, or the amplitudes themselves.

    Attributes:
        row: lattice row of the first row.
        column: lattice column of the first column.
        size_index: shape (n_y, n_x), rows of ``table``; None for a tile that carries its amplitudes.
        table: shape (n, n_polarisations), power-normalised amplitude of each index for x and y polarisation or, of
            turned pillars, the Jones matrix' entries xx, xy = yx and yy.
        amplitudes: shape (n_polarisations, n_y, n_x) where ``size_index`` is None.
    """

    row: int
    column: int
    size_index: SizeIndexArray | None = None
    table: ComplexArray | None = None
    amplitudes: ComplexArray | None = None

    @property
    def polarisations(self) -> int:
        """Number of amplitudes at each site: 2, or 3 entries of Jones matrices."""
        if self.table is not None:
            return int(self.table.shape[1])
        assert self.amplitudes is not None
        return len(self.amplitudes)

    def amplitude(self, polarisation: int) -> ComplexArray:
        """Amplitude of one polarisation at each site, shape (n_y, n_x)."""
        if self.size_index is None or self.table is None:
            assert self.amplitudes is not None
            return np.asarray(self.amplitudes[polarisation])
        return np.asarray(self.table[self.size_index, polarisation])

    def indexed(self, polarisation: int) -> tuple[NDArray[np.unsignedinteger], ComplexArray]:
        """The same as an index, shape (n_y, n_x), into amplitudes, shape (n,): what the compiled pass reads."""
        if self.size_index is None or self.table is None:
            amplitude = self.amplitude(polarisation)
            sites = np.arange(amplitude.size).reshape(amplitude.shape)
            return sites.astype(np.uint16 if amplitude.size <= 1 << 16 else np.uint32), amplitude.ravel()
        return self.size_index, np.ascontiguousarray(self.table[:, polarisation])


class Source(Protocol):
    """A stream of field tiles over a lattice, which can be opened again and again."""

    @property
    def lattice(self) -> Lattice:
        """Where the sites are."""

    def tiles(self) -> Iterator[FieldTile]:
        """Tiles that cover the lattice once; where there is none, no light comes through."""


@dataclass(frozen=True)
class WrittenField:
    """Pillars of a mask, each with the amplitudes of its size.

    Attributes:
        pillars: the sites' size indices.
        table: shape (n_sizes + 1, n_polarisations), t sqrt(n_out / n_in) of each size, as :class:`FieldTile` holds it;
            row 0 (no pillar) is dark.
    """

    pillars: PillarMap
    table: ComplexArray

    @property
    def lattice(self) -> Lattice:
        """The pillars' lattice."""
        return self.pillars.lattice

    def tiles(self) -> Iterator[FieldTile]:
        """The mask's tiles."""
        for tile in self.pillars.tiles():
            yield FieldTile(tile.row, tile.column, tile.size_index, self.table)


class Target(Protocol):
    """Target phases or Jones matrices."""

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Amplitudes on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,), shape (n_polarisations, n_y, n_x)."""


@dataclass(frozen=True)
class IdealField:
    """The target phases at full transmission inside the aperture.

    Attributes:
        profile: target phases.
        lattice: where they are sampled.
        device: the aperture's outline and size.
    """

    profile: Target
    lattice: Lattice
    device: Device

    def tiles(self) -> Iterator[FieldTile]:
        """Square tiles; those outside the aperture are left out."""
        x, y = self.lattice.x_um(), self.lattice.y_um()
        for row in range(0, y.size, _IDEAL_TILE_SITES):
            for column in range(0, x.size, _IDEAL_TILE_SITES):
                tile_x, tile_y = x[column : column + _IDEAL_TILE_SITES], y[row : row + _IDEAL_TILE_SITES]
                inside = encloses(self.device, tile_x, tile_y)
                if self.lattice.hexagonal:
                    inside &= self.lattice.carries(row + np.arange(tile_y.size), column + np.arange(tile_x.size))
                if inside.any():
                    yield FieldTile(row, column, amplitudes=self.profile.transmission(tile_x, tile_y) * inside)


@dataclass(frozen=True)
class ApodisedField:
    """A source behind a stop or a filter in its own plane.

    Attributes:
        behind: what leaves the metasurface without it.
        transmission: amplitude that it lets through, 0 to 1, of shape (n_y, n_x) on the grid of x (n_x,) and y (n_y,).
    """

    behind: Source
    transmission: Callable[[FloatArray, FloatArray], FloatArray]

    @property
    def lattice(self) -> Lattice:
        """The source's lattice."""
        return self.behind.lattice

    def tiles(self) -> Iterator[FieldTile]:
        """The source's tiles, weakened; dark ones are left out, clear ones left as they are."""
        x, y = self.lattice.x_um(), self.lattice.y_um()
        for tile in self.behind.tiles():
            n_y, n_x = tile.amplitude(0).shape if tile.size_index is None else tile.size_index.shape
            let_through = self.transmission(x[tile.column : tile.column + n_x], y[tile.row : tile.row + n_y])
            if (let_through == 1.0).all():
                yield tile
            elif let_through.any():
                amplitudes = [tile.amplitude(p) * let_through for p in range(tile.polarisations)]
                yield FieldTile(tile.row, tile.column, amplitudes=np.array(amplitudes))


def written_field(pillars: PillarMap, library: Library) -> WrittenField:
    """The field behind the pillars of a mask, by the library's zero-order transmission.

    Raises:
        InputError: the mask holds a size that the library does not.
    """
    width_nm, length_nm = pillars.size_nm()[1:].T
    table = power_amplitudes(library, width_nm, length_nm) if width_nm.size else np.empty((0, 2), dtype=np.complex128)
    if pillars.angle_deg is not None:
        table = turned_jones(table, pillars.angle_deg[1:])
    table = np.concatenate([np.zeros((1, table.shape[1]), dtype=np.complex128), table])
    return WrittenField(pillars, table)


def ideal_field(profile: Target, lattice: Lattice, device: Device) -> IdealField:
    """The field of the target phases themselves: what a perfect library and mask would give."""
    return IdealField(profile, lattice, device)
