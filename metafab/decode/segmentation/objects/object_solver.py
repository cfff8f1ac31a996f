"""Least squares of small objects in windows, for textures and changes of the unknowns at once, and their posterior.

The information matrix is that of white noise and white textures with a weak prior of the changes; systems are solved by
preconditioned conjugate gradients. The gradient of the log-determinant of the textures' information is, by Fisher's
identity, a mean over draws from their posterior; each draw is a solve with random right sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.segmentation.objects.object_scene import DepthOptics, Unknowns, WindowScene
from metafab.decode.segmentation.objects.object_window import ObjectWindow, Spectra

#: Steps of conjugate gradients of a solve.
STEPS = 60
#: Draws of the textures; their randomness moves the depth by 0.2 of its error.
_DRAWS = 4
#: Standard deviations of the weak prior of a Gauss-Newton step.
_PRIOR = np.array([3.0, 60.0, 60.0, 60.0, 60.0, 10.0, 10.0, 30.0, 30.0])
#: Square of the preconditioned gradient below which the conjugate gradients have converged.
_CONVERGED = 1e-12
#: Least divisor of conjugate gradients.
_LEAST = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class LinearModel:
    """The model about given unknowns, linear in the textures and in changes of the unknowns."""

    scene: WindowScene  #: The model at the unknowns.
    textures: Spectra  #: Shape (k, 2, n, n // 2 + 1), white textures.
    first: int  #: First unknown that changes.
    slopes: NDArray[np.float32]  #: Shape (k, n_free, 2 * n * n), weighted images of a change by one.
    left: NDArray[np.float32]  #: Shape (k, 2, n, n), weighted images less the model's.
    #: Shape (k, 2, n, n // 2 + 1), information about the textures, for preconditioning.
    power: NDArray[np.float32]

    @classmethod
    def of(cls, window: ObjectWindow, unknowns: Unknowns, textures: Spectra, first: int) -> LinearModel:
        """Linearise about unknowns, shape (k, 9), and white textures, in the unknowns from the ``first`` one on."""
        scene = WindowScene.of(window, DepthOptics.of(window, unknowns[:, 0]), unknowns)
        slopes = scene.slopes(unknowns, textures, True, first) * window.weight
        pairs = window.surface[:, 0], scene.object[:, 0]
        power = np.stack([(np.abs(one) ** 2).sum(axis=1) for one in pairs], axis=1)
        power *= window.amplitude**2 * np.square(window.weight).mean(axis=(1, 2, 3), keepdims=True)
        left = window.weight * (window.images - scene.mean - scene.textured(textures))
        flat = np.ascontiguousarray(slopes.swapaxes(0, 1)).reshape(len(left), -1, left[0].size)
        return cls(scene, textures, first, flat, left, power)

    def solved(self, of_textures: Unknowns, steps: int) -> tuple[Unknowns, Spectra]:
        """Changes of the unknowns, 0 for fixed ones, and of the textures.

        ``of_textures``: slopes of half the logarithm of the determinant of the textures' information.
        """
        gradient = self.scene.adjoint(self.scene.window.weight * self.left) - self.textures
        change = np.zeros(of_textures.shape)
        of_free = _times(_flat(self.left), self.slopes.swapaxes(1, 2)) - of_textures[:, self.first :]
        textures, change[:, self.first :] = self._solution(gradient, of_free, steps)
        return change, textures

    def drawn(self, count: int) -> Spectra:
        """Textures drawn from their posterior about its mean, with all unknowns fixed: shape (count, k, 2, ...)."""
        window, random = self.scene.window, np.random.default_rng(0)
        # One draw for all windows: an object's fit does not depend on those that are computed with it.
        both = random.standard_normal((count, 2, 1, *window.images.shape[1:])).astype(np.float32)
        noise, white = both.swapaxes(0, 1)
        right = self.scene.adjoint(window.weight * noise) + window.spectra(white)
        return self._solution(right, np.zeros((*right.shape[:2], 0)), STEPS)[0]

    def depth_errors(self) -> FloatArray:
        """Standard error of the logarithm of vergence, the first unknown, with all others unknown too: shape (k,)."""
        first = np.zeros(self.slopes.shape[:2])
        first[:, 0] = 1.0
        _, column = self._solution(np.zeros_like(self.textures), first, STEPS)
        variance = column[:, 0]
        return np.where(variance > 0.0, np.sqrt(np.abs(variance)), np.inf)

    def _solution(self, right: Spectra, right_free: FloatArray, steps: int) -> tuple[Spectra, FloatArray]:
        """Product of the inverse information matrix and the right sides, by preconditioned conjugate gradients.

        Right sides have shapes (..., k, 2, n, n // 2 + 1) and (..., k, n_free); leading axes are those of as many
        systems.
        """
        weight, slopes = self.scene.window.weight, self.slopes[:, : right_free.shape[-1]]
        back = slopes.swapaxes(1, 2)
        prior = 1.0 / _PRIOR[self.first :][: slopes.shape[1]] ** 2
        inverse = np.linalg.inv(slopes @ back + np.diag(prior))
        through = (1.0 / (1.0 + self.power)).astype(np.float32)
        textures, free = np.zeros_like(right), np.zeros(right_free.shape)
        ahead, ahead_free = through * right, _times(right_free, inverse)
        norm = _product(right, ahead) + (right_free * ahead_free).sum(axis=-1)
        for _ in range(steps):
            images = self.scene.textured(ahead)
            images *= weight
            images += _times(ahead_free.astype(np.float32), slopes).reshape(images.shape)
            along = self.scene.adjoint(weight * images)
            along += ahead
            along_free = _times(_flat(images), back) + prior * ahead_free
            # A system that has converged stays, while others go on: its solution does not depend on theirs.
            curvature = _product(ahead, along) + (ahead_free * along_free).sum(axis=-1)
            length = np.where(norm < _CONVERGED, 0.0, norm / np.maximum(curvature, _LEAST))
            textures, free = textures + wide(length) * ahead, free + length[..., None] * ahead_free
            right, right_free = right - wide(length) * along, right_free - length[..., None] * along_free
            next_, next_free = through * right, _times(right_free, inverse)
            before, norm = norm, _product(right, next_) + (right_free * next_free).sum(axis=-1)
            if (norm < _CONVERGED).all():
                break
            ratio = norm / np.maximum(before, _LEAST)
            ahead = next_ + wide(ratio) * ahead
            ahead_free = next_free + ratio[..., None] * ahead_free
        return textures, free


def determinant_slopes(window: ObjectWindow, unknowns: Unknowns, draws: int = _DRAWS) -> Unknowns:
    """Slopes of half the logarithm of the determinant of the textures' information, from draws of the textures."""
    none = np.zeros((len(unknowns), 2, window.side, window.side // 2 + 1), dtype=np.complex64)
    linear = LinearModel.of(window, unknowns, none, unknowns.shape[1])
    drawn = linear.drawn(draws)
    at = np.square(window.weight) * linear.scene.textured(drawn)
    slopes = linear.scene.slopes(unknowns, drawn, False, 0)
    return np.asarray((slopes * at).sum(axis=(1, 3, 4, 5), dtype=np.float64).T / draws)


def _times(rows: NDArray[Any], matrices: NDArray[Any]) -> NDArray[Any]:
    """Products of rows, shape (..., k, n), and matrices, shape (k, n, m): shape (..., k, m)."""
    return np.asarray((rows[..., None, :] @ matrices)[..., 0, :])


def _flat(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Images of shape (..., 2, n, n) as rows of shape (..., 2 * n * n)."""
    return images.reshape(*images.shape[:-3], -1)


def wide(factors: FloatArray) -> NDArray[np.float32]:
    """Factors, shape (...), for transforms of shape (..., 2, n, n // 2 + 1)."""
    return factors[..., None, None, None].astype(np.float32)


def _product(one: Spectra, other: Spectra) -> FloatArray:
    """Dot products of pictures, shape (..., 2, n, n), of transforms (..., 2, n, n // 2 + 1): shape (...)."""
    of_column = np.einsum("...iyx,...iyx->...x", one.view(np.float32), other.view(np.float32)).astype(np.float64)
    both = 2.0 * of_column.sum(axis=-1) - of_column[..., :2].sum(axis=-1) - of_column[..., -2:].sum(axis=-1)
    return np.asarray(both / one.shape[-2] ** 2)
