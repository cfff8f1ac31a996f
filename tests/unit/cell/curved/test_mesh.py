"""Elements of a quarter cell: they fill it without overlap, follow the outline, and are refused where they cannot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, Slice, solve
from metafab.cell.curved import is_treated
from metafab.cell.curved.mesh import quarter_mesh
from metafab.core.errors import InputError

ELLIPSE = PillarCell(
    period_nm=(340.0, 300.0),
    width_nm=110.0,
    length_nm=200.0,
    height_nm=800.0,
    n_pillar=2.461,
    n_substrate=(1.461, 1.461),
    n_ambient=1.0,
    wavelength_nm=532.0,
    shape="ellipse",
)
HEXAGONAL = replace(ELLIPSE, period_nm=(340.0, 294.0), width_nm=200.0, is_staggered=True)
ROUNDED = replace(ELLIPSE, shape="rectangle", corner_radius_nm=25.0)
STADIUM = replace(ROUNDED, corner_radius_nm=55.0)
RING = replace(ELLIPSE, shape="ring", width_nm=220.0, length_nm=220.0, hole_nm=90.0)


@pytest.mark.parametrize("cell", [ELLIPSE, HEXAGONAL, ROUNDED, STADIUM, RING, replace(ELLIPSE, width_nm=332.0)])
def test_elements_have_the_areas_of_pillar_and_cell(cell: PillarCell) -> None:
    node, weight = np.polynomial.legendre.leggauss(24)
    areas = {True: 0.0, False: 0.0}
    for quad in quarter_mesh(cell).quads:
        place = quad.geometry(node, node)
        assert place.area.min() > 0.0
        areas[quad.inside] += float(weight @ place.area @ weight)
    cut_off = (4.0 - math.pi) * cell.corner_radius_nm**2
    pillar = 1.0 if cell.shape == "rectangle" else 0.25 * math.pi
    expected = pillar * (cell.width_nm * cell.length_nm - cell.hole_nm**2) - cut_off
    assert 4.0 * areas[True] == pytest.approx(expected, rel=1e-9)
    whole = cell.period_nm[0] * cell.period_nm[1]
    assert 4.0 * sum(areas.values()) == pytest.approx(whole, rel=1e-9)


def test_slopes_of_the_map_are_its_derivatives() -> None:
    for quad in quarter_mesh(ROUNDED).quads:
        u, v, step = np.array([-0.7, 0.1, 0.8]), np.array([-0.4, 0.6]), 1e-6
        place = quad.geometry(u, v)
        for axis, (by_x, by_y) in enumerate(((place.x_u, place.y_u), (place.x_v, place.y_v))):
            one, other = (quad.geometry(u + sign * step * (1 - axis), v + sign * step * axis) for sign in (1.0, -1.0))
            np.testing.assert_allclose((one.x - other.x) / (2.0 * step), by_x, atol=1e-6)
            np.testing.assert_allclose((one.y - other.y) / (2.0 * step), by_y, atol=1e-6)


@pytest.mark.parametrize(
    ("cell", "treated"),
    [
        (ELLIPSE, True),
        (HEXAGONAL, True),
        (STADIUM, True),
        (RING, True),
        (replace(RING, sidewall_angle_deg=88.0), False),
        (replace(ELLIPSE, over=(Slice(30.0, 1.46, 1.0),), under=(Slice(20.0, 2.0, 2.0),)), True),
        (replace(ELLIPSE, over=(Slice(30.0, 1.46, 1.0, width_nm=60.0),)), False),
        (replace(ELLIPSE, corner_radius_nm=0.0, shape="rectangle"), False),
        (replace(ELLIPSE, shape="cross"), False),
        (replace(ELLIPSE, width_nm=0.0), False),
        (replace(ELLIPSE, width_nm=338.0), False),
        (replace(HEXAGONAL, width_nm=330.0, length_nm=290.0), False),
        (replace(ELLIPSE, angle_deg=5.0), False),
        (replace(ELLIPSE, sidewall_angle_deg=88.0), False),
        (replace(ELLIPSE, n_pillar=0.2 + 4.0j), False),
        (replace(ELLIPSE, n_ambient=0.2 + 4.0j), False),
        (replace(ELLIPSE, n_substrate=(1.461, 0.2 + 4.0j)), False),
        (replace(ELLIPSE, over=(Slice(30.0, 1.46, 0.2 + 4.0j),)), False),
    ],
)
def test_cells_that_have_elements(cell: PillarCell, treated: bool) -> None:
    assert is_treated(cell) is treated


def test_the_solver_says_which_way_it_went() -> None:
    assert solve(ELLIPSE, CellNumerics(target_error=0.5)).numerics.solver == "elements"
    assert solve(ELLIPSE, CellNumerics(target_error=0.5, formulation="fourier", max_orders=6)).numerics.solver == "rcwa"
    with pytest.raises(InputError, match="`formulation`: expected adaptive"):
        solve(ELLIPSE, CellNumerics(target_error=0.5, solver="elements", formulation="fourier"))


@pytest.mark.parametrize(
    ("cell", "numerics", "named"),
    [
        (replace(ELLIPSE, angle_deg=5.0), CellNumerics(target_error=0.5, solver="elements"), ["angle_deg"]),
        (replace(ROUNDED, shape="cross", corner_radius_nm=0.0), CellNumerics(solver="elements"), ["shape"]),
        (replace(HEXAGONAL, width_nm=330.0, length_nm=290.0), CellNumerics(), ["width_nm, length_nm"]),
        (replace(HEXAGONAL, n_pillar=0.2 + 4.0j), CellNumerics(), ["n_pillar"]),
        (replace(HEXAGONAL, n_pillar=0.2 + 4.0j, angle_deg=5.0), CellNumerics(), ["angle_deg", "n_pillar"]),
        (HEXAGONAL, CellNumerics(formulation="fourier"), ["formulation"]),
        (RING, CellNumerics(formulation="fourier"), ["formulation"]),
        (replace(RING, angle_deg=5.0), CellNumerics(), ["angle_deg"]),
        (replace(RING, hole_nm=220.0), CellNumerics(), ["width_nm, length_nm"]),
        (replace(ELLIPSE, hole_nm=50.0), CellNumerics(), ["hole_nm"]),
        (replace(HEXAGONAL, shape="rectangle", corner_radius_nm=20.0), CellNumerics(), ["shape"]),
    ],
)
def test_a_refusal_names_the_cause(cell: PillarCell, numerics: CellNumerics, named: list[str]) -> None:
    with pytest.raises(InputError) as refused:
        solve(cell, numerics)
    assert [fault.field.removesuffix(", corner_radius_nm") for fault in refused.value.faults] == named
