"""Segments of a film: what a part of the window shows now, joined to what goes on unchanged around it.

A segment of the part that lies, around the part, on one of the last frame's goes on in it, and has its depth: that is
from all of its pixels, of which the part shows some. It is found anew only where the segment has become much larger.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metafab.decode.matching.cost_volume import Volume
from metafab.decode.registration.reduce import place_within
from metafab.decode.segmentation.planes import Cells, Plane, distinct_planes
from metafab.decode.segmentation.regions import Regions, depth_of
from metafab.decode.segmentation.segment import SegmentDepth

Part = tuple[slice, slice]

#: A segment goes on in another if this share of its pixels around the part lies on it, and so many at least.
_SAME_SHARE = 0.5
_FEWEST_SAME = 9
#: Its depth is found again when it comes from this many times the pixels that the known one is from.
_GROWTH = 1.25


def planes_around(last: Regions, part: Part, about: Part, separation_per_m: float) -> list[Plane]:
    """Distinct planes of the last frame's segments around a part, in a picture that starts with ``about``.

    Args:
        last: segments of the last frame.
        part: what has changed, compared pixels.
        about: that and what lies around it.
        separation_per_m: vergence by which planes differ.
    """
    label = last.label[about].copy()
    label[place_within(part, about)] = 0
    numbers, place = np.unique(label, return_inverse=True)
    around = [number for number in numbers.tolist() if number > 0]
    ranked = place.reshape(label.shape).astype(np.int32) + (0 if (numbers == 0).any() else 1)
    planes = [last.depths[number - 1].plane.moved(-about[0].start, -about[1].start) for number in around]
    return distinct_planes(planes, ranked, separation_per_m)


def joined(
    last: Regions, found: Regions, part: Part, about: Part, separation_per_m: float
) -> tuple[Regions, NDArray[np.int32]]:
    """The last frame's segments with those that a part shows now.

    Args:
        last: segments of the last frame.
        found: those of ``about``.
        part: what has changed, compared pixels.
        about: that and what lies around it.
        separation_per_m: vergence by which planes differ.

    Returns:
        All segments, and the number in them of each of the last frame's from 0 (for none): 0 for one that has gone.
    """
    inside, count = place_within(part, about), len(last.depths)
    same = _continued(last, found, part, about, separation_per_m)
    all_of_it, in_part = (np.bincount(near.ravel(), minlength=count + 1)[1:] for near in (last.near, last.near[part]))
    stays = all_of_it > in_part
    # Numbers that have become free are given again, so that those of all others stay.
    places: list[SegmentDepth | None] = [one if kept else None for one, kept in zip(last.depths, stays, strict=True)]
    free = [index for index, one in enumerate(places) if one is None]
    number = np.zeros(len(found.depths) + 1, dtype=np.int32)
    seen = np.bincount(found.near[inside].ravel(), minlength=len(found.depths) + 1) > 0
    for index, depth in enumerate(found.depths, start=1):
        if not seen[index]:
            continue
        if same[index]:
            number[index] = same[index]
            continue
        moved = _moved(depth, about)
        if free:
            number[index] = 1 + free[0]
            places[free.pop(0)] = moved
        else:
            places.append(moved)
            number[index] = len(places)
    left = np.array([0, *(one is not None for one in places)])
    renumbered = (np.cumsum(left) * left).astype(np.int32)
    labels = []
    for before, now in ((last.label, found.label), (last.inner, found.inner), (last.near, found.near)):
        label = before.copy() if stays.all() else np.where(np.append(True, stays)[before], before, 0).astype(np.int32)
        label[part] = number[now[inside]]
        labels.append(label if left.all() else renumbered[label])
    depths = tuple(one for one in places if one is not None)
    return Regions(last.layers, depths, *labels), np.append(0, np.where(stays, renumbered[1 : count + 1], 0))


def _continued(last: Regions, found: Regions, part: Part, about: Part, separation_per_m: float) -> NDArray[np.intp]:
    """Of each segment from 1 that was found, the last frame's that it goes on in around the part; 0 for none."""
    around, kept, count = np.ones(found.label.shape, dtype=bool), last.within(*about), len(last.depths) + 1
    around[place_within(part, about)] = False
    pairs = np.bincount(found.label[around] * count + kept.label[around], minlength=(len(found.depths) + 1) * count)
    same = np.zeros(len(found.depths) + 1, dtype=np.intp)
    for index, on in enumerate(pairs.reshape(-1, count)):
        best = int(on[1:].argmax()) + 1 if count > 1 else 0
        if index == 0 or best == 0 or on[best] < max(_FEWEST_SAME, _SAME_SHARE * on.sum()):
            continue
        place = [axis.astype(np.float64) for axis in np.nonzero(found.label == index)]
        away = found.depths[index - 1].plane.at(*place) - kept.depths[best - 1].plane.at(*place)
        if np.median(np.abs(away)) < 0.5 * separation_per_m:
            same[index] = best
    return same


def refreshed(regions: Regions, volume: Volume, every: int) -> Regions:
    """The same segments, the depths of those that have become much larger found anew; itself if there are none."""
    sizes = np.bincount(regions.inner.ravel(), minlength=len(regions.depths) + 1)[1:]
    larger = [index for index, one in enumerate(regions.depths) if sizes[index] > _GROWTH * one.pixels]
    if not larger:
        return regions
    number = np.zeros(sizes.size + 1, dtype=np.int32)
    number[np.array(larger) + 1] = np.arange(1, len(larger) + 1)
    depths = list(regions.depths)
    for index, cells in zip(larger, Cells.of_each(volume, number[regions.inner], len(larger), every), strict=True):
        known = depths[index]
        depths[index] = replace(depth_of(volume, cells, known.plane) or known, pixels=float(sizes[index]))
    return replace(regions, depths=tuple(depths))


def _moved(depth: SegmentDepth, about: Part) -> SegmentDepth:
    return replace(depth, plane=depth.plane.moved(about[0].start, about[1].start))
