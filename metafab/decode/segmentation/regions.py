"""Segmentation of a frame: cost volume and pixel depths -> segments with their depths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance
from metafab.core.parallel.executor import kept_threads
from metafab.core.parallel.progress import silent
from metafab.decode.confidence import differs, right_segment
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import PixelDepth, pixel_depth
from metafab.decode.matching.filters import CrossFilters
from metafab.decode.segmentation.assignment import (
    NARROW_PX,
    OUTLINE_REACH_PX,
    SegmentationNumerics,
    measured_again,
)
from metafab.decode.segmentation.fit import (
    OUTLINE_LIGHT_PX,
    Misfit,
    across_outlines,
    fitting_segments,
    foreign_light,
    misfit_at,
)
from metafab.decode.segmentation.layered.frame_model import FrameModel
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.objects.bars import with_bars
from metafab.decode.segmentation.objects.plain_objects import with_plain_objects
from metafab.decode.segmentation.objects.small_objects import SmallObject, small_objects
from metafab.decode.segmentation.planes import Cells, Plane
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segment_depth import interior, textured_components
from metafab.decode.segmentation.segments import Regions, SegmentDepth
from metafab.decode.segmentation.slopes import along_planes
from metafab.decode.segmentation.surfaces import first_segments

#: Misfit from which a pixel is left out of its segment's depth: 12 samples of noise reach it in one of 10^3 windows.
_LARGEST_MISFIT = 2.5
#: Share of such pixels that changes no depth, and share of the pixels that is kept at least.
_FEW_OUTLIERS, LEAST_KEPT = 0.01, 0.3
#: Change of a depth, in standard errors, below which its outliers stay the same.
_SETTLED = 0.25
#: Share of an interior that moved outlines leave clear, of what was clear before, below which a segment's depth is
#: measured again.
_STILL_CLEAR = 0.75
#: Light of another segment over a segment's own from which that is measured without brighter light: the step at their
#: outline is then its own light. Last: most segments of a frame that are, one cost volume each.
_BRIGHTER, _MOST_DIM = 2.0, 4


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
    reach, texture, objects = OUTLINE_REACH_PX // prepared.downsampling.step, prepared.textured, prepared.plain_objects
    if objects.any():
        texture = texture & (distance(objects > 0) > prepared.outline_reach)
    textured = textured_components(prepared.lit, texture, reach) & (objects == 0)
    return np.asarray((distance(textured) <= prepared.window // 2) & ~prepared.plain)


def find_regions(
    prepared: PreparedFrame,
    volume: CostVolume,
    pixels: PixelDepth,
    known: Sequence[Plane] = (),
    numerics: SegmentationNumerics = SegmentationNumerics(),
    optics: LayerOptics | None = None,
    filters: CrossFilters | None = None,
    volume_in_place: Callable[[], CostVolume] | None = None,
) -> Regions:
    """Segment a frame, with the probability that each pixel is in the right segment.

    With ``optics``, light that does not fit its segment, away from outlines, is that of small objects, or has no depth.

    Args:
        pixels: depth of each pixel.
        known: planes of the picture; if some are tilted, pixels are assigned to them at once.
        optics: the pair, for outlines of a refined segmentation by the model of the frame, and for small objects;
            without, outlines stay where correlation puts them.
        filters: matched filters, for the depth of segments much dimmer than others; without, it is not measured again.
        volume_in_place: returns the cost volume of continuous surfaces, by filters that keep textures in their place;
            called where surfaces are sought. Without, ``volume`` is theirs.
    """
    segments = first_segments(prepared, volume, pixels, known, numerics, volume_in_place)
    if segments.continuous:  # Each pixel has its own depth and probability.
        return segments
    regions = with_plain_objects(segments, prepared, volume)
    if not regions.depths:
        return regions
    unknown = unknown_objects(prepared, regions)
    if not numerics.refined:
        own = _misfit(prepared, volume, regions, regions.grown)
        misfit_of = partial(_misfit, prepared, volume, regions)
        right, _ = right_by_misfit(regions, own.over_noise, own, misfit_of, prepared.downsampling.step, unknown)
        return replace(regions, right=right).refused(unknown)
    refused = unknown
    if optics is not None:
        regions, about_bars = with_bars(regions, prepared, volume, optics)
        refused = unknown | about_bars
        regions = with_modelled_outlines(prepared, regions, optics, volume)
    regions, own = _with_settled_depths(prepared, volume, regions, numerics)
    if filters is not None:
        measured = without_bright_light(prepared, filters, regions)
        if measured is not regions:
            regions, own = measured, _misfit(prepared, volume, measured, measured.grown)
    misfit, unexplained = own.over_noise, np.zeros(regions.grown.shape, dtype=bool)
    if optics is not None:
        regions, own = _with_fitting_pixels(prepared, volume, regions, own, optics)
        regions, misfit, unexplained = _with_foreign_light_explained(prepared, volume, regions, own, optics)
    misfit_of = partial(_misfit, prepared, volume, regions)
    right, fits_nowhere = right_by_misfit(regions, misfit, own, misfit_of, prepared.downsampling.step, unknown)
    return replace(regions, right=right).refused(refused | (unexplained & fits_nowhere))


def _misfit(
    prepared: PreparedFrame,
    volume: CostVolume,
    regions: Regions,
    number: NDArray[np.int32],
    model_error: float | None = None,
) -> Misfit:
    """Misfit of each pixel at the depth of the segments ``number``, (n_y, n_x); errors as of :func:`misfit_at`."""
    return misfit_at(prepared, volume, regions.vergence_per_m(number), regions.interior, model_error)


def _with_settled_depths(
    prepared: PreparedFrame, volume: CostVolume, regions: Regions, numerics: SegmentationNumerics
) -> tuple[Regions, Misfit]:
    """Segments whose depths are measured without outliers, until they settle, and their misfit."""
    own, moving = _misfit(prepared, volume, regions, regions.grown), np.ones(len(regions.depths) + 1, dtype=bool)
    for _ in range(numerics.robust_rounds):
        judged = np.where(prepared.spoiled, np.float32(np.inf), own.over_noise)
        before, step = regions.depths, prepared.downsampling.step
        regions = without_outliers(regions, volume, judged, step, moving, slopes=numerics.slopes)
        moving[1:] = [not _is_settled(*both, judged.shape) for both in zip(regions.depths, before, strict=True)]
        if not moving[1:].any():
            break
        own = _misfit(prepared, volume, regions, regions.grown)
    return regions, own


def _with_fitting_pixels(
    prepared: PreparedFrame, volume: CostVolume, regions: Regions, own: Misfit, optics: LayerOptics
) -> tuple[Regions, Misfit]:
    """Segments in which pixels that fit another one nearby are that one's, and their misfit; ``own`` is that before."""

    def at_segment(number: int) -> Misfit:
        # The blur of a plain object's outline fits its depth beyond it.
        if regions.of_outline[number]:
            return own
        everywhere = np.full(regions.grown.shape, number, dtype=np.int32)
        return _misfit(prepared, volume, regions, everywhere, own.model_error)

    reach, judge = OUTLINE_REACH_PX / prepared.downsampling.step, FrameModel(prepared, regions, optics).explained_moves
    owner, fits = fitting_segments(regions.grown, prepared.spoiled, own, at_segment, reach, judge)
    return regions.with_owners(owner), fits


def _with_foreign_light_explained(
    prepared: PreparedFrame, volume: CostVolume, regions: Regions, own: Misfit, optics: LayerOptics
) -> tuple[Regions, NDArray[np.float32], NDArray[np.bool_]]:
    """Segments with the small objects whose light is in them.

    Returns:
        The segments, the misfit of each pixel, and whether it holds light of another depth that no object explains;
        ``own`` is the misfit without objects. Shape (n_y, n_x) each.
    """
    step, misfit = prepared.downsampling.step, own.over_noise
    unexplained = foreign_light(regions, own, step) & ~prepared.spoiled
    if not unexplained.any():
        return regions, misfit, unexplained
    # The blur of bars and plain objects is no object of its own.
    searched = unexplained & (distance(regions.of_outline[regions.grown]) * step > OUTLINE_LIGHT_PX)
    found = small_objects(prepared, optics, regions.vergence_per_m(regions.grown), searched, misfit)
    misfit = misfit.copy()
    for one in found:
        misfit[one.blob] = np.minimum(misfit[one.blob], one.misfit)
        unexplained[one.blob] = False
    return with_small_objects(regions, found, volume), misfit, unexplained


def unknown_objects(prepared: PreparedFrame, regions: Regions) -> NDArray[np.bool_]:
    """Pixels of plain objects whose outlines gave no depth, shape (n_y, n_x).

    Their light shows another surface. Segments nearby grow over the blur along their outlines.
    """
    return np.asarray((prepared.plain_objects > 0) & ~regions.of_outline[regions.grown])


def right_by_misfit(
    regions: Regions,
    misfit: NDArray[np.float32],
    own: Misfit,
    misfit_of: Callable[[NDArray[np.int32], float], Misfit],
    step: int,
    unknown: NDArray[np.bool_],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Probability that each pixel is in the right segment, and pixels that fit no segment across an outline either.

    Both have the shape (n_y, n_x).

    Args:
        regions: segments.
        misfit: shape (n_y, n_x), misfit of each pixel.
        own: misfit at the depth of each pixel's segment.
        misfit_of: returns the misfit at the depths of other segments, (n_y, n_x), with a calibration's error.
        step: frame pixels from one downsampled pixel to the next.
        unknown: shape (n_y, n_x), pixels of surfaces without a depth, whose outlines count as those of segments.
    """
    across, away = across_outlines(regions.grown, regions.vergence_per_m(regions.grown))
    other = misfit_of(across, own.model_error) if across.any() else own
    # Outlines of plain objects are judged as a whole.
    misfit = np.where(regions.of_outline[regions.grown], np.float32(1.0), misfit)
    misfit_across = other.over_noise
    if unknown.any():  # No depth across them could fit better or worse.
        beside = distance(unknown) - np.float32(1.0)
        misfit_across = np.where(beside < away, misfit, misfit_across)
        away = np.minimum(away, beside)
    return right_segment(misfit, misfit_across, away * step), other.is_foreign | (across == 0)


def with_modelled_outlines(
    prepared: PreparedFrame, regions: Regions, optics: LayerOptics, volume: CostVolume
) -> Regions:
    """Segments by the model of the frame: without false pieces, and with the outlines that explain it."""
    # A plain surface has no segment that could explain the light of a piece beside it.
    beside_plain = set(regions.grown[distance(prepared.plain) <= 2.0].tolist())
    most = NARROW_PX / prepared.downsampling.step**2
    pieces = ((number, one) for number, one in enumerate(regions.depths, 1) if not one.of_outline)
    narrow = [number for number, one in pieces if one.pixels < most and number not in beside_plain]
    model = FrameModel(prepared, regions, optics)
    false = model.false_pieces(narrow)
    if false:
        model = FrameModel(prepared, regions.without(false), optics)
    owner = model.owners()
    if owner is None:
        return model.regions
    return clear_of_moved_outlines(model.regions.with_owners(owner), model.regions, volume, prepared.downsampling.step)


def clear_of_moved_outlines(regions: Regions, before: Regions, volume: CostVolume, step: int) -> Regions:
    """Measure the depths of segments again whose interiors moved outlines have come near to.

    Beside an outline, the pair mixes the depths of both sides. A small object grows over that mixture at first: its
    interior holds its true outline. Outlines between depths within 5 % of each other do not count.

    Args:
        regions: segments with moved outlines, and interiors of the outlines before.
        before: the same segments with these outlines.
        volume: cost volume.
        step: frame pixels from one downsampled pixel to the next.
    """
    inside, depths = regions.interior.copy(), list(regions.depths)
    vergences = [one.vergence_per_m(one.grown) for one in (regions, before)]
    for number in range(1, len(depths) + 1):
        own, plane = regions.interior == number, depths[number - 1].plane.over(inside.shape)
        clear, was_clear = (
            own & interior(np.where(differs(plane, vergence) | (one.grown == number), one.grown, 0), number, step)
            for one, vergence in zip((regions, before), vergences, strict=True)
        )
        if clear.sum() < _STILL_CLEAR * was_clear.sum():
            inside[own & ~clear] = 0
            cells = Cells.of(volume, clear, step)
            depths[number - 1] = measured_again(volume, cells, depths[number - 1], depths[number - 1].pixels, step)
    return replace(regions, depths=along_planes(depths, inside, volume, step), interior=inside)


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
    regions: Regions,
    volume: CostVolume,
    misfits: NDArray[np.float32],
    step: int,
    which: NDArray[np.bool_],
    *,
    slopes: bool = True,
) -> Regions:
    """Measure the depths of segments again without the pixels that they do not explain; ``regions`` if there are few.

    Args:
        misfits: shape (n_y, n_x), misfit of each pixel at its segment's depth.
        step: frame pixels from one downsampled pixel to the next.
        which: shape (n_segments + 1,), segments that are measured, by number.
        slopes: whether slopes are measured along their planes.
    """
    count = len(regions.depths)
    kept = np.where(misfits < _LARGEST_MISFIT, regions.interior, 0)
    before, after = (np.bincount(label.ravel(), minlength=count + 1)[1:] for label in (regions.interior, kept))
    again = np.flatnonzero(which[1:] & (after < (1.0 - _FEW_OUTLIERS) * before) & (after > LEAST_KEPT * before))
    if not again.size:
        return regions
    number = np.zeros(count + 1, dtype=np.int32)
    number[again + 1] = np.arange(1, again.size + 1)
    depths = list(regions.depths)
    for index, cells in zip(again.tolist(), Cells.of_each(volume, number[kept], again.size, step), strict=True):
        depths[index] = measured_again(volume, cells, depths[index], depths[index].pixels, step)
    if not slopes:
        return replace(regions, depths=tuple(depths))
    measured = np.where(number[kept] > 0, kept, 0).astype(np.int32)
    return replace(regions, depths=along_planes(depths, measured, volume, step))


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
    dim = np.flatnonzero((both > 0.0) & (_BRIGHTER * both <= both.max()) & (pixels * step**2 >= NARROW_PX))
    depths = list(regions.depths)
    for index in dim[np.argsort(-pixels[dim])][:_MOST_DIM].tolist():
        bright = np.append(False, both >= _BRIGHTER * both[index])[regions.grown]
        inside = np.where(regions.interior == index + 1, np.int32(index + 1), np.int32(0))
        spectra, whole = prepared.without_light(bright, light[index], float(both.max() / both[index]))
        volume = filters.volume(spectra, prepared.levels, inside > 0, silent)
        misfit = misfit_at(prepared, volume, regions.vergence_per_m(inside), inside).over_noise
        kept = (inside > 0) & whole & (misfit < _LARGEST_MISFIT) & ~prepared.spoiled
        if kept.sum() > LEAST_KEPT * pixels[index]:
            cells = Cells.of(volume, kept, step)
            depths[index] = measured_again(volume, cells, depths[index], depths[index].pixels, step)
    return replace(regions, depths=tuple(depths)) if dim.size else regions
