"""Transform block sums to the field on one window of the sensor, by a few matrix Fourier transforms.

Blocks are gathered on the Chebyshev points of the lens. Each low-rank term of the kernel weights them on the lens,
transforms them to the window by two matrices, and weights the result on the window; the terms add up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric import chebyshev
from metafab.optics.geometry.path import Ray
from metafab.optics.geometry.polarisation import Weight
from metafab.optics.propagation.kernel import SingleComplexArray, WindowKernel
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.propagation.refocus import refocus, weighted


@dataclass(frozen=True)
class WindowTransform:
    """Linear map from refocused blocks to the field on the window."""

    kernel: WindowKernel  #: Propagation from Chebyshev points to the window.
    gather_y: NDArray[np.float32]  #: Shape (q_y, n_y), transposed interpolation: blocks to weights on Chebyshev points.
    gather_x: NDArray[np.float32]  #: Shape (n_x, q_x).
    #: Shape (3, n, n), response of each window point to the sum and the moments of a block: the diffraction of the
    #: block, and i times its phase slope along x and y. Shape (1, n, n) for blocks of one site.
    by_order: SingleComplexArray

    @classmethod
    def build(cls, pupil: Pupil, kernel: WindowKernel) -> WindowTransform:
        """Return the transform from the blocks of ``pupil`` to the window of ``kernel``."""
        q_y, q_x = kernel.over_lens.shape[1:]
        spec, block = kernel.spec, pupil.carrier.block_sites
        (x, y, z), offsets_um, n = spec.target_um, spec.offsets_um, spec.window_px
        distance = math.hypot(x, y, z)
        slope_x, slope_y = (-spec.wavenumber * (1.0 - (c / distance) ** 2) / distance * offsets_um for c in (x, y))
        diffraction = np.outer(
            _dirichlet(slope_y * pupil.pitch_um[1], block), _dirichlet(slope_x * pupil.pitch_um[0], block)
        )
        orders = [diffraction, 1j * np.tile(slope_x, (n, 1)), 1j * np.tile(slope_y, (n, 1)).T]
        return cls(
            kernel,
            chebyshev.interpolation(spec.lens_um[1], q_y, pupil.y_um).T.astype(np.float32, order="C"),
            chebyshev.interpolation(spec.lens_um[0], q_x, pupil.x_um).astype(np.float32, order="C"),
            np.array(orders[: 1 if block == 1 else 3], dtype=np.complex64),
        )

    def field(self, blocks: SingleComplexArray) -> SingleComplexArray:
        """Return the field on the window, shape (n, n), of refocused blocks of shape (1 or 3, n_y, n_x)."""
        return self.propagated(self.gathered(blocks))

    def gathered(self, blocks: SingleComplexArray, rows: slice = slice(None)) -> SingleComplexArray:
        """Return the weights on the Chebyshev points, shape (1 or 3, q_y, q_x), of the blocks in some ``rows``."""
        along_y = (self.gather_y[:, rows] @ blocks.view(np.float32)).view(np.complex64)
        return np.asarray((along_y.real @ self.gather_x) + 1j * (along_y.imag @ self.gather_x))

    def propagated(self, weights: SingleComplexArray) -> SingleComplexArray:
        """Return the field on the window, shape (n, n), of weights as :meth:`gathered` gives them."""
        kernel = self.kernel
        total = np.zeros(self.by_order.shape[1:], dtype=np.complex64)
        for terms, order, weight in zip(self._terms(), self.by_order, weights, strict=True):
            images = kernel.left @ (kernel.over_lens[terms] * weight) @ kernel.right
            images *= kernel.over_window[terms]
            total += order * images.sum(axis=0)
        return total

    def _terms(self) -> list[slice]:
        """Low-rank terms for the sum (all) and for the small moments (the stronger half; terms grow in strength)."""
        return [slice(None), *2 * [slice(self.kernel.rank // 2, None)]][: self.by_order.shape[0]]

    def adjoint(self, field: SingleComplexArray) -> SingleComplexArray:
        """Apply the conjugate transpose of :meth:`field`: field, shape (n, n), to blocks, shape (1 or 3, n_y, n_x)."""
        kernel = self.kernel
        blocks = []
        for terms, order in zip(self._terms(), self.by_order, strict=True):
            images = kernel.over_window[terms].conj() * (order.conj() * field)
            weights = kernel.left.conj().T @ images @ kernel.right.conj().T
            total = np.einsum("mvu,mvu->vu", kernel.over_lens[terms].conj(), weights)
            blocks.append(self.gather_y.T @ total @ self.gather_x.T)
        return np.array(blocks, dtype=np.complex64)


def window_fields(pupil: Pupil, kernel: WindowKernel, rays: Sequence[Ray]) -> Iterator[ComplexArray]:
    """Yield the field behind each ray, moved to the centre of the kernel's window, on that window, shape (n, n)."""
    for (field,) in component_fields(pupil, kernel, rays, [None]):
        yield field


def component_fields(
    pupil: Pupil, kernel: WindowKernel, rays: Sequence[Ray], weights: Sequence[Weight | None]
) -> Iterator[list[ComplexArray]]:
    """Yield for each ray one field of shape (n, n) for each of ``weights``, which multiply the light of each site.

    Otherwise they are those of :func:`window_fields`.
    """
    transform = WindowTransform.build(pupil, kernel)
    for ray in rays:
        moved, gathered = replace(ray, target_um=kernel.spec.target_um), [np.zeros((), np.complex64)] * len(weights)
        for rows, band in pupil.bands():
            blocks = refocus(band, moved, kernel.spec.wavenumber)
            for index, weight in enumerate(weights):
                part = blocks if weight is None else weighted(blocks, band, weight)
                gathered[index] = gathered[index] + transform.gathered(part, rows)
        yield [transform.propagated(total).astype(np.complex128) for total in gathered]


def _dirichlet(phase_per_site: FloatArray, sites: int) -> FloatArray:
    """Dirichlet kernel, the diffraction of a block: mean of exp(i phase n) over ``sites`` centred sites."""
    half = 0.5 * phase_per_site
    steep = np.abs(np.sin(half)) > 1e-9
    safe = np.where(steep, half, 1.0)
    return np.where(steep, np.sin(sites * safe) / (sites * np.sin(safe)), 1.0)
