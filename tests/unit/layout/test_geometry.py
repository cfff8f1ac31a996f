"""Lengths in whole database units; which sites lie inside the aperture."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.core.errors import InputError
from metafab.layout import Aperture, field_sites, lattice_of, tile_sites
from metafab.layout.geometry import whole_dbu
from metafab.spec import Design


def _device(design: Design, **changes: object) -> Design:
    return replace(design, device=replace(design.device, **changes))


def _mask(design: Design, **changes: object) -> Design:
    return replace(design, mask=replace(design.mask, **changes))


def test_paper_lens_has_25_6_million_sites(small_design: Design) -> None:
    design = _device(small_design, aperture_um=2000.0)
    assert lattice_of(design).shape == (5714, 5714)
    # pi (1000 um)^2 / (350 nm)^2, less half a ring of cells along the rim: within 0.1 %.
    assert Aperture.of(design).count == pytest.approx(math.pi * 1e6**2 / 350.0**2, rel=1e-3)


@given(aperture_nm=st.integers(700, 30_000), square=st.booleans())
def test_a_site_is_inside_exactly_if_its_whole_cell_is(small_design: Design, aperture_nm: int, square: bool) -> None:
    shape = "square" if square else "circle"
    design = _device(small_design, aperture_um=aperture_nm * 1e-3, aperture_shape=shape)
    lattice = lattice_of(design)
    x, y = np.meshgrid(lattice.x_dbu(), lattice.y_dbu())
    # Four times the squared distance of the far corner, in whole units: the rule in words, no rounding.
    corner_x, corner_y = 2 * np.abs(x) + lattice.period_dbu[0], 2 * np.abs(y) + lattice.period_dbu[1]
    side = 2 * aperture_nm
    inside = np.maximum(corner_x, corner_y) <= side if square else corner_x**2 + corner_y**2 <= side**2
    if not inside.any():
        with pytest.raises(InputError, match="room for a unit cell"):
            Aperture.of(design)
        return
    aperture = Aperture.of(design)
    assert np.array_equal(aperture.inside(0, 0, lattice.shape), inside)
    assert aperture.count == np.count_nonzero(inside)


def test_a_block_is_a_part_of_the_whole(small_design: Design) -> None:
    aperture = Aperture.of(small_design)
    whole = aperture.inside(0, 0, aperture.lattice.shape)
    assert np.array_equal(aperture.inside(100, 37, (50, 60)), whole[100:150, 37:97])


def test_tiles_divide_write_fields(small_design: Design) -> None:
    assert field_sites(small_design) == (1428, 1428)
    for wanted in (16, 100, 286, 700, 4096):
        design = replace(small_design, numerics=replace(small_design.numerics, tile_sites=wanted))
        assert 1428 % tile_sites(design) == 0
        assert 0.5 < tile_sites(design) / min(wanted, 1428) < 2.0


def test_a_write_field_that_cuts_pillars_is_refused_with_the_nearest_that_do_not(small_design: Design) -> None:
    with pytest.raises(InputError, match=r"499\.8 or 500\.15 um"):
        field_sites(_mask(small_design, write_field_um=500.0))


def test_the_nearest_write_fields_hold_whole_numbers_of_both_periods(small_design: Design) -> None:
    """500 um is a whole number of 400 nm, and not of 360 nm, of which 499.68 and 500.04 um are."""
    cell = small_design.unit_cell
    oblong = replace(cell, cell=replace(cell.cell, period_nm=(400.0, 360.0)))
    with pytest.raises(
        InputError, match=r"periods of 400 and of 360 nm, got 500 um.* of 360 nm; use 496\.8 or 500\.4 um"
    ):
        field_sites(replace(_mask(small_design, write_field_um=500.0), unit_cell=oblong))
    field_sites(replace(_mask(small_design, write_field_um=500.4), unit_cell=oblong))


@pytest.mark.parametrize(("period_nm", "unit_nm"), [((417.3, 391.7), 0.1), ((333.25, 333.25), 0.25)])
def test_the_write_fields_of_a_refusal_are_accepted(
    small_design: Design, period_nm: tuple[float, float], unit_nm: float
) -> None:
    """1634.5641 um and 500.20825 um, written to the last digit."""
    cell = small_design.unit_cell
    design = replace(
        _mask(small_design, write_field_um=500.0, database_unit_nm=unit_nm),
        unit_cell=replace(cell, cell=replace(cell.cell, period_nm=period_nm)),
    )
    with pytest.raises(InputError) as refusal:
        field_sites(design)
    found = re.search(r"use (\S+) or (\S+) um", str(refusal.value))
    assert found is not None
    for side_um in map(float, found.groups()):
        field_sites(_mask(design, write_field_um=side_um))


def test_a_period_off_the_grid_is_refused(small_design: Design) -> None:
    with pytest.raises(InputError, match="whole number of database units"):
        lattice_of(_mask(small_design, database_unit_nm=0.3))


def test_a_length_off_the_grid_is_named_with_all_digits_of_the_fault() -> None:
    with pytest.raises(InputError, match=r"got 100000\.13 nm, 200000\.26 units; use 100000 or 100000\.5 nm, or a unit"):
        whole_dbu(100000.13, 0.5, "at_um")


def test_an_aperture_without_a_cell_is_refused(small_design: Design) -> None:
    with pytest.raises(InputError, match="at least one period"):
        lattice_of(_device(small_design, aperture_um=0.3))


@given(units=st.integers(1, 10**6), unit_nm=st.sampled_from([0.1, 0.25, 0.5, 1.0, 5.0]))
def test_whole_units_are_exact(units: int, unit_nm: float) -> None:
    assert whole_dbu(units * unit_nm, unit_nm, "a") == units
    if units % 2:
        with pytest.raises(InputError, match="even number"):
            whole_dbu(units * unit_nm, unit_nm, "a", even=True)


@pytest.mark.parametrize(
    ("length_nm", "unit_nm", "even", "remedy"),
    [
        (0.5, 0.5, True, "use 0 or 1 nm, or a unit of 0.25 nm"),
        (351.0, 0.5, True, None),
        (351.0, 1.0, True, "use 350 or 352 nm, or a unit of 0.5 nm"),
        (100.0 / 3.0, 0.5, False, "use 33 or 33.5 nm"),
    ],
)
def test_the_remedy_for_a_length_off_the_grid_is_one(
    length_nm: float, unit_nm: float, even: bool, remedy: str | None
) -> None:
    if remedy is None:
        assert whole_dbu(length_nm, unit_nm, "x", even=even) == 702
        return
    with pytest.raises(InputError) as caught:
        whole_dbu(length_nm, unit_nm, "x", even=even)
    assert caught.value.faults[0].remedy == remedy
