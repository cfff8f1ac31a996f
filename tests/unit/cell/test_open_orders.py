"""Orders that open in the substrate are counted and weighed before any work."""

from __future__ import annotations

import math
from typing import Literal

import pytest

from metafab.cell.open_orders import open_orders
from metafab.core.conventions import Side
from metafab.spec import UnitCell, make_unit_cell


def _cell(
    period_nm: float,
    side: Side = "substrate",
    *,
    shape: Literal["rectangle", "circle"] = "rectangle",
    lattice: Literal["rectangular", "hexagonal"] = "rectangular",
) -> UnitCell:
    return make_unit_cell(
        period_nm=period_nm,
        height_nm=300,
        pillar=2.0,
        substrate=1.46,
        wavelength_nm=532,
        sizes_nm=(80, 240),
        size_grid_nm=20,
        target_error=0.02,
        side=side,
        shape=shape,
        lattice=lattice,
    )


def test_no_order_opens_below_the_wavelength_in_the_substrate() -> None:
    assert open_orders(_cell(532 / 1.46 - 1)) == ()


@pytest.mark.parametrize("side", ["substrate", "ambient"])
def test_orders_in_the_substrate_are_said_with_their_share(side: Side) -> None:
    """532 / 1.46 = 364 nm: at 450 nm the four first orders travel in the glass, none in air."""
    (found,) = open_orders(_cell(450, side))
    assert (found.side, found.count) == ("substrate", 4)
    assert found.largest_period_nm == pytest.approx(532 / 1.46)
    assert 0.0 < found.share_x < 0.5
    assert found.share_x == pytest.approx(found.share_y, abs=1e-6)  # square pillars
    sentence = found.sentence()
    assert "4 diffraction orders" in sentence
    assert "below 364 nm" in sentence
    assert f"{100.0 * found.share_x:.1f} % of x" in sentence


def test_rows_of_a_hexagonal_lattice_count() -> None:
    """Orders open when the row distance, sqrt(3) / 2 of the period, exceeds the wavelength in the glass."""
    (found,) = open_orders(_cell(440, lattice="hexagonal"))
    assert found.largest_period_nm == pytest.approx(2.0 / math.sqrt(3.0) * 532 / 1.46)
    assert found.count == 6


@pytest.mark.parametrize("lattice", ["rectangular", "hexagonal"])
def test_orders_of_circles_take_what_the_zero_order_lacks(lattice: Literal["rectangular", "hexagonal"]) -> None:
    (found,) = open_orders(_cell(450, shape="circle", lattice=lattice))
    assert found.side == "substrate"
    assert 0.01 < found.share_x < 0.5
    assert found.share_x == pytest.approx(found.share_y, abs=2e-2)
