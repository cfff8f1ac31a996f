"""Frames by a direct sum over sub-apertures: each scene point's light through the part of the aperture that sees it.

The helix pupil of ``tests.conjugate_pair`` is cut into square cells. Near surfaces are rectangles, tested along the ray
from each point through each cell. The fields of the cells that see the point add up, and their squared modulus is the
PSF of its cut aperture, diffraction included.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import scipy.fft

from metafab.camera.kernels import pixel_transfer
from metafab.core.conventions import FloatArray, sensor_distance_um
from metafab.spec import SceneObject
from tests import conjugate_pair as pair

WINDOW_PX = 48
_CELL_SAMPLES = 5


@cache
def _cells(depth_m: float) -> tuple[FloatArray, np.ndarray]:
    """Centres (x, y) of the cells, um, and their fields on the window, shape (n_cells, 48, 48)."""
    distance_um = sensor_distance_um(pair.FOCAL_LENGTH_MM, pair.ANGLE_DEG, pair.FOCUS_DEPTH_M)
    count = 3 * WINDOW_PX
    step_um = pair.WAVELENGTH_UM * distance_um / (count * pair.PIXEL_UM)
    u = (np.arange(count) - count // 2) * step_um
    x, y = np.meshgrid(u, u)
    radius, azimuth = np.hypot(x, y) / pair.RADIUS_UM, np.arctan2(y, x)
    vergence = 1.0 / depth_m - 1.0 / pair.FOCUS_DEPTH_M
    spiral = np.ceil(4 * np.clip(radius, 1e-9, 1.0) ** 2) * azimuth
    defocus = math.pi / pair.WAVELENGTH_UM * (pair.RADIUS_UM * radius) ** 2 * vergence * 1e-6
    pupil = np.where(radius <= 1.0, np.exp(1j * (spiral + defocus)), 0.0)
    half, middle = WINDOW_PX // 2, count // 2
    window = slice(middle - half, middle + half)
    centres, fields = [], []
    starts = range(middle % _CELL_SAMPLES, count - _CELL_SAMPLES + 1, _CELL_SAMPLES)
    for row in starts:
        for column in starts:
            cell = (slice(row, row + _CELL_SAMPLES), slice(column, column + _CELL_SAMPLES))
            if pupil[cell].any():
                part = np.zeros_like(pupil)
                part[cell] = pupil[cell]
                fields.append(np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(part)))[window, window])
                centres.append((x[cell].mean(), y[cell].mean()))
    total = (np.abs(np.fft.fft2(pupil)) ** 2).sum()
    return np.array(centres), np.array(fields) / math.sqrt(total)


def image(
    light: Sequence[FloatArray],
    objects: Sequence[SceneObject],
    tangent_x: FloatArray,
    tangent_y: FloatArray,
) -> FloatArray:
    """The image of layers, nearest first, on the grid of ``tangent_x`` with half a window around.

    Args:
        light: the whole light of each layer, hidden or not, shape (n_y, n_x).
        objects: rectangles that the layers are.
        tangent_x: shape (n_y, n_x), x/z of the grid; equidistant.
        tangent_y: shape (n_y, n_x), y/z of the grid.
    """
    n_y, n_x = tangent_x.shape
    pixel = abs(float(tangent_x[0, 1] - tangent_x[0, 0]))
    total = np.zeros((n_y + WINDOW_PX, n_x + WINDOW_PX))
    for index, (layer, spec) in enumerate(zip(light, objects, strict=True)):
        centres_um, fields = _cells(spec.depth_m)
        flat = fields.reshape(len(fields), -1)
        for row, column in np.argwhere(layer > 0.0):
            open_ = np.ones(len(centres_um))
            for mask in objects[:index]:
                step = 1e-6 * (1.0 / mask.depth_m - 1.0 / spec.depth_m)
                sides = []
                for axis, tangent in enumerate((tangent_x, tangent_y)):
                    place = np.abs(tangent[row, column] + step * centres_um[:, axis] - mask.centre[axis])
                    sides.append(np.clip((0.5 * mask.size[axis] - place) / pixel + 0.5, 0.0, 1.0))
                open_ = np.maximum(open_ - sides[0] * sides[1], 0.0)
            # A cell that is open in part, at a pixel on an outline, lets its share of the pixel's points through.
            levels = np.unique(np.concatenate([[0.0], open_]))
            for low, high in itertools.pairwise(levels):
                field = (open_ >= high) @ flat
                irradiance = np.abs(field.reshape(WINDOW_PX, WINDOW_PX)) ** 2
                place = (slice(row, row + WINDOW_PX), slice(column, column + WINDOW_PX))
                total[place] += (high - low) * layer[row, column] * irradiance
    shape = total.shape
    return np.asarray(scipy.fft.irfft2(scipy.fft.rfft2(total) * pixel_transfer(shape), shape))
