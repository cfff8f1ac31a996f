"""Smoothing of a surface by robust planes about each pixel.

The price of semi-global matching for a change of level makes stairs of a slope, and where there is little texture the
levels follow noise. A plane through the levels about a pixel has less of both. Levels beyond an outline are outliers of
the plane on this side, which biweights leave out, if the step is larger than their tolerance. Once the sharp light is
known, pixels also count less the more their light differs from the pixel's own (joint bilateral filter; Petschnigg et
al., ACM Trans. Graph. 23, 664, 2004).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread

#: Rounds of the reweighted fit. The first is about the pixel's own level, with twice the tolerance.
_ROUNDS = 3
#: Samples on each side of the pixel, along both axes, at most: wider surroundings are sampled more coarsely.
_SAMPLES = 8
#: Distance from the plane, in tolerances, from which a sample is left out: it would weigh 1 % of one on the plane.
_OUTLIER = 3.0
#: Difference of the light's logarithm at which a sample's weight falls to a half. From 0.2 to 0.5 the errors of nine
#: pictures differ by 1 %; without it, they are 0.4 to 2 % larger.
_LIGHT = 0.3
#: Ridge on slopes, as a share of the sum of weights, per squared pixel: samples on one line have no slope across it.
_RIDGE = 1e-3


def smoothed_levels(
    level: FloatArray,
    weight: NDArray[np.float32],
    deviation: float,
    tolerance: float,
    light: NDArray[np.float32] | None = None,
) -> FloatArray:
    """Levels at each pixel of the planes about it: shape (n_y, n_x).

    Args:
        level: shape (n_y, n_x), level of each pixel.
        weight: shape (n_y, n_x), weight of each pixel in a fit, inverse variance in any unit, positive.
        deviation: standard deviation of the Gaussian that weights pixels by their distance, pixels. Pixels within
            5/3 of it are sampled.
        tolerance: distance from the plane at which a pixel's weight falls to a quarter, levels.
        light: shape (n_y, n_x), logarithm of the sharp light; without, pixels of any light count alike.
    """
    reach = max(1, round(5.0 / 3.0 * deviation))
    stride = max(1, round(reach / _SAMPLES))
    out = np.empty(level.shape)
    light = np.zeros(level.shape, dtype=np.float32) if light is None else light
    arrays = [np.ascontiguousarray(array, dtype=np.float64) for array in (level, weight, light)]
    spread(_fit_planes, level.shape[0], *arrays, reach // stride, stride, deviation, tolerance, out)
    return out


@compiled
def _fit_planes(
    first: int,
    stop: int,
    level: FloatArray,
    weight: FloatArray,
    light: FloatArray,
    samples: int,
    stride: int,
    deviation: float,
    tolerance: float,
    out: FloatArray,
) -> None:
    """Write the value at each pixel of the plane through ``samples`` levels on each side, ``stride`` pixels apart."""
    n_y, n_x = level.shape
    distance_weight = np.exp(-0.5 * (np.arange(-samples, samples + 1) * stride / deviation) ** 2)
    for i in range(first, stop):
        for j in range(n_x):
            value, slope_y, slope_x = level[i, j], 0.0, 0.0
            for repeat in range(_ROUNDS):
                scale = 1.0 / (2.0 * tolerance if repeat == 0 else tolerance)
                s, sy, sx, syy, syx, sxx, b, by, bx = 1e-12, 0.0, 0.0, 1e-12, 0.0, 1e-12, 0.0, 0.0, 0.0
                for m in range(-samples, samples + 1):
                    row, y = i + m * stride, float(m * stride)
                    if row < 0 or row >= n_y:
                        continue
                    along = distance_weight[m + samples]
                    for n in range(-samples, samples + 1):
                        column, x = j + n * stride, float(n * stride)
                        if column < 0 or column >= n_x:
                            continue
                        away = (level[row, column] - (value + slope_y * y + slope_x * x)) * scale
                        if abs(away) > _OUTLIER:
                            continue
                        other = (light[row, column] - light[i, j]) / _LIGHT
                        w = weight[row, column] * along * distance_weight[n + samples]
                        w /= (1.0 + away * away) ** 2 * (1.0 + other * other)
                        at = w * level[row, column]
                        s += w
                        sy += w * y
                        sx += w * x
                        syy += w * y * y
                        syx += w * y * x
                        sxx += w * x * x
                        b += at
                        by += at * y
                        bx += at * x
                syy += _RIDGE * s
                sxx += _RIDGE * s
                # Cramer's rule.
                yy_xx, y_xx, y_yx = syy * sxx - syx * syx, sy * sxx - syx * sx, sy * syx - syy * sx
                determinant = s * yy_xx - sy * y_xx + sx * y_yx
                if not determinant > 0.0:
                    break
                value = (b * yy_xx - sy * (by * sxx - syx * bx) + sx * (by * syx - syy * bx)) / determinant
                slope_y = (s * (by * sxx - bx * syx) - b * y_xx + sx * (sy * bx - by * sx)) / determinant
                slope_x = (s * (syy * bx - syx * by) - sy * (sy * bx - by * sx) + b * y_yx) / determinant
            out[i, j] = value
