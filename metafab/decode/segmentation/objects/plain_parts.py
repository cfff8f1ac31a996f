"""Wide plain parts of a segment, whose twins show nothing, and that may be another surface.

Segments are grown over plain parts, and so are continuous surfaces, because most plain parts belong to what is around
them. A plain object before a textured surface and a plain wall behind a textured object look the same. What tells them
apart is their size: the twins of a wide part as a whole either show the depth of its segment, or the part has none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects
from scipy.ndimage import label as connected_components

from metafab.core.numeric.distance import distance
from metafab.decode.confidence import differs
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.fit import FAINT, surface_window, texture_energy
from metafab.decode.segmentation.prepared_frame import BLUR_PX, WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Sum of the twins' product over a wide part, in standard deviations of that of pure noise, from which the part shows
#: its segment's depth: noise alone has so much in one of 40 parts.
_SHOWN = 2.0


def without_evidence(
    prepared: PreparedFrame, volume: CostVolume, regions: Regions, pixels: PixelDepth
) -> NDArray[np.bool_]:
    """Pixels of wide plain parts that do not show the depth of their segment as a whole: shape (n_y, n_x).

    A part is connected, and holds a window's pixels that are farther than a window from all pixels of their segment
    with its depth. Pixels about it are left out as far as its own were by the windows and the blur.

    Args:
        prepared: the frame.
        volume: its cost volume.
        regions: segments.
        pixels: depth of each pixel by itself.
    """
    step, label = prepared.downsampling.step, regions.grown
    least, none = WINDOW_PX**2 / step**2, np.zeros(label.shape, dtype=bool)
    plain = (texture_energy(prepared, volume) < FAINT) & (label > 0) & ~regions.of_outline[label]
    if np.count_nonzero(plain) < least:
        return none
    vergence = np.nan_to_num(regions.vergence_per_m(label), nan=float(volume.vergences_per_m[0]))
    shows = pixels.claimed & (label > 0) & ~differs(vergence, pixels.vergence_per_m)
    far = (label > 0) & (_away_in_segment(label, shows) * step > WINDOW_PX)
    parts, _ = connected_components(plain)
    sizes = np.bincount(parts[far], minlength=int(parts.max()) + 1)
    wide = 1 + np.flatnonzero(sizes[1:] >= least)
    if not wide.size:
        return none
    noise = volume.noise_gain * np.sqrt(prepared.variance[0] * prepared.variance[1])
    product, refused = volume.at(vergence[None])[0, 0] / noise, none
    for number in wide.tolist():
        # With the specks in it that show something: plain pixels alone are chosen for what they lack.
        core = far & closed(parts == number, surface_window(prepared))
        shown = product[core].sum(dtype=np.float64) * np.sqrt(volume.samples / np.count_nonzero(core))
        if shown < _SHOWN:
            refused |= parts == number
    if not refused.any():
        return none
    return np.asarray((distance(refused) <= surface_window(prepared) // 2 + BLUR_PX / step) & (label > 0))


def closed(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Morphological closing of a mask, shape (n_y, n_x), by a disc of ``reach`` pixels."""
    room = np.pad(mask, reach + 1)
    inner = distance(distance(room) > reach) > reach
    return inner[reach + 1 : -reach - 1, reach + 1 : -reach - 1]


def _away_in_segment(label: NDArray[np.int32], shows: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance of each pixel from the nearest pixel of its own segment that shows its depth: shape (n_y, n_x)."""
    away = np.full(label.shape, np.inf, dtype=np.float32)
    for number, box in enumerate(find_objects(label), start=1):
        if box is not None:
            own = label[box] == number
            np.copyto(away[box], distance(shows[box] & own), where=own)
    return away
