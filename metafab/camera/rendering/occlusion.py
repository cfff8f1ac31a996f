"""Occlusion by geometry: the share of the aperture that sees each point of a surface.

The ray from a point in direction t at vergence v (1/depth) to the point p of the aperture crosses the vergence w of a
nearer surface in the direction t + p (w - v). The surface hides the aperture point where it lies in that direction.
Surfaces at equal depths therefore hide each other only where they overlap, and touch without a seam.

A pixel that several surfaces cover in part is shared out from the nearest on: outlines that meet in a pixel are taken
to touch, and not to cover the same part of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from metafab.camera.rendering.render import Piece
from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled

#: Shift of outlines (pixels) below which the aperture is taken as a point.
_LEAST_SHIFT_PX = 0.02
#: Shifts of outlines as a pinhole sees them.
PINHOLE: FloatArray = np.zeros((1, 2))
#: Fixed-point steps to the vergence where a ray meets a sloped surface; each gains a factor of 100 in the worst case.
_STEPS = 2


@dataclass(frozen=True)
class Occluder:
    """Mask of a surface on a part of a pixel grid."""

    rows: slice  #: Rows of the grid.
    columns: slice  #: Columns of the grid.
    coverage: FloatArray  #: Shape (n_y, n_x), share of each pixel that the surface covers.
    vergence_per_m: FloatArray  #: Shape (n_y, n_x), 1/depth; beyond the outline, that of the nearest covered pixel.
    moves: bool = False  #: Whether the surface moves.

    @classmethod
    def of(cls, piece: Piece, *, moves: bool = False) -> Occluder:
        """The mask of a piece."""
        coverage = piece.coverage.sum(axis=0)
        if piece.depth_m.size == 1:
            vergence = np.full(coverage.shape, 1.0 / piece.depth_m[0])
        else:
            vergence = 1.0 / np.where(coverage > 0.0, piece.mean_depth_m, np.inf)
            if not (covered := coverage > 0.0).all() and covered.any():
                nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
                vergence = vergence[tuple(nearest)]
        return cls(piece.rows, piece.columns, coverage, vergence, moves)

    @classmethod
    def everywhere(cls, shape: tuple[int, int], depth_m: float) -> Occluder:
        """The mask of a surface at one depth that covers a whole grid of ``shape``, (n_y, n_x)."""
        return cls(slice(0, shape[0]), slice(0, shape[1]), np.ones(shape), np.full(shape, 1.0 / depth_m))


def visible_piece(piece: Piece, nearer: Sequence[Occluder], aperture_px_m: FloatArray) -> Piece:
    """The piece with the brightness that the aperture sees past nearer surfaces; its coverage is unchanged.

    ``aperture_px_m``, shape (n, 2), is the shift (columns, rows) of an outline by each aperture point, pixels per 1/m.
    """
    own = Occluder.of(piece)
    return replace(piece, brightness=piece.brightness * visible_share(own, nearer, aperture_px_m)) if nearer else piece


def visible_share(surface: Occluder, nearer: Sequence[Occluder], aperture_px_m: FloatArray) -> FloatArray:
    """Visible share of each pixel of a surface, mean over its covered part and the aperture: shape of ``surface``."""
    shape = surface.coverage.shape
    behind, undecided = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
    before = []
    for mask in nearer:
        margin = _margin(surface, mask, aperture_px_m)
        local = _placed(mask, surface, margin)
        if local is None:
            continue
        size = 2 * margin + 1
        inside = (slice(margin, margin + shape[0]), slice(margin, margin + shape[1]))
        behind |= minimum_filter(local, size, mode="nearest")[inside] >= 1.0 - 1e-9
        undecided |= maximum_filter(local, size, mode="nearest")[inside] > 0.0
        before.append((mask, margin > 0))
    undecided &= ~behind & (surface.coverage > 0.0)
    share = np.where(behind, 0.0, 1.0)
    rows, columns = np.nonzero(undecided)
    points = aperture_px_m if any(shifted for _, shifted in before) else PINHOLE
    for part in np.array_split(np.arange(rows.size), max(1, rows.size * len(points) // 2_000_000)):
        own, vergence = surface.coverage[rows[part], columns[part]], surface.vergence_per_m[rows[part], columns[part]]
        hidden = np.zeros((part.size, len(points)))
        place = rows[part] + surface.rows.start, columns[part] + surface.columns.start
        for mask, _ in before:
            corner = (mask.rows.start, mask.columns.start)
            _add_hidden(hidden, *place, vergence, mask.coverage, mask.vergence_per_m, corner, points)
        visible = np.clip(np.minimum(own[:, None], 1.0 - hidden), 0.0, None).mean(axis=1)
        share[rows[part], columns[part]] = visible / own
    return share


def _placed(mask: Occluder, surface: Occluder, margin: int) -> FloatArray | None:
    """Coverage of a mask on the grid of a surface and a margin around it; None if it does not reach there.

    Beyond its own grid a mask keeps the coverage of the grid's edge: only the edge of the image cuts a surface.
    """
    indices = []
    for own, part, count in zip(
        (surface.rows, surface.columns), (mask.rows, mask.columns), mask.coverage.shape, strict=True
    ):
        indices.append(np.clip(np.arange(own.start - margin, own.stop + margin) - part.start, 0, count - 1))
    local = mask.coverage[np.ix_(*indices)]
    return local if local.any() else None


def _margin(surface: Occluder, mask: Occluder, aperture_px_m: FloatArray) -> int:
    """Pixels by which a mask can be shifted as seen from the surface, plus one; 0 for a pinhole or equal depths."""
    between_per_m = float(mask.vergence_per_m.max() - surface.vergence_per_m.min())
    shift_px = max(between_per_m, 0.0) * float(np.abs(aperture_px_m).max(initial=0.0))
    return int(np.ceil(shift_px)) + 1 if shift_px >= _LEAST_SHIFT_PX else 0


def hidden_region(
    surface: Occluder, nearer: Sequence[Occluder], aperture_px_m: FloatArray, shape: tuple[int, ...]
) -> tuple[slice, slice] | None:
    """Rows and columns of a grid of ``shape`` within which masks may hide parts of a surface; None for none."""
    spans = []
    for mask in nearer:
        margin = _margin(surface, mask, aperture_px_m) + 2
        rows, columns = (
            slice(max(own.start, part.start - margin), min(own.stop, part.stop + margin))
            for own, part in ((surface.rows, mask.rows), (surface.columns, mask.columns))
        )
        if rows.start < rows.stop and columns.start < columns.stop:
            spans.append((rows, columns))
    if not spans:
        return None
    # Slopes of the grid need two pixels along each axis.
    crop = []
    for axis, count in enumerate(shape):
        start, stop = min(span[axis].start for span in spans), max(span[axis].stop for span in spans)
        crop.append(slice(max(0, min(start, count - 2)), max(stop, start + 2)))
    return crop[0], crop[1]


def padded(mask: Occluder, margin: tuple[int, int]) -> Occluder:
    """The mask on a grid that is wider by (rows, columns) on each side, with the values of the edge."""
    pads = [(wide, wide) for wide in margin]
    rows, columns = (
        slice(part.start - wide, part.stop + wide) for part, wide in zip((mask.rows, mask.columns), margin, strict=True)
    )
    coverage, vergence_per_m = (np.pad(values, pads, mode="edge") for values in (mask.coverage, mask.vergence_per_m))
    return Occluder(rows, columns, coverage, vergence_per_m, mask.moves)


@compiled
def _add_hidden(
    hidden: FloatArray,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    vergence_per_m: FloatArray,
    coverage: FloatArray,
    mask_per_m: FloatArray,
    corner: tuple[int, int],
    points: FloatArray,
) -> None:
    """Add the bilinear coverage of a mask where the rays from pixels to aperture points cross it.

    ``hidden`` has the shape (n_pixels, n_points); rows, columns and vergence of the pixels (n_pixels,), coverage and
    vergence of the mask (n_y, n_x). ``corner`` is (row, column) of the mask's first pixel, ``points``, shape (n_points,
    2), the shift (columns, rows) per 1/m.
    """
    n_y, n_x = coverage.shape
    for pixel in range(rows.size):
        row, column = rows[pixel] - corner[0], columns[pixel] - corner[1]
        at = mask_per_m[min(max(row, 0), n_y - 1), min(max(column, 0), n_x - 1)]
        for point in range(points.shape[0]):
            vergence, y, x = at, 0.0, 0.0
            for _ in range(_STEPS):
                step = max(vergence - vergence_per_m[pixel], 0.0)
                y, x = row + step * points[point, 1], column + step * points[point, 0]
                vergence = mask_per_m[min(max(int(y + 0.5), 0), n_y - 1), min(max(int(x + 0.5), 0), n_x - 1)]
            low_y, low_x = int(np.floor(y)), int(np.floor(x))
            part_y, part_x = y - low_y, x - low_x
            low, high = min(max(low_y, 0), n_y - 1), min(max(low_y + 1, 0), n_y - 1)
            left, right = min(max(low_x, 0), n_x - 1), min(max(low_x + 1, 0), n_x - 1)
            lower = (1.0 - part_x) * coverage[low, left] + part_x * coverage[low, right]
            upper = (1.0 - part_x) * coverage[high, left] + part_x * coverage[high, right]
            hidden[pixel, point] += (1.0 - part_y) * lower + part_y * upper
