"""Plain parts of an object's segment that are the plain surface behind the object.

Where a plain wall has no depth, segments of objects before it still grow over it, up to a window from their own pixels:
there the twins agree at the depth of the outline, in its blur. The blur is not in the sharp images, which show noise
alone from the object's edge on. Such a part is connected, through pixels without texture, with the part of the wall
that has no depth. Where other pixels of that plain surface have a farther depth, the part is more likely the surface's
than the object's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label as connected_components

from metafab.core.numeric.distance import distance, nearest
from metafab.decode.confidence import LEAST_RIGHT
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.continuous.surface import gradient_coherence
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Side of the window over which the sharp images are compared, frame pixels, and coherence below which they show noise.
_COHERENCE_PX, _PLAIN = 15.0, 0.5
#: Width of an edge in the sharp images and in their gradients, downsampled pixels.
_EDGE = 2
#: Least area without a depth of a plain surface, in windows: plain parts of objects before textured walls have less.
_WINDOWS = 8.0
#: Share of a plain surface's pixels with a depth that may be farther than it, and relative difference of vergence from
#: which a part is before it: the little that a plain surface shows is up to 9 % off.
_FARTHER_SHARE, _BEFORE = 0.1, 0.1
#: Probability that a part before its plain surface is the object's, and that of the pixels at its edge, whose windows
#: hold both. In nine frames (two or three objects before plain walls of unlike light, one of faint texture, the moon,
#: four walls that are plain in one half), 0 to 74 % of the former are right, 23 % in the mean, and of the latter 10 to
#: 91 %, 53 % in the mean.
_OF_OBJECT, _ABOUT_RIGHT = 0.23, 0.53


def plain_behind_doubted(
    prepared: PreparedFrame, regions: Regions, pixels: PixelDepth, light: NDArray[np.float32]
) -> Regions:
    """Segments without depths in the plain parts of objects that are more likely the surface behind them.

    Args:
        prepared: the frame.
        regions: segments, with the probability that each pixel is in the right one.
        pixels: depth of each pixel by itself.
        light: shape (2, n_y, n_x), sharp light of the downsampled pixels.
    """
    if regions.right is None or regions.continuous or len(regions.depths) < 2:
        return regions
    step, label = prepared.downsampling.step, regions.grown
    shown = (distance(pixels.claimed & (label > 0)) * step <= WINDOW_PX) | regions.of_outline[label]
    no_depth = prepared.lit & ~((label > 0) & shown & (regions.right >= LEAST_RIGHT))
    least = _WINDOWS * WINDOW_PX**2 / step**2
    if np.count_nonzero(no_depth) < least:
        return regions
    window = round(_COHERENCE_PX / step) | 1
    surface, count = connected_components((gradient_coherence(light, window) < _PLAIN) & prepared.lit)
    without = np.bincount(surface[no_depth], minlength=count + 1)
    vergence = regions.vergence_per_m(label)
    known = (label > 0) & ~no_depth & ~regions.of_outline[label]
    behind_per_m = np.full(count + 1, np.inf)
    for number in (1 + np.flatnonzero(without[1:] >= least)).tolist():
        own = known & (surface == number)
        if own.any():
            behind_per_m[number] = np.quantile(vergence[own], _FARTHER_SHARE)
    if np.isinf(behind_per_m).all():
        return regions
    before = known & (vergence > (1.0 + _BEFORE) * behind_per_m[surface])
    # Next to the surface's edge, windows of coherence hold the object's edge, too.
    away, row, column = nearest((behind_per_m[surface] < np.inf) & (before | ~known))
    nearby_per_m = behind_per_m[surface[row, column]]
    about = known & ~before & (away <= window // 2 + _EDGE) & (vergence > (1.0 + _BEFORE) * nearby_per_m)
    right = np.where(before, np.minimum(regions.right, _OF_OBJECT), regions.right)
    return replace(regions, right=np.where(about, np.minimum(right, _ABOUT_RIGHT), right))
