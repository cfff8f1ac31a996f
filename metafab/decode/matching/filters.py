"""Matched filters that make the twin images equal at a candidate depth, computed once for a calibration.

For a texture with transform F, the two images are Y_x = F H_x(z) and Y_y = c F H_y(z). Each image is multiplied by the
transfer function of the *other* one: both become F H_x H_y (up to the factor c) at the right depth z, and differ at
all others. Divided by sqrt(|H_x|^2 + |H_y|^2), their squared difference in white noise is the log-likelihood.

The filters change with depth and over the field, but all of them are mixtures of a few dozen basis kernels. Each image
is convolved with the basis once. Its results are mixed at each pixel by the weights of the pixel's place and of each
candidate depth. A point of the scene keeps its place, so that the place of the mixed pixel is that of the pair.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.spectra import independent_samples
from metafab.core.parallel.executor import kept_threads
from metafab.core.parallel.progress import Progress
from metafab.decode.matching.bias import unbiased, unbiased_places
from metafab.decode.matching.centring import centred
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.filter_basis import FilterBasis, frequencies, low_rank
from metafab.decode.matching.levels import Levels, high_pass
from metafab.decode.matching.mixing import mixed_products
from metafab.decode.matching.space_variance import FirstMoments, compensated, field_gradient
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.downsampling import Downsampling
from metafab.information.fisher import twin_information
from metafab.information.texture import Texture

#: Share of the information about depth that downsampling may lose.
_NEGLIGIBLE_SHARE = 0.1
#: (step, fewest pixels of a window that is worth it): small windows are cheap, and hold mostly outlines.
_STEPS = ((4, 200_000), (3, 200_000), (2, 0))
#: Size of the windows of filters over that of the pair's kernels: a normalised filter is longer than the pair.
_ROOM = 2
#: Share of the strongest frequency's power below which a frequency is not normalised: it is noise.
_FAINTEST = 1e-4
#: Sides of the square blocks within which the pair is taken as constant, frame pixels; all steps divide them.
BLOCK_PX, _SMALL_BLOCK_PX = 24, 12
#: Change of the pair (relative L2) from the centre of a large block to its side, above which small blocks are taken.
_CHANGE_IN_BLOCK = 0.05
#: Levels for which filters are normalised: 3000 electrons a pixel.
_TYPICAL = Levels(3000.0, 3000.0, 600.0, 2.0)
#: Images that are filtered together: their transforms stay in a thread's cache.
_AT_ONCE = 4
#: Share of the frequencies, from the highest down, over which the likelihood fades out.
_FADED_SHARE = 0.25


@dataclass(frozen=True)
class CrossFilters:
    """Matched filters of both images at each candidate depth, on the downsampled pixels."""

    downsampling: Downsampling  #: The pixels that are compared.
    vergences_per_m: FloatArray  #: Shape (n_candidates,), 1/depth, equally spaced.
    basis: FilterBasis  #: Kernels of which the filters are mixtures.
    #: Shape (2, n_block_y, n_block_x, n_candidates, n_basis), of the basis in the filters of each image.
    weights: NDArray[np.float32]
    block_px: int  #: Side of the blocks that share a mixture, frame pixels.

    @classmethod
    def of(
        cls,
        calibration: Calibration,
        vergences_per_m: FloatArray,
        basis_error: float,
        *,
        compensate: bool = True,
        step: int | None = None,
        in_place: bool = False,
    ) -> CrossFilters:
        """Compute the filters of a calibration.

        Args:
            vergences_per_m: shape (n_candidates,), 1/depth, equally spaced.
            basis_error: relative L2 error of the mixtures; a larger one is faster.
            compensate: whether to correct the filters for the pair's change over the field.
            step: pixels from one compared pixel to the next; by default :func:`coarsest_step`.
            in_place: whether filtered textures keep their place (:mod:`metafab.decode.matching.centring`).
        """
        grid = calibration.grid
        step = step or coarsest_step(calibration)
        downsampling = Downsampling(step, grid.shape, grid.margin)
        steps = np.linspace(vergences_per_m[0], vergences_per_m[-1], 2 * vergences_per_m.size - 1)
        transfer = _transfer(calibration, steps, step)
        filters, power = _cross_filters(calibration, transfer[:, ::2], step, compensate, in_place)
        basis, of_field_points = low_rank(filters, power, step, basis_error)
        gradient = field_gradient(calibration) if compensate else None
        of_field_points = _unbiased(basis, of_field_points, transfer, gradient)
        block_px = BLOCK_PX if min(calibration.core_px(_CHANGE_IN_BLOCK)) >= BLOCK_PX else _SMALL_BLOCK_PX
        at_blocks = calibration.block_weights(downsampling.shape, step, block_px // step)
        weights = np.einsum("yxf,pvfk->pyxvk", at_blocks, of_field_points, optimize=True)
        return cls(downsampling, vergences_per_m, basis, np.ascontiguousarray(weights, dtype=np.float32), block_px)

    @property
    def nbytes(self) -> int:
        """Memory of the filters."""
        return self.basis.nbytes + self.weights.nbytes

    @property
    def block(self) -> int:
        """Side of the blocks that share a mixture, downsampled pixels."""
        return self.block_px // self.downsampling.step

    def within(self, rows: slice, columns: slice) -> CrossFilters:
        """The filters of a part of the window, with the same basis.

        Rows and columns are downsampled pixels, whole blocks except at the window's end.
        """
        block = self.block
        blocks = (slice(at.start // block, -(-at.stop // block)) for at in (rows, columns))
        weights = np.ascontiguousarray(self.weights[:, *blocks])
        return replace(self, downsampling=self.downsampling.within(rows, columns), weights=weights)

    def volume(
        self, spectra: NDArray[np.complex64], levels: Levels, lit: NDArray[np.bool_], progress: Progress
    ) -> CostVolume:
        """Cost volume of the twins over the candidate depths, from their downsampled transforms, shape (2, n_ky, n_kx).

        ``lit``, shape (n_y, n_x), says whether a pixel is lit; blocks without a lit pixel are left out.
        """
        kernels, power = self.basis.transforms(self.downsampling)
        weight = _likelihood_weight(levels, power, *self.downsampling.frequencies).astype(np.float32)
        weighted = spectra * weight
        rows, columns = self.downsampling.inner
        filtered = np.empty((2, self.basis.count, *self.downsampling.shape), dtype=np.float32)

        def convolve(image: int, first: int) -> None:
            few = slice(first, first + _AT_ONCE)
            product = kernels[image, few] * weighted[image]
            # Rows of the margin are not needed, and not transformed back.
            product = scipy.fft.ifft(product, axis=-2, overwrite_x=True)[:, rows]
            filtered[image, few] = scipy.fft.irfft(product, self.downsampling.size[1], overwrite_x=True)[..., columns]

        jobs = [(image, first) for image in range(2) for first in range(0, self.basis.count, _AT_ONCE)]
        with kept_threads() as pool:
            for done, _ in enumerate(pool.map(convolve, *zip(*jobs, strict=True)), start=1):
                progress("decode", done, len(jobs))
        products = mixed_products(filtered, self.weights, self.block, lit)
        return CostVolume(self.vergences_per_m, products, *self._samples(weight))

    def _samples(self, weight: NDArray[np.float32]) -> tuple[float, float]:
        """Independent samples a pixel, and variance of a filtered image per variance of a pixel of the frame."""
        samples, gain = independent_samples(weight, self.downsampling.size)
        return samples, gain * self.downsampling.variance_gain


def _likelihood_weight(levels: Levels, power: FloatArray, ky: FloatArray, kx: FloatArray) -> FloatArray:
    """Root of each frequency's share in the likelihood, 0 to 1, without structure slower than a window.

    It fades out towards the highest frequencies: with a sharp cut-off, filters would reach all over the picture.
    """
    k2 = ky[:, None] ** 2 + kx[None, :] ** 2
    return np.asarray(levels.likelihood_weight(power, k2) * _fade(ky)[:, None] * _fade(kx))


def _fade(frequency: FloatArray) -> FloatArray:
    """1, falling to 0 over the highest frequencies."""
    remaining = 1.0 - np.abs(frequency) / np.abs(frequency).max()
    return np.asarray(np.sin(0.5 * np.pi * np.minimum(remaining / _FADED_SHARE, 1.0)))


def _transfer(calibration: Calibration, vergences_per_m: FloatArray, step: int) -> NDArray[np.complex64]:
    """Transfer functions of the pair at each candidate and field point.

    Shape (2, n_candidates, n_field, m_y, m_x // 2 + 1): transforms of every ``step``-th pixel of windows ``_ROOM``
    times as large as the kernels.
    """
    stack = calibration.stack
    n_y, n_x = stack.shape[-2:]
    size = (2 * math.ceil(_ROOM * n_y / (2 * step)), 2 * math.ceil(_ROOM * n_x / (2 * step)))
    ky, kx = frequencies(size, step)
    along_y = np.exp(-2j * np.pi * ky[:, None] * (np.arange(n_y) - n_y // 2)).astype(np.complex64)
    along_x = np.exp(-2j * np.pi * kx[:, None] * (np.arange(n_x) - n_x // 2)).astype(np.complex64)
    nodes = along_y @ (stack @ along_x.T)  # (2, n_depth, n_field, n_ky, n_kx)
    return np.tensordot(calibration.depth_weights(vergences_per_m), nodes, axes=(1, 1)).swapaxes(0, 1)


def _cross_filters(
    calibration: Calibration, transfer: NDArray[np.complex64], step: int, compensate: bool, in_place: bool
) -> tuple[NDArray[np.complex64], FloatArray]:
    """Each image's filter at each candidate and field point, and the mean power of the pair in the middle.

    Returns:
        The shape of ``transfer``, and (m_y, m_x // 2 + 1).
    """
    squared = transfer.real**2 + transfer.imag**2
    power = squared[:, :, transfer.shape[2] // 2].mean(axis=(0, 1))
    total = squared.sum(axis=0)
    total += _FAINTEST * total.max()
    filters = transfer[::-1] * np.sqrt(2.0 / total)
    weight = _likelihood_weight(_TYPICAL, power, *_frequencies(transfer, step))
    if in_place:
        filters = centred(filters, transfer, weight, step)
    if compensate:
        filters = compensated(filters, transfer, total, weight, calibration, step)
    return filters, power.astype(np.float64)


def _frequencies(transfer: NDArray[np.complex64], step: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies of transforms along y and x, cycles a frame pixel."""
    n_y, n_kx = transfer.shape[-2:]
    return frequencies((n_y, 2 * (n_kx - 1)), step)


def _unbiased(
    basis: FilterBasis,
    weights: NDArray[np.float32],
    transfer: NDArray[np.complex64],
    gradient: NDArray[np.float32] | None,
) -> NDArray[np.float32]:
    """Weights of the basis that put the maxima of the expected correlation at the true depths.

    ``transfer`` is the pair's at every half step between candidates; ``gradient`` is that of the field, None to leave
    the pair's change out.
    """
    ky, kx = _frequencies(transfer, basis.step)
    weight = _likelihood_weight(_TYPICAL, basis.power, ky, kx).astype(np.float32)
    kernels = (scipy.fft.rfft2(basis.kernels) * weight).reshape(2, 1, basis.count, -1)
    mixed = (weights @ kernels).reshape(*weights.shape[:3], *transfer.shape[3:])
    texture = _TYPICAL.texture_spectrum(ky[:, None] ** 2 + kx[None, :] ** 2)
    spectra = texture, np.full_like(texture, _TYPICAL.noise_variance)
    moments = FirstMoments.of(transfer, basis.step)
    return unbiased(weights, unbiased_places(mixed, transfer, gradient, moments, spectra))


def coarsest_step(calibration: Calibration) -> int:
    """The largest downsampling step that keeps 90 % of the Fisher information about depth for a natural texture."""
    stack = calibration.stack
    field = stack.shape[2] // 2
    middle = float(np.median(1.0 / calibration.kernels.psf.depth_m))
    difference = 1e-3 * middle
    low, at, high = (
        np.fft.fft2(np.tensordot(calibration.depth_weights(middle + d), stack[:, :, field], axes=(0, 1)))
        for d in (-difference, 0.0, difference)
    )
    ky, kx = (np.abs(np.fft.fftfreq(n)) for n in at.shape[1:])
    signal_to_noise = Texture().signal_to_noise((at.shape[1], at.shape[2]))
    signal_to_noise = signal_to_noise * high_pass(ky[:, None] ** 2 + kx[None, :] ** 2)
    all_information = twin_information(at, high - low, signal_to_noise)
    for step, fewest in _STEPS:
        inside = (ky[:, None] < 0.5 / step) & (kx[None, :] < 0.5 / step)
        kept = twin_information(at, high - low, signal_to_noise * inside)
        if math.prod(calibration.grid.shape) >= fewest and kept >= (1.0 - _NEGLIGIBLE_SHARE) * all_information:
            return step
    return 1
