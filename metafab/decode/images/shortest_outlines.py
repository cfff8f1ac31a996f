"""Outlines as short as the doubt about their pixels allows, where edges of the sharp images shorten a length.

Outlines that are found pixel by pixel are jagged: each follows its own noise. True ones are smooth, and most are edges
of the light. A segment is therefore cut from its surroundings where the sum of an outline's length, less along edges
(geodesic active contours; Caselles, Kimmel and Sapiro, Int. J. Comput. Vis. 22, 61, 1997), and of the log odds of all
pixels that leave their segment is least. That sum is convex in the share of a pixel that belongs to the segment (Chan,
Esedoglu and Nikolova, SIAM J. Appl. Math. 66, 1632, 2006) and is minimised by a primal-dual iteration (Chambolle and
Pock, J. Math. Imaging Vis. 40, 120, 2011).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import expit, logit

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.distance import box_about
from metafab.core.parallel.executor import kept_threads
from metafab.decode.confidence import LEAST_RIGHT
from metafab.decode.images.contrast_outlines import block_sums
from metafab.decode.images.deconvolution import SharpImages
from metafab.decode.matching.levels import light_steps
from metafab.decode.segmentation.fit import across_outlines, connected_moves
from metafab.decode.segmentation.segments import Regions

#: Largest correction of an outline, frame pixels.
_REACH_PX = 12
#: Log odds that a downsampled pixel of an outline's length costs without an edge, and change of the logarithm of the
#: light, root of the sum of squares of both images, over which that falls by a factor of e. With 4 or 2 natural scenes
#: are 0.07 or 0.3 % worse, 1 % as they are.
_LENGTH_COST, _EDGE = 8.0, 0.3
#: Deviation of the filter that smooths an outline, downsampled pixels: what bends within less is shortened, what bends
#: within more, as a disc, keeps its size.
_SMOOTHED = 12.0
#: Least distance from 0 and 1 of the probabilities before.
_LEAST_DOUBT = 0.05
#: Weights of 1, of the log odds before and of the logarithm of 1 and the distance from an outline (frame pixels) in the
#: log odds that a pixel is right. Fitted to nine frames of seven scenes, each with the same weight.
_RIGHT = (0.86, 0.41, 0.85)
#: Largest probability of a pixel that had a lesser one before: two of the frames have more errors than the others.
_CONFIRMED = 0.8
#: Iterations and their step.
_ITERATIONS, _STEP = 100, 0.35


def shortest_outlines(regions: Regions, sharp: SharpImages, step: int) -> Regions:
    """Segments with the shortest outlines that their pixels' probabilities allow, and probabilities by these.

    Pixels in the interior of a segment stay, and those of light that fits none.

    Args:
        regions: segments, with the probability that each pixel is in the right one.
        sharp: sharp images.
        step: frame pixels from one downsampled pixel to the next.
    """
    if len(regions.depths) < 2 or regions.right is None or regions.continuous:
        return regions
    label, vergence = regions.grown, regions.vergence_per_m(regions.grown)
    across, away = across_outlines(label, vergence)
    free = (across > 0) & (away * step <= _REACH_PX) & (regions.interior != label) & (regions.right > 0.0)
    free &= ~(regions.of_outline[label] | regions.of_outline[across])
    if not free.any():
        return regions
    odds = logit(np.clip(regions.right, _LEAST_DOUBT, 1.0 - _LEAST_DOUBT))
    weight = _length_cost(block_sums(np.ascontiguousarray(sharp.images), step, label.shape), label > 0)
    largest, owner = np.zeros(label.shape, dtype=np.float32), label.copy()

    def share(number: int) -> tuple[tuple[slice, ...], NDArray[np.float32]]:
        box = box_about(label == number, _REACH_PX // step + 1)
        own, may = label[box] == number, free[box] & ((label[box] == number) | (across[box] == number))
        cost = np.where(own, -odds[box], odds[box]) + weight[box] * _curvature(own)
        return box, _cut(own.astype(np.float32), cost.astype(np.float32), weight[box].copy(), may, _ITERATIONS)

    with kept_threads() as pool:
        for number, (box, found) in enumerate(pool.map(share, range(1, len(regions.depths) + 1)), start=1):
            owner[box][free[box] & (found > largest[box])] = number
            np.maximum(largest[box], found, out=largest[box])
    moved = connected_moves(label, np.where(owner != label, owner, 0))
    owned = regions.with_owners(np.where(moved > 0, moved, label))
    _, away = across_outlines(owned.grown, owned.vergence_per_m(owned.grown))
    constant, of_odds, of_distance = _RIGHT
    likely = expit(constant + of_odds * np.where(moved > 0, -odds, odds) + of_distance * np.log1p(away * step))
    before = np.where(moved > 0, 0.0, regions.right)
    # Doubted pixels that changed sides and stand next to an outline: as many are wrong as right.
    doubted = (moved > 0) & (regions.right < LEAST_RIGHT) & (away <= 1.0)
    most = np.where(doubted, 0.0, np.maximum(before, _CONFIRMED))
    return replace(owned, right=np.where(free, np.minimum(likely, most), regions.right))


def _length_cost(light: NDArray[np.float32], lit: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Cost of an outline's length at each pixel, by the change of the light (2, n_y, n_x) to the next: (n_y, n_x)."""
    change = np.sqrt(np.square(light_steps(light)).sum(axis=(0, 1)))
    return np.where(lit, _LENGTH_COST * np.exp(-change / _EDGE), 0.0).astype(np.float32)


def _curvature(own: NDArray[np.bool_]) -> FloatArray:
    """Curvature of a segment's smoothed outline, 1/downsampled pixels, negative where it is convex: (n_y, n_x).

    The cost of length alone would make round segments smaller: this much of it is taken back.
    """
    slope = np.gradient(gaussian_filter(own.astype(np.float32), _SMOOTHED, truncate=3.0))
    normal = slope / np.maximum(np.hypot(*slope), 1e-3)
    return np.asarray(np.gradient(normal[0], axis=0) + np.gradient(normal[1], axis=1))


@compiled
def _cut(
    share: NDArray[np.float32],
    cost: NDArray[np.float32],
    weight: NDArray[np.float32],
    free: NDArray[np.bool_],
    iterations: int,
) -> NDArray[np.float32]:
    """The share, 0 to 1, of each free pixel in a segment that minimises its cost and its weighted total variation.

    All shapes are (n_y, n_x); ``share`` is the start, and is changed.
    """
    n_y, n_x = share.shape
    step, zero, one = np.float32(_STEP), np.float32(0.0), np.float32(1.0)
    rising = free.copy()
    for i in range(n_y):
        for j in range(n_x):
            rising[i, j] |= free[min(i + 1, n_y - 1), j] or free[i, min(j + 1, n_x - 1)]
    (free_y, free_x), (rise_y, rise_x) = np.nonzero(free), np.nonzero(rising)
    dual_x, dual_y = np.zeros_like(share), np.zeros_like(share)
    ahead = share.copy()
    for _ in range(iterations):
        for k in range(rise_y.size):
            i, j = rise_y[k], rise_x[k]
            x = dual_x[i, j] + step * (ahead[i, min(j + 1, n_x - 1)] - ahead[i, j])
            y = dual_y[i, j] + step * (ahead[min(i + 1, n_y - 1), j] - ahead[i, j])
            inside = min(one, weight[i, j] / max(np.sqrt(x * x + y * y), np.float32(1e-9)))
            dual_x[i, j], dual_y[i, j] = x * inside, y * inside
        for k in range(free_y.size):
            i, j = free_y[k], free_x[k]
            inward = dual_x[i, j] + dual_y[i, j]
            if j > 0:
                inward -= dual_x[i, j - 1]
            if i > 0:
                inward -= dual_y[i - 1, j]
            new = min(max(share[i, j] + step * (inward - cost[i, j]), zero), one)
            ahead[i, j] = new + new - share[i, j]
            share[i, j] = new
    return share
