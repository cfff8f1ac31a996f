"""Layers: depths at which many pixels lie, the assignment of pixels to them, and connected pixels of one layer.

All pictures are on the downsampled pixels of the cost volume.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, gaussian_filter1d
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance, nearest
from metafab.decode.matching.cost_volume import CostVolume, correlation_less
from metafab.decode.matching.depth import PixelDepth, parabolic_peak
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.outlines import ROUNDS, refined_outlines
from metafab.decode.segmentation.planes import Plane

#: Frame pixels of the smallest segment, half a window: less looks like the mixture of depths along an outline.
FEWEST_PX = 300
#: Share of the claimed pixels that a layer holds at least.
_SMALLEST_SHARE = 0.01
#: Window over which the correlation at each layer's depth is pooled for the first assignment, frame pixels.
_ASSIGNMENT_WINDOW_PX = 13
#: Window over which it is pooled to score outlines: a narrower one would be noise.
_OUTLINE_WINDOW_PX = 7
#: Window over which the refinement of outlines takes the layers' shares.
_SHARES_WINDOW_PX = 21
#: Weight of the correlation against those shares: with half as much, outlines would eat small objects.
_CORRELATION_WEIGHT = 2.0


def depth_layers(pixels: PixelDepth, separation_per_m: float) -> FloatArray:
    """Vergences (1/m) of layers: peaks of the histogram of the pixels' depths, strongest first, shape (n_layers,).

    Peaks nearer to each other than 1.5 times ``separation_per_m`` are one layer.
    """
    claimed = pixels.claimed
    if not claimed.any():
        return np.zeros(0)
    vergence = pixels.vergence_per_m[claimed]
    weight = 1.0 / (1.0 + (pixels.relative_error[claimed] / 0.01) ** 2)
    low, high = float(vergence.min()) - 2.0 * separation_per_m, float(vergence.max()) + 2.0 * separation_per_m
    bins = max(8, int(np.ceil(4.0 * (high - low) / separation_per_m)))
    counts, edges = np.histogram(vergence, bins=bins, range=(low, high), weights=weight)
    smooth = gaussian_filter1d(counts, 2.0, mode="constant")
    middle = smooth[1:-1]
    peak = 1 + np.flatnonzero((middle >= smooth[:-2]) & (middle > smooth[2:]))
    bins_of_peak = 2.0 * np.sqrt(2.0 * np.pi)  # area of the smoothing Gaussian over its height
    peak = peak[smooth[peak] * bins_of_peak > max(_SMALLEST_SHARE * counts.sum(), 1.0)]
    peak = peak[np.argsort(-smooth[peak])]
    # Layers lie between bins, whose places follow the extreme depths: a layer half a bin off leaves fragments.
    place = peak + parabolic_peak(smooth[peak - 1], smooth[peak], smooth[peak + 1]).place
    kept: list[float] = []
    for centre in edges[0] + (place + 0.5) * (edges[1] - edges[0]):
        if all(abs(centre - other) > 1.5 * separation_per_m for other in kept):
            kept.append(float(centre))
    return np.array(kept)


def assign_layers(
    volume: CostVolume,
    layers: Sequence[Plane],
    pixels: PixelDepth,
    separation_per_m: float,
    step: int,
    lit: NDArray[np.bool_],
    allowed: NDArray[np.bool_] | None = None,
    outline_rounds: int = ROUNDS,
) -> NDArray[np.int32]:
    """Assign each pixel to the layer at whose depth the twins correlate best around it: shape (n_y, n_x), from 1.

    Args:
        layers: depths of the layers over the picture.
        pixels: depth of each pixel.
        separation_per_m: vergence by which layers differ.
        step: frame pixels from one downsampled pixel to the next.
        lit: shape (n_y, n_x), whether a pixel is lit.
        allowed: shape (n_layers, n_y, n_x), where each layer may be; everywhere by default.
        outline_rounds: most rounds of the refinement of outlines.
    """
    flat = np.array([plane.vergence_per_m for plane in layers])
    tilted = any(plane.tilted for plane in layers)
    vergence = np.stack([plane.over(volume.shape) for plane in layers]) if tilted else flat[:, None, None]
    products = volume.at(vergence if tilted else flat)
    difference = np.abs(pixels.vergence_per_m.astype(np.float32) - vergence.astype(np.float32))
    penalty = np.float32(0.05) * np.minimum(difference / np.float32(separation_per_m), np.float32(4.0))
    wide, narrow = (
        correlation_less(window_means(products, px // step | 1), penalty)
        for px in (_ASSIGNMENT_WINDOW_PX, _OUTLINE_WINDOW_PX)
    )
    wide = window_means(wide, 3)
    if allowed is not None:
        wide[~allowed] = narrow[~allowed] = -np.inf
    window = _SHARES_WINDOW_PX // step | 1
    layer = refined_outlines(wide.argmax(axis=0), _CORRELATION_WEIGHT * narrow, lit, window, outline_rounds)
    label = (layer + 1).astype(np.int32)
    if pixels.claimed.any() and not pixels.claimed.all():
        away, row, column = nearest(pixels.claimed)
        label = np.where(away * step > _ASSIGNMENT_WINDOW_PX, label[row, column], label).astype(np.int32)
    return np.asarray(label)


def connected_segments(
    layer: NDArray[np.int32], lit: NDArray[np.bool_], window_px: int, step: int
) -> NDArray[np.int32]:
    """Number the connected lit pixels of each layer from 1: shape (n_y, n_x), 0 for none.

    Specks are left out, and so is a part smaller than a window next to a larger one: it is the mixture of depths along
    an outline. ``window_px`` is the side of a window in frame pixels, ``step`` the frame pixels from one downsampled
    pixel to the next.
    """
    segment = np.zeros(layer.shape, dtype=np.int32)
    count = 0
    for index, box in enumerate(find_objects(np.where(lit, layer, 0)), start=1):
        if box is None:
            continue
        component, n_components = connected_components(opened((layer[box] == index) & lit[box], max(1, 2 // step)))
        sizes = np.bincount(component.ravel(), minlength=n_components + 1) * step**2
        large = np.append(False, sizes[1:] >= FEWEST_PX)
        numbers = np.where(large, count + np.cumsum(large), 0).astype(np.int32)
        segment[box] += numbers[component]
        count += int(large.sum())
    sizes = np.bincount(segment.ravel(), minlength=count + 1) * step**2
    large = sizes >= window_px**2
    large[0] = False
    near_large = distance(large[segment]) * step <= window_px if large.any() else np.zeros(layer.shape, bool)
    renumbered = np.zeros(count + 1, dtype=np.int32)
    beside = np.bincount(segment[near_large], minlength=count + 1) > 0
    kept = 1 + np.flatnonzero((large | ~beside)[1:])
    renumbered[kept] = np.arange(1, kept.size + 1)
    return np.asarray(renumbered[segment])


def opened(mask: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """Morphological opening of a mask, shape (n_y, n_x), by a cross, ``steps`` times; ten times faster than SciPy's."""
    for _ in range(steps):
        mask = ~dilated(~mask)
        mask[[0, -1]] = mask[:, [0, -1]] = False
    for _ in range(steps):
        mask = dilated(mask)
    return mask


def dilated(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Dilation of a mask, shape (n_y, n_x), by a cross; ten times faster than SciPy's."""
    wide = mask.copy()
    for into, of in ((wide, mask), (wide.T, mask.T)):
        into[1:] |= of[:-1]
        into[:-1] |= of[1:]
    return wide


def grown(segment: NDArray[np.int32], reach: float = np.inf) -> NDArray[np.int32]:
    """Give pixels without a segment, shape (n_y, n_x), to the nearest one within ``reach`` pixels: the same shape."""
    if not segment.any():
        return segment
    away, row, column = nearest(segment > 0)
    return np.where(away <= reach, segment[row, column], 0).astype(np.int32)
