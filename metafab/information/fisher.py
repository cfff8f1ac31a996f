"""Fisher information about depth: two images of one texture, or PSFs sampled over depth; its Cramer-Rao bound.

At each frequency the two images hold one texture S behind two transfer functions, and noise: Y_j = O_j S + n_j. Let
b_j = O_j sqrt(P) / noise_j, where P is the power of the texture, and let ' be the derivative with respect to depth.

Unknown texture
    S is Gaussian with power P, a nuisance parameter that the covariance of (Y_x, Y_y) projects out. There remains
    J = 2 |b_x b_y' - b_y b_x'|^2 / (1 + |b_x|^2 + |b_y|^2): only a change of the *ratio* of the transfer functions
    counts. For a conjugate pair O_y = conj(O_x) = |O| exp(-i alpha) this is
    J = 8 (P |O|^2)^2 alpha'^2 / (1 + 2 P |O|^2): the depth is in the phase. A single image, a symmetric PSF (lens,
    double helix) and two equal PSFs have J = 0.
Known texture
    All changes of both images count: J = 2 (|b_x'|^2 + |b_y'|^2). This is never less. The difference is the blur that
    both images share, and the frequencies that drown in noise.

Images are real, so a frequency and its negative are one measurement: sums over all frequencies of a DFT take J / 2.

PSFs are a stack of shape (2, n_depth, n_y, n_x), as :attr:`metafab.optics.Psf.psf`, in windows about the geometric
image points. The source is a texture or a point (position and brightness known or not). For a point with mean image
mu, the information is sum mu'^2 / variance: exact for many electrons, otherwise a lower bound.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.information.texture import PointSource, Texture


def twin_information(
    transfer: ComplexArray, slope: ComplexArray, signal_to_noise: FloatArray, *, contrast_known: bool = False
) -> float:
    """Information about depth in two images of an unknown texture, in the inverse square of the unit of depth.

    Args:
        transfer: shape (2, n_y, n_x), DFT of both PSFs, zero frequency first.
        slope: shape (2, n_y, n_x), derivative of ``transfer`` with respect to depth.
        signal_to_noise: shape (n_y, n_x), power of the texture over that of the noise in either image.
        contrast_known: whether the brightness ratio of the images is known; no difference for a conjugate pair.
    """
    mixed = signal_to_noise * (transfer[0] * slope[1] - transfer[1] * slope[0])
    ratio = signal_to_noise * transfer[0] * transfer[1]
    weight = 1.0 / (1.0 + signal_to_noise * (np.abs(transfer) ** 2).sum(axis=0))
    depth = float((np.abs(mixed) ** 2 * weight).sum())
    if contrast_known or depth == 0.0:
        return depth
    contrast = float((np.abs(ratio) ** 2 * weight).sum())
    cross = float(((mixed * ratio.conj()).real * weight).sum())
    return depth - cross**2 / contrast


def conjugate_information(transfer: ComplexArray, slope: ComplexArray, signal_to_noise: FloatArray) -> FloatArray:
    """Information about depth in conjugate pairs of images of an unknown texture, in the inverse square of its unit.

    The transfer function of x polarisation and its derivative with respect to depth have the shape (..., n_y, n_x),
    zero frequency first, those of y polarisation are the complex conjugates. The signal-to-noise ratio, shape (n_y,
    n_x), is that of :func:`twin_information`, the information has the shape (...).
    """
    turn = (slope * transfer.conj()).imag
    density = 4.0 * (signal_to_noise * turn) ** 2 / (1.0 + 2.0 * signal_to_noise * np.abs(transfer) ** 2)
    return np.asarray(density.sum(axis=(-2, -1)))


def known_texture_information(slope: ComplexArray, signal_to_noise: FloatArray) -> float:
    """Information about depth in two images of a known texture; at least that of :func:`twin_information`.

    ``slope``, shape (2, n_y, n_x), is the derivative of the DFT of both PSFs with respect to depth.
    """
    return float((signal_to_noise * (np.abs(slope) ** 2).sum(axis=0)).sum())


def depth_slope(stack: FloatArray, depth_m: ArrayLike) -> FloatArray:
    """Return the derivative of a stack with respect to depth, per metre, by a cubic spline over the vergence 1/depth.

    The stack is real, of shape (..., n_depth, n_y, n_x), like the derivative. Fewer than 4 depths, or depths that do
    not ascend, raise ValueError.
    """
    depth = np.asarray(depth_m, dtype=np.float64)
    if depth.size < 4 or np.any(np.diff(depth) <= 0.0):
        raise ValueError(f"`depth_m`: expected at least 4 ascending depths, got {depth.tolist()}")
    spline = CubicSpline(-1.0 / depth, stack, axis=-3)
    return np.asarray(spline(-1.0 / depth, 1) / (depth**2)[:, None, None], dtype=np.float64)


def point_information(
    psf: FloatArray, depth_m: ArrayLike, pixel_um: float, source: PointSource, *, known: bool = True
) -> FloatArray:
    """Information about depth in the image of a point, both polarisations together, shape (n_depth,), 1/m^2.

    Args:
        psf: shape (2, n_depth, n_y, n_x), irradiance at pixel centres, 1/um^2 per unit power; zeros for one
            polarisation give the information of the other alone.
        depth_m: shape (n_depth,), ascending.
        pixel_um: pixel pitch; a pixel collects the irradiance at its centre times its area.
        source: electrons and noise.
        known: whether position (x and y) and brightness are known. Unknown, they are nuisance parameters.
    """
    mean = source.electrons * pixel_um**2 * psf
    variance = mean + source.background_e + source.read_noise_e**2
    by_depth = depth_slope(mean, depth_m)
    if known:
        return np.asarray((by_depth**2 / variance).sum(axis=(0, 2, 3)), dtype=np.float64)
    by_y, by_x = np.gradient(mean, axis=(2, 3))
    parameters = np.stack([by_depth, by_x, by_y, mean])
    # Shape (depth, parameter, parameter); the Schur complement projects the nuisance parameters out. Ones on the
    # diagonal make the inverses well-conditioned.
    fisher = np.einsum("apdyx,bpdyx->dab", parameters / variance, parameters)
    size = np.sqrt(np.einsum("daa->da", fisher))
    normalised = fisher / size[:, :, None] / size[:, None, :]
    kept = np.array([1.0 / np.linalg.pinv(matrix, hermitian=True)[0, 0] for matrix in normalised])
    return np.asarray(kept * fisher[:, 0, 0], dtype=np.float64)


def twin_depth_information(
    psf: FloatArray, depth_m: ArrayLike, pixel_um: float, texture: Texture, *, contrast_known: bool = False
) -> FloatArray:
    """Information about depth in twin images of a patch of unknown texture with the size of the PSF windows.

    ``psf`` is the irradiance at pixel centres, shape (2, n_depth, n_y, n_x), 1/um^2 per unit power; depths ascend.
    ``contrast_known``: whether the brightness ratio of the two images is known. Shape (n_depth,), 1/m^2; proportional
    to the area of the patch.
    """
    stacks = (np.fft.ifftshift(stack, axes=(2, 3)) for stack in (psf, depth_slope(psf, depth_m)))
    transfer, slope = (np.moveaxis(np.fft.fft2(stack), 1, 0) * pixel_um**2 for stack in stacks)
    snr = texture.signal_to_noise((psf.shape[2], psf.shape[3]))
    pairs = zip(transfer, slope, strict=True)
    return np.array([twin_information(*pair, snr, contrast_known=contrast_known) for pair in pairs])


def depth_crlb_m(information: ArrayLike) -> FloatArray:
    """Cramer-Rao bound: the smallest standard deviation (m) of an unbiased depth estimate, 1 / sqrt(information).

    The information, 1/m^2, has any shape; the bound has the same, and is infinite where the information is 0.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(np.asarray(information, dtype=np.float64)))
