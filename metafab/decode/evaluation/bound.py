"""The least error of depth that a calibrated pair allows at each place of a frame (Cramer-Rao).

At each frequency the two images hold Y_j = O_j F + n_j, with n_j the noise and F the texture that both show.

*Unknown texture*, what a decoder is given: F is a nuisance. With Gaussian F of power P it is projected out by writing
the covariance of (Y_x, Y_y), whose derivative with respect to depth at fixed P gives
(:mod:`metafab.information.twin_images`)

    J = 2 |b_x b_y' - b_y b_x'|^2 / (1 + |b_x|^2 + |b_y|^2),    b_j = O_j sqrt(P) / noise_j,

less what the unknown ratio of brightness takes. Only a change of the *ratio* of the two transfer functions counts.

*Known texture*, what no decoder of scenes is given: both images' changes count whole, J = 2 (|b_x'|^2 + |b_y'|^2).
Where there is much light, a change of their relative phase counts the same as before; what is added is what changes
alike in both, and the frequencies that drown in noise. It is stated as the price of not knowing.

J is summed over the frequencies of the *local* pair: kernels as the decoder has them, integrated over pixels, y's on
x's grid. Off the axis the pair is blurred by the lens' aberrations, and knows less: at the edge of the paper's field
a sixth of what it knows on the axis, so that the axis' bound is none for a frame. Divided by the number of frequencies
it is the information of a pixel; a window much larger than the pair's blur has the sum of its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.matching.filters import BLOCK_PX
from metafab.decode.registration.calibration import Calibration
from metafab.information.twin_images import Texture, known_texture_information, twin_information

#: Transforms are of windows this many times as large as the kernels.
_ROOM = 2
#: Half the difference of vergence (relative) over which the pair's change is taken.
_STEP = 1e-3


@dataclass(frozen=True)
class DepthBound:
    """Information about depth in each pixel of a decoder's window.

    Attributes:
        depth_m: depth that it is about.
        unknown_per_m2: shape (n_y, n_x), 1/m^2 a pixel, with unknown texture and brightness ratio.
        known_per_m2: the same shape, if the texture were known.
    """

    depth_m: float
    unknown_per_m2: FloatArray
    known_per_m2: FloatArray

    @classmethod
    def of(
        cls, calibration: Calibration, depth_m: float, texture: Texture, extent_px: tuple[int, int] | None = None
    ) -> DepthBound:
        """The bound of a calibration for one kind of texture.

        Args:
            calibration: the pair.
            depth_m: inside the calibrated depths.
            texture: electrons a pixel of either image, contrast and noise.
            extent_px: (n_y, n_x) of the piece over which the texture has its contrast; the window by default.
        """
        stack, vergence = calibration.stack, 1.0 / depth_m
        shape = (_ROOM * stack.shape[-2], _ROOM * stack.shape[-1])
        on_axis = texture.signal_to_noise(shape, extent_px or calibration.grid.shape)
        weights = calibration.depth_weights(vergence * np.array([1.0 - _STEP, 1.0, 1.0 + _STEP]))
        per_m = vergence / (2.0 * _STEP)  # of vergence it is 1 / (2 _STEP vergence), and d(1/z) = -dz / z^2
        found = np.empty((stack.shape[2], 2))
        for field in range(stack.shape[2]):
            low, at, high = np.fft.fft2(np.tensordot(weights, stack[:, :, field], axes=(1, 1)), shape)
            slope = (high - low) * per_m
            signal_to_noise = on_axis / _noise(texture, float(np.abs(at[:, 0, 0]).mean()))
            found[field] = (
                twin_information(at, slope, signal_to_noise),
                known_texture_information(slope, signal_to_noise),
            )
        shares = calibration.block_weights(calibration.grid.shape, 1, BLOCK_PX)
        by_block = np.maximum(shares @ (found / (shape[0] * shape[1])), 0.0)
        whole = by_block.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)
        n_y, n_x = calibration.grid.shape
        return cls(depth_m, whole[:n_y, :n_x, 0], whole[:n_y, :n_x, 1])

    def relative_error(self, mask: NDArray[np.bool_] | tuple[slice, slice], *, known: bool = False) -> float:
        """Least standard error of depth over depth, of pixels of one depth together; inf for none.

        Args:
            mask: shape (n_y, n_x), or the slices of a window.
            known: whether the texture is known.
        """
        total = float((self.known_per_m2 if known else self.unknown_per_m2)[mask].sum())
        return 1.0 / (np.sqrt(total) * self.depth_m) if total > 0.0 else float("inf")


def _noise(texture: Texture, light: float) -> float:
    """Variance of a pixel that gets a share ``light`` of the axis' light, over that of one on the axis."""
    dark = texture.background_e + texture.read_noise_e**2
    return (light * texture.electrons + dark) / (texture.electrons + dark)
