"""The index' uncertainty against the closed form of a film, and its common phase that does not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.library.library import Library
from metafab.library.use.error_terms import index_phase_error_rad, oblique_field_error, phase_rms_rad
from metafab.spec import Material

SIZES_NM = np.array([[0.0, 0.0], [120.0, 180.0], [140.0, 160.0], [160.0, 220.0]])
NUMBERS = np.array([0, 40, 40, 20])


def _with_error(library: Library, n_error: float) -> Library:
    materials = replace(
        library.unit_cell.materials, pillar=replace(library.unit_cell.materials.pillar, n_error=n_error)
    )
    sweep = replace(library.unit_cell.sweep, target_error=2e-2)
    return replace(library, unit_cell=replace(library.unit_cell, materials=materials, sweep=sweep))


def test_an_index_without_a_stated_uncertainty_has_no_error(smooth_library: Library) -> None:
    """Unknown is not zero."""
    assert index_phase_error_rad(_with_error(smooth_library, 0.0)) is None


def test_the_error_grows_with_the_uncertainty_and_stays_below_a_solid_film(smooth_library: Library) -> None:
    small, large = (index_phase_error_rad(_with_error(smooth_library, e), samples=6) for e in (0.005, 0.01))
    assert small is not None and large is not None
    # To first order in n the phase is linear; resonances near a sample bend it.
    assert large == pytest.approx(2.0 * small, rel=0.3)
    # One pass through 600 nm of solid silicon turns the phase by 2 pi / 800 * 600 * 0.01 = 0.047 rad.
    assert 0.0 < large < 0.047 * 3.0


def test_a_phase_that_all_sizes_share_is_no_error() -> None:
    t = np.exp(1j * np.linspace(0.0, 5.0, 20)).reshape(10, 2)
    assert phase_rms_rad(t, t * np.exp(0.7j)) == pytest.approx(0.0, abs=1e-12)
    assert phase_rms_rad(t, t * np.exp(1j * np.array([[0.7, -0.2]]))) == pytest.approx(0.0, abs=1e-12)
    wobble = np.tile([[0.1], [-0.1]], (5, 2))
    assert phase_rms_rad(t, t * np.exp(1j * wobble)) == pytest.approx(0.1, rel=1e-12)


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
