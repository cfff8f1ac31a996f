"""All-in-focus images: Wiener deconvolution of both images at the depth of each pixel, tile by tile."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.spectra import transfer_functions
from metafab.core.parallel.executor import kept_threads
from metafab.decode.images.highlights import one_depth_each, separated
from metafab.decode.images.unmixing import Unmixing
from metafab.decode.matching.levels import Levels
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.tiles import Tiling

#: Change of the pair (relative L2) from the centre of a tile to its edge.
_TILE_CHANGE = 0.2
#: Smallest and largest side of a tile's core: larger tiles transform more pixels that are not asked for, smaller ones
#: more margin.
_CORES_PX = (32.0, 160.0)
#: Margin of a tile: with 8 pixels more, images would be better by 0.01 dB.
_MARGIN_PX = 28
#: Memory of the transfer functions that are kept; a tilted scene has a hundred pairs of tile and depth.
KEPT_BYTES = 2**28
#: Side of the window whose light determines a pixel's noise: about the width of a Wiener filter.
NOISE_WINDOW_PX = 9
#: Steps of the grid of depths over the calibrated range: the pair turns by less than a degree in each.
_DEPTH_STEPS = 96


@dataclass(frozen=True)
class TileSpectra:
    """Transforms of some tiles of both images."""

    #: Shape (n_tiles,), index in ``spectra`` of each tile of the tiling; 0 for tiles without spectra.
    place: NDArray[np.intp]
    spectra: NDArray[np.complex64]  #: Shape (2, n, n_ky, n_kx).


@dataclass(frozen=True)
class SharpImages:
    """All-in-focus images."""

    images: NDArray[np.float32]  #: Shape (2, n_y, n_x), electrons.
    #: Shape (2, n_y, n_x), variance of a pixel over that of the frame's pixels around it.
    noise_gain: NDArray[np.float32]

    def within(self, rows: slice, columns: slice) -> SharpImages:
        """A part of the images."""
        return SharpImages(self.images[:, rows, columns], self.noise_gain[:, rows, columns])

    def overwrite(self, other: SharpImages, where: NDArray[np.bool_]) -> None:
        """Write ``other`` into these images where the mask (n_y, n_x) is set."""
        np.copyto(self.images, other.images, where=where)
        np.copyto(self.noise_gain, other.noise_gain, where=where)


@dataclass(frozen=True)
class Deconvolver:
    """Wiener deconvolution with one calibration.

    The transfer functions last used, each of shape (2, n_ky, n_kx), are kept.
    """

    calibration: Calibration  #: Kernels on the grid.
    tiling: Tiling  #: Tiles of the window.
    kept_bytes: int = KEPT_BYTES  #: Most memory of the transfer functions that are kept.
    #: Separation of polarisations that a birefringent substrate mixes; None without one.
    unmixing: Unmixing | None = None
    _transfers: OrderedDict[tuple[int, int], NDArray[np.complex64]] = field(
        default_factory=OrderedDict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(
        cls, calibration: Calibration, kept_bytes: int = KEPT_BYTES, unmixing: Unmixing | None = None
    ) -> Deconvolver:
        """A deconvolver with tiles over which the pair hardly varies, and whose transforms stay in the cache."""
        smallest, largest = _CORES_PX
        core = [min(max(px, smallest), largest) for px in calibration.core_px(_TILE_CHANGE)]
        grid = calibration.grid
        tiling = Tiling.over(grid.shape, min(_MARGIN_PX, grid.margin), (core[0], core[1]))
        return cls(calibration, tiling, kept_bytes, unmixing)

    @property
    def nbytes(self) -> int:
        """Memory of the transfer functions that are kept."""
        return sum(transfer.nbytes for transfer in self._transfers.values())

    def tile_spectra(self, images: NDArray[np.float32], wanted: NDArray[np.bool_]) -> TileSpectra:
        """Transform the tiles that hold a wanted pixel, shape (n_y, n_x).

        Images have the shape (2, n_y + 2 margin, n_x + 2 margin), electrons a pixel.
        """
        tiles = self.tiling.tiles_with(wanted)
        place = np.zeros(self.tiling.n_tiles, dtype=np.intp)
        place[tiles] = np.arange(tiles.size)
        n_y, n_x = self.tiling.size
        spectra = np.empty((2, tiles.size, n_y, n_x // 2 + 1), dtype=np.complex64)
        spare = self.calibration.grid.margin - self.tiling.margin
        inside = slice(spare, -spare or None)
        for image, of_image in zip(images[:, inside, inside], spectra, strict=True):
            for cut, spectrum in zip(self.tiling.cut(image, tiles), of_image, strict=True):
                spectrum[...] = scipy.fft.rfft2(cut)
        return TileSpectra(place, spectra)

    def __call__(
        self,
        tiles: TileSpectra,
        levels: Levels,
        label: NDArray[np.int32],
        vergences_per_m: FloatArray,
        broken: NDArray[np.bool_] | None = None,
    ) -> SharpImages:
        """Deconvolve both images, each pixel at its own depth.

        The filter H* / (|H|^2 + noise / texture) is the best linear one for a texture of the spectrum of
        :meth:`Levels.texture_spectrum` in white noise. It keeps the mean. The images are not negative; they and their
        noise gain are 0 where ``label`` is 0.

        Args:
            tiles: tiles that hold all pixels of ``label``.
            levels: noise and texture of the frame.
            label: shape (n_y, n_x), number of each pixel's depth from 1; 0 for none.
            vergences_per_m: shape (n_depths,), 1/depth of each number.
            broken: shape (2, n_y + 2 margin, n_x + 2 margin), pixels of both images without a datum; none by default.
        """
        tiling, sharp = self.tiling, SharpImages(*np.zeros((2, 2, *self.tiling.shape), dtype=np.float32))
        ky, kx = scipy.fft.fftfreq(tiling.size[0])[:, None], scipy.fft.rfftfreq(tiling.size[1])[None, :]
        noise_to_signal = levels.noise_variance / np.maximum(levels.texture_spectrum(ky * ky + kx * kx), 1e-300)
        noise_to_signal[0, 0] = 0.0
        ratio = noise_to_signal.astype(np.float32)
        low, high = self._range_per_m
        steps = np.round((vergences_per_m - low) / (high - low) * _DEPTH_STEPS).astype(np.intp)
        pairs = tiling.labels_of_tiles(label, len(vergences_per_m))
        transfers = self.transfers([(int(steps[number - 1]), tile) for tile, number in pairs])
        spectra, highlights = tiles.spectra, dict[tuple[int, int], NDArray[np.float32]]()
        if broken is not None and broken.any():
            spectra = tiles.spectra.copy()
            highlights = self._separated(
                replace(tiles, spectra=spectra), levels, ratio, label, broken, pairs, transfers
            )

        def deconvolve(pair: tuple[int, int], transfer: NDArray[np.complex64]) -> None:
            tile, number = pair
            filtered, gain = wiener_filter(transfer, spectra[:, tiles.place[tile]], ratio)
            mask = label[tiling.place(tile)] == number
            rows = np.flatnonzero(mask.any(axis=1))
            part, mask = tiling.place(tile, rows[0], rows[-1] + 1), mask[rows[0] : rows[-1] + 1]
            core = tiling.cores(filtered, rows[0], rows[-1] + 1)[..., : mask.shape[1]]
            for image in range(2):
                if (tile, image) in highlights:
                    core[image] += highlights[tile, image][rows[0] : rows[-1] + 1, : mask.shape[1]]
            np.copyto(sharp.images[:, *part], np.maximum(core, 0.0), where=mask)
            np.copyto(sharp.noise_gain[:, *part], gain[:, None, None], where=mask)

        # One tile and depth at a time: the data of a thread stay in its cache.
        with kept_threads() as pool:
            pool.map(deconvolve, pairs, transfers)
        if self.unmixing is not None:
            self.unmixing.separate(sharp.images, sharp.noise_gain)
        return sharp

    def _separated(
        self,
        tiles: TileSpectra,
        levels: Levels,
        ratio: NDArray[np.float32],
        label: NDArray[np.int32],
        broken: NDArray[np.bool_],
        pairs: list[tuple[int, int]],
        transfers: list[NDArray[np.complex64]],
    ) -> dict[tuple[int, int], NDArray[np.float32]]:
        """Fill in the broken pixels of the tiles and subtract the highlights around them; see :func:`separated`.

        Returns:
            Sharp light of the highlights in the core of each (tile, image) that has some, shape ``core``.
        """
        tiling, spare = self.tiling, self.calibration.grid.margin - self.tiling.margin
        inside = slice(spare, -spare or None)
        depths, masks = np.pad(label, tiling.margin, mode="edge"), broken[:, inside, inside]
        core = tuple(slice(tiling.margin, tiling.margin + n) for n in tiling.core)
        of_tiles: dict[int, dict[int, NDArray[np.complex64]]] = {}
        for (tile, number), transfer in zip(pairs, transfers, strict=True):
            of_tiles.setdefault(tile, {})[number] = transfer

        def separate(of_image: tuple[int, int]) -> NDArray[np.float32] | None:
            tile, image = of_image
            mask = tiling.window(masks[image], tile)
            if not mask.any():
                return None
            place, light = (image, tiles.place[tile]), np.zeros(tiling.size, dtype=np.float32)
            owner = one_depth_each(mask, tiling.window(depths, tile), np.array(list(of_tiles[tile])))
            for number, transfer in of_tiles[tile].items():
                free = owner == number
                if not free.any():
                    continue
                found = separated(
                    tiles.spectra[place], transfer[image], ratio, free, levels.noise_variance, levels.signal
                )
                if found is not None:
                    tiles.spectra[place] = found.spectrum
                    light += found.light
            return light[core] if light.any() else None

        # The depths of a tile are treated in turn: each subtracts its highlights from what the earlier ones left.
        jobs = [(tile, image) for tile in of_tiles for image in range(2)]
        with kept_threads() as pool:
            found = zip(jobs, pool.map(separate, jobs), strict=True)
            return {job: light for job, light in found if light is not None}

    @property
    def _range_per_m(self) -> tuple[float, float]:
        """Ends of the calibrated range of vergence."""
        inverse = 1.0 / self.calibration.kernels.psf.depth_m
        return float(inverse.min()), float(inverse.max())

    def transfers(self, wanted: list[tuple[int, int]]) -> list[NDArray[np.complex64]]:
        """Transfer functions at each pair (step of the grid of depths, tile): shape (2, n_ky, n_kx) each."""
        _, pair = self._pairs
        wanted = [(step, int(pair[tile])) for step, tile in wanted]
        missing = sorted({key for key in wanted if key not in self._transfers})
        with kept_threads() as pool:
            self._transfers.update(zip(missing, pool.map(self._transfer, missing), strict=True))
        transfers = [self._transfers[key] for key in wanted]
        for key in wanted:
            self._transfers.move_to_end(key)
        while len(self._transfers) > 1 and self.nbytes > self.kept_bytes:
            self._transfers.popitem(last=False)
        return transfers

    def _transfer(self, key: tuple[int, int]) -> NDArray[np.complex64]:
        step, pair = key
        low, high = self._range_per_m
        share = self.calibration.depth_weights(low + step * (high - low) / _DEPTH_STEPS)
        nodes = self._kernels[pair]
        kernels = (share @ nodes.reshape(*nodes.shape[:2], -1)).reshape(2, *nodes.shape[-2:])
        return np.asarray(transfer_functions(kernels.astype(np.float32), self.tiling.size), dtype=np.complex64)

    @cached_property
    def _pairs(self) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """Distinct pairs of the tiles, as weights of the field points, (n_pairs, n_field), and that of each tile."""
        weights, pair = np.unique(self.calibration.tile_weights(self.tiling), axis=0, return_inverse=True)
        return weights, pair.ravel()

    @cached_property
    def _kernels(self) -> NDArray[np.float32]:
        """The distinct pairs of the tiles at each calibrated depth: shape (n_pairs, 2, n_depth, n_y, n_x)."""
        weights, _ = self._pairs
        return np.stack([np.tensordot(share, self.calibration.stack, axes=(0, 2)) for share in weights])


@compiled
def wiener_filter(
    transfer: NDArray[np.complex64], spectra: NDArray[np.complex64], ratio: NDArray[np.float32]
) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
    """Multiply a tile's spectra by H* / (|H|^2 + ratio), with H and spectra of shape (2, n_ky, n_kx).

    ``ratio``, shape (n_ky, n_kx), is noise over texture. Also returns the gain of white noise's variance, shape (2,).
    """
    _, n_y, n_x = transfer.shape
    out = np.empty((2, n_y, n_x), dtype=np.complex64)
    gain = np.zeros(2, dtype=np.float32)
    squares = np.empty(n_x, dtype=np.float32)
    for image in range(2):
        total = 0.0
        for i in range(n_y):
            h_line, s_line, noise, to = transfer[image, i], spectra[image, i], ratio[i], out[image, i]
            for j in range(n_x):
                h, s = h_line[j], s_line[j]
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
