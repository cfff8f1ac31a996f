"""Error bounds of unsolved sizes: certificates of solved sizes with similar slopes count."""

from __future__ import annotations

import numpy as np

from metafab.library.fit.certificate import solver_errors
from metafab.library.fit.rational import RationalModel, Shape
from metafab.library.fit.size_grid import SizeGrid

SPAN = (100.0, 250.0)


def slanted(depth: float) -> RationalModel:
    """A pole ``depth`` beside the real widths, at their middle: |dt/dW| is largest there."""
    numerator = np.array([[1.0, 0.1], [0.0, 0.0], [0.0, 0.0]], dtype=np.complex128)
    denominator = np.array([-1j * depth, 0.0, 1.0])
    return RationalModel(SPAN, SPAN, Shape((1, 1)), depth * np.stack([numerator] * 2), np.stack([denominator] * 2))


def test_a_size_states_its_own_certificate_and_others_that_of_their_like() -> None:
    """On the flat sides 1e-4 was found, on the ridge 8e-4: sizes between solved ones are told apart by their slope."""
    side = np.linspace(*SPAN, 76)
    grid = SizeGrid(side, side, exchange=False)
    widths = np.array([104.0, 240.0, 176.0, 174.0])
    width_nm, length_nm = (part.ravel() for part in np.meshgrid(widths, np.linspace(100.0, 250.0, 16)))
    sizes_nm = np.stack([width_nm, length_nm])
    error = np.where(np.abs(width_nm - 175.0) < 5.0, 8e-4, 1e-4)
    at, around = solver_errors(grid, sizes_nm, error, slanted(0.1))
    row = int(np.searchsorted(side, 132.0))
    assert at[row, np.searchsorted(side, 176.0)] >= 8e-4
    assert at[row, np.searchsorted(side, 106.0)] < 3e-4
    # Half a step off the size that was solved it is hardly steeper than there.
    assert 8e-4 <= around[row, np.searchsorted(side, 176.0)] < 1.2e-3
    assert at[np.searchsorted(side, 110.0), np.searchsorted(side, 104.0)] == 1e-4


def test_where_only_flat_sizes_were_solved_steep_ones_are_stated_as_much_worse() -> None:
    side = np.linspace(*SPAN, 76)
    grid = SizeGrid(side, side, exchange=False)
    sizes_nm = np.stack([part.ravel() for part in np.meshgrid([104.0, 240.0], np.linspace(100.0, 250.0, 16))])
    at, _ = solver_errors(grid, sizes_nm, np.full(32, 1e-4), slanted(0.1))
    assert at[40, np.searchsorted(side, 176.0)] > 10.0 * at[40, np.searchsorted(side, 110.0)]
