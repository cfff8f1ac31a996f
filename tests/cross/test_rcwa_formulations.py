"""The two formulations of RCWA on twenty pillars: adapted coordinates, and Li's rules on plain harmonics.

They share the equations and nothing of the basis, the overlaps or the certificate's measured claims. Meep, the third
witness, is compared by ``metafab library check ... --against meep``.
"""

from __future__ import annotations

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell
from metafab.cell.rcwa import solve

ON_RESONANCES = [(250.0, 250.0), (150.0, 210.0), (145.0, 245.0), (155.0, 185.0), (220.0, 195.0), (220.8, 244.6)]
DRAWN = [tuple(size) for size in np.random.default_rng(20).uniform(100.0, 250.0, (14, 2)).round(1).tolist()]


@pytest.mark.parametrize("size_nm", ON_RESONANCES + DRAWN, ids=str)
def test_adapted_coordinates_agree_with_plain_harmonics(size_nm: tuple[float, float]) -> None:
    """Within the sum of the stated errors; 12 plain harmonics err by about 1e-2 and state up to ten times that."""
    cell = PillarCell((350.0, 350.0), *size_nm, 600.0, 3.6941 + 0.0065j, (1.7601, 1.7601), 1.0, 800.0)
    adaptive = solve(cell, CellNumerics(target_error=1e-3))
    plain = solve(cell, CellNumerics(target_error=1e-9, max_orders=12, formulation="fourier"))
    assert adaptive.converged
    assert not plain.converged
    difference = max(np.abs(adaptive.t - plain.t).max(), np.abs(adaptive.r - plain.r).max())
    assert difference <= adaptive.error + plain.error
    # Loose bounds would agree with anything: Li's rules leave about 1/M^2 of the contrast, 2e-2 at M = 12.
    assert difference < 2e-2
    assert plain.error < 0.2
