"""Surfaces of a frame: the layers, planes or continuous surfaces that fit the depths of its pixels best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.assignment import Segmentation, SegmentationNumerics
from metafab.decode.segmentation.continuous.evidence import needs_surface
from metafab.decode.segmentation.continuous.pieces import surfaces_of_pieces
from metafab.decode.segmentation.fit import LEAST_MODEL_ERROR, explains_better, misfit_at
from metafab.decode.segmentation.fragments import adjacency
from metafab.decode.segmentation.layers import depth_layers
from metafab.decode.segmentation.planes import (
    CELL_PX,
    FEWEST_INLIERS,
    Cells,
    Plane,
    cell_side,
    distinct_planes,
    ransac_planes,
)
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.robust_fits import curved_surface, mean_square, plane_misfit
from metafab.decode.segmentation.segments import Regions

#: Largest separation of layers, as a share of the calibrated range of vergence.
_LAYER_SHARE = 1.0 / 24.0
#: Separation of layers in median standard errors of the pixels' depths, which scatter by 1.5 times what they state.
_SEPARATION_ERRORS = 2.0
#: Standard errors, and relative difference, within which adjacent segments have one depth.
_ONE_DEPTH_ERRORS, _ONE_DEPTH = 2.5, 1.5e-3
#: Ratio of misfits below which finer layers replace coarser ones, or planes.
_CLEARLY_BETTER = 0.93
#: Misfit of pixels' depths to planes fitted to their segments from which segments are sought on continuous surfaces:
#: scenes of flat objects and photographs on them have 1.0 to 2.4, the Middlebury motorcycle 6.
_UNFIT = 2.6
#: Misfit to one depth for each segment, and its ratio to that to planes, from which segments are stripes of a steep
#: surface. Planes that rise by 15 to 27 % across a small field have misfits of 2.3 to 8 and ratios of 1.6 to 4. Scenes
#: of flat objects have ratios of at most 1.5 or smaller misfits, but 3.4 and 1.9 before a wall at twice the distance,
#: and 4.4 and 3.4 in a staircase, which the surface does not explain better.
_STRIPES, _STRIPES_RATIO = 2.0, 1.5
#: Number of segments, and of tilted ones, above which they may be pieces of one surface: in little light each piece
#: fits. Rooms at 300 and 500 electrons have 31 and 46, scenes of flat objects at most 13; a steep card has 11 tilted.
_PIECES, _TILTED_PIECES = 16, 3
#: Share of segments' pixels within their interiors below which surfaces are sought, too: near outlines depths mix, and
#: layers that are mostly outlines explain nothing. Scenes of flat objects have 0.59 to 1, a corner of steep walls 0.31,
#: three photographs on many steps of depth 0.21 to 0.26.
_FEW_INSIDE = 0.28
#: Share of the pixels within interiors whose twins hold light of another depth, from which they are sought, too: flat
#: scenes have 0.00 to 0.08, one with a cluttered background 0.12, photographs on steps 4 to 40 px wide 0.23 and 0.27.
_FOREIGN_INSIDE = 0.15
#: Relative difference of planes from the surface that they run across.
#: Share of the pixels within segments that differ by more, from which each pixel has the surface's own depth. It is
#: 0.02 to 0.2 in five pictures with depth and a steep ground, and 0 for a film's tilted road, which is wrong in 0.2 %
#: of its pixels by planes and in 1.3 % by the surface.
_OFF_SURFACE, _FEW_OFF = 0.02, 0.005
#: Change of a surface from one pixel to the next from which it has a step, in separations of layers: segments nearer
#: than that are on one plane.
_STEP_SHARE = 0.5
#: Frame pixels from which a surface must gain more than chance, and its pieces are tried. What chance gains was
#: measured in frames of 345 600 pixels and more. In frames of a small lens with 49 500, surfaces that gained 0.00 to
#: 0.05 were right: balls of 8 and 10 % rise before a wall were 0.7 to 0.9 % off by them, 1.1 to 1.4 % by planes.
_WIDE_FRAME_PX = 200_000
#: Most downsampled pixels of a frame whose continuous surfaces are sought. A pixel takes 1.2 kilobytes.
_MOST_SURFACE_PIXELS = 400_000
#: Share of the claimed pixels that is kept at least without those about saturated or invalid ones.
_LEAST_UNSPOILED = 0.3
#: Parameters of a plane that are fitted to a segment's pixels: its depth, or its depth and slopes.
_MOVED, _TILTED = 1, 3
#: Number of layers from which they may be stripes of a tilted surface.
_MANY_LAYERS = 5
#: A segment is a stripe of a plane if its pixels' depths differ at most this many times as much from the plane.
_STRIPE_RATIO = 1.25
#: Side of the cells of small segments, frame pixels. With 24 px, planes of 94 x 47 px are found in the same eight of
#: eight frames, with errors of their slope of 5 to 15 %, with 18 px 0 to 7 %, with 14 px 2 to 16 %.
_SMALL_CELL_PX = 18


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


def unspoiled(prepared: PreparedFrame, pixels: PixelDepth) -> PixelDepth:
    """Pixel depths without those about saturated or invalid pixels, which err by more than their noise.

    All of them if few others are left.
    """
    whole = pixels.claimed & ~prepared.spoiled
    return replace(pixels, claimed=whole) if whole.sum() > _LEAST_UNSPOILED * pixels.claimed.sum() else pixels


def first_segments(
    prepared: PreparedFrame,
    volume: CostVolume,
    pixels: PixelDepth,
    known: Sequence[Plane],
    numerics: SegmentationNumerics,
    volume_in_place: Callable[[], CostVolume] | None = None,
) -> Regions:
    """Segment a frame; depths still hold the outliers of their segments.

    At first each layer has one depth. If some of its segments are tilted, or are stripes of a tilted surface, the
    layers become planes, and pixels are assigned to them once more. Where noise tells more layers apart, those replace
    them if the pixels' depths fit clearly better: a staircase lies within the cells' errors of a plane. Segments whose
    pixels lie on a quadric of vergence become one, if there are no more of them and they explain the twins better.
    Where the pixels' depths fit none of these, segments look like stripes or pieces of one surface, most pixels lie
    near outlines, or the twins in interiors hold light of other depths, pixels have the depth of a continuous surface,
    and segments are pieces of planes across it, if that explains the twins better: in a wide frame, by more than its
    freedom brings by chance, and than fewer planes and quadrics through its own pieces leave. Where these planes are
    hardly anywhere off the surface, pixels keep the planes' depths. Arguments are those of
    :func:`metafab.decode.segmentation.regions.find_regions`.
    """
    segmentation = Segmentation(prepared, volume, pixels, layer_separation_per_m(volume), numerics, volume_in_place)
    if any(plane.tilted for plane in known):
        return segmentation.of_planes(list(known))
    coarse = segmentation.layers
    if not coarse:
        none = np.zeros(volume.shape, dtype=np.int32)
        return Regions(0, (), none, none, none)
    regions = _of_layers_or_planes(segmentation, coarse)
    clean = unspoiled(prepared, pixels).claimed
    if not (numerics.refined and (clean & (regions.interior > 0)).any()):
        return regions
    planes = curved_and_planes(regions, pixels, segmentation.separation_per_m)
    if any(plane.curved for plane in planes):
        curved = segmentation.of_planes(planes)
        fewer = len(curved.depths) <= len(regions.depths)
        if fewer and explains_better(curved, regions, prepared, volume, pixels):
            regions = curved
    inside = clean & (regions.interior > 0)
    if not numerics.surfaces or inside.size > _MOST_SURFACE_PIXELS:
        return regions
    layered = _has_layers(regions, prepared, volume, inside, clean)
    if layered:
        moved, tilted = (plane_misfit(regions, pixels, inside, free) for free in (_MOVED, _TILTED))
        many = len(regions.depths) > _PIECES or sum(one.plane.tilted for one in regions.depths) > _TILTED_PIECES
        one_surface = many or moved > max(_STRIPES, _STRIPES_RATIO * tilted)
        if tilted < _UNFIT and not one_surface:
            return regions
    found = segmentation.of_surfaces(None if layered else regions)
    if found is None:
        return regions
    of_planes, surface = found
    wide = inside.size * prepared.downsampling.step**2 >= _WIDE_FRAME_PX
    if wide:
        regions = _of_pieces(segmentation, surface, regions)
    inner = of_planes.interior
    off = np.abs(of_planes.vergence_per_m(inner) / surface.vergence_per_m(inner) - 1.0) > _OFF_SURFACE
    if off.sum() > _FEW_OFF * np.count_nonzero(inner):
        judge = needs_surface if wide else explains_better
        return surface if judge(surface, regions, prepared, segmentation.surface_volume, pixels) else regions
    return of_planes if explains_better(of_planes, regions, prepared, volume, pixels) else regions


def _of_pieces(segmentation: Segmentation, surface: Regions, regions: Regions) -> Regions:
    """Segments of one plane or quadric for each piece of a surface, where fewer explain more; else ``regions``."""
    prepared, volume, pixels = segmentation.prepared, segmentation.volume, segmentation.pixels
    step_per_m = _STEP_SHARE * segmentation.separation_per_m
    surface_per_m = surface.vergence_per_m(surface.grown)
    planes = surfaces_of_pieces(surface_per_m, prepared.lit, pixels, step_per_m, prepared.downsampling.step)
    if not any(plane.tilted for plane in planes):
        return regions
    found = segmentation.of_planes(planes)
    fewer = len(found.depths) < len(regions.depths)
    return found if fewer and explains_better(found, regions, prepared, volume, pixels) else regions


def _has_layers(
    regions: Regions,
    prepared: PreparedFrame,
    volume: CostVolume,
    inside: NDArray[np.bool_],
    clean: NDArray[np.bool_],
) -> bool:
    """Whether enough of the segments' pixels lie in interiors, and few of these hold light of another depth.

    Args:
        regions: segments.
        prepared: the frame.
        volume: its cost volume.
        inside: shape (n_y, n_x), pixels within interiors that count.
        clean: shape (n_y, n_x), all pixels that count.
    """
    if np.count_nonzero(inside) < _FEW_INSIDE * np.count_nonzero(clean & (regions.grown > 0)) or not inside.any():
        return False
    vergence = regions.vergence_per_m(regions.grown)
    misfit = misfit_at(prepared, volume, vergence, regions.interior, LEAST_MODEL_ERROR)
    return float(misfit.is_foreign[inside].mean()) <= _FOREIGN_INSIDE


def _of_layers_or_planes(segmentation: Segmentation, coarse: list[Plane]) -> Regions:
    """Segments of layers, of planes across them, or of the layers that noise tells apart; small planes across these."""
    prepared, volume, pixels = segmentation.prepared, segmentation.volume, segmentation.pixels
    regions = segmentation.of_layers(coarse)
    if len(coarse) >= _MANY_LAYERS or any(depth.plane.tilted for depth in regions.depths):
        step = prepared.downsampling.step
        cells = Cells.of(volume, pixels.claimed & prepared.lit, step)
        planes = planes_across(cells, cell_side(step), segmentation.separation_per_m, pixels, regions)
        if any(plane.tilted for plane in planes):
            regions = segmentation.of_planes(planes)
    if not segmentation.numerics.refined:
        return regions
    clean = unspoiled(prepared, pixels)
    finer = replace(segmentation, separation_per_m=noise_separation_per_m(volume, clean))
    layers = [Plane(vergence) for vergence in depth_layers(clean, finer.separation_per_m).tolist()]
    if len(layers) <= len(coarse):
        return with_small_planes(segmentation, regions)
    of_noise = finer.of_layers(layers)
    needed = distinct_layers(of_noise, layers)
    if len(needed) < len(layers):
        of_noise = finer.of_layers(needed)
    # Next to outlines depths mix: more layers always fit better there, and flat treads worse than a ramp across them.
    inside = clean.claimed & (regions.interior > 0)
    if any(depth.plane.tilted for depth in regions.depths):
        inside &= of_noise.interior > 0
    # Outliers leave a segment's depth only later: finer layers may move, but a slope must not pass for their steps.
    moved, tilted = plane_misfit(of_noise, pixels, inside, _MOVED), plane_misfit(regions, pixels, inside, _TILTED)
    if moved < _CLEARLY_BETTER * tilted:
        return with_small_planes(finer, of_noise)
    return with_small_planes(segmentation, regions)


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


def planes_across(
    cells: Cells, side: int, separation_per_m: float, pixels: PixelDepth, regions: Regions
) -> list[Plane]:
    """Planes that span several layers, and the distinct planes of segments that are no stripes of those.

    Args:
        cells: among which planes are sought.
        side: of a cell, downsampled pixels.
        separation_per_m: vergence by which layers differ.
        pixels: depth of each pixel.
        regions: segments of one depth.
    """
    spanning = ransac_planes(cells, side, separation_per_m)
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
    return spanning + distinct_planes(planes, renumbered[regions.label], separation_per_m)


def with_small_planes(segmentation: Segmentation, regions: Regions) -> Regions:
    """Segments with tilted planes across small flat ones, where these fit better; the segments themselves elsewhere.

    Small are segments of fewer pixels than the cells of which :func:`planes_across` makes a plane. Fewer segments are
    better if they fit the depths of the cells better. As many must fit the depths of the pixels better: a plane across
    one of two flat objects that touch does not.
    """
    prepared, volume, pixels = segmentation.prepared, segmentation.volume, segmentation.pixels
    step = prepared.downsampling.step
    sizes = np.bincount(regions.grown.ravel(), minlength=len(regions.depths) + 1)
    flat = np.array([False, *(not depth.plane.tilted for depth in regions.depths)])
    small = flat & (sizes * step**2 < FEWEST_INLIERS * CELL_PX**2)
    mask = pixels.claimed & prepared.lit & small[regions.grown]
    if np.count_nonzero(mask) * step**2 < FEWEST_INLIERS * _SMALL_CELL_PX**2:
        return regions
    cells, side = Cells.of(volume, mask, step, _SMALL_CELL_PX), cell_side(step, _SMALL_CELL_PX)
    planes = planes_across(cells, side, segmentation.separation_per_m, pixels, regions)
    if sum(plane.tilted for plane in planes) <= np.count_nonzero(~flat[1:]):
        return regions
    found = segmentation.of_planes(planes)
    both = (found.grown > 0) & (regions.grown > 0)
    if len(found.depths) < len(regions.depths):
        at: tuple[NDArray[np.intp], ...] = (np.rint(cells.row).astype(np.intp), np.rint(cells.column).astype(np.intp))
        measured, error, counts = cells.vergence_per_m, cells.error_per_m, np.isfinite(cells.error_per_m) & both[at]
    elif len(found.depths) == len(regions.depths):
        at = np.nonzero(pixels.claimed & both & ((found.interior > 0) | (regions.interior > 0)))
        measured, counts = pixels.vergence_per_m[at], np.ones(at[0].size, dtype=bool)
        error = pixels.relative_error[at] * measured
    else:
        return regions
    depths = [of.vergence_per_m(of.grown)[at] for of in (found, regions)]
    judged = counts & (np.abs(depths[0] - depths[1]) > error)
    if not judged.any():
        return regions
    new, old = (mean_square((measured - one)[judged] / error[judged]) for one in depths)
    return found if new < old else regions
