"""Outlines as rectangles: energies against the closed form of polygons."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from metafab.core.conventions import FloatArray
from metafab.exposure import BeamPsf, BeamTerm
from metafab.exposure.energy.shapes import Shapes
from metafab.layout import Lattice, PillarMap
from metafab.layout.outlines import Outline
from tests.physics.exposure.conftest import polygon_energy

SIZES_DBU = np.array([(0, 0), (200, 200), (400, 400), (300, 420), (120, 620)], dtype=np.int32)
OUTLINES = [Outline("ellipse", 0.5), Outline("rounded", 0.5, 60.0), Outline("rectangle", 0.5)]


def shapes_of(outline: Outline) -> Shapes:
    index = np.zeros((3, 3), dtype=np.uint16)
    return Shapes.of(
        PillarMap.from_array(Lattice(period_dbu=(700, 700), shape=(3, 3), database_unit_nm=0.5), SIZES_DBU, index, 512),
        outline,
    )


def summed(shapes: Shapes, range_nm: float, x_nm: FloatArray, y_nm: FloatArray, *, on_axis: bool = False) -> FloatArray:
    total = np.zeros(len(x_nm))
    for part in shapes.parts(range_nm, on_axis=on_axis):
        ends = erf((x_nm + part.half_width_nm) / range_nm) - erf((x_nm - part.half_width_nm) / range_nm)
        total += 0.5 * ends * part.along_y(y_nm, range_nm)
    return total


@pytest.mark.parametrize("outline", OUTLINES, ids=lambda outline: outline.shape)
def test_parts_add_up_to_the_polygon(outline: Outline) -> None:
    """Centre, edges, inside and outside, for ranges from a blur to backscatter; 1.2e-4 is the stated error."""
    shapes, polygons = shapes_of(outline), outline.polygons(SIZES_DBU.astype(np.int64))
    np.testing.assert_allclose(shapes.area_nm2, 0.25 * outline.area(SIZES_DBU), rtol=1e-12)
    for range_nm in (5.0, 9.0, 20.0, 60.0, 150.0, 310.0, 1000.0):
        beam = BeamPsf.of([BeamTerm("gauss", 1.0, range_nm)], "assumption")
        for x, y in ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.51, 0.02), (0.35, -0.35), (-0.3, 0.4), (1.4, 0.9)):
            at_x, at_y = x * shapes.size_nm[:, 0], y * shapes.size_nm[:, 1]
            exact = [polygon_energy(beam, 0.5 * polygons[k] - (at_x[k], at_y[k])) for k in range(1, len(SIZES_DBU))]
            np.testing.assert_allclose(summed(shapes, range_nm, at_x, at_y)[1:], exact, rtol=0.0, atol=1.2e-4)
            if y == 0.0:
                on_axis = summed(shapes, range_nm, at_x, at_y, on_axis=True)
                np.testing.assert_allclose(on_axis[1:], exact, rtol=0.0, atol=1.2e-4)


@pytest.mark.parametrize("outline", OUTLINES, ids=lambda outline: outline.shape)
def test_turned_shapes_exchange_x_and_y(outline: Outline) -> None:
    shapes = shapes_of(outline)
    turned = shapes.turned()
    x, y = np.array([0.0, 60.0, 110.0, 30.0, 40.0]), np.array([0.0, 20.0, 90.0, 130.0, 200.0])
    for range_nm in (12.0, 700.0):
        np.testing.assert_allclose(summed(turned, range_nm, y, x), summed(shapes, range_nm, x, y), rtol=0.0, atol=2e-4)
    assert not summed(shapes, 12.0, x, y)[0]
