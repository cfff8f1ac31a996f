"""The depth of a segment, measured on its interior, and whether it shows texture.

All pictures are on the downsampled pixels of the cost volume.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import box_about, distance
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import spline_peaks, standard_error
from metafab.decode.segmentation.layers import FEWEST_PX
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import SegmentDepth

#: Distances from other segments, frame pixels, that keep their blur out: the first that leaves enough is taken.
_CLEAR_PX = (24, 20, 16, 12, 8, 4)
#: Least share of a region's interior that shows texture; at 5 standard deviations, noise shows none.
_LEAST_TEXTURED = 0.05
#: Ratio of the eigenvalues of the structure tensor below which structure lies along one straight line: outlines of
#: plain surfaces have 0.001 to 0.003, narrow segments of textured ones 0.16 to 0.7.
_STRAIGHT = 0.02


def segment_depth(volume: CostVolume, sums: FloatArray, pixels: float, tilt: Plane | None = None) -> SegmentDepth:
    """Measure a segment's depth at the peak of a spline through the correlation at all candidates.

    The error is infinite where the twins do not correlate, or best at an end of the candidates. ``sums`` are its
    products, shape (3, n_candidates), summed over its interior ``pixels`` along the plane ``tilt``, if there is one.
    """
    rho = correlation(sums)
    nodes = volume.vergences_per_m
    if not np.isfinite(rho).all() or rho.max() <= 0.0:
        return _segment(tilt, float(nodes[nodes.size // 2]), np.inf, 0.0, 0.0)
    peak = spline_peaks(rho[None])
    vergence, height = float(nodes[0]) + volume.step_per_m * float(peak.place[0]), float(peak.height[0])
    if not peak.inside[0]:  # still rising at the end of the calibrated range
        return _segment(tilt, vergence, np.inf, height, 0.0)
    samples = max(pixels * volume.samples, 1.0)
    error = standard_error(peak.height[0], peak.curvature[0] / volume.step_per_m**2, samples) / abs(vergence)
    candidate = int(np.abs(nodes - vergence).argmin())
    power = float(np.sqrt(sums[1, candidate] * sums[2, candidate])) / max(pixels, 1.0)
    return _segment(tilt, vergence, float(error), height, power)


def _segment(tilt: Plane | None, vergence: float, error: float, height: float, power: float) -> SegmentDepth:
    plane = Plane(vergence) if tilt is None else replace(tilt, vergence_per_m=vergence)
    return SegmentDepth(vergence, error, height, power, plane)


def with_error_of_straight(
    depth: SegmentDepth, light: NDArray[np.float32], mask: NDArray[np.bool_], samples: float
) -> SegmentDepth:
    """Depth with the error of a segment whose structure lies along one straight line; itself for other structure.

    Along such a line, the pixels are no independent samples: what differs between the twins at one is repeated at all
    others. Those across it count, as far as they hold the light's gradient.

    Args:
        depth: of the segment.
        light: shape (n_y, n_x), electrons.
        mask: shape (n_y, n_x), pixels that the depth is measured on.
        samples: independent samples a pixel.
    """
    place = np.stack(np.nonzero(mask), axis=1)
    if min(light.shape) < 2 or not place.size:
        return depth
    box = tuple(
        slice(max(0, low - 1), high + 2) for low, high in zip(place.min(axis=0), place.max(axis=0), strict=True)
    )
    part: NDArray[np.float64] = light[box].astype(np.float64)
    gradient = np.stack([np.gradient(part, axis=axis)[mask[box]] for axis in (0, 1)], axis=1)
    shares, directions = np.linalg.eigh(gradient.T @ gradient)
    if not shares[0] < _STRAIGHT * shares[1]:
        return depth
    across = np.rint(place @ directions[:, 1]).astype(np.intp)
    energy = np.bincount(across - across.min(), (gradient @ directions[:, 1]) ** 2)
    lines = float(energy.sum() ** 2 / (energy**2).sum())
    factor = float(np.sqrt(max(len(place) * samples / lines, 1.0)))
    return replace(depth, relative_error=depth.relative_error * factor, error_factor=factor)


def interior(segment: NDArray[np.int32], number: int, step: int) -> NDArray[np.bool_]:
    """The pixels of a segment away from other segments, shape (n_y, n_x), as far as a fifth of them remain.

    Next to another depth the pair's lobes mix both; next to darkness there is nothing to mix. ``segment`` holds the
    numbers of the segments from 1; ``step`` is the frame pixels from one downsampled pixel to the next.
    """
    mask: NDArray[np.bool_] = segment == number
    # Others farther away than the largest distance that is asked for do not matter.
    box = box_about(mask, _CLEAR_PX[0] // step + 1)
    own, inside = mask[box], np.zeros_like(mask)
    others = (segment[box] > 0) & ~own
    if not others.any():
        return mask
    away = distance(others)
    least = max(0.2 * FEWEST_PX / step**2, 0.2 * float(own.sum()))
    for px in _CLEAR_PX:
        inside[box] = own & (away > px / step)
        if inside.sum() >= least:
            return inside
    return mask


def is_textured(region: NDArray[np.bool_], texture: NDArray[np.bool_], reach: int) -> bool:
    """Whether a region, shape (n_y, n_x), of connected lit pixels shows texture away from its outline.

    True for one too small to have an interior. From ``reach`` pixels on a window contains the outline.
    """
    box = box_about(region)
    if min(region[box].shape) <= 2 * reach:
        return True
    inner = distance_transform_cdt(np.pad(region[box], 1), metric="taxicab")[1:-1, 1:-1] > reach
    return not inner.any() or float(texture[box][inner].mean()) > _LEAST_TEXTURED


def textured_components(lit: NDArray[np.bool_], texture: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """The connected components of ``lit``, shape (n_y, n_x), that :func:`is_textured`: the same shape."""
    component, count = connected_components(lit)
    keep = np.array([False, *(is_textured(component == k, texture, reach) for k in range(1, count + 1))])
    return np.asarray(keep[component])
