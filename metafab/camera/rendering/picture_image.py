"""The image of a picture with its depth: its surfaces, blurred and added, and the balance of light at outlines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metafab.camera.rendering.depth_blur import DepthBlur
from metafab.camera.rendering.picture import Surface
from metafab.camera.rendering.windows import Window
from metafab.core.conventions import FloatArray


def picture_image(surfaces: Sequence[Surface], blur: DepthBlur, window: Window) -> FloatArray:
    """Electrons of each pixel for the surfaces of a picture (:func:`metafab.camera.rendering.picture.surfaces`).

    Radiance does not change along a ray, so the blurred visible shares of all surfaces add up to 1 in each pixel. The
    sum differs from 1 at an outline, because each depth has its own blur. The difference, times the mean light of the
    farther surface, is added, as for objects (:class:`metafab.camera.rendering.lens.Lens`).

    Args:
        surfaces: at least one.
        blur: of the image's polarisation.
        window: place of the image on the sensor.

    Returns:
        Shape of the window plus that of a kernel, less 1; the window's pixel [0, 0] is at ``[k_y // 2, k_x // 2]``.
    """
    directions, flux = (window.tangent_x, window.tangent_y), window.gain * window.stop
    light = np.stack([one.light for one in surfaces])
    share = np.stack([one.share for one in surfaces])
    vergence = np.stack([one.vergence_per_m for one in surfaces])
    image = blur(light * share * flux, vergence, *directions)
    if np.ptp(vergence) > 0.0:
        whole, at = light[0], vergence[0]
        for behind, its in zip(light[1:], vergence[1:], strict=True):
            whole, at = (np.where(behind > 0.0, *pair) for pair in ((behind, whole), (its, at)))
        image += blur.mean_light((whole * flux)[None], at[None], *directions) * _missing(share, vergence, blur, window)
    return image


def _missing(share: FloatArray, vergence_per_m: FloatArray, blur: DepthBlur, window: Window) -> FloatArray:
    """1 less the blurred visible shares of surfaces, (n_surfaces, n_y, n_x): shape of :func:`picture_image`."""
    (n_y, n_x), (k_y, k_x) = share.shape[1:], blur.basis.shape[-2:]
    y, x = k_y // 2, k_x // 2
    # Values of the edge go on around the window: only the edge of the image cuts a surface.
    wide = [np.pad(one, ((y, y), (x, x)), mode="edge") for one in (window.tangent_x, window.tangent_y)]
    around = [np.pad(one, ((0, 0), (y, y), (x, x)), mode="edge") for one in (share, vergence_per_m)]
    return np.asarray(1.0 - blur.coverage(*around, *wide)[y : y + n_y + k_y - 1, x : x + n_x + k_x - 1])
