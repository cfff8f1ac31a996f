"""Light from the side: nothing changes without pillars, and the change grows with the squared sine of the angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.library.library import Library
from metafab.library.use.oblique_error import oblique_field_error
from metafab.spec import Material

SIZES_NM = np.array([[0.0, 0.0], [120.0, 180.0], [140.0, 160.0], [160.0, 220.0]])
NUMBERS = np.array([0, 40, 40, 20])


def test_pillars_of_the_ambient_change_nothing(smooth_library: Library) -> None:
    unit_cell = smooth_library.unit_cell
    materials = replace(unit_cell.materials, pillar=Material(n=1.0))
    empty = replace(smooth_library, unit_cell=replace(unit_cell, materials=materials))
    # Fresnel's amplitudes change by the fourth order of the angle where s and p polarisation are mixed alike.
    change = oblique_field_error(empty, SIZES_NM, NUMBERS, (0.1, 0.1))
    assert change is not None
    assert change < 2e-3


def test_the_change_is_that_of_finer_solutions_weighted_by_the_pillars(smooth_library: Library) -> None:
    cells = [pillar_cell(smooth_library.unit_cell, *size) for size in ((120.0, 180.0), (140.0, 160.0), (160.0, 220.0))]
    n_in = complex(cells[0].n_of_angle).real
    angle_deg = float(np.degrees(np.arcsin(np.sin(np.arctan(0.06)) / n_in)))
    # Eight places: the shares 40, 40 and 20 % are met by 3, 3 and 2 of them.
    before, after = (
        np.repeat([np.diagonal(solve(cell, CellNumerics(target_error=2e-3)).t) for cell in each], [3, 3, 2], axis=0)
        for each in (cells, [replace(cell, angle_deg=angle_deg) for cell in cells])
    )
    turned = after * np.exp(-1j * np.angle(np.sum(after * before.conj(), axis=0)))
    expected = np.max(np.linalg.norm(turned - before, axis=0) / np.linalg.norm(before, axis=0))
    change = oblique_field_error(smooth_library, SIZES_NM, NUMBERS, (0.06, 0.0))
    assert change == pytest.approx(expected, rel=0.03)
    half = oblique_field_error(smooth_library, SIZES_NM, NUMBERS, (0.03, 0.0))
    assert half == pytest.approx(0.25 * expected, rel=0.1)


def test_no_pillars_and_no_quick_solver_give_no_figure(smooth_library: Library) -> None:
    assert oblique_field_error(smooth_library, SIZES_NM, np.zeros(4, dtype=int), (0.06, 0.0)) is None
    unit_cell = smooth_library.unit_cell
    circles = replace(smooth_library, unit_cell=replace(unit_cell, cell=replace(unit_cell.cell, shape="ellipse")))
    assert oblique_field_error(circles, SIZES_NM, NUMBERS, (0.06, 0.0)) is None


@pytest.mark.parametrize("substrate", [Material(n=1.76, n_y=1.768), Material(n=1.76, k=1e-3)])
def test_substrates_that_no_oblique_light_comes_from_give_no_figure(
    substrate: Material, smooth_library: Library
) -> None:
    """One without an index along z, and one that absorbs: both are fit for light along the axis."""
    unit_cell = smooth_library.unit_cell
    materials = replace(unit_cell.materials, substrate=substrate)
    library = replace(smooth_library, unit_cell=replace(unit_cell, materials=materials))
    assert oblique_field_error(library, SIZES_NM, NUMBERS, (0.06, 0.0)) is None
