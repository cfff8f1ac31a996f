"""Locate the two images in a raw frame and bring them onto one grid: the geometric image of the x polarisation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import uniform_filter

from metafab.camera.frames.frame import RawFrame
from metafab.camera.geometry import ImageMap
from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled_parallel, prange
from metafab.decode.registration.reduce import taken
from metafab.decode.registration.resample import Resampler

#: Squares of brighter values would not fit single precision; nothing real comes near.
BRIGHTEST = 1e15
#: How far around a part of a frame its broken pixels' neighbours and theirs are.
_MENDED_PX = 4
#: What frames are made of, in the machine's byte order; all else is converted first.
_COMPILED_FOR = (np.dtype(np.float32), np.dtype(np.float64), np.dtype(np.uint8), np.dtype(np.uint16))


@dataclass(frozen=True)
class TwinGrid:
    """Where the twin of each pixel of the x image stands in a frame of a given shape.

    All maps cover the decoded window and a margin all around, from which blur comes in.

    Attributes:
        frame_shape: shape of the frames that it is made for.
        origin_um: (x, y) on the sensor of the decoded window's pixel [0, 0].
        pixel_um: pitch of the pixels.
        shape: (n_y, n_x) of the decoded window.
        margin: pixels all around.
        row: frame row of the first row of the margin; likewise ``column``.
        tangent_x: shape (n_y + 2 margin, n_x + 2 margin), direction behind each pixel; likewise ``tangent_y``.
        twin_row: the same shape, frame row (fractional) of the twin; likewise ``twin_column``.
        twin_area: the same shape, area in the y image per area in the x image.
    """

    frame_shape: tuple[int, int]
    origin_um: tuple[float, float]
    pixel_um: float
    shape: tuple[int, int]
    margin: int
    row: int
    column: int
    tangent_x: FloatArray
    tangent_y: FloatArray
    twin_row: FloatArray
    twin_column: FloatArray
    twin_area: FloatArray

    @classmethod
    def at(
        cls,
        image_map: ImageMap,
        frame_shape: tuple[int, int],
        origin_um: tuple[float, float],
        pixel_um: float,
        margin: int,
        window: tuple[int, int, int, int],
    ) -> TwinGrid:
        """The grid of a known window (row, column, rows, columns)."""
        first_row, first_column, rows, columns = window
        row, column = first_row - margin, first_column - margin
        x_um = np.asarray(origin_um[0] + pixel_um * (column + np.arange(columns + 2 * margin)), dtype=np.float64)
        y_um = np.asarray(origin_um[1] + pixel_um * (row + np.arange(rows + 2 * margin)), dtype=np.float64)
        tangent_x, tangent_y, place_x, place_y, area = _maps(image_map, x_um, y_um)
        return cls(
            frame_shape,
            (float(x_um[margin]), float(y_um[margin])),
            pixel_um,
            (rows, columns),
            margin,
            row,
            column,
            tangent_x,
            tangent_y,
            (place_y - origin_um[1]) / pixel_um,
            (place_x - origin_um[0]) / pixel_um,
            area,
        )

    @classmethod
    def find(
        cls,
        image_map: ImageMap,
        frame_shape: tuple[int, int],
        origin_um: tuple[float, float],
        pixel_um: float,
        margin: int,
    ) -> TwinGrid | None:
        """All pixels of the calibrated field whose two images, blur included, lie in the frame; None if there are none.

        The x image is looked for on its own side of the midline between the two images of the axis.
        """
        n_y, n_x = frame_shape
        axis_x, axis_y = image_map.coefficients_um[0, :, 0, 0]
        twin_x, twin_y = image_map.coefficients_um[1, :, 0, 0]
        x_um = origin_um[0] + pixel_um * np.arange(n_x)
        y_um = origin_um[1] + pixel_um * np.arange(n_y)
        # Along the line that joins the images, each keeps to its half.
        split_x, split_y = twin_x - axis_x, twin_y - axis_y
        span = math.hypot(split_x, split_y)
        if span < 2.0 * pixel_um or n_y <= 2 * margin or n_x <= 2 * margin:
            return None
        every = max(1, min(n_y, n_x) // 64)
        rows, columns = np.arange(margin, n_y - margin), np.arange(margin, n_x - margin)
        some_rows, some_columns = rows[::every], columns[::every]
        grid_x, grid_y = np.meshgrid(x_um[some_columns], y_um[some_rows])
        along = ((grid_x - 0.5 * (axis_x + twin_x)) * split_x + (grid_y - 0.5 * (axis_y + twin_y)) * split_y) / span
        tangents = image_map.to_tangent(0, grid_x, grid_y)
        place_x, place_y = image_map.to_sensor_um(1, *tangents)
        twin_column = (place_x - origin_um[0]) / pixel_um
        twin_row = (place_y - origin_um[1]) / pixel_um
        inside = (
            (along < 0.0)
            & image_map.covers(*tangents)
            & (twin_column > margin - 1)
            & (twin_column < n_x - margin)
            & (twin_row > margin - 1)
            & (twin_row < n_y - margin)
        )
        # A row or column counts if the twins of most of the pixels that it could have are in the frame.
        good_rows = some_rows[inside.sum(axis=1) >= 0.5 * max(1, inside.sum(axis=1).max())]
        good_columns = some_columns[inside.sum(axis=0) >= 0.5 * max(1, inside.sum(axis=0).max())]
        if not inside.any():
            return None
        first_row, last_row = _grown(good_rows, every, margin, n_y)
        first_column, last_column = _grown(good_columns, every, margin, n_x)
        window = (first_row, first_column, last_row - first_row + 1, last_column - first_column + 1)
        return cls.at(image_map, frame_shape, origin_um, pixel_um, margin, window)

    def within(self, rows: slice, columns: slice) -> TwinGrid:
        """A part of the window, with the same margin."""
        left, bottom = self.origin_um
        wide = slice(rows.start, rows.stop + 2 * self.margin), slice(columns.start, columns.stop + 2 * self.margin)
        return TwinGrid(
            self.frame_shape,
            (left + self.pixel_um * columns.start, bottom + self.pixel_um * rows.start),
            self.pixel_um,
            (rows.stop - rows.start, columns.stop - columns.start),
            self.margin,
            self.row + rows.start,
            self.column + columns.start,
            *(map_[wide] for map_ in self._maps),
        )

    @property
    def _maps(self) -> tuple[FloatArray, ...]:
        return self.tangent_x, self.tangent_y, self.twin_row, self.twin_column, self.twin_area

    @cached_property
    def resampler(self) -> Resampler:
        """Brings the y image onto the grid, margin included."""
        return Resampler.of(self.twin_row, self.twin_column, self.frame_shape)

    @cached_property
    def area(self) -> NDArray[np.float32]:
        """``twin_area`` in the precision of images."""
        return self.twin_area.astype(np.float32)

    @property
    def inner(self) -> tuple[slice, slice]:
        """The decoded window inside the maps with margin."""
        m = self.margin
        return slice(m, m + self.shape[0]), slice(m, m + self.shape[1])


@dataclass(frozen=True)
class Twins:
    """The two images on one grid, with margin.

    Attributes:
        grid: where they come from.
        image: shape (2, n_y + 2 margin, n_x + 2 margin), single precision, electrons a pixel of the x image.
        bad: shape (n_y, n_x), pixels (without margin) where the frame is saturated or not a number.
    """

    grid: TwinGrid
    image: NDArray[np.float32]
    bad: NDArray[np.bool_]

    def within(self, rows: slice, columns: slice) -> Twins:
        """Those of a part of the window."""
        m = self.grid.margin
        image = self.image[:, rows.start : rows.stop + 2 * m, columns.start : columns.stop + 2 * m]
        return Twins(self.grid.within(rows, columns), image, self.bad[rows, columns])


def _maps(image_map: ImageMap, x_um: FloatArray, y_um: FloatArray) -> tuple[FloatArray, ...]:
    """Of a grid of the x image: directions behind it along x and y, places of its twins, and their relative area.

    All are solved on some of the grid and interpolated, for they vary slowly.
    """
    knots_y, knots_x = np.linspace(y_um[0], y_um[-1], 17), np.linspace(x_um[0], x_um[-1], 17)
    tangents = image_map.to_tangent(0, *np.meshgrid(knots_x, knots_y))
    area = image_map.area_um2(1, *tangents) / image_map.area_um2(0, *tangents)
    some = (*tangents, *image_map.to_sensor_um(1, *tangents), area)
    return tuple(np.asarray(RectBivariateSpline(knots_y, knots_x, part, kx=5, ky=5)(y_um, x_um)) for part in some)


def extract(frame: RawFrame, grid: TwinGrid) -> Twins:
    """Both images from a frame; broken pixels are replaced by their neighbours' mean and marked."""
    return Twins(grid, *extract_part(frame, grid, *(slice(0, n) for n in grid.shape)))


def extract_part(
    frame: RawFrame, grid: TwinGrid, rows: slice, columns: slice
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """``image`` and ``bad`` of :class:`Twins` in some rows and columns of the window and the margin about them."""
    m = grid.margin
    wide = slice(rows.start, rows.stop + 2 * m), slice(columns.start, columns.stop + 2 * m)
    whole = (rows.stop - rows.start, columns.stop - columns.start) == grid.shape
    resampler = grid.resampler if whole else grid.resampler.within(*wide)
    shape = wide[0].stop - wide[0].start, wide[1].stop - wide[1].start
    at = grid.row + wide[0].start, grid.column + wide[1].start
    # Rows of the frame that either image needs, and what broken pixels there are mended from.
    given = np.asarray(frame.frame)
    first = max(0, min(at[0], resampler.first_row, given.shape[0] - 1) - _MENDED_PX)
    last = max(at[0] + shape[0], resampler.first_row + resampler.column.shape[0]) + _MENDED_PX
    limit = np.inf if frame.saturation_e is None else float(frame.saturation_e)
    values, broken = _checked(given[first:last], limit)
    at, resampler = (at[0] - first, at[1]), replace(resampler, first_row=resampler.first_row - first)
    any_broken = bool(broken.any())
    if any_broken:
        values = _mended(values, broken)
    image = np.empty((2, *shape), dtype=np.float32)
    image[0] = _cut(values, at, shape)
    np.multiply(resampler(values), grid.area[wide], out=image[1])
    bad = np.zeros(shape, dtype=bool)
    if any_broken:
        bad = _cut(broken, at, shape) | (resampler(uniform_filter(broken.astype(np.float32), 3)) > 0.05)
    return image, bad[m : shape[0] - m, m : shape[1] - m]


def readable(given: NDArray[Any]) -> NDArray[Any]:
    """Values of a type that loops are compiled for."""
    values = np.asarray(given)
    return values if values.dtype in _COMPILED_FOR else values.astype(np.float64)


def _checked(given: NDArray[Any], saturation: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Values in single precision, and which of them are saturated, too bright or not a number."""
    given = readable(given)
    if HAS_NUMBA:
        return _checked_loop(given, saturation)
    with np.errstate(over="ignore", invalid="ignore"):
        fine = np.abs(given) < BRIGHTEST
        return np.where(fine, given, np.nan).astype(np.float32), ~fine | (given >= saturation)


@compiled_parallel
def _checked_loop(given: NDArray[Any], saturation: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    values = np.empty(given.shape, dtype=np.float32)
    broken = np.empty(given.shape, dtype=np.bool_)
    for i in prange(given.shape[0]):
        for j in range(given.shape[1]):
            value = np.float64(given[i, j])
            fine = abs(value) < BRIGHTEST
            values[i, j] = value if fine else np.nan
            broken[i, j] = not fine or value >= saturation
    return values, broken


def _cut(values: NDArray[Any], at: tuple[int, int], shape: tuple[int, int]) -> NDArray[Any]:
    """A part of the frame that starts at some row and column; beyond the frame, the frame's edge."""
    (row, column), (n_y, n_x) = at, shape
    if row >= 0 and column >= 0 and row + n_y <= values.shape[0] and column + n_x <= values.shape[1]:
        return values[row : row + n_y, column : column + n_x]
    rows, columns = (
        np.clip(first + np.arange(size), 0, have - 1) for first, size, have in zip(at, shape, values.shape, strict=True)
    )
    return taken(values, rows, columns)


def _mended(values: NDArray[np.float32], broken: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Broken pixels as the mean of the good ones near them; where there are none, saturated ones stay full."""
    finite = np.where(np.isfinite(values), values, 0.0)
    share = uniform_filter((~broken).astype(np.float32), 5, mode="nearest")
    mean = uniform_filter(np.where(broken, 0.0, finite), 5, mode="nearest") / np.maximum(share, 0.01)
    return np.asarray(np.where(broken, np.where(share > 0.02, mean, finite), finite), dtype=np.float32)


def _grown(chosen: np.ndarray, every: int, margin: int, count: int) -> tuple[int, int]:
    """First and last index of a coarse choice, grown to what the coarse grid may have missed."""
    return max(margin, int(chosen[0]) - every + 1), min(count - margin - 1, int(chosen[-1]) + every - 1)
