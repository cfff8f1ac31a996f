"""Outlines moved to edges of the sharp images, where the model of the frame agrees.

Correlation and contrast leave an outline within some pixels of where it is, and most outlines are edges of the light,
too. Segments grow from beyond such a band, and meet where the light changes most (watershed; Beucher and Lantuejoul,
1979). Textures have edges of their own: pixels move only where the raw frame fits clearly better. Where it fits either
outline, their segment is in doubt.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import watershed_ift

from metafab.decode.images.contrast_outlines import block_sums
from metafab.decode.images.deconvolution import SharpImages
from metafab.decode.matching.levels import log_light
from metafab.decode.matching.pooling import window_maxima
from metafab.decode.segmentation.fit import across_outlines, connected_moves
from metafab.decode.segmentation.layered.frame_model import FrameModel
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Largest correction of an outline, frame pixels.
_REACH_PX = 12
#: Fall of the misfit, in variances of a pixel, from which it moves. Textures have edges on which the misfit of an
#: outline is that of the true one within 0.5: there, with 0, 1 % more of the pixels are wrong.
_CLEARLY = 1.0
#: Share of the pixels with lesser changes than the largest that counts.
_LARGEST_CHANGE = 0.995
#: Probability that a moved pixel is right. Where a pixel stays that would move: weights of 1, of its log odds before,
#: and of the fall of the misfit in those after. Fitted to 14 000 pixels of four natural frames and three others.
_MOVED_RIGHT, _STAYS_RIGHT = 0.8, (-0.6, 0.6, -0.55)
#: Least distance from 0 and 1 of the probabilities before.
_LEAST_DOUBT = 1e-3


def outlines_at_edges(
    regions: Regions, prepared: PreparedFrame, sharp: SharpImages, optics: LayerOptics, step: int
) -> Regions:
    """Segments with outlines at edges of the light, where these explain the frame better.

    Args:
        regions: segments, with the probability that each pixel is in the right one.
        prepared: the frame.
        sharp: its sharp images.
        optics: the pair on the frame's downsampled pixels.
        step: frame pixels from one downsampled pixel to the next.
    """
    if len(regions.depths) < 2 or regions.right is None or regions.continuous:
        return regions
    label = regions.grown
    changes = _changes(block_sums(np.ascontiguousarray(sharp.images), step, label.shape))
    moved = _watershed(regions, changes, _REACH_PX / step)
    moved = np.where(regions.of_outline[label] | regions.of_outline[moved], label, moved)
    gain = FrameModel(prepared, regions, optics).gain_of_moves(moved)
    if gain is None:
        return regions
    before = np.clip(regions.right, _LEAST_DOUBT, 1.0 - _LEAST_DOUBT)
    constant, of_odds, of_gain = _STAYS_RIGHT
    odds = constant + of_odds * np.log(before / (1.0 - before)) + of_gain * np.minimum(gain, _CLEARLY)
    doubted = (moved != label) & (regions.right > 0.0)
    stays = np.where(doubted, np.minimum(1.0 / (1.0 + np.exp(-odds)), regions.right), regions.right)
    moved = connected_moves(label, np.where((moved != label) & (gain > _CLEARLY), moved, 0))
    owned = regions.with_owners(np.where(moved > 0, moved, label))
    return replace(owned, right=np.where(moved > 0, _MOVED_RIGHT, stays))


def _watershed(regions: Regions, changes: NDArray[np.uint16], reach: float) -> NDArray[np.int32]:
    """Segments grown over the pixels within ``reach`` of outlines, meeting at the largest changes: shape (n_y, n_x)."""
    label = regions.grown
    across, away = across_outlines(label, regions.vergence_per_m(label))
    seeds = np.where((across > 0) & (away <= reach), 0, label)
    lost = np.setdiff1d(label, seeds)
    seeds = np.where(np.isin(label, lost), label, seeds)
    seeds[label == 0] = -1
    grown = watershed_ift(changes, seeds.astype(np.int16), structure=np.ones((3, 3), dtype=int))
    return np.where((label > 0) & (grown > 0), grown, label).astype(np.int32)


def _changes(light: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Range of the logarithm of the light (2, n_y, n_x) in 3 x 3 pixels, root of the sum of squares of both images.

    Shape (n_y, n_x), in units of its largest.
    """
    logarithm = log_light(light)
    change = np.sqrt(sum((window_maxima(one, 3) + window_maxima(-one, 3)) ** 2 for one in logarithm))
    largest = max(float(np.quantile(change, _LARGEST_CHANGE)), 1e-9)
    return np.asarray(np.minimum(change / largest, 1.0) * np.iinfo(np.uint16).max, dtype=np.uint16)
