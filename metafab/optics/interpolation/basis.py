"""A low-rank basis of the PSFs over depth and field: few images, and smooth weights that say how they mix.

    PSF(x, y; depth, direction) = sum over r of w_r(depth, direction) B_r(x, y)

A camera then blurs a scene by one convolution for each image, with the weights as maps over the scene, and
interpolates numbers where it would interpolate images. The images are the leading singular vectors of all PSFs, each
scaled to unit norm, so that the error is the same share of a faint PSF as of a bright one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.interpolation.field import spline_weights
from metafab.optics.point_spread import Psf

#: Vectors that are looked for at first; all of them only where these do not suffice.
_USUAL_RANK = 160


@dataclass(frozen=True)
class PsfBasis:
    """Images and weights of one stack over depth and field.

    Attributes:
        depth_m: shape (n_depth,), ascending.
        tangent_x: shape (n_field_x,), object directions x/z; one, 0, for a stack on the axis alone.
        tangent_y: shape (n_field_y,).
        pixel_um: sampling step of the images.
        images: shape (2, rank, n_y, n_x), orthonormal for each polarisation; strongest first.
        weights: shape (2, n_depth, n_field_y, n_field_x, rank), 1/um^2.
        error: largest relative L2 error of any PSF of the stack.
    """

    depth_m: FloatArray
    tangent_x: FloatArray
    tangent_y: FloatArray
    pixel_um: float
    images: NDArray[np.float32]
    weights: NDArray[np.float32]
    error: float

    @classmethod
    def of(cls, psf: Psf, target_error: float = 1e-2) -> PsfBasis:
        """The fewest images that carry every PSF of ``psf`` to ``target_error`` (relative L2, from 1e-6 on)."""
        if psf.field is None:
            x, y, stack = np.zeros(1), np.zeros(1), psf.psf[:, :, None, None].astype(np.float32)
        else:
            x, y, stack = psf.field.tangent_x, psf.field.tangent_y, psf.field.psf
        n_y, n_x = stack.shape[-2:]
        # In double precision: what is left of a PSF is a difference of numbers near one.
        rows = [part.reshape(-1, n_y * n_x).astype(np.float64) for part in stack]
        bases = [_singular_vectors(_unit(part), target_error) for part in rows]
        rank = max(_rank(_unit(part), basis, target_error) for part, basis in zip(rows, bases, strict=True))
        images = [basis[:rank].astype(np.float32) for basis in bases]
        weights = [(part @ basis[:rank].T).astype(np.float32) for part, basis in zip(rows, bases, strict=True)]
        left = [_left(*parts) for parts in zip(rows, weights, images, strict=True)]
        return cls(
            psf.depth_m, x, y, psf.pixel_um, np.array(images).reshape(2, rank, n_y, n_x),
            np.array(weights).reshape(*stack.shape[:-2], rank), max(left),
        )  # fmt: skip

    @property
    def rank(self) -> int:
        """Images of each polarisation."""
        return int(self.images.shape[1])

    @property
    def nbytes(self) -> int:
        """Memory of images and weights."""
        return int(self.images.nbytes + self.weights.nbytes)

    def weights_at(self, depth_m: ArrayLike, tangent_x: ArrayLike, tangent_y: ArrayLike) -> FloatArray:
        """Weights at any depths and directions inside the stack, by cubic splines (in vergence along depth).

        Args:
            depth_m: any shape.
            tangent_x: x/z, same shape.
            tangent_y: y/z, same shape.

        Returns:
            Shape (2, *shape, rank).

        Raises:
            InputError: a point outside of the stack; nothing is extrapolated.
        """
        points = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (depth_m, tangent_x, tangent_y)))
        nodes = (self.depth_m, self.tangent_x, self.tangent_y)
        for name, at, grid in zip(("depth_m", "tangent_x", "tangent_y"), points, nodes, strict=True):
            slack = 1e-12 * float(np.abs(grid).max())
            if grid.size > 1 and not np.all((at >= grid[0] - slack) & (at <= grid[-1] + slack)):
                raise InputError.single(
                    "PSF basis", name, f"from {grid[0]:g} to {grid[-1]:g}", f"{at.min():g} to {at.max():g}",
                    "compute the stack over a wider range",
                )  # fmt: skip
        over_depth = spline_weights(1.0 / self.depth_m, 1.0 / points[0])
        over_x, over_y = spline_weights(self.tangent_x, points[1]), spline_weights(self.tangent_y, points[2])
        return np.asarray(
            np.einsum("pdyxr,...d,...y,...x->p...r", self.weights, over_depth, over_y, over_x, optimize=True),
            dtype=np.float64,
        )

    def psf_at(self, depth_m: float, tangent: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Both polarisations' PSFs of one object point, shape (2, n_y, n_x), 1/um^2."""
        weights = self.weights_at(depth_m, *tangent)
        return np.asarray(np.einsum("pr,pryx->pyx", weights, self.images, optimize=True), dtype=np.float64)


def _unit(rows: FloatArray) -> FloatArray:
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(norms > 0.0, norms, 1.0))


def _singular_vectors(unit: FloatArray, target_error: float) -> FloatArray:
    """Leading right singular vectors of rows of unit norm, strongest first, by the smaller Gram matrix."""
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
    """The fewest vectors that leave no row more than the target."""
    left = (unit**2).sum(axis=1)[:, None] - np.cumsum((unit @ basis.T) ** 2, axis=1)
    enough = np.flatnonzero(left.max(axis=0) <= target_error**2)
    return 1 + int(enough[0]) if enough.size else basis.shape[0]


def _left(rows: FloatArray, weights: NDArray[np.float32], images: NDArray[np.float32]) -> float:
    """Largest relative L2 of what weights and images leave of a row."""
    norms = np.linalg.norm(rows, axis=1)
    rest = np.linalg.norm(rows - weights @ images, axis=1)
    return float(np.max(rest / np.where(norms > 0.0, norms, 1.0)))
