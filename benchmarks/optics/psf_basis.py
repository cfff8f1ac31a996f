"""Low-rank basis of the PSFs over depth and field: a few images and their smooth weights.

    PSF(x, y; depth, direction) = sum over r of w_r(depth, direction) B_r(x, y)

A scene is blurred by one convolution per image, with maps of weights over the scene, and only weights are interpolated.
The images are the leading singular vectors of all PSFs, each scaled to unit norm, so that the relative error is the
same for faint and bright PSFs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.interpolation import spline_weights
from metafab.optics.point_spread import Psf

#: Singular vectors computed at first; all are computed only if these do not suffice.
_USUAL_RANK = 160


@dataclass(frozen=True)
class PsfBasis:
    """Images and weights of one stack over depth and field."""

    depth_m: FloatArray  #: Shape (n_depth,), ascending.
    tangent_x: FloatArray  #: Shape (n_field_x,), object directions x/z; only 0 for a stack without a field.
    tangent_y: FloatArray  #: Shape (n_field_y,), object directions y/z.
    pixel_um: float  #: Sampling step of the images.
    images: NDArray[np.float32]  #: Shape (2, rank, n_y, n_x), orthonormal for each polarisation, strongest first.
    weights: NDArray[np.float32]  #: Shape (2, n_depth, n_field_y, n_field_x, rank), 1/um^2.
    error: float  #: Largest relative L2 error of any PSF of the stack.

    @classmethod
    def of(cls, psf: Psf, target_error: float = 1e-2) -> PsfBasis:
        """Return the smallest basis that represents every PSF to ``target_error`` (relative L2, at least 1e-6)."""
        if psf.field is None:
            x, y, stack = np.zeros(1), np.zeros(1), psf.psf[:, :, None, None].astype(np.float32)
        else:
            x, y, stack = psf.field.tangent_x, psf.field.tangent_y, psf.field.psf
        n_y, n_x = stack.shape[-2:]
        # Double precision, as the residual of a PSF is a difference of numbers near one.
        rows = [part.reshape(-1, n_y * n_x).astype(np.float64) for part in stack]
        bases = [_singular_vectors(_unit(part), target_error) for part in rows]
        rank = max(_rank(_unit(part), basis, target_error) for part, basis in zip(rows, bases, strict=True))
        images = [basis[:rank].astype(np.float32) for basis in bases]
        weights = [(part @ basis[:rank].T).astype(np.float32) for part, basis in zip(rows, bases, strict=True)]
        return cls(
            psf.depth_m,
            x,
            y,
            psf.pixel_um,
            np.array(images).reshape(2, rank, n_y, n_x),
            np.array(weights).reshape(*stack.shape[:-2], rank),
            max(_largest_residual(*parts) for parts in zip(rows, weights, images, strict=True)),
        )

    @property
    def rank(self) -> int:
        """Number of images of each polarisation."""
        return int(self.images.shape[1])

    @property
    def nbytes(self) -> int:
        """Memory of images and weights, bytes."""
        return int(self.images.nbytes + self.weights.nbytes)

    def weights_at(self, depth_m: ArrayLike, tangent_x: ArrayLike, tangent_y: ArrayLike) -> FloatArray:
        """Interpolate the weights to any depths (in vergence) and directions inside the stack, by cubic splines.

        Args:
            depth_m: any shape.
            tangent_x: x/z, broadcasts with ``depth_m``.
            tangent_y: y/z, broadcasts with ``depth_m``.

        Returns:
            Shape (2, *shape, rank).

        Raises:
            InputError: a point lies outside the stack; nothing is extrapolated.
        """
        points = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (depth_m, tangent_x, tangent_y)))
        nodes = (self.depth_m, self.tangent_x, self.tangent_y)
        for name, at, grid in zip(("depth_m", "tangent_x", "tangent_y"), points, nodes, strict=True):
            slack = 1e-12 * float(np.abs(grid).max())
            if grid.size > 1 and not np.all((at >= grid[0] - slack) & (at <= grid[-1] + slack)):
                got, remedy = f"{at.min():g} to {at.max():g}", "compute the stack over a wider range"
                raise InputError.single("PSF basis", name, f"from {grid[0]:g} to {grid[-1]:g}", got, remedy)
        over_depth = spline_weights(1.0 / self.depth_m, 1.0 / points[0])
        over_x, over_y = spline_weights(self.tangent_x, points[1]), spline_weights(self.tangent_y, points[2])
        return np.asarray(
            np.einsum("pdyxr,...d,...y,...x->p...r", self.weights, over_depth, over_y, over_x, optimize=True),
            dtype=np.float64,
        )

    def psf_at(self, depth_m: float, tangent: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Return the PSFs of one object point, shape (2, n_y, n_x), 1/um^2."""
        weights = self.weights_at(depth_m, *tangent)
        return np.asarray(np.einsum("pr,pryx->pyx", weights, self.images, optimize=True), dtype=np.float64)


def _unit(rows: FloatArray) -> FloatArray:
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(norms > 0.0, norms, 1.0))


def _singular_vectors(unit: FloatArray, target_error: float) -> FloatArray:
    """Leading right singular vectors of rows of unit norm, strongest first, from the smaller Gram matrix."""
    small = unit.shape[0] <= unit.shape[1]
    gram = unit @ unit.T if small else unit.T @ unit
    count = gram.shape[0]
    for wanted in (min(_USUAL_RANK, count), count):
        squares, vectors = eigh(gram, subset_by_index=(count - wanted, count - 1))
        if wanted == count or float(np.trace(gram)) - float(squares.sum()) <= target_error**2:
            break
    kept = squares[::-1] > 1e-14 * float(squares[-1])
    kept[0] = True
    leading = vectors[:, ::-1][:, kept]
    return np.asarray(np.linalg.qr(unit.T @ leading if small else leading)[0].T)


def _rank(unit: FloatArray, basis: FloatArray, target_error: float) -> int:
    """Smallest number of vectors whose residual is within the target for each row."""
    residual = (unit**2).sum(axis=1)[:, None] - np.cumsum((unit @ basis.T) ** 2, axis=1)
    enough = np.flatnonzero(residual.max(axis=0) <= target_error**2)
    return 1 + int(enough[0]) if enough.size else basis.shape[0]


def _largest_residual(rows: FloatArray, weights: NDArray[np.float32], images: NDArray[np.float32]) -> float:
    """Largest relative L2 residual of a row."""
    norms = np.linalg.norm(rows, axis=1)
    residual = np.linalg.norm(rows - weights @ images, axis=1)
    return float(np.max(residual / np.where(norms > 0.0, norms, 1.0)))
