"""Pieces of a continuous surface: where it has no step, it may be one plane or quadric.

Layers and planes cut a steep or bent object into many segments, each of which explains little. The surface runs through
all of them, and has a step at the object's outline alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.prepared_frame import WINDOW_PX
from metafab.decode.segmentation.robust_fits import simplest_surface

#: Most pieces, the largest first: a surface of more is not one of few objects.
_MOST_PIECES = 24


def surfaces_of_pieces(
    surface_per_m: FloatArray, lit: NDArray[np.bool_], pixels: PixelDepth, step_per_m: float, step: int
) -> list[Plane]:
    """One depth, a plane or a quadric for each piece of a surface, through the depths of its pixels.

    Pixels within half a window of a piece's edge are left out where others are enough: their windows hold both sides.

    Args:
        surface_per_m: shape (n_y, n_x), 1/depth of the surface.
        lit: shape (n_y, n_x), pixels with light.
        pixels: depth of each pixel by itself.
        step_per_m: change of 1/depth from one pixel to the next from which a piece ends.
        step: frame pixels from one downsampled pixel to the next.
    """
    piece, count = connected_components(lit & ~_beside_steps(surface_per_m, step_per_m))
    sizes = np.bincount(piece.ravel(), minlength=count + 1)[1:]
    largest = 1 + np.argsort(-sizes)[:_MOST_PIECES]
    found: list[Plane] = []
    for number in largest[sizes[largest - 1] * step**2 >= WINDOW_PX**2].tolist():
        own = piece == number
        inner = own & (distance(~own) * step > 0.5 * WINDOW_PX)
        surface = simplest_surface(pixels, inner) or simplest_surface(pixels, own)
        if surface is not None:
            found.append(surface)
    return found


def _beside_steps(surface_per_m: FloatArray, step_per_m: float) -> NDArray[np.bool_]:
    """Pixels from which 1/depth, shape (n_y, n_x), changes by more than ``step_per_m`` to the next: the same shape."""
    beside = np.zeros(surface_per_m.shape, dtype=bool)
    for values, marked in ((surface_per_m, beside), (surface_per_m.T, beside.T)):
        jumps = np.abs(np.diff(values, axis=0)) > step_per_m
        marked[1:] |= jumps
        marked[:-1] |= jumps
    return beside
