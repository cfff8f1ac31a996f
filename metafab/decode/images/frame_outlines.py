"""Outlines between segments of unlike polarisation contrast, to a part of a downsampled pixel, by the raw frame.

Where the contrast changes, a pixel on the wrong side changes the light of one image and not of the other, whatever the
texture: the frame tells where the outline is to a part of a pixel. Where contrasts are alike, a texture that lies
behind explains the light as well, and outlines stay (measured in ``benchmarks/decode/outline_information.py``). The
misfit of the model of the frame is computed for outlines as they are and displaced by a downsampled pixel either way;
pooled along the outline, it is a parabola of the displacement, with its least value where the outline is. A normal
prior of the place within a downsampled pixel holds outlines of which the frame tells little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from metafab.core.numeric.distance import distance
from metafab.decode.images.pixel_outlines import DEVIATION
from metafab.decode.segmentation.fit import across_outlines
from metafab.decode.segmentation.layered.frame_model import FrameModel
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Distance from an outline up to which pixels take its displacement, downsampled pixels.
_REACH = 3.0
#: Least distance from the dark, frame pixels: the model's mean light of a layer is that of a window of 21 px, in which
#: light and dark would be mixed.
_LIT_PX = 21
#: Least fall of the misfit for which an outline is displaced: two standard deviations of its place.
_LEAST_GAIN = 4.0
#: Prior variance of an outline's place between downsampled pixels, squared downsampled pixels: it may lie anywhere
#: within one.
_PLACE_VARIANCE = 1.0 / 12.0


def outlines_by_frame(regions: Regions, prepared: PreparedFrame, optics: LayerOptics, step: int) -> Regions:
    """Segments whose outlines stand between downsampled pixels where their contrasts differ.

    Args:
        regions: segments.
        prepared: the frame.
        optics: the pair on the frame's downsampled pixels.
        step: frame pixels from one downsampled pixel to the next.
    """
    if step == 1 or len(regions.depths) < 2 or regions.continuous:
        return regions
    label, model = regions.grown, FrameModel(prepared, regions, optics)
    vergence = regions.vergence_per_m(label)
    across, away = across_outlines(label, vergence)
    asked = (away <= _REACH) & model.unlike[label, across] & (regions.right != 0.0)
    asked &= ~(regions.of_outline[label] | regions.of_outline[across] | prepared.spoiled)
    asked &= distance(~prepared.enclosed) * step > _LIT_PX
    if not asked.any():
        return regions
    is_near = vergence > np.where(across > 0, regions.vergence_per_m(across), 0.0)
    beyond_px = _smoothed(np.where(is_near, -1.0, 1.0) * (away + 0.5)) * np.float32(step)
    misfits = model.displaced_misfits(beyond_px, across, (-step, 0.0, step), asked)
    if misfits is None:
        return regions
    displaced_px = np.where(asked, least_misfit_px(misfits, step), np.float32(0.0))
    return replace(regions, beyond_px=np.where(is_near, displaced_px, -displaced_px).astype(np.float32))


def _smoothed(beyond: NDArray[np.float32]) -> NDArray[np.float32]:
    """Signed distances from outlines, shape (n_y, n_x), downsampled pixels, without the steps of these pixels."""
    near = np.clip(beyond, -2.0 * _REACH, 2.0 * _REACH).astype(np.float32)
    smooth = gaussian_filter(near, DEVIATION)
    # Between two outlines the distance jumps from that of one to that of the other.
    kept = (np.abs(near) <= _REACH) & (np.abs(smooth - near) <= 1.0)
    return np.where(kept, np.copysign(np.maximum(np.abs(smooth), 1e-3), near), near).astype(np.float32)


def least_misfit_px(misfits: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Displacement, frame pixels, of the least of a parabola through three misfits (3, n_y, n_x): shape (n_y, n_x).

    With the prior of the place; 0 where the sum does not fall clearly.
    """
    slope = 0.5 * (misfits[2] - misfits[0])
    bend = misfits[0] + misfits[2] - 2.0 * misfits[1] + np.float32(2.0 / _PLACE_VARIANCE)
    # Without a least value between them, it is one of the outer two.
    inner = bend > np.abs(slope)
    place = np.where(inner, -slope / np.where(inner, bend, 1.0), -np.sign(slope))
    gain = -(slope * place + 0.5 * bend * place**2)
    return np.where(gain > _LEAST_GAIN, place * step, 0.0).astype(np.float32)
