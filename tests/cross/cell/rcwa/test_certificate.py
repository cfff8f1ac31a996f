"""The two formulations of RCWA on twenty pillars: adapted coordinates, and Li's rules on plain harmonics.

They share the equations and nothing of the basis, the overlaps or the certificate's measured claims. Meep, the third
witness, is compared by ``metafab library check ... --against meep``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.cell.fourier_limit import fourier_limit
from metafab.cell import CellNumerics, PillarCell
from metafab.cell.rcwa import solve, zero_order
from metafab.cell.rcwa.jones import ZeroOrder
from metafab.core.errors import InputError
from tests.paper_cell import SILICON

ON_RESONANCES = [(250.0, 250.0), (150.0, 210.0), (145.0, 245.0), (155.0, 185.0), (220.0, 195.0), (220.8, 244.6)]
DRAWN = [tuple(size) for size in np.random.default_rng(20).uniform(100.0, 250.0, (14, 2)).round(1).tolist()]


@pytest.mark.parametrize("size_nm", ON_RESONANCES + DRAWN, ids=str)
def test_adapted_coordinates_agree_with_plain_harmonics(size_nm: tuple[float, float]) -> None:
    """Within the sum of the stated errors, the limit of 8 to 12 plain harmonics against a certified answer."""
    cell = replace(SILICON, width_nm=size_nm[0], length_nm=size_nm[1])
    adaptive, plain = solve(cell, CellNumerics(target_error=5e-4)), fourier_limit(cell)
    assert adaptive.converged
    difference = max(np.abs(adaptive.t - plain.t).max(), np.abs(adaptive.r - plain.r).max())
    assert difference <= adaptive.error + plain.error
    # Loose bounds would agree with anything. Twelve plain harmonics themselves are off by up to 1.1e-2.
    assert difference < 4e-3
    assert plain.error < 1.5e-2


def test_a_law_of_the_third_power_is_seen_through_exactly() -> None:
    limit = zero_order(SILICON, 4)

    def lawful(_: PillarCell, orders: int, formulation: str) -> ZeroOrder:
        assert formulation == "fourier"
        return replace(limit, t=limit.t + (2.0 - 1.0j) / orders**3, r=limit.r - 3.0 / orders**3)

    found = fourier_limit(SILICON, solver=lawful)
    np.testing.assert_allclose(found.t, limit.t, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found.r, limit.r, rtol=0.0, atol=1e-12)
    assert found.correction == pytest.approx(3.0 / 12**3)
    # What is held against it is not zero: a law is never known for certain.
    assert found.error > 0.1 * found.correction


def test_scatter_counts_as_error() -> None:
    limit = zero_order(SILICON, 4)

    def scattered(_: PillarCell, orders: int, formulation: str) -> ZeroOrder:
        return replace(limit, t=limit.t + 1e-2 * (-1.0) ** orders)

    found = fourier_limit(SILICON, solver=scattered)
    assert found.error > 1e-2
    assert np.abs(found.t - limit.t).max() < found.error


def test_too_little_to_extrapolate_is_refused() -> None:
    with pytest.raises(InputError, match="orders"):
        fourier_limit(SILICON, (8, 12))
    with pytest.raises(InputError, match="orders"):
        fourier_limit(SILICON, (8, 8, 12))
    with pytest.raises(InputError, match="sidewall_angle_deg"):
        fourier_limit(replace(SILICON, sidewall_angle_deg=88.0))
