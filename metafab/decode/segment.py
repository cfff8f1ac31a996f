"""Segments: connected pixels of one depth, their outline, and their depth from all of their pixels at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, binary_opening, distance_transform_edt, gaussian_filter1d, uniform_filter
from scipy.ndimage import label as connected

from metafab.core.conventions import FloatArray
from metafab.decode.align import Aligner, doubled
from metafab.decode.depth import PixelDepth, parabola, standard_error

#: Half a window: less cannot be told from the mixture of depths along an outline.
_FEWEST_PIXELS = 300
_SMALLEST_SHARE = 0.01
#: Pixels next to an outline see the blur of what lies beyond it.
_EDGE_PX = 8
_OUTLINE_WINDOW_PX = 13


@dataclass(frozen=True)
class SegmentDepth:
    """The depth of one segment.

    Attributes:
        vergence_per_m: 1/depth.
        relative_error: standard error of depth over depth; inf if the twins do not agree at any depth.
        correlation: of the twins at that depth.
    """

    vergence_per_m: float
    relative_error: float
    correlation: float


def depth_layers(pixels: PixelDepth, step_per_m: float) -> FloatArray:
    """Vergences at which many pixels lie: peaks of their histogram, strongest first.

    Args:
        pixels: the depth of each pixel.
        step_per_m: spacing of the candidates; layers nearer to each other than this are one.
    """
    claimed = pixels.claimed
    if not claimed.any():
        return np.zeros(0)
    vergence = pixels.vergence_per_m[claimed]
    weight = 1.0 / (1.0 + (pixels.relative_error[claimed] / 0.01) ** 2)
    low, high = float(vergence.min()) - 2.0 * step_per_m, float(vergence.max()) + 2.0 * step_per_m
    bins = max(8, int(np.ceil(4.0 * (high - low) / step_per_m)))
    counts, edges = np.histogram(vergence, bins=bins, range=(low, high), weights=weight)
    smooth = gaussian_filter1d(counts, 2.0, mode="constant")
    middle = smooth[1:-1]
    peak = 1 + np.flatnonzero((middle >= smooth[:-2]) & (middle > smooth[2:]))
    width = 2.0 * np.sqrt(2.0 * np.pi)  # bins under the smoothing
    peak = peak[smooth[peak] * width > max(_SMALLEST_SHARE * counts.sum(), 1.0)]
    peak = peak[np.argsort(-smooth[peak])]
    centres = 0.5 * (edges[:-1] + edges[1:])[peak]
    kept: list[float] = []
    for centre in centres:
        if all(abs(centre - other) > 1.5 * step_per_m for other in kept):
            kept.append(float(centre))
    return np.array(kept)


def assign(aligner: Aligner, layers_per_m: FloatArray, pixels: PixelDepth, step_per_m: float) -> NDArray[np.int32]:
    """Which layer each pixel belongs to: shape (n_y, n_x), from 1.

    In a small window the twins decide between the few layers only; far from any texture, the nearest texture does.
    """
    scores = []
    for vergence in layers_per_m:
        agreement = aligner.windows(float(vergence), _OUTLINE_WINDOW_PX)
        # Agreement of two twins of equal power: 1 - |a - b|^2 / (|a|^2 + |b|^2) after matching their contrast.
        score = doubled(agreement.correlation, pixels.claimed.shape)
        score = score - 0.05 * np.minimum(np.abs(pixels.vergence_per_m - vergence) / step_per_m, 4.0)
        scores.append(uniform_filter(score, 5, mode="nearest"))
    label = (np.argmax(scores, axis=0) + 1).astype(np.int32)
    near = pixels.claimed
    if near.any() and not near.all():
        away, (row, column) = distance_transform_edt(~near, return_indices=True)
        label = np.where(away > _OUTLINE_WINDOW_PX, label[row, column], label).astype(np.int32)
    return np.asarray(label)


def split(layer: NDArray[np.int32], lit: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Connected lit pixels of one layer, numbered from 1; specks are left out (0)."""
    segment = np.zeros(layer.shape, dtype=np.int32)
    number = 0
    for index in range(1, int(layer.max(initial=0)) + 1):
        mask = binary_opening((layer == index) & lit, iterations=2)
        parts, count = connected(mask)
        sizes = np.bincount(parts.ravel(), minlength=count + 1)
        for part in range(1, count + 1):
            if sizes[part] >= _FEWEST_PIXELS:
                number += 1
                segment[parts == part] = number
    return segment


def grown(segment: NDArray[np.int32], lit: NDArray[np.bool_], reach_px: float) -> NDArray[np.int32]:
    """Lit pixels without a segment join the nearest one within ``reach_px``."""
    if not segment.any():
        return segment
    away, (row, column) = distance_transform_edt(segment == 0, return_indices=True)
    return np.where(lit & (away <= reach_px), segment[row, column], 0).astype(np.int32)


def segment_depth(
    aligner: Aligner, mask: NDArray[np.bool_], start_per_m: float, step_per_m: float, limits_per_m: tuple[float, float]
) -> SegmentDepth:
    """The vergence at which a segment's twins agree best, by parabolas of shrinking width from ``start_per_m``."""
    inner = interior(mask)
    samples = max(float(inner.sum()) * aligner.bandwidth, 1.0)
    low, high = limits_per_m
    vergence, step = float(np.clip(start_per_m, low, high)), step_per_m
    peak, curvature, error = 0.0, 0.0, np.inf
    for _ in range(3):
        middle = float(np.clip(vergence, low + step, high - step)) if high - low > 2.0 * step else 0.5 * (low + high)
        below, at, above = (aligner.segment(middle + d * step, inner).correlation for d in (-1, 0, 1))
        if not np.isfinite(below + at + above) or max(below, at, above) <= 0.0:
            return SegmentDepth(vergence, np.inf, 0.0)
        if at >= max(below, above):
            shift, peak, curvature = (float(value) for value in parabola(below, at, above))
            vergence = middle + step * shift
            error = float(standard_error(np.array(peak), np.array(curvature / step**2), samples)) / abs(vergence)
            step *= 0.4
        else:
            vergence = float(np.clip(middle + (step if above > below else -step), low, high))
    return SegmentDepth(vergence, error, peak)


def interior(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The pixels away from the outline, as far as a fifth of them remain."""
    for away in range(_EDGE_PX, 0, -2):
        inner = binary_erosion(mask, iterations=away)
        if inner.sum() >= max(0.2 * _FEWEST_PIXELS, 0.2 * mask.sum()):
            return np.asarray(inner)
    return mask
