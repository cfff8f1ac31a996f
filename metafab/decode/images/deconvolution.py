"""All-in-focus images: each segment's blur undone by a Wiener filter for its depth, where it is."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.core.parallel.executor import kept_threads
from metafab.decode.matching.levels import Levels
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.tiles import Tiling

#: How much of itself (relative L2) the pair may change from the centre of a tile to its edge.
_TILE_CHANGE = 0.2
_CORES_PX = (32.0, 256.0)
#: How far around a tile its light is looked at: 8 more would make its images better by 0.01 dB.
_MARGIN_PX = 28
#: Memory for transfer functions, the last used; a tilted scene has a hundred of its tiles' depths.
_KEPT_BYTES = 2**28
#: About as wide as a filter, whose noise is that of the light under it.
NOISE_WINDOW_PX = 9
#: Their depths are a grid of this many steps over the calibrated range: less than a degree of the pair's turn.
_DEPTH_STEPS = 96


@dataclass(frozen=True)
class LitTiles:
    """The transformed tiles of a frame.

    Attributes:
        place: shape (n_tiles,), where each tile of the tiling is among the spectra, if it is.
        spectra: shape (2, n, n_ky, n_kx).
    """

    place: NDArray[np.intp]
    spectra: NDArray[np.complex64]


@dataclass(frozen=True)
class Sharp:
    """All-in-focus images.

    Attributes:
        images: shape (2, n_y, n_x), electrons.
        noise_gain: the same shape, variance of a pixel per variance of the frame's pixels about it.
    """

    images: NDArray[np.float32]
    noise_gain: NDArray[np.float32]

    def within(self, rows: slice, columns: slice) -> Sharp:
        """A part of them."""
        return Sharp(self.images[:, rows, columns], self.noise_gain[:, rows, columns])


@dataclass(frozen=True)
class Restorer:
    """Wiener filters of one calibration, tile by tile, and the transfer functions last used.

    Attributes:
        calibration: kernels on the grid.
        tiling: tiles of the window.
    """

    calibration: Calibration
    tiling: Tiling
    # No other calibration's: `dataclasses.replace` begins with none.
    _kept: OrderedDict[tuple[int, int], NDArray[np.complex64]] = field(
        default_factory=OrderedDict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(cls, calibration: Calibration) -> Restorer:
        """Tiles where the pair varies over the field, one tile where it does not."""
        smallest, largest = _CORES_PX
        core = [
            np.inf if px > 16 * largest else min(max(px, smallest), largest) for px in calibration.core_px(_TILE_CHANGE)
        ]
        grid = calibration.grid
        return cls(calibration, Tiling.over(grid.shape, min(_MARGIN_PX, grid.margin), (core[0], core[1])))

    @property
    def nbytes(self) -> int:
        """Memory of the transfer functions that are kept."""
        return sum(transfer.nbytes for transfer in self._kept.values())

    def transformed(self, images: NDArray[np.float32], lit: NDArray[np.bool_]) -> LitTiles:
        """The tiles of both images that hold anything lit, as spectra.

        Args:
            images: shape (2, n_y + 2 margin, n_x + 2 margin), electrons a pixel.
            lit: shape (n_y, n_x).
        """
        tiles = self.tiling.touched(lit)
        place = np.zeros(self.tiling.n_tiles, dtype=np.intp)
        place[tiles] = np.arange(tiles.size)
        n_y, n_x = self.tiling.size
        spectra = np.empty((2, tiles.size, n_y, n_x // 2 + 1), dtype=np.complex64)
        spare = self.calibration.grid.margin - self.tiling.margin
        inside = slice(spare, -spare or None)
        for image, found in zip(images[:, inside, inside], spectra, strict=True):
            for cut, one in zip(self.tiling.cut(image, tiles), found, strict=True):
                one[...] = scipy.fft.rfft2(cut)
        return LitTiles(place, spectra)

    def __call__(self, seen: LitTiles, levels: Levels, label: NDArray[np.int32], vergences_per_m: FloatArray) -> Sharp:
        """Both images, sharp where ``label`` says at which depth they are; 0 where it is 0, never negative.

        The filter H* / (|H|^2 + noise / texture) is the best linear one for a texture with the spectrum of
        :meth:`Levels.texture_spectrum` in white noise; it keeps the mean.

        Args:
            seen: tiles that hold all of ``label``.
            levels: noise and texture of the frame.
            label: shape (n_y, n_x), number of each pixel's depth from 1.
            vergences_per_m: 1/depth of each number.

        Returns:
            The images, and what their filters make of the frame's noise.
        """
        sharp = Sharp(*np.zeros((2, 2, *self.tiling.shape), dtype=np.float32))
        self.write(sharp, seen, levels, label, vergences_per_m)
        return sharp

    def write(
        self,
        sharp: Sharp,
        seen: LitTiles,
        levels: Levels,
        label: NDArray[np.int32],
        vergences_per_m: FloatArray,
    ) -> None:
        """As a call, over what stands in ``sharp``; where ``label`` is 0, that stays."""
        tiling = self.tiling
        ky, kx = scipy.fft.fftfreq(tiling.size[0])[:, None], scipy.fft.rfftfreq(tiling.size[1])[None, :]
        noise_to_signal = levels.noise_variance / np.maximum(levels.texture_spectrum(ky * ky + kx * kx), 1e-300)
        noise_to_signal[0, 0] = 0.0
        ratio = noise_to_signal.astype(np.float32)
        steps = self._steps(vergences_per_m)
        pairs = tiling.numbers(label, len(vergences_per_m))
        transfers = self._transfers([(int(steps[number - 1]), tile) for tile, number in pairs])

        def restore(pair: tuple[int, int], transfer: NDArray[np.complex64]) -> None:
            tile, number = pair
            spectra = seen.spectra[:, seen.place[tile]]
            filtered, gain = (_wiener if HAS_NUMBA else _wiener_plain)(transfer, spectra, ratio)
            mask = label[tiling.place(tile)] == number
            rows = np.flatnonzero(mask.any(axis=1))
            part, mask = tiling.place(tile, rows[0], rows[-1] + 1), mask[rows[0] : rows[-1] + 1]
            core = tiling.cores(filtered, rows[0], rows[-1] + 1)[..., : mask.shape[1]]
            np.copyto(sharp.images[:, *part], np.maximum(core, 0.0), where=mask)
            np.copyto(sharp.noise_gain[:, *part], gain[:, None, None], where=mask)

        # A tile and a depth at once: what one thread works on stays in its cache.
        with kept_threads() as pool:
            for _ in pool.map(restore, pairs, transfers):
                pass

    @property
    def _range_per_m(self) -> tuple[float, float]:
        """Ends of the calibrated range of vergence."""
        inverse = 1.0 / self.calibration.kernels.psf.depth_m
        return float(inverse.min()), float(inverse.max())

    def _steps(self, vergences_per_m: FloatArray) -> NDArray[np.intp]:
        """The nearest depths of the grid of depths."""
        low, high = self._range_per_m
        return np.round((vergences_per_m - low) / (high - low) * _DEPTH_STEPS).astype(np.intp)

    def _transfers(self, wanted: list[tuple[int, int]]) -> list[NDArray[np.complex64]]:
        """Transfer functions at some (step of the grid of depths, tile): shape (2, n_ky, n_kx) each."""
        missing = sorted({key for key in wanted if key not in self._kept})
        with kept_threads() as pool:
            self._kept.update(zip(missing, pool.map(self._transfer, missing), strict=True))
        found = [self._kept[key] for key in wanted]
        for key in wanted:
            self._kept.move_to_end(key)
        while len(self._kept) > 1 and self.nbytes > _KEPT_BYTES:
            self._kept.popitem(last=False)
        return found

    def _transfer(self, key: tuple[int, int]) -> NDArray[np.complex64]:
        step, tile = key
        low, high = self._range_per_m
        share = self.calibration.depth_weights(low + step * (high - low) / _DEPTH_STEPS)
        kept = self._kernels[tile]
        kernels = (share @ kept.reshape(*kept.shape[:2], -1)).reshape(2, *kept.shape[-2:])
        # Each quarter of the kernels goes to a corner: their middle is the origin.
        place = np.zeros((2, *self.tiling.size), dtype=np.float32)
        (up, left), (n_y, n_x) = (n // 2 for n in kernels.shape[-2:]), kernels.shape[-2:]
        for to_y, from_y in ((slice(n_y - up), slice(up, None)), (slice(-up, None), slice(up))):
            for to_x, from_x in ((slice(n_x - left), slice(left, None)), (slice(-left, None), slice(left))):
                place[:, to_y, to_x] = kernels[:, from_y, from_x]
        return np.asarray(scipy.fft.rfft2(place), dtype=np.complex64)

    @cached_property
    def _kernels(self) -> NDArray[np.float32]:
        """The pair in each tile at each calibrated depth: shape (n_tiles, 2, n_depth, n_y, n_x)."""
        weights, stack = self.calibration.tile_weights(self.tiling, 1), self.calibration.stack
        return np.stack([np.tensordot(share, stack, axes=(0, 2)) for share in weights])


def _wiener_plain(
    transfer: NDArray[np.complex64], spectra: NDArray[np.complex64], ratio: NDArray[np.float32]
) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
    wiener = np.conj(transfer) / (transfer.real**2 + transfer.imag**2 + ratio)
    squares = np.abs(wiener) ** 2
    n_y, n_kx = ratio.shape
    # The other half plane; transforms have an even number of columns.
    total = 2.0 * squares.sum(axis=(-2, -1)) - squares[..., (0, -1)].sum(axis=(-2, -1))
    return np.asarray(wiener * spectra), np.asarray(total / (n_y * 2 * (n_kx - 1)), dtype=np.float32)


@compiled
def _wiener(
    transfer: NDArray[np.complex64], spectra: NDArray[np.complex64], ratio: NDArray[np.float32]
) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
    """Spectra times H* / (|H|^2 + ratio), and what that makes of white noise.

    Args:
        transfer: H, shape (2, n_ky, n_kx).
        spectra: of a tile's images, the same shape.
        ratio: noise over texture, shape (n_ky, n_kx).

    Returns:
        The shape of ``spectra``, and (2,): mean squares of the filters.
    """
    _, n_y, n_x = transfer.shape
    out = np.empty((2, n_y, n_x), dtype=np.complex64)
    gain = np.zeros(2, dtype=np.float32)
    squares = np.empty(n_x, dtype=np.float32)
    for image in range(2):
        total = 0.0
        for i in range(n_y):
            given, seen, noise, to = transfer[image, i], spectra[image, i], ratio[i], out[image, i]
            for j in range(n_x):
                h, s = given[j], seen[j]
                square = h.real * h.real + h.imag * h.imag
                inverse = np.float32(1.0) / (square + noise[j])
                real, imag = h.real * inverse, h.imag * inverse
                to[j] = complex(real * s.real + imag * s.imag, real * s.imag - imag * s.real)
                squares[j] = square * inverse * inverse
            line = np.float32(0.0)
            for j in range(n_x):
                line += squares[j]
            # The other half plane; transforms have an even number of columns.
            total += 2.0 * float(line) - float(squares[0]) - float(squares[n_x - 1])
        gain[image] = total / (n_y * 2 * (n_x - 1))
    return out, gain
