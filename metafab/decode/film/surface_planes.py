"""Planes of a continuous surface, on which what comes to light in the next frames of a film lies.

Where the depths of a frame are those of a continuous surface, its segments are only pieces: their planes may be far
from the surface, and each part of a later frame would find others. The surface's own depths show planes, and slopes,
that layers of one depth hide: they have less noise than the depths of cells, and no layers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import nearest
from metafab.core.numeric.spread import normal_sigma
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.assignment import Segmentation, SegmentationNumerics
from metafab.decode.segmentation.fragments import adjacency
from metafab.decode.segmentation.layers import grown
from metafab.decode.segmentation.planes import Cells, Plane, cell_side, ransac_planes
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.robust_fits import robust_fit
from metafab.decode.segmentation.segments import Regions
from metafab.decode.segmentation.surfaces import layer_separation_per_m

#: Cells of a continuous surface: their side, frame pixels, and their error in separations of its planes; and this
#: separation in that of layers. Then: most separations that a plane crosses within a cell.
_SURFACE_CELL_PX, _CELL_ERROR, _SURFACE_SEPARATION, _SURFACE_STEEPEST = 30, 0.1, 0.5, 6.0
#: Distance from a neighbour's plane within which a segment of a surface is part of it, in separations of layers.
_ONE_PLANE = 0.25
#: Least width of a segment that shows a slope across it, frame pixels: two windows.
_WIDE_PX = 2 * WINDOW_PX


def with_planes_of_surface(
    regions: Regions,
    prepared: PreparedFrame,
    volume: CostVolume,
    pixels: PixelDepth,
    numerics: SegmentationNumerics,
) -> Regions:
    """A continuous surface with segments on the planes that most of it lies on; other segments stay as they are.

    Without a continuous surface, or without planes on it, ``regions`` itself. The depths of pixels do not change.
    """
    if regions.surface_per_m is None:
        return regions
    step, separation = prepared.downsampling.step, layer_separation_per_m(volume)
    narrow = _SURFACE_SEPARATION * separation
    cells = Cells.of(volume, pixels.claimed & (regions.grown > 0), step, _SURFACE_CELL_PX)
    at = np.rint(cells.row).astype(np.intp), np.rint(cells.column).astype(np.intp)
    error = np.full(at[0].shape, _CELL_ERROR * narrow)
    cells = replace(cells, vergence_per_m=regions.surface_per_m[at], error_per_m=error)
    planes = ransac_planes(cells, cell_side(step, _SURFACE_CELL_PX), narrow, _SURFACE_STEEPEST)
    if not planes:
        return regions
    on_surface = replace(pixels, vergence_per_m=regions.surface_per_m)
    found = Segmentation(prepared, volume, on_surface, separation, numerics).of_planes(planes)
    if not found.depths:
        return regions
    everywhere = np.where(regions.grown > 0, grown(found.grown), 0).astype(np.int32)
    found = replace(found, grown=everywhere, right=regions.right, surface_per_m=regions.surface_per_m)
    return _joined(_on_surface(found, step), separation, step)


def _on_surface(regions: Regions, step: int) -> Regions:
    """Segments at the planes through the depths of their continuous surface, in their interiors."""
    depths, surface = list(regions.depths), regions.vergence_per_m(regions.grown)
    for number, depth in enumerate(depths, start=1):
        inside = regions.interior == number
        if np.count_nonzero(inside) * step**2 < WINDOW_PX**2:
            continue
        axes = [axis.astype(np.float64) for axis in np.nonzero(inside)]
        vergence, middle = surface[inside], float(np.median(surface[inside]))
        error = max(float(normal_sigma(vergence - middle)), 1e-9)
        centre = float(axes[0].mean()), float(axes[1].mean())
        # Windows along an outline mix both sides: a narrow segment shows no slope across it.
        wide = [float(np.ptp(axis)) * step >= _WIDE_PX for axis in axes]
        columns = [np.ones_like(vergence), *(k * (axis - c) for k, axis, c in zip(wide, axes, centre, strict=True))]
        rise, y, x = robust_fit(np.stack(columns, axis=1) / error, (vergence - middle) / error)[1].tolist()
        plane = Plane(middle + rise, (y, x), centre)
        depths[number - 1] = replace(depth, plane=plane, vergence_per_m=plane.vergence_per_m)
    return replace(regions, depths=tuple(depths))


def _joined(regions: Regions, separation_per_m: float, step: int) -> Regions:
    """Segments of a continuous surface, of which those on the plane of a larger neighbour are part of that."""
    surface, count = regions.vergence_per_m(regions.grown), len(regions.depths) + 1
    sizes, touching = np.bincount(regions.grown.ravel(), minlength=count), adjacency(regions.grown, count)
    target = np.arange(count, dtype=np.int32)
    planes = [depth.plane.over(regions.grown.shape) for depth in regions.depths]
    smallest_first: list[int] = (1 + np.argsort(sizes[1:], kind="stable")).tolist()
    for number in smallest_first:
        own = regions.grown == number
        larger = [k for k in np.flatnonzero(touching[number] & (sizes > sizes[number])).tolist() if k > 0]
        away = [float(np.median(np.abs(planes[k - 1][own] - surface[own]))) for k in larger]
        if away and min(away) < _ONE_PLANE * separation_per_m:
            target[number] = larger[int(np.argmin(away))]
    for number in reversed(smallest_first):
        target[number] = target[target[number]]
    if np.array_equal(target, np.arange(count)):
        return regions
    joined, _ = regions.merged(target, interiors=True)
    inside = np.bincount(joined.interior.ravel(), minlength=len(joined.depths) + 1)[1:].tolist()
    depths = tuple(replace(depth, pixels=float(n)) for depth, n in zip(joined.depths, inside, strict=True))
    return _on_surface(replace(joined, depths=depths), step)


def continued_surface(surface_per_m: FloatArray, before: NDArray[np.int32], owner: NDArray[np.int32]) -> FloatArray:
    """A surface on which pixels that changed their segment have the depth of the new one's nearest pixel.

    Args:
        surface_per_m: shape (n_y, n_x), 1/depth of each pixel.
        before: shape (n_y, n_x), segment of each pixel there.
        owner: shape (n_y, n_x), its new segment.
    """
    moved, surface = (owner != before) & (owner > 0), surface_per_m.copy()
    for number in np.unique(owner[moved]).tolist():
        to = moved & (owner == number)
        _, row, column = nearest((before == number) & (owner == number))
        surface[to] = surface_per_m[row[to], column[to]]
    return surface
