"""Sizes chosen for the field that stands among neighbours: a window of sites, improved in rounds.

The mapping wants the largest overlap of the field with the target wave, F = sum_m Re(w_m t_m) over all sites and both
polarisations, w = exp(-i target). In each round the chains of the window are solved with two right sides, which gives
the derivatives of all corrections in F by the size of each pillar
(:func:`metafab.library.neighbours.mask.open_lines.open_line_slopes`). Every pillar then takes the best of the sizes one
step of the grid around its own: the library's t(s) counts exactly, the corrections to first order, and a step has a
price, since all pillars move at once.

F alone lets the phase of the wanted light drift by 0.05 rad from place to place: a drift costs F only to second order.
Phases are held by error diffusion: along each row a running sum of the phase errors of the field, and of what the moves
change in them, is carried from pillar to pillar. Each choice pays for the square of the sum that it leaves behind. The
derivatives of F are complex: their imaginary part is what the corrections add to the change of phase by a move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.library.neighbours.mask.open_lines import IndexArray
from metafab.library.neighbours.mask.windows import NeighbourTables
from metafab.library.neighbours.model import Neighbours

#: Rounds, and price in F of a step of width or length. Twelve rounds win twice the light by the model, but none on rows
#: by full wave: sizes drift to where corrections by rows and by columns are large, and their sum is not exact.
ROUNDS, _PRICE = 4, 1e-3
#: Price in F of half of the squared sum of phase errors, and the share of the sum that the next pillar inherits. With a
#: share of 0.95 the sum spans 20 pillars, more than a period of Shen's lens, and the phases of periods scatter by
#: 0.030 rad in place of 0.018.
_PHASE_PRICE, _KEPT = 1.0, 0.9
#: Cells along each target phase of the table of a mapping by table.
SHIFT_CELLS = 48
#: Standard deviation, in sites along the row, of the Gaussian mean that gives the local phase of the field.
_LOCAL_SITES = 5.0


@dataclass(frozen=True)
class NeighbourChoice:
    """Sizes of a mapping, and the light that they have among their neighbours."""

    tables: NeighbourTables  #: Chains at the sizes.
    t: ComplexArray  #: Shape (sizes, 2), the library's t; row 0 is no pillar.
    place: NDArray[np.intp]  #: Shape (sizes, 2), (row, column) of each size in ``grid``.
    grid: IndexArray  #: Shape (lengths, widths), index of each size; 0 where the rules admit none.
    length_nm: FloatArray  #: Shape (lengths,), lengths of the grid.
    width_nm: FloatArray  #: Shape (widths,), widths of the grid.

    @classmethod
    def of(cls, neighbours: Neighbours, size_nm: FloatArray, t: ComplexArray) -> NeighbourChoice:
        """Sizes (width, length), shape (sizes, 2), and their t, shape (sizes, 2); row 0 is no pillar."""
        width_nm, length_nm = (np.unique(size_nm[1:, axis]) for axis in (0, 1))
        place = np.zeros((len(size_nm), 2), dtype=np.intp)
        place[1:, 0] = np.searchsorted(length_nm, size_nm[1:, 1])
        place[1:, 1] = np.searchsorted(width_nm, size_nm[1:, 0])
        grid = np.zeros((length_nm.size, width_nm.size), dtype=np.uint16)
        grid[place[1:, 0], place[1:, 1]] = np.arange(1, len(size_nm))
        return cls(NeighbourTables.of(neighbours, size_nm), t, place, grid, length_nm, width_nm)

    def improve(self, size_index: IndexArray, target_rad: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Choose the sizes of a window of sites again, in place; its ends have no neighbours.

        Args:
            size_index: shape (n_y, n_x), 0 where no pillar stands, which stays so.
            target_rad: shape (2, n_y, n_x), target phases.

        Returns:
            Field over the target wave by the model before and after, shape (2, n_y, n_x) each; 0 without a pillar.
        """
        weight = np.where(size_index > 0, np.exp(-1j * target_rad), 0.0)
        for number in range(ROUNDS):
            field, slopes = self.tables.slopes(size_index, weight)
            reached = weight * (self.t[size_index].transpose(2, 0, 1) + field)
            if number == 0:
                before = reached
            error = local_mean(reached, size_index).imag.transpose(1, 2, 0)
            _move(size_index, slopes, self.t, weight, error, self.place, self.grid, self.length_nm, self.width_nm)
        return before, self.reached(size_index, target_rad)

    def reached(self, size_index: IndexArray, target_rad: FloatArray) -> ComplexArray:
        """Field over the target wave of the sizes of a window, shape (2, n_y, n_x); arguments as :meth:`improve`."""
        weight = np.where(size_index > 0, np.exp(-1j * target_rad), 0.0)
        return np.asarray(weight * (self.t[size_index].transpose(2, 0, 1) + self.tables.field(size_index)))

    def phase_shifts(self, size_index: IndexArray, target_rad: FloatArray, core: tuple[slice, slice]) -> ComplexArray:
        """Changes of t by :meth:`improve` of the sizes of a window, summed by the target phases of the pillars.

        Args:
            size_index: shape (n_y, n_x), 0 where no pillar stands.
            target_rad: shape (2, n_y, n_x), target phases.
            core: rows and columns that count.

        Returns:
            Sum of t conj(t of ``size_index``), shape (2, cells, cells), of x and y polarisation at the target phases
            2 pi (column, row) / cells.
        """
        chosen = size_index.copy()
        self.improve(chosen, target_rad)
        cell = np.rint(target_rad[:, *core] * (SHIFT_CELLS / (2.0 * np.pi))).astype(np.intp) % SHIFT_CELLS
        place = np.ravel(cell[1] * SHIFT_CELLS + cell[0])
        stands = size_index[core] > 0
        sums = np.empty((2, SHIFT_CELLS**2), dtype=np.complex128)
        for light in range(2):
            turned = self.t[chosen[core], light] * self.t[size_index[core], light].conj() * stands
            sums[light].real, sums[light].imag = (
                np.bincount(place, part.ravel(), SHIFT_CELLS**2) for part in (turned.real, turned.imag)
            )
        return sums.reshape(2, SHIFT_CELLS, SHIFT_CELLS)


def local_mean(field: ComplexArray, size_index: IndexArray) -> ComplexArray:
    """Gaussian mean along the rows, over the pillars, of a field over the target wave, shape (2, n_y, n_x) both."""
    pillars = gaussian_filter1d((size_index > 0).astype(np.float64), _LOCAL_SITES, axis=1, mode="constant")
    sums = gaussian_filter1d(field, _LOCAL_SITES, axis=2, mode="constant")
    return np.asarray(sums / np.maximum(pillars, 1e-3))


@compiled
def _move(
    size_index: IndexArray,
    slopes: ComplexArray,
    t: ComplexArray,
    weight: ComplexArray,
    error: FloatArray,
    place: NDArray[np.intp],
    grid: IndexArray,
    length_nm: FloatArray,
    width_nm: FloatArray,
) -> None:
    """Move all pillars to the best size within a step of the grid.

    ``error``, shape (n_y, n_x, 2), is the imaginary part of the local mean field over the target wave.
    """
    n_y, n_x = size_index.shape
    carried, change, chosen = np.empty(2), np.empty(2), np.empty(2)
    for m in range(n_y):
        carried[:] = 0.0
        for n in range(n_x):
            now = size_index[m, n]
            carried *= _KEPT
            if now == 0:
                continue
            carried += error[m, n]
            row, column = place[now]
            best = -np.inf
            for i in range(max(row - 1, 0), min(row + 2, length_nm.size)):
                for j in range(max(column - 1, 0), min(column + 2, width_nm.size)):
                    size = grid[i, j]
                    if size == 0:
                        continue
                    value = -_PRICE * ((i - row) ** 2 + (j - column) ** 2)
                    d_width, d_length = width_nm[j] - width_nm[column], length_nm[i] - length_nm[row]
                    for light in range(2):
                        moved = weight[light, m, n] * (t[size, light] - t[now, light])
                        moved += d_width * slopes[light, m, n, 0] + d_length * slopes[light, m, n, 1]
                        change[light] = moved.imag
                        value += moved.real - 0.5 * _PHASE_PRICE * (carried[light] + change[light]) ** 2
                    if value > best:
                        best = value
                        size_index[m, n] = size
                        chosen[:] = change
            carried += chosen
