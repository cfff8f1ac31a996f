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
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.registration.downsampling import relative_slices
from metafab.decode.segmentation.assignment import measured_again
from metafab.decode.segmentation.layers import FEWEST_PX, dilated
from metafab.decode.segmentation.planes import Cells, Plane, distinct_planes
from metafab.decode.segmentation.segments import Regions, SegmentDepth

Part = tuple[slice, slice]

#: A segment continues one of the last frame if at least this share and this number of its pixels of unchanged light
#: lie on that one.
_CONTINUED_SHARE, _FEWEST_CONTINUED = 0.5, 9
#: Growth of a segment's pixels from which its depth is measured again.
_GROWTH = 1.25


@dataclass(frozen=True)
class ChangedPart:
    """A part of the window that is decoded again, and its surroundings; slices in downsampled pixels."""

    part: Part  #: Rectangle that holds the changed pixels.
    around: Part  #: The part with the pixels around it.
    changed: NDArray[np.bool_]  #: Shape (n_y, n_x) of the part, pixels whose light changed.

    @property
    def inside(self) -> Part:
        """The part relative to its surroundings."""
        return relative_slices(self.part, self.around)


@dataclass(frozen=True)
class TrackedRegions:
    """Segments of a frame, tracked from the last one."""

    regions: Regions  #: The segments.
    #: Shape (n_last + 1,), present number of each segment of the last frame, by its number there (0 for none); 0 for
    #: one that has gone.
    number: NDArray[np.int32]


def planes_around(last: Regions, change: ChangedPart, separation_per_m: float) -> list[Plane]:
    """Distinct planes of the last frame's segments about the changed pixels, in the coordinates of the surroundings.

    Planes differ by ``separation_per_m`` of vergence or more.
    """
    label = last.label[change.around].copy()
    label[change.inside][change.changed] = 0
    around = 1 + np.flatnonzero(np.bincount(label.ravel())[1:])
    rank = np.zeros(len(last.depths) + 1, dtype=np.int32)
    rank[around] = np.arange(1, around.size + 1)
    rows, columns = change.around
    planes = [last.depths[number - 1].plane.moved(-rows.start, -columns.start) for number in around.tolist()]
    return distinct_planes(planes, rank[label], separation_per_m)


def track(
    last: Regions, current: Regions, change: ChangedPart, pixels: PixelDepth, separation_per_m: float
) -> TrackedRegions:
    """Replace the changed pixels of a part of the last frame's segments by the current ones.

    Segments that continue keep their numbers. All other pixels of the part keep their segments: new noise moves no
    outline. A segment continues one whose plane its own is near, or the depths of its pixels: within half of
    ``separation_per_m`` of vergence.

    Args:
        last: segments of the last frame, in the window.
        current: segments of the surroundings now.
        change: the part, its surroundings and the changed pixels.
        pixels: present depths of the pixels in the surroundings.
        separation_per_m: vergence by which the planes of different segments differ.
    """
    stays = _seen_elsewhere(last, change)
    depths, number = _numbered(
        last, current, change, stays, _continued(last, current, change, pixels, separation_per_m)
    )
    used = np.array([0, *(one is not None for one in depths)])
    renumbered = (np.cumsum(used) * used).astype(np.int32)
    of_last = np.append(0, np.where(stays, renumbered[1 : stays.size + 1], 0)).astype(np.int32)
    of_current, part, inside, changed = renumbered[number], change.part, change.inside, change.changed
    labels = []
    for before, now in ((last.label, current.label), (last.interior, current.interior), (last.grown, current.grown)):
        label = of_last[before]
        label[part][changed] = of_current[now[inside][changed]]
        labels.append(label)
    earlier, later = _right(last), _right(current)
    right = None if earlier is None or later is None else earlier.copy()
    if right is not None and later is not None:
        right[part][changed] = later[inside][changed]
    tracked = tuple(one for one in depths if one is not None)
    label, interior, grown_label = labels
    regions = Regions(last.layers, tracked, label, interior, grown_label, right)
    if last.continuous or current.continuous:
        regions = replace(regions, surface_per_m=_surface(last, current, change, regions))
    return TrackedRegions(regions, of_last)


def _seen_elsewhere(last: Regions, change: ChangedPart) -> NDArray[np.bool_]:
    """Whether each of the last frame's segments has pixels that have not changed: shape (n_last,)."""
    sizes, changed = (
        np.bincount(one.ravel(), minlength=len(last.depths) + 1)[1:]
        for one in (last.grown, last.grown[change.part][change.changed])
    )
    return np.asarray(sizes > changed)


def _numbered(
    last: Regions,
    current: Regions,
    change: ChangedPart,
    stays: NDArray[np.bool_],
    continued: NDArray[np.intp],
) -> tuple[list[SegmentDepth | None], NDArray[np.int32]]:
    """Depths of the last frame's and of new segments, and the place of each current one among them.

    The places of segments that have gone are taken by new ones, so that those of all others stay; None for places that
    stay empty. Places count from 1: shape (n_current + 1,), 0 for segments not seen in changed pixels.

    Args:
        stays: shape (n_last,), whether each of the last frame's segments is seen elsewhere.
        continued: shape (n_current + 1,), segment of the last frame that each continues; 0 for none.
    """
    depths: list[SegmentDepth | None] = [one if kept else None for one, kept in zip(last.depths, stays, strict=True)]
    free = [index for index, one in enumerate(depths) if one is None]
    number = np.zeros(len(current.depths) + 1, dtype=np.int32)
    visible = np.bincount(current.grown[change.inside][change.changed], minlength=number.size) > 0
    rows, columns = change.around
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
    return depths, number


def _surface(last: Regions, current: Regions, change: ChangedPart, regions: Regions) -> FloatArray:
    """1/depth of each pixel, shape (n_y, n_x), where the segments now or before are those of a continuous surface.

    Changed pixels take that of ``regions``, the tracked segments, if the current ones are on planes.
    """
    surface = last.vergence_per_m(last.grown) if last.surface_per_m is None else last.surface_per_m.copy()
    if current.continuous:
        new = current.vergence_per_m(current.grown)[change.inside]
    else:
        local = regions.within(*change.part)
        new = local.vergence_per_m(local.grown)
    surface[change.part] = np.where(change.changed & np.isfinite(new), new, surface[change.part])
    return surface


def without_slivers(tracked: TrackedRegions, change: ChangedPart, pixels: PixelDepth, step: int) -> TrackedRegions:
    """Segments of which those too small for one are joined to the neighbour whose depth their pixels fit best.

    What moves on leaves slivers of segments behind. Only those inside the part are joined, of which the image is made
    anew. Their pixels on a continuous surface keep their own depths.

    Args:
        tracked: segments of the window.
        change: the part and its surroundings.
        pixels: present depths of the pixels in the surroundings.
        step: frame pixels from one downsampled pixel to the next.
    """
    regions, fewest = tracked.regions, FEWEST_PX / step**2
    count = len(regions.depths) + 1
    sizes, in_part = (np.bincount(one.ravel(), minlength=count) for one in (regions.grown, regions.grown[change.part]))
    small = (sizes < fewest) & (in_part == sizes) & (sizes > 0) & ~regions.of_outline
    target = np.arange(count, dtype=np.int32)
    around = regions.grown[change.around]
    for number in np.flatnonzero(small[1:]) + 1:
        own = around == number
        beside = [k for k in np.unique(around[dilated(own) & ~own]).tolist() if k > 0 and not small[k]]
        if not beside:
            continue
        judged = own & pixels.claimed if (own & pixels.claimed).any() else own
        place = [axis.astype(np.float64) for axis in np.nonzero(judged)]
        whole = [axis + at.start for axis, at in zip(place, change.around, strict=True)]
        measured = pixels.vergence_per_m[judged]
        away = [float(np.median(np.abs(regions.depths[k - 1].plane.at(*whole) - measured))) for k in beside]
        target[number] = beside[int(np.argmin(away))]
    if np.array_equal(target, np.arange(count)):
        return tracked
    joined, renumbered = regions.merged(target, interiors=False)
    return TrackedRegions(joined, renumbered[tracked.number])


def _right(regions: Regions) -> FloatArray | None:
    """Probability of the right segment, shape (n_y, n_x); without segments none is doubted."""
    return regions.right if regions.depths else np.ones(regions.grown.shape)


def _continued(
    last: Regions, current: Regions, change: ChangedPart, pixels: PixelDepth, separation_per_m: float
) -> NDArray[np.intp]:
    """For each current segment from 1, the last frame's segment that it continues where nothing changed; 0 for none."""
    around, before, count = np.ones(current.label.shape, dtype=bool), last.within(*change.around), len(last.depths) + 1
    around[change.inside] = ~change.changed
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
        away = [np.abs(current.depths[index - 1].plane.at(*place) - there)]
        if (claimed := pixels.claimed[own]).any():
            # A part may show little of a plane, whose tilt is then noise.
            away.append(np.abs(pixels.vergence_per_m[own] - there)[claimed])
        if min(float(np.median(one)) for one in away) < 0.5 * separation_per_m:
            continued[index] = best
    return continued


def remeasured(regions: Regions, volume: CostVolume, step: int) -> Regions:
    """Measure the depths of segments again that have become much larger; ``regions`` itself if there are none.

    The tilted planes of a continuous surface stay: its own depths, which they were fitted to, show slopes better.
    The cost volume is that of the whole window, ``step`` the frame pixels from one downsampled pixel to the next.
    """
    sizes = np.bincount(regions.interior.ravel(), minlength=len(regions.depths) + 1)[1:]
    larger = [
        index
        for index, one in enumerate(regions.depths)
        if sizes[index] > _GROWTH * one.pixels and not (regions.continuous and one.plane.tilted)
    ]
    if not larger:
        return regions
    number = np.zeros(sizes.size + 1, dtype=np.int32)
    number[np.array(larger) + 1] = np.arange(1, len(larger) + 1)
    depths = list(regions.depths)
    for index, cells in zip(larger, Cells.of_each(volume, number[regions.interior], len(larger), step), strict=True):
        depths[index] = measured_again(volume, cells, depths[index], float(sizes[index]), step)
    return replace(regions, depths=tuple(depths))
