"""Plain parts of an object's segment that are the plain surface behind the object.

Where a plain wall has no depth, segments of objects before it still grow over it, up to a window from their own pixels:
there the twins agree at the depth of the outline, in its blur. The blur is not in the sharp images, which show noise
alone from the object's edge on. Such a part is connected, through pixels without texture, with the part of the wall
that has no depth. Where other pixels of that plain surface have a farther depth, the part is more likely the surface's
than the object's. Little light hides faint texture of an object, too: what shows texture in smoothed images keeps its
depth, but is not sure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import nearest
from metafab.decode.confidence import LEAST_RIGHT
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.continuous.surface import gradient_coherence
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Side of the window over which the sharp images are compared, frame pixels, coherence below which they show noise, and
#: side of the window that smooths them for a second look, downsampled pixels.
_COHERENCE_PX, _PLAIN, _SMOOTH = 15.0, 0.5, 3
#: Width of an edge in the sharp images and in their gradients, downsampled pixels.
_EDGE = 2
#: Least area without a depth of a plain surface, in windows: plain parts of objects before textured walls have less.
_WINDOWS = 8.0
#: Share of a plain surface's pixels with a depth that may be farther than it, and relative difference of vergence from
#: which a part is before it: the little that a plain surface shows is up to 9 % off.
_FARTHER_SHARE, _BEFORE = 0.1, 0.1
#: Probability that a part before its plain surface is the object's, and that of the pixels at its edge, whose windows
#: hold both, and of parts that show texture in smoothed images. In nine frames at 3000 electrons (two or three objects
#: before plain walls of unlike light, one of faint texture, the moon, four walls that are plain in one half), 0 to 74 %
#: of the first are right, 23 % in the mean, and of those at the edge 10 to 91 %, 53 % in the mean.
_OF_OBJECT, _ABOUT_RIGHT = 0.23, 0.53


def plain_behind_doubted(
    prepared: PreparedFrame, regions: Regions, pixels: PixelDepth, light_of: Callable[[], NDArray[np.float32]]
) -> Regions:
    """Segments without depths in the plain parts of objects that are more likely the surface behind them.

    Args:
        prepared: the frame.
        regions: segments, with the probability that each pixel is in the right one.
        pixels: depth of each pixel by itself.
        light_of: returns the sharp light of the downsampled pixels, shape (2, n_y, n_x); called where it is needed.
    """
    if regions.right is None or regions.continuous or len(regions.depths) < 2:
        return regions
    step, label = prepared.downsampling.step, regions.grown
    has_depth = regions.shown(pixels.claimed, WINDOW_PX / step) & (regions.right >= LEAST_RIGHT)
    no_depth = prepared.lit & ~has_depth
    least = _WINDOWS * WINDOW_PX**2 / step**2
    if np.count_nonzero(no_depth) < least:
        return regions
    known = (label > 0) & has_depth & ~regions.of_outline[label]
    vergence = np.where(known, regions.vergence_per_m(label), 0.0)
    window = round(_COHERENCE_PX / step) | 1
    light = light_of()
    plain = prepared.lit & (gradient_coherence(light, window) < _PLAIN)
    behind_per_m = _behind(plain, no_depth, vergence, least)
    before = vergence > (1.0 + _BEFORE) * behind_per_m
    if not before.any():
        return regions
    # Next to the surface's edge, windows of coherence hold the object's edge, too.
    away, row, column = nearest((behind_per_m < np.inf) & (before | ~known))
    about = (away <= window // 2 + _EDGE) & (vergence > (1.0 + _BEFORE) * behind_per_m[row, column])
    # Plain in smoothed images, too, and connected through such pixels: no texture hidden by noise.
    plain &= gradient_coherence(window_means(light, _SMOOTH), window) < _PLAIN
    surely = vergence > (1.0 + _BEFORE) * _behind(plain, no_depth, vergence, least)
    right = np.where(before | about, np.minimum(regions.right, _ABOUT_RIGHT), regions.right)
    return replace(regions, right=np.where(surely, np.minimum(right, _OF_OBJECT), right))


def _behind(plain: NDArray[np.bool_], no_depth: NDArray[np.bool_], vergence: FloatArray, least: float) -> FloatArray:
    """1/depth of the wide plain surface, of which other parts have no depth, that each pixel is part of.

    inf for pixels of none. Arrays have the shape (n_y, n_x).

    Args:
        plain: pixels whose sharp images show noise.
        no_depth: pixels without a depth.
        vergence: 1/depth of segments; 0 where none counts.
        least: pixels without a depth that make a surface a wide one.
    """
    surface, count = connected_components(plain)
    without = np.bincount(surface[no_depth], minlength=count + 1)
    behind_per_m = np.full(count + 1, np.inf)
    for number in (1 + np.flatnonzero(without[1:] >= least)).tolist():
        own = vergence[(surface == number) & (vergence > 0.0)]
        if own.size:
            behind_per_m[number] = np.quantile(own, _FARTHER_SHARE)
    return np.asarray(behind_per_m[surface])
