"""Plain objects: the depth of their outlines, as they hold no texture.

An object is plain where light of one level fills an outline. Its depth is that of all pixels along the outline, if they
agree: the jackknife over cells of the outline gives its error, and refuses outlines of several depths. Before other
light, the change of the depth across the rim is part of the error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance
from metafab.decode.confidence import LARGEST_ERROR, differs
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import spline_peaks
from metafab.decode.segmentation.fit import TwinEnergies
from metafab.decode.segmentation.layers import grown
from metafab.decode.segmentation.planes import cell_side
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segment_depth import segment_depth, with_error_of_straight
from metafab.decode.segmentation.segments import Regions, SegmentDepth

#: Distance from a plain object's outline up to which its depth is measured, frame pixels.
_RIM_PX = 12.0
#: Ratio of the jackknife's error to that of noise up to which an outline has one depth: it has 0.7 to 2 then, and 4
#: with a third of it 30 % farther.
_ONE_OUTLINE = 3.0
#: Distance from other light up to which that is mixed in, frame pixels.
_CLEAR_PX = 24.0
#: Distance from a plain object up to which segments of its outline are grown, frame pixels, and share of a segment
#: within it from which that is such a one, if it has the object's depth.
_REACHED_PX, _REACHED_SHARE = WINDOW_PX + _RIM_PX, 0.9


def with_plain_objects(regions: Regions, prepared: PreparedFrame, volume: CostVolume) -> Regions:
    """Add the segments of plain objects, each at the depth of its outline, in place of those of the outline alone.

    An outline before segments that are not farther may be theirs, and gives none.
    """
    objects, step = prepared.plain_objects, prepared.downsampling.step
    if not objects.any():
        return regions
    own, segments, found = np.zeros(objects.shape, dtype=np.int32), regions.grown, list[SegmentDepth]()
    sizes = np.bincount(segments.ravel(), minlength=len(regions.depths) + 1)
    vergences = np.array([np.inf, *(depth.vergence_per_m for depth in regions.depths)])
    of_outline = np.zeros(sizes.shape, dtype=bool)
    for number in range(1, int(objects.max()) + 1):
        mask = objects == number
        beyond_px = distance(mask) * step
        depth, in_the_dark = outline_depth(prepared, volume, mask, beyond_px)
        if depth is None:
            continue
        reached = np.bincount(segments[beyond_px <= _REACHED_PX], minlength=sizes.size)
        same = ~differs(vergences, np.array(depth.vergence_per_m))
        rings = same & (reached > _REACHED_SHARE * sizes)
        around = segments[~mask & (beyond_px <= _CLEAR_PX)]
        around = around[(around > 0) & ~rings[around]]
        farther = ~same[around] & (vergences[around] < depth.vergence_per_m)
        if not in_the_dark and 2 * farther.sum() < farther.size:
            continue
        found.append(depth)
        own[mask] = len(found)
        of_outline |= rings
    of_outline |= np.bincount(segments[own == 0], minlength=sizes.size) == 0
    of_outline[0] = False
    renumbered = np.where(of_outline, 0, np.cumsum(~of_outline) - 1)
    depths = [depth for depth, left_out in zip(regions.depths, of_outline[1:].tolist(), strict=True) if not left_out]

    def painted(segment: NDArray[np.int32]) -> NDArray[np.int32]:
        return np.where(own > 0, len(depths) + own, renumbered[segment]).astype(np.int32)

    others = np.where(own > 0, 0, renumbered[segments]).astype(np.int32)
    lost = of_outline[segments] & (own == 0)
    wide = np.where(lost, grown(others, _REACHED_PX / step), painted(segments))
    pictures = painted(regions.label), painted(regions.interior), wide
    return replace(regions, depths=(*depths, *found), label=pictures[0], interior=pictures[1], grown=pictures[2])


def outline_depth(
    prepared: PreparedFrame, volume: CostVolume, mask: NDArray[np.bool_], beyond_px: NDArray[np.float32]
) -> tuple[SegmentDepth | None, bool]:
    """Depth of the outline of a plain object, and whether it was measured next to darkness.

    None if the outline lies along one straight line, has parts at different depths, or mixes with other light.

    Args:
        prepared: the frame.
        volume: cost volume.
        mask: shape (n_y, n_x), pixels of the object.
        beyond_px: shape (n_y, n_x), distance from them, frame pixels.
    """
    step = prepared.downsampling.step
    inner = mask & (distance(~mask) * step <= _RIM_PX)
    # Darkness has no depth of its own: next to it, both sides show the outline.
    both = inner | (~mask & (beyond_px <= _RIM_PX))
    dark = both & (distance(prepared.lit & (beyond_px > _RIM_PX)) * step > _CLEAR_PX)
    in_the_dark = bool(2 * dark.sum() > both.sum())
    rim = dark if in_the_dark else inner
    pixels, sums = float(rim.sum()), volume.label_sums(rim.astype(np.int32), 1)[0]
    depth = segment_depth(volume, sums, pixels)
    depth = with_error_of_straight(depth, prepared.inner.sum(axis=0), rim, volume.samples)
    error = jackknife_error(volume, rim, sums, step)
    if depth.error_factor > 1.0 or not error < min(LARGEST_ERROR, _ONE_OUTLINE * depth.relative_error):
        return None, in_the_dark
    if is_mixed(prepared, volume, rim, depth.vergence_per_m):
        return None, in_the_dark
    error = max(error, depth.relative_error)
    if not in_the_dark:
        error = float(np.hypot(error, change_across(volume, mask, step)))
        if not error < LARGEST_ERROR:
            return None, in_the_dark
    return replace(depth, relative_error=error, pixels=pixels, of_outline=True), in_the_dark


def change_across(volume: CostVolume, mask: NDArray[np.bool_], step: int) -> float:
    """Relative change of an outline's depth from the outer to the inner half of its rim, beyond noise.

    The blur of a textured surface behind reaches over the outline and draws its depth; farther in there is less of it.
    Cells along the outline share this error, so that the jackknife does not show it.

    Args:
        volume: cost volume.
        mask: shape (n_y, n_x), pixels of the object.
        step: frame pixels from one downsampled pixel to the next.
    """
    within = distance(~mask) * step
    halves = np.where(mask & (within <= _RIM_PX), np.where(within <= 0.5 * _RIM_PX, 1, 2), 0).astype(np.int32)
    outer, inner = (
        segment_depth(volume, sums, float(np.count_nonzero(halves == half)))
        for half, sums in enumerate(volume.label_sums(halves, 2), start=1)
    )
    change = outer.vergence_per_m / inner.vergence_per_m - 1.0
    noise = np.hypot(outer.relative_error, inner.relative_error)
    return float(np.sqrt(max(change**2 - noise**2, 0.0))) if np.isfinite(noise) else float("inf")


def is_mixed(prepared: PreparedFrame, volume: CostVolume, mask: NDArray[np.bool_], vergence_per_m: float) -> bool:
    """Whether the pixels of a mask, shape (n_y, n_x), hold light of another depth, by their mean products."""
    products = volume.at(np.array([vergence_per_m]))[:, 0][:, mask].mean(axis=1)
    x, y = volume.noise_gain * prepared.variance[:, mask].mean(axis=1)
    return bool(TwinEnergies((products / np.array([np.sqrt(x * y), x, y])).astype(np.float32)).is_foreign)


def jackknife_error(volume: CostVolume, mask: NDArray[np.bool_], sums: FloatArray, step: int) -> float:
    """Relative standard error of a segment's depth by the jackknife over its cells.

    Args:
        volume: cost volume.
        mask: shape (n_y, n_x), pixels of the segment.
        sums: shape (3, n_candidates), products summed over them.
        step: frame pixels from one downsampled pixel to the next.

    Returns:
        The error; inf for a single cell, or if the depth leaves the calibrated range without one of them.
    """
    row, column = np.nonzero(mask)
    side, cell = cell_side(step), np.zeros(mask.shape, dtype=np.int32)
    numbers, index = np.unique(row // side * mask.shape[1] + column // side, return_inverse=True)
    cell[row, column] = 1 + index
    without = sums - volume.label_sums(cell, numbers.size)
    peak = spline_peaks(correlation(without.swapaxes(0, 1)))
    if numbers.size < 2 or not peak.inside.all():
        return float("inf")
    vergence = volume.vergences_per_m[0] + volume.step_per_m * peak.place
    return float(np.sqrt((numbers.size - 1) * vergence.var()) / vergence.mean())
