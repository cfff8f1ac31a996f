"""Pedestal of a frame: light that forms no image (bare substrate, stray light), and a black level left in the counts.

It is measured at the frame's edge, which the field stop keeps dark. The edge is cut into blocks, and the darkest of
them that are equal within their noise are averaged. Without a dark edge no pedestal can be told from the scene.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray
from metafab.decode.registration.twins import BRIGHTEST

#: Depth and length of the blocks along the edge, pixels.
_BLOCK_PX = (4, 32)
#: Standard errors within which blocks are equally dark, and from which a pedestal is significant.
_EQUAL, _SIGNIFICANT = 3.0, 5.0
#: Quantile of the blocks at which the search for the dark ones starts.
_START = 0.2
#: Least dark share of the edge, for frames whose field stop is not known.
_DARK_SHARE = 0.5
#: Rounds in which blocks that differ from the level are left out.
_ROUNDS = 5


def pedestal_e(frame: RawFrame) -> float:
    """Mean electrons a pixel that form no image; 0 where it is not significant or the frame has no dark edge."""
    means = _edge_means(np.asarray(frame.frame))
    if means.size < 8:
        return 0.0
    pixels = float(np.prod(_BLOCK_PX))
    level = float(np.quantile(means, _START))
    dark = means
    for _ in range(_ROUNDS):
        error = np.sqrt((max(level, 0.0) + frame.read_noise_e**2) / pixels)
        dark = means[np.abs(means - level) <= _EQUAL * error]
        if not dark.size:
            return 0.0
        level = float(dark.mean())
    if not _stop_known(frame) and dark.size < _DARK_SHARE * means.size:
        return 0.0
    error = float(np.sqrt((max(level, 0.0) + frame.read_noise_e**2) / (pixels * dark.size)))
    return level if level > max(_SIGNIFICANT * error, frame.read_noise_e) else 0.0


def without_pedestal(frame: RawFrame, level_e: float) -> RawFrame:
    """The frame less its pedestal, whose photon noise is counted as read noise."""
    if level_e == 0.0:
        return frame
    return replace(
        frame,
        frame=np.asarray(frame.frame, dtype=np.float64) - level_e,
        read_noise_e=float(np.hypot(frame.read_noise_e, np.sqrt(level_e))),
        saturation_e=None if frame.saturation_e is None else frame.saturation_e - level_e,
    )


def _stop_known(frame: RawFrame) -> bool:
    """Whether the field stop is known to keep the frame's edge dark."""
    return frame.x_window is not None and min(frame.x_window[:2]) >= _BLOCK_PX[0]


def _edge_means(values: np.ndarray) -> FloatArray:
    """Means of the valid blocks along the four edges of a frame (n_y, n_x): shape (n,)."""
    deep, long = _BLOCK_PX
    means = []
    for strip in (values[:deep], values[-deep:], values[:, :deep].T, values[:, -deep:].T):
        count = strip.shape[1] // long
        if strip.shape[0] == deep and count:
            blocks = strip[:, : count * long].astype(np.float64).reshape(deep, count, long)
            means.append(np.where(np.abs(blocks) < BRIGHTEST, blocks, np.nan).mean(axis=(0, 2)))
    all_means = np.concatenate(means) if means else np.zeros(0)
    return np.asarray(all_means[np.isfinite(all_means)])
