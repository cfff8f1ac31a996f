"""A window cut into overlapping tiles for transforms, and put together again from their cores."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.decode.registration.downsampling import blocks_with, edge_taper

Value = TypeVar("Value", np.bool_, np.int32, np.float32)

#: Share of the margin over which a tile fades out.
_FADE_SHARE = 0.75


@dataclass(frozen=True)
class Tiling:
    """Tiles of equal size over a window with margin, numbered row by row."""

    shape: tuple[int, int]  #: (n_y, n_x) of the window without margin.
    margin: int  #: Pixels on all sides of its core that a tile holds.
    core: tuple[int, int]  #: (n_y, n_x) of the core, the part of the window that a tile stands for.
    size: tuple[int, int]  #: (n_y, n_x) of a tile's transform: core and margins, rounded up to a fast length.
    counts: tuple[int, int]  #: Tiles along y and x.

    @classmethod
    def over(cls, shape: tuple[int, int], margin: int, core_px: tuple[float, float]) -> Tiling:
        """Equal tiles whose cores have at most about ``core_px`` (rows, columns)."""
        counts = [max(1, math.ceil(n / px)) for n, px in zip(shape, core_px, strict=True)]
        core = tuple(math.ceil(n / count) for n, count in zip(shape, counts, strict=True))
        size = tuple(2 * scipy.fft.next_fast_len(math.ceil((n + 2 * margin) / 2), real=True) for n in core)
        return cls(shape, margin, (core[0], core[1]), (size[0], size[1]), (counts[0], counts[1]))

    @property
    def n_tiles(self) -> int:
        """Number of tiles."""
        return self.counts[0] * self.counts[1]

    @cached_property
    def middles(self) -> NDArray[np.intp]:
        """Row and column of each tile's centre, inside the window: shape (n_tiles, 2)."""
        rows, columns = (
            np.minimum(np.arange(count) * core + core // 2, n - 1)
            for count, core, n in zip(self.counts, self.core, self.shape, strict=True)
        )
        return np.stack([axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij")], axis=1)

    def cut(self, image: FloatArray, tiles: NDArray[np.intp]) -> Iterator[NDArray[np.float32]]:
        """Yield tiles of an image, each of shape ``size`` and faded out towards its edges.

        The image has the shape (n_y + 2 margin, n_x + 2 margin); beyond it, its edge value is taken. ``tiles``, shape
        (n,), are numbers of tiles.
        """
        need = [(n - 1) * core + size for n, core, size in zip(self.counts, self.core, self.size, strict=True)]
        extra = [(0, max(0, n - have)) for n, have in zip(need, image.shape, strict=True)]
        padded = np.pad(image, extra, mode="edge") if any(e[1] for e in extra) else image
        for tile in tiles.tolist():
            row, column = (index * core for index, core in zip(divmod(tile, self.counts[1]), self.core, strict=True))
            cut = np.array(padded[row : row + self.size[0], column : column + self.size[1]], dtype=np.float32)
            level = cut.mean()
            cut -= level
            cut *= self._taper
            cut += level
            yield cut

    def window(self, picture: NDArray[Value], tile: int) -> NDArray[Value]:
        """A tile's part of pictures (..., n_y + 2 margin, n_x + 2 margin), 0 beyond them: shape (..., *size)."""
        row, column = (index * core for index, core in zip(divmod(tile, self.counts[1]), self.core, strict=True))
        part = picture[..., row : row + self.size[0], column : column + self.size[1]]
        if part.shape[-2:] == self.size:
            return part
        extra = [(0, n - have) for n, have in zip(self.size, part.shape[-2:], strict=True)]
        return np.pad(part, [(0, 0)] * (picture.ndim - 2) + extra)

    @cached_property
    def _taper(self) -> NDArray[np.float32]:
        """1 in the core, falling to 0 over the outer part of the margin: shape ``size``."""
        y, x = (edge_taper(n, self.margin, _FADE_SHARE, m) for n, m in zip(self.core, self.size, strict=True))
        return np.asarray(y[:, None] * x[None, :], dtype=np.float32)

    def place(self, tile: int, first: int = 0, last: int | None = None) -> tuple[slice, slice]:
        """Slices of a tile's core, or of its rows from ``first`` to ``last``; they may reach beyond the window."""
        row, column = divmod(tile, self.counts[1])
        n_y, n_x = self.core
        top = row * n_y
        return slice(top + first, top + (n_y if last is None else last)), slice(column * n_x, (column + 1) * n_x)

    def labels_of_tiles(self, label: NDArray[np.int32], largest: int) -> list[tuple[int, int]]:
        """Pairs (tile, number) of all numbers from 1 to ``largest`` that occur in the cores of the tiles.

        Labels have the shape (n_y, n_x) and are numbers from 0.
        """
        occurs = _labels_in_cores(label, self.core, self.counts, largest)
        return [(tile, number + 1) for tile, number in np.argwhere(occurs[:, 1:]).tolist()]

    def cores(self, spectra: NDArray[np.complex64], first: int = 0, last: int | None = None) -> NDArray[np.float32]:
        """Cores of tiles from their spectra, or their rows from ``first`` to ``last``, shape (..., n_rows, core[1]).

        Args:
            spectra: shape (..., n_ky, n_kx); overwritten.
            first: first row of the core.
            last: end of its rows; all by default.
        """
        (n_y, n_x), m = self.core, self.margin
        # Rows that are not needed are not transformed back.
        needed = slice(m + first, m + (n_y if last is None else last))
        rows = scipy.fft.ifft(spectra, axis=-2, overwrite_x=True)[..., needed, :]
        return np.asarray(scipy.fft.irfft(rows, self.size[1])[..., m : m + n_x])

    def tiles_with(self, mask: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Numbers of the tiles whose cores hold a pixel of ``mask`` (n_y, n_x): shape (n,)."""
        return np.flatnonzero(blocks_with(mask, self.core, self.counts))

    def in_many(self, mask: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
        """Pixels of ``mask`` (n_y, n_x) in the cores that hold at least ``least`` of them: the same shape."""
        blocks = blocks_with(mask, self.core, self.counts, least)
        pixels = blocks.repeat(self.core[0], axis=0).repeat(self.core[1], axis=1)
        return np.asarray(mask & pixels[: mask.shape[0], : mask.shape[1]])


@compiled
def _labels_in_cores(
    label: NDArray[np.int32], core: tuple[int, int], counts: tuple[int, int], largest: int
) -> NDArray[np.bool_]:
    """Which numbers up to ``largest`` occur in each tile's core: shape (n_tiles, largest + 1)."""
    occurs = np.zeros((counts[0] * counts[1], largest + 1), dtype=np.bool_)
    for i in range(label.shape[0]):
        for column in range(counts[1]):
            in_tile = occurs[(i // core[0]) * counts[1] + column]
            last = -1
            for j in range(column * core[1], min((column + 1) * core[1], label.shape[1])):
                if label[i, j] != last:
                    last = label[i, j]
                    in_tile[last] = True
    return occurs
