"""Plain parts of an object's segment that are the plain surface behind the object.

Where a plain wall has no depth, segments of objects before it still grow over it, up to a window from their own pixels:
there the twins agree at the depth of the outline, in its blur. The blur is not in the sharp images, which show noise
alone from the object's edge on. Such a part is connected, through pixels without texture, with a part of the wall
that has no depth. Where other pixels of that plain surface have a farther depth, the part is more likely the surface's
than the object's. Little light hides faint texture of an object, too: what shows texture in smoothed images, and what
lies at the edge of the plain surface, keeps its depth unless its light is more likely the surface's, and is not sure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label as connected_components
from scipy.special import expit, logit

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import nearest
from metafab.decode.confidence import LEAST_RIGHT
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.continuous.surface import gradient_coherence
from metafab.decode.segmentation.objects.plain_edges import light_odds
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Side of the window over which the sharp images are compared, frame pixels, coherence below which they show noise, and
#: side of the window that smooths them for a second look, downsampled pixels.
_COHERENCE_PX, _PLAIN, _SMOOTH = 15.0, 0.5, 3
#: Width of an edge in the sharp images and in their gradients, downsampled pixels.
_EDGE = 2
#: Least area of a wide plain surface, and of its part without a depth, in windows: plain parts of objects before
#: textured walls are smaller, or have a depth all over.
_WINDOWS, _WITHOUT = 8.0, 1.0
#: Share of a plain surface's pixels with a depth that may be farther than it, and relative difference of vergence from
#: which a part is before it: the little that a plain surface shows is up to 9 % off.
_FARTHER_SHARE, _BEFORE = 0.1, 0.1
#: Probability that a part before its plain surface is the object's, and that of the pixels at its edge, whose windows
#: hold both, and of parts that show texture in smoothed images. In nine frames at 3000 electrons (two or three objects
#: before plain walls of unlike light, one of faint texture, the moon, four walls that are plain in one half), 0 to 74 %
#: of the first are right, 23 % in the mean, and of those at the edge 10 to 91 %, 53 % in the mean.
_OF_OBJECT, _ABOUT_RIGHT = 0.23, 0.53
#: Probability from which a pixel away from the edge shows the light of its segment.
_INSIDE_RIGHT = 0.9


@dataclass(frozen=True)
class PlainPixels:
    """Pixels of a frame whose sharp images show no texture, masks of shape (n_y, n_x), and their light."""

    light: NDArray[np.float32]  #: Shape (2, n_y, n_x), sharp light of both images.
    lit: NDArray[np.bool_]  #: Pixels with light.
    noise: NDArray[np.bool_]  #: Lit pixels about which both sharp images show noise alone.
    smoothed: NDArray[np.bool_]  #: Those of them about which smoothed images do, too: no texture hidden by noise.

    @classmethod
    def of(cls, light: NDArray[np.float32], lit: NDArray[np.bool_], step: int) -> PlainPixels:
        """Plain pixels of sharp images.

        Args:
            light: shape (2, n_y, n_x), sharp light of the downsampled pixels.
            lit: shape (n_y, n_x), pixels with light.
            step: frame pixels from one downsampled pixel to the next.
        """
        window = _coherence_window(step)
        noise = lit & (gradient_coherence(light, window) < _PLAIN)
        return cls(light, lit, noise, noise & (gradient_coherence(window_means(light, _SMOOTH), window) < _PLAIN))

    def wide(self, step: int) -> NDArray[np.bool_]:
        """Pixels of plain surfaces so wide that nothing about them shows their depth: shape (n_y, n_x).

        Such a surface shows no texture, in smoothed images either, over :data:`_WINDOWS` windows; what shows none by
        itself and is connected with that is part of it.
        """
        surely, _ = connected_components(self.smoothed)
        is_wide = np.bincount(surely.ravel()) >= _WINDOWS * WINDOW_PX**2 / step**2
        is_wide[0] = False
        parts, count = connected_components(self.noise)
        holds_wide = np.zeros(count + 1, dtype=bool)
        holds_wide[parts[is_wide[surely]]] = True
        return np.asarray(holds_wide[parts])

    def within(self, rows: slice, columns: slice) -> PlainPixels:
        """Those in a part of the frame."""
        masks = (mask[rows, columns] for mask in (self.lit, self.noise, self.smoothed))
        return PlainPixels(self.light[:, rows, columns], *masks)

    def updated(self, part: tuple[slice, slice], other: PlainPixels, inside: tuple[slice, slice]) -> PlainPixels:
        """These pixels with those ``inside`` others in a part of the frame."""
        light, masks = self.light.copy(), [one.copy() for one in (self.lit, self.noise, self.smoothed)]
        light[:, *part] = other.light[:, *inside]
        for own, new in zip(masks, (other.lit, other.noise, other.smoothed), strict=True):
            own[part] = new[inside]
        return PlainPixels(light, *masks)


def plain_behind_doubted(
    prepared: PreparedFrame,
    regions: Regions,
    pixels: PixelDepth,
    plain_of: Callable[[], PlainPixels],
    where: NDArray[np.bool_] | None = None,
) -> tuple[Regions, PlainPixels | None]:
    """Segments without depths in the plain parts of objects that are more likely the surface behind them.

    Args:
        prepared: the frame.
        regions: segments, with the probability that each pixel is in the right one.
        pixels: depth of each pixel by itself.
        plain_of: returns the plain pixels; called where they are needed.
        where: shape (n_y, n_x), pixels that may be doubted; all by default.

    Returns:
        The segments, and the plain pixels; None if they were not needed.
    """
    step, label = prepared.downsampling.step, regions.grown
    if len(regions.depths) < 2:
        return regions, None
    right = np.ones(label.shape) if regions.right is None else regions.right
    window = WINDOW_PX**2 / step**2
    claimed = pixels.claimed & (label > 0) & (right >= LEAST_RIGHT)
    if claimed.size - np.count_nonzero(claimed) < _WITHOUT * window:
        return regions, None
    shown = label > 0 if regions.continuous else regions.shown(pixels.claimed, WINDOW_PX / step)
    has_depth = shown & (right >= LEAST_RIGHT)
    if has_depth.size - np.count_nonzero(has_depth) < _WITHOUT * window:
        return regions, None
    plain = plain_of()
    no_depth = plain.lit & ~has_depth
    known = has_depth & ~regions.of_outline[label]
    vergence = np.where(known, regions.vergence_per_m(label), 0.0)
    behind_per_m = _behind(plain.noise, no_depth, vergence, window)
    before = vergence > (1.0 + _BEFORE) * behind_per_m
    if not before.any():
        return regions, plain
    # Next to the surface's edge, windows of coherence hold the object's edge, too.
    away, row, column = nearest((behind_per_m < np.inf) & (before | ~known))
    reach = _coherence_window(step) // 2 + _EDGE
    nearer = vergence > (1.0 + _BEFORE) * behind_per_m[row, column]
    about = (away <= reach) & nearer
    surely = vergence > (1.0 + _BEFORE) * _behind(plain.smoothed, no_depth, vergence, window)
    doubted = np.where(before | about, np.minimum(right, _ABOUT_RIGHT), right)
    doubted = np.where(surely, np.minimum(doubted, _OF_OBJECT), doubted)
    # What is more likely the surface's by its light, too.
    edge, surface = (before | about) & ~surely & has_depth, plain.smoothed & (behind_per_m < np.inf)
    if edge.any() and surface.any():
        inside = known & nearer & (right >= _INSIDE_RIGHT) & ~before & ~about
        odds = logit(_ABOUT_RIGHT) + light_odds(plain.light, surface, label, inside, edge, step)
        doubted[edge] = np.minimum(doubted[edge], expit(odds))
    return replace(regions, right=doubted if where is None else np.where(where, doubted, right)), plain


def _coherence_window(step: int) -> int:
    """Side of the window over which the sharp images are compared, downsampled pixels; odd."""
    return round(_COHERENCE_PX / step) | 1


def _behind(plain: NDArray[np.bool_], no_depth: NDArray[np.bool_], vergence: FloatArray, window: float) -> FloatArray:
    """1/depth of the wide plain surface, of which other parts have no depth, that each pixel is part of.

    inf for pixels of none. Arrays have the shape (n_y, n_x).

    Args:
        plain: pixels whose sharp images show noise.
        no_depth: pixels without a depth.
        vergence: 1/depth of segments; 0 where none counts.
        window: pixels of a window.
    """
    surface, count = connected_components(plain)
    area, without = np.bincount(surface.ravel()), np.bincount(surface[no_depth], minlength=count + 1)
    behind_per_m = np.full(count + 1, np.inf)
    is_wide = (area >= _WINDOWS * window) & (without >= _WITHOUT * window)
    for number in (1 + np.flatnonzero(is_wide[1:])).tolist():
        own = vergence[(surface == number) & (vergence > 0.0)]
        if own.size:
            behind_per_m[number] = np.quantile(own, _FARTHER_SHARE)
    return np.asarray(behind_per_m[surface])
