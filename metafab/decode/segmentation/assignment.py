"""Assignment of pixels to planes: the connected segments of each, and the depth of each segment from its cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from metafab.core.numeric.distance import distance
from metafab.core.parallel.executor import kept_threads
from metafab.decode.confidence import LARGEST_ERROR
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.matching.pooling import opened_by_square
from metafab.decode.segmentation.continuous.doubt import right_depth
from metafab.decode.segmentation.continuous.surface import matched_surface
from metafab.decode.segmentation.fragments import fragment_targets
from metafab.decode.segmentation.layers import assign_layers, connected_segments, depth_layers, grown
from metafab.decode.segmentation.outlines import ROUNDS
from metafab.decode.segmentation.planes import Cells, Plane, cell_side, fit_plane, ransac_planes
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segment_depth import interior, is_textured, segment_depth, with_error_of_straight
from metafab.decode.segmentation.segments import Regions, SegmentDepth
from metafab.decode.segmentation.slopes import along_planes

#: Side of a cell of continuous surfaces, frame pixels.
_SURFACE_CELL_PX = 18
#: Most layers that such a surface crosses within a cell.
_SURFACE_STEEPEST = 6.0
#: Most planes of such surfaces.
_MOST_SURFACES = 24
#: Most cells of a frame whose surfaces are sought: 0.4 GB, which grow with its square, and 4 s of processor time.
#: Frames of 1.0 to 1.3 million pixels have 4000.
_MOST_SURFACE_CELLS = 4000
#: Distance from an outline up to which a window, with the pair's main lobes, contains it; frame pixels.
OUTLINE_REACH_PX = 40
#: Pixels below which a segment may be the outline of a plain surface: twice a window.
NARROW_PX = 2 * WINDOW_PX**2


@dataclass(frozen=True)
class SegmentationNumerics:
    """Numerics of the segmentation of a frame."""

    outline_rounds: int = ROUNDS  #: Most rounds of the refinement of outlines.
    refined: bool = True  #: Whether to separate layers by noise, and leave outliers out of depths.
    slopes: bool = True  #: Whether a refined segmentation measures slopes along their planes.
    surfaces: bool = True  #: Whether a refined segmentation seeks continuous surfaces.
    robust_rounds: int = 3  #: Most rounds of leaving outliers out; a segment's depth settles after two.

    @property
    def along_planes(self) -> bool:
        """Whether slopes are measured along their planes."""
        return self.refined and self.slopes


@dataclass(frozen=True)
class Segmentation:
    """The inputs that every assignment of a frame's pixels shares."""

    prepared: PreparedFrame  #: The frame.
    volume: CostVolume  #: Its cost volume.
    pixels: PixelDepth  #: Depth of each pixel.
    separation_per_m: float  #: Vergence by which layers differ.
    numerics: SegmentationNumerics = SegmentationNumerics()  #: Numerics.
    #: Returns the cost volume of continuous surfaces, by filters that keep textures in place; None for ``volume``.
    volume_in_place: Callable[[], CostVolume] | None = None

    @property
    def surface_volume(self) -> CostVolume:
        """Cost volume of continuous surfaces."""
        return self.volume if self.volume_in_place is None else self.volume_in_place()

    @property
    def layers(self) -> list[Plane]:
        """Layers of one depth at the peaks of the pixels' depths."""
        return [Plane(vergence) for vergence in depth_layers(self.pixels, self.separation_per_m).tolist()]

    def of_planes(self, planes: list[Plane]) -> Regions:
        """Segments of planes, and of the depths of pixels that clearly lie on none of them.

        Such a depth may equal that of a tilted plane elsewhere, where it must not take the plane's pixels. It needs a
        patch as large as a window: noise and outlines are smaller.
        """
        pixels, window = self.pixels, self.prepared.window
        shape = pixels.claimed.shape
        away = np.full(shape, np.inf)
        for plane in planes:
            np.minimum(away, np.abs(pixels.vergence_per_m - plane.over(shape)), out=away)
        doubt = 0.5 * self.separation_per_m + 2.0 * pixels.relative_error * pixels.vergence_per_m
        off_planes = opened_by_square(pixels.claimed & (away > doubt), window)
        depths = depth_layers(replace(pixels, claimed=off_planes), self.separation_per_m).tolist()
        near = distance(off_planes) <= window
        allowed = np.stack([np.ones(shape, dtype=bool)] * len(planes) + [near] * len(depths))
        return self.of_layers(planes + [Plane(vergence) for vergence in depths], allowed)

    def of_surfaces(self, before: Regions | None = None) -> tuple[Regions, Regions] | None:
        """Segments of the planes across a surface of semi-global matching; None if it has too many cells.

        Where the surface has no tilted planes, its pieces are the segments ``before``, and without them there are none.

        Returns:
            Pixels at the depths of the planes, and all lit pixels, those of plain parts included, at the surface's own.
        """
        prepared, volume, separation = self.prepared, self.volume, self.separation_per_m
        step = prepared.downsampling.step
        cells = Cells.of(volume, self.pixels.claimed & prepared.lit, step, _SURFACE_CELL_PX)
        if cells.row.size > _MOST_SURFACE_CELLS:
            return None
        surface = matched_surface(prepared, self.surface_volume)
        vergence = surface.vergence_per_m
        at = np.rint(cells.row).astype(np.intp), np.rint(cells.column).astype(np.intp)
        error = np.full(at[0].shape, 0.1 * separation)
        cells = replace(cells, vergence_per_m=vergence[at], error_per_m=error)
        side = cell_side(step, _SURFACE_CELL_PX)
        planes = ransac_planes(cells, side, separation, _SURFACE_STEEPEST, _MOST_SURFACES)
        of_surface = replace(self, pixels=replace(self.pixels, vergence_per_m=vergence))
        regions = of_surface.of_planes(planes) if planes else before
        if regions is None:
            return None
        everywhere = np.where(prepared.lit, grown(regions.grown), 0).astype(np.int32)
        return regions, replace(regions, grown=everywhere, right=right_depth(surface, step), surface_per_m=vergence)

    def of_layers(self, layers: list[Plane], allowed: NDArray[np.bool_] | None = None) -> Regions:
        """Segments of layers: connected pixels of one plane, where ``allowed`` (n_layers, n_y, n_x)."""
        prepared, volume, step = self.prepared, self.volume, self.prepared.downsampling.step
        rounds = self.numerics.outline_rounds
        layer = assign_layers(volume, layers, self.pixels, self.separation_per_m, step, prepared.lit, allowed, rounds)
        segments = connected_segments(layer, prepared.lit & ~prepared.plain, WINDOW_PX, step)
        parts, inside, plain = self._textured(segments)
        count = int(parts.max(initial=0))
        number, sizes = np.zeros(count + 1, dtype=np.int32), np.bincount(inside.ravel(), minlength=count + 1)
        depths: list[SegmentDepth] = []
        light = prepared.inner.sum(axis=0)
        for part, cells in enumerate(Cells.of_each(volume, inside, count, step), start=1):
            own = layers[int(np.median(layer[parts == part])) - 1]
            depth = measured_depth(volume, cells, own)
            if depth is not None and not self.holds(own, depth):
                depth = self.in_layer(own, inside == part) or depth
            if depth is not None and sizes[part] * step**2 < NARROW_PX:
                depth = with_error_of_straight(depth, light, inside == part, volume.samples)
            if depth is not None and depth.relative_error < LARGEST_ERROR:
                depths.append(replace(depth, pixels=float(sizes[part])))
                number[part] = len(depths)
        label, inner = number[parts], number[inside]
        wide = grown(label, WINDOW_PX / step)
        if plain.any():
            wide[(distance(plain) <= WINDOW_PX / step) & (label == 0)] = 0
        wide[prepared.plain] = 0
        target = fragment_targets(depths, wide, step)
        # Depth and contrast are measured without the fragments that are merged into a segment.
        regions, _ = Regions(len(layers), tuple(depths), label, inner, wide).merged(target, interiors=False)
        if not self.numerics.along_planes:
            return regions
        return replace(regions, depths=along_planes(regions.depths, regions.interior, volume, step))

    def holds(self, layer: Plane, depth: SegmentDepth) -> bool:
        """Whether the depth of a segment lies in its layer.

        A layer is where most of its pixels' depths are, a segment's depth where the sums of the twins' products
        correlate best. Few pixels of other surfaces, such as bars, move these sums if their texture is stronger.
        """
        tilted = layer.tilted or depth.plane.tilted
        return tilted or abs(depth.vergence_per_m - layer.vergence_per_m) < self.separation_per_m

    def in_layer(self, layer: Plane, inside: NDArray[np.bool_]) -> SegmentDepth | None:
        """Depth of the pixels of an interior, shape (n_y, n_x), whose own depth lies in the segment's layer.

        None where they are not most of those with a depth: then the layer is not that of the segment.
        """
        inside = inside & self.pixels.claimed
        away = np.abs(self.pixels.vergence_per_m - layer.over(inside.shape))
        kept = inside & (away < self.separation_per_m)
        if 2 * np.count_nonzero(kept) <= np.count_nonzero(inside):
            return None
        return measured_depth(self.volume, Cells.of(self.volume, kept, self.prepared.downsampling.step), layer)

    def _textured(self, segments: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
        """The segments that show texture, numbered anew from 1, their interiors, and the pixels of the others."""
        step, texture, count = self.prepared.downsampling.step, self.prepared.textured, 0
        label, inner = np.zeros((2, *segments.shape), dtype=np.int32)
        plain = np.zeros(segments.shape, dtype=bool)

        # Interior and texture depend on the surroundings of a segment alone.
        reach = OUTLINE_REACH_PX // step
        boxes = [
            tuple(slice(max(0, at.start - reach), at.stop + reach) for at in box) for box in find_objects(segments)
        ]

        def interior_of(number: int, box: tuple[slice, ...]) -> NDArray[np.bool_] | None:
            if is_textured(segments[box] == number, texture[box], reach):
                return interior(segments[box], number, step)
            return None

        numbers = range(1, len(boxes) + 1)
        with kept_threads() as pool:
            for number, box, inside in zip(numbers, boxes, pool.map(interior_of, numbers, boxes), strict=True):
                own = segments[box] == number
                if inside is None:
                    plain[box] |= own
                    continue
                count += 1
                label[box][own], inner[box][inside] = count, count
        return label, inner, plain


def measured_depth(volume: CostVolume, cells: Cells, layer: Plane) -> SegmentDepth | None:
    """Depth of a segment from its cells: tilted if they, or else its layer, are tilted; None if it has none.

    A curved layer keeps its shape.
    """
    plane = layer if layer.curved else fit_plane(cells) or layer
    if plane.tilted and cells.pixels.size:
        depth = segment_depth(volume, cells.sheared(volume, plane), float(cells.pixels.sum()), plane)
    else:
        depth = segment_depth(volume, cells.whole, float(cells.size))
    return depth if depth.relative_error < LARGEST_ERROR and depth.correlation > 0.0 else None


def measured_again(volume: CostVolume, cells: Cells, before: SegmentDepth, pixels: float, step: int) -> SegmentDepth:
    """Depth of a segment from other cells, or the depth before if they have none, or too few for its tilt.

    Args:
        volume: cost volume that holds the cells.
        cells: of the segment.
        before: depth of the segment; its factor of straight structure stays while the segment is narrow.
        pixels: downsampled pixels of the segment.
        step: frame pixels from one downsampled pixel to the next.
    """
    if before.of_outline or (before.plane.tilted and not cells.pixels.size):
        return replace(before, pixels=pixels)
    factor = before.error_factor if pixels * step**2 < NARROW_PX else 1.0
    measured = measured_depth(volume, cells, before.plane)
    if measured is None or not measured.relative_error * factor < LARGEST_ERROR:
        return replace(before, pixels=pixels)
    return replace(measured, relative_error=measured.relative_error * factor, pixels=pixels, error_factor=factor)
