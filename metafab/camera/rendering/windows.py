"""The rectangles of the sensor that light lands on, and how much of it a pixel collects from where."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.camera.geometry import ImageMap
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.point_spread import Psf
from metafab.spec.scene import Scene


@dataclass(frozen=True)
class Window:
    """A rectangle of sensor pixels, with the direction that each pixel is the geometric image of.

    Attributes:
        column: sensor column (x_um / pixel_um) of the first pixel; likewise ``row``.
        tangent_x: shape (n_y, n_x); likewise ``tangent_y``.
        seen: shape (n_y, n_x), 1 inside the field stop, 0 outside.
        gain: shape (n_y, n_x), electrons at brightness 1: those on the axis times the solid angle behind a pixel and
            what vignetting leaves.
    """

    column: int
    row: int
    tangent_x: FloatArray
    tangent_y: FloatArray
    seen: FloatArray
    gain: FloatArray


def sensor_windows(scene: Scene, psf: Psf, image_map: ImageMap) -> tuple[Window, Window]:
    """The x polarisation's window of ``field_px`` pixels about the axis, and the one that holds its twin."""
    pixel = psf.pixel_um
    n_y, n_x = scene.field_px
    axis_x, axis_y = image_map.coefficients_um[0, :, 0, 0]
    column, row = round(axis_x / pixel) - n_x // 2, round(axis_y / pixel) - n_y // 2
    edges = (np.arange(n_x + 1) - 0.5 + column) * pixel, (np.arange(n_y + 1) - 0.5 + row) * pixel
    outline_x = np.concatenate([edges[0], edges[0], np.full(n_y + 1, edges[0][0]), np.full(n_y + 1, edges[0][-1])])
    outline_y = np.concatenate([np.full(n_x + 1, edges[1][0]), np.full(n_x + 1, edges[1][-1]), edges[1], edges[1]])
    twin_x, twin_y = image_map.to_sensor_um(1, *image_map.to_tangent(0, outline_x, outline_y))
    twin_column, twin_row = math.floor(twin_x.min() / pixel + 0.5), math.floor(twin_y.min() / pixel + 0.5)
    twin_n_x = math.ceil(twin_x.max() / pixel - 0.5) - twin_column + 1
    twin_n_y = math.ceil(twin_y.max() / pixel - 0.5) - twin_row + 1
    apart = abs(twin_column - column) >= (n_x if twin_column > column else twin_n_x) or abs(twin_row - row) >= (
        n_y if twin_row > row else twin_n_y
    )
    if not apart:
        raise InputError.single(
            "scene",
            "field_px",
            "a field whose two images lie side by side",
            f"{n_y} x {n_x} pixels, with the images {abs(twin_column - column)} columns apart",
            "make the field smaller or split by a larger angle",
        )
    first = _window(image_map, 0, pixel, column, row, n_x, n_y, scene, None)
    stop = (edges[0][0], edges[0][-1], edges[1][0], edges[1][-1])
    second = _window(image_map, 1, pixel, twin_column, twin_row, twin_n_x, twin_n_y, scene, stop)
    return first, second


def _window(
    image_map: ImageMap,
    polarisation: int,
    pixel: float,
    column: int,
    row: int,
    n_x: int,
    n_y: int,
    scene: Scene,
    stop: tuple[float, float, float, float] | None,
) -> Window:
    x_um, y_um = np.meshgrid((column + np.arange(n_x)) * pixel, (row + np.arange(n_y)) * pixel)
    tangent_x, tangent_y = image_map.to_tangent(polarisation, x_um, y_um)
    axis = np.zeros(1)
    # Irradiance falls where the image is stretched, and with the aperture and the surface seen under an angle.
    gain = image_map.area_um2(0, axis, axis) / image_map.area_um2(polarisation, tangent_x, tangent_y)
    gain *= scene.photons_per_pixel * scene.quantum_efficiency
    if scene.vignetting == "natural":
        gain /= (1.0 + tangent_x**2 + tangent_y**2) ** 2
    if stop is None:
        return Window(column, row, tangent_x, tangent_y, np.ones((n_y, n_x)), gain)
    in_x, in_y = image_map.to_sensor_um(0, tangent_x, tangent_y)
    seen_x = np.clip(np.minimum(in_x - stop[0], stop[1] - in_x) / pixel + 0.5, 0.0, 1.0)
    seen_y = np.clip(np.minimum(in_y - stop[2], stop[3] - in_y) / pixel + 0.5, 0.0, 1.0)
    return Window(column, row, tangent_x, tangent_y, seen_x * seen_y, gain)
