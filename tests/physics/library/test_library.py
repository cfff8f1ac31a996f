"""A library of circles has one size: what is made is known to its error, what is not is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.core.errors import InputError
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library import Library, build_size_table
from metafab.library.axes import corner_cell
from metafab.library.sweep.build import BuildNumerics
from metafab.library.sweep.corner_sampling import CornerNumerics
from metafab.library.use.any_size import response_of_sizes
from metafab.library.use.lookup import phase_slope_per_nm
from metafab.optics import WrittenField, written_field
from metafab.report.figures import library as figures
from metafab.spec import UnitCell, load_unit_cell
from metafab.spec.cell import Axes
from metafab.tolerance import corner_fields

NITRIDE = Path(__file__).parents[3] / "unitcell_lib" / "sin_circles_633nm.toml"
DIAMETERS_NM = np.linspace(100.0, 160.0, 7)


@pytest.fixture(scope="module")
def unit_cell() -> UnitCell:
    """Seven diameters of the example's cell."""
    cell = load_unit_cell(NITRIDE)
    sweep = replace(cell.sweep, width_nm=(100.0, 160.0), length_nm=(100.0, 160.0), size_grid_nm=10.0)
    return replace(cell, sweep=sweep)


@pytest.fixture(scope="module")
def circles(unit_cell: UnitCell) -> Library:
    return library.build(unit_cell)


def test_only_diameters_are_solved_and_both_polarisations_answer_alike(circles: Library) -> None:
    assert circles.statistics.points_solved == circles.statistics.points_total == 7
    assert np.array_equal(circles.known, np.eye(7, dtype=bool))
    t = circles.t_xx[0].diagonal()
    np.testing.assert_allclose(t, circles.t_yy[0].diagonal(), atol=1e-12)
    assert np.all(np.isnan(circles.t_xx[0][~circles.known]))
    assert circles.statistics.max_error <= circles.unit_cell.sweep.target_error
    # A wider post is optically longer.
    assert np.all(np.diff(np.unwrap(np.angle(t))) > 0.0)


def test_it_survives_its_file_and_holds_against_a_finer_solution(circles: Library, tmp_path: Path) -> None:
    library.save(circles, tmp_path / "circles.h5")
    again = library.load(tmp_path / "circles.h5")
    np.testing.assert_array_equal(again.t_xx, circles.t_xx)
    result = library.check(again, samples=3)
    assert result.verdict == "holds"
    assert all(size.width_nm == size.length_nm for size in result.sizes)


def test_a_circle_is_spoken_of_by_its_diameter(circles: Library) -> None:
    assert circles.key_figures()["sizes"].endswith(f"to {circles.width_nm[-1]:g} nm in diameter")
    strict = replace(circles.unit_cell, sweep=replace(circles.unit_cell.sweep, target_error=1e-9))
    (sentence,) = replace(circles, unit_cell=strict).warnings()
    assert " nm in diameter, is known to " in sentence and " x " not in sentence


def test_figures_of_merit_are_those_of_the_diameters(circles: Library) -> None:
    found = library.quality(circles)
    assert all(map(math.isfinite, vars(found).values()))
    slope = phase_slope_per_nm(circles)[3, 3, 0]
    ends = np.unwrap(np.angle(circles.t_xx[0].diagonal()))
    assert slope == pytest.approx((ends[4] - ends[2]) / 20.0, rel=0.05)


def test_a_layout_gets_circles_and_nothing_else(circles: Library) -> None:
    table = build_size_table(circles, database_unit_nm=0.5, cells=32)
    assert np.array_equal(0.5 * table.size_dbu[1:], np.repeat(DIAMETERS_NM[:, None], 2, axis=1))
    assert np.isfinite(table.t).all()
    with pytest.raises(InputError, match="diameters of circles"):
        circles.at_sizes(110.0, 120.0)
    with pytest.raises(InputError, match="continuous in both"):
        circles.surface(110.0, 120.0)


def test_what_is_shown_runs_over_the_diameter(circles: Library) -> None:
    figure, axes = plt.subplots(1, 5)
    figures.phase_map(circles, axes[0], "x")
    figures.transmittance_map(circles, axes[1], "y")
    figures.error_map(circles, axes[2])
    figures.sensitivity_map(circles, axes[3], "x")
    figures.coverage(circles, axes[4])
    for each in axes[:4]:
        assert each.get_xlabel() == "diameter / nm"
        np.testing.assert_array_equal(each.lines[0].get_xdata(), DIAMETERS_NM)
        assert np.isfinite(each.lines[0].get_ydata()).all()
    plt.close(figure)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("length_nm = [100.0, 250.0]", "length_nm = [100.0, 200.0]", "both are the diameter"),
        ("[solver]", "[sweep.axes]\ncorner_radius_nm = [0.0, 10.0]\n[solver]", "not available for the shape 'circle'"),
    ],
)
def test_sweeps_that_are_no_circles_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = NITRIDE.read_text()
    assert old in text
    (tmp_path / "cell.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=said):
        load_unit_cell(tmp_path / "cell.toml")


def test_diameters_between_and_ellipses_are_solved(circles: Library) -> None:
    """Printed or measured pillars are no longer on the grid, and not quite round."""
    sizes_nm = np.array([[113.0, 113.0], [120.0, 120.0], [131.0, 127.5], [127.5, 131.0], [171.0, 171.0]])
    found = response_of_sizes(circles, sizes_nm)
    assert found.t_xx[1] == circles.at_sizes(120.0, 120.0).t_xx
    assert found.t_xx[2] == found.t_yy[3]
    for (width_nm, length_nm), t_xx in zip(sizes_nm, found.t_xx, strict=True):
        exact = solve(circles.pillar(width_nm, length_nm), CellNumerics(target_error=5e-4)).t[0, 0]
        assert abs(t_xx - exact) < 2e-3


@pytest.fixture
def two_circles(circles: Library) -> WrittenField:
    """Circles of 110 and 150 nm as rows 1 and 2 of the table."""
    lattice = Lattice(period_dbu=(800, 800), shape=(2, 2), database_unit_nm=0.5)
    size_dbu = np.array([[0, 0], [220, 220], [300, 300]], dtype=np.int32)
    index = np.array([[1, 2], [2, 1]], dtype=np.uint16)
    return written_field(PillarMap.from_array(lattice, size_dbu, index, 2), circles)


@pytest.mark.parametrize(("axis", "deviation"), [("cd_bias_nm", 10.0), ("cd_bias_nm", 3.0), ("height_nm", 15.0)])
def test_fabrication_corners_of_circles_are_those_of_their_cells(
    circles: Library, two_circles: WrittenField, axis: str, deviation: float
) -> None:
    corner = corner_fields(two_circles, circles, {axis: deviation})[1]
    for row, size_nm in ((1, 110.0), (2, 150.0)):
        at = {axis: circles.unit_cell.nominal(axis) + deviation}
        exact = solve(corner_cell(circles.unit_cell, size_nm, size_nm, at), CellNumerics(target_error=1e-3)).t[0, 0]
        nominal = solve(circles.pillar(size_nm, size_nm), CellNumerics(target_error=1e-3)).t[0, 0]
        assert corner.field.table[row, 0] / two_circles.table[row, 0] == pytest.approx(exact / nominal, abs=4e-3)


def test_a_slope_of_circles_is_compared_with_upright_walls_by_the_same_solver(
    circles: Library, two_circles: WrittenField
) -> None:
    """Staircases of RCWA are off by hundredths, alike with and without the slope: elements for one would add them."""
    sloped = corner_fields(two_circles, circles, {"sidewall_angle_deg": 0.01})[1]
    assert sloped.change < 2e-3
    assert np.abs(sloped.field.table[1:] / two_circles.table[1:] - 1.0).max() < 4e-3


def test_circles_have_axes_like_other_shapes(tmp_path: Path) -> None:
    """Wavelength and bias of a few diameters, by the model over diameter and axes, against the solver."""
    cell = load_unit_cell(NITRIDE)
    axes = Axes(wavelength_nm=(625.0, 641.0), cd_bias_nm=(-5.0, 5.0))
    sweep = replace(cell.sweep, width_nm=(120.0, 220.0), length_nm=(120.0, 220.0), size_grid_nm=20.0, axes=axes)
    asked = replace(cell, sweep=replace(sweep, target_error=2e-2))
    built = library.build(asked, numerics=BuildNumerics(corners=CornerNumerics(256, 24, 48)))
    library.save(built, tmp_path / "circles.h5")
    there = library.load(tmp_path / "circles.h5").at(wavelength_nm=638.0, cd_bias_nm=3.0)
    np.testing.assert_array_equal(there.known, np.eye(6, dtype=bool))
    for diameter_nm in (120.0, 180.0, 220.0):
        found = there.at_sizes(diameter_nm, diameter_nm)
        own = solve(
            pillar_cell(cell, diameter_nm + 3.0, diameter_nm + 3.0, wavelength_nm=638.0),
            CellNumerics(target_error=4e-3),
        )
        assert abs(found.t_xx - own.t[0, 0]) < found.error + own.error < 8e-2
        assert found.t_yy == pytest.approx(found.t_xx, abs=1e-9)
    with pytest.raises(InputError, match="625 to 641"):
        built.at(wavelength_nm=650.0)
