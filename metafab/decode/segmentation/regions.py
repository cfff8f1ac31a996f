"""Segments of a frame: which pixels lie at one depth, and at which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import kept_threads
from metafab.decode.matching.cost_volume import Volume
from metafab.decode.matching.depth import HALF_CONFIDENCE, PixelDepth, pixel_depth
from metafab.decode.segmentation import segment as segments
from metafab.decode.segmentation.consensus import spanning_planes
from metafab.decode.segmentation.distance import distance
from metafab.decode.segmentation.frame_statistics import WINDOW_PX, Seen
from metafab.decode.segmentation.neighbours import joined
from metafab.decode.segmentation.planes import Cells, Plane, cell_side, distinct_planes, fitted_plane

#: Layers of the scene are told apart from this share of the calibrated range of vergence.
LAYER_SHARE = 1.0 / 24.0
#: How far from an outline a window, through the pair's main parts, still sees it.
_OUTLINE_REACH_PX = 40
#: So many layers may be stripes of a tilted surface.
_MANY_LAYERS = 5
#: A segment is a stripe of a plane that is hardly farther from its pixels' own depths than the segment's depth is.
_AS_NEAR = 1.25


@dataclass(frozen=True)
class Regions:
    """The segments of a frame, on every few pixels.

    Attributes:
        layers: depths at which many pixels lie.
        depths: of each segment.
        label: shape (n_y, n_x), number of each pixel's segment from 1; 0 for none.
        inner: the same, of the pixels alone that its depth is from.
        near: the same, with the pixels along the outlines.
    """

    layers: int
    depths: tuple[segments.SegmentDepth, ...]
    label: NDArray[np.int32]
    inner: NDArray[np.int32]
    near: NDArray[np.int32]

    def within(self, rows: slice, columns: slice) -> Regions:
        """Those of a part of the window, with the same numbers."""
        depths = (replace(one, plane=one.plane.moved(-rows.start, -columns.start)) for one in self.depths)
        labels = (label[rows, columns] for label in (self.label, self.inner, self.near))
        return Regions(self.layers, tuple(depths), *labels)

    def vergence_per_m(self, label: NDArray[np.int32]) -> FloatArray:
        """1/depth at each pixel of the segment that ``label`` gives it to; NaN for none."""
        one = np.array([np.nan, *(depth.vergence_per_m for depth in self.depths)])
        vergence = one[label]
        for number, depth in enumerate(self.depths, start=1):
            if depth.plane.tilted:
                np.copyto(vergence, depth.plane.over(label.shape), where=label == number)
        return vergence

    def bands(self, label: NDArray[np.int32], step_per_m: float) -> tuple[NDArray[np.int32], FloatArray]:
        """``label`` with tilted segments cut into bands of one depth each, and 1/depth of every number from 1."""
        if not any(depth.plane.tilted for depth in self.depths):
            return label, np.array([depth.vergence_per_m for depth in self.depths])
        vergence, bands = self.vergence_per_m(label), np.zeros(label.shape, dtype=np.int32)
        found: list[float] = []
        for number, depth in enumerate(self.depths, start=1):
            mask = label == number
            step = np.round((vergence[mask] - depth.vergence_per_m) / step_per_m)
            steps, place = np.unique(step, return_inverse=True)
            bands[mask] = len(found) + 1 + place
            found += (depth.vergence_per_m + steps * step_per_m).tolist()
        return bands, np.array(found)


def layer_step_per_m(volume: Volume) -> float:
    """Vergence by which layers differ."""
    return float(volume.vergences_per_m[-1] - volume.vergences_per_m[0]) * LAYER_SHARE


def textured_pixels(seen: Seen, volume: Volume) -> PixelDepth:
    """The depth of each pixel by itself, claimed where something lit shows texture."""
    variance, _ = seen.variance, seen.uneven  # by loops over all threads, before another thread asks
    with kept_threads() as beside:
        near = beside.submit(near_texture, seen)
        pixels = pixel_depth(volume, seen.window, variance)
    return PixelDepth(pixels.vergence_per_m, pixels.relative_error, pixels.claimed & near.result())


def near_texture(seen: Seen) -> NDArray[np.bool_]:
    """Pixels whose windows lie on something lit that shows texture.

    The outline of a uniform object has no texture either: what lies behind it would be mixed in.
    """
    kept = segments.textured_parts(seen.lit, seen.uneven, _OUTLINE_REACH_PX // seen.reduction.every)
    return np.asarray((distance(kept) <= seen.window // 2) & ~seen.plain)


def find_regions(seen: Seen, volume: Volume, pixels: PixelDepth, known: Sequence[Plane] = ()) -> Regions:
    """Segments from the pixels' own depths, and the depth of each from all of its pixels at once.

    First each layer has one depth. If some of their segments turn out to be tilted, or to be stripes of a tilted
    surface, layers are planes, and pixels are shared out among them once more.

    Args:
        seen: of the frame.
        volume: of the frame.
        pixels: the depth of each pixel by itself.
        known: planes that are in the picture; if some are tilted, pixels are shared out among them at once.
    """
    if any(plane.tilted for plane in known):
        return _shared_out_on(list(known), seen, volume, pixels)
    separation = layer_step_per_m(volume)
    layers = [Plane(vergence) for vergence in segments.depth_layers(pixels, separation).tolist()]
    if not layers:
        nowhere = np.zeros(volume.parts.shape[-2:], dtype=np.int32)
        return Regions(0, (), nowhere, nowhere, nowhere)
    regions = _share_out(seen, volume, pixels, layers, separation)
    if len(layers) >= _MANY_LAYERS or any(depth.plane.tilted for depth in regions.depths):
        planes = _planes(seen.lit, seen.reduction.every, volume, pixels, regions)
        if any(plane.tilted for plane in planes):
            return _shared_out_on(planes, seen, volume, pixels)
    return regions


def _shared_out_on(planes: list[Plane], seen: Seen, volume: Volume, pixels: PixelDepth) -> Regions:
    """Segments of planes, and of the depths of what lies on none of them."""
    separation = layer_step_per_m(volume)
    surfaces, allowed = _surfaces(planes, pixels, separation, seen.window)
    return _share_out(seen, volume, pixels, surfaces, separation, allowed)


def _planes(lit: NDArray[np.bool_], every: int, volume: Volume, pixels: PixelDepth, regions: Regions) -> list[Plane]:
    """Distinct planes of segments, and those that several segments are stripes of, in place of them."""
    step_per_m = layer_step_per_m(volume)
    cells = Cells.of(volume, pixels.claimed & lit, every)
    spanning = spanning_planes(cells, cell_side(every), step_per_m)
    over = [plane.over(regions.label.shape) for plane in spanning]

    def is_stripe(number: int) -> bool:
        mask = (regions.label == number) & pixels.claimed
        own, *others = (
            float(np.median(np.abs(pixels.vergence_per_m[mask] - there[mask]))) if mask.any() else 0.0
            for there in (regions.depths[number - 1].plane.over(mask.shape), *over)
        )
        return any(other < _AS_NEAR * own for other in others)

    left = [number for number in range(1, len(regions.depths) + 1) if not is_stripe(number)]
    number = np.zeros(len(regions.depths) + 1, dtype=np.int32)
    number[left] = np.arange(1, len(left) + 1)
    planes = [regions.depths[index - 1].plane for index in left]
    return spanning + distinct_planes(planes, number[regions.label], step_per_m)


def _share_out(
    seen: Seen,
    volume: Volume,
    pixels: PixelDepth,
    layers: list[Plane],
    separation_per_m: float,
    allowed: NDArray[np.bool_] | None = None,
) -> Regions:
    """Segments of layers: connected pixels of one plane, where that may be."""
    every = seen.reduction.every
    layer = segments.assign(volume, layers, pixels, separation_per_m, every, seen.lit, allowed)
    parts, inside, unseen = _textured(seen, segments.split(layer, seen.lit & ~seen.plain, WINDOW_PX, every))
    count = int(parts.max(initial=0))
    number, sizes = np.zeros(count + 1, dtype=np.int32), np.bincount(inside.ravel(), minlength=count + 1)
    found: list[segments.SegmentDepth] = []
    for part, cells in enumerate(Cells.of_each(volume, inside, count, every), start=1):
        depth = depth_of(volume, cells, layers[int(np.median(layer[parts == part])) - 1])
        if depth is not None:
            found.append(replace(depth, pixels=float(sizes[part])))
            number[part] = len(found)
    label, inner = number[parts], number[inside]
    near = segments.grown(label, WINDOW_PX / every)
    if unseen.any():
        near[(distance(unseen) <= WINDOW_PX / every) & (label == 0)] = 0
    near[seen.plain] = 0
    target = joined(found, near)
    own = target == np.arange(target.size)
    renumbered = (np.cumsum(own) - 1).astype(np.int32)
    kept = tuple(depth for depth, itself in zip(found, own[1:].tolist(), strict=True) if itself)
    # Depth and contrast are of a segment itself, without what joins it.
    label, near = (renumbered[target][part] for part in (label, near))
    return Regions(len(layers), kept, label, np.where(own, renumbered, 0)[inner].astype(np.int32), near)


def depth_of(volume: Volume, cells: Cells, otherwise: Plane) -> segments.SegmentDepth | None:
    """The depth of a segment, tilted if its cells say so or if it is taken for a tilted one; None if it has none."""
    plane = fitted_plane(cells) or otherwise
    if plane.tilted and cells.pixels.size:
        depth = segments.segment_depth(volume, cells.sheared(volume, plane), float(cells.pixels.sum()), plane)
    else:
        depth = segments.segment_depth(volume, cells.whole, float(cells.size))
    known = depth.relative_error < 4.0 * HALF_CONFIDENCE and depth.correlation > 0.0
    return depth if known else None


def _surfaces(
    planes: list[Plane], pixels: PixelDepth, separation_per_m: float, window: int
) -> tuple[list[Plane], NDArray[np.bool_]]:
    """Planes, the depths of what clearly lies on none of them, and where each may be.

    Such a depth may cross a tilted plane elsewhere, where it must not take the plane's pixels; it needs a patch of a
    window, or noise would make some, and outlines.
    """
    shape = pixels.claimed.shape
    away = np.min([np.abs(pixels.vergence_per_m - plane.over(shape)) for plane in planes], axis=0)
    doubt = 0.5 * separation_per_m + 2.0 * pixels.relative_error * pixels.vergence_per_m
    beside = binary_opening(pixels.claimed & (away > doubt), np.ones((window, window), dtype=bool))
    others = PixelDepth(pixels.vergence_per_m, pixels.relative_error, beside)
    depths = segments.depth_layers(others, separation_per_m).tolist()
    about = distance(beside) <= window
    allowed = np.stack([np.ones(shape, dtype=bool)] * len(planes) + [about] * len(depths))
    return planes + [Plane(vergence) for vergence in depths], allowed


def _textured(seen: Seen, parts: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
    """The parts that show texture, numbered anew from 1, their interiors, and the pixels of the others."""
    every, kept = seen.reduction.every, 0
    label, inner = np.zeros((2, *parts.shape), dtype=np.int32)
    unseen = np.zeros(parts.shape, dtype=bool)
    uneven = seen.uneven

    def inside(number: int) -> NDArray[np.bool_] | None:
        if segments.textured(parts == number, uneven, _OUTLINE_REACH_PX // every):
            return segments.interior(parts, number, every)
        return None

    numbers = range(1, int(parts.max(initial=0)) + 1)
    with kept_threads() as pool:
        for number, within in zip(numbers, pool.map(inside, numbers), strict=True):
            if within is None:
                unseen |= parts == number
                continue
            kept += 1
            label[parts == number], inner[within] = kept, kept
    return label, inner, unseen
