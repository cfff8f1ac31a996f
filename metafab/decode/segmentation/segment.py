"""Segments: connected pixels of one depth, their outline, and their depth from all of their pixels at once.

All of this is done on the volume's own grid of every few pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt, gaussian_filter1d
from scipy.ndimage import label as connected

from metafab.core.conventions import FloatArray
from metafab.decode.matching.cost_volume import Volume, correlation
from metafab.decode.matching.depth import PixelDepth, spline_peaks, standard_error
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.distance import distance, nearest
from metafab.decode.segmentation.outlines import settled
from metafab.decode.segmentation.planes import Plane

#: Half a window: less cannot be told from the mixture of depths along an outline.
_FEWEST_PX = 300
_SMALLEST_SHARE = 0.01
#: Pixels this near to another depth see its blur: the first that leaves enough of a segment is taken.
_CLEAR_PX = (24, 20, 16, 12, 8, 4)
_OUTLINE_WINDOW_PX = 13
#: What speaks for a layer where its outline is: less is noise.
_NARROW_WINDOW_PX = 7
#: Outlines are straightened over windows of this side.
_SHARES_WINDOW_PX = 21
#: How much the twins' agreement counts beside those shares: half as much lets outlines eat small objects.
_AGREEMENT_WEIGHT = 2.0
#: Share of a textured region's inside that must show its texture; 5 standard deviations leave noise none.
_LEAST_TEXTURED = 0.05


@dataclass(frozen=True)
class SegmentDepth:
    """The depth of one segment.

    Attributes:
        vergence_per_m: 1/depth, of a tilted segment in its middle.
        relative_error: standard error of depth over depth; inf if the twins do not agree at any depth.
        correlation: of the twins at that depth.
        power: mean square of the aligned twins there, geometric mean of both, electrons squared.
        plane: its depth over the picture.
        pixels: how many compared pixels it has inside.
    """

    vergence_per_m: float
    relative_error: float
    correlation: float
    power: float
    plane: Plane
    pixels: float = 0.0


def depth_layers(pixels: PixelDepth, step_per_m: float) -> FloatArray:
    """Vergences at which many pixels lie: peaks of their histogram, strongest first.

    Args:
        pixels: the depth of each pixel.
        step_per_m: layers nearer to each other than 1.5 of this are one.
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


def assign(
    volume: Volume,
    layers: Sequence[Plane],
    pixels: PixelDepth,
    step_per_m: float,
    every: int,
    lit: NDArray[np.bool_],
    allowed: NDArray[np.bool_] | None = None,
) -> NDArray[np.int32]:
    """The layer (from 1) whose depth makes the twins agree best about each pixel.

    Args:
        volume: agreement of the twins.
        layers: depths of the layers over the picture.
        pixels: the depth of each pixel by itself.
        step_per_m: difference of vergence that counts.
        every: pixels of the frame a pixel of the volume.
        lit: shape (n_y, n_x), where there is light.
        allowed: shape (n_layers, n_y, n_x), where each layer may be; everywhere by default.
    """
    flat = np.array([plane.vergence_per_m for plane in layers])
    at = flat[:, None, None]
    if any(plane.tilted for plane in layers):
        at = np.stack([plane.over(volume.parts.shape[-2:]) for plane in layers])
    products = volume.at(flat if at.size == flat.size else at)
    own, place = pixels.vergence_per_m.astype(np.float32), at.astype(np.float32)
    far = np.float32(0.05) * np.minimum(np.abs(own - place) / np.float32(step_per_m), np.float32(4.0))
    wide, narrow = (
        (correlation(window_means(products, px // every | 1)) - far).astype(np.float32)
        for px in (_OUTLINE_WINDOW_PX, _NARROW_WINDOW_PX)
    )
    wide = window_means(wide, 3)
    if allowed is not None:
        wide[~allowed] = narrow[~allowed] = -np.inf
    found = settled(wide.argmax(axis=0), _AGREEMENT_WEIGHT * narrow, lit, _SHARES_WINDOW_PX // every | 1)
    label = (found + 1).astype(np.int32)
    near = pixels.claimed
    if near.any() and not near.all():
        away, row, column = nearest(near)
        label = np.where(away * every > _OUTLINE_WINDOW_PX, label[row, column], label).astype(np.int32)
    return np.asarray(label)


def split(layer: NDArray[np.int32], lit: NDArray[np.bool_], window_px: int, every: int) -> NDArray[np.int32]:
    """Connected lit pixels of one layer, numbered from 1; specks are left out (0).

    A part smaller than a window beside a larger one is the mixture of depths along an outline: left out, too.
    """
    segment = np.zeros(layer.shape, dtype=np.int32)
    number = 0
    for index in range(1, int(layer.max(initial=0)) + 1):
        mask = opened((layer == index) & lit, max(1, 2 // every))
        parts, count = connected(mask)
        sizes = np.bincount(parts.ravel(), minlength=count + 1) * every**2
        for part in range(1, count + 1):
            if sizes[part] >= _FEWEST_PX:
                number += 1
                segment[parts == part] = number
    sizes = np.bincount(segment.ravel(), minlength=number + 1) * every**2
    large = sizes >= window_px**2
    large[0] = False
    beside = distance(large[segment]) * every <= window_px if large.any() else np.zeros(layer.shape, bool)
    renumbered = np.zeros(number + 1, dtype=np.int32)
    kept = [k for k in range(1, number + 1) if large[k] or not beside[segment == k].any()]
    renumbered[kept] = np.arange(1, len(kept) + 1)
    return np.asarray(renumbered[segment])


def opened(mask: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """What is left of ``mask`` when it shrinks by so many pixels, up, down and sideways, and grows again.

    As SciPy's ``binary_opening``, in a tenth of its time.
    """
    for joined in (np.logical_and, np.logical_or):
        for _ in range(steps):
            wide = np.pad(mask, 1)
            mask = joined(mask, wide[:-2, 1:-1])
            for beside in (wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]):
                joined(mask, beside, out=mask)
    return mask


def grown(segment: NDArray[np.int32], reach: float) -> NDArray[np.int32]:
    """Pixels without a segment join the nearest one within ``reach`` pixels."""
    if not segment.any():
        return segment
    away, row, column = nearest(segment > 0)
    return np.where(away <= reach, segment[row, column], 0).astype(np.int32)


def segment_depth(volume: Volume, sums: FloatArray, pixels: float, tilt: Plane | None = None) -> SegmentDepth:
    """The vergence at which a segment's twins agree best: the peak of a spline through all candidates.

    Its error is infinite where they do not agree, or best at an end of the candidates.

    Args:
        volume: agreement of the twins.
        sums: shape (3, n), its products summed over the segment's :func:`interior`.
        pixels: how many those are.
        tilt: along which they were summed; none by default.
    """
    agreement = correlation(sums)
    nodes = volume.vergences_per_m
    if not np.isfinite(agreement).all() or agreement.max() <= 0.0:
        return _segment(tilt, float(nodes[nodes.size // 2]), np.inf, 0.0, 0.0)
    place, peak, curvature, inside = (float(one[0]) for one in spline_peaks(agreement[None]))
    vergence = float(nodes[0]) + volume.step_per_m * place
    if not inside:  # Still rising where the calibration ends: the depth is not inside it.
        return _segment(tilt, vergence, np.inf, peak, 0.0)
    samples = max(pixels * volume.samples, 1.0)
    error = float(standard_error(np.array(peak), np.array(curvature / volume.step_per_m**2), samples)) / abs(vergence)
    nearest = int(np.abs(nodes - vergence).argmin())
    power = float(np.sqrt(sums[1, nearest] * sums[2, nearest])) / max(pixels, 1.0)
    return _segment(tilt, vergence, error, peak, power)


def _segment(tilt: Plane | None, vergence: float, error: float, peak: float, power: float) -> SegmentDepth:
    plane = Plane(vergence) if tilt is None else replace(tilt, vergence_per_m=vergence)
    return SegmentDepth(vergence, error, peak, power, plane)


def interior(segment: NDArray[np.int32], number: int, every: int) -> NDArray[np.bool_]:
    """The pixels of a segment away from other segments, as far as a fifth of them remain.

    Beside another depth the pair's parts mix both; beside darkness there is nothing to mix.
    """
    mask: NDArray[np.bool_] = segment == number
    others = (segment > 0) & ~mask
    if not others.any():
        return mask
    away = distance(others)
    least = max(0.2 * _FEWEST_PX / every**2, 0.2 * float(mask.sum()))
    for px in _CLEAR_PX:
        inner = mask & (away > px / every)
        if inner.sum() >= least:
            return np.asarray(inner)
    return mask


def textured(region: NDArray[np.bool_], claimed: NDArray[np.bool_], reach: int) -> bool:
    """Whether a region shows texture away from its outline; True for one too small to have an inside.

    Args:
        region: lit pixels that belong together.
        claimed: where the brightness shows texture.
        reach: how far a window sees an outline, pixels.
    """
    inner = distance_transform_cdt(np.pad(region, 1), metric="taxicab")[1:-1, 1:-1] > reach
    return not inner.any() or float(claimed[inner].mean()) > _LEAST_TEXTURED


def textured_parts(lit: NDArray[np.bool_], claimed: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """The connected parts of what is lit that show texture away from their outlines."""
    parts, count = connected(lit)
    keep = np.zeros(count + 1, dtype=bool)
    for part in range(1, count + 1):
        keep[part] = textured(parts == part, claimed, reach)
    return np.asarray(keep[parts])
