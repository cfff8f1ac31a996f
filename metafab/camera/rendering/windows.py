"""The rectangles of the sensor on which the two images lie, and the light that their pixels collect."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.camera.geometry import ImageMap
from metafab.camera.rendering.occlusion import PINHOLE
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.limits import beyond, limit
from metafab.optics.point_spread import Psf
from metafab.spec.scene import Scene

#: Memory of a frame for each pixel of the field (bytes; 190 to 250 measured), and what it may take by default (MB).
_BYTES_OF_A_PIXEL, _MOST_MB = 256, 4096.0


@dataclass(frozen=True)
class Window:
    """A rectangle of sensor pixels, with the direction whose geometric image each pixel is."""

    column: int  #: Sensor column (x_um / pixel_um) of the first pixel.
    row: int  #: Sensor row of the first pixel.
    tangent_x: FloatArray  #: Shape (n_y, n_x), x/z of the direction.
    tangent_y: FloatArray  #: Shape (n_y, n_x), y/z of the direction.
    stop: FloatArray  #: Shape (n_y, n_x), transmission of the field stop, 0 to 1.
    #: Shape (n_y, n_x), electrons at brightness 1: those on the axis times the pixel's solid angle and the vignetting.
    gain: FloatArray

    @classmethod
    def of(
        cls,
        scene: Scene,
        pixel_um: float,
        image_map: ImageMap,
        polarisation: int,
        corner: tuple[int, int],
        shape: tuple[int, int],
    ) -> Window:
        """A window from its corner (column, row) and shape (n_y, n_x); the field stop lets all of it pass."""
        (column, row), (n_y, n_x) = corner, shape
        x_um, y_um = np.meshgrid((column + np.arange(n_x)) * pixel_um, (row + np.arange(n_y)) * pixel_um)
        tangent_x, tangent_y = image_map.to_tangent(polarisation, x_um, y_um)
        axis = np.zeros(1)
        # Irradiance falls where the image is stretched, and with the cosines of the aperture and the surface.
        gain = image_map.area_um2(0, axis, axis) / image_map.area_um2(polarisation, tangent_x, tangent_y)
        gain *= scene.photons_per_pixel * scene.quantum_efficiency
        if scene.vignetting == "natural":
            gain /= (1.0 + tangent_x**2 + tangent_y**2) ** 2
        return cls(column, row, tangent_x, tangent_y, np.ones(shape), gain)


def shifts_px_m(aperture_um: FloatArray | None, tangent_x: FloatArray, tangent_y: FloatArray) -> FloatArray:
    """Parallax: shift (columns, rows) of an outline seen from points of the aperture, pixels for each 1/m.

    The shift is proportional to the difference in vergence (1/m) of the surfaces before and behind the outline.
    ``aperture_um`` and the result have the shape (n, 2); a pinhole (None) has one point without shift. The grid of
    directions, shape (n_y, n_x) each, gives the angle of a pixel.
    """
    if aperture_um is None:
        return PINHOLE
    slopes = np.diff(tangent_x, axis=1).mean(), np.diff(tangent_y, axis=0).mean()
    return np.asarray(1e-6 * aperture_um / slopes)


def sensor_windows(scene: Scene, psf: Psf, image_map: ImageMap) -> tuple[Window, Window]:
    """The x polarisation's window of ``field_px`` pixels about the axis, and the y polarisation's of the same field.

    Images that overlap, or that take more memory than 4 GB and the limit ``memory_mb``, raise InputError.
    """
    pixel = psf.pixel_um
    n_y, n_x = scene.field_px
    most_mb = max(_MOST_MB, limit("memory_mb", _MOST_MB))  # a lower one is meant for files
    if n_y * n_x * _BYTES_OF_A_PIXEL > 1e6 * most_mb:
        most = f"at most {1e6 * most_mb / _BYTES_OF_A_PIXEL:.3g} pixels of the field, for {most_mb:g} MB"
        got = f"{n_y} x {n_x}, which take {math.ceil(1e-6 * n_y * n_x * _BYTES_OF_A_PIXEL)} MB"
        raise beyond("scene", "field_px", "memory_mb", most, got, "use a smaller field")
    axis_x, axis_y = image_map.coefficients_um[0, :, 0, 0]
    column, row = round(axis_x / pixel) - n_x // 2, round(axis_y / pixel) - n_y // 2
    edge_x, edge_y = (np.arange(n_x + 1) - 0.5 + column) * pixel, (np.arange(n_y + 1) - 0.5 + row) * pixel
    outline_x = np.concatenate([edge_x, edge_x, np.full(n_y + 1, edge_x[0]), np.full(n_y + 1, edge_x[-1])])
    outline_y = np.concatenate([np.full(n_x + 1, edge_y[0]), np.full(n_x + 1, edge_y[-1]), edge_y, edge_y])
    twin_x, twin_y = image_map.to_sensor_um(1, *image_map.to_tangent(0, outline_x, outline_y))
    twin_column, twin_row = math.floor(twin_x.min() / pixel + 0.5), math.floor(twin_y.min() / pixel + 0.5)
    twin_n_x = math.ceil(twin_x.max() / pixel - 0.5) - twin_column + 1
    twin_n_y = math.ceil(twin_y.max() / pixel - 0.5) - twin_row + 1
    beside = abs(twin_column - column) >= (n_x if twin_column > column else twin_n_x)
    above = abs(twin_row - row) >= (n_y if twin_row > row else twin_n_y)
    if not beside and not above:
        expected = "a field whose two images lie side by side"
        got = f"{n_y} x {n_x} pixels, with the images {abs(twin_column - column)} columns apart"
        raise InputError.single("scene", "field_px", expected, got, "make the field smaller or split by a larger angle")
    first = Window.of(scene, pixel, image_map, 0, (column, row), (n_y, n_x))
    twin = Window.of(scene, pixel, image_map, 1, (twin_column, twin_row), (twin_n_y, twin_n_x))
    x_um, y_um = image_map.to_sensor_um(0, twin.tangent_x, twin.tangent_y)
    stop_x = np.clip(np.minimum(x_um - edge_x[0], edge_x[-1] - x_um) / pixel + 0.5, 0.0, 1.0)
    stop_y = np.clip(np.minimum(y_um - edge_y[0], edge_y[-1] - y_um) / pixel + 0.5, 0.0, 1.0)
    return first, Window(twin.column, twin.row, twin.tangent_x, twin.tangent_y, stop_x * stop_y, twin.gain)
