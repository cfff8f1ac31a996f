"""Figures of a mapping: how well the chosen sizes follow the target phases.

Sums over tiles (:class:`TileSums`) add up to those of the lens, which give its :class:`MappingFigures`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.figures import MappingFigures
from metafab.core.numeric.chebyshev import power_coefficients
from metafab.core.numeric.compiled import compiled
from metafab.layout.pillars import SizeIndexArray
from metafab.library import Library, SizeTable
from metafab.library.use.amplitudes import power_ratio_of


@dataclass(frozen=True)
class TileSums:
    """Sums over the pillars of a tile; those of all tiles add up to those of the lens."""

    pillars: int  #: Number of pillars.
    overlap: ComplexArray  #: Shape (2,), sum of t exp(-i target) for x and y polarisation.
    power: FloatArray  #: Shape (2,), sum of |t|^2.
    square_error: FloatArray  #: Shape (2,), sum of (arg t - target)^2, each difference wrapped to (-pi, pi].
    used: NDArray[np.int64]  #: Shape (n_sizes + 1,), number of pillars of each size.
    smallest_gap_dbu: float  #: Smallest gap of all pairs with a pillar in the tile; the other may lie in another tile.
    #: Sums of the sizes that keep the gap independently, where sizes were then chosen jointly.
    each: TileSums | None = None
    #: Shape (2, 2), overlaps by the model of neighbours, of the sizes that suit equal neighbours best and of those
    #: chosen among unlike ones, for x and y polarisation; None without that choice.
    among: ComplexArray | None = None
    among_power: FloatArray | None = None  #: Shape (2, 2), likewise sums of |t|^2 by that model.
    #: Shape (2,), of both mappings: squared phase error of the local mean field, summed over pillars and polarisations.
    among_square_error: FloatArray | None = None
    lights: tuple[TileSums, ...] = ()  #: Sums at each wavelength, where sizes were chosen for several.

    @classmethod
    def of(
        cls, size_index: SizeIndexArray, target_rad: FloatArray, table: SizeTable, smallest_gap_dbu: float
    ) -> TileSums:
        """Sum over a block of size indices, shape (n_y, n_x), and target phases, shape (2, n_y, n_x)."""
        used = np.bincount(size_index.ravel(), minlength=len(table.size_dbu))
        used[0] = 0
        amplitude = np.abs(table.t)
        amplitude[0] = 0.0
        targets = np.ascontiguousarray(target_rad)
        sums = _sum_overlap_and_error(size_index, targets, amplitude.T.copy(), np.angle(table.t).T.copy())
        overlap = sums[:, 0] + 1j * sums[:, 1]
        return cls(int(used.sum()), overlap, used @ np.abs(table.t) ** 2, sums[:, 2], used, smallest_gap_dbu)

    def __add__(self, other: TileSums) -> TileSums:
        return TileSums(
            self.pillars + other.pillars,
            self.overlap + other.overlap,
            self.power + other.power,
            self.square_error + other.square_error,
            self.used + other.used,
            min(self.smallest_gap_dbu, other.smallest_gap_dbu),
            self.each + other.each if self.each and other.each else None,
            _sum_of(self.among, other.among),
            _sum_of(self.among_power, other.among_power),
            _sum_of(self.among_square_error, other.among_square_error),
            tuple(one + two for one, two in zip(self.lights, other.lights, strict=True)),
        )

    def with_light_of(self, sample: TileSums) -> TileSums:
        """Return these sums with the mean light that a sample's pillars have among their neighbours, if it has any."""
        assert sample.among is not None
        assert sample.among_power is not None
        assert sample.among_square_error is not None
        if not sample.pillars:
            return self
        share = self.pillars / sample.pillars
        return replace(
            self,
            among=share * sample.among,
            among_power=share * sample.among_power,
            among_square_error=share * sample.among_square_error,
        )

    def _neighbour_efficiency(self, power_ratio: FloatArray) -> FloatArray | None:
        """Share of power in the wanted wave by the model of neighbours, shape (2,), before and after the choice.

        A field with more power than arrives is scaled to the incident power, as the model does not conserve energy.
        """
        if self.among is None or self.among_power is None:
            return None
        wanted = np.abs(self.among / self.pillars) ** 2 * power_ratio
        transmitted = self.among_power / self.pillars * power_ratio
        return np.asarray((wanted / np.maximum(transmitted, 1.0)).mean(axis=1))

    def figures(self, library: Library, table: SizeTable, offsets_rad: Sequence[float]) -> MappingFigures:
        """Return the figures of the lens whose sums these are; the library gives the media and the angle.

        ``offsets_rad``: constants (x, y polarisation) that the target phases of the sums hold beside the design's.
        """
        ratio = power_ratio_of(library)
        transmittance = self.power / self.pillars * ratio
        overlap = np.abs(self.overlap) ** 2 / (self.pillars * self.power)
        efficiency = transmittance * overlap
        among = self._neighbour_efficiency(ratio)
        square = None if self.among_square_error is None else self.among_square_error / (2 * self.pillars)
        gap_dbu = self.smallest_gap_dbu
        used = self.used > 0
        retardance = self.overlap[1] * self.overlap[0].conj() * np.exp(1j * (offsets_rad[1] - offsets_rad[0]))
        return MappingFigures(
            pillars=self.pillars,
            distinct_sizes=int(np.count_nonzero(self.used[1:])),
            min_gap_nm=gap_dbu * table.database_unit_nm if np.isfinite(gap_dbu) else None,
            phase_rms_error_rad=float(np.sqrt(self.square_error.sum() / (2 * self.pillars))),
            mean_transmittance=float(transmittance.mean()),
            mean_transmittance_x=float(transmittance[0]),
            mean_transmittance_y=float(transmittance[1]),
            field_overlap=float(overlap.mean()),
            field_overlap_x=float(overlap[0]),
            field_overlap_y=float(overlap[1]),
            efficiency=float(efficiency.mean()),
            efficiency_x=float(efficiency[0]),
            efficiency_y=float(efficiency[1]),
            retardance_error_rad=float(np.angle(retardance)),
            neighbour_efficiency=None if among is None else float(among[1]),
            neighbour_efficiency_before=None if among is None else float(among[0]),
            neighbour_phase_rms_error_rad=None if square is None else float(np.sqrt(square[1])),
            neighbour_phase_rms_error_before_rad=None if square is None else float(np.sqrt(square[0])),
            library_error=float(np.sqrt(self.used @ table.error**2 / self.pillars)),
            worst_library_error=float(table.error[used].max()),
            doubtful_pillars=int(self.used[table.error > library.unit_cell.sweep.target_error].sum()),
        )


def _sum_of(one: NDArray[Any] | None, two: NDArray[Any] | None) -> NDArray[Any] | None:
    return None if one is None or two is None else one + two


#: Coefficients of cos(e) and of sin(e) / e as polynomials of degree 9 in q = e^2, e up to pi, lowest power first. They
#: fall like (pi / 2)^(2 n) / (2 n)!, to 1e-14 at the tenth.
_COSINE = power_coefficients(lambda q: np.cos(np.sqrt(q)), 9, (0.0, np.pi**2))
_SINE = power_coefficients(lambda q: np.sin(np.sqrt(q)) / np.sqrt(q), 9, (0.0, np.pi**2))


@compiled
def _sum_overlap_and_error(
    size_index: SizeIndexArray, target_rad: FloatArray, amplitude: FloatArray, phase_rad: FloatArray
) -> FloatArray:
    """Per polarisation: real and imaginary part of the overlap, and the squared phase error; shape (2, 3).

    Looking up, computing and adding are separate loops over a row, so that the middle one is vectorised.
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
