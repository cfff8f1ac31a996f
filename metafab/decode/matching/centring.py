"""Centring of the matched filters: a filtered texture stands at its own place, at every depth and all over the field.

Both images of a texture become F H_x H_y. On the axis the pair's blurs are mirror images of each other, H_y is the
conjugate of H_x, and the product stays in place. Off the axis, what both blurs have in common (coma, and the change of
both images' place with depth) displaces it: by up to 6.5 px at the sides of Shen's field, by another distance at each
candidate depth. Where the depth changes from pixel to pixel, it is measured beside its place. A shift of both filters
alike brings the filtered twins back, and changes neither their difference nor their noise.

Windows of flat objects do not need it: there, displaced blur of an outline helps as often as it harms.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.matching.filter_basis import frequencies


def displacement_px(
    filters: NDArray[np.complex64], transfer: NDArray[np.complex64], weight: NDArray[Any], step: int
) -> FloatArray:
    """Displacement of a filtered texture, as a (y, x) in frame pixels: shape (2, n_candidates, n_field).

    It is the mean place of the energy in the image of a point, filtered at the point's own depth.

    Args:
        filters: shape (2, n_candidates, n_field, m_y, m_x // 2 + 1), filters of both images.
        transfer: the shape of ``filters``, transfer functions of the pair.
        weight: shape (m_y, m_x // 2 + 1), root of each frequency's share in the likelihood.
        step: frame pixels from one pixel to the next.
    """
    n_y, n_kx = filters.shape[-2:]
    size = (n_y, 2 * (n_kx - 1))
    energy = scipy.fft.irfft2(filters[0] * transfer[0] * weight, size) ** 2
    place_y, place_x = (step * n * scipy.fft.fftfreq(n) for n in size)
    total = energy.sum(axis=(-2, -1))
    return np.asarray(np.stack([energy.sum(axis=-1) @ place_y, energy.sum(axis=-2) @ place_x]) / total)


def centred(
    filters: NDArray[np.complex64], transfer: NDArray[np.complex64], weight: NDArray[Any], step: int
) -> NDArray[np.complex64]:
    """Filters of both images, shifted alike so that textures keep their place: the shape of ``filters``.

    Arguments are those of :func:`displacement_px`.
    """
    n_y, n_kx = filters.shape[-2:]
    ky, kx = frequencies((n_y, 2 * (n_kx - 1)), step)
    off_y, off_x = displacement_px(filters, transfer, weight, step)[..., None, None]
    shift = np.exp(2j * np.pi * (ky[:, None] * off_y + kx * off_x))
    return np.asarray(filters * shift.astype(np.complex64))
