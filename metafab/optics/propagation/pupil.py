"""Millions of pillars to some 10^5 block sums, in one streaming pass.

Within a block, the light of all pillars travels to the image point with nearly the same phase once the exact
(non-paraxial) path of a carrier ray is removed at every site. A block is then its sum and its two first moments;
what other object points, depths and window points add to the phase is smooth across it. The moments make ragged
rims and phase slopes exact to second order in the block's size. The phase is reduced in double precision. Blocks
of twice the side are made of four, which is how the error is estimated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.progress import Progress, silent
from metafab.layout.pillars import Lattice
from metafab.optics.geometry.path import Ray, path_um
from metafab.optics.sources.source import FieldTile, Source


@dataclass(frozen=True)
class Carrier:
    """Which polarisation is summed, after removal of the path of which ray, in blocks of how many sites."""

    polarisation: int
    ray: Ray
    block_sites: int


@dataclass(frozen=True)
class Pupil:
    """Block sums of one polarisation behind a carrier.

    Attributes:
        carrier: polarisation, ray and block size.
        wavenumber: k, rad/um.
        pitch_um: (x, y) distance of sites.
        cell_um2: area that belongs to one pillar.
        x_um: shape (n_x,), block centres.
        y_um: shape (n_y,).
        sums: shape (3, n_y, n_x), over the block, of amplitude times exp(i k path), and of the same times x and
            times y from the block's centre (um).
        power: shape (n_y, n_x), sum over the block of the squared amplitude.
    """

    carrier: Carrier
    wavenumber: float
    pitch_um: tuple[float, float]
    cell_um2: float
    x_um: FloatArray
    y_um: FloatArray
    sums: ComplexArray
    power: FloatArray

    @property
    def block_um(self) -> tuple[float, float]:
        """(x, y) sides of a block."""
        block = self.carrier.block_sites
        return block * self.pitch_um[0], block * self.pitch_um[1]

    def halved(self) -> Pupil:
        """Half as many blocks a side, each the sum of four."""
        step_x, step_y = self.block_um
        # A quarter lies half a fine step beside the centre of the four: low for even, high for odd rows.
        aside_x = 0.5 * step_x * (2.0 * (np.arange(self.x_um.size) % 2) - 1.0)
        aside_y = 0.5 * step_y * (2.0 * (np.arange(self.y_um.size) % 2) - 1.0)
        sums = _sum_of_four(self.sums[0])
        moment_x = _sum_of_four(self.sums[1] + aside_x[None, :] * self.sums[0])
        moment_y = _sum_of_four(self.sums[2] + aside_y[:, None] * self.sums[0])
        return Pupil(
            Carrier(self.carrier.polarisation, self.carrier.ray, 2 * self.carrier.block_sites),
            self.wavenumber,
            self.pitch_um,
            self.cell_um2,
            self.x_um[::2] + 0.5 * step_x,
            self.y_um[::2] + 0.5 * step_y,
            np.array([sums, moment_x, moment_y]),
            _sum_of_four(self.power),
        )

    def transmitted(self, ray: Ray) -> float:
        """Integral of the transmitted flux over the lens for the object of ``ray``, um^2."""
        flux = ray.incident_amplitude(self.x_um[None, :], self.y_um[:, None]) ** 2
        return float(np.sum(flux * self.power)) * self.cell_um2


def _sum_of_four(values: Any) -> Any:
    n_y, n_x = values.shape
    padded = np.zeros((n_y + n_y % 2, n_x + n_x % 2), dtype=values.dtype)
    padded[:n_y, :n_x] = values
    return (padded[0::2, 0::2] + padded[1::2, 0::2]) + (padded[0::2, 1::2] + padded[1::2, 1::2])


def reduce_field(
    source: Source,
    carriers: Sequence[Carrier],
    wavenumber: float,
    *,
    workers: int | None = None,
    progress: Progress = silent,
) -> list[Pupil]:
    """Block sums behind each carrier, from one pass over the source's tiles.

    Memory beyond the source is that of the block sums: a tile is summed and forgotten.
    """
    x, y = source.lattice.x_um(), source.lattice.y_um()
    pupils = [_empty_pupil(carrier, wavenumber, source.lattice) for carrier in carriers]
    pending: list[Future[None]] = []
    # Carriers in parallel, never tiles (which may share blocks); the source makes a tile while the last is summed.
    with ThreadPoolExecutor(default_workers() if workers is None else workers) as threads:
        for tile in source.tiles():
            for job in pending:
                job.result()
            pending = [threads.submit(_add_tile if HAS_NUMBA else add_tile_exactly, p, tile, x, y) for p in pupils]
            progress("pupil", min(tile.row * x.size + tile.column, x.size * y.size), x.size * y.size)
        for job in pending:
            job.result()
    progress("pupil", x.size * y.size, x.size * y.size)
    return pupils


def _empty_pupil(carrier: Carrier, wavenumber: float, lattice: Lattice) -> Pupil:
    block, unit_um = carrier.block_sites, lattice.database_unit_nm * 1e-3
    pitch_x, pitch_y = (period * unit_um for period in lattice.period_dbu)
    x_um, y_um = lattice.x_um(), lattice.y_um()
    n_x, n_y = (-(-axis.size // block) for axis in (x_um, y_um))
    centre_x = x_um[0] + pitch_x * (block * np.arange(n_x) + 0.5 * (block - 1))
    centre_y = y_um[0] + pitch_y * (block * np.arange(n_y) + 0.5 * (block - 1))
    sums, power = np.zeros((3, n_y, n_x), dtype=np.complex128), np.zeros((n_y, n_x))
    return Pupil(carrier, wavenumber, (pitch_x, pitch_y), lattice.cell_um2, centre_x, centre_y, sums, power)


def _add_tile(pupil: Pupil, tile: FieldTile, x_um: FloatArray, y_um: FloatArray) -> None:
    ray, block = pupil.carrier.ray, pupil.carrier.block_sites
    size_index, table = tile.indexed(pupil.carrier.polarisation)
    _sum_blocks(
        pupil.sums, pupil.power, size_index, table.real.copy(), table.imag.copy(), tile.row, tile.column,
        block, pupil.x_um, pupil.y_um, *pupil.pitch_um, pupil.wavenumber,
        ray.vergence_per_um, *ray.tangent, *ray.target_um,
    )  # fmt: skip


def add_tile_exactly(pupil: Pupil, tile: FieldTile, x_um: FloatArray, y_um: FloatArray) -> None:
    """Add a tile with the carrier's path evaluated at every site: plain NumPy, and what the kernel is tested on."""
    amplitude = tile.amplitude(pupil.carrier.polarisation)
    n_y, n_x = amplitude.shape
    rows = np.arange(tile.row, tile.row + n_y) // pupil.carrier.block_sites
    columns = np.arange(tile.column, tile.column + n_x) // pupil.carrier.block_sites
    tile_x, tile_y = x_um[None, tile.column : tile.column + n_x], y_um[tile.row : tile.row + n_y, None]
    phase_rad = pupil.wavenumber * pupil.carrier.ray.path_um(tile_x, tile_y)
    light = amplitude * np.exp(1j * phase_rad)
    target = np.ix_(np.unique(rows), np.unique(columns))
    pupil.sums[0][target] += _block_sums(light, rows, columns)
    pupil.sums[1][target] += _block_sums(light * (tile_x - pupil.x_um[columns]), rows, columns)
    pupil.sums[2][target] += _block_sums(light * (tile_y - pupil.y_um[rows, None]), rows, columns)
    pupil.power[target] += _block_sums(np.abs(amplitude) ** 2, rows, columns)


def _block_sums(values: Any, rows: np.ndarray, columns: np.ndarray) -> Any:
    first_row = np.flatnonzero(np.diff(rows, prepend=-1))
    first_column = np.flatnonzero(np.diff(columns, prepend=-1))
    return np.add.reduceat(np.add.reduceat(values, first_row, axis=0), first_column, axis=1)


@compiled
def _sum_blocks(
    sums: ComplexArray, power: FloatArray, size_index: NDArray[np.unsignedinteger], real: FloatArray, imag: FloatArray,
    row: int, column: int, block: int, centre_x: FloatArray, centre_y: FloatArray, pitch_x: float, pitch_y: float,
    wavenumber: float, w: float, t_x: float, t_y: float, c_x: float, c_y: float, c_z: float,
) -> None:  # fmt: skip
    """Add a tile; inside a block the path is its value, slopes and curvatures at the centre.

    The mixed curvature is followed to first order; what is left, :func:`unfollowed_phase_rad` says, which callers
    keep small by the block size. Columns are summed first, so that the innermost loops have no carried sums.
    """
    n_y, n_x = size_index.shape
    middle = 0.5 * (block - 1)
    site_re, site_im = np.empty(block), np.empty(block)
    sum_re, sum_im, moment_re, moment_im, squares = (
        np.empty(block), np.empty(block), np.empty(block), np.empty(block), np.empty(block)
    )  # fmt: skip
    for block_row in range(row // block, (row + n_y - 1) // block + 1):
        top, bottom = max(row, block_row * block), min(row + n_y, (block_row + 1) * block)
        for block_column in range(column // block, (column + n_x - 1) // block + 1):
            left, right = max(column, block_column * block), min(column + n_x, (block_column + 1) * block)
            x, y = centre_x[block_column], centre_y[block_row]
            here = path_um(x, y, w, t_x, t_y, c_x, c_y, c_z)
            north = path_um(x, y + pitch_y, w, t_x, t_y, c_x, c_y, c_z)
            south = path_um(x, y - pitch_y, w, t_x, t_y, c_x, c_y, c_z)
            slope_y, bend_y = 0.5 * wavenumber * (north - south), 0.5 * wavenumber * (north - 2.0 * here + south)
            sum_re[:], sum_im[:], moment_re[:], moment_im[:], squares[:] = 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(top, bottom):
                step = i - block_row * block - middle
                phase = wavenumber * here + step * (slope_y + step * bend_y)
                cosine, sine = math.cos(phase), math.sin(phase)
                indices = size_index[i - row, left - column : right - column]
                for j in range(right - left):
                    site_re[j], site_im[j] = real[indices[j]], imag[indices[j]]
                for j in range(right - left):
                    re = site_re[j] * cosine - site_im[j] * sine
                    im = site_re[j] * sine + site_im[j] * cosine
                    sum_re[j] += re
                    sum_im[j] += im
                    moment_re[j] += step * re
                    moment_im[j] += step * im
                    squares[j] += re * re + im * im
            east = path_um(x + pitch_x, y, w, t_x, t_y, c_x, c_y, c_z)
            west = path_um(x - pitch_x, y, w, t_x, t_y, c_x, c_y, c_z)
            slope_x, bend_x = 0.5 * wavenumber * (east - west), 0.5 * wavenumber * (east - 2.0 * here + west)
            corner = path_um(x + pitch_x, y + pitch_y, w, t_x, t_y, c_x, c_y, c_z) + here - east - north
            # Of rows from the middle, the mean square.
            spread = (block * block - 1) / 12.0
            for j in range(right - left):
                step = left + j - block_column * block - middle
                phase = step * (slope_x + step * bend_x)
                wave = math.cos(phase) + 1j * math.sin(phase)
                total = wave * (sum_re[j] + 1j * sum_im[j])
                moment = wave * (moment_re[j] + 1j * moment_im[j])
                twist = 1j * wavenumber * corner * step
                followed = total + twist * moment
                sums[0, block_row, block_column] += followed
                sums[1, block_row, block_column] += followed * (step * pitch_x)
                sums[2, block_row, block_column] += (moment + twist * spread * total) * pitch_y
                power[block_row, block_column] += squares[j]


def unfollowed_phase_rad(source: Source, ray: Ray, wavenumber: float, block_sites: int) -> float:
    """Largest error of a block's phase in the compiled pass, at the corners of blocks about 9 x 9 points of the lens.

    It is the path beyond second order, and what the mixed curvature does beyond first order (its square over 2).
    """
    lattice = source.lattice
    pitch_x, pitch_y = (period * lattice.database_unit_nm * 1e-3 for period in lattice.period_dbu)
    x, y = np.meshgrid(*(np.linspace(axis[0], axis[-1], 9) for axis in (lattice.x_um(), lattice.y_um())))
    here, along_x, along_y = ray.path_um(x, y), ray.path_um(x + pitch_x, y), ray.path_um(x, y + pitch_y)
    back_x, back_y = ray.path_um(x - pitch_x, y), ray.path_um(x, y - pitch_y)
    mixed = ray.path_um(x + pitch_x, y + pitch_y) + here - along_x - along_y
    largest, half = 0.0, 0.5 * block_sites
    for a in (-half, half):
        for b in (-half, half):
            twist = wavenumber * a * b * mixed
            expanded = (
                here + 0.5 * a * (along_x - back_x) + 0.5 * a * a * (along_x - 2.0 * here + back_x)
                + 0.5 * b * (along_y - back_y) + 0.5 * b * b * (along_y - 2.0 * here + back_y) + a * b * mixed
            )  # fmt: skip
            beyond = wavenumber * (ray.path_um(x + a * pitch_x, y + b * pitch_y) - expanded)
            largest = max(largest, float(np.max(np.abs(beyond) + 0.5 * twist**2)))
    return largest
