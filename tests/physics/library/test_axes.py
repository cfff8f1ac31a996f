"""A library with axes: each corner within what it states there, whatever the workers, and no byte for who asks none."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, CellResponse, PillarCell
from metafab.core.errors import InputError, SolverError
from metafab.library import Library
from metafab.library.store import statistics_json
from metafab.library.sweep.build import BuildNumerics
from metafab.library.sweep.corner_sampling import CornerNumerics
from metafab.spec import UnitCell
from metafab.spec.cell import Axes
from tests import library_ridges as ridges

#: The closed form is smooth here: rounds of a real build would spend their time on fits that it does not need.
SMALL = BuildNumerics(corners=CornerNumerics(sequence=2048, first_round=24))


@pytest.fixture(scope="module")
def plain(unit_cell: UnitCell) -> UnitCell:
    sweep = replace(unit_cell.sweep, width_nm=(100.0, 160.0), length_nm=(100.0, 160.0), size_grid_nm=5.0)
    return replace(unit_cell, sweep=sweep)


@pytest.fixture(scope="module")
def cell(plain: UnitCell) -> UnitCell:
    axes = Axes(wavelength_nm=(790.0, 810.0), cd_bias_nm=(-5.0, 5.0))
    return replace(plain, sweep=replace(plain.sweep, axes=axes))


@pytest.fixture(scope="module")
def built(cell: UnitCell) -> Library:
    return library.build(cell, solver=ridges.solve_scaled, numerics=SMALL)


def test_every_corner_is_within_its_stated_error(built: Library) -> None:
    """1200 sizes at 8 corners between and on the faces of the box, against the closed form itself."""
    rng = np.random.default_rng(5)
    inner = [(float(w), float(b)) for w, b in rng.uniform((790.0, -5.0), (810.0, 5.0), (6, 2))]
    for wavelength_nm, bias_nm in [*inner, (790.0, 5.0), (810.0, -5.0)]:
        width_nm, length_nm = rng.uniform(100.0, 160.0, (2, 150))
        held = library.evaluate(built, width_nm, length_nm, wavelength_nm=wavelength_nm, cd_bias_nm=bias_nm)
        made = 800.0 / wavelength_nm * (np.stack([width_nm, length_nm]) + bias_nm)
        true_x = np.array([ridges.amplitude(w, h) for w, h in made.T])
        true_y = np.array([ridges.amplitude(h, w) for w, h in made.T])
        error = np.maximum(np.abs(held.t_xx - true_x), np.abs(held.t_yy - true_y))
        assert np.all(error <= held.error), (wavelength_nm, bias_nm)
        assert error.max() <= built.unit_cell.sweep.target_error


def test_a_corner_is_a_library_of_its_own(built: Library) -> None:
    corner = built.at(wavelength_nm=807.0, cd_bias_nm=-3.0)
    assert corner.wavelength_nm[0] == corner.unit_cell.illumination.wavelength_nm == 807.0
    assert corner.inputs_sha256 != built.inputs_sha256
    assert (corner.pillar(120.0, 140.0).width_nm, corner.pillar(120.0, 140.0).wavelength_nm) == (117.0, 807.0)
    table = library.build_size_table(corner, database_unit_nm=0.5, cells=16)
    assert np.array_equal(table.t[1:, 0], corner.t_xx[0].ravel())
    judged = library.check(corner, samples=40, solver=ridges.solve_scaled)
    assert judged.verdict == "holds"
    nominal = library.check(corner, samples=40, solver=ridges.solve)
    assert nominal.verdict == "fails"  # the same sizes at 800 nm are other pillars


def test_the_units_own_corner_is_the_library_itself(built: Library) -> None:
    assert built.at() is built
    assert built.at(wavelength_nm=800.0, cd_bias_nm=0.0) is built


def test_exchange_holds_at_every_corner(built: Library) -> None:
    corner = built.at(wavelength_nm=793.0, cd_bias_nm=2.0)
    assert np.allclose(corner.t_yy[0], corner.t_xx[0].T, atol=1e-9)


def test_axes_leave_the_nominal_library_as_it_was(built: Library, plain: UnitCell) -> None:
    without = library.build(plain, solver=ridges.solve_scaled, numerics=SMALL)
    for name in ("t_xx", "t_yy", "r_xx", "r_yy", "error"):
        assert np.array_equal(getattr(built, name), getattr(without, name)), name
    assert without.corners is None
    assert not any(name.startswith("corner") for name in statistics_json(without))
    assert any(name.startswith("corner") for name in statistics_json(built))


def test_workers_and_kills_change_nothing(built: Library, cell: UnitCell, tmp_path: Path) -> None:
    """Killed among the corners, taken up again by three workers, saved and loaded: the same to the last bit."""
    checkpoint = tmp_path / "library.partial"
    lives = built.statistics.points_solved + 30
    with pytest.raises(SolverError, match="out of lives"):
        dying = ridges.DyingSolver(lives, ridges.solve_scaled)
        library.build(cell, solver=dying, checkpoint=checkpoint, numerics=SMALL)
    survivor = ridges.DyingSolver(10_000, ridges.solve_scaled)
    with ThreadPoolExecutor(3) as executor:
        again = library.build(cell, solver=survivor, checkpoint=checkpoint, executor=executor, numerics=SMALL)
    # A chunk of 4 goes down with the build.
    assert built.corners is not None
    total = built.statistics.points_solved + built.corners.statistics.points_solved
    assert total - lives <= survivor.calls <= total - lives + 4
    library.save(again, tmp_path / "library.h5")
    loaded = library.load(tmp_path / "library.h5")
    one, other = (each.at(wavelength_nm=806.0, cd_bias_nm=1.0) for each in (built, loaded))
    for name in ("t_xx", "t_yy", "r_xx", "r_yy", "error", "model_error"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert loaded.statistics == again.statistics
    assert loaded.corners is not None and again.corners is not None
    assert loaded.corners.statistics == again.corners.statistics
    assert library.is_current(tmp_path / "library.h5", cell) == (again.inputs_sha256 == loaded.inputs_sha256)


def test_corners_from_before_circles_had_axes_are_those_of_two_sizes(built: Library, tmp_path: Path) -> None:
    library.save(built, tmp_path / "old.h5")
    with h5py.File(tmp_path / "old.h5", "r+") as file:
        for model in (each for name, each in file["corners"].items() if name.startswith("model_")):
            del model.attrs["sizes"]
    there, here = (each.at(wavelength_nm=806.0) for each in (library.load(tmp_path / "old.h5"), built))
    assert np.array_equal(there.t_xx, here.t_xx)
    with h5py.File(tmp_path / "old.h5", "r+") as file:
        del file["corners/model_0"].attrs["axis_weight"]
    with pytest.raises(InputError, match="axis_weight"):
        library.load(tmp_path / "old.h5")


def test_a_bias_alone_is_no_variable_but_a_margin_of_the_sizes(plain: UnitCell) -> None:
    """Only widths and lengths matter then: the model of the wider sweep serves every bias."""
    cell = replace(plain, sweep=replace(plain.sweep, axes=Axes(cd_bias_nm=(-5.0, 5.0))))
    built = library.build(cell, solver=ridges.solve, numerics=SMALL)
    assert built.corners is not None
    assert built.corners.statistics.target == "reached"
    width_nm, length_nm = np.random.default_rng(8).uniform(100.0, 160.0, (2, 300))
    for bias_nm in (-5.0, 0.7, 5.0):
        held = library.evaluate(built, width_nm, length_nm, cd_bias_nm=bias_nm)
        true = np.array([ridges.amplitude(w + bias_nm, h + bias_nm) for w, h in zip(width_nm, length_nm, strict=True)])
        error = np.abs(held.t_xx - true)
        assert np.all(error <= held.error), bias_nm
        assert error.max() <= built.unit_cell.sweep.target_error


def test_an_axis_out_of_reach_ends_and_says_so(cell: UnitCell) -> None:
    """A response that jumps from cell to cell away from 800 nm: no model can hold, and the errors say how far off."""

    def jumping(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        answer = ridges.solve_scaled(cell, numerics)
        if cell.wavelength_nm == 800.0:
            return answer
        jump = 0.05 if int(1e6 * cell.wavelength_nm) % 2 else -0.05
        return replace(answer, t=answer.t + jump * np.eye(2))

    few = BuildNumerics(corners=replace(SMALL.corners, most_cells=40))
    built = library.build(cell, solver=jumping, numerics=few)
    assert built.corners is not None
    most = 40 * 3  # width, length and wavelength
    assert most <= built.corners.statistics.points_solved <= 1.5 * most
    assert built.corners.statistics.target.startswith("not reached in")
    assert built.at(wavelength_nm=795.0).error.min() > 0.02
    assert built.error.max() <= built.unit_cell.sweep.target_error
