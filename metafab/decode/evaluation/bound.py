"""Cramer-Rao bound of depth at each place of a frame, for a calibrated pair.

The information (:mod:`metafab.information.twin_images`) is summed over the frequencies of the *local* pair: kernels
integrated over pixels, y on the grid of x. Aberrations blur the pair off the axis: at the edge of the paper's field it
carries a sixth of the information on the axis. Divided by the number of frequencies it is the information of a pixel; a
window much larger than the blur has the sum of its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.matching.filters import BLOCK_PX
from metafab.decode.registration.calibration import Calibration
from metafab.information.texture import Texture
from metafab.information.twin_images import known_texture_information, twin_information

#: Side of the transforms over that of the kernels.
_ROOM = 2
#: Half step of vergence, relative, of the central difference.
_STEP = 1e-3


@dataclass(frozen=True)
class DepthBound:
    """Information about depth in each pixel of a decoder's window."""

    depth_m: float  #: Depth of the texture.
    #: Shape (n_y, n_x), 1/m^2 a pixel, for unknown texture and brightness ratio: a decoder's case.
    unknown_per_m2: FloatArray
    #: Shape (n_y, n_x), 1/m^2 a pixel, for known texture; the difference is the cost of an unknown texture.
    known_per_m2: FloatArray

    @classmethod
    def of(
        cls, calibration: Calibration, depth_m: float, texture: Texture, extent_px: tuple[int, int] | None = None
    ) -> DepthBound:
        """Evaluate the bound of a calibration for a texture.

        Args:
            depth_m: inside the calibrated depths.
            texture: electrons a pixel of either image, contrast and noise.
            extent_px: (n_y, n_x) of the piece over which the texture has its contrast; the window by default.
        """
        stack, vergence = calibration.stack, 1.0 / depth_m
        shape = (_ROOM * stack.shape[-2], _ROOM * stack.shape[-1])
        on_axis = texture.signal_to_noise(shape, extent_px or calibration.grid.shape)
        weights = calibration.depth_weights(vergence * np.array([1.0 - _STEP, 1.0, 1.0 + _STEP]))
        per_m = vergence / (2.0 * _STEP)  # 1 / (2 _STEP vergence) per unit of vergence, and d(1/z) = -dz / z^2
        information = np.empty((stack.shape[2], 2))
        for field in range(stack.shape[2]):
            low, at, high = np.fft.fft2(np.tensordot(weights, stack[:, :, field], axes=(1, 1)), shape)
            slope = (high - low) * per_m
            signal_to_noise = on_axis / _relative_noise(texture, float(np.abs(at[:, 0, 0]).mean()))
            information[field, 0] = twin_information(at, slope, signal_to_noise)
            information[field, 1] = known_texture_information(slope, signal_to_noise)
        shares = calibration.block_weights(calibration.grid.shape, 1, BLOCK_PX)
        by_block = np.maximum(shares @ (information / (shape[0] * shape[1])), 0.0)
        whole = by_block.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)
        n_y, n_x = calibration.grid.shape
        return cls(depth_m, whole[:n_y, :n_x, 0], whole[:n_y, :n_x, 1])

    def relative_error(self, mask: NDArray[np.bool_] | tuple[slice, slice], *, known: bool = False) -> float:
        """Smallest standard error of depth over depth, from pixels of one depth together; infinite without pixels.

        The mask has the shape (n_y, n_x), or consists of the slices of a window. ``known`` says whether the texture is
        known.
        """
        total = float((self.known_per_m2 if known else self.unknown_per_m2)[mask].sum())
        return 1.0 / (np.sqrt(total) * self.depth_m) if total > 0.0 else float("inf")


def _relative_noise(texture: Texture, light: float) -> float:
    """Variance of a pixel with a share ``light`` of the light on the axis, over the variance on the axis."""
    dark = texture.background_e + texture.read_noise_e**2
    return (light * texture.electrons + dark) / (texture.electrons + dark)
