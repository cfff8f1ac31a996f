"""Sum the pillars of a lens in blocks, in one streaming pass: millions of pillars to some 10^5 block sums.

The exact (non-paraxial) path of a carrier ray is removed at every site, so that the light of all pillars in a block
reaches the image point with nearly the same phase. A block is stored as its sum and two first moments. Other object
points, depths and window points add a phase that is smooth across the block. The moments account for its slope, also in
blocks that the aperture cuts, so that the error is of second order in the block size. Phases are reduced in double
precision. Four blocks make one of twice the side, and the difference of the two sizes gives the error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.work import Work
from metafab.core.storage.scratch import release, scratch
from metafab.layout.pillars import Lattice
from metafab.library.use.oblique import powers
from metafab.optics.geometry.aperture import sub_apertures_um
from metafab.optics.geometry.imaging import Tangent
from metafab.optics.geometry.path import Ray, RayNumbers, path_um
from metafab.optics.sources.source import FieldTile, Source

#: Most blocks of a band, about 30 MB with the arrays computed from them.
_BAND_BLOCKS = 1 << 18
#: Largest array of block sums that is held in memory; a pair of polarisations has some six of this order.
_IN_MEMORY_BYTES = 1 << 26


@dataclass(frozen=True)
class Carrier:
    """Polarisation to sum, ray whose path is removed, and block size."""

    polarisation: int  #: Index of the polarisation in the field tiles.
    ray: Ray  #: Carrier ray, in air.
    block_sites: int  #: Sites along a side of a block.


@dataclass(frozen=True)
class Pupil:
    """Block sums of one polarisation behind a carrier."""

    carrier: Carrier  #: Polarisation, ray and block size.
    wavenumber: float  #: k, rad/um.
    pitch_um: tuple[float, float]  #: (x, y) distance of sites.
    cell_um2: float  #: Area of one unit cell.
    x_um: FloatArray  #: Shape (n_x,), block centres.
    y_um: FloatArray  #: Shape (n_y,), block centres.
    #: Shape (3, n_y, n_x), sum over the block of the amplitude times exp(i k path), and its first moments along x and y
    #: about the block centre, um.
    sums: ComplexArray
    power: FloatArray  #: Shape (n_y, n_x), sum over the block of the squared amplitude.
    tangent: Tangent = (0.0, 0.0)  #: Direction of the light under which the amplitudes are these.
    #: Pupils of the coefficients by which they change with the direction (:func:`metafab.library.use.oblique.powers`);
    #: none if they do not.
    changes: tuple[Pupil, ...] = ()

    def towards(self, tangent: Tangent) -> Pupil:
        """Return the sums under light from the direction ``tangent``; ``power`` stays that of the pupil's direction."""
        if not self.changes or tangent == self.tangent:
            return self
        weights = powers(tangent) - powers(self.tangent)
        sums = _zero_sums(*self.power.shape)[0]
        for rows, band in self.bands():
            sums[:, rows] = band.sums
            for weight, change in zip(weights.tolist(), self.changes, strict=True):
                sums[:, rows] += weight * change.sums[:, rows]
            release(sums)
        return replace(self, sums=sums, tangent=tangent, changes=())

    @property
    def block_um(self) -> tuple[float, float]:
        """(x, y) sides of a block."""
        block = self.carrier.block_sites
        return block * self.pitch_um[0], block * self.pitch_um[1]

    @property
    def spread_um2(self) -> tuple[float, float]:
        """Mean square of x and of y over a full block, about its centre."""
        block = self.carrier.block_sites
        along_x, along_y = (pitch * pitch * (block * block - 1) / 12.0 for pitch in self.pitch_um)
        return along_x, along_y

    @property
    def sub_apertures_um(self) -> FloatArray | None:
        """(x, y) of points that carry equal shares of the power, shape (n, 2); None for a dark pupil."""
        return sub_apertures_um(self.x_um, self.y_um, self.power) if self.power.any() else None

    def bands(self) -> Iterator[tuple[slice, Pupil]]:
        """Yield the pupil in bands of whole rows, an even number each but for the last, with their slice of the rows.

        A pupil of up to 2^18 blocks is one band. Sums that are in a file take the memory of one band.
        """
        n_y, n_x = self.power.shape
        count = max(1, min(-(-n_y * n_x // _BAND_BLOCKS), n_y // 2))
        edges = [*(2 * np.linspace(0, n_y // 2, count + 1).astype(int)[:-1]).tolist(), n_y]
        for top, bottom in pairwise(edges):
            rows = slice(top, bottom)
            sums = np.ascontiguousarray(self.sums[:, rows])
            yield rows, replace(self, y_um=self.y_um[rows], sums=sums, power=self.power[rows])
            self.release()

    def release(self) -> None:
        """Give back the memory of sums that are in a file."""
        release(self.sums)
        release(self.power)

    def coarsened(self) -> Pupil:
        """Return blocks of twice the side, each the sum of four."""
        step_x, step_y = self.block_um
        x_um, y_um = self.x_um[::2] + 0.5 * step_x, self.y_um[::2] + 0.5 * step_y
        sums, power = _zero_sums(y_um.size, x_um.size)
        coarse = replace(
            self,
            carrier=replace(self.carrier, block_sites=2 * self.carrier.block_sites),
            x_um=x_um,
            y_um=y_um,
            sums=sums,
            power=power,
        )
        # Each of the four lies half a fine step from their common centre: low for even, high for odd rows.
        offset_x = 0.5 * step_x * (2.0 * (np.arange(self.x_um.size) % 2) - 1.0)
        for rows, band in self.bands():
            offset_y = 0.5 * step_y * (2.0 * (np.arange(band.y_um.size) % 2) - 1.0)
            into = slice(rows.start // 2, -(-rows.stop // 2))
            coarse.sums[0, into] = _sum_of_four(band.sums[0])
            coarse.sums[1, into] = _sum_of_four(band.sums[1] + offset_x[None, :] * band.sums[0])
            coarse.sums[2, into] = _sum_of_four(band.sums[2] + offset_y[:, None] * band.sums[0])
            coarse.power[into] = _sum_of_four(band.power)
            coarse.release()
        return replace(coarse, changes=tuple(change.coarsened() for change in self.changes))

    def transmitted(self, ray: Ray) -> float:
        """Return the integral of the transmitted flux over the lens for the object of ``ray``, um^2."""
        total = 0.0
        for _, band in self.bands():
            flux = ray.incident_amplitude(band.x_um[None, :], band.y_um[:, None]) ** 2
            if ray.crystal is not None:
                flux = flux * np.abs(ray.jones_factor(band.x_um, band.y_um)) ** 2
            total += float(np.sum(flux * band.power))
        return total * self.cell_um2


def _zero_sums(n_y: int, n_x: int) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """``sums`` and ``power`` of a pupil without light; large ones are in a file."""
    sums = scratch((3, n_y, n_x), np.complex128, _IN_MEMORY_BYTES)
    return sums, scratch((n_y, n_x), np.float64, _IN_MEMORY_BYTES)


def _sum_of_four(values: Any) -> Any:
    n_y, n_x = values.shape
    padded = np.zeros((n_y + n_y % 2, n_x + n_x % 2), dtype=values.dtype)
    padded[:n_y, :n_x] = values
    return (padded[0::2, 0::2] + padded[1::2, 0::2]) + (padded[0::2, 1::2] + padded[1::2, 1::2])


def reduce_field(source: Source, carriers: Sequence[Carrier], wavenumber: float, work: Work = Work()) -> list[Pupil]:
    """Return the block sums behind each carrier (polarisation, ray, block size), from one pass over the source's tiles.

    Memory beyond the source is that of the block sums: a tile is summed and dropped. Sums above 64 MB are in an unnamed
    file of the temporary folder. ``wavenumber`` is k, rad/um.
    """
    x, y = source.lattice.x_um(), source.lattice.y_um()
    pupils = [_empty_pupil(carrier, wavenumber, source.lattice) for carrier in carriers]
    pending: list[Future[None]] = []
    row = -1
    # Carriers run in parallel, tiles do not, as they may share blocks. The source makes the next tile meanwhile.
    with ThreadPoolExecutor(default_workers() if work.workers is None else work.workers) as threads:
        for tile in source.tiles():
            for job in pending:
                job.result()
            if tile.row != row:  # the first tile of a row may be dark, and so be left out
                row = tile.row
                for pupil in pupils:
                    pupil.release()
            pending = [threads.submit(_add_tile, pupil, tile) for pupil in pupils]
            work.progress("pupil", min(tile.row * x.size + tile.column, x.size * y.size), x.size * y.size)
        for job in pending:
            job.result()
    work.progress("pupil", x.size * y.size, x.size * y.size)
    return pupils


def _empty_pupil(carrier: Carrier, wavenumber: float, lattice: Lattice) -> Pupil:
    block, unit_um = carrier.block_sites, lattice.database_unit_nm * 1e-3
    pitch_x, pitch_y = (period * unit_um for period in lattice.period_dbu)
    x_um, y_um = lattice.x_um(), lattice.y_um()
    n_x, n_y = (-(-axis.size // block) for axis in (x_um, y_um))
    centre_x = x_um[0] + pitch_x * (block * np.arange(n_x) + 0.5 * (block - 1))
    centre_y = y_um[0] + pitch_y * (block * np.arange(n_y) + 0.5 * (block - 1))
    empty = _zero_sums(n_y, n_x)
    return Pupil(carrier, wavenumber, (pitch_x, pitch_y), lattice.cell_um2, centre_x, centre_y, *empty)


def _add_tile(pupil: Pupil, tile: FieldTile) -> None:
    size_index, table = tile.indexed(pupil.carrier.polarisation)
    _sum_blocks(
        pupil.sums,
        pupil.power,
        np.ascontiguousarray(size_index),  # one layout in memory, so that one form is compiled
        table.real.copy(),
        table.imag.copy(),
        (tile.row, tile.column),
        pupil.carrier.block_sites,
        pupil.x_um,
        pupil.y_um,
        pupil.pitch_um,
        pupil.wavenumber,
        pupil.carrier.ray.numbers,
    )


@compiled
def _sum_blocks(
    sums: ComplexArray,
    power: FloatArray,
    size_index: NDArray[np.unsignedinteger],
    real: FloatArray,
    imag: FloatArray,
    first: tuple[int, int],
    block: int,
    centre_x: FloatArray,
    centre_y: FloatArray,
    pitch_um: tuple[float, float],
    wavenumber: float,
    ray: RayNumbers,
) -> None:
    """Add a tile whose first site is (row, column) = ``first`` to the block sums.

    Inside a block the path is expanded about the centre: value, slopes, curvatures, and the mixed curvature to first
    order. :func:`expansion_error_rad` bounds the rest. Columns are summed first, so that the innermost loops carry no
    sums from one iteration to the next.
    """
    row, column = first
    pitch_x, pitch_y = pitch_um
    n_y, n_x = size_index.shape
    middle = 0.5 * (block - 1)
    site_re, site_im = np.empty(block), np.empty(block)
    sum_re, sum_im = np.empty(block), np.empty(block)
    moment_re, moment_im, squares = np.empty(block), np.empty(block), np.empty(block)
    for block_row in range(row // block, (row + n_y - 1) // block + 1):
        top, bottom = max(row, block_row * block), min(row + n_y, (block_row + 1) * block)
        for block_column in range(column // block, (column + n_x - 1) // block + 1):
            left, right = max(column, block_column * block), min(column + n_x, (block_column + 1) * block)
            x, y = centre_x[block_column], centre_y[block_row]
            here = path_um(x, y, ray)
            north = path_um(x, y + pitch_y, ray)
            south = path_um(x, y - pitch_y, ray)
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
            east = path_um(x + pitch_x, y, ray)
            west = path_um(x - pitch_x, y, ray)
            slope_x, bend_x = 0.5 * wavenumber * (east - west), 0.5 * wavenumber * (east - 2.0 * here + west)
            corner = path_um(x + pitch_x, y + pitch_y, ray) + here - east - north
            # Mean square of the row index about the middle.
            spread = (block * block - 1) / 12.0
            for j in range(right - left):
                step = left + j - block_column * block - middle
                phase = step * (slope_x + step * bend_x)
                wave = math.cos(phase) + 1j * math.sin(phase)
                total = wave * (sum_re[j] + 1j * sum_im[j])
                moment = wave * (moment_re[j] + 1j * moment_im[j])
                twist = 1j * wavenumber * corner * step
                twisted = total + twist * moment
                sums[0, block_row, block_column] += twisted
                sums[1, block_row, block_column] += twisted * (step * pitch_x)
                sums[2, block_row, block_column] += (moment + twist * spread * total) * pitch_y
                power[block_row, block_column] += squares[j]


def expansion_error_rad(source: Source, ray: Ray, wavenumber: float, block_sites: int) -> float:
    """Return the largest phase error of the path expansion in :func:`reduce_field`, rad.

    It is the path beyond second order, plus half the square of the phase of the mixed curvature, at the corners of
    blocks about 9 x 9 points of the lens.
    """
    lattice = source.lattice
    pitch_x, pitch_y = (period * lattice.database_unit_nm * 1e-3 for period in lattice.period_dbu)
    x, y = np.meshgrid(*(np.linspace(axis[0], axis[-1], 9) for axis in (lattice.x_um(), lattice.y_um())))
    here = ray.path_um(x, y)
    east, west = ray.path_um(x + pitch_x, y), ray.path_um(x - pitch_x, y)
    north, south = ray.path_um(x, y + pitch_y), ray.path_um(x, y - pitch_y)
    mixed = ray.path_um(x + pitch_x, y + pitch_y) + here - east - north
    largest, half = 0.0, 0.5 * block_sites
    for a in (-half, half):
        for b in (-half, half):
            twist = wavenumber * a * b * mixed
            along_x = 0.5 * a * (east - west) + 0.5 * a * a * (east - 2.0 * here + west)
            along_y = 0.5 * b * (north - south) + 0.5 * b * b * (north - 2.0 * here + south)
            expanded = here + along_x + along_y + a * b * mixed
            beyond = wavenumber * (ray.path_um(x + a * pitch_x, y + b * pitch_y) - expanded)
            largest = max(largest, float(np.max(np.abs(beyond) + 0.5 * twist**2)))
    return largest
