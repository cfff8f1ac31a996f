"""Field behind the metasurface: the written pillars through their library, or the target phases; their apodisation.

Amplitudes are normalised to power: |a|^2 is the transmitted over the incident flux through the lens plane, so that
efficiencies add up in a propagation that conserves the integral of |a|^2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from metafab.core.arguments import require_types
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.interpolation import bilinear_on_grid
from metafab.layout.pillars import Lattice, PillarMap, SizeIndexArray
from metafab.library.library import Library
from metafab.library.use.amplitudes import power_amplitudes, power_normalised, turned_jones
from metafab.library.use.any_size import response_of_sizes
from metafab.phase.terms.sampled import read_array, require_coverage
from metafab.spec import Design, Device

_IDEAL_TILE_SITES = 256
#: Transmitted amplitude, 0 to 1, shape (n_y, n_x), at x, shape (n_x,), and y, shape (n_y,), in um.
Transmission = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class FieldTile:
    """Rectangular tile of sites: indices into a table of amplitudes, or the amplitudes themselves."""

    row: int  #: Lattice row of the first row.
    column: int  #: Lattice column of the first column.
    size_index: SizeIndexArray | None = None  #: Shape (n_y, n_x), rows of ``table``; None for a tile of amplitudes.
    #: Shape (n, n_polarisations), power-normalised amplitudes of each index: for x and y polarisation or, for turned
    #: pillars, the Jones entries xx, xy = yx and yy.
    table: ComplexArray | None = None
    amplitudes: ComplexArray | None = None  #: Shape (n_polarisations, n_y, n_x), if ``size_index`` is None.

    @property
    def polarisations(self) -> int:
        """Number of amplitudes of each site: 2, or the 3 entries of Jones matrices."""
        if self.table is not None:
            return int(self.table.shape[1])
        assert self.amplitudes is not None
        return len(self.amplitudes)

    def amplitude(self, polarisation: int) -> ComplexArray:
        """Return the amplitude of one polarisation at each site, shape (n_y, n_x)."""
        if self.size_index is None or self.table is None:
            assert self.amplitudes is not None
            return np.asarray(self.amplitudes[polarisation])
        return np.asarray(self.table[self.size_index, polarisation])

    def indexed(self, polarisation: int) -> tuple[NDArray[np.unsignedinteger], ComplexArray]:
        """Return indices, shape (n_y, n_x), into the amplitudes, shape (n,), of one polarisation."""
        if self.size_index is None or self.table is None:
            amplitude = self.amplitude(polarisation)
            sites = np.arange(amplitude.size).reshape(amplitude.shape)
            return sites.astype(np.uint16 if amplitude.size <= 1 << 16 else np.uint32), amplitude.ravel()
        return self.size_index, np.ascontiguousarray(self.table[:, polarisation])


class Source(Protocol):
    """Repeatable stream of field tiles over a lattice."""

    @property
    def lattice(self) -> Lattice:
        """Lattice of the sites."""

    def tiles(self) -> Iterator[FieldTile]:
        """Return disjoint tiles; sites without a tile are dark."""


@dataclass(frozen=True)
class WrittenField:
    """Pillars of a mask with the amplitudes of their sizes."""

    pillars: PillarMap  #: Size index of each site.
    #: Shape (n_sizes + 1, n_polarisations), t sqrt(n_out / n_in) of each size, as in :class:`FieldTile`; row 0 (no
    #: pillar) is dark.
    table: ComplexArray = field(repr=False)

    @property
    def lattice(self) -> Lattice:
        """Lattice of the pillars."""
        return self.pillars.lattice

    def tiles(self) -> Iterator[FieldTile]:
        """Return the tiles of the mask."""
        for tile in self.pillars.tiles():
            yield FieldTile(tile.row, tile.column, tile.size_index, self.table)


class Target(Protocol):
    """Target phases or Jones matrices."""

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Return the amplitudes at ``x_um``, shape (n_x,), and ``y_um``, shape (n_y,): (n_polarisations, n_y, n_x)."""


@dataclass(frozen=True)
class IdealField:
    """Target phases at full transmission inside the aperture."""

    profile: Target  #: Target phases.
    lattice: Lattice  #: Sampling points.
    device: Device  #: Outline and size of the aperture.

    def tiles(self) -> Iterator[FieldTile]:
        """Return square tiles without those outside the aperture."""
        x, y = self.lattice.x_um(), self.lattice.y_um()
        for row in range(0, y.size, _IDEAL_TILE_SITES):
            for column in range(0, x.size, _IDEAL_TILE_SITES):
                tile_x, tile_y = x[column : column + _IDEAL_TILE_SITES], y[row : row + _IDEAL_TILE_SITES]
                inside = self.device.encloses(tile_x, tile_y)
                if self.lattice.hexagonal:
                    inside &= self.lattice.carries(row + np.arange(tile_y.size), column + np.arange(tile_x.size))
                if inside.any():
                    yield FieldTile(row, column, amplitudes=self.profile.transmission(tile_x, tile_y) * inside)


@dataclass(frozen=True)
class ApodisedField:
    """Source behind a stop or an amplitude in the plane of the pillars."""

    source: Source  #: Field without the apodisation.
    transmission: Transmission  #: Amplitude that stop and apodisation transmit.

    @property
    def lattice(self) -> Lattice:
        """Lattice of the source."""
        return self.source.lattice

    def tiles(self) -> Iterator[FieldTile]:
        """Return the attenuated tiles of the source without the dark ones; clear tiles are unchanged."""
        x, y = self.lattice.x_um(), self.lattice.y_um()
        for tile in self.source.tiles():
            n_y, n_x = tile.amplitude(0).shape if tile.size_index is None else tile.size_index.shape
            transmitted = self.transmission(x[tile.column : tile.column + n_x], y[tile.row : tile.row + n_y])
            if (transmitted == 1.0).all():
                yield tile
            elif transmitted.any():
                amplitudes = [tile.amplitude(p) * transmitted for p in range(tile.polarisations)]
                yield FieldTile(tile.row, tile.column, amplitudes=np.array(amplitudes))


def written_field(pillars: PillarMap, library: Library) -> WrittenField:
    """Return the field behind the pillars of a mask, by the zero-order transmission of the library.

    InputError if the library lacks a size of the mask, or has another period.
    """
    _require_own(pillars, library)
    width_nm, length_nm = pillars.size_nm()[1:].T
    table = power_amplitudes(library, width_nm, length_nm) if width_nm.size else np.empty((0, 2), dtype=np.complex128)
    if pillars.angle_deg is not None:
        table = turned_jones(table, pillars.angle_deg[1:])
    return _with_dark(pillars, table)


def made_field(pillars: PillarMap, library: Library, executor: Executor | None = None) -> WrittenField:
    """Return the field behind upright pillars of any size, such as printed or measured ones.

    The executor solves sizes beyond the library's sweep. InputError if too many sizes lie beyond the sweep, or the
    library has another period.
    """
    _require_own(pillars, library)
    response = response_of_sizes(library, pillars.size_nm()[1:], executor)
    return _with_dark(pillars, power_normalised(response, library))


def _require_own(pillars: PillarMap, library: Library) -> None:
    """Refuse (InputError) a library of another period than that of the pillars, and other things than both."""
    require_types("optics", pillars=(pillars, PillarMap), library=(library, Library))
    own_nm = library.unit_cell.cell.period_nm
    period_nm = pillars.lattice.database_unit_nm * np.array(pillars.lattice.cell_dbu)
    if not np.allclose(own_nm, period_nm, rtol=1e-9):
        expected, got = ("{:g} x {:g} nm".format(*each) for each in (period_nm, own_nm))
        remedy = "give the library that the layout was made with"
        raise InputError.single("library", "period_nm", f"that of the pillars, {expected}", got, remedy)


def _with_dark(pillars: PillarMap, table: ComplexArray) -> WrittenField:
    """Field of amplitudes of each size, shape (n_sizes, n_polarisations); sites without a pillar are dark."""
    return WrittenField(pillars, np.concatenate([np.zeros((1, table.shape[1]), dtype=np.complex128), table]))


def ideal_field(profile: Target, lattice: Lattice, device: Device) -> IdealField:
    """Return the field of the target phases themselves: that of a perfect library and mask."""
    return IdealField(profile, lattice, device)


@dataclass(frozen=True)
class Apodisation:
    """Round stop and sampled amplitude; either may be absent."""

    stop_um: float = np.inf  #: Diameter of the stop; infinite for none.
    #: Shape (n_y, n_x), amplitudes on a square grid about the axis, lowest y first; None for 1.
    samples: FloatArray | None = None
    pitch_um: float = 1.0  #: Distance of the samples, between which the amplitude is bilinear.

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Return the transmitted amplitude, shape (n_y, n_x), at ``x_um``, shape (n_x,), and ``y_um``, shape (n_y,).

        A site is inside the stop if its centre is, as with the aperture.
        """
        open_ = np.hypot(x_um[None, :], y_um[:, None]) <= 0.5 * self.stop_um
        if self.samples is None:
            return open_.astype(np.float64)
        return np.asarray(open_ * bilinear_on_grid(self.samples, x_um / self.pitch_um, y_um / self.pitch_um))

    @classmethod
    def of(cls, design: Design) -> Apodisation | None:
        """Return the apodisation of a design (``[optics]``); None for none.

        InputError if the file of amplitudes cannot be read, has values outside 0 to 1, or does not cover the aperture.
        """
        optics = design.optics
        if optics is None or (optics.stop_um is None and optics.amplitude_file is None):
            return None
        stop_um = np.inf if optics.stop_um is None else optics.stop_um
        if optics.amplitude_file is None or optics.amplitude_pitch_um is None:
            return cls(stop_um)
        samples = _amplitudes(optics.amplitude_file, optics.amplitude_dataset)
        pitch_um, radius_um = optics.amplitude_pitch_um, 0.5 * design.device.aperture_um
        require_coverage(optics.amplitude_file, "optics.amplitude_pitch_um", min(samples.shape), pitch_um, radius_um)
        return cls(stop_um, samples, pitch_um)


def apodised(source: Source, transmission: Transmission | None) -> Source:
    """Return the source behind an apodisation; the source itself for None."""
    return source if transmission is None else ApodisedField(source, transmission)


def _amplitudes(file: Path, dataset: str) -> FloatArray:
    samples = read_array(file, dataset)
    fits = samples.ndim == 2 and min(samples.shape) >= 2 and samples.dtype.kind in "fiu"
    if not fits or not np.isfinite(samples).all() or samples.min() < 0.0 or samples.max() > 1.0:
        got = f"{samples.dtype} of shape {samples.shape}"
        if fits:
            got += f", {samples.min():g} to {samples.max():g}"
        expected = "amplitudes from 0 to 1 of shape (n_y, n_x), at least 2 x 2"
        remedy = "give the square root of the transmitted power"
        raise InputError.single(str(file), "optics.amplitude_file", expected, got, remedy)
    return samples.astype(np.float64)
