"""How well chosen sizes follow their targets: sums over a tile that add up to a lens' figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray, wrap_phase
from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.layout.pillars import SizeIndexArray
from metafab.library import SizeTable


@dataclass(frozen=True)
class TileFigures:
    """Sums over the pillars of a tile; those of all tiles add up to the lens'.

    Attributes:
        pillars: how many.
        overlap: shape (2,), sum of t exp(-i target) for x and y polarisation.
        power: shape (2,), sum of |t|^2.
        square_error: shape (2,), sum of (arg t - target)^2, each wrapped to (-pi, pi].
        used: shape (n_sizes + 1,), pillars of each size.
        smallest_gap_dbu: over all pairs with a pillar in the tile, neighbours in other tiles included.
        plain: where sizes were chosen jointly, the figures of the plain choice.
    """

    pillars: int
    overlap: NDArray[np.complex128]
    power: FloatArray
    square_error: FloatArray
    used: NDArray[np.int64]
    smallest_gap_dbu: float
    plain: TileFigures | None = None

    @classmethod
    def of(
        cls, size_index: SizeIndexArray, target_rad: FloatArray, table: SizeTable, smallest_gap_dbu: float
    ) -> TileFigures:
        """Figures of a block of sites, shape (n_y, n_x), against its targets, shape (2, n_y, n_x), rad, any turns."""
        used = np.bincount(size_index.ravel(), minlength=len(table.size_dbu))
        used[0] = 0
        overlap, square_error = compare(size_index, target_rad, table)
        return cls(int(used.sum()), overlap, used @ np.abs(table.t) ** 2, square_error, used, smallest_gap_dbu)

    def __add__(self, other: TileFigures) -> TileFigures:
        return TileFigures(
            self.pillars + other.pillars,
            self.overlap + other.overlap,
            self.power + other.power,
            self.square_error + other.square_error,
            self.used + other.used,
            min(self.smallest_gap_dbu, other.smallest_gap_dbu),
            self.plain + other.plain if self.plain and other.plain else None,
        )


def compare(
    size_index: SizeIndexArray, target_rad: FloatArray, table: SizeTable
) -> tuple[NDArray[np.complex128], FloatArray]:
    """Sums of t exp(-i target) and of the squared phase error over the pillars, each of shape (2,)."""
    if not HAS_NUMBA:
        return compare_vectorised(size_index, target_rad, table)
    amplitude = np.abs(table.t)
    amplitude[0] = 0.0
    sums = _compare(size_index, np.ascontiguousarray(target_rad), amplitude.T.copy(), np.angle(table.t).T.copy())
    return sums[:, 0] + 1j * sums[:, 1], sums[:, 2]


def compare_vectorised(
    size_index: SizeIndexArray, target_rad: FloatArray, table: SizeTable
) -> tuple[NDArray[np.complex128], FloatArray]:
    """As :func:`compare`, in NumPy alone."""
    filled = size_index > 0
    t = table.t[size_index[filled]].T
    error = wrap_phase(np.angle(t) - target_rad[:, filled])
    return np.sum(np.abs(t) * np.exp(1j * error), axis=1), np.sum(error**2, axis=1)


def _even_series(function: np.ufunc, odd: bool) -> tuple[float, ...]:
    """Cosine, or sine over its argument, as a polynomial of degree 9 in q = error^2 on [0, pi^2], lowest power first.

    Interpolation in Chebyshev points; the coefficients fall like (pi / 2)^(2 n) / (2 n)!, to 1e-14 at the tenth.
    """

    def sampled(q: FloatArray) -> FloatArray:
        root = np.sqrt(q)
        return np.asarray(function(root) / root if odd else function(root))

    chebyshev = np.polynomial.Chebyshev.interpolate(sampled, 9, domain=[0.0, np.pi**2])
    power = chebyshev.convert(kind=np.polynomial.Polynomial, domain=[-1.0, 1.0], window=[-1.0, 1.0])
    return tuple(float(c) for c in power.coef)


_COSINE, _SINE = _even_series(np.cos, odd=False), _even_series(np.sin, odd=True)


@compiled
def _compare(
    size_index: SizeIndexArray, target_rad: FloatArray, amplitude: FloatArray, phase_rad: FloatArray
) -> FloatArray:
    """Per channel: real and imaginary part of the overlap, squared error.

    Looking up, computing and adding are loops of their own over a row, so that the middle one is vectorised.
    """
    sums = np.zeros((2, 3))
    c, s = _COSINE, _SINE
    turn, per_turn = 2.0 * np.pi, 0.5 / np.pi
    n_y, n_x = size_index.shape
    weight, reached, real, imag, square = np.empty(n_x), np.empty(n_x), np.empty(n_x), np.empty(n_x), np.empty(n_x)
    for channel in range(2):
        for row in range(n_y):
            for column in range(n_x):
                size = size_index[row, column]
                weight[column] = amplitude[channel, size]
                reached[column] = phase_rad[channel, size]
            for column in range(n_x):
                error = reached[column] - target_rad[channel, row, column]
                error -= turn * np.rint(per_turn * error)
                q = error * error
                cosine = (((c[9] * q + c[8]) * q + c[7]) * q + c[6]) * q + c[5]
                cosine = ((((cosine * q + c[4]) * q + c[3]) * q + c[2]) * q + c[1]) * q + c[0]
                sine = (((s[9] * q + s[8]) * q + s[7]) * q + s[6]) * q + s[5]
                sine = ((((sine * q + s[4]) * q + s[3]) * q + s[2]) * q + s[1]) * q + s[0]
                real[column] = weight[column] * cosine
                imag[column] = weight[column] * sine * error
                square[column] = q
            for column in range(n_x):
                sums[channel, 0] += real[column]
                sums[channel, 1] += imag[column]
                sums[channel, 2] += square[column] if size_index[row, column] > 0 else 0.0
    return sums
