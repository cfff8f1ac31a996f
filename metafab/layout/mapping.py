"""One tile: target phases -> the best sizes, and how well they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray, wrap_phase
from metafab.core.numerics import HAS_NUMBA, compiled
from metafab.layout.aperture import Aperture
from metafab.layout.gaps import smallest_gap
from metafab.layout.pillars import PillarTile, SizeIndexArray
from metafab.library import SizeTable
from metafab.phase.profile import PhaseProfile


@dataclass(frozen=True)
class TileFigures:
    """Sums over the pillars of a tile; those of all tiles add up to the lens'.

    Attributes:
        pillars: how many.
        overlap: shape (2,), sum of t exp(-i target) for x and y polarisation.
        power: shape (2,), sum of |t|^2.
        square_error: shape (2,), sum of (arg t - target)^2, each wrapped to (-pi, pi].
        used: shape (n_sizes + 1,), pillars of each size.
        smallest_gap_dbu: over all pairs with a pillar in the tile, neighbours in other tiles included.
    """

    pillars: int
    overlap: NDArray[np.complex128]
    power: FloatArray
    square_error: FloatArray
    used: NDArray[np.int64]
    smallest_gap_dbu: float

    def __add__(self, other: TileFigures) -> TileFigures:
        return TileFigures(
            self.pillars + other.pillars,
            self.overlap + other.overlap,
            self.power + other.power,
            self.square_error + other.square_error,
            self.used + other.used,
            min(self.smallest_gap_dbu, other.smallest_gap_dbu),
        )


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
        target = self.profile(
            lattice.x_um()[halo_column:halo_end_column], lattice.y_um()[halo_row:halo_end_row]
        ) + np.reshape(self.offset_rad, (2, 1, 1))
        shape = (halo_end_row - halo_row, halo_end_column - halo_column)
        with_halo = self.table.sizes_for(target[0], target[1])
        with_halo[~self.aperture.inside(halo_row, halo_column, shape)] = 0
        core = (slice(row - halo_row, end_row - halo_row), slice(column - halo_column, end_column - halo_column))
        size_index = np.ascontiguousarray(with_halo[core])
        overlap, power, square_error = compare(size_index, target[:, *core], self.table)
        figures = TileFigures(
            int(np.count_nonzero(size_index)),
            overlap,
            power,
            square_error,
            np.bincount(size_index.ravel(), minlength=len(self.table.size_dbu)),
            smallest_gap(with_halo, self.table.size_dbu, lattice).smallest_dbu,
        )
        return PillarTile(row, column, size_index), figures


def compare(
    size_index: SizeIndexArray, target_rad: FloatArray, table: SizeTable
) -> tuple[NDArray[np.complex128], FloatArray, FloatArray]:
    """Sums of t exp(-i target), |t|^2 and squared phase error over the pillars, each of shape (2,)."""
    amplitude, phase_rad = np.abs(table.t), np.angle(table.t)
    if HAS_NUMBA:
        sums = _compare_compiled(size_index, np.ascontiguousarray(target_rad), amplitude, phase_rad)
        return sums[:, 0] + 1j * sums[:, 1], sums[:, 2], sums[:, 3]
    filled = size_index > 0
    size = size_index[filled]
    error = wrap_phase(phase_rad[size].T - target_rad[:, filled])
    overlap = np.sum(amplitude[size].T * np.exp(1j * error), axis=1)
    return overlap, np.sum(amplitude[size].T ** 2, axis=1), np.sum(error**2, axis=1)


@compiled
def _compare_compiled(
    size_index: SizeIndexArray, target_rad: FloatArray, amplitude: FloatArray, phase_rad: FloatArray
) -> FloatArray:
    sums = np.zeros((2, 4))
    turn = 2.0 * np.pi
    for channel in range(2):
        for row in range(size_index.shape[0]):
            for column in range(size_index.shape[1]):
                size = size_index[row, column]
                if size == 0:
                    continue
                error = phase_rad[size, channel] - target_rad[channel, row, column]
                error -= turn * np.rint(error / turn)
                sums[channel, 0] += amplitude[size, channel] * np.cos(error)
                sums[channel, 1] += amplitude[size, channel] * np.sin(error)
                sums[channel, 2] += amplitude[size, channel] ** 2
                sums[channel, 3] += error * error
    return sums
