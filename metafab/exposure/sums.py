"""Compiled loops over the pillars of a tile: sums of linearised size errors, new doses, statistics of printed sizes.

Size indices and doses have the shape (n_y, n_x). ``others``, shape (2, n_y, n_x), is the energy of all other pillars at
the edges. ``at_edge``, shape (2, n_sizes), is a pillar's own energy there per unit dose, and ``slope``, of that shape,
its decrease per nm. ``ratio`` is the base dose over the clearing dose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.numeric.compiled import compiled


@compiled
def dose_to_size_sums(
    size_index: NDArray[np.uint16], dose: Float32Array, others: Float32Array, at_edge: Float32Array, slope: Float32Array
) -> tuple[float, float]:
    """Sums over both axes of all pillars of energy / slope and of 1 / slope; shapes as in the module."""
    weighted_energy, weights = 0.0, 0.0
    for row in range(size_index.shape[0]):
        for column in range(size_index.shape[1]):
            size = size_index[row, column]
            if size == 0:
                continue
            for axis in range(2):
                energy = at_edge[axis, size] * dose[row, column] + others[axis, row, column]
                weighted_energy += energy / slope[axis, size]
                weights += 1.0 / slope[axis, size]
    return weighted_energy, weights


@compiled
def newton_doses(
    size_index: NDArray[np.uint16],
    dose: Float32Array,
    others: Float32Array,
    at_edge: Float32Array,
    slope: Float32Array,
    ratio: float,
    bounds: tuple[float, float],
    new_dose: Float32Array,
) -> tuple[float, int]:
    """Write new doses for a mean size error of zero; return the sum of squared residuals (nm^2) and their number.

    ``bounds`` are the least and the largest dose, ``new_dose`` has the shape of ``dose``, the rest as in the module.
    """
    square, count = 0.0, 0
    for row in range(size_index.shape[0]):
        for column in range(size_index.shape[1]):
            size = size_index[row, column]
            if size == 0:
                new_dose[row, column] = 1.0
                continue
            d = dose[row, column]
            residual, per_dose = 0.0, 0.0
            for axis in range(2):
                own, rest = at_edge[axis, size], others[axis, row, column]
                residual += (ratio * (own * d + rest) - 1.0) / (ratio * d * slope[axis, size])
                per_dose += (own + rest / d) / (d * slope[axis, size])
            new_dose[row, column] = min(max(d - residual / per_dose, bounds[0]), bounds[1])
            square += residual * residual
            count += 1
    return square, count


@compiled
def size_statistics(
    size_index: NDArray[np.uint16],
    dose: Float32Array,
    slope: Float32Array,
    displacement_nm: Float32Array,
    ratio: float,
    bin_nm: float,
    histogram: NDArray[np.int64],
) -> FloatArray:
    """Add size errors, printed less wanted, to a histogram and return their sums; shapes as in the module.

    ``displacement_nm``, shape (2, n_y, n_x), is the error of each edge, -inf where a pillar does not print. The
    histogram, shape (n_bins,), has bins of ``bin_nm`` and is centred on 0.

    Returns:
        Shape (8,): number of pillars, of unprinted pillars; sum, sum of squares and largest magnitude of the size
        errors (nm); sum of the latitudes (nm per percent of dose); least and largest dose.
    """
    result = np.zeros(8)
    result[6] = np.inf
    half = 0.5 * histogram.size
    for row in range(size_index.shape[0]):
        for column in range(size_index.shape[1]):
            size = size_index[row, column]
            if size == 0:
                continue
            result[0] += 1.0
            d = dose[row, column]
            result[6], result[7] = min(result[6], d), max(result[7], d)
            if not (np.isfinite(displacement_nm[0, row, column]) and np.isfinite(displacement_nm[1, row, column])):
                result[1] += 1.0
                continue
            for axis in range(2):
                error = 2.0 * displacement_nm[axis, row, column]
                result[2] += error
                result[3] += error * error
                result[4] = max(result[4], abs(error))
                # Two edges, each moved by one percent of dose.
                result[5] += 2.0 * 0.01 / (ratio * d * slope[axis, size])
                place = int(np.floor(error / bin_nm + half))
                histogram[min(max(place, 0), histogram.size - 1)] += 1
    return result
