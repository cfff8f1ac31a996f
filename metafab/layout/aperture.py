"""Which sites carry a pillar: those whose whole unit cell lies inside the aperture.

The rule is decided in integers, so that mapping and design rules agree at every site of the rim: a cell centred
at (x, y) with periods (p_x, p_y) is inside a circle of diameter D when (2|x| + p_x)^2 + (2|y| + p_y)^2 <= D^2,
and inside a square of side D when 2|x| + p_x <= D and 2|y| + p_y <= D, all in database units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.layout.geometry import aperture_dbu, lattice_of
from metafab.layout.pillars import Lattice
from metafab.spec import Design


@dataclass(frozen=True)
class Aperture:
    """The sites inside, one run of columns a row.

    Attributes:
        lattice: the lattice that it masks.
        first: shape (n_y,), first column inside.
        last: shape (n_y,), one past the last column inside; equal to ``first`` where a row is empty.
    """

    lattice: Lattice
    first: NDArray[np.int64]
    last: NDArray[np.int64]

    @classmethod
    def of(cls, design: Design) -> Aperture:
        """The aperture of ``design`` on its lattice."""
        lattice = lattice_of(design)
        n_y, n_x = lattice.shape
        p_x, p_y = lattice.period_dbu
        side = aperture_dbu(design)
        reach_y = np.abs(2 * np.arange(n_y, dtype=np.int64) - (n_y - 1)) * p_y + p_y
        if design.device.aperture_shape == "square":
            reach_x = np.full(n_y, side, dtype=np.int64)
        else:
            reach_x = _isqrt(np.maximum(side * side - reach_y * reach_y, 0))
        # |2 i - (n_x - 1)| <= k is the rule above solved for column i.
        k = np.where(reach_y <= side, (reach_x - p_x) // p_x, -1)
        first = np.maximum(-((k - (n_x - 1)) // 2), 0)
        last = np.minimum((n_x - 1 + k) // 2 + 1, n_x)
        return cls(lattice, first, np.where(k < 0, first, np.maximum(first, last)))

    @property
    def count(self) -> int:
        """Sites inside."""
        return int(np.sum(self.last - self.first))

    def inside(self, row: int, column: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Which sites of the block at (row, column) are inside; shape ``shape`` = (n_y, n_x)."""
        columns = np.arange(column, column + shape[1])
        rows = slice(row, row + shape[0])
        return np.asarray((columns >= self.first[rows, None]) & (columns < self.last[rows, None]))


def _isqrt(square: NDArray[np.int64]) -> NDArray[np.int64]:
    """Largest integer whose square does not exceed ``square`` (floats alone err above 2^53)."""
    root = np.sqrt(square.astype(np.float64)).astype(np.int64)
    root -= root * root > square
    return root + ((root + 1) * (root + 1) <= square)
