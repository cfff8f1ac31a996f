"""Energy from beyond the nearest neighbours: by Fourier transforms, on tiles of sites and on a coarse grid.

Middle ranges act between sites. A pillar's mass m = dose x area spreads over its shape, to second order

    E(r) = sum over j, m_j [f + w_j^2 / 24 f_xx + l_j^2 / 24 f_yy](r - r_j),

where w and l are the sides of the rectangle of its second moments. The mean energy of its edges, at +-w/2 from the
site, is E + w^2 / 8 E_xx with the drawn width. Kernels are sampled at sites without the block of
:mod:`metafab.exposure.energy.near`, so that nothing is aliased. Long ranges act between blocks of sites, whose mass is
spread over the block; the smooth result is interpolated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.special import erf

from metafab.core.conventions import Float32Array, FloatArray
from metafab.exposure.electrons.beam import BeamPsf

#: Ranges after which a Gaussian is cut off: exp(-3.6^2) = 2e-6.
REACH = 3.6
#: Shortest range of the coarse grid, in periods.
LONG_PERIODS = 18.0
#: Sites a side of a block of the coarse grid: two ninths of the shortest range on that grid.
BLOCK_SITES = 4


@dataclass(frozen=True)
class MiddleRange:
    """Convolution between sites on tiles with a margin."""

    margin: int  #: Sites on each side that a tile's energy depends on.
    size: int  #: Sites a side of the transform.
    kernels: Float32Array  #: Shape (3, size, size // 2 + 1), transforms of f, f_xx and f_yy; real.

    @classmethod
    def of(
        cls, psf: BeamPsf, period_nm: tuple[float, float], tile_sites: int, near: tuple[int, int]
    ) -> MiddleRange | None:
        """Kernels for tiles of at most ``tile_sites`` sites a side; None without Gaussians.

        Sites within the reach ``near`` of (rows, columns) are left out.
        """
        if psf.range_nm.size == 0:
            return None
        margin = max(*near, math.ceil(REACH * float(psf.range_nm.max()) / min(period_nm)))
        size = int(scipy.fft.next_fast_len(tile_sites + 2 * margin, real=True))
        place = np.arange(-margin, margin + 1)
        x, y = place * period_nm[0], place[:, None] * period_nm[1]
        density, second_x, second_y = (np.zeros((place.size, place.size)) for _ in range(3))
        for weight, beta in zip(psf.weight, psf.range_nm, strict=True):
            gauss = weight / (math.pi * beta**2) * np.exp(-(x**2 + y**2) / beta**2)
            density += gauss
            second_x += gauss * (4.0 * x**2 / beta**4 - 2.0 / beta**2)
            second_y += gauss * (4.0 * y**2 / beta**4 - 2.0 / beta**2)
        transforms = []
        for kernel in (density, second_x, second_y):
            kernel[tuple(slice(margin - reach, margin + reach + 1) for reach in near)] = 0.0
            padded = np.zeros((size, size))
            padded[: place.size, : place.size] = kernel
            transforms.append(scipy.fft.rfft2(np.roll(padded, (-margin, -margin), axis=(0, 1))).real)
        return cls(margin, size, np.asarray(transforms, dtype=np.float32))

    def energy(
        self, mass: Float32Array, spread_x: Float32Array, spread_y: Float32Array, edge: Float32Array
    ) -> Float32Array:
        """Energy of a tile's pillars at the centre and at the x and the y edges (means): shape (3, n_y, n_x).

        Mass (dose times area, nm^2; 0 where no pillar stands), and mass times w^2 / 24 and l^2 / 24, have the shape
        (n_y + 2 margin, n_x + 2 margin); ``edge``, shape (2, n_y, n_x), is an eighth of the squared width and length.
        """
        shape, m = (self.size, self.size), self.margin
        n_y, n_x = mass.shape[0] - 2 * m, mass.shape[1] - 2 * m
        plain, wide, long = (scipy.fft.rfft2(values, shape) for values in (mass, spread_x, spread_y))
        f, f_xx, f_yy = self.kernels
        inner = (slice(m, m + n_y), slice(m, m + n_x))
        total = scipy.fft.irfft2(f * plain + f_xx * wide + f_yy * long, shape)[inner]
        curved_x = scipy.fft.irfft2(f_xx * plain, shape)[inner]
        curved_y = scipy.fft.irfft2(f_yy * plain, shape)[inner]
        return np.stack([total, total + edge[0] * curved_x, total + edge[1] * curved_y])


@dataclass(frozen=True)
class LongRange:
    """Energy of the long ranges on blocks of the whole lens."""

    energy: FloatArray  #: Shape (blocks_y, blocks_x), at block centres.

    @classmethod
    def of(cls, psf: BeamPsf, block_mass: FloatArray, period_nm: tuple[float, float]) -> LongRange | None:
        """Convolve masses of blocks (dose times area, nm^2), shape (blocks_y, blocks_x), with the long Gaussians.

        A block has :data:`BLOCK_SITES` sites of the lattice period a side.
        """
        if psf.range_nm.size == 0:
            return None
        steps = [BLOCK_SITES * side_nm for side_nm in period_nm[::-1]]
        reaches = [
            min(count, math.ceil(REACH * float(psf.range_nm.max()) / step) + 1)
            for step, count in zip(steps, block_mass.shape, strict=True)
        ]
        y_size, x_size = (
            int(scipy.fft.next_fast_len(count + reach, real=True))
            for count, reach in zip(block_mass.shape, reaches, strict=True)
        )
        kernel = np.zeros((y_size, x_size // 2 + 1))
        for weight, beta in zip(psf.weight, psf.range_nm, strict=True):
            along_y, along_x = (
                _transformed(_blurred_block(beta, step, reach), size)
                for step, reach, size in zip(steps, reaches, (y_size, x_size), strict=True)
            )
            kernel += weight * along_y[:, None] * along_x[: x_size // 2 + 1]
        spectrum = scipy.fft.rfft2(block_mass, (y_size, x_size))
        spectrum *= kernel
        return cls(scipy.fft.irfft2(spectrum, (y_size, x_size))[: block_mass.shape[0], : block_mass.shape[1]])

    def at(self, rows: slice, columns: slice) -> Float32Array:
        """Energy at the sites of a tile, by cubic interpolation: shape (n_y, n_x)."""
        along_y, first_y = _cubic_weights(rows, self.energy.shape[0])
        along_x, first_x = _cubic_weights(columns, self.energy.shape[1])
        part = self.energy[first_y : first_y + along_y.shape[1], first_x : first_x + along_x.shape[1]]
        return np.asarray(along_y @ part @ along_x.T, dtype=np.float32)


def block_masses(mass: FloatArray) -> FloatArray:
    """Sums of masses over blocks of :data:`BLOCK_SITES` sites a side: shape (ceil(n_y / B), ceil(n_x / B))."""
    n_y, n_x = (-(-n // BLOCK_SITES) * BLOCK_SITES for n in mass.shape)
    padded = np.zeros((n_y, n_x), dtype=mass.dtype)
    padded[: mass.shape[0], : mass.shape[1]] = mass
    blocks = padded.reshape(n_y // BLOCK_SITES, BLOCK_SITES, n_x // BLOCK_SITES, BLOCK_SITES)
    return np.asarray(blocks.sum(axis=(1, 3), dtype=np.float64))


def _blurred_block(beta: float, side: float, reach: int) -> FloatArray:
    """Density of a Gaussian along one axis, averaged over a source block, at distances 0, 1, ... blocks: (reach,)."""
    distance = np.arange(reach) * side
    return np.asarray((erf((distance + 0.5 * side) / beta) - erf((distance - 0.5 * side) / beta)) / (2.0 * side))


def _transformed(half: FloatArray, size: int) -> FloatArray:
    """Fourier transform of a symmetric kernel given by its half: real, shape (size,)."""
    kernel = np.zeros(size)
    kernel[: half.size] = half
    kernel[size - half.size + 1 :] = half[:0:-1]
    return np.asarray(scipy.fft.fft(kernel).real)


def _cubic_weights(sites: slice, blocks: int) -> tuple[FloatArray, int]:
    """Lagrange weights of four block centres for each site, and the first block that they refer to."""
    place = (np.arange(sites.start, sites.stop) + 0.5) / BLOCK_SITES - 0.5
    points = min(4, blocks)
    start = np.clip(np.floor(place).astype(int) - (points - 1) // 2, 0, blocks - points)
    first = int(start.min())
    weights = np.zeros((place.size, int(start.max()) - first + points))
    for k in range(points):
        factor = np.ones(place.size)
        for other in range(points):
            if other != k:
                factor *= (place - start - other) / (k - other)
        weights[np.arange(place.size), start - first + k] = factor
    return weights, first
