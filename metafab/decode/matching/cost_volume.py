"""Cost volume: products of the filtered twin images over place and candidate depth, and their correlation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.interpolation import spline_weights
from metafab.core.parallel.executor import spread
from metafab.decode.matching.pooling import halved, label_sums

#: Depths between two candidates at which products are interpolated pixel by pixel; the nearest one is taken.
_DEPTHS_PER_CANDIDATE = 64


@dataclass(frozen=True)
class CostVolume:
    """Products of the filtered twin images a and b at each candidate depth."""

    vergences_per_m: FloatArray  #: Shape (n,), 1/depth of the candidates, equally spaced.
    products: NDArray[np.float32]  #: Shape (3, n, n_y, n_x), contiguous: a b, a^2 and b^2.
    samples: float  #: Independent samples a pixel.
    noise_gain: float  #: Variance of a filtered image per variance of a pixel of the frame.

    @property
    def shape(self) -> tuple[int, int]:
        """(n_y, n_x) of the pictures."""
        return self.products.shape[-2], self.products.shape[-1]

    @property
    def step_per_m(self) -> float:
        """Vergence from one candidate to the next."""
        return float(self.vergences_per_m[1] - self.vergences_per_m[0])

    def within(self, rows: slice, columns: slice) -> CostVolume:
        """A part of the pictures, copied once: loops over contiguous lines are two to three times as fast."""
        return replace(self, products=np.ascontiguousarray(self.products[:, :, rows, columns]))

    def halved(self) -> CostVolume:
        """The volume at every second pixel, smoothed."""
        return CostVolume(self.vergences_per_m, halved(self.products), 4.0 * self.samples, self.noise_gain)

    def at(self, vergences_per_m: FloatArray) -> NDArray[np.float32]:
        """Interpolate the products between the candidates by splines: shape (3, n, n_y, n_x).

        Vergences have the shape (n,), or (n, n_y, n_x) where they differ at each pixel.
        """
        if vergences_per_m.ndim > 1:
            return np.stack([self._at_each_pixel(one) for one in vergences_per_m], axis=1)
        weights = spline_weights(self.vergences_per_m, vergences_per_m).astype(np.float32)
        flat = self.products.reshape(*self.products.shape[:2], -1)
        return np.asarray((weights @ flat).reshape(3, -1, *self.shape))

    def _at_each_pixel(self, vergence_per_m: FloatArray) -> NDArray[np.float32]:
        if (vergence_per_m == vergence_per_m[0, 0]).all():
            return self.at(vergence_per_m[0, :1])[:, 0]
        nodes = self.vergences_per_m
        weights = _fine_weights(tuple(nodes.tolist()))
        steps = weights.shape[1] - 1
        place = np.rint((vergence_per_m - nodes[0]) * (steps / (nodes[-1] - nodes[0])))
        sums = np.zeros((3, *self.shape), dtype=np.float32)
        spread(_weighted_sums, self.shape[0], self.products, weights, np.clip(place, 0, steps).astype(np.int32), sums)
        return sums

    def label_sums(self, label: NDArray[np.int32], count: int) -> FloatArray:
        """Sum the products over the pixels of each number from 1 to ``count``: shape (count, 3, n).

        ``label`` has the shape (n_y, n_x), 0 for none.
        """
        sums = label_sums(self.products.reshape(-1, *label.shape), label, count)
        return np.moveaxis(sums.reshape(*self.products.shape[:2], count), -1, 0)


def correlation(products: np.ndarray) -> np.ndarray:
    """Normalised cross-correlation: 1 for equal twins without noise, whatever their polarisation contrast.

    Sums or means of a b, a^2 and b^2, shape (3, ...), give the shape (...), -1 to 1.
    """
    # Roots before the product: sums of squares of a bright frame are near the limit of single precision.
    norm = np.sqrt(np.maximum(products[1], 0.0)) * np.sqrt(np.maximum(products[2], 0.0))
    return np.asarray(products[0] / np.maximum(norm, 1e-15))


def correlation_less(products: NDArray[np.float32], penalty: NDArray[np.float32]) -> NDArray[np.float32]:
    """:func:`correlation` of the products, shape (3, n, n_y, n_x), less a penalty: one pass over memory.

    The penalty and the result have the shape (n, n_y, n_x).
    """
    out = np.empty(penalty.shape, dtype=np.float32)
    spread(_correlation_less, penalty.shape[1], products, penalty, out)
    return out


@compiled
def _correlation_less(
    first: int, stop: int, products: NDArray[np.float32], penalty: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    least, zero = np.float32(1e-15), np.float32(0.0)
    for k in range(out.shape[0]):
        for i in range(first, stop):
            both, x, y, less, to = products[0, k, i], products[1, k, i], products[2, k, i], penalty[k, i], out[k, i]
            for j in range(to.size):
                norm = np.sqrt(max(x[j], zero)) * np.sqrt(max(y[j], zero))
                to[j] = both[j] / max(norm, least) - less[j]


@lru_cache(maxsize=4)
def _fine_weights(nodes: tuple[float, ...]) -> NDArray[np.float32]:
    """Spline weights of the candidates at depths between them: shape (n, n_steps)."""
    fine = np.linspace(nodes[0], nodes[-1], _DEPTHS_PER_CANDIDATE * (len(nodes) - 1) + 1)
    return np.ascontiguousarray(spline_weights(np.array(nodes), fine).T, dtype=np.float32)


@compiled
def _weighted_sums(
    first: int,
    stop: int,
    products: NDArray[np.float32],
    weights: NDArray[np.float32],
    place: NDArray[np.int32],
    out: NDArray[np.float32],
) -> None:
    """Add pictures (n_products, n, n_y, n_x) by the weights (n, n_places) of each pixel's place to the sums."""
    n_products, count, _, n_x = products.shape
    share = np.empty(n_x, dtype=np.float32)
    # Line by line: its sums stay in the cache, and weights are looked up once for all products.
    for i in range(first, stop):
        for v in range(count):
            for j in range(n_x):
                share[j] = weights[v, place[i, j]]
            for p in range(n_products):
                line, to = products[p, v, i], out[p, i]
                for j in range(n_x):
                    to[j] += share[j] * line[j]
