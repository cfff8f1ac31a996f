"""A picture with its depth (RGB-D) as surfaces: continuous depths, holes, and what geometry hides at outlines.

Each pixel is blurred at its own depth (:mod:`metafab.camera.rendering.depth_blur`). Behind an outline, the farther
surface keeps its depth and light at the outline, as far as any aperture point sees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.distance import nearest
from metafab.core.parallel.executor import spread
from metafab.spec.scene import Scene

#: Smallest brightness relative to the picture's mean: no surface is blacker.
_DARKEST = 0.02
#: Least jump of depth that is an outline: pixels by which its sides shift against each other, seen from the rim of
#: the aperture instead of its centre.
_OUTLINE_PX = 1.0


def require_objects(scene: Scene) -> None:
    """Raise InputError for a picture with its depth where only objects can be photographed."""
    if scene.rgbd is not None:
        remedy = "give `objects`, or photograph it with a pair over depth"
        raise InputError.single("scene", "rgbd", "objects at depths of their own", "a picture with its depth", remedy)


@dataclass(frozen=True)
class DepthPicture:
    """A picture with its depth on the pixels of a field."""

    brightness: FloatArray  #: Shape (n_y, n_x), mean 1, top row first.
    depth_m: FloatArray  #: Shape (n_y, n_x), nearest neighbour of the file's; NaN for a hole.
    contrast: FloatArray  #: Shape (n_y, n_x), I_x / I_y.
    extent: tuple[float, float]  #: (x/z, y/z) from the middle to the sides.
    is_scaled: bool = False  #: Whether the scene scales the file's depths.

    @classmethod
    def of(cls, scene: Scene, pixel_tangent: float) -> DepthPicture:
        """Read the files of a scene; InputError if one cannot be read, or shapes and values do not fit."""
        if scene.rgbd is None:
            raise InputError.single("scene", "rgbd", "a picture with its depth", "none")
        shape, is_scaled = scene.field_px, scene.rgbd.depth_range_m is not None
        light, depth_m, contrast = scene.rgbd.arrays()
        # Relative to the largest value first: resampling is in single precision, and the light in any unit.
        light = light / light.max()
        brightness = np.maximum(_averaged(light / light.mean(), shape), _DARKEST)
        half = (0.5 * pixel_tangent * shape[1], 0.5 * pixel_tangent * shape[0])
        places = [((np.arange(n) + 0.5) * m / n).astype(int) for n, m in zip(shape, depth_m.shape, strict=True)]
        return cls(brightness, depth_m[np.ix_(*places)], _averaged(contrast, shape), half, is_scaled)

    def at(self, tangent_x: FloatArray, tangent_y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Brightness, depth and contrast in directions of shape (n_y, n_x); the rim goes on beyond the picture."""
        n_y, n_x = self.brightness.shape
        column = 0.5 * (tangent_x / self.extent[0] + 1.0) * n_x - 0.5
        row = 0.5 * (1.0 - tangent_y / self.extent[1]) * n_y - 0.5
        place = np.stack([row, column])
        brightness, contrast = (
            map_coordinates(values, place, order=1, mode="nearest") for values in (self.brightness, self.contrast)
        )
        return brightness, map_coordinates(self.depth_m, place, order=0, mode="nearest"), contrast

    def require_inside(self, calibrated_m: FloatArray) -> None:
        """Raise InputError if depths are outside the calibrated ones, shape (n,)."""
        known = self.depth_m[np.isfinite(self.depth_m)]
        nearest, farthest = calibrated_m.min(), calibrated_m.max()
        if not known.size or (known.min() >= nearest * (1.0 - 1e-9) and known.max() <= farthest * (1.0 + 1e-9)):
            return
        expected = f"depths inside the PSF calibration, {nearest:g} to {farthest:g} m"
        field = "rgbd.depth_range_m" if self.is_scaled else "rgbd.depth_file"
        remedy = "change the range" if self.is_scaled else "scale them by `depth_range_m`"
        remedy += ", or calibrate the PSF over their range (`metafab psf --depths-m ...`)"
        raise InputError.single("scene", field, expected, f"{known.min():g} to {known.max():g} m", remedy)


@dataclass(frozen=True)
class Surface:
    """A surface of continuous depth on a pixel grid, before any blur."""

    light: FloatArray  #: Shape (n_y, n_x), light that it would send if nothing stood before it; 0 in holes.
    share: FloatArray  #: Shape (n_y, n_x), share of the aperture that sees each pixel; 0 where the surface is not.
    vergence_per_m: FloatArray  #: Shape (n_y, n_x), 1/depth; in holes that of the nearest known pixel.


def surfaces(
    picture: DepthPicture,
    tangent_x: FloatArray,
    tangent_y: FloatArray,
    calibrated_m: FloatArray,
    shifts_px_m: FloatArray,
    polarisation: int,
) -> list[Surface]:
    """Return the surfaces that the aperture sees: that of the picture, and its continuation behind outlines.

    The list is empty where no depth is known.

    Args:
        tangent_x: shape (n_y, n_x), x/z of the grid's directions; likewise ``tangent_y``.
        calibrated_m: shape (n,), calibrated depths; InputError for depths outside of them.
        shifts_px_m: shape (n, 2), shift (columns, rows) of outlines by each aperture point, pixels per 1/m.
        polarisation: 0 for x, 1 for y.
    """
    light, depth_m, contrast = picture.at(tangent_x, tangent_y)
    light = light * (2.0 * contrast if polarisation == 0 else 2.0) / (1.0 + contrast)
    known = np.isfinite(depth_m)
    if not known.any():
        return []
    picture.require_inside(calibrated_m)
    # Holes hide nothing and have no light: they count as infinitely far.
    vergence = np.where(known, 1.0 / np.where(known, depth_m, 1.0), 0.0)
    reach = float(np.abs(shifts_px_m).max())
    _, row, column = nearest(known)
    share = _open_share(vergence, vergence, known, shifts_px_m)
    found = [Surface(light * known, share, vergence[row, column])]
    if reach > 0.0:
        behind, behind_light, hidden = _behind(vergence, light, known, reach)
        if hidden.any():
            found.append(
                Surface(behind_light * hidden, hidden * _open_share(vergence, behind, hidden, shifts_px_m), behind)
            )
    return found


def _jump(reach_px_m: float) -> float:
    return _OUTLINE_PX / reach_px_m if reach_px_m > 0.0 else np.inf


def _behind(
    vergence: FloatArray, light: FloatArray, known: NDArray[np.bool_], reach_px_m: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Vergence and light of the farthest known surface within the aperture's reach, and where it is behind another."""
    margin = int(np.ceil(reach_px_m * float(np.ptp(vergence[known])))) + 1
    order = np.argsort(np.where(known, vergence, np.inf), axis=None)
    rank = np.empty(order.size)
    rank[order] = np.arange(order.size)
    farthest = order[minimum_filter(rank.reshape(vergence.shape), 2 * margin + 1, mode="nearest").astype(np.intp)]
    behind, behind_light = vergence.ravel()[farthest], light.ravel()[farthest]
    return behind, behind_light, np.logical_and(known, vergence - behind > _jump(reach_px_m))


def _open_share(
    vergence: FloatArray, start: FloatArray, asked: NDArray[np.bool_], shifts_px_m: FloatArray
) -> FloatArray:
    """Share of the aperture that sees points of vergence ``start`` past the surface; 1 if not asked: (n_y, n_x)."""
    reach = float(np.abs(shifts_px_m).max())
    jump, share = _jump(reach), np.ones(vergence.shape)
    if reach == 0.0:
        return share
    highest = highest_met(vergence, start, float(np.hypot(*shifts_px_m.T).max()), jump)
    rows, columns = np.nonzero(np.logical_and(asked, highest > start))
    if rows.size:
        open_share, ends = np.zeros(rows.size), (start[rows, columns], highest[rows, columns])
        spread(_march, rows.size, vergence, *ends, rows, columns, shifts_px_m, jump, open_share)
        share[rows, columns] = open_share
    return share


def highest_met(vergence: FloatArray, start: FloatArray, reach_px_m: float, jump: float) -> FloatArray:
    """Highest vergence of a surface below which a ray from vergence ``start`` can pass: shape (n_y, n_x).

    When a ray comes to a place it has risen by its length over ``reach_px_m``, or more, and passes above what lies
    lower there. -inf where rays pass above everything, and where nothing within reach is nearer by a jump.
    """
    margin = int(np.ceil(reach_px_m * float(np.ptp(vergence)))) + 1
    highest, inner = np.full(vergence.shape, -np.inf), 0
    for outer in (*(1 << k for k in range(margin.bit_length()) if 1 << k < margin), margin):
        top = maximum_filter(vergence, 2 * outer + 1, mode="nearest")
        # Places beyond the inner window are at least half a pixel beyond it before they are rounded.
        risen = start + (inner + 0.5) / reach_px_m * (inner > 0)
        np.maximum(highest, top, out=highest, where=top > risen + 0.25 * jump)
        inner = outer
    return np.where(top - start > jump, highest, -np.inf)


@compiled
def _march(
    first: int,
    stop: int,
    vergence: FloatArray,
    start: FloatArray,
    highest: FloatArray,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    points: FloatArray,
    jump: float,
    share: FloatArray,
) -> None:
    """Write the share of the rays to the aperture points that meet no surface: shape of ``rows``.

    A ray is followed in steps of half a pixel from vergence ``start`` to ``highest`` (:func:`highest_met`), which have
    the shape of ``rows``. It is stopped where it meets a continuous surface from behind, and passes where the surface
    ends in a jump.
    """
    n_y, n_x = vergence.shape
    for index in range(first, stop):
        for point in range(points.shape[0]):
            x_px, y_px = points[point, 0], points[point, 1]
            length = np.hypot(x_px, y_px) * (highest[index] - start[index])
            steps = int(np.ceil(2.0 * length)) + 1
            step = (highest[index] - start[index]) / steps
            last = vergence[rows[index], columns[index]]
            below = start[index] - last < -jump
            is_open = 1.0
            for number in range(1, steps + 1):
                ray = start[index] + number * step
                row = min(max(int(rows[index] + y_px * number * step + 0.5), 0), n_y - 1)
                column = min(max(int(columns[index] + x_px * number * step + 0.5), 0), n_x - 1)
                here = vergence[row, column]
                is_below = ray < here - 0.5 * jump
                if below and not is_below and abs(here - last) <= jump:
                    is_open = 0.0
                    break
                below, last = is_below, here
            if below:
                is_open = 0.0
            share[index] += is_open / points.shape[0]


def _averaged(values: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """A picture at another size: mean over each pixel."""
    from PIL import Image

    image = Image.fromarray(values.astype(np.float32), mode="F")
    return np.asarray(image.resize(shape[::-1], Image.Resampling.BOX), dtype=np.float64)
