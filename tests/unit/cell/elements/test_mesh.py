"""Mesh, numbering and polynomials of a supercell: areas, derivatives, parity, and the singular field of a corner."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.cell.elements.basis import basis_of, elements_of
from metafab.cell.elements.line import graded_quadrature, mirrored_line, periodic_line, shapes
from metafab.cell.elements.mesh import mesh_of, singular_exponent
from metafab.cell.supercell import Supercell
from metafab.core.errors import InputError
from tests.paper_cell import EMPTY

BLOCK = Supercell(EMPTY, np.array([[(120.0, 180.0), (150.0, 110.0)], [(180.0, 130.0), (0.0, 0.0)]]))


def test_nodal_functions_have_the_edge_functions_as_derivatives() -> None:
    at = np.linspace(-0.9, 0.9, 7)
    here, ahead, back = (shapes(5, at + step) for step in (0.0, 1e-6, -1e-6))
    np.testing.assert_allclose(here.nodal_slope, (ahead.nodal - back.nodal) / 2e-6, atol=1e-8)
    np.testing.assert_allclose(here.slope @ here.edge, here.nodal_slope)
    np.testing.assert_allclose(shapes(5, np.array([-1.0, 1.0])).nodal[2:], 0.0, atol=1e-14)


def test_the_quadrature_integrates_the_corner_field() -> None:
    """Integral of (1 + x)^(-0.28) over -1..1; Gauss-Legendre of 24 nodes is off by 1e-2."""
    node, weight = graded_quadrature(24)
    assert np.sum(weight * (1.0 + node) ** -0.28) == pytest.approx(2.0**0.72 / 0.72, rel=1e-4)


def test_elements_cover_the_period_and_pillars_their_area() -> None:
    elements = elements_of(basis_of(BLOCK, "x", 2.0))
    assert sum(each.weight.sum() for each in elements) == pytest.approx(700.0**2)
    pillars = sum(each.weight.sum() for each in elements if each.is_pillar)
    assert pillars == pytest.approx(np.prod(BLOCK.size_nm, axis=-1).sum())


@pytest.mark.parametrize("even", [True, False])
def test_a_mirrored_axis_has_the_functions_of_one_parity(even: bool) -> None:
    whole = periodic_line((5, 4))
    halves = [mirrored_line((5, 4), even=each) for each in (even, not even)]
    assert sum(half.nodal_count for half in halves) == whole.nodal_count
    assert sum(half.edge_count for half in halves) == whole.edge_count
    gradient = halves[0].gradient()
    # The constant is the only continuous function without a slope.
    assert np.linalg.matrix_rank(gradient) == halves[0].nodal_count - (1 if even else 0)


def test_the_field_of_a_corner_is_continuous_and_its_flux_too() -> None:
    """Silicon in air: tau = 0.716. Across each wall the function and eps times its normal derivative agree."""
    from metafab.cell.elements.mesh import Geometry, corner_function

    tau, eps = singular_exponent(13.6, 1.0), 13.6
    assert tau == pytest.approx(0.7161, abs=1e-3)
    assert singular_exponent(1.0, 1.0) == 1.0
    nothing = np.zeros((1, 1))
    # On the wall y = 0 of a corner at the origin whose pillar lies at x, y > 0.
    on_wall = Geometry(np.array([[30.0]]), nothing, nothing, nothing, nothing, nothing)
    inner, outer = (corner_function(tau, on_wall, (0.0, 0.0), (1, 1), inside=inside) for inside in (True, False))
    assert inner[0] == pytest.approx(outer[0])
    assert inner[1] == pytest.approx(outer[1])
    assert eps * inner[2] == pytest.approx(outer[2], rel=1e-9)


def test_pillars_that_touch_are_refused() -> None:
    with pytest.raises(InputError, match="gap"):
        mesh_of(Supercell(EMPTY, np.array([[(349.0, 100.0)]])))
