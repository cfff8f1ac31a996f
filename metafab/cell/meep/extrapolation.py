"""Richardson extrapolation of several resolutions to the limit of vanishing pixels, with an error from their spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray

#: Power of h in the error of a field that is singular at a right-angled corner: 2 alpha for a field r^(alpha - 1), with
#: alpha > 2/3 for any dielectric; smooth fields have h^2.
_SLOWEST_POWER = 4.0 / 3.0


@dataclass(frozen=True)
class Extrapolated:
    """Limit of a sequence of grids."""

    value: ComplexArray  #: Shape (n_values,), the limit.
    error: float  #: Estimate of the largest absolute error among the values.
    gain: float  #: Factor from an independent error of each grid's values to that of the limit.


def richardson(pixel_um: Sequence[float], values: Sequence[ComplexArray]) -> Extrapolated:
    """Limit of v(h) = v + c_2 h^2 + c_4 h^4 + ... from two grids or more that share their coordinates, coarse to fine.

    The three finest grids give both coefficients, two grids the first only. The error assumes that the step between the
    last two second-order limits is due to a term in h^(4/3), the slowest that a pillar's corners add. With two grids it
    is the whole correction. The values of each grid have the shape (n_values,). ValueError for fewer than two grids, or
    spacings that do not descend.
    """
    if len(pixel_um) < 2 or len(pixel_um) != len(values):
        raise ValueError(f"`pixel_um`: expected two or more, as many as `values`, got {len(pixel_um)}")
    if any(fine >= coarse for coarse, fine in pairwise(pixel_um)):
        raise ValueError(f"`pixel_um`: expected descending grid spacings, got {tuple(pixel_um)}")
    h, v = np.asarray(pixel_um, dtype=np.float64), np.asarray(values, dtype=np.complex128)
    last = _limit(h[-2:], v[-2:])
    if len(h) == 2:
        return Extrapolated(last, float(np.max(np.abs(last - v[-1]))), _gain(h))
    step = float(np.max(np.abs(last - _limit(h[-3:-1], v[-3:-1]))))
    coarse, fine = (abs(_limit(pair, pair[:, None] ** _SLOWEST_POWER)[0]) for pair in (h[-3:-1], h[-2:]))
    return Extrapolated(_limit(h[-3:], v[-3:]), step * fine / (coarse - fine), _gain(h[-3:]))


def smoothed_limit(pixel_um: Sequence[float], values: Sequence[ComplexArray]) -> Extrapolated:
    """Limit of v(h) = v + c h^2 from two plain grids or more, coarse to fine, whose walls cross pixels anywhere.

    The error of such a grid deviates irregularly from c h^2, by 22 % for a circle on 36 pixels a period. The limit is
    that of weighted least squares with deviations in proportion to h^2. Its error is the largest difference from the
    limit of any two grids, and at least the correction of the finest; of two grids twice that. The values of each grid
    have the shape (n_values,); errors are raised as by :func:`richardson`.
    """
    if len(pixel_um) < 2 or len(pixel_um) != len(values):
        raise ValueError(f"`pixel_um`: expected two or more, as many as `values`, got {len(pixel_um)}")
    h, v = np.asarray(pixel_um, dtype=np.float64), np.asarray(values, dtype=np.complex128)
    columns = np.stack([h**-2, np.ones_like(h)], axis=-1)
    weights = np.linalg.pinv(columns)[0] / h**2
    value = weights @ v
    pairs = [_limit(h[[i, j]], v[[i, j]]) for i, j in combinations(range(len(h)), 2)]
    spread = max(float(np.max(np.abs(pair - value))) for pair in pairs)
    correction = float(np.max(np.abs(value - v[-1])))
    error = 2.0 * correction if len(h) == 2 else max(spread, correction)
    return Extrapolated(value, error, float(np.sum(np.abs(weights))))


def _limit(h: FloatArray, v: FloatArray | ComplexArray) -> ComplexArray:
    """Value at h = 0 of the polynomial in h^2 through all points."""
    return np.asarray(np.linalg.solve(np.vander(h**2, increasing=True).astype(np.complex128), v)[0])


def _gain(h: FloatArray) -> float:
    """Sum of the magnitudes of the weights in :func:`_limit`."""
    return float(np.sum(np.abs(_limit(h, np.eye(len(h))))))
