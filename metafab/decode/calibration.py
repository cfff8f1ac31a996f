"""The PSF pair as the decoder uses it: transfer functions of each tile of the x grid, at any depth.

The image is cut into tiles, small enough for one pair each; each tile brings a margin, so that what its filters
mix in from outside is real light. The y image has been brought onto the x image's grid, so its kernels are
stretched by the same map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import spline_filter1d
from scipy.sparse import csr_matrix

from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.decode.twins import TwinGrid
from metafab.optics.field import spline_weights

Transfer = NDArray[np.complex64]
#: How much of itself (relative L2) the pair may change from the centre of a tile to its edge. What x and y change
#: in opposite senses cancels in their comparison, so this is far from the depth error that it leaves.
_TILE_CHANGE = 0.1
_TILE_CORES = (32, 256)
#: Share of the margin over which a tile fades out.
_FADE = 0.75


@dataclass(frozen=True)
class Tiling:
    """Tiles over a window with margin.

    Attributes:
        shape: (n_y, n_x) of the window without margin.
        margin: pixels all around that tiles may reach into.
        core: (n_y, n_x) of what each tile delivers.
        size: (n_y, n_x) of a tile's transform: core and margins, rounded up to a fast length.
        starts: row and column of each tile's core in the window.
    """

    shape: tuple[int, int]
    margin: int
    core: tuple[int, int]
    size: tuple[int, int]
    starts: tuple[tuple[int, int], ...]

    @classmethod
    def over(cls, shape: tuple[int, int], margin: int, core_px: tuple[float, float]) -> Tiling:
        """Equal tiles of about ``core_px`` (rows, columns) at most."""
        counts = [max(1, math.ceil(n / px)) for n, px in zip(shape, core_px, strict=True)]
        core = tuple(2 * math.ceil(n / (2 * count)) for n, count in zip(shape, counts, strict=True))
        size = tuple(4 * scipy.fft.next_fast_len(math.ceil((n + 2 * margin) / 4), real=True) for n in core)
        starts = tuple((i * core[0], j * core[1]) for i in range(counts[0]) for j in range(counts[1]))
        return cls(shape, margin, (core[0], core[1]), (size[0], size[1]), starts)

    def cut(self, image: FloatArray) -> NDArray[np.float32]:
        """Tiles with margins of an image with margin: shape (n_tiles, *size); beyond the image, its edge value."""
        need = [max(start[axis] for start in self.starts) + self.size[axis] for axis in (0, 1)]
        extra = [(0, max(0, n - have)) for n, have in zip(need, image.shape, strict=True)]
        padded = np.pad(image, extra, mode="edge") if any(e[1] for e in extra) else image
        tiles = np.empty((len(self.starts), *self.size), dtype=np.float32)
        for tile, (row, column) in zip(tiles, self.starts, strict=True):
            cut = padded[row : row + self.size[0], column : column + self.size[1]]
            level = cut.mean()
            tile[:] = (cut - level) * self._fade + level
        return tiles

    @cached_property
    def _fade(self) -> NDArray[np.float32]:
        """1 in the core, falling to 0 over the outer part of the margin, shape ``size``.

        A step where a tile wraps round would agree with itself in both images and pull the depth.
        """
        fades = []
        for core, size in zip(self.core, self.size, strict=True):
            away = np.maximum(-np.arange(size) + self.margin, np.arange(size) - (self.margin + core - 1))
            share = np.clip((self.margin - away) / (_FADE * self.margin), 0.0, 1.0)
            fades.append(0.5 - 0.5 * np.cos(np.pi * share))
        return np.asarray(fades[0][:, None] * fades[1][None, :], dtype=np.float32)

    def halved(self) -> Tiling:
        """The same tiles at every second pixel; margins, cores and sizes are even for that."""
        (n_y, n_x), (core_y, core_x), (size_y, size_x) = self.shape, self.core, self.size
        starts = tuple((row // 2, column // 2) for row, column in self.starts)
        shape, core, size = ((n_y + 1) // 2, (n_x + 1) // 2), (core_y // 2, core_x // 2), (size_y // 2, size_x // 2)
        return Tiling(shape, self.margin // 2, core, size, starts)

    @property
    def counts(self) -> tuple[int, int]:
        """Tiles along y and x."""
        return self.starts[-1][0] // self.core[0] + 1, self.starts[-1][1] // self.core[1] + 1

    def core_of(self, tiles: NDArray[np.float32]) -> NDArray[np.float32]:
        """The cores of tiles: shape (n_tiles, *core)."""
        m = self.margin
        return tiles[:, m : m + self.core[0], m : m + self.core[1]]

    def join(self, tiles: NDArray[np.float32]) -> NDArray[np.float32]:
        """The window from the cores of its tiles."""
        (rows, columns), (n_y, n_x) = self.counts, self.core
        cores = self.core_of(tiles).reshape(rows, columns, n_y, n_x)
        return cores.transpose(0, 2, 1, 3).reshape(rows * n_y, columns * n_x)[: self.shape[0], : self.shape[1]]

    def cores(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """A mask of the window cut into cores: shape (n_tiles, *core)."""
        (rows, columns), (n_y, n_x) = self.counts, self.core
        whole = np.zeros((rows * n_y, columns * n_x), dtype=bool)
        whole[: self.shape[0], : self.shape[1]] = mask
        return whole.reshape(rows, n_y, columns, n_x).transpose(0, 2, 1, 3).reshape(-1, n_y, n_x)


@dataclass(frozen=True)
class Calibration:
    """Transfer functions of the pair on the tiles of one grid.

    Attributes:
        kernels: the PSF calibration.
        grid: the twin grid.
        image_map: directions to the sensor.
        tiling: the tiles.
    """

    kernels: PairKernels
    grid: TwinGrid
    image_map: ImageMap
    tiling: Tiling

    @classmethod
    def of(cls, kernels: PairKernels, grid: TwinGrid, image_map: ImageMap) -> Calibration:
        """Tiles where the pair varies over the field, one tile where it does not."""
        pixel_tangent = kernels.psf.pixel_um / kernels.psf.sensor_distance_um
        core = [2.0 * _TILE_CHANGE / max(rate * pixel_tangent, 1e-12) for rate in _change_per_tangent(kernels)]
        smallest, largest = _TILE_CORES
        cores = [math.inf if px > 16 * largest else min(max(px, smallest), largest) for px in core]
        return cls(kernels, grid, image_map, Tiling.over(grid.shape, grid.margin, (cores[0], cores[1])))

    @cached_property
    def _tile_weights(self) -> FloatArray:
        """Share of each field point in each tile's kernel: shape (n_tiles, n_field_y * n_field_x)."""
        m = self.grid.margin
        rows = [min(m + r + self.tiling.core[0] // 2, self.grid.tangent_x.shape[0] - 1) for r, _ in self.tiling.starts]
        columns = [
            min(m + c + self.tiling.core[1] // 2, self.grid.tangent_x.shape[1] - 1) for _, c in self.tiling.starts
        ]
        weights = self.kernels.field_weights(self.grid.tangent_x[rows, columns], self.grid.tangent_y[rows, columns])
        return weights.reshape(len(rows), -1)

    @cached_property
    def _stack(self) -> NDArray[np.float32]:
        """Kernels at all calibrated depths with y's stretched: (2, n_depth, n_field, n_y, n_x)."""
        nodes = self.kernels.nodes.copy()
        for j, tangent_y in enumerate(self.kernels.tangent_y):
            for i, tangent_x in enumerate(self.kernels.tangent_x):
                stretch = self._stretch(tangent_x, tangent_y)
                if np.abs(stretch - np.eye(2)).max() > 1e-6:
                    nodes[1, :, j, i] = _stretched(nodes[1, :, j, i], stretch)
        return nodes.reshape(*nodes.shape[:2], -1, *nodes.shape[-2:])

    def _stretch(self, tangent_x: float, tangent_y: float) -> FloatArray:
        """d(place in the y image) / d(place in the x image), shape (2, 2) over (x, y)."""
        x, y = (self.image_map.jacobian_um(p, np.array(tangent_x), np.array(tangent_y)) for p in (0, 1))
        return np.asarray(y @ np.linalg.inv(x))

    def _depth_weights(self, vergence_per_m: float) -> NDArray[np.float32]:
        return spline_weights(1.0 / self.kernels.psf.depth_m, vergence_per_m).astype(np.float32)

    def transfer(self, vergence_per_m: float) -> Transfer:
        """Transfer functions at a depth: shape (2, n_tiles, size_y, size_x // 2 + 1)."""
        return self._transformed(np.tensordot(self._depth_weights(vergence_per_m), self._stack, axes=(0, 1)))

    def _transformed(self, nodes: NDArray[np.float32]) -> Transfer:
        """Transforms of each tile's kernels from those of the field points, shape (2, n_field, n_y, n_x)."""
        n_y, n_x = self.kernels.shape
        weights = self._tile_weights.astype(np.float32)
        kernels = (weights @ nodes.reshape(2, nodes.shape[1], n_y * n_x)).reshape(2, -1, n_y, n_x)
        place = np.zeros((2, weights.shape[0], *self.tiling.size), dtype=np.float32)
        place[..., :n_y, :n_x] = kernels
        place = np.roll(place, (-(n_y // 2), -(n_x // 2)), axis=(-2, -1))
        return np.asarray(scipy.fft.rfft2(place), dtype=np.complex64)

    @cached_property
    def _low_band(self) -> Transfer:
        """Low halves of the transforms at all calibrated depths: (n_depth, 2, n_tiles, size_y / 2, size_x / 4 + 1)."""
        return np.stack([low_band(self._transformed(self._stack[:, d])) for d in range(self._stack.shape[1])])

    def low_band_transfer(self, vergence_per_m: float, tiles: NDArray[np.intp] | None = None) -> Transfer:
        """:meth:`transfer` up to a quarter cycle a pixel, of some tiles: shape (2, n_tiles, size_y / 2, ...)."""
        nodes = self._low_band if tiles is None else self._low_band[:, :, tiles]
        return np.asarray(np.tensordot(self._depth_weights(vergence_per_m), nodes, axes=(0, 0)))


def low_band(spectra: Transfer) -> Transfer:
    """The part of half-plane transforms below a quarter cycle a pixel: the transform of every second pixel."""
    n_y, n_kx = spectra.shape[-2:]
    columns = spectra[..., : (n_kx - 1) // 2 + 1]
    return np.concatenate([columns[..., : n_y // 4, :], columns[..., n_y - n_y // 4 :, :]], axis=-2)


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


def _stretched(kernels: NDArray[np.float32], stretch: FloatArray) -> NDArray[np.float32]:
    """h(J r) |J| for a stack of kernels (n, n_y, n_x), by a quintic spline; zero outside of the window."""
    n_y, n_x = kernels.shape[-2:]
    coefficients = spline_filter1d(kernels, order=5, axis=-1, mode="mirror", output=np.float32)
    coefficients = spline_filter1d(coefficients, order=5, axis=-2, mode="mirror", output=np.float32)
    y, x = np.mgrid[:n_y, :n_x]
    x, y = x - n_x // 2, y - n_y // 2
    place_x = stretch[0, 0] * x + stretch[0, 1] * y + n_x // 2
    place_y = stretch[1, 0] * x + stretch[1, 1] * y + n_y // 2
    inside = (place_x >= 0) & (place_x <= n_x - 1) & (place_y >= 0) & (place_y <= n_y - 1)
    first_x, first_y = np.floor(place_x).astype(int) - 2, np.floor(place_y).astype(int) - 2
    weight_x = np.stack([_QUINTIC(place_x - (first_x + i)) * inside for i in range(6)])
    weight_y = np.stack([_QUINTIC(place_y - (first_y + i)) for i in range(6)])
    row = np.stack([_mirrored(first_y + j, n_y) for j in range(6)])
    column = np.stack([_mirrored(first_x + i, n_x) for i in range(6)])
    source = (row[:, None] * n_x + column[None, :]).reshape(36, -1)
    weight = (weight_y[:, None] * weight_x[None, :]).reshape(36, -1) * abs(np.linalg.det(stretch))
    starts = np.arange(0, 36 * n_y * n_x + 1, 36)
    matrix = csr_matrix((weight.T.ravel().astype(np.float32), source.T.ravel(), starts), shape=(n_y * n_x,) * 2)
    return np.asarray((matrix @ coefficients.reshape(-1, n_y * n_x).T).T.reshape(kernels.shape), dtype=np.float32)


_QUINTIC = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)


def _mirrored(index: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    return np.asarray((count - 1) - np.abs((count - 1) - np.abs(index)) % (2 * count))
