"""Correction of the matched filters for the pair's change over the field.

A point of the scene at s is blurred by the pair of s, but its image at x passes the filters of x. Let t = x - s and
H(s) = H(x) - t grad H. Filters A (of the x image) and B (of the y image) that make the twins of one place equal,
A H_x = B H_y, leave a difference of F times

    q = -sum_j FT[t_j IFT(A d_j H_x - B d_j H_y)],

to first order in the change over the pair's own width, with F the texture's transform.
The difference is no noise and does not average out: over Shen's field it changes depth by 0.07 % in the mean, and
by up to 0.2 % at the sides. The smallest change of both filters that removes it is -q H_x* / (|H_x|^2 + |H_y|^2) of A
and +q H_y* / (|H_x|^2 + |H_y|^2) of B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from metafab.core.conventions import FloatArray
from metafab.decode.registration.calibration import Calibration

#: Share of the largest weight below which a frequency is not corrected: it hardly counts.
_FAINTEST = 1e-2


def compensated(
    filters: NDArray[np.complex64],
    transfer: NDArray[np.complex64],
    total: NDArray[np.float32],
    weight: FloatArray,
    calibration: Calibration,
    step: int,
) -> NDArray[np.complex64]:
    """Correct filters for the pair's change over the field; all frequencies are those of every ``step``-th pixel.

    Args:
        filters: shape (2, n_candidates, n_field, m_y, m_x // 2 + 1), filters of the pair at each field point.
        transfer: the shape of ``filters``, transfer functions H of the pair.
        total: shape (n_candidates, n_field, m_y, m_x // 2 + 1), sum of both |H|^2; positive.
        weight: shape (m_y, m_x // 2 + 1), weight that is common to both filtered images.
    """
    gradient = field_gradient(calibration)
    if not gradient.any():
        return filters
    moments = FirstMoments.of(transfer, step)
    weight = np.asarray(weight, dtype=np.float32)
    inverse_weight = 1.0 / np.maximum(weight, _FAINTEST * weight.max())
    out = np.empty_like(filters)
    for v in range(transfer.shape[1]):
        changes = (np.tensordot(along, transfer[:, v], axes=(1, 1)).swapaxes(0, 1) for along in gradient)
        unequal = (weight * (filters[0, v] * change[0] - filters[1, v] * change[1]) for change in changes)
        share = moments(*unequal) * inverse_weight / total[v]
        out[0, v] = filters[0, v] + share * transfer[0, v].conj()
        out[1, v] = filters[1, v] - share * transfer[1, v].conj()
    return out


def field_gradient(calibration: Calibration) -> NDArray[np.float32]:
    """Matrices of the derivatives over x and y (per pixel) of the pair at the n field points: shape (2, n, n)."""
    kernels = calibration.kernels
    nodes_y, nodes_x = kernels.tangent_y, kernels.tangent_x
    by_x = np.kron(np.eye(nodes_y.size), slope_weights(nodes_x))
    by_y = np.kron(slope_weights(nodes_y), np.eye(nodes_x.size))
    tangent_y, tangent_x = (axis.ravel() for axis in np.meshgrid(nodes_y, nodes_x, indexing="ij"))
    place_um = calibration.image_map.jacobian_um(0, tangent_x, tangent_y)
    # d(tangent) / d(place in the x image), per pixel.
    tangent_per_px = kernels.psf.pixel_um * np.linalg.inv(place_um)[..., None]
    along = [tangent_per_px[:, 0, axis] * by_x + tangent_per_px[:, 1, axis] * by_y for axis in (0, 1)]
    return np.asarray(along, dtype=np.float32)


def slope_weights(nodes: FloatArray) -> FloatArray:
    """Weights of the values at nodes (n,) in the slopes of the spline through them, at the nodes: shape (n, n)."""
    if nodes.size == 1:
        return np.zeros((1, 1))
    spline = make_interp_spline(nodes, np.eye(nodes.size), k=min(3, nodes.size - 1))
    return np.asarray(spline.derivative()(nodes), dtype=np.float64)


@dataclass(frozen=True)
class FirstMoments:
    """Multiplication of real images by the offset of each pixel from their origin, in transforms of real images.

    The offset along y multiplies each column by itself: an imaginary matrix over k_y, since offsets are odd. That
    along x multiplies each row, of which a transform along x holds half: a real matrix over the real and imaginary
    parts of its k_x.
    """

    by_y: NDArray[np.float32]  #: Shape (m_y, m_y), imaginary part of the matrix.
    by_x: NDArray[np.float32]  #: Shape (m_x + 2, m_x + 2), from the right.

    @classmethod
    def of(cls, transfer: NDArray[np.complex64], step: int) -> FirstMoments:
        """Those of transforms, shape (..., m_y, m_x // 2 + 1), of every ``step``-th pixel, in pixels."""
        n_y, n_kx = transfer.shape[-2:]
        n_x = 2 * (n_kx - 1)
        columns = scipy.fft.ifft(np.eye(n_y), axis=0) * _periodic_offsets(n_y)[:, None]
        rows = scipy.fft.irfft(np.eye(2 * n_kx).view(np.complex128), n_x) * _periodic_offsets(n_x)
        by_y, by_x = scipy.fft.fft(columns, axis=0).imag, scipy.fft.rfft(rows).view(np.float64)
        return cls((step * by_y).astype(np.float32), (step * by_x).astype(np.float32))

    def __call__(self, image_x: NDArray[np.complex64], image_y: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Transform of x times one image plus y times the other; all have the shape (..., m_y, m_x // 2 + 1)."""
        rows = np.ascontiguousarray(scipy.fft.ifft(image_x, axis=-2)).view(np.float32)
        moment = scipy.fft.fft((rows @ self.by_x).view(np.complex64), axis=-2, overwrite_x=True)
        moment += 1j * (self.by_y @ np.ascontiguousarray(image_y).view(np.float32)).view(np.complex64)
        return np.asarray(moment)


def _periodic_offsets(count: int) -> FloatArray:
    """Signed offsets from the first pixel of a periodic window; 0 for the pixel that is equally far both ways."""
    offset = scipy.fft.fftfreq(count) * count
    offset[count // 2] = 0.0
    return np.asarray(offset)
