"""Every few pixels of an image, without what finer structure would be mistaken for, and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled

#: Share of the margin over which an image fades out.
_FADE = 0.25


@dataclass(frozen=True)
class Reduction:
    """A window with margins at every few pixels: its transform holds the low frequencies alone.

    Attributes:
        every: step of the pixels that are kept; it divides the margin.
        window: (n_y, n_x) of the window, in pixels of the frame.
        edge: margin all around, in pixels of the frame.
    """

    every: int
    window: tuple[int, int]
    edge: int

    @property
    def shape(self) -> tuple[int, int]:
        """(n_y, n_x) of the reduced window without margin."""
        return -(-self.window[0] // self.every), -(-self.window[1] // self.every)

    @property
    def margin(self) -> int:
        """Margin all around, in reduced pixels."""
        return self.edge // self.every

    @property
    def size(self) -> tuple[int, int]:
        """(n_y, n_x) of the transform in reduced pixels, margins included: even, and fast."""
        rows, columns = (2 * scipy.fft.next_fast_len(-(-(n + 2 * self.margin) // 2), real=True) for n in self.shape)
        return rows, columns

    @property
    def inner(self) -> tuple[slice, slice]:
        """The window inside what has margins."""
        rows, columns = (slice(self.margin, self.margin + n) for n in self.shape)
        return rows, columns

    def of_part(self, rows: slice, columns: slice) -> tuple[slice, slice]:
        """The window's own pixels that a part of the reduced ones stands for."""
        in_rows, in_columns = (
            slice(at.start * self.every, min(at.stop * self.every, n))
            for at, n in zip((rows, columns), self.window, strict=True)
        )
        return in_rows, in_columns

    def within(self, rows: slice, columns: slice) -> Reduction:
        """A part of the window, with the same margin: slices of reduced pixels."""
        wide = self.of_part(rows, columns)
        return Reduction(self.every, (wide[0].stop - wide[0].start, wide[1].stop - wide[1].start), self.edge)

    @property
    def frequencies(self) -> tuple[FloatArray, FloatArray]:
        """Of the transform along y and x, cycles a pixel of the frame."""
        return scipy.fft.fftfreq(self.size[0]) / self.every, scipy.fft.rfftfreq(self.size[1]) / self.every

    @property
    def variance_left(self) -> float:
        """Variance of a reduced pixel per variance of white noise in the image."""
        return 1.0 / self.every**2

    def spectra(self, images: NDArray[np.float32]) -> NDArray[np.complex64]:
        """Transforms of images with margins (n, n_y, n_x), frame pixels: shape (n, size[0], size[1] // 2 + 1)."""
        count, rows, columns = images.shape
        level = images.mean(axis=(-2, -1), keepdims=True)
        place = np.zeros((count, rows, self.size[1] * self.every), dtype=np.float32)
        inside = place[:, :, :columns]
        np.subtract(images, level, out=inside)
        for along, fade in ((inside.swapaxes(1, 2), self._fades[0]), (inside, self._fades[1])):
            for part in (slice(None, self.edge), slice(-self.edge, None)):
                along[..., part] *= fade[part]
        half, low = self.size[0] // 2, self.size[1] // 2
        # Along y, the low frequencies of x alone are transformed.
        wide = scipy.fft.rfft(place, axis=-1, workers=2, overwrite_x=True)[..., : low + 1]
        full = scipy.fft.fft(wide, self.size[0] * self.every, axis=-2, workers=2)
        kept = np.concatenate([full[:, :half], full[:, -half:]], axis=1)
        kept *= np.float32(1.0 / self.every**2)
        kept[:, half] = 0.0
        kept[:, :, low] = 0.0
        kept[:, 0, 0] += level[:, 0, 0] * (self.size[0] * self.size[1])
        return np.asarray(kept)

    def images(self, spectra: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Reduced images with margins: shape (n, shape[0] + 2 margin, shape[1] + 2 margin)."""
        rows, columns = (n + 2 * self.margin for n in self.shape)
        return np.asarray(scipy.fft.irfft2(spectra, self.size, workers=2)[:, :rows, :columns])

    @cached_property
    def _fades(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """1 in the window, falling to 0 over the outer part of the margin, along y and x.

        A step where the window wraps round would agree with itself in both images and pull the depth.
        """
        y, x = (_fade(n, self.edge) for n in self.window)
        return y, x


def place_within(part: tuple[slice, slice], about: tuple[slice, slice]) -> tuple[slice, slice]:
    """A part of a picture, in the picture of what lies ``about`` it alone."""
    rows, columns = (slice(a.start - b.start, a.stop - b.start) for a, b in zip(part, about, strict=True))
    return rows, columns


def _fade(inner: int, edge: int) -> NDArray[np.float32]:
    """1 over ``inner`` pixels, falling to 0 over the outer part of ``edge`` more at each end."""
    place = np.arange(inner + 2 * edge)
    away = np.maximum(edge - place, place - (edge + inner - 1))
    share = np.clip((edge - away) / max(_FADE * edge, 1e-9), 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * share), dtype=np.float32)


def enlarged(values: NDArray[Any], every: int, shape: tuple[int, int]) -> NDArray[Any]:
    """Values at every ``every``-th pixel brought back to ``shape``, linear in between; beyond the last, its value."""
    if every == 1:
        return values[: shape[0], : shape[1]].copy()
    return (_enlarged if HAS_NUMBA else _enlarged_plain)(values, every, shape)


def _enlarged_plain(values: NDArray[Any], every: int, shape: tuple[int, int]) -> NDArray[Any]:
    for axis, count in enumerate(shape):
        before = np.moveaxis(values, axis, 0)
        after = np.concatenate([before[1:], before[-1:]])
        fine = np.empty((every * before.shape[0], *before.shape[1:]), dtype=values.dtype)
        for k in range(every):
            fine[k::every] = before if k == 0 else (1.0 - k / every) * before + (k / every) * after
        values = np.moveaxis(fine[:count], 0, axis)
    return values


@compiled
def _enlarged(values: NDArray[Any], every: int, shape: tuple[int, int]) -> NDArray[Any]:
    n_y, n_x = values.shape
    out = np.empty(shape, dtype=values.dtype)
    for i in range(shape[0]):
        above = i // every
        below, down = min(above + 1, n_y - 1), (i % every) / every
        line = np.empty(n_x + 1, dtype=values.dtype)
        for j in range(n_x):
            line[j] = (1.0 - down) * values[above, j] + down * values[below, j]
        line[n_x] = line[n_x - 1]
        for j in range(n_x):
            for k in range(min(every, shape[1] - every * j)):
                out[i, every * j + k] = (1.0 - k / every) * line[j] + (k / every) * line[j + 1]
    return out


def repeated(values: NDArray[Any], every: int, shape: tuple[int, int]) -> NDArray[Any]:
    """Values at every ``every``-th pixel brought back to ``shape``, each pixel that of its nearest neighbour."""
    if every == 1:
        return values[: shape[0], : shape[1]].copy()
    rows, columns = (
        np.minimum((np.arange(n) + every // 2) // every, m - 1) for n, m in zip(shape, values.shape, strict=True)
    )
    return taken(values, rows, columns)


def taken(values: NDArray[Any], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[Any]:
    """``values[np.ix_(rows, columns)]``, in less time."""
    return _taken(values, rows, columns) if HAS_NUMBA else np.asarray(values[np.ix_(rows, columns)])


@compiled
def _taken(values: NDArray[Any], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[Any]:
    out = np.empty((rows.size, columns.size), dtype=values.dtype)
    for i in range(rows.size):
        line, to = values[rows[i]], out[i]
        for j in range(columns.size):
            to[j] = line[columns[j]]
    return out
