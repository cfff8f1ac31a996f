"""The calibrated PSF pair on the grid of the x image, at any place and depth.

The y image is resampled on the x image's grid, so the y kernels are stretched by the same map.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, PPoly
from scipy.ndimage import map_coordinates, spline_filter1d
from scipy.sparse import csr_matrix

from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.numeric.interpolation import spline_weights
from metafab.decode.registration.tiles import Tiling
from metafab.decode.registration.twins import TwinGrid

#: Distances from a straight outline at which the light beyond it is tabulated, pixels.
_SPILL_PX = (8, 16, 24, 32)
#: Quantile of that light over field and depth: the pair is widest at the corners.
_SPILL_QUANTILE = 0.9


@dataclass(frozen=True)
class Calibration:
    """The pair's kernels on the grid of the x image."""

    kernels: PairKernels  #: The PSF calibration.
    grid: TwinGrid  #: The grid of both images.
    image_map: ImageMap  #: Map from directions to places on the sensor.

    def core_px(self, change: float) -> tuple[float, float]:
        """(n_y, n_x) of a tile over which the pair changes by ``change`` (relative L2) from the centre to the edge."""
        pixel_tangent = self.kernels.psf.pixel_um / self.kernels.psf.sensor_distance_um
        rate_y, rate_x = self._change_per_tangent
        return 2.0 * change / max(rate_y * pixel_tangent, 1e-12), 2.0 * change / max(rate_x * pixel_tangent, 1e-12)

    @cached_property
    def _change_per_tangent(self) -> tuple[float, float]:
        return _change_per_tangent(self.kernels)

    def tile_weights(self, tiling: Tiling, step: int = 1) -> NDArray[np.float32]:
        """Interpolation weights of the field points at each tile's centre: shape (n_tiles, n_field).

        Tiles are those of every ``step``-th pixel.
        """
        row, column = self.grid.margin + np.minimum(step * tiling.middles, np.array(self.grid.shape) - 1).T
        weights = self.kernels.field_weights(self.grid.tangent_x[row, column], self.grid.tangent_y[row, column])
        return weights.reshape(tiling.n_tiles, -1).astype(np.float32)

    def block_weights(self, shape: tuple[int, int], step: int, block: int) -> NDArray[np.float32]:
        """Interpolation weights of the field points at the centre of each block of ``block`` downsampled pixels a side.

        The downsampled window has ``shape``, (n_y, n_x), and one pixel for every ``step`` frame pixels.

        Returns:
            Shape (n_block_y, n_block_x, n_field).
        """
        row, column = (
            np.minimum(step * (np.arange(-(-n // block)) * block + 0.5 * (block - 1)), most - 1.0)
            for n, most in zip(shape, self.grid.shape, strict=True)
        )
        return self.place_weights(*np.meshgrid(row, column, indexing="ij"))

    def place_weights(self, row: FloatArray, column: FloatArray) -> NDArray[np.float32]:
        """Interpolation weights of the field points at places of the window, frame pixels: shape (n, m, n_field).

        ``row`` and ``column`` have the shape (n, m) and may lie within the margin.
        """
        grid = self.grid
        place = row + grid.margin, column + grid.margin
        tangents = (map_coordinates(axis, place, order=1, mode="nearest") for axis in (grid.tangent_x, grid.tangent_y))
        return self.kernels.field_weights(*tangents).reshape(*row.shape, -1).astype(np.float32)

    @cached_property
    def stack(self) -> NDArray[np.float32]:
        """Kernels at all calibrated points, those of y stretched: shape (2, n_depth, n_field, n_y, n_x)."""
        nodes, tangents = self.kernels.nodes.copy(), np.meshgrid(self.kernels.tangent_x, self.kernels.tangent_y)
        # d(place in the x image) and d(place in the y image) / d(tangent) at the field points.
        x, y = (self.image_map.jacobian_um(p, *tangents) for p in (0, 1))
        stretch = y @ np.linalg.inv(x)
        for j, i in np.argwhere(np.abs(stretch - np.eye(2)).max(axis=(-2, -1)) > 1e-6):
            nodes[1, :, j, i] = stretched(nodes[1, :, j, i], stretch[j, i])
        return nodes.reshape(*nodes.shape[:2], -1, *nodes.shape[-2:])

    @cached_property
    def spill(self) -> tuple[tuple[int, float], ...]:
        """Distances from a straight outline, pixels, and the share of a surface's light that falls beyond them."""
        middle_y, middle_x = (n // 2 for n in self.stack.shape[-2:])
        along_y, along_x = self.stack.sum(axis=-1, dtype=np.float64), self.stack.sum(axis=-2, dtype=np.float64)
        shares = []
        for px in _SPILL_PX:
            sides = [
                part.sum(axis=-1) / line.sum(axis=-1)
                for line, middle in ((along_y, middle_y), (along_x, middle_x))
                for part in (line[..., middle + px :], line[..., : max(0, middle - px + 1)])
            ]
            shares.append(float(np.quantile(np.max(sides, axis=0), _SPILL_QUANTILE)))
        return tuple(zip(_SPILL_PX, shares, strict=True))

    def depth_weights(self, vergence_per_m: float | FloatArray) -> NDArray[np.float32]:
        """Interpolation weights of the calibrated depths at a vergence, scalar or array: shape (..., n_depth)."""
        return spline_weights(1.0 / self.kernels.psf.depth_m, vergence_per_m).astype(np.float32)


def _change_per_tangent(kernels: PairKernels) -> tuple[float, float]:
    """Largest relative L2 change of the pair per unit tangent along y and x, at the middle depth."""
    middle = kernels.at_depth(float(np.median(kernels.psf.depth_m)))
    rates = []
    for axis, nodes in ((1, kernels.tangent_y), (2, kernels.tangent_x)):
        if nodes.size == 1:
            rates.append(0.0)
            continue
        span = float(nodes[-1] - nodes[0])
        places = np.linspace(nodes[0], nodes[-1], 33)
        step = 1e-3 * span
        low, high = (spline_weights(nodes, places + d) for d in (-step, step))
        change = np.linalg.norm(np.tensordot(high - low, middle, axes=(1, axis)).reshape(33, -1), axis=1)
        level = np.linalg.norm(np.tensordot(low, middle, axes=(1, axis)).reshape(33, -1), axis=1)
        rates.append(float(np.median(change / level)) / (2.0 * step))
    return rates[0], rates[1]


def stretched(kernels: NDArray[np.float32], stretch: FloatArray) -> NDArray[np.float32]:
    """Stretch kernels h(r) to h(J r) |J| by a quintic spline; zero outside of their window.

    Kernels have the shape (n, n_y, n_x) and their origin at [n_y // 2, n_x // 2]; J has the shape (2, 2) over (x, y).
    """
    n_y, n_x = kernels.shape[-2:]
    coefficients = spline_filter1d(kernels, order=5, axis=-1, mode="mirror", output=np.float32)
    coefficients = spline_filter1d(coefficients, order=5, axis=-2, mode="mirror", output=np.float32)
    y, x = np.mgrid[:n_y, :n_x]
    x, y = x - n_x // 2, y - n_y // 2
    place_x = stretch[0, 0] * x + stretch[0, 1] * y + n_x // 2
    place_y = stretch[1, 0] * x + stretch[1, 1] * y + n_y // 2
    inside = (place_x >= 0) & (place_x <= n_x - 1) & (place_y >= 0) & (place_y <= n_y - 1)
    first_x, first_y = np.floor(place_x).astype(int) - 2, np.floor(place_y).astype(int) - 2
    weight_x = quintic_weights(place_x - (first_x + 2)) * inside
    weight_y = quintic_weights(place_y - (first_y + 2))
    row = np.stack([_mirrored(first_y + j, n_y) for j in range(6)])
    column = np.stack([_mirrored(first_x + i, n_x) for i in range(6)])
    source = (row[:, None] * n_x + column[None, :]).reshape(36, -1)
    weight = (weight_y[:, None] * weight_x[None, :]).reshape(36, -1) * abs(np.linalg.det(stretch))
    starts = np.arange(0, 36 * n_y * n_x + 1, 36)
    matrix = csr_matrix((weight.T.ravel().astype(np.float32), source.T.ravel(), starts), shape=(n_y * n_x,) * 2)
    return np.asarray((matrix @ coefficients.reshape(-1, n_y * n_x).T).T.reshape(kernels.shape), dtype=np.float32)


#: Polynomial coefficients (highest power first) of the six pieces of the quintic B-spline.
_QUINTIC = PPoly.from_spline(BSpline.basis_element(np.arange(-3.0, 4.0)).tck).c[:, 5:11]


def quintic_weights(fraction: FloatArray) -> FloatArray:
    """Weights of the six spline coefficients about a place: shape (6, *fraction.shape).

    ``fraction``, of any shape, is the distance of the place from the third coefficient, 0 to 1 pixel.
    """
    return np.stack([np.polyval(_QUINTIC[:, 5 - i], fraction) for i in range(6)])


def _mirrored(index: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    return np.asarray((count - 1) - np.abs((count - 1) - np.abs(index)) % (2 * count))
