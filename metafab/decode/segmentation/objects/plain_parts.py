"""Wide plain parts of a segment, whose twins show nothing, and that may be another surface.

Segments are grown over plain parts, and so are continuous surfaces, because most plain parts belong to what is around
them. A plain object before a textured surface and a plain wall behind a textured object look the same. Two things tell
them apart. The twins of a wide part as a whole show the depth of its segment, or do not. And where light changes at the
rim of an enclosed part, another surface has an outline: its twins show another depth, or none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects
from scipy.ndimage import label as connected_components

from metafab.core.numeric.distance import distance
from metafab.decode.confidence import differs
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import PixelDepth, spline_peaks
from metafab.decode.segmentation.fit import FAINT, surface_window, texture_energy
from metafab.decode.segmentation.prepared_frame import BLUR_PX, WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Sum of the twins' product over a wide part, in standard deviations of that of pure noise, from which the part shows
#: its segment's depth: noise alone has so much in one of 40 parts.
_SHOWN = 2.0
#: Width of the rim about a part whose twins are summed with its own, frame pixels.
_RIM_PX = 6.0
#: Least correlation of the twins at the depth that a part with its rim shows. Of nine right parts in frames of the
#: paper's lens, six have 0.79 to 0.96 at depths within 3 %, and three 0.45 to 0.69; thirteen plain objects before a
#: wall have 0.57 to 0.72.
_LEAST_CORRELATION = 0.75
#: Largest share of the rim within a window of the picture's border, or where no segment is. A part that lies about
#: other surfaces is no part of theirs, and their outlines are its rim: three such have 0.63 to 0.69.
_MOST_OPEN = 0.5
#: Largest probability of the right depth where only the rim shows it.
_RIM_RIGHT = 0.85


def plain_parts_judged(prepared: PreparedFrame, volume: CostVolume, regions: Regions, pixels: PixelDepth) -> Regions:
    """Segments whose wide plain parts have no depth where nothing shows it, and none that is sure where the rim does.

    A part is connected, and holds a window's pixels that are farther than a window from all pixels of their segment
    with its depth. Pixels about it are left out as far as its own were by the windows and the blur.

    Args:
        prepared: the frame.
        volume: its cost volume.
        regions: segments.
        pixels: depth of each pixel by itself.
    """
    step, label = prepared.downsampling.step, regions.grown
    least = WINDOW_PX**2 / step**2
    plain = (texture_energy(prepared, volume) < FAINT) & (label > 0) & ~regions.of_outline[label]
    if np.count_nonzero(plain) < least:
        return regions
    vergence = np.nan_to_num(regions.vergence_per_m(label), nan=float(volume.vergences_per_m[0]))
    shows = pixels.claimed & (label > 0) & ~differs(vergence, pixels.vergence_per_m)
    far = (label > 0) & (_away_in_segment(label, shows) * step > WINDOW_PX)
    parts, _ = connected_components(plain)
    sizes = np.bincount(parts[far], minlength=int(parts.max()) + 1)
    wide = 1 + np.flatnonzero(sizes[1:] >= least)
    if not wide.size:
        return regions
    noise = volume.noise_gain * np.sqrt(prepared.variance[0] * prepared.variance[1])
    product = volume.at(vergence[None])[0, 0] / noise
    refused, doubted = np.zeros((2, *label.shape), dtype=bool)
    reach = surface_window(prepared) // 2 + BLUR_PX / step
    for number in wide.tolist():
        # With the specks in it that show something: plain pixels alone are chosen for what they lack.
        core = far & closed(parts == number, surface_window(prepared))
        shown = product[core].sum(dtype=np.float64) * np.sqrt(volume.samples / np.count_nonzero(core))
        if shown < _SHOWN:
            part = (distance(parts == number) <= reach) & (label > 0)
            by_rim = rim_shows(part, label > 0, volume, float(np.median(vergence[core])), step)
            (doubted if by_rim else refused)[part] = True
    if doubted.any():
        right = np.ones(label.shape) if regions.right is None else regions.right
        regions = replace(regions, right=np.where(doubted, np.minimum(right, _RIM_RIGHT), right))
    return regions.refused(refused)


def rim_shows(
    part: NDArray[np.bool_], known: NDArray[np.bool_], volume: CostVolume, vergence_per_m: float, step: int
) -> bool:
    """Whether the twins of an enclosed part, and of it with its rim, correlate best at the depth of its segment.

    Args:
        part: shape (n_y, n_x), its pixels, and those about it that the blur of its rim reaches.
        known: shape (n_y, n_x), pixels of segments.
        volume: cost volume.
        vergence_per_m: 1/depth of the part's segment there.
        step: frame pixels from one downsampled pixel to the next.
    """
    away = distance(np.pad(part, 1))
    rim = (away > 0.0) & (away <= 1.0)
    if np.count_nonzero(rim & ~np.pad(_away_from_border(known, step), 1)) > _MOST_OPEN * np.count_nonzero(rim):
        return False
    # What lies beyond the rim shows the segment's depth in any case: without it, the part must show it, too.
    away = away[1:-1, 1:-1] * step
    sums = np.stack([volume.label_sums(mask.astype(np.int32), 1)[0] for mask in (part, away <= _RIM_PX)])
    peak = spline_peaks(correlation(np.moveaxis(sums, 1, 0)))
    found = volume.vergences_per_m[0] + volume.step_per_m * peak.place
    like = not differs(np.full(found.shape, vergence_per_m), found).any()
    return bool(like and peak.height[1] >= _LEAST_CORRELATION)


def _away_from_border(known: NDArray[np.bool_], step: int) -> NDArray[np.bool_]:
    """Pixels of ``known``, shape (n_y, n_x), farther than a window from the picture's border."""
    window, away = max(1, round(WINDOW_PX / step)), np.zeros_like(known)
    away[window:-window, window:-window] = known[window:-window, window:-window]
    return away


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
