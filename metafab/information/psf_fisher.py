"""Fisher information about depth in PSF stacks, and the smallest error that it allows (Cramer-Rao bound).

Two questions, both answered from a stack alone, shape (2, n_depth, n_y, n_x) as :attr:`Psf.psf`, whose windows are
centred on the geometric image points:

- a point source (known position and brightness, or not): how does the image of a point change with depth?
- a twin image of unknown texture: how does the *relation* of the two images change with depth?
  (:mod:`metafab.information.twin_images`)

The noise is Poisson noise of the signal and the background and Gaussian read noise, whose variances add: sum (d
mean)^2 / variance, exact for a large background or many electrons, a lower bound of the information otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from metafab.core.conventions import FloatArray
from metafab.information.twin_images import PointSource, Texture, twin_information

__all__ = ["PointSource", "Texture", "depth_crlb_m", "depth_slope", "point_information", "twin_depth_information"]


def depth_slope(stack: FloatArray, depth_m: ArrayLike) -> FloatArray:
    """Derivative of a stack with respect to depth, 1/m, by a cubic spline over the vergence 1/depth.

    Args:
        stack: shape (..., n_depth, n_y, n_x), real.
        depth_m: shape (n_depth,), ascending, at least 4.

    Raises:
        ValueError: fewer than 4 depths, or not ascending.
    """
    depth = np.asarray(depth_m, dtype=np.float64)
    if depth.size < 4 or np.any(np.diff(depth) <= 0.0):
        raise ValueError(f"`depth_m`: expected at least 4 ascending depths, got {depth.tolist()}")
    spline = CubicSpline(-1.0 / depth, stack, axis=-3)
    return np.asarray(spline(-1.0 / depth, 1) / (depth**2)[:, None, None], dtype=np.float64)


def point_information(
    psf: FloatArray, depth_m: ArrayLike, pixel_um: float, source: PointSource, *, known: bool = True
) -> FloatArray:
    """Information about depth in the image of a point, both polarisations together.

    Args:
        psf: shape (2, n_depth, n_y, n_x), irradiance at pixel centres, 1/um^2 per unit power; with zeros for one
            polarisation, the information of the other alone.
        depth_m: shape (n_depth,), ascending.
        pixel_um: pixel pitch; the irradiance at the centre stands for the pixel.
        source: electrons and noise.
        known: whether position (x and y) and brightness are known; else they are estimated, too, and take their
            share.

    Returns:
        Shape (n_depth,), 1/m^2.
    """
    mean = source.electrons * pixel_um**2 * psf
    variance = mean + source.background_e + source.read_noise_e**2
    by_depth = depth_slope(mean, depth_m)
    if known:
        return np.asarray((by_depth**2 / variance).sum(axis=(0, 2, 3)), dtype=np.float64)
    by_y, by_x = np.gradient(mean, axis=(2, 3))
    parameters = np.stack([by_depth, by_x, by_y, mean])
    # (parameter, parameter, depth): depth keeps what the others cannot explain (Schur complement).
    fisher = np.einsum("apdyx,bpdyx->dab", parameters / variance, parameters)
    kept = np.array([1.0 / np.linalg.pinv(matrix, hermitian=True)[0, 0] for matrix in _scaled(fisher)])
    return np.asarray(kept * fisher[:, 0, 0], dtype=np.float64)


def _scaled(fisher: FloatArray) -> FloatArray:
    """Information matrices with ones on the diagonal, so that units do not spoil their inverses."""
    size = np.sqrt(np.einsum("daa->da", fisher))
    return np.asarray(fisher / size[:, :, None] / size[:, None, :])


def twin_depth_information(
    psf: FloatArray, depth_m: ArrayLike, pixel_um: float, texture: Texture, *, contrast_known: bool = False
) -> FloatArray:
    """Information about the depth of a piece of unknown texture, as large as the PSFs' windows, in its twin image.

    Args:
        psf: shape (2, n_depth, n_y, n_x), irradiance at pixel centres, 1/um^2 per unit power.
        depth_m: shape (n_depth,), ascending.
        pixel_um: pixel pitch.
        texture: electrons a pixel, contrast, spectrum and noise.
        contrast_known: whether the brightness ratio of the two images is known.

    Returns:
        Shape (n_depth,), 1/m^2; multiply by the number of such pieces for a larger area.
    """
    transfer = np.fft.fft2(np.fft.ifftshift(psf, axes=(2, 3))) * pixel_um**2
    slope = np.fft.fft2(np.fft.ifftshift(depth_slope(psf, depth_m), axes=(2, 3))) * pixel_um**2
    signal_to_noise = texture.signal_to_noise((psf.shape[2], psf.shape[3]))
    return np.array(
        [
            twin_information(transfer[:, i], slope[:, i], signal_to_noise, contrast_known=contrast_known)
            for i in range(psf.shape[1])
        ]
    )


def depth_crlb_m(information: ArrayLike) -> FloatArray:
    """Smallest standard deviation of any unbiased depth estimate, 1/sqrt(information), m; ``inf`` where it is 0."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(np.asarray(information, dtype=np.float64)))
