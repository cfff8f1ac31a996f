"""Registration of the two images of a raw frame on one grid: the geometric image of the x polarisation."""

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
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread
from metafab.decode.registration.downsampling import outer_index
from metafab.decode.registration.resample import Resampler

#: Largest value of a valid pixel: squares of brighter ones would not fit single precision.
BRIGHTEST = 1e15
#: Pixels around a part of a frame from which its broken pixels and their neighbours are repaired.
_REPAIR_REACH_PX = 4
#: Types of frames that the compiled loops accept; all others are converted first.
_COMPILED_FOR = (np.dtype(np.float32), np.dtype(np.float64), np.dtype(np.uint8), np.dtype(np.uint16))
#: Knots along each axis of the splines through the maps, which vary slowly.
_KNOTS = 17


@dataclass(frozen=True)
class TwinGrid:
    """The place of each x image pixel's twin in frames of one shape.

    All maps cover the decoded window and a margin on all sides, from which blur comes in.
    """

    frame_shape: tuple[int, int]  #: (n_rows, n_columns) of the frames.
    origin_um: tuple[float, float]  #: (x, y) on the sensor of the decoded window's pixel [0, 0].
    pixel_um: float  #: Pixel pitch.
    shape: tuple[int, int]  #: (n_y, n_x) of the decoded window.
    margin: int  #: Pixels of the margin.
    row: int  #: Frame row of the first row of the margin.
    column: int  #: Frame column of the first column of the margin.
    tangent_x: FloatArray  #: Shape (n_y + 2 margin, n_x + 2 margin), x/z of the direction whose image is each pixel.
    tangent_y: FloatArray  #: Shape (n_y + 2 margin, n_x + 2 margin), y/z of that direction.
    twin_row: FloatArray  #: Shape (n_y + 2 margin, n_x + 2 margin), frame row (fractional) of the twin.
    twin_column: FloatArray  #: Shape (n_y + 2 margin, n_x + 2 margin), frame column (fractional) of the twin.
    twin_area: FloatArray  #: Shape (n_y + 2 margin, n_x + 2 margin), area in the y image per area in the x image.

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
        """The grid of a known window (row, column, rows, columns) of the x image."""
        first_row, first_column, rows, columns = window
        row, column = first_row - margin, first_column - margin
        x_um = np.asarray(origin_um[0] + pixel_um * (column + np.arange(columns + 2 * margin)), dtype=np.float64)
        y_um = np.asarray(origin_um[1] + pixel_um * (row + np.arange(rows + 2 * margin)), dtype=np.float64)
        tangent_x, tangent_y, twin_x_um, twin_y_um, area = _twin_maps(image_map, x_um, y_um)
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
            (twin_y_um - origin_um[1]) / pixel_um,
            (twin_x_um - origin_um[0]) / pixel_um,
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
        """The grid of all pixels of the calibrated field whose two images, blur included, lie in the frame, or None.

        The x image is searched on its side of the midline between the two images of the axis.
        """
        n_y, n_x = frame_shape
        axis_x, axis_y = image_map.coefficients_um[0, :, 0, 0]
        twin_axis_x, twin_axis_y = image_map.coefficients_um[1, :, 0, 0]
        split_x, split_y = twin_axis_x - axis_x, twin_axis_y - axis_y
        split = math.hypot(split_x, split_y)
        if split < 2.0 * pixel_um or n_y <= 2 * margin or n_x <= 2 * margin:
            return None
        step = max(1, min(n_y, n_x) // 64)
        rows, columns = np.arange(margin, n_y - margin, step), np.arange(margin, n_x - margin, step)
        x_um, y_um = np.meshgrid(origin_um[0] + pixel_um * columns, origin_um[1] + pixel_um * rows)
        from_midline = (x_um - 0.5 * (axis_x + twin_axis_x)) * split_x + (y_um - 0.5 * (axis_y + twin_axis_y)) * split_y
        tangents = image_map.to_tangent(0, x_um, y_um)
        twin_x_um, twin_y_um = image_map.to_sensor_um(1, *tangents)
        twin_column, twin_row = (twin_x_um - origin_um[0]) / pixel_um, (twin_y_um - origin_um[1]) / pixel_um
        inside = (
            (from_midline < 0.0)
            & image_map.covers(*tangents)
            & (twin_column > margin - 1)
            & (twin_column < n_x - margin)
            & (twin_row > margin - 1)
            & (twin_row < n_y - margin)
        )
        if not inside.any():
            return None
        # A row or column counts if the frame holds the twins of at least half as many of its pixels as of the best one.
        first_row, n_rows = _grown_range(rows, inside.sum(axis=1), step, n_y - margin)
        first_column, n_columns = _grown_range(columns, inside.sum(axis=0), step, n_x - margin)
        window = (first_row, first_column, n_rows, n_columns)
        return cls.at(image_map, frame_shape, origin_um, pixel_um, margin, window)

    def within(self, rows: slice, columns: slice) -> TwinGrid:
        """A part of the window, with the same margin."""
        left, bottom = self.origin_um
        wide = slice(rows.start, rows.stop + 2 * self.margin), slice(columns.start, columns.stop + 2 * self.margin)
        return replace(
            self,
            origin_um=(left + self.pixel_um * columns.start, bottom + self.pixel_um * rows.start),
            shape=(rows.stop - rows.start, columns.stop - columns.start),
            row=self.row + rows.start,
            column=self.column + columns.start,
            tangent_x=self.tangent_x[wide],
            tangent_y=self.tangent_y[wide],
            twin_row=self.twin_row[wide],
            twin_column=self.twin_column[wide],
            twin_area=self.twin_area[wide],
        )

    @cached_property
    def resampler(self) -> Resampler:
        """Interpolation of the y image on the grid, margin included."""
        return Resampler.of(self.twin_row, self.twin_column, self.frame_shape)

    @cached_property
    def area(self) -> NDArray[np.float32]:
        """``twin_area`` in single precision: shape (n_y + 2 margin, n_x + 2 margin)."""
        return self.twin_area.astype(np.float32)


@dataclass(frozen=True)
class Twins:
    """Both images of a frame on one grid, with margin."""

    grid: TwinGrid  #: The grid.
    image: NDArray[np.float32]  #: Shape (2, n_y + 2 margin, n_x + 2 margin), electrons per pixel of the x image.
    #: Shape (2, n_y + 2 margin, n_x + 2 margin), whether the frame is saturated or not a number there.
    broken: NDArray[np.bool_]

    @cached_property
    def bad(self) -> NDArray[np.bool_]:
        """Whether either image is broken at a pixel of the window: shape (n_y, n_x)."""
        inside = slice(self.grid.margin, -self.grid.margin or None)
        return self.broken[0, inside, inside] | self.broken[1, inside, inside]

    def within(self, rows: slice, columns: slice) -> Twins:
        """A part of the window, with the same margin."""
        m = self.grid.margin
        wide = slice(rows.start, rows.stop + 2 * m), slice(columns.start, columns.stop + 2 * m)
        return Twins(self.grid.within(rows, columns), self.image[:, *wide], self.broken[:, *wide])


def extract(frame: RawFrame, grid: TwinGrid) -> Twins:
    """Register both images of a frame; broken pixels are marked and replaced by the mean of their neighbours."""
    return Twins(grid, *extract_part(frame, grid, *(slice(0, n) for n in grid.shape)))


def extract_part(
    frame: RawFrame, grid: TwinGrid, rows: slice, columns: slice
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Register a part, n_y rows and n_x columns, of the window of a frame of the grid's shape.

    Returns:
        ``image`` and ``broken`` of :class:`Twins`, shapes (2, n_y + 2 margin, n_x + 2 margin).
    """
    m = grid.margin
    wide = slice(rows.start, rows.stop + 2 * m), slice(columns.start, columns.stop + 2 * m)
    whole = (rows.stop - rows.start, columns.stop - columns.start) == grid.shape
    resampler = grid.resampler if whole else grid.resampler.within(*wide)
    shape = wide[0].stop - wide[0].start, wide[1].stop - wide[1].start
    corner = grid.row + wide[0].start, grid.column + wide[1].start
    # Frame rows that either image needs, and those from which their broken pixels are repaired.
    counts = np.asarray(frame.frame)
    first = max(0, min(corner[0], resampler.first_row, counts.shape[0] - 1) - _REPAIR_REACH_PX)
    last = max(corner[0] + shape[0], resampler.first_row + resampler.column.shape[0]) + _REPAIR_REACH_PX
    limit = np.inf if frame.saturation_e is None else float(frame.saturation_e)
    values, broken = validated(compilable(counts[first:last]), limit)
    corner, resampler = (corner[0] - first, corner[1]), replace(resampler, first_row=resampler.first_row - first)
    any_broken = bool(broken.any())
    if any_broken:
        values = _repaired(values, broken)
    image = np.empty((2, *shape), dtype=np.float32)
    image[0] = crop(values, corner, shape)
    np.multiply(resampler(values), grid.area[wide], out=image[1])
    marked = np.zeros(image.shape, dtype=bool)
    if any_broken:
        marked[0] = crop(broken, corner, shape)
        marked[1] = resampler(uniform_filter(broken.astype(np.float32), 3)) > 0.05
    return image, marked


def compilable(values: NDArray[Any]) -> NDArray[Any]:
    """Pixel values of any shape in a type for which the loops over frames are compiled."""
    array = np.asarray(values)
    return array if array.dtype in _COMPILED_FOR else array.astype(np.float64)


def _twin_maps(image_map: ImageMap, x_um: FloatArray, y_um: FloatArray) -> tuple[FloatArray, ...]:
    """Tangents (x, y) of the directions imaged at places of the x image, places (x, y) of the twins, relative area.

    All are solved at a few knots and interpolated: shapes (y_um.size, x_um.size).
    """
    knots_y, knots_x = np.linspace(y_um[0], y_um[-1], _KNOTS), np.linspace(x_um[0], x_um[-1], _KNOTS)
    tangents = image_map.to_tangent(0, *np.meshgrid(knots_x, knots_y))
    area = image_map.area_um2(1, *tangents) / image_map.area_um2(0, *tangents)
    at_knots = (*tangents, *image_map.to_sensor_um(1, *tangents), area)
    return tuple(
        np.asarray(RectBivariateSpline(knots_y, knots_x, values, kx=5, ky=5)(y_um, x_um)) for values in at_knots
    )


def validated(counts: NDArray[Any], saturation: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Check the pixels of a frame, shape (n_rows, n_columns), which saturate at a level.

    Returns values in single precision, NaN where a pixel is not a number or too bright, and whether it is one of these
    or saturated.
    """
    values = np.empty(counts.shape, dtype=np.float32)
    broken = np.empty(counts.shape, dtype=np.bool_)
    spread(_validate, counts.shape[0], counts, saturation, values, broken)
    return values, broken


@compiled
def _validate(
    first: int,
    stop: int,
    counts: NDArray[Any],
    saturation: float,
    values: NDArray[np.float32],
    broken: NDArray[np.bool_],
) -> None:
    for i in range(first, stop):
        for j in range(counts.shape[1]):
            value = np.float64(counts[i, j])
            valid = abs(value) < BRIGHTEST
            values[i, j] = value if valid else np.nan
            broken[i, j] = not valid or value >= saturation


def crop(values: NDArray[Any], corner: tuple[int, int], shape: tuple[int, int]) -> NDArray[Any]:
    """Cut a part of shape (n_y, n_x) out of a frame, shape (n_rows, n_columns), from the corner (row, column) on.

    Beyond the frame, the value of its edge is taken.
    """
    (row, column), (n_y, n_x) = corner, shape
    if row >= 0 and column >= 0 and row + n_y <= values.shape[0] and column + n_x <= values.shape[1]:
        return values[row : row + n_y, column : column + n_x]
    rows = np.clip(row + np.arange(n_y), 0, values.shape[0] - 1)
    return outer_index(values, rows, np.clip(column + np.arange(n_x), 0, values.shape[1] - 1))


def _repaired(values: NDArray[np.float32], broken: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Broken pixels replaced by the mean of the valid ones in a window; where there are none, saturated ones stay."""
    finite = np.where(np.isfinite(values), values, 0.0)
    share = uniform_filter((~broken).astype(np.float32), 5, mode="nearest")
    mean = uniform_filter(np.where(broken, 0.0, finite), 5, mode="nearest") / np.maximum(share, 0.01)
    return np.asarray(np.where(broken, np.where(share > 0.02, mean, finite), finite), dtype=np.float32)


def _grown_range(places: NDArray[np.intp], hits: NDArray[np.intp], step: int, end: int) -> tuple[int, int]:
    """First pixel and length of the coarse ``places`` with at least half of the most hits, widened by under a step."""
    chosen = places[hits >= 0.5 * max(1, hits.max())]
    first, last = max(int(places[0]), int(chosen[0]) - step + 1), min(end - 1, int(chosen[-1]) + step - 1)
    return first, last - first + 1
