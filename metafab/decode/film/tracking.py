"""Tracking of segments: those of a part of the window are identified with the last frame's segments around it.

A segment of the part that lies on one of the last frame's segments where the light has not changed continues it. It
keeps the last frame's depth, which is measured on all pixels of the segment; the part shows only some. The depth is
measured again when the segment has become much larger.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import nearest
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.registration.downsampling import relative_slices
from metafab.decode.segmentation.assignment import Segmentation, measured_again
from metafab.decode.segmentation.fit import robust_fit
from metafab.decode.segmentation.planes import Cells, Plane, cell_side, distinct_planes, ransac_planes
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import Regions, SegmentDepth, adjacency, grown
from metafab.decode.segmentation.surfaces import layer_separation_per_m

Part = tuple[slice, slice]

#: A segment continues one of the last frame if at least this share and this number of its pixels of unchanged light
#: lie on that one.
_CONTINUED_SHARE, _FEWEST_CONTINUED = 0.5, 9
#: Cells of a continuous surface: their side, frame pixels, and their error in separations of its planes; and this
#: separation in that of layers. Then: most separations that a plane crosses within a cell.
_SURFACE_CELL_PX, _CELL_ERROR, _SURFACE_SEPARATION, _SURFACE_STEEPEST = 30, 0.1, 0.5, 6.0
#: Distance from a neighbour's plane within which a segment of a surface is part of it, in separations of layers.
_ONE_PLANE = 0.25
#: Least width of a segment that shows a slope across it, frame pixels: two windows.
_WIDE_PX = 2 * WINDOW_PX
#: Growth of a segment's pixels from which its depth is measured again.
_GROWTH = 1.25


@dataclass(frozen=True)
class TrackedRegions:
    """Segments of a frame, tracked from the last one."""

    regions: Regions  #: The segments.
    #: Shape (n_last + 1,), present number of each segment of the last frame, by its number there (0 for none); 0 for
    #: one that has gone.
    number: NDArray[np.int32]


def with_planes_of_surface(
    regions: Regions, prepared: PreparedFrame, volume: CostVolume, pixels: PixelDepth, outline_rounds: int
) -> Regions:
    """A continuous surface with segments on the planes that most of it lies on; other segments stay as they are.

    The segments of a surface are only pieces, whose planes may be far from its depths. What comes to light beside them
    in the next frames needs the planes. The surface has less noise than cells, and shows tilts that layers hide.
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
    found = Segmentation(prepared, volume, on_surface, separation, outline_rounds).of_planes(planes)
    if not found.depths:
        return regions
    everywhere = np.where(regions.grown > 0, grown(found.grown), 0).astype(np.int32)
    found = replace(found, grown=everywhere, right=regions.right, surface_per_m=regions.surface_per_m)
    return _joined(_on_surface(found, step), separation, step)


def _on_surface(regions: Regions, step: int) -> Regions:
    """Segments at the planes through the depths of their continuous surface, in their interiors."""
    depths, surface = list(regions.depths), regions.surface_per_m
    for number, depth in enumerate(depths, start=1):
        inside = regions.interior == number
        if surface is None or np.count_nonzero(inside) * step**2 < WINDOW_PX**2:
            continue
        axes = [axis.astype(np.float64) for axis in np.nonzero(inside)]
        vergence, middle = surface[inside], float(np.median(surface[inside]))
        error = max(1.48 * float(np.median(np.abs(vergence - middle))), 1e-9)
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
    surface, count = regions.surface_per_m, len(regions.depths) + 1
    sizes, touching = np.bincount(regions.grown.ravel(), minlength=count), adjacency(regions.grown, count)
    target = np.arange(count, dtype=np.int32)
    planes = [depth.plane.over(regions.grown.shape) for depth in regions.depths]
    smallest_first: list[int] = (1 + np.argsort(sizes[1:], kind="stable")).tolist()
    for number in smallest_first if surface is not None else ():
        own = regions.grown == number
        larger = [k for k in np.flatnonzero(touching[number] & (sizes > sizes[number])).tolist() if k > 0]
        away = [float(np.median(np.abs(planes[k - 1][own] - surface[own]))) for k in larger]
        if away and min(away) < _ONE_PLANE * separation_per_m:
            target[number] = larger[int(np.argmin(away))]
    for number in reversed(smallest_first):
        target[number] = target[target[number]]
    stays = target == np.arange(count)
    if stays.all():
        return regions
    number = (np.cumsum(stays) - 1).astype(np.int32)[target]
    joined = replace(
        regions,
        depths=tuple(depth for depth, stay in zip(regions.depths, stays[1:].tolist(), strict=True) if stay),
        label=number[regions.label],
        interior=number[regions.interior],
        grown=number[regions.grown],
    )
    inside = np.bincount(joined.interior.ravel(), minlength=len(joined.depths) + 1)[1:].tolist()
    depths = tuple(replace(depth, pixels=float(n)) for depth, n in zip(joined.depths, inside, strict=True))
    return _on_surface(replace(joined, depths=depths), step)


def planes_around(
    last: Regions, part: Part, surroundings: Part, affected: NDArray[np.bool_], separation_per_m: float
) -> list[Plane]:
    """Distinct planes of the last frame's segments about the affected pixels, in the coordinates of the surroundings.

    ``part`` and ``surroundings`` are slices, in downsampled pixels, of the changed part and of the part with the pixels
    around it; ``affected``, of the part's shape, are the pixels whose light changed. Planes differ by
    ``separation_per_m`` of vergence or more.
    """
    label = last.label[surroundings].copy()
    label[relative_slices(part, surroundings)][affected] = 0
    around = 1 + np.flatnonzero(np.bincount(label.ravel())[1:])
    rank = np.zeros(len(last.depths) + 1, dtype=np.int32)
    rank[around] = np.arange(1, around.size + 1)
    rows, columns = surroundings
    planes = [last.depths[number - 1].plane.moved(-rows.start, -columns.start) for number in around.tolist()]
    return distinct_planes(planes, rank[label], separation_per_m)


def track(
    last: Regions,
    current: Regions,
    pixels: PixelDepth,
    part: Part,
    surroundings: Part,
    affected: NDArray[np.bool_],
    separation_per_m: float,
) -> TrackedRegions:
    """Replace the affected pixels of a part of the last frame's segments by the current ones.

    Current segments are those of the surroundings, with the depths ``pixels`` of their pixels. Segments that continue keep their numbers. All other pixels of the
    part keep their segments: new noise moves no outline. The arguments are those of :func:`planes_around`; ``affected``
    has the shape (n_y, n_x) of the part.
    """
    inside, count = relative_slices(part, surroundings), len(last.depths)
    continued = _continued(last, current, pixels, part, surroundings, affected, separation_per_m)
    sizes, changed = (
        np.bincount(one, minlength=count + 1)[1:] for one in (last.grown.ravel(), last.grown[part][affected])
    )
    stays = sizes > changed
    # The numbers of segments that have gone are used again, so that those of all others stay.
    depths: list[SegmentDepth | None] = [one if kept else None for one, kept in zip(last.depths, stays, strict=True)]
    free = [index for index, one in enumerate(depths) if one is None]
    number = np.zeros(len(current.depths) + 1, dtype=np.int32)
    visible = np.bincount(current.grown[inside][affected], minlength=len(current.depths) + 1) > 0
    rows, columns = surroundings
    for index, depth in enumerate(current.depths, start=1):
        if not visible[index]:
            continue
        if continued[index]:
            number[index] = continued[index]
            continue
        moved = replace(depth, plane=depth.plane.moved(rows.start, columns.start))
        if free:
            number[index] = 1 + free[0]
            depths[free.pop(0)] = moved
        else:
            depths.append(moved)
            number[index] = len(depths)
    used = np.array([0, *(one is not None for one in depths)])
    renumbered = (np.cumsum(used) * used).astype(np.int32)
    of_last = np.append(0, np.where(stays, renumbered[1 : count + 1], 0)).astype(np.int32)
    of_current, labels = renumbered[number], []
    for before, now in ((last.label, current.label), (last.interior, current.interior), (last.grown, current.grown)):
        label = of_last[before]
        label[part][affected] = of_current[now[inside][affected]]
        labels.append(label)
    earlier, later = _right(last), _right(current)
    right = None if earlier is None or later is None else earlier.copy()
    if right is not None and later is not None:
        right[part][affected] = later[inside][affected]
    label, interior, grown_label = labels
    tracked = tuple(one for one in depths if one is not None)
    regions = Regions(last.layers, tracked, label, interior, grown_label, right)
    if last.continuous or current.continuous:
        # The probabilities of a continuous surface are those of its own depths, not of the planes across it.
        surface = last.vergence_per_m(last.grown) if last.surface_per_m is None else last.surface_per_m.copy()
        new = (current if current.continuous else regions.within(*surroundings)).vergence_per_m(
            current.grown if current.continuous else grown_label[surroundings]
        )[inside]
        surface[part] = np.where(affected & np.isfinite(new), new, surface[part])
        regions = replace(regions, surface_per_m=surface)
    return TrackedRegions(regions, of_last)


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


def _right(regions: Regions) -> FloatArray | None:
    """Probability of the right segment, shape (n_y, n_x); without segments none is doubted."""
    return regions.right if regions.depths else np.ones(regions.grown.shape)


def _continued(
    last: Regions,
    current: Regions,
    pixels: PixelDepth,
    part: Part,
    surroundings: Part,
    affected: NDArray[np.bool_],
    separation_per_m: float,
) -> NDArray[np.intp]:
    """For each current segment from 1, the last frame's segment that it continues where nothing changed; 0 for none."""
    around, before, count = np.ones(current.label.shape, dtype=bool), last.within(*surroundings), len(last.depths) + 1
    around[relative_slices(part, surroundings)] = ~affected
    codes = current.label[around] * count + before.label[around]
    overlaps = np.bincount(codes, minlength=(len(current.depths) + 1) * count).reshape(-1, count)
    continued = np.zeros(len(current.depths) + 1, dtype=np.intp)
    for index, overlap in enumerate(overlaps):
        best = int(overlap[1:].argmax()) + 1 if count > 1 else 0
        if index == 0 or best == 0 or overlap[best] < max(_FEWEST_CONTINUED, _CONTINUED_SHARE * overlap.sum()):
            continue
        own = current.label == index
        place = [axis.astype(np.float64) for axis in np.nonzero(own)]
        there = before.depths[best - 1].plane.at(*place)
        # A part may show little of a plane, whose tilt is then noise.
        claimed = pixels.claimed[own]
        away = [np.abs(current.depths[index - 1].plane.at(*place) - there)]
        if claimed.any():
            away.append(np.abs(pixels.vergence_per_m[own] - there)[claimed])
        if min(float(np.median(one)) for one in away) < 0.5 * separation_per_m:
            continued[index] = best
    return continued


def remeasured(regions: Regions, volume: CostVolume, step: int) -> Regions:
    """Measure the depths of segments again that have become much larger; ``regions`` itself if there are none.

    The cost volume is that of the whole window, ``step`` the frame pixels from one downsampled pixel to the next.
    """
    sizes = np.bincount(regions.interior.ravel(), minlength=len(regions.depths) + 1)[1:]
    larger = [index for index, one in enumerate(regions.depths) if sizes[index] > _GROWTH * one.pixels]
    if not larger:
        return regions
    number = np.zeros(sizes.size + 1, dtype=np.int32)
    number[np.array(larger) + 1] = np.arange(1, len(larger) + 1)
    depths = list(regions.depths)
    for index, cells in zip(larger, Cells.of_each(volume, number[regions.interior], len(larger), step), strict=True):
        depths[index] = measured_again(volume, cells, depths[index], float(sizes[index]), step)
    return replace(regions, depths=tuple(depths))
