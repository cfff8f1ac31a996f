"""A window cut into tiles with margins, and put together again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled

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
        counts: tiles along y and x.
    """

    shape: tuple[int, int]
    margin: int
    core: tuple[int, int]
    size: tuple[int, int]
    counts: tuple[int, int]

    @classmethod
    def over(cls, shape: tuple[int, int], margin: int, core_px: tuple[float, float]) -> Tiling:
        """Equal tiles of about ``core_px`` (rows, columns) at most."""
        counts = [max(1, math.ceil(n / px)) for n, px in zip(shape, core_px, strict=True)]
        core = tuple(math.ceil(n / count) for n, count in zip(shape, counts, strict=True))
        size = tuple(2 * scipy.fft.next_fast_len(math.ceil((n + 2 * margin) / 2), real=True) for n in core)
        return cls(shape, margin, (core[0], core[1]), (size[0], size[1]), (counts[0], counts[1]))

    @property
    def n_tiles(self) -> int:
        """How many there are; they are numbered row by row."""
        return self.counts[0] * self.counts[1]

    @cached_property
    def middles(self) -> NDArray[np.intp]:
        """Row and column of each tile's centre in the window, inside of it: shape (n_tiles, 2)."""
        rows, columns = (
            np.minimum(np.arange(count) * core + core // 2, n - 1)
            for count, core, n in zip(self.counts, self.core, self.shape, strict=True)
        )
        return np.stack([axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij")], axis=1)

    def cut(self, image: FloatArray, tiles: NDArray[np.intp]) -> Iterator[NDArray[np.float32]]:
        """One after the other, tiles with margins of an image with margin; beyond the image, its edge value."""
        need = [(n - 1) * core + size for n, core, size in zip(self.counts, self.core, self.size, strict=True)]
        extra = [(0, max(0, n - have)) for n, have in zip(need, image.shape, strict=True)]
        padded = np.pad(image, extra, mode="edge") if any(e[1] for e in extra) else image
        for tile in tiles.tolist():
            row, column = (index * core for index, core in zip(divmod(tile, self.counts[1]), self.core, strict=True))
            cut = np.array(padded[row : row + self.size[0], column : column + self.size[1]], dtype=np.float32)
            level = cut.mean()
            cut -= level
            cut *= self._fade
            cut += level
            yield cut

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

    def place(self, tile: int, first: int = 0, last: int | None = None) -> tuple[slice, slice]:
        """Some rows of a tile's core in the window, all by default; the last ones may reach beyond it."""
        row, column = divmod(tile, self.counts[1])
        n_y, n_x = self.core
        top = row * n_y
        return slice(top + first, top + (n_y if last is None else last)), slice(column * n_x, (column + 1) * n_x)

    def numbers(self, label: NDArray[np.int32], largest: int) -> list[tuple[int, int]]:
        """The tiles with each number from 1 to ``largest`` that ``label`` (the window's shape) has in their cores."""
        found = (_numbers if HAS_NUMBA else _numbers_plain)(label, self.core, self.counts, largest)
        return [(tile, number + 1) for tile, number in np.argwhere(found[:, 1:]).tolist()]

    def cores(self, spectra: NDArray[np.complex64], first: int = 0, last: int | None = None) -> NDArray[np.float32]:
        """What tiles of some spectra (..., n_ky, n_kx) deliver in some rows of their cores, all by default."""
        (n_y, n_x), m = self.core, self.margin
        # Rows that are not needed are not transformed back.
        rows = scipy.fft.ifft(spectra, axis=-2, overwrite_x=True)[
            ..., m + first : m + (n_y if last is None else last), :
        ]
        return np.asarray(scipy.fft.irfft(rows, self.size[1])[..., m : m + n_x])

    def touched(self, mask: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Numbers of the tiles whose cores hold a pixel of ``mask`` (the window's shape)."""
        (rows, columns), (n_y, n_x) = self.counts, self.core
        whole = np.zeros((rows * n_y, columns * n_x), dtype=bool)
        whole[: self.shape[0], : self.shape[1]] = mask
        return np.flatnonzero(whole.reshape(rows, n_y, columns, n_x).any(axis=(1, 3)))


def _numbers_plain(
    label: NDArray[np.int32], core: tuple[int, int], counts: tuple[int, int], largest: int
) -> NDArray[np.bool_]:
    found = np.zeros((counts[0] * counts[1], largest + 1), dtype=bool)
    row, column = (np.arange(n) // side for n, side in zip(label.shape, core, strict=True))
    found[row[:, None] * counts[1] + column, label] = True
    return found


@compiled
def _numbers(
    label: NDArray[np.int32], core: tuple[int, int], counts: tuple[int, int], largest: int
) -> NDArray[np.bool_]:
    """Which numbers up to ``largest`` occur in each tile's core: shape (n_tiles, largest + 1)."""
    found = np.zeros((counts[0] * counts[1], largest + 1), dtype=np.bool_)
    for i in range(label.shape[0]):
        for column in range(counts[1]):
            here = found[(i // core[0]) * counts[1] + column]
            last = -1
            for j in range(column * core[1], min((column + 1) * core[1], label.shape[1])):
                if label[i, j] != last:
                    last = label[i, j]
                    here[last] = True
    return found
