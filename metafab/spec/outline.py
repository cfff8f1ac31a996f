"""Points enclosed by the aperture."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.spec.design import Device


def encloses(device: Device, x_um: FloatArray, y_um: FloatArray) -> NDArray[np.bool_]:
    """Mask of the grid points within the aperture, its rim included.

    Args:
        device: the aperture.
        x_um: shape (n_x,).
        y_um: shape (n_y,).

    Returns:
        Shape (n_y, n_x).
    """
    half = 0.5 * device.aperture_um
    if device.aperture_shape == "square":
        return (np.abs(y_um) <= half)[:, None] & (np.abs(x_um) <= half)
    if device.aperture_shape == "polygon":
        x, y = np.meshgrid(x_um, y_um)
        return np.asarray(shapely.intersects_xy(shapely.Polygon(device.outline_um), x, y))
    square = y_um[:, None] ** 2 + x_um**2
    within: NDArray[np.bool_] = square <= half * half
    if device.aperture_shape == "ring":
        within &= square >= (0.5 * device.inner_um) ** 2
    return within
