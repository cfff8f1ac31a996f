"""Downsampling of images with an anti-aliasing low-pass filter, and interpolation back to all pixels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread

#: Share of the margin over which an image fades out.
_FADE_SHARE = 0.25


@dataclass(frozen=True)
class Downsampling:
    """A window with margins at every ``step``-th pixel, computed from the low frequencies of its transform."""

    step: int  #: Distance of the pixels that are kept, in frame pixels; it divides ``frame_margin``.
    window: tuple[int, int]  #: (n_y, n_x) of the window, in frame pixels.
    frame_margin: int  #: Margin on all sides, in frame pixels.

    @property
    def shape(self) -> tuple[int, int]:
        """(n_y, n_x) of the downsampled window without margin."""
        return -(-self.window[0] // self.step), -(-self.window[1] // self.step)

    @property
    def margin(self) -> int:
        """Margin on all sides, in downsampled pixels."""
        return self.frame_margin // self.step

    @property
    def size(self) -> tuple[int, int]:
        """(n_y, n_x) of the transform in downsampled pixels, margins included: even, and fast."""
        rows, columns = (2 * scipy.fft.next_fast_len(-(-(n + 2 * self.margin) // 2), real=True) for n in self.shape)
        return rows, columns

    @property
    def inner(self) -> tuple[slice, slice]:
        """The window inside an array with margins."""
        rows, columns = (slice(self.margin, self.margin + n) for n in self.shape)
        return rows, columns

    def frame_slices(self, rows: slice, columns: slice) -> tuple[slice, slice]:
        """Slices of frame pixels that correspond to slices of downsampled pixels, cut at the end of the window."""
        frame_rows, frame_columns = (
            slice(at.start * self.step, min(at.stop * self.step, n))
            for at, n in zip((rows, columns), self.window, strict=True)
        )
        return frame_rows, frame_columns

    def within(self, rows: slice, columns: slice) -> Downsampling:
        """A part of the window (slices of downsampled pixels), with the same margin."""
        wide = self.frame_slices(rows, columns)
        return Downsampling(self.step, (wide[0].stop - wide[0].start, wide[1].stop - wide[1].start), self.frame_margin)

    @property
    def frequencies(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies of the transform along y and x, shapes (n_ky,) and (n_kx,), cycles a frame pixel."""
        return scipy.fft.fftfreq(self.size[0]) / self.step, scipy.fft.rfftfreq(self.size[1]) / self.step

    @property
    def variance_gain(self) -> float:
        """Variance of a downsampled pixel per variance of white noise in the image."""
        return 1.0 / self.step**2

    def spectra(self, images: NDArray[np.float32]) -> NDArray[np.complex64]:
        """Transforms of downsampled images with margins, shape (n, size[0], size[1] // 2 + 1): low frequencies.

        Images have the shape (n, n_y, n_x), frame pixels.
        """
        count, rows, columns = images.shape
        level = images.mean(axis=(-2, -1), keepdims=True)
        padded = np.zeros((count, rows, self.size[1] * self.step), dtype=np.float32)
        inside = padded[:, :, :columns]
        np.subtract(images, level, out=inside)
        for lines, taper in ((inside.swapaxes(1, 2), self._tapers[0]), (inside, self._tapers[1])):
            for part in (slice(None, self.frame_margin), slice(-self.frame_margin, None)):
                lines[..., part] *= taper[part]
        half, low = self.size[0] // 2, self.size[1] // 2
        # Along y, only the low frequencies of x are transformed.
        wide = scipy.fft.rfft(padded, axis=-1, workers=2, overwrite_x=True)[..., : low + 1]
        full = scipy.fft.fft(wide, self.size[0] * self.step, axis=-2, workers=2)
        kept = np.concatenate([full[:, :half], full[:, -half:]], axis=1)
        kept *= np.float32(1.0 / self.step**2)
        kept[:, half] = 0.0
        kept[:, :, low] = 0.0
        kept[:, 0, 0] += level[:, 0, 0] * (self.size[0] * self.size[1])
        return np.asarray(kept)

    def images(self, spectra: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Downsampled images of spectra (n, n_ky, n_kx): shape (n, shape[0] + 2 margin, shape[1] + 2 margin)."""
        rows, columns = (n + 2 * self.margin for n in self.shape)
        return np.asarray(scipy.fft.irfft2(spectra, self.size, workers=2)[:, :rows, :columns])

    @cached_property
    def _tapers(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        y, x = (edge_taper(n, self.frame_margin, _FADE_SHARE).astype(np.float32) for n in self.window)
        return y, x


def edge_taper(inner: int, margin: int, fade_share: float, size: int | None = None) -> FloatArray:
    """A cosine taper: 1 over the inner pixels, falling to 0 over the outer part of the margins on both sides.

    A step where a transform wraps round would be common to both images and bias the depth. ``fade_share`` is the share
    of the margin over which the taper falls. The result has the shape (size,), by default inner pixels and margins.
    """
    place = np.arange(inner + 2 * margin if size is None else size)
    outside = np.maximum(margin - place, place - (margin + inner - 1))
    share = np.clip((margin - outside) / max(fade_share * margin, 1e-9), 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * share))


def relative_slices(part: tuple[slice, slice], surroundings: tuple[slice, slice]) -> tuple[slice, slice]:
    """Return the slices of ``part`` relative to those of ``surroundings``."""
    rows, columns = (slice(a.start - b.start, a.stop - b.start) for a, b in zip(part, surroundings, strict=True))
    return rows, columns


def blocks_with(
    mask: NDArray[np.bool_], block: tuple[int, int], counts: tuple[int, int], least: int = 1
) -> NDArray[np.bool_]:
    """Whether each block of pixels holds at least ``least`` pixels of a mask of shape (n_y, n_x): shape ``counts``.

    ``block`` is (rows, columns) of a block, ``counts`` (rows, columns) of blocks; together they hold the mask.
    """
    whole = np.zeros((counts[0] * block[0], counts[1] * block[1]), dtype=bool)
    whole[: mask.shape[0], : mask.shape[1]] = mask
    blocks = whole.reshape(counts[0], block[0], counts[1], block[1])
    return np.asarray(blocks.any(axis=(1, 3)) if least == 1 else np.count_nonzero(blocks, axis=(1, 3)) >= least)


def enlarged(values: NDArray[Any], step: int, shape: tuple[int, int]) -> NDArray[Any]:
    """Interpolate values at every ``step``-th pixel linearly to all pixels; beyond the last, its value.

    Values have the shape (m_y, m_x), the result ``shape``, (n_y, n_x).
    """
    if step == 1:
        return values[: shape[0], : shape[1]].copy()
    out = np.empty(shape, dtype=values.dtype)
    spread(_enlarged, shape[0], values, step, out)
    return out


@compiled
def _enlarged(first: int, stop: int, values: NDArray[Any], step: int, out: NDArray[Any]) -> None:
    n_y, n_x = values.shape
    line = np.empty(n_x + 1, dtype=values.dtype)
    for i in range(first, stop):
        above = i // step
        below, down = min(above + 1, n_y - 1), (i % step) / step
        for j in range(n_x):
            line[j] = (1.0 - down) * values[above, j] + down * values[below, j]
        line[n_x] = line[n_x - 1]
        for j in range(n_x):
            for k in range(min(step, out.shape[1] - step * j)):
                out[i, step * j + k] = (1.0 - k / step) * line[j] + (k / step) * line[j + 1]


def repeated(values: NDArray[Any], step: int, shape: tuple[int, int]) -> NDArray[Any]:
    """Values at every ``step``-th pixel (m_y, m_x) brought to all pixels of ``shape`` by nearest neighbour."""
    if step == 1:
        return values[: shape[0], : shape[1]].copy()
    rows, columns = (
        np.minimum((np.arange(n) + step // 2) // step, m - 1) for n, m in zip(shape, values.shape, strict=True)
    )
    return outer_index(values, rows, columns)


def outer_index(values: NDArray[Any], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[Any]:
    """``values[np.ix_(rows, columns)]`` of an array of shape (n_y, n_x), faster: shape (rows.size, columns.size)."""
    # Bits, so that one form is compiled for all types of a size.
    bits = np.empty((rows.size, columns.size), dtype=f"u{values.itemsize}")
    spread(_outer_index, rows.size, values.view(bits.dtype), rows, columns, bits)
    return bits.view(values.dtype)


@compiled
def _outer_index(
    first: int,
    stop: int,
    values: NDArray[Any],
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    out: NDArray[Any],
) -> None:
    for i in range(first, stop):
        line, to = values[rows[i]], out[i]
        if i > first and rows[i] == rows[i - 1]:
            before = out[i - 1]
            for j in range(columns.size):
                to[j] = before[j]
            continue
        for j in range(columns.size):
            to[j] = line[columns[j]]
