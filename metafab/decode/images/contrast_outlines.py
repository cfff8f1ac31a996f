"""Outlines between segments of unlike polarisation contrast, moved to where the contrast of the sharp images changes.

The pair mixes both sides of an outline over its own width, and so does the correlation by which segments are found. The
sharp images do not: the ratio I_x / I_y of a few pixels tells two surfaces of unlike contrast apart. Its logarithm is
taken as normally distributed, with the median and spread of each segment's interior, which hold noise and whatever
varies on the surface. The probability that a pixel lies in the segment across the outline follows by Bayes' rule from
that of the segmentation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label as connected_components
from scipy.special import expit, logit

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.distance import box_about
from metafab.core.numeric.spread import normal_sigma
from metafab.core.parallel.executor import spread
from metafab.decode.images.deconvolution import SharpImages
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.fit import across_outlines, connected_moves
from metafab.decode.segmentation.layers import dilated
from metafab.decode.segmentation.segments import Regions

#: Side of the window whose light gives a ratio, frame pixels.
_WINDOW_PX = 7
#: Largest correction of an outline, frame pixels. In natural scenes, outlines bulge by about as much.
_REACH_PX = 24
#: Distance of two segments' logarithms of contrast, in the sum of their spreads, from which they are told apart.
_SEPARATE = 2.5
#: Fewest interior pixels from which a segment's contrast is known, and least spread of its logarithm.
_FEWEST, _LEAST_SPREAD = 20, 0.02
#: Largest log odds that the contrast alone may give: deconvolution at the wrong depth has errors of its own.
_MOST_ODDS = 6.0
#: Least distance from 0 and 1 of the probabilities taken from the segmentation.
_LEAST_DOUBT = 1e-3
#: Probability that a moved pixel is right; and, for pixels that stay, the share of their prior doubt that remains
#: because they may lie in a third segment. Measured in five frames of natural scenes.
_MOVED_RIGHT, _DOUBT_LEFT = 0.86, 0.15


def moved_outlines(
    regions: Regions,
    sharp: SharpImages,
    step: int,
    lit: NDArray[np.bool_],
    where: NDArray[np.bool_] | None = None,
) -> Regions:
    """Segments with outlines where the contrast changes; ``regions`` itself where no two of them differ in it.

    Continuous surfaces stay as they are.

    Args:
        regions: segments, with the probability that each pixel is in the right one.
        sharp: sharp images.
        step: frame pixels from one downsampled pixel to the next.
        lit: shape of the sharp images, pixels that have light in them.
        where: shape (n_y, n_x), pixels that may change; all by default.
    """
    if len(regions.depths) < 2 or regions.right is None or regions.continuous:
        return regions
    label = regions.grown
    ratio = _log_ratio(sharp.images, step, label.shape)
    middle, spread = _classes(ratio, regions)
    across, away = across_outlines(label)
    apart = np.abs(middle[label] - middle[across]) > _SEPARATE * (spread[label] + spread[across])
    asked = (across > 0) & (label > 0) & (away * step <= _REACH_PX) & apart & np.isfinite(ratio)
    # Light that fits no segment has probability 0 in its own, which makes the segment across no more probable.
    asked &= regions.right > 0.0
    if where is not None:
        asked &= where
    if not asked.any():
        return regions
    # A window half in either surface: with the spread of each, the outline would move into the more even one.
    halfway = logit(0.5 * (expit(middle[label]) + expit(middle[across])))
    variance = 0.5 * (spread[label] ** 2 + spread[across] ** 2)
    odds = (middle[label] - middle[across]) * (ratio - halfway) / variance
    odds = np.where(asked, np.clip(odds, -_MOST_ODDS, _MOST_ODDS), 0.0)
    prior = np.clip(regions.right, _LEAST_DOUBT, 1.0 - _LEAST_DOUBT)
    right = 1.0 / (1.0 + (1.0 / prior - 1.0) * np.exp(-odds))
    moved = connected_moves(label, np.where(asked & (right < 0.5), across, 0))
    has_light = block_sums(np.broadcast_to(lit, (1, *lit.shape)).astype(np.float32), step, label.shape)[0] > 0.0
    moved = _with_cut_off(label, moved, has_light, (regions.interior == label) | ~asked)
    number = np.where(moved > 0, moved, label)
    kept = right * (1.0 - _DOUBT_LEFT * (1.0 - prior))
    right = np.where(moved > 0, _MOVED_RIGHT * (1.0 - np.minimum(right, 0.5)), np.where(asked, kept, regions.right))
    return replace(
        regions,
        label=np.where((moved > 0) & (regions.label > 0), moved, regions.label).astype(np.int32),
        interior=np.where(moved > 0, 0, regions.interior).astype(np.int32),
        grown=number.astype(np.int32),
        right=right,
    )


def _with_cut_off(
    label: NDArray[np.int32], moved: NDArray[np.int32], lit: NDArray[np.bool_], sure: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Moved pixels, with the slivers that they cut off: pixels on the former outline, whose windows mix both contrasts.

    Args:
        label: shape (n_y, n_x), segments before.
        moved: shape (n_y, n_x), new segment of the pixels that move; 0 elsewhere.
        lit: shape (n_y, n_x), pixels that are lit in the sharp images.
        sure: shape (n_y, n_x), pixels that are no sliver's: in the interior of their segment, or surely in it.
    """
    taken = moved.copy()
    for number in np.unique(label[moved > 0]).tolist():
        own = label == number
        box = box_about(own, 1)
        piece, count = connected_components((own & (moved == 0) & lit)[box])
        is_body = np.zeros(count + 1, dtype=bool)
        is_body[piece[sure[box]]] = True
        for other in np.unique(moved[own & (moved > 0)]).tolist():
            beside = np.zeros(count + 1, dtype=bool)
            beside[piece[dilated(moved[box] == other)]] = True
            taken[box][(piece > 0) & (beside & ~is_body)[piece]] = other
    return taken


def _log_ratio(images: NDArray[np.float32], step: int, shape: tuple[int, int]) -> FloatArray:
    """Logarithm of I_x / I_y in the window about each downsampled pixel, NaN in the dark: shape ``shape``."""
    light = window_means(block_sums(np.ascontiguousarray(images), step, shape), max(1, _WINDOW_PX // step) | 1).astype(
        np.float64
    )
    known = (light > 0.0).all(axis=0)
    return np.where(known, np.log(np.where(known, light[0], 1.0) / np.where(known, light[1], 1.0)), np.nan)


def block_sums(images: NDArray[np.float32], step: int, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Sums of images (n, n_y, n_x) over the block of ``step`` pixels about each downsampled pixel: (n, *shape)."""
    sums = np.zeros((len(images), *shape), dtype=np.float32)
    spread(_block_sums, shape[0], images, step, sums)
    return sums


@compiled
def _block_sums(first: int, stop: int, images: NDArray[np.float32], step: int, sums: NDArray[np.float32]) -> None:
    _, n_y, n_x = images.shape
    before, (count, rows, columns) = step // 2, sums.shape
    # The first and the last blocks hold the pixels beyond them.
    edges = np.minimum(np.maximum(np.arange(columns + 1) * step - before, 0), n_x)
    edges[0], edges[columns] = 0, n_x
    for image in range(count):
        for row in range(first, stop):
            end = n_y if row == rows - 1 else min((row + 1) * step - before, n_y)
            for i in range(max(row * step - before, 0), end):
                to, line = sums[image, row], images[image, i]
                for column in range(columns):
                    for j in range(edges[column], edges[column + 1]):
                        to[column] += line[j]


def _classes(ratio: FloatArray, regions: Regions) -> tuple[FloatArray, FloatArray]:
    """Median and spread of the logarithms of contrast in each segment's interior, by its number; NaN if unknown."""
    middle, spread = np.full((2, len(regions.depths) + 1), np.nan)
    for number in range(1, len(regions.depths) + 1):
        inside = ratio[(regions.interior == number) & np.isfinite(ratio)]
        if inside.size >= _FEWEST:
            middle[number] = np.median(inside)
            spread[number] = max(_LEAST_SPREAD, float(normal_sigma(inside - middle[number])))
    return middle, spread
