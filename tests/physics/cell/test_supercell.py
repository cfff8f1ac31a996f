"""Symmetries of supercells, which the meshes of rectangles and of curved outlines keep alike."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.cell.elements import orders_at
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS
from tests.paper_cell import EMPTY
from tests.physics.cell.curved.test_supercell import CELL

#: A row of three unlike pillars, and the resolution of its elements.
ROWS = {
    "rectangles": (Supercell(EMPTY, np.array([[(120.0, 180.0), (150.0, 150.0), (180.0, 130.0)]])), 2.5),
    "circles": (Supercell(CELL, np.array([[(130.0, 130.0), (190.0, 190.0), (240.0, 240.0)]])), 2.0),
}


@pytest.mark.parametrize(("row", "resolution"), ROWS.values(), ids=ROWS)
def test_a_row_along_y_is_the_row_along_x_with_the_lights_exchanged(row: Supercell, resolution: float) -> None:
    along_x, along_y = (orders_at(each, POLARISATIONS, resolution) for each in (row, row.exchanged()))
    np.testing.assert_array_equal(along_y, along_x[:, ::-1, ::-1])


@pytest.mark.parametrize(("row", "resolution"), ROWS.values(), ids=ROWS)
def test_a_mirrored_row_mirrors_its_orders_and_a_moved_one_turns_their_phases(
    row: Supercell, resolution: float
) -> None:
    order, size_nm = row.propagating_orders("x")[:, 0], row.size_nm
    here, mirrored, moved = (
        orders_at(Supercell(row.cell, each), ("y",), resolution)
        for each in (size_nm, size_nm[:, ::-1], np.roll(size_nm, 1, axis=1))
    )
    np.testing.assert_allclose(mirrored, here[::-1], atol=1e-9)
    np.testing.assert_allclose(moved[:, 1, 0], here[:, 1, 0] * np.exp(-2j * np.pi * order / 3.0), atol=1e-9)
    assert np.abs(here[0] - here[-1]).max() > 0.05
