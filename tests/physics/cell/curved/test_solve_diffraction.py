"""Single orders by spectral elements: power, RCWA where both serve, and the directions of a hexagonal lattice."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, rcwa
from metafab.cell.curved.solve import diffraction
from metafab.cell.rcwa.diffraction import Diffraction

#: Lossless circles whose first orders open on both sides.
CIRCLE = PillarCell(
    period_nm=(620.0, 560.0),
    width_nm=260.0,
    length_nm=260.0,
    height_nm=500.0,
    n_pillar=2.0,
    n_substrate=(1.46, 1.46),
    n_ambient=1.0,
    wavelength_nm=532.0,
    shape="ellipse",
)
HEXAGONAL = replace(CIRCLE, period_nm=(640.0, 554.0), is_staggered=True)
RING = replace(HEXAGONAL, shape="ring", hole_nm=120.0)


def _efficiencies(found: Diffraction) -> np.ndarray:
    return np.array([(each.efficiency_x, each.efficiency_y) for each in (*found.transmitted, *found.reflected)])


@pytest.mark.parametrize("cell", [CIRCLE, HEXAGONAL, RING], ids=["circle", "hexagonal", "ring"])
def test_all_orders_together_carry_the_power_that_came_in(cell: PillarCell) -> None:
    found = diffraction(cell, CellNumerics(target_error=0.1))
    np.testing.assert_allclose(_efficiencies(found).sum(axis=0), 1.0, atol=found.error)
    assert found.error < 0.1
    assert len(found.transmitted) > 1


def test_an_order_that_leaves_for_one_polarisation_alone_has_no_power_for_the_other() -> None:
    """On a substrate of two indices, which the first orders enter for y light alone."""
    cell = replace(HEXAGONAL, period_nm=(300.0, 400.0), n_substrate=(1.25, 1.45))
    found = diffraction(cell, CellNumerics(target_error=0.5))
    first = [each for each in found.reflected if each.order == (0, 2)]
    assert [each.efficiency_x for each in first] == [0.0]
    assert first[0].efficiency_y > 0.0


def test_they_are_those_of_rcwa_where_both_serve() -> None:
    """RCWA converges slowly on circles: at nine cosines it states 1, as it implies 0.17, and is off by 2e-3."""
    found, other = (
        diffraction(CIRCLE, CellNumerics(target_error=1e-2)),
        rcwa.diffraction(CIRCLE, CellNumerics(target_error=5e-2, max_orders=9)),
    )
    assert [each.order for each in found.transmitted] == [each.order for each in other.transmitted]
    np.testing.assert_allclose(_efficiencies(found), _efficiencies(other), atol=1e-2)
    assert found.error < 5e-3
    assert other.error == 1.0


def test_the_first_orders_of_a_hexagonal_lattice_leave_along_its_six_directions() -> None:
    """Whose period is the row distance: sin = 2 wavelength / (sqrt(3) period)."""
    found = diffraction(replace(HEXAGONAL, period_nm=(640.0, 320.0 * math.sqrt(3.0))), CellNumerics(target_error=0.3))
    first = [each for each in found.transmitted if any(each.order)]
    sines = [math.sin(math.radians(each.polar_deg)) for each in first]
    np.testing.assert_allclose(sines, 532.0 / (320.0 * math.sqrt(3.0)), rtol=1e-9)
    assert sorted(each.azimuth_deg for each in first) == pytest.approx([-150.0, -90.0, -30.0, 30.0, 90.0, 150.0])
