"""Separation of the polarisations that a birefringent substrate mixes, by the calibrated shares of its ghosts.

Both images are deconvolved by their response to unpolarised light. Each then holds a weighted mean of the object's
polarisations, in the ratio of the calibrated pair to its ghosts:

    D_x = (1 - s_x) I_x + s_x I_y,   D_y = s_y I_x + (1 - s_y) I_y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.decode.registration.twins import TwinGrid
from metafab.optics.point_spread import Psf

#: Smallest |1 - s_x - s_y| that is divided by: below it, noise of the contrast grows more than fivefold.
_LEAST_DETERMINANT = 0.2


@dataclass(frozen=True)
class Unmixing:
    """Shares of the other polarisation's light in both images."""

    share: NDArray[np.float32]  #: Shape (2, n_y, n_x), s_x and s_y of each pixel for light of equal polarisations.

    WARNING: ClassVar[str] = "the substrate mixes the polarisations so evenly that their contrast is unknown"

    @classmethod
    def of(cls, psf: Psf, grid: TwinGrid) -> Unmixing | None:
        """Shares of a calibration at its middle depth over the decoded window; None for one without ghosts."""
        if psf.ghost is None:
            return None
        middle = psf.depth_m.size // 2
        sums = np.array([_field_sums(stack, middle) for stack in (psf, psf.ghost)])
        at_nodes = sums[1] / np.maximum(sums.sum(axis=0), 1e-30)
        kernels, margin = PairKernels(psf), grid.margin
        share = np.empty((2, *grid.shape), dtype=np.float32)
        for row in range(grid.shape[0]):
            place = (margin + row, slice(margin, margin + grid.shape[1]))
            weights = kernels.field_weights(grid.tangent_x[place], grid.tangent_y[place])
            share[:, row] = np.einsum("xji,pji->px", weights, at_nodes)
        return cls(np.clip(share, 0.0, 1.0))

    @cached_property
    def is_possible(self) -> bool:
        """Whether the polarisations can be told apart in all of the window."""
        return bool(self._possible.all())

    @cached_property
    def _determinant(self) -> NDArray[np.float32]:
        """Determinant of the mixture of each pixel, 1 - s_x - s_y: shape (n_y, n_x)."""
        return np.asarray(1.0 - self.share.sum(axis=0))

    @cached_property
    def _possible(self) -> NDArray[np.bool_]:
        """Pixels whose polarisations can be told apart: shape (n_y, n_x)."""
        return np.asarray(np.abs(self._determinant) >= _LEAST_DETERMINANT)

    def separate(self, images: NDArray[np.float32], noise_gain: NDArray[np.float32]) -> None:
        """Replace both images, and their noise gain, shape (2, n_y, n_x) each, by those of the object's polarisations.

        Pixels whose polarisations cannot be told apart keep their means. Images are in electrons; negative values
        become 0.
        """
        other = np.where(self._possible, self.share, np.float32(0.0))
        own = np.float32(1.0) - other[::-1]
        scale = np.float32(1.0) / np.where(self._possible, self._determinant, np.float32(1.0))
        separated = np.where(self._possible, (own * images - other * images[::-1]) * scale, images)
        noise_gain[...] = (own**2 * noise_gain + other**2 * noise_gain[::-1]) * scale**2
        np.maximum(separated, 0.0, out=images)


def _field_sums(psf: Psf, depth: int) -> FloatArray:
    """Sums of the pair over each window of the field, shape (2, n_field_y, n_field_x)."""
    images = psf.psf[:, depth, None, None] if psf.field is None else psf.field.psf[:, depth]
    return np.asarray(images.sum(axis=(-2, -1)), dtype=np.float64)
