"""Agreement of the twins over place and depth, pooled over windows or segments."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.decode.matching.pooling import halved, label_sums
from metafab.optics.interpolation.field import spline_weights

#: Depths between two candidates at which products are interpolated for each pixel; the nearest is taken.
_FINE = 64


@dataclass(frozen=True)
class Volume:
    """Products of the aligned images a and b at each candidate depth.

    Attributes:
        vergences_per_m: shape (n,), 1/depth, equally spaced.
        parts: shape (3, n, n_y, n_x): a b, a^2 and b^2.
        samples: independent samples a pixel.
        noise_gain: variance of an aligned image per variance of a pixel of the frame.
    """

    vergences_per_m: FloatArray
    parts: NDArray[np.float32]
    samples: float
    noise_gain: float

    @property
    def step_per_m(self) -> float:
        """Spacing of the candidates."""
        return float(self.vergences_per_m[1] - self.vergences_per_m[0])

    def within(self, rows: slice, columns: slice) -> Volume:
        """A part of the picture."""
        return replace(self, parts=self.parts[:, :, rows, columns])

    def halved(self) -> Volume:
        """Every second pixel, a mean of what lies about it."""
        return Volume(self.vergences_per_m, halved(self.parts), 4.0 * self.samples, self.noise_gain)

    def at(self, vergences_per_m: FloatArray) -> NDArray[np.float32]:
        """The products at any depths, interpolated between the candidates: shape (3, n, n_y, n_x).

        Args:
            vergences_per_m: shape (n,), or (n, n_y, n_x) for depths of their own at each pixel.
        """
        if vergences_per_m.ndim > 1:
            return np.stack([self._at_each(one) for one in vergences_per_m], axis=1)
        weights = spline_weights(self.vergences_per_m, vergences_per_m).astype(np.float32)
        flat = self.parts.reshape(*self.parts.shape[:2], -1)
        return np.asarray((weights @ flat).reshape(3, -1, *self.parts.shape[-2:]))

    def _at_each(self, vergence_per_m: FloatArray) -> NDArray[np.float32]:
        if (vergence_per_m == vergence_per_m[0, 0]).all():
            return self.at(vergence_per_m[0, :1])[:, 0]
        nodes = self.vergences_per_m
        weights = _fine_weights(tuple(nodes.tolist()))
        steps = weights.shape[1] - 1
        place = np.rint((vergence_per_m - nodes[0]) * (steps / (nodes[-1] - nodes[0])))
        mixed = _mixed if HAS_NUMBA else _mixed_plain
        return mixed(self.parts, weights, np.clip(place, 0, steps).astype(np.int32))

    def over(self, label: NDArray[np.int32], count: int) -> FloatArray:
        """Sums over the pixels of each label from 1 to ``count``: shape (count, 3, n)."""
        sums = label_sums(self.parts.reshape(-1, *label.shape), label, count)
        return np.moveaxis(sums.reshape(*self.parts.shape[:2], count), -1, 0)


@lru_cache(maxsize=4)
def _fine_weights(nodes: tuple[float, ...]) -> NDArray[np.float32]:
    """Weights of the candidates at depths between them: shape (n, n_steps)."""
    fine = np.linspace(nodes[0], nodes[-1], _FINE * (len(nodes) - 1) + 1)
    return np.ascontiguousarray(spline_weights(np.array(nodes), fine).T, dtype=np.float32)


def _mixed_plain(
    parts: NDArray[np.float32], weights: NDArray[np.float32], place: NDArray[np.int32]
) -> NDArray[np.float32]:
    return np.asarray(np.einsum("vyx,pvyx->pyx", weights[:, place], parts))


@compiled
def _mixed(parts: NDArray[np.float32], weights: NDArray[np.float32], place: NDArray[np.int32]) -> NDArray[np.float32]:
    """Sums of pictures (n_parts, n, n_y, n_x) by the weights (n, n_places) of each pixel's place."""
    n_parts, count, n_y, n_x = parts.shape
    out = np.zeros((n_parts, n_y, n_x), dtype=np.float32)
    share = np.empty(n_x, dtype=np.float32)
    # A line at a time: its sums stay in the cache, and all parts take the shares that are looked up once.
    for i in range(n_y):
        for v in range(count):
            for j in range(n_x):
                share[j] = weights[v, place[i, j]]
            for p in range(n_parts):
                line, to = parts[p, v, i], out[p, i]
                for j in range(n_x):
                    to[j] += share[j] * line[j]
    return out


def correlation(parts: np.ndarray) -> np.ndarray:
    """Normalised cross-correlation: blind to the polarisation contrast, 1 for equal twins without noise.

    Args:
        parts: shape (3, ...): sums or means of a b, a^2 and b^2.
    """
    # Roots before the product: sums of squares of a bright frame are near the end of single precision.
    norm = np.sqrt(np.maximum(parts[1], 0.0)) * np.sqrt(np.maximum(parts[2], 0.0))
    return np.asarray(parts[0] / np.maximum(norm, 1e-15))
