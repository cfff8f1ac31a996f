"""Axes beyond sizes: what is asked is checked, corners name the right cells, and contraction changes no value."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.cell import is_square, pillar_cell
from metafab.core.errors import InputError
from metafab.library.axes import CornerBox, corner_cell, corner_unit_cell
from metafab.library.fit.size_grid import SizeGrid
from metafab.library.library import Library
from metafab.library.use.lookup import isotropic_sizes
from metafab.spec import UnitCell, canonical_toml
from metafab.spec.cell import Axes, Material
from metafab.spec.toml import validate

SPANS = {
    "wavelength_nm": (795.0, 805.0),
    "height_nm": (590.0, 610.0),
    "sidewall_angle_deg": (86.0, 92.0),
    "cd_bias_nm": (-5.0, 5.0),
    "pillar_n_shift": (-0.0135, 0.0135),
    "angle_x_deg": (0.0, 6.0),
}


def asking(unit_cell: UnitCell, **spans: tuple[float, float]) -> UnitCell:
    return replace(unit_cell, sweep=replace(unit_cell.sweep, axes=Axes(**spans)))


@pytest.fixture(scope="module")
def box(unit_cell: UnitCell) -> CornerBox:
    found = CornerBox.of(asking(unit_cell, **SPANS))
    assert found is not None
    return found


def table(unit_cell: UnitCell, axes: dict[str, Any]) -> dict[str, Any]:
    """The paper's unit cell as a file would hold it, with axes."""
    whole: dict[str, Any] = tomllib.loads(canonical_toml(unit_cell))
    whole["sweep"]["axes"] = axes
    return whole


def test_a_cell_without_axes_is_written_as_before(unit_cell: UnitCell) -> None:
    """The fingerprint of a library hangs on this text: it must not name what was not asked."""
    assert "axes" not in canonical_toml(unit_cell)
    assert CornerBox.of(unit_cell) is None
    assert validate(UnitCell, table(unit_cell, dict(SPANS)), "test").sweep.axes == Axes(**SPANS)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({"wavelength_nm": [805.0, 795.0]}, "lowest, highest"),
        ({"wavelength_nm": [801.0, 805.0]}, "must contain the cell's own 800"),
        ({"height_nm": [500.0, 590.0]}, "must contain the cell's own 600"),
        ({"pillar_n_shift": [0.01, 0.02]}, "must contain the cell's own 0"),
        ({"cd_bias_nm": [-100.0, 5.0]}, "outside 0 to `cell.period_nm`"),
        ({"cd_bias_nm": [-5.0, 101.0]}, "outside 0 to `cell.period_nm`"),
        ({"angle_x_deg": [-5.0, 5.0]}, "greater than or equal to 0"),
        ({"angle_x_deg": [0.0, 90.0]}, "largest below 90"),
        ({"angle_x_deg": [0.0, 5.0], "angle_y_deg": [0.0, 5.0]}, "not both"),
        ({"corner_radius_nm": [5.0, 20.0]}, "must contain the cell's own 0"),
        ({"roughness_nm": [0.0, 20.0]}, "known key"),
    ],
)
def test_axes_that_make_no_sense_are_refused(unit_cell: UnitCell, axes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        validate(UnitCell, table(unit_cell, axes), "test")


def test_a_corner_names_its_cell(unit_cell: UnitCell) -> None:
    corner = {
        "wavelength_nm": 803.0,
        "height_nm": 607.0,
        "sidewall_angle_deg": 88.0,
        "corner_radius_nm": 12.0,
        "cd_bias_nm": -2.0,
        "pillar_n_shift": 0.01,
        "angle_x_deg": 4.0,
    }
    cell = corner_cell(unit_cell, 150.0, 210.0, corner)
    assert (cell.width_nm, cell.length_nm, cell.height_nm, cell.wavelength_nm) == (148.0, 208.0, 607.0, 803.0)
    assert cell.n_pillar == pytest.approx(3.7041 + 0.0065j)
    assert (cell.sidewall_angle_deg, cell.angle_deg, cell.azimuth_deg) == (88.0, 4.0, 0.0)
    assert cell.corner_radius_nm == 12.0
    assert corner_cell(unit_cell, 150.0, 210.0, {"angle_y_deg": 4.0}).azimuth_deg == 90.0
    # A bias grows the wall of a ring on both sides, whichever of wall and hole the unit cell states.
    for stated in ({"wall_nm": 45.0}, {"inner_diameter_nm": 60.0}):
        rings = replace(unit_cell, cell=replace(unit_cell.cell, shape="ring", sidewall_angle_deg=None, **stated))
        ring = corner_cell(rings, 150.0, 150.0, {"cd_bias_nm": 2.0})
        assert (ring.width_nm, ring.hole_nm) == (152.0, 58.0)
        with pytest.raises(InputError, match="larger than its hole"):
            corner_cell(rings, 150.0, 150.0, {"cd_bias_nm": 61.0})
    at = corner_unit_cell(asking(unit_cell, **SPANS), corner)
    assert (at.illumination.wavelength_nm, at.cell.height_nm, at.sweep.axes) == (803.0, 607.0, None)
    assert corner_cell(at, 150.0, 210.0, corner) == cell


def test_no_corner_is_the_nominal_cell(unit_cell: UnitCell) -> None:
    assert corner_cell(unit_cell, 150.0, 210.0, {}) == pillar_cell(unit_cell, 150.0, 210.0)


def test_the_box_holds_the_bias_in_its_sizes(box: CornerBox) -> None:
    assert box.width_nm == box.length_nm == (95.0, 255.0)
    assert box.variables == ("wavelength_nm", "height_nm", "sidewall_angle_deg", "pillar_n_shift", "angle_x_deg")
    assert not box.keeps_xy_symmetry


@given(
    wavelength_nm=st.floats(795.0, 805.0),
    height_nm=st.floats(590.0, 610.0),
    shift=st.floats(-0.0135, 0.0135),
    angle_deg=st.floats(0.01, 6.0),
)
def test_variables_and_back(
    box: CornerBox, wavelength_nm: float, height_nm: float, shift: float, angle_deg: float
) -> None:
    corner = box.completed(
        {"wavelength_nm": wavelength_nm, "height_nm": height_nm, "pillar_n_shift": shift, "angle_x_deg": angle_deg}
    )
    variables = box.to_variables(corner)
    assert np.all(np.abs(variables) <= 1.0 + 1e-12)
    back = box.from_variables(variables)
    # sin^2 of 0.01 degrees is 3e-8, known to 1e-16 of the span's 1e-2: the angle to 1e-8 of itself, and to 1e-7 here.
    assert back == pytest.approx({name: corner[name] for name in box.variables}, rel=1e-7, abs=1e-12)


def test_an_angle_may_have_either_sign(box: CornerBox) -> None:
    assert box.completed({"angle_x_deg": -3.0})["angle_x_deg"] == 3.0


@pytest.mark.parametrize(
    ("corner", "message"),
    [({"wavelength_nm": 806.0}, "795 to 805"), ({"tilt": 1.0}, "none of them"), ({"angle_x_deg": math.nan}, "0 to 6")],
)
def test_corners_beyond_the_box_are_refused(box: CornerBox, corner: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        box.completed(corner)


def test_a_library_without_axes_has_no_corners(smooth_library: Library) -> None:
    assert smooth_library.at() is smooth_library
    with pytest.raises(InputError, match=r"\[sweep.axes\]"):
        smooth_library.at(wavelength_nm=801.0)


def test_a_birefringent_record_tells_x_from_y(unit_cell: UnitCell, smooth_library: Library) -> None:
    """R-plane sapphire, the usual wafer: x and y light see different indices, by a record that names no `n_y`."""
    sapphire = replace(unit_cell.materials, substrate=Material(record="Al2O3/Malitson-R-x"))
    wafer = replace(unit_cell, materials=sapphire)
    assert is_square(unit_cell)
    assert not is_square(wafer)
    assert SizeGrid.of(unit_cell).exchange
    assert not SizeGrid.of(wafer).exchange
    with pytest.raises(InputError, match="different responses along x and y"):
        isotropic_sizes(replace(smooth_library, unit_cell=wafer))
    pillar = replace(unit_cell, materials=replace(sapphire, pillar=Material(record="Al2O3/Malitson-R-x")))
    with pytest.raises(InputError, match=r"materials\.pillar"):
        pillar_cell(pillar, 150.0, 150.0)
