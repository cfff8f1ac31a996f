"""Light of pixels at the edge of a plain surface: that of the surface, or of the object before it.

The light of a plain surface is even, and the sharp images show it up to the edge of what stands before it. A pixel has
the light of the surface if it differs from that nearby by noise alone. The light of an object varies with its texture,
which its other pixels show. By Bayes' rule, the ratio of both probabilities tells how much more likely the pixel is the
object's. Where the object's texture is faint and its light that of the surface, both are as likely.

The blur along an object may become a segment of its own, at a depth between that of the object and of the surface. Such
a strip has no pixels away from the edge, and the light of the surface. A small object has that by chance alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import nearest
from metafab.core.numeric.spread import normal_sigma
from metafab.decode.matching.pooling import label_sums, window_means
from metafab.decode.segmentation.fragments import adjacency

#: Side of the window over which the light of a plain surface is averaged, frame pixels.
_LEVEL_PX = 69.0
#: Fewest pixels away from the edge that tell an object's light.
_FEWEST = 50
#: The noise of a plain surface is the median deviation of one pixel in so many: medians take time.
_EACH = 8


def light_odds(
    light: NDArray[np.float32],
    surface: NDArray[np.bool_],
    label: NDArray[np.int32],
    inside: NDArray[np.bool_],
    asked: NDArray[np.bool_],
    step: int,
) -> FloatArray:
    """Log odds of the light of pixels being that of their segment to that of the plain surface nearby: (n_asked,).

    0 where the light of neither an object nor its neighbour is known.

    Args:
        light: shape (2, n_y, n_x), sharp light of both images.
        surface: shape (n_y, n_x), pixels of plain surfaces, some.
        label: shape (n_y, n_x), segment of each pixel.
        inside: shape (n_y, n_x), pixels of objects before the surface, away from their edges.
        asked: shape (n_y, n_x), the pixels.
        step: frame pixels from one downsampled pixel to the next.
    """
    window = round(_LEVEL_PX / step) | 1
    sums = window_means(np.concatenate([light * surface, surface[None]]).astype(np.float32), window)
    _, row, column = nearest(surface)
    level = (sums[:2] / np.maximum(sums[2], np.float32(1e-6)))[:, row, column]
    off = light - level
    some = np.flatnonzero(surface)[::_EACH]
    noise = np.maximum(normal_sigma(off.reshape(2, -1)[:, some], axis=1), 1e-6)
    objects, here = _Lights.of(off, label, inside, noise), off[:, asked].astype(np.float64)
    is_known = objects.count >= _FEWEST
    own, is_strip = label[asked] - 1, np.zeros_like(is_known)
    if not is_known[own].all():
        is_strip = ~is_known & adjacency(label, is_known.size + 1)[1:, 1:][:, is_known].any(axis=1)
    # A strip that is an object has any light up to twice that of the surface.
    of_anything = -np.log(np.maximum(2.0 * level[:, asked], 1e-6)).sum(axis=0)
    of_own = np.where(is_known[own], objects.log_density(own, here), of_anything)
    none = np.zeros(1)
    of_surface = _Lights(np.ones(1), np.zeros((2, 1)), noise[:, None], none).log_density(np.zeros_like(own), here)
    return np.asarray(np.where((is_known | is_strip)[own], of_own - of_surface, 0.0))


@dataclass(frozen=True)
class _Lights:
    """Normal distributions of the light of both images, one for each of n segments."""

    count: FloatArray  #: Shape (n,), pixels.
    mean: FloatArray  #: Shape (2, n).
    spread: FloatArray  #: Shape (2, n), standard deviations.
    correlation: FloatArray  #: Shape (n,), of both images.

    @classmethod
    def of(
        cls, light: NDArray[np.float32], label: NDArray[np.int32], inside: NDArray[np.bool_], noise: FloatArray
    ) -> _Lights:
        """Those of the light, shape (2, n_y, n_x), of the pixels ``inside`` segments, at least with the noise (2,)."""
        x, y = light
        pictures = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y])
        sums = label_sums(pictures, np.where(inside, label, 0).astype(np.int32), int(label.max()))
        moments = sums / np.maximum(sums[0], 1.0)
        mean = moments[1:3]
        spread = np.sqrt(np.maximum(moments[3:5] - mean**2, noise[:, None] ** 2))
        correlation = np.clip((moments[5] - mean[0] * mean[1]) / spread.prod(axis=0), -0.999, 0.999)
        return cls(sums[0], mean, spread, correlation)

    def log_density(self, which: NDArray[np.signedinteger], light: FloatArray) -> FloatArray:
        """Logarithm of the density of light, shape (2, m), in the distributions ``which``, shape (m,)."""
        x, y = (light - self.mean[:, which]) / self.spread[:, which]
        rest = 1.0 - self.correlation[which] ** 2
        square = (x * x + y * y - 2.0 * self.correlation[which] * x * y) / rest
        of_spread = np.log(self.spread[:, which]).sum(axis=0)
        return np.asarray(-0.5 * (square + np.log(rest)) - of_spread - math.log(2.0 * math.pi))
