"""Oblique light against solved cells: its error along the axis, and its expansion in the cosines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.cell.response import power_ratio
from metafab.library.library import Library
from metafab.library.use import oblique
from metafab.library.use.oblique import oblique_change, oblique_field_error, powers
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


def _solved(library: Library, size_nm: tuple[float, float], direction: tuple[float, float]) -> np.ndarray:
    """t_xx and t_yy at fine truncation, in square roots of power."""
    cell = pillar_cell(library.unit_cell, *size_nm)
    slope = np.hypot(*direction)
    angle_deg = float(np.degrees(np.arcsin(slope / np.hypot(1.0, slope) / complex(cell.n_of_angle).real)))
    azimuth_deg = float(np.degrees(np.arctan2(direction[1], direction[0])))
    tilted = replace(cell, angle_deg=angle_deg, azimuth_deg=azimuth_deg)
    return np.diagonal(solve(tilted, CellNumerics(target_error=2e-3)).t) * np.sqrt(power_ratio(tilted))


def test_the_expansion_is_that_of_solved_directions(smooth_library: Library) -> None:
    """Three sizes, all of them solved: directions between and beside the planes are predicted."""
    corner = (0.08, 0.06)
    found = oblique_change(smooth_library, SIZES_NM, NUMBERS, corner)
    assert found is not None
    # The solved truncation is common to both and cancels; the term in u_x^2 u_y^2 is what is left.
    assert found.left < 0.15 * found.change
    assert not found.coefficients[0].any()
    for direction, share in (((0.065, 0.0), 0.05), ((0.03, -0.07), 0.15)):
        size = (160.0, 220.0)
        straight, tilted = (_solved(smooth_library, size, each) for each in ((0.0, 0.0), direction))
        predicted = powers(direction) @ found.coefficients[3]
        assert np.linalg.norm(straight + predicted - tilted) < share * np.linalg.norm(tilted - straight)


def test_sizes_that_were_not_solved_follow_from_a_fit(smooth_library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mask of more sizes than are solved: the error stated from held-out ones, and a size that is none of them."""
    monkeypatch.setattr(oblique, "_FITTED_SIZES", 24)
    side = np.arange(110.0, 151.0, 8.0)
    sizes = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    numbers = np.ones(len(sizes), dtype=int)
    found = oblique_change(smooth_library, sizes, numbers, (0.08, 0.0))
    assert found is not None
    assert found.left < 0.2 * found.change
    size, direction = sizes[1], (0.07, 0.0)
    straight, tilted = (_solved(smooth_library, tuple(size), each) for each in ((0.0, 0.0), direction))
    miss = np.linalg.norm(straight + powers(direction) @ found.coefficients[1] - tilted)
    assert miss < 0.2 * np.linalg.norm(tilted - straight)
