"""Segmentation of a frame: cost volume and pixel depths -> segments with their depths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening
from scipy.sparse.csgraph import connected_components

from metafab.core.numeric.distance import distance
from metafab.core.parallel.executor import kept_threads
from metafab.core.parallel.progress import silent
from metafab.decode.confidence import LARGEST_ERROR, right_segment
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import PixelDepth, pixel_depth
from metafab.decode.matching.filters import CrossFilters
from metafab.decode.segmentation.fit import (
    OUTLINE_LIGHT_PX,
    Misfit,
    across_outlines,
    curved_surface,
    explains_better,
    fitting_segments,
    foreign_light,
    misfit_at,
    plane_misfit,
    surface_per_m,
)
from metafab.decode.segmentation.frame_model import FrameModel
from metafab.decode.segmentation.layer_light import LayerOptics
from metafab.decode.segmentation.objects.bars import with_bars
from metafab.decode.segmentation.objects.plain_objects import with_plain_objects
from metafab.decode.segmentation.objects.small_objects import SmallObject, small_objects
from metafab.decode.segmentation.outlines import ROUNDS
from metafab.decode.segmentation.planes import Cells, Plane, cell_side, distinct_planes, fit_plane, ransac_planes
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import (
    Regions,
    SegmentDepth,
    adjacency,
    assign_layers,
    connected_segments,
    depth_layers,
    fragment_targets,
    grown,
    interior,
    is_textured,
    segment_depth,
    textured_components,
    with_error_of_straight,
)

#: Largest separation of layers, as a share of the calibrated range of vergence.
_LAYER_SHARE = 1.0 / 24.0
#: Separation of layers in median standard errors of the pixels' depths, which scatter by 1.5 times what they state.
_SEPARATION_ERRORS = 2.0
#: Standard errors, and relative difference, within which adjacent segments have one depth.
_ONE_DEPTH_ERRORS, _ONE_DEPTH = 2.5, 1.5e-3
#: Ratio of misfits below which finer layers replace coarser ones, or planes.
_CLEARLY_BETTER = 0.93
#: Misfit of pixels' depths to planes fitted to their segments from which segments are sought on continuous surfaces:
#: scenes of flat objects and photographs on them have 1.0 to 2.4, a steep ground 3.1, the Middlebury motorcycle 6.
_UNFIT = 2.6
#: Side of a cell of such surfaces, frame pixels.
_SURFACE_CELL_PX = 18
#: Most layers that such a surface crosses within a cell.
_SURFACE_STEEPEST = 6.0
#: Most planes of such surfaces.
_MOST_SURFACES = 24
#: Most downsampled pixels and cells of a frame whose surfaces are sought. A pixel takes a kilobyte. This number of
#: cells takes 0.4 GB, which grows with its square, and 4 s of processor time; frames of 1.0 to 1.3 million pixels have
#: 4000.
_MOST_SURFACE_PIXELS, _MOST_SURFACE_CELLS = 400_000, 4000
#: Misfit from which a pixel is left out of its segment's depth: 12 samples of noise reach it in one of 10^3 windows.
_LARGEST_MISFIT = 2.5
#: Share of such pixels that changes no depth, and share of the pixels that is kept at least.
_FEW_OUTLIERS, _LEAST_KEPT = 0.01, 0.3
#: Most rounds of leaving them out; a segment's depth settles after two.
ROBUST_ROUNDS = 3
#: Change of a depth, in standard errors, below which its outliers stay the same.
_SETTLED = 0.25
#: Light of another segment over a segment's own from which that is measured without brighter light: the step at their
#: outline is then its own light. Last: most segments of a frame that are, one cost volume each.
_BRIGHTER, _MOST_DIM = 2.0, 4
#: Parameters of a plane that are fitted to a segment's pixels: its depth, or its depth and slopes.
_MOVED, _TILTED = 1, 3
#: Distance from an outline up to which a window, with the pair's main lobes, contains it; frame pixels.
_OUTLINE_REACH_PX = 40
#: Pixels below which a segment may be the outline of a plain surface: twice a window.
_NARROW_PX = 2 * WINDOW_PX**2
#: Number of layers from which they may be stripes of a tilted surface.
_MANY_LAYERS = 5
#: A segment is a stripe of a plane if its pixels' depths differ at most this many times as much from the plane.
_STRIPE_RATIO = 1.25


def layer_separation_per_m(volume: CostVolume) -> float:
    """Largest vergence by which layers differ: that of tilted planes, and of segments in successive frames."""
    return float(volume.vergences_per_m[-1] - volume.vergences_per_m[0]) * _LAYER_SHARE


def noise_separation_per_m(volume: CostVolume, pixels: PixelDepth) -> float:
    """Vergence by which the noise of the pixels' depths lets layers be told apart."""
    largest = layer_separation_per_m(volume)
    if not pixels.claimed.any():
        return largest
    error = float(np.median((pixels.relative_error * pixels.vergence_per_m)[pixels.claimed]))
    return float(np.clip(_SEPARATION_ERRORS * error, 0.02 * largest, largest))


def textured_pixel_depth(prepared: PreparedFrame, volume: CostVolume) -> PixelDepth:
    """Depth of each pixel, claimed where the window around it lies on a textured surface."""
    # Shared by both threads below, and computed on all of them.
    variance, _ = prepared.variance, prepared.textured
    with kept_threads() as pool:
        near = pool.submit(near_texture, prepared)
        pixels = pixel_depth(volume, prepared.window, variance)
    return replace(pixels, claimed=pixels.claimed & near.result())


def near_texture(prepared: PreparedFrame) -> NDArray[np.bool_]:
    """Pixels whose windows lie on a textured lit surface: shape (n_y, n_x).

    At the outline of a uniform object, the texture of the background would be mixed in.
    """
    reach, texture, objects = _OUTLINE_REACH_PX // prepared.downsampling.step, prepared.textured, prepared.plain_objects
    if objects.any():
        texture = texture & (distance(objects > 0) > prepared.outline_reach)
    textured = textured_components(prepared.lit, texture, reach) & (objects == 0)
    return np.asarray((distance(textured) <= prepared.window // 2) & ~prepared.plain)


def unspoiled(prepared: PreparedFrame, pixels: PixelDepth) -> PixelDepth:
    """Pixel depths without those about saturated or invalid pixels, which err by more than their noise.

    All of them if few others are left.
    """
    whole = pixels.claimed & ~prepared.spoiled
    return replace(pixels, claimed=whole) if whole.sum() > _LEAST_KEPT * pixels.claimed.sum() else pixels


def find_regions(
    prepared: PreparedFrame,
    volume: CostVolume,
    pixels: PixelDepth,
    known: Sequence[Plane] = (),
    outline_rounds: int = ROUNDS,
    *,
    refined: bool = True,
    robust_rounds: int = ROBUST_ROUNDS,
    optics: LayerOptics | None = None,
    filters: CrossFilters | None = None,
) -> Regions:
    """Segment a frame, with the probability that each pixel is in the right segment.

    With ``optics``, light that does not fit its segment, away from outlines, is that of small objects, or has no depth.

    Args:
        pixels: depth of each pixel.
        known: planes of the picture; if some are tilted, pixels are assigned to them at once.
        outline_rounds: most rounds of the refinement of outlines.
        refined: whether to separate layers by noise, leave outliers out of depths, and compute that probability.
        robust_rounds: most rounds of leaving outliers out.
        optics: the pair, for outlines by the model of the frame, and for small objects; without, outlines stay where
            correlation puts them.
        filters: matched filters, for the depth of segments much dimmer than others; without, it is not measured again.
    """
    segments = _find_regions(prepared, volume, pixels, known, outline_rounds, refined=refined)
    regions = with_plain_objects(segments, prepared, volume)
    if not (regions.depths and refined):
        return regions
    step, refused = prepared.downsampling.step, np.zeros(regions.grown.shape, dtype=bool)
    if optics is not None and not regions.continuous:
        regions, refused = with_bars(regions, prepared, volume, optics)
        regions = with_modelled_outlines(prepared, regions, optics)
    label = regions.grown

    def misfit_of(number: NDArray[np.int32], model_error: float | None = None) -> Misfit:
        return misfit_at(prepared, volume, regions.vergence_per_m(number), regions.interior, model_error)

    def at_segment(number: int) -> Misfit:
        # The blur of a plain object's outline fits its depth beyond it.
        same = np.full(label.shape, number, dtype=np.int32)
        return own if regions.of_outline[number] else misfit_of(same, own.model_error)

    own, moving = misfit_of(label), np.ones(len(regions.depths) + 1, dtype=bool)
    for _ in range(robust_rounds):
        judged = np.where(prepared.spoiled, np.float32(np.inf), own.over_noise)
        before = regions.depths
        regions = without_outliers(regions, volume, judged, step, moving)
        moving[1:] = [not _is_settled(*both, label.shape) for both in zip(regions.depths, before, strict=True)]
        if not moving[1:].any():
            break
        own = misfit_of(label)
    if filters is not None and not regions.continuous:
        measured = without_bright_light(prepared, filters, regions)
        if measured is not regions:
            regions = measured
            own = misfit_of(label)
    if optics is not None:
        reach = _OUTLINE_REACH_PX / step
        judge = None if regions.continuous else FrameModel(prepared, regions, optics).explained_moves
        owner, own = fitting_segments(label, prepared.spoiled, own, at_segment, reach, judge)
        regions = regions.with_owners(owner)
        label = regions.grown
    none, misfit_here = np.zeros(label.shape, dtype=bool), own.over_noise
    unexplained = none if optics is None else foreign_light(regions, own, step) & ~prepared.spoiled
    if optics is not None and unexplained.any():
        vergence = regions.vergence_per_m(label)
        # The blur of bars and plain objects is no object of its own.
        searched = unexplained & (distance(regions.of_outline[label]) * step > OUTLINE_LIGHT_PX)
        found = [] if regions.continuous else small_objects(prepared, optics, vergence, searched, misfit_here)
        misfit_here = misfit_here.copy()
        for one in found:
            misfit_here[one.blob] = np.minimum(misfit_here[one.blob], one.misfit)
            unexplained[one.blob] = False
        regions = with_small_objects(regions, found, volume)
        label = regions.grown
    across, away = across_outlines(label, regions.vergence_per_m(label))
    other = misfit_of(across, own.model_error) if across.any() else own
    # Outlines of plain objects are judged as a whole.
    misfit_here = np.where(regions.of_outline[label], np.float32(1.0), misfit_here)
    right = right_segment(misfit_here, other.over_noise, away * step)
    refused |= unexplained & (other.is_foreign | (across == 0))
    return replace(regions, right=np.where(refused, 0.0, right))


def with_modelled_outlines(prepared: PreparedFrame, regions: Regions, optics: LayerOptics) -> Regions:
    """Segments by the model of the frame: without false pieces, and with the outlines that explain it."""
    # A plain surface has no segment that could explain the light of a piece beside it.
    beside_plain = set(regions.grown[distance(prepared.plain) <= 2.0].tolist())
    most = _NARROW_PX / prepared.downsampling.step**2
    pieces = ((number, one) for number, one in enumerate(regions.depths, 1) if not one.of_outline)
    narrow = [number for number, one in pieces if one.pixels < most and number not in beside_plain]
    model = FrameModel(prepared, regions, optics)
    false = model.false_pieces(narrow)
    if false:
        model = FrameModel(prepared, regions.without(false), optics)
    owner = model.owners()
    return model.regions if owner is None else model.regions.with_owners(owner)


def with_small_objects(regions: Regions, found: Sequence[SmallObject], volume: CostVolume) -> Regions:
    """Segments, and those of small objects."""
    depths = list(regions.depths)
    label, inside, wide = regions.label.copy(), regions.interior.copy(), regions.grown.copy()
    for one in found:
        sums = volume.at(np.array([one.vergence_per_m]))[:, 0, *one.blob][:, one.mask].sum(axis=1, dtype=np.float64)
        pixels = float(one.mask.sum())
        power = float(np.sqrt(sums[1] * sums[2])) / pixels
        agreement, plane = float(correlation(sums)), Plane(one.vergence_per_m)
        depths.append(SegmentDepth(one.vergence_per_m, one.relative_error, agreement, power, plane, pixels))
        for picture in (label, inside, wide):
            picture[one.blob][one.mask] = len(depths)
    return replace(regions, depths=tuple(depths), label=label, interior=inside, grown=wide)


def _is_settled(depth: SegmentDepth, before: SegmentDepth, shape: tuple[int, ...]) -> bool:
    """Whether two measurements of a segment's depth agree all over the picture within a small share of their error."""
    if depth is before:
        return True
    corners = np.array([[0.0], [shape[0]]]), np.array([[0.0, shape[1]]])
    ratio = depth.plane.at(*corners) / before.plane.at(*corners)
    return bool(np.abs(ratio - 1.0).max() < _SETTLED * depth.relative_error)


def without_outliers(
    regions: Regions, volume: CostVolume, misfits: NDArray[np.float32], step: int, which: NDArray[np.bool_]
) -> Regions:
    """Measure the depths of segments again without the pixels that they do not explain; ``regions`` if there are few.

    Args:
        misfits: shape (n_y, n_x), misfit of each pixel at its segment's depth.
        step: frame pixels from one downsampled pixel to the next.
        which: shape (n_segments + 1,), segments that are measured, by number.
    """
    count = len(regions.depths)
    kept = np.where(misfits < _LARGEST_MISFIT, regions.interior, 0)
    before, after = (np.bincount(label.ravel(), minlength=count + 1)[1:] for label in (regions.interior, kept))
    again = np.flatnonzero(which[1:] & (after < (1.0 - _FEW_OUTLIERS) * before) & (after > _LEAST_KEPT * before))
    if not again.size:
        return regions
    number = np.zeros(count + 1, dtype=np.int32)
    number[again + 1] = np.arange(1, again.size + 1)
    depths = list(regions.depths)
    for index, cells in zip(again.tolist(), Cells.of_each(volume, number[kept], again.size, step), strict=True):
        depths[index] = measured_again(volume, cells, depths[index], depths[index].pixels, step)
    return replace(regions, depths=tuple(depths))


def without_bright_light(prepared: PreparedFrame, filters: CrossFilters, regions: Regions) -> Regions:
    """Measure the depth of each segment of at most half of another's light again, with brighter segments faded out.

    Returns:
        Segments with the new depths, of the largest ones if many are dim; ``regions`` itself if none is.
    """
    count, step = len(regions.depths), prepared.downsampling.step
    pixels = np.bincount(regions.interior.ravel(), minlength=count + 1)[1:]
    sums = [np.bincount(regions.interior.ravel(), one.ravel(), count + 1)[1:] for one in prepared.inner]
    light = np.stack(sums, axis=1) / np.maximum(pixels, 1)[:, None]
    both = light.sum(axis=1)
    dim = np.flatnonzero((both > 0.0) & (_BRIGHTER * both <= both.max()) & (pixels * step**2 >= _NARROW_PX))
    depths = list(regions.depths)
    for index in dim[np.argsort(-pixels[dim])][:_MOST_DIM].tolist():
        bright = np.append(False, both >= _BRIGHTER * both[index])[regions.grown]
        inside = np.where(regions.interior == index + 1, np.int32(index + 1), np.int32(0))
        spectra, whole = prepared.without_light(bright, light[index], float(both.max() / both[index]))
        volume = filters.volume(spectra, prepared.levels, inside > 0, silent)
        misfit = misfit_at(prepared, volume, regions.vergence_per_m(inside), inside).over_noise
        kept = (inside > 0) & whole & (misfit < _LARGEST_MISFIT) & ~prepared.spoiled
        if kept.sum() > _LEAST_KEPT * pixels[index]:
            cells = Cells.of(volume, kept, step)
            depths[index] = measured_again(volume, cells, depths[index], depths[index].pixels, step)
    return replace(regions, depths=tuple(depths)) if dim.size else regions


def _find_regions(
    prepared: PreparedFrame,
    volume: CostVolume,
    pixels: PixelDepth,
    known: Sequence[Plane],
    outline_rounds: int,
    *,
    refined: bool,
) -> Regions:
    """Segment a frame; depths still hold the outliers of their segments.

    At first each layer has one depth. If some of its segments are tilted, or are stripes of a tilted surface, the
    layers become planes, and pixels are assigned to them once more. Where noise tells more layers apart, those replace
    them if the pixels' depths fit clearly better: a staircase lies within the cells' errors of a plane. Segments whose
    pixels lie on a quadric of vergence become one, if there are no more of them and they explain the twins better.
    Where the pixels' depths fit no planes, segments are pieces of planes across the surface of semi-global matching, if
    those explain the twins better.
    """
    segmentation = _Segmentation(prepared, volume, pixels, layer_separation_per_m(volume), outline_rounds)
    if any(plane.tilted for plane in known):
        return segmentation.of_planes(list(known))
    coarse = segmentation.layers
    if not coarse:
        none = np.zeros(volume.shape, dtype=np.int32)
        return Regions(0, (), none, none, none)
    regions = _of_layers_or_planes(segmentation, coarse, refined=refined)
    inside = unspoiled(prepared, pixels).claimed & (regions.interior > 0)
    if not (refined and inside.any()):
        return regions
    planes = curved_and_planes(regions, pixels, segmentation.separation_per_m)
    if any(plane.curved for plane in planes):
        curved = segmentation.of_planes(planes)
        fewer = len(curved.depths) <= len(regions.depths)
        if fewer and explains_better(curved, regions, prepared, volume, pixels):
            return curved
    if inside.size > _MOST_SURFACE_PIXELS or plane_misfit(regions, pixels, inside, _TILTED) < _UNFIT:
        return regions
    surfaces = segmentation.of_surfaces()
    if surfaces is None or not explains_better(surfaces, regions, prepared, volume, pixels):
        return regions
    return surfaces


def _of_layers_or_planes(segmentation: _Segmentation, coarse: list[Plane], *, refined: bool) -> Regions:
    """Segments of layers, of planes across them, or of the layers that noise tells apart."""
    prepared, volume, pixels = segmentation.prepared, segmentation.volume, segmentation.pixels
    regions = segmentation.of_layers(coarse)
    if len(coarse) >= _MANY_LAYERS or any(depth.plane.tilted for depth in regions.depths):
        cells = Cells.of(volume, pixels.claimed & prepared.lit, prepared.downsampling.step)
        planes = planes_across(cells, cell_side(prepared.downsampling.step), volume, pixels, regions)
        if any(plane.tilted for plane in planes):
            regions = segmentation.of_planes(planes)
    if not refined:
        return regions
    clean = unspoiled(prepared, pixels)
    finer = replace(segmentation, separation_per_m=noise_separation_per_m(volume, clean))
    layers = [Plane(vergence) for vergence in depth_layers(clean, finer.separation_per_m).tolist()]
    if len(layers) <= len(coarse):
        return regions
    of_noise = finer.of_layers(layers)
    needed = distinct_layers(of_noise, layers)
    if len(needed) < len(layers):
        of_noise = finer.of_layers(needed)
    # Next to outlines, where depths mix, more layers always fit better.
    inside = clean.claimed & (regions.interior > 0)
    # Outliers leave a segment's depth only later: finer layers may move, but a slope must not pass for their steps.
    moved, tilted = plane_misfit(of_noise, pixels, inside, _MOVED), plane_misfit(regions, pixels, inside, _TILTED)
    return of_noise if moved < _CLEARLY_BETTER * tilted else regions


def curved_and_planes(regions: Regions, pixels: PixelDepth, separation_per_m: float) -> list[Plane]:
    """Quadrics of the segments that lie on those and on no planes, and the distinct planes of all others."""
    count = len(regions.depths) + 1
    vergence = np.array([np.inf, *(depth.vergence_per_m for depth in regions.depths)])
    near = np.abs(vergence[1:, None] - vergence[1:]) < separation_per_m
    groups, group = connected_components(near & adjacency(regions.grown, count)[1:, 1:])
    curved: list[Plane] = []
    remaining = np.zeros(count, dtype=np.int32)
    planes: list[Plane] = []
    for numbers in (1 + np.flatnonzero(group == one) for one in range(groups)):
        surface = curved_surface(regions, pixels, numbers.tolist())
        if surface is not None:
            curved.append(surface)
            continue
        for number in numbers.tolist():
            planes.append(regions.depths[number - 1].plane)
            remaining[number] = len(planes)
    return curved + distinct_planes(planes, remaining[regions.label], separation_per_m)


def distinct_layers(regions: Regions, layers: list[Plane]) -> list[Plane]:
    """Layers without those whose segments all have the depth of a larger neighbour within their errors."""
    count = len(regions.depths) + 1
    sizes, touching = np.bincount(regions.grown.ravel(), minlength=count), adjacency(regions.grown, count)
    vergence = np.array([0.0, *(depth.vergence_per_m for depth in regions.depths)])
    error = np.array([0.0, *(depth.relative_error for depth in regions.depths)])
    own = np.abs(np.array([plane.vergence_per_m for plane in layers])[:, None] - vergence[1:]).argmin(axis=0)
    kept = np.zeros(len(layers), dtype=bool)
    for number in range(1, count):
        larger = np.flatnonzero(
            touching[number] & ((sizes > sizes[number]) | ((sizes == sizes[number]) & (np.arange(count) < number)))
        )
        larger = larger[larger > 0]
        difference = np.abs(vergence[larger] / vergence[number] - 1.0)
        allowed = np.maximum(_ONE_DEPTH_ERRORS * np.hypot(error[larger], error[number]), _ONE_DEPTH)
        if not (difference < allowed).any():
            kept[own[number - 1]] = True
    return [plane for plane, stays in zip(layers, kept.tolist(), strict=True) if stays] or layers


def planes_across(cells: Cells, side: int, volume: CostVolume, pixels: PixelDepth, regions: Regions) -> list[Plane]:
    """Planes that span several layers, and the distinct planes of segments that are no stripes of those.

    Args:
        cells: of the whole picture.
        side: of a cell, downsampled pixels.
        pixels: depth of each pixel.
        regions: segments of one depth.
    """
    separation = layer_separation_per_m(volume)
    spanning = ransac_planes(cells, side, separation)
    surfaces = [plane.over(regions.label.shape) for plane in spanning]

    def is_stripe(number: int) -> bool:
        mask = (regions.label == number) & pixels.claimed
        if not mask.any():
            return False
        vergence, plane = pixels.vergence_per_m[mask], regions.depths[number - 1].plane.over(mask.shape)
        away = float(np.median(np.abs(vergence - plane[mask])))
        return any(float(np.median(np.abs(vergence - one[mask]))) < _STRIPE_RATIO * away for one in surfaces)

    remaining = [number for number in range(1, len(regions.depths) + 1) if not is_stripe(number)]
    renumbered = np.zeros(len(regions.depths) + 1, dtype=np.int32)
    renumbered[remaining] = np.arange(1, len(remaining) + 1)
    planes = [regions.depths[number - 1].plane for number in remaining]
    return spanning + distinct_planes(planes, renumbered[regions.label], separation)


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
    """Depth of a segment from other cells, or the depth before if they have none.

    Args:
        volume: cost volume that holds the cells.
        cells: of the segment.
        before: depth of the segment; its factor of straight structure stays while the segment is narrow.
        pixels: downsampled pixels of the segment.
        step: frame pixels from one downsampled pixel to the next.
    """
    if before.of_outline:
        return replace(before, pixels=pixels)
    factor = before.error_factor if pixels * step**2 < _NARROW_PX else 1.0
    measured = measured_depth(volume, cells, before.plane)
    if measured is None or not measured.relative_error * factor < LARGEST_ERROR:
        return replace(before, pixels=pixels)
    return replace(measured, relative_error=measured.relative_error * factor, pixels=pixels, error_factor=factor)


@dataclass(frozen=True)
class _Segmentation:
    """The inputs that every assignment of a frame's pixels shares."""

    prepared: PreparedFrame
    volume: CostVolume
    pixels: PixelDepth
    separation_per_m: float
    outline_rounds: int

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
        away = np.min([np.abs(pixels.vergence_per_m - plane.over(shape)) for plane in planes], axis=0)
        doubt = 0.5 * self.separation_per_m + 2.0 * pixels.relative_error * pixels.vergence_per_m
        off_planes = binary_opening(pixels.claimed & (away > doubt), np.ones((window, window), dtype=bool))
        depths = depth_layers(replace(pixels, claimed=off_planes), self.separation_per_m).tolist()
        near = distance(off_planes) <= window
        allowed = np.stack([np.ones(shape, dtype=bool)] * len(planes) + [near] * len(depths))
        return self.of_layers(planes + [Plane(vergence) for vergence in depths], allowed)

    def of_surfaces(self) -> Regions | None:
        """Segments of the planes across a surface of semi-global matching; None without any, or of too many cells."""
        prepared, volume, separation = self.prepared, self.volume, self.separation_per_m
        step = prepared.downsampling.step
        cells = Cells.of(volume, self.pixels.claimed & prepared.lit, step, _SURFACE_CELL_PX)
        if cells.row.size > _MOST_SURFACE_CELLS:
            return None
        surface = surface_per_m(prepared, volume)
        at = np.rint(cells.row).astype(np.intp), np.rint(cells.column).astype(np.intp)
        error = np.full(at[0].shape, 0.1 * separation)
        cells = replace(cells, vergence_per_m=surface[at], error_per_m=error)
        side = cell_side(step, _SURFACE_CELL_PX)
        planes = ransac_planes(cells, side, separation, _SURFACE_STEEPEST, _MOST_SURFACES)
        if not planes:
            return None
        of_surface = replace(self, pixels=replace(self.pixels, vergence_per_m=surface))
        return replace(of_surface.of_planes(planes), continuous=True)

    def of_layers(self, layers: list[Plane], allowed: NDArray[np.bool_] | None = None) -> Regions:
        """Segments of layers: connected pixels of one plane, where ``allowed`` (n_layers, n_y, n_x)."""
        prepared, volume, step = self.prepared, self.volume, self.prepared.downsampling.step
        layer = assign_layers(
            volume, layers, self.pixels, self.separation_per_m, step, prepared.lit, allowed, self.outline_rounds
        )
        segments = connected_segments(layer, prepared.lit & ~prepared.plain, WINDOW_PX, step)
        parts, inside, plain = self._textured(segments)
        count = int(parts.max(initial=0))
        number, sizes = np.zeros(count + 1, dtype=np.int32), np.bincount(inside.ravel(), minlength=count + 1)
        depths: list[SegmentDepth] = []
        light = prepared.inner.sum(axis=0)
        for part, cells in enumerate(Cells.of_each(volume, inside, count, step), start=1):
            depth = measured_depth(volume, cells, layers[int(np.median(layer[parts == part])) - 1])
            if depth is not None and sizes[part] * step**2 < _NARROW_PX:
                depth = with_error_of_straight(depth, light, inside == part, volume.samples)
            if depth is not None and depth.relative_error < LARGEST_ERROR:
                depths.append(replace(depth, pixels=float(sizes[part])))
                number[part] = len(depths)
        label, inner = number[parts], number[inside]
        wide = grown(label, WINDOW_PX / step)
        if plain.any():
            wide[(distance(plain) <= WINDOW_PX / step) & (label == 0)] = 0
        wide[prepared.plain] = 0
        target = fragment_targets(depths, wide)
        stays = target == np.arange(target.size)
        renumbered = (np.cumsum(stays) - 1).astype(np.int32)
        kept = tuple(depth for depth, stay in zip(depths, stays[1:].tolist(), strict=True) if stay)
        # Depth and contrast are measured without the fragments that are merged into a segment.
        inner = np.where(stays, renumbered, 0)[inner].astype(np.int32)
        merged = renumbered[target]
        return Regions(len(layers), kept, merged[label], inner, merged[wide])

    def _textured(self, segments: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
        """The segments that show texture, numbered anew from 1, their interiors, and the pixels of the others."""
        step, texture, count = self.prepared.downsampling.step, self.prepared.textured, 0
        label, inner = np.zeros((2, *segments.shape), dtype=np.int32)
        plain = np.zeros(segments.shape, dtype=bool)

        def interior_of(number: int) -> NDArray[np.bool_] | None:
            if is_textured(segments == number, texture, _OUTLINE_REACH_PX // step):
                return interior(segments, number, step)
            return None

        numbers = range(1, int(segments.max(initial=0)) + 1)
        with kept_threads() as pool:
            for number, inside in zip(numbers, pool.map(interior_of, numbers), strict=True):
                if inside is None:
                    plain |= segments == number
                    continue
                count += 1
                label[segments == number], inner[inside] = count, count
        return label, inner, plain
