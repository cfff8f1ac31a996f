"""The filters that make twins equal at a candidate depth, computed once for a calibration.

Of an unknown texture with transform F, the frame holds Y_x = F H_x(z) and Y_y = c F H_y(z). Passing each image
through the *other's* transfer function gives F H_x H_y in both where z is right, and different pictures where it is
not. Divided by sqrt(|H_x|^2 + |H_y|^2), the residual of this comparison in white noise is the likelihood itself.

The filters change with depth and over the field, but all of them are mixtures of a few dozen: each image is passed
through those once, and mixed at each pixel by the shares of its place and of each candidate depth. A point of the scene
comes out where it stands, so that the place of the mixed pixel is the one whose pair it takes.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import kept_threads
from metafab.core.parallel.progress import Progress
from metafab.decode.matching.cost_volume import Volume
from metafab.decode.matching.drift import made_up
from metafab.decode.matching.levels import LOWEST_FREQUENCY, Levels
from metafab.decode.matching.mixing import agreement
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.reduce import Reduction
from metafab.information.texture import Texture
from metafab.information.twin_images import twin_information

#: What the mixtures of the basis may leave out of the filters (relative L2, weighted as the likelihood is).
BASIS_ERROR = 0.02
#: Finer structure is left out where all of it knows less than this share of what is known about depth.
_NEGLIGIBLE_SHARE = 0.1
#: (step, fewest pixels of a window that is worth it): small windows are cheap, and hold outlines above all.
_STEPS = ((4, 200_000), (3, 200_000), (2, 0))
#: A normalised filter is longer than the pair: it is computed on windows larger by this factor.
_ROOM = 2
#: Share of the strongest frequency's power below which a frequency is not normalised: it is noise.
_FAINTEST = 1e-4
#: Sides of the squares over which the pair may be taken as one, pixels of the frame; all steps divide them.
BLOCK_PX, _SMALL_BLOCK_PX = 24, 12
#: What the pair may change by from the middle of a large square to its side (relative L2).
_CHANGE_IN_BLOCK = 0.05
_LARGEST_BASIS = 64
#: What filters that do not know their frame are made for: 3000 electrons a pixel.
_TYPICAL = Levels(3000.0, 3000.0, 600.0, 2.0)
#: Images that are filtered together: their transforms stay in a thread's cache.
_AT_ONCE = 4
#: Transforms of the basis are kept for this many sizes of windows, the last used.
_KEPT_SIZES = 6
#: Structure slower than this many times the lowest frequency varies with the light, and reaches far across outlines.
_HIGH_PASS = 3.0
#: Share of the frequencies, from the highest down, over which the likelihood fades out.
_FADED_SHARE = 0.25


@dataclass(frozen=True)
class CrossFilters:
    """Filters of both images at each candidate depth, on every ``every``-th pixel.

    Attributes:
        reduction: which pixels are compared.
        vergences_per_m: shape (n_candidates,), 1/depth, equally spaced.
        kernels: shape (2, n_basis, m_y, m_x), what each image is passed through; origin at [0, 0].
        shares: shape (2, n_block_y, n_block_x, n_candidates, n_basis), of its basis in the filter of each image.
        window_power: shape (m_y, m_x // 2 + 1), mean of |H|^2 over depth and polarisation in the middle of the window.
        block_px: side of the squares that share a mixture, pixels of the frame.
    """

    reduction: Reduction
    vergences_per_m: FloatArray
    kernels: NDArray[np.float32]
    shares: NDArray[np.float32]
    window_power: FloatArray
    block_px: int
    _of_sizes: OrderedDict[tuple[int, int], tuple[NDArray[np.complex64], FloatArray]] = field(
        default_factory=OrderedDict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(
        cls, calibration: Calibration, vergences_per_m: FloatArray, basis_error: float = BASIS_ERROR
    ) -> CrossFilters:
        """Filters of a calibration at candidate depths.

        Args:
            calibration: the pair.
            vergences_per_m: 1/depth of the candidates, equally spaced.
            basis_error: what the mixtures may leave out: more is faster, and less exact.
        """
        grid = calibration.grid
        every = coarsest_step(calibration)
        reduction = Reduction(every, grid.shape, grid.margin)
        filters, power = _cross_filters(calibration, vergences_per_m, every)
        kernels, shares = _low_rank(filters, power, every, basis_error)
        block_px = BLOCK_PX if min(calibration.core_px(_CHANGE_IN_BLOCK)) >= BLOCK_PX else _SMALL_BLOCK_PX
        weights = calibration.block_weights(reduction.shape, every, block_px // every)
        by_block = np.einsum("yxf,pvfk->pyxvk", weights, shares, optimize=True)
        return cls(
            reduction,
            vergences_per_m,
            kernels.astype(np.float32),
            np.ascontiguousarray(by_block, dtype=np.float32),
            power,
            block_px,
        )

    @property
    def nbytes(self) -> int:
        """Memory of the filters."""
        kept = sum(basis.nbytes + power.nbytes for basis, power in self._of_sizes.values())
        return self.kernels.nbytes + self.shares.nbytes + kept

    def within(self, rows: slice, columns: slice) -> CrossFilters:
        """The filters of a part of the window in compared pixels, whole blocks but for the window's end.

        What depends on the size of the part alone is computed once.
        """
        block, part = self.block, self.reduction.within(rows, columns)
        blocks = (slice(at.start // block, -(-at.stop // block)) for at in (rows, columns))
        found = replace(self, reduction=part, shares=np.ascontiguousarray(self.shares[:, *blocks]))
        object.__setattr__(found, "_of_sizes", self._of_sizes)  # of the same kernels
        return found

    @property
    def basis(self) -> NDArray[np.complex64]:
        """Transforms of the kernels: shape (2, n_basis, n_ky, n_kx)."""
        return self._of_size[0]

    @property
    def power(self) -> FloatArray:
        """``window_power`` at the transform's frequencies: shape (n_ky, n_kx)."""
        return self._of_size[1]

    @property
    def _of_size(self) -> tuple[NDArray[np.complex64], FloatArray]:
        size = self.reduction.size
        if size not in self._of_sizes:
            if len(self._of_sizes) >= _KEPT_SIZES:
                self._of_sizes.popitem(last=False)
            power = _on_frequencies(self.window_power, self.reduction, self.reduction.every)
            self._of_sizes[size] = _on_grid(self.kernels, size), power
        self._of_sizes.move_to_end(size)
        return self._of_sizes[size]

    def volume(
        self,
        spectra: NDArray[np.complex64],
        levels: Levels,
        lit: NDArray[np.bool_],
        progress: Progress,
    ) -> Volume:
        """Agreement of the twins at each candidate depth.

        Args:
            spectra: transforms of the reduced twins.
            levels: noise and texture of the frame.
            lit: shape of the reduced window, where there is light: other blocks are left out.
            progress: called after every few filtered images.
        """
        weight = self._weight(levels)
        weighted = spectra * weight
        rows, columns = self.reduction.inner
        basis = self.basis
        passed = np.empty((2, basis.shape[1], *self.reduction.shape), dtype=np.float32)

        def passes(image: int, first: int) -> None:
            few = slice(first, first + _AT_ONCE)
            mixed = basis[image, few] * weighted[image]
            # Rows of the margin are not needed, and not transformed back.
            mixed = scipy.fft.ifft(mixed, axis=-2, overwrite_x=True)[:, rows]
            passed[image, few] = scipy.fft.irfft(mixed, self.reduction.size[1], overwrite_x=True)[..., columns]

        jobs = [(image, first) for image in range(2) for first in range(0, basis.shape[1], _AT_ONCE)]
        with kept_threads() as pool:
            for done, _ in enumerate(pool.map(passes, *zip(*jobs, strict=True)), start=1):
                progress("decode", done, len(jobs))
        parts = agreement(passed, self.shares, self.block, lit)
        return Volume(self.vergences_per_m, parts, *self._samples(weight))

    @property
    def block(self) -> int:
        """Side of the squares of pixels that share a mixture."""
        return self.block_px // self.reduction.every

    def _samples(self, weight: NDArray[np.float32]) -> tuple[float, float]:
        """Independent samples a pixel, and variance of an aligned image per variance of a pixel of the frame."""
        share = weight.astype(np.float64) ** 2
        share[:, 1:-1] *= 2.0  # the other half plane
        total = math.prod(self.reduction.size)
        samples = float(share.sum() ** 2 / (weight.astype(np.float64) ** 2 * share).sum() / total)
        return samples, float(share.sum() / total) * self.reduction.variance_left

    def _weight(self, levels: Levels) -> NDArray[np.float32]:
        """Square root of what each frequency adds to the likelihood; nothing slower than a window."""
        ky, kx = self.reduction.frequencies
        return _likelihood(levels, self.power, ky, kx).astype(np.float32)


def _likelihood(levels: Levels, power: FloatArray, ky: FloatArray, kx: FloatArray) -> FloatArray:
    """Square root of what each frequency adds to the likelihood, at most 1; nothing slower than a window.

    It fades out towards the highest frequencies: cut off sharply, filters would reach all over the picture.
    """
    k2 = ky[:, None] ** 2 + kx[None, :] ** 2
    signal = power * levels.texture_spectrum(k2)
    share = np.sqrt(2.0 * signal / (levels.noise_variance + 2.0 * signal))
    return np.asarray(share * _high_pass(k2) * _fade(ky)[:, None] * _fade(kx))


def _fade(frequency: FloatArray) -> FloatArray:
    """1, and falling to 0 over the highest frequencies."""
    left = 1.0 - np.abs(frequency) / np.abs(frequency).max()
    return np.asarray(np.sin(0.5 * np.pi * np.minimum(left / _FADED_SHARE, 1.0)))


def _cross_filters(
    calibration: Calibration, vergences_per_m: FloatArray, every: int
) -> tuple[NDArray[np.complex64], FloatArray]:
    """Each image's filter at each candidate and field point, and the mean power of the pair in the middle.

    Returns:
        Shapes (2, n_candidates, n_field, m, m // 2 + 1) and (m, m // 2 + 1): transforms of every ``every``-th pixel
        of windows of ``_ROOM`` times the kernels' size.
    """
    stack = calibration.stack
    n_y, n_x = stack.shape[-2:]
    size = (_window_px(n_y, every), _window_px(n_x, every))
    ky, kx = _frequencies(size, every)
    along_y = np.exp(-2j * np.pi * ky[:, None] * (np.arange(n_y) - n_y // 2)).astype(np.complex64)
    along_x = np.exp(-2j * np.pi * kx[:, None] * (np.arange(n_x) - n_x // 2)).astype(np.complex64)
    nodes = along_y @ (stack @ along_x.T)  # (2, n_depth, n_field, n_ky, n_kx)
    depths = calibration.depth_weights(vergences_per_m)
    transfer = np.tensordot(depths, nodes, axes=(1, 1)).swapaxes(0, 1)
    squared = transfer.real**2 + transfer.imag**2
    power = squared[:, :, stack.shape[2] // 2].mean(axis=(0, 1))
    total = squared.sum(axis=0)
    total += _FAINTEST * total.max()
    weight = _likelihood(_TYPICAL, power, ky, kx)
    filters = made_up(transfer[::-1] * np.sqrt(2.0 / total), transfer, total, weight, calibration, every)
    return filters, power.astype(np.float64)


def _low_rank(
    filters: NDArray[np.complex64], power: FloatArray, every: int, error: float
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Basis kernels of each image, and the share of each in each of its filters.

    Returns:
        Shapes (2, n_basis, m_y, m_x), origin at [0, 0], and (2, n_candidates, n_field, n_basis).
    """
    n_y, n_kx = filters.shape[-2:]
    size = (n_y, 2 * (n_kx - 1))
    ky, kx = _frequencies(size, every)
    k2 = ky[:, None] ** 2 + kx[None, :] ** 2
    weight = np.sqrt(power / (k2 + LOWEST_FREQUENCY**2)) * _high_pass(k2)
    weight[n_y // 2] = weight[:, -1] = 0.0
    weight[:, 1:-1] *= np.sqrt(2.0)
    found = []
    for rows in (filters * weight).astype(np.complex64).reshape(2, -1, n_y * n_kx):
        found.append(_range(np.concatenate([rows.real, rows.imag], axis=1), error))
    vectors = np.zeros((2, found[0].shape[0], max(one.shape[1] for one in found)), dtype=np.float32)
    for one, place in zip(found, vectors, strict=True):
        place[:, : one.shape[1]] = one
    transfer = vectors.swapaxes(1, 2) @ filters.reshape(2, -1, n_y * n_kx)
    kernels = np.asarray(scipy.fft.irfft2(transfer.reshape(2, -1, n_y, n_kx), size), dtype=np.float64)
    return kernels, vectors.reshape(*filters.shape[:3], -1)


def _range(table: NDArray[np.float32], error: float) -> NDArray[np.float32]:
    """Orthonormal columns that hold the columns of ``table`` to within ``error``: shape (n_rows, n_basis)."""
    most = min(_LARGEST_BASIS, *table.shape)
    probes = np.random.default_rng(0).standard_normal((table.shape[1], most)).astype(np.float32)
    first, _ = np.linalg.qr(table @ probes)
    first, _ = np.linalg.qr(table @ (table.T @ first))
    left, singular, _ = np.linalg.svd(first.T @ table, full_matrices=False)
    missing = 1.0 - np.cumsum(singular.astype(np.float64) ** 2) / np.sum(table.astype(np.float64) ** 2)
    enough = np.flatnonzero(missing < error**2)
    count = int(enough[0]) + 1 if enough.size else most
    return np.asarray(first @ left[:, :count], dtype=np.float32)


def _on_grid(kernels: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.complex64]:
    """Transforms of kernels on a larger (or smaller) grid of the same pixels."""
    n_y, n_x = (min(a, b) for a, b in zip(kernels.shape[-2:], size, strict=True))
    centred = np.roll(kernels, (n_y // 2, n_x // 2), axis=(-2, -1))[..., :n_y, :n_x]
    place = np.zeros((*kernels.shape[:-2], *size), dtype=np.float32)
    place[..., :n_y, :n_x] = centred
    place = np.roll(place, (-(n_y // 2), -(n_x // 2)), axis=(-2, -1))
    return np.asarray(scipy.fft.rfft2(place), dtype=np.complex64)


def _window_px(kernel_px: int, every: int) -> int:
    return 2 * math.ceil(_ROOM * kernel_px / (2 * every))


def coarsest_step(calibration: Calibration) -> int:
    """The largest step of pixels that keeps nearly all that the twins of a natural texture know about depth."""
    stack = calibration.stack
    field = stack.shape[2] // 2
    middle = float(np.median(1.0 / calibration.kernels.psf.depth_m))
    step = 1e-3 * middle
    low, at, high = (
        np.fft.fft2(np.tensordot(calibration.depth_weights(middle + d), stack[:, :, field], axes=(0, 1)))
        for d in (-step, 0.0, step)
    )
    signal_to_noise = Texture().signal_to_noise((at.shape[1], at.shape[2]))
    ky, kx = (np.abs(np.fft.fftfreq(n)) for n in at.shape[1:])
    k2 = ky[:, None] ** 2 + kx[None, :] ** 2
    signal_to_noise = signal_to_noise * _high_pass(k2)
    known = twin_information(at, high - low, signal_to_noise)
    for every, fewest in _STEPS:
        inside = (ky[:, None] < 0.5 / every) & (kx[None, :] < 0.5 / every)
        kept = twin_information(at, high - low, signal_to_noise * inside)
        if math.prod(calibration.grid.shape) >= fewest and kept >= (1.0 - _NEGLIGIBLE_SHARE) * known:
            return every
    return 1


def _frequencies(size: tuple[int, int], every: int) -> tuple[FloatArray, FloatArray]:
    """Of a transform along y and x, cycles a pixel of the frame."""
    return scipy.fft.fftfreq(size[0]) / every, scipy.fft.rfftfreq(size[1]) / every


def _high_pass(frequency_squared: FloatArray) -> FloatArray:
    """Amplitude that is left of slow structure."""
    return np.asarray(frequency_squared / (frequency_squared + (_HIGH_PASS * LOWEST_FREQUENCY) ** 2))


def _on_frequencies(power: FloatArray, reduction: Reduction, every: int) -> FloatArray:
    """A smooth function of frequency on the reduction's frequencies, linear in between."""
    old_y, old_x = _frequencies((power.shape[0], 2 * (power.shape[1] - 1)), every)
    ky, kx = reduction.frequencies
    order = np.argsort(old_y)
    spline = RectBivariateSpline(old_y[order], old_x, power[order], kx=1, ky=1)
    return np.asarray(spline(np.clip(ky, old_y.min(), old_y.max())[:, None], kx[None, :], grid=False))
