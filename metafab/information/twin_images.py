"""Fisher information about depth in two images of one texture, summed over spatial frequencies.

At each frequency the two images hold one texture S behind two transfer functions, and noise: Y_j = O_j S + n_j. Let
b_j = O_j sqrt(P) / noise_j, where P is the power of the texture, and let ' be the derivative with respect to depth.

Unknown texture
    S is Gaussian with power P, a nuisance parameter that the covariance of (Y_x, Y_y) projects out. Left is
    J = 2 |b_x b_y' - b_y b_x'|^2 / (1 + |b_x|^2 + |b_y|^2): only a change of the *ratio* of the transfer functions
    counts. For a conjugate pair O_y = conj(O_x) = |O| exp(-i alpha) this is
    J = 8 (P |O|^2)^2 alpha'^2 / (1 + 2 P |O|^2): the depth is in the phase. A single image, a symmetric PSF (lens,
    double helix) and two equal PSFs have J = 0.
Known texture
    All changes of both images count: J = 2 (|b_x'|^2 + |b_y'|^2). This is never less. The difference is the blur that
    both images share, and the frequencies that drown in noise.

Images are real, so a frequency and its negative are one measurement: sums over all frequencies of a DFT take J / 2.
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray


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
