"""Transform block sums to the field on one window of the sensor, by a few matrix Fourier transforms.

Blocks are gathered on the Chebyshev points of the lens. Each low-rank term of the kernel weights the points, transforms
them to the window by two matrices, and weights the result on the window; the terms add up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric import chebyshev
from metafab.core.numeric.chebyshev import Span
from metafab.optics.geometry.path import Ray
from metafab.optics.geometry.polarisation import Weight
from metafab.optics.propagation.kernel import SingleComplexArray, WindowKernel
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.propagation.refocus import refocus, weighted


@dataclass(frozen=True)
class WindowTransform:
    """Linear map from refocused blocks to the field on the window.

    A block is its sum and, above one site, its two first moments: light that is uniform over the block and light that
    rises along x or y. The kernel is averaged over the sites of the block with these weights, which is its diffraction.
    """

    kernel: WindowKernel  #: Propagation from Chebyshev points to the window.
    #: Shape (2, q_y, n_y), blocks to weights on Chebyshev points: transposed interpolation, averaged over a block, and
    #: its slope over the block, 1/um.
    gather_y: NDArray[np.float32]
    gather_x: NDArray[np.float32]  #: Shape (2, n_x, q_x).

    @classmethod
    def build(cls, pupil: Pupil, kernel: WindowKernel) -> WindowTransform:
        """Return the transform from blocks whose sites lie in the box of ``kernel`` to the window."""
        (q_y, q_x), (over_x, over_y) = kernel.over_lens.shape[1:], kernel.spec.lens_um
        (pitch_x, pitch_y), sites = pupil.pitch_um, pupil.carrier.block_sites
        along_y = _over_blocks(over_y, q_y, pupil.y_um, pitch_y, sites)
        along_x = _over_blocks(over_x, q_x, pupil.x_um, pitch_x, sites)
        return cls(
            kernel,
            along_y.transpose(0, 2, 1).astype(np.float32, order="C"),
            along_x.astype(np.float32),
        )

    def field(self, blocks: SingleComplexArray) -> SingleComplexArray:
        """Return the field on the window, shape (n, n), of refocused blocks of shape (1 or 3, n_y, n_x)."""
        return self.propagated(self.gathered(blocks))

    def gathered(self, blocks: SingleComplexArray, rows: slice = slice(None)) -> SingleComplexArray:
        """Return the weights on the Chebyshev points, shape (q_y, q_x), of the blocks in some ``rows``."""
        (value_y, slope_y), (value_x, slope_x) = self.gather_y[:, :, rows], self.gather_x
        if blocks.shape[0] == 1:
            return _along_x(value_y @ blocks[0].view(np.float32), value_x)
        along_y = value_y @ blocks[:2].view(np.float32)
        along_y[0] += slope_y @ blocks[2].view(np.float32)
        return _along_x(along_y[0], value_x) + _along_x(along_y[1], slope_x)

    def propagated(self, weights: SingleComplexArray) -> SingleComplexArray:
        """Return the field on the window, shape (n, n), of weights as :meth:`gathered` gives them."""
        kernel = self.kernel
        images = kernel.left @ (kernel.over_lens * weights) @ kernel.right
        images *= kernel.over_window
        return np.asarray(images.sum(axis=0))

    def adjoint(self, field: SingleComplexArray) -> SingleComplexArray:
        """Apply the conjugate transpose of :meth:`field`: field, shape (n, n), to blocks, shape (3, n_y, n_x)."""
        kernel = self.kernel
        images = kernel.left.conj().T @ (kernel.over_window.conj() * field) @ kernel.right.conj().T
        weights = np.einsum("mvu,mvu->vu", kernel.over_lens.conj(), images)
        (value_y, slope_y), (value_x, slope_x) = self.gather_y, self.gather_x
        pairs = ((value_y, value_x), (value_y, slope_x), (slope_y, value_x))
        return np.array([along_y.T @ weights @ along_x.T for along_y, along_x in pairs], dtype=np.complex64)


def _along_x(values: NDArray[np.float32], gather_x: NDArray[np.float32]) -> SingleComplexArray:
    """Complex ``values``, shape (q_y, 2 n_x) as pairs of real numbers, gathered along x to shape (q_y, q_x)."""
    columns = values.view(np.complex64)
    return np.asarray((columns.real @ gather_x) + 1j * (columns.imag @ gather_x))


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


def _over_blocks(span: Span, count: int, centres: FloatArray, pitch_um: float, sites: int) -> FloatArray:
    """Interpolation from Chebyshev points to blocks along one axis, and its slope, 1/um; shape (2, n, count).

    Sums over the ``sites`` of a block are those of a Gauss rule of three places, exact to the fifth power of the
    distance from the middle.
    """
    square, fourth = (sites**2 - 1) / 12.0, (sites**2 - 1) * (3 * sites**2 - 7) / 240.0
    middle = chebyshev.interpolation(span, count, centres)
    if sites == 1:
        return np.array([middle, np.zeros_like(middle)])
    step, share = pitch_um * math.sqrt(fourth / square), 0.5 * square**2 / fourth
    below, above = (chebyshev.interpolation(span, count, centres + side * step) for side in (-1, 1))
    return np.array([(1.0 - 2.0 * share) * middle + share * (below + above), (above - below) / (2.0 * step)])
