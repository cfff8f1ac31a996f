"""Segments of a frame: which pixels lie at one depth, and at which."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from metafab.core.conventions import FloatArray
from metafab.decode import segment as segments
from metafab.decode.depth import HALF_CONFIDENCE, PixelDepth, pixel_depth
from metafab.decode.seen import WINDOW_PX, Seen
from metafab.decode.volume import Volume

#: Layers of the scene are told apart from this share of the calibrated range of vergence.
_LAYER_SHARE = 1.0 / 24.0
#: How far from an outline a window, through the pair's main parts, still sees it.
_OUTLINE_REACH_PX = 40


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

    def vergences_per_m(self, otherwise: float) -> FloatArray:
        """1/depth of each segment; of a single one in place of none, ``otherwise``."""
        return np.array([depth.vergence_per_m for depth in self.depths] or [otherwise])


def textured_pixels(seen: Seen, volume: Volume) -> PixelDepth:
    """The depth of each pixel by itself, claimed where something lit shows texture."""
    pixels = pixel_depth(volume, seen.window, seen.variance)
    # The outline of a uniform object has no texture either: what lies behind it would be mixed in.
    kept = segments.textured_parts(seen.lit, seen.uneven, _OUTLINE_REACH_PX // seen.reduction.every)
    near = distance_transform_edt(~kept) <= seen.window // 2 if kept.any() else kept
    return PixelDepth(pixels.vergence_per_m, pixels.relative_error, pixels.claimed & near)


def find_regions(seen: Seen, volume: Volume, pixels: PixelDepth) -> Regions:
    """Segments from the pixels' own depths, and the depth of each from all of its pixels at once."""
    every = seen.reduction.every
    candidates = volume.vergences_per_m
    separation = float(candidates[-1] - candidates[0]) * _LAYER_SHARE
    layers = segments.depth_layers(pixels, separation)
    shape = volume.parts.shape[-2:]
    label, inner = np.zeros((2, *shape), dtype=np.int32)
    found: list[segments.SegmentDepth] = []
    unseen = np.zeros(shape, dtype=bool)
    if layers.size:
        layer = segments.assign(volume, layers, pixels, separation, every)
        parts, inside, unseen = _textured(seen, segments.split(layer, seen.lit, WINDOW_PX, every))
        count = int(parts.max(initial=0))
        sizes = np.bincount(inside.ravel(), minlength=count + 1)[1:]
        number = np.zeros(count + 1, dtype=np.int32)
        for part, (sums, size) in enumerate(zip(volume.over(inside, count), sizes.tolist(), strict=True), start=1):
            depth = segments.segment_depth(volume, sums, float(size))
            if depth.relative_error < 4.0 * HALF_CONFIDENCE and depth.correlation > 0.0:
                found.append(depth)
                number[part] = len(found)
        label, inner = number[parts], number[inside]
    near = segments.grown(label, WINDOW_PX / every)
    if unseen.any():
        away = distance_transform_edt(~unseen)
        near[(away <= WINDOW_PX / every) & (label == 0)] = 0
    return Regions(layers.size, tuple(found), label, inner, near)


def _textured(seen: Seen, parts: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
    """The parts that show texture, numbered anew from 1, their interiors, and the pixels of the others."""
    every, kept = seen.reduction.every, 0
    label, inner = np.zeros((2, *parts.shape), dtype=np.int32)
    unseen = np.zeros(parts.shape, dtype=bool)
    for number in range(1, int(parts.max(initial=0)) + 1):
        mask = parts == number
        if segments.textured(mask, seen.uneven, _OUTLINE_REACH_PX // every):
            kept += 1
            label[mask], inner[segments.interior(parts, number, every)] = kept, kept
        else:
            unseen |= mask
    return label, inner, unseen
