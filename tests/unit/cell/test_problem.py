"""From specs to cells, refusals, and solving many."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metafab.cell import CellNumerics, Slice, pillar_cell, solve, solve_many
from metafab.cell.problem import check
from metafab.core.errors import InputError
from metafab.core.parallel.executor import SerialExecutor
from metafab.library.library import inputs_of
from metafab.spec import UnitCell, canonical_toml, load_unit_cell


def test_cell_of_the_paper(unit_cell: UnitCell) -> None:
    cell = pillar_cell(unit_cell, 150.0, 210.0)
    assert cell.n_pillar == 3.6941 + 0.0065j
    assert cell.n_in == (1.7601, 1.7601)
    assert cell.n_out == (1.0, 1.0)
    assert pillar_cell(unit_cell, 150.0, 210.0, wavelength_nm=820.0).wavelength_nm == 820.0


def test_all_faults_of_a_cell_at_once(unit_cell: UnitCell) -> None:
    with pytest.raises(InputError) as caught:
        pillar_cell(unit_cell, 351.0, -1.0, angle_deg=90.0)
    assert [fault.field for fault in caught.value.faults] == ["width_nm", "length_nm", "angle_deg"]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"azimuth_deg": float("nan")}, "azimuth_deg"),
        ({"azimuth_deg": float("inf")}, "azimuth_deg"),
        ({"period_nm": (350.0, 0.0)}, "period_nm"),
        ({"period_nm": (float("inf"), 350.0)}, "period_nm"),
        ({"period_nm": (float("nan"), 350.0)}, "period_nm"),
        ({"side": "above"}, "side"),
        ({"sizes_at": "waist", "sidewall_angle_deg": 88.0}, "sizes_at"),
        ({"wavelength_nm": 1e-3}, "period_nm"),
    ],
)
def test_cells_without_meaning_name_their_one_fault(unit_cell: UnitCell, change: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        solve(replace(pillar_cell(unit_cell, 150.0, 210.0), **change))
    assert {fault.field for fault in caught.value.faults} == {field}


def test_300_wavelengths_squared_are_the_widest_cell(unit_cell: UnitCell) -> None:
    cell = pillar_cell(unit_cell, 150.0, 210.0)
    widest_nm = 300.0 * cell.wavelength_nm
    check(replace(cell, period_nm=(1.99 * widest_nm, 0.5 * widest_nm)))
    with pytest.raises(InputError, match="300 by 300 wavelengths"):
        check(replace(cell, period_nm=(2.01 * widest_nm, 0.5 * widest_nm)))


@pytest.mark.parametrize(
    ("numerics", "field"),
    [
        ({"solver": "fdfd"}, "solver"),
        ({"formulation": "laurent"}, "formulation"),
        ({"target_error": 0.0}, "target_error"),
        ({"target_error": 1.0}, "target_error"),
        ({"target_error": float("nan")}, "target_error"),
        ({"max_orders": 2}, "max_orders"),
    ],
)
def test_numerics_that_ask_for_nothing_known_are_refused(
    unit_cell: UnitCell, numerics: dict[str, Any], field: str
) -> None:
    with pytest.raises(InputError) as caught:
        solve(pillar_cell(unit_cell, 150.0, 210.0), CellNumerics(**numerics))
    assert [fault.field for fault in caught.value.faults] == [field]


def test_gain_is_refused(unit_cell: UnitCell) -> None:
    with pytest.raises(InputError, match="n_pillar"):
        solve(replace(pillar_cell(unit_cell, 150.0, 210.0), n_pillar=3.7 - 0.01j))


def test_anisotropic_substrate_gives_each_polarisation_its_index(unit_cell: UnitCell) -> None:
    cell = pillar_cell(unit_cell, 150.0, 210.0)
    mixed = solve(replace(cell, n_substrate=(1.7601, 1.7522)), CellNumerics(target_error=1e-2))
    ordinary, extraordinary = (
        solve(replace(cell, n_substrate=(n, n)), CellNumerics(target_error=1e-2)) for n in (1.7601, 1.7522)
    )
    assert abs(mixed.t[0, 0] - ordinary.t[0, 0]) <= 2e-2
    assert abs(mixed.t[1, 1] - extraordinary.t[1, 1]) <= 2e-2
    with pytest.raises(InputError, match="angle_deg"):
        solve(replace(cell, n_substrate=(1.7601, 1.7522), angle_deg=5.0))


def test_error_reached_or_confessed(unit_cell: UnitCell) -> None:
    cell = pillar_cell(unit_cell, 150.0, 210.0)
    reached = solve(cell, CellNumerics(target_error=1e-2))
    assert reached.converged
    assert reached.error <= 1e-2
    given_up = solve(cell, CellNumerics(target_error=1e-9, max_orders=5))
    assert not given_up.converged
    assert given_up.error > 1e-9


def test_many_cells_come_back_with_their_cells(unit_cell: UnitCell) -> None:
    cells = [pillar_cell(unit_cell, width, 150.0) for width in (100.0, 120.0, 140.0)]
    seen: list[float] = []
    responses = list(
        solve_many(
            cells, CellNumerics(target_error=1e-2), progress=lambda step, done, total: seen.append(done), batch=2
        )
    )
    assert {response.cell for response in responses} == set(cells)
    assert len(seen) == 2
    assert seen[-1] == 3
    for response in responses:
        np.testing.assert_array_equal(response.t, solve(response.cell, CellNumerics(target_error=1e-2)).t)


def test_equal_and_exchanged_cells_are_solved_once(unit_cell: UnitCell) -> None:
    film = (Slice(50.0, 1.45, 1.45), Slice(60.0, 2.0, 1.0, 140.0, 90.0))
    plain = [pillar_cell(unit_cell, *size_nm) for size_nm in ((110.0, 150.0), (150.0, 110.0), (110.0, 150.0))]
    lifted = replace(plain[0], period_nm=(350.0, 320.0), n_substrate=(1.76, 1.752), under=film)
    slanting = [replace(cell, angle_deg=10.0) for cell in plain[:2]]
    cells = [*plain, pillar_cell(unit_cell, 130.0, 130.0), lifted, lifted.exchanged(), *slanting]
    responses = list(solve_many(cells, CellNumerics(target_error=1e-2), SerialExecutor(), batch=3))
    assert Counter(response.cell for response in responses) == Counter(cells)
    # One answer in no time for each exchanged cell; an equal one is the same answer.
    assert sum(response.seconds == 0.0 for response in responses) == 2
    for response in responses:
        alone = solve(response.cell, CellNumerics(target_error=1e-2))
        np.testing.assert_allclose(response.t, alone.t, atol=1e-9)
        np.testing.assert_allclose(response.r, alone.r, atol=1e-9)
        np.testing.assert_allclose(response.transmittance, alone.transmittance, atol=1e-9)
        for name in ("transmitted_power_x", "reflected_power_y"):
            assert getattr(response.details, name) == pytest.approx(getattr(alone.details, name), abs=1e-9)
        assert response.error == pytest.approx(alone.error, rel=1e-4)
    with pytest.raises(ValueError, match="axes may be exchanged"):
        solve(slanting[0], CellNumerics(target_error=1e-2)).exchanged()


def test_slopes_leave_empty_cells_and_closed_axes_alone(unit_cell: UnitCell) -> None:
    cell = replace(pillar_cell(unit_cell, 150.0, 350.0), sidewall_angle_deg=85.0)
    assert cell.sizes_nm(0.5) == (150.0, 350.0)
    assert cell.sizes_nm(0.0) == pytest.approx((150.0 + 600.0 * np.tan(np.radians(5.0)), 350.0))
    assert replace(cell, width_nm=0.0, length_nm=0.0).sizes_nm(0.0) == (0.0, 0.0)


def test_the_slope_comes_from_the_file(unit_cell: UnitCell) -> None:
    sloped = replace(unit_cell, cell=replace(unit_cell.cell, sidewall_angle_deg=88.0, sizes_at="top"))
    cell = pillar_cell(sloped, 150.0, 210.0)
    assert cell.is_sloped
    assert cell.sizes_nm(1.0) == pytest.approx((150.0, 210.0))
    assert not pillar_cell(unit_cell, 150.0, 210.0).is_sloped
    # An unlit site of a layout is an empty cell, slopes or not.
    assert pillar_cell(sloped, 0.0, 0.0).n_in == (1.7601, 1.7601)
    with pytest.raises(InputError, match="from the pillar's bottom"):
        pillar_cell(sloped, 340.0, 210.0)


def test_a_unit_cell_that_asks_for_nothing_new_is_written_as_before(unit_cell: UnitCell) -> None:
    text = canonical_toml(unit_cell)
    assert not any(key in text for key in ("sidewall", "sizes_at", "n_z", "k_z"))


def test_caps_and_films_of_a_file_are_layers_of_its_cells(unit_cell: UnitCell, tmp_path: Path) -> None:
    plain_text = canonical_toml(unit_cell)
    assert "cap" not in plain_text
    assert "film" not in plain_text
    head, rest = plain_text.split("[materials", 1)
    layers = (
        "[[cell.cap]]\nheight_nm = 40.0\nmaterial = { n = 1.41 }\n"
        '[[cell.cap]]\nheight_nm = 5.0\nmaterial = "SiO2/Malitson"\n'
        "[[cell.film]]\nheight_nm = 100.0\nmaterial = { n = 1.33, k = 0.01 }\n"
    )
    path = tmp_path / "capped.toml"
    path.write_text(f"{head}{layers}[materials{rest}")
    capped = load_unit_cell(path)
    cell = pillar_cell(capped, 150.0, 210.0)
    assert cell.under == (Slice(100.0, 1.33 + 0.01j, 1.33 + 0.01j),)
    assert [layer.height_nm for layer in cell.over] == [40.0, 5.0]
    assert [layer.n_around for layer in cell.over] == [1.0, 1.0]
    assert cell.over[1].n_inside == pytest.approx(1.4533, abs=1e-3)
    # What a library is built from tells the two apart, and a copy holds all of it.
    assert inputs_of(capped) != inputs_of(unit_cell)
    path.write_text(canonical_toml(capped))
    assert load_unit_cell(path) == capped
    # They change the answer by more than both errors.
    bare = solve(pillar_cell(unit_cell, 150.0, 210.0), CellNumerics(target_error=1e-2))
    assert np.abs(solve(cell, CellNumerics(target_error=1e-2)).t - bare.t).max() > 2e-2


@pytest.mark.parametrize(
    "layer",
    [
        "height_nm = -1.0\nmaterial = { n = 1.41 }",
        "height_nm = 40.0\nmaterial = { n = 1.41, n_y = 1.5 }",
        'height_nm = 40.0\nmaterial = { n = 1.41 }\noutline = "closed"',
    ],
)
def test_impossible_layers_are_refused(unit_cell: UnitCell, tmp_path: Path, layer: str) -> None:
    head, rest = canonical_toml(unit_cell).split("[materials", 1)
    path = tmp_path / "bad.toml"
    path.write_text(f"{head}[[cell.cap]]\n{layer}\n[materials{rest}")
    with pytest.raises(InputError, match="cap"):
        load_unit_cell(path)


def test_a_unit_cell_in_place_of_a_pillar_is_told_how_to_make_one(unit_cell: UnitCell) -> None:
    with pytest.raises(InputError, match="`cell`: expected a PillarCell, got UnitCell; `pillar_cell` makes one"):
        solve(unit_cell)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="`numerics`: expected CellNumerics, got float"):
        solve(pillar_cell(unit_cell, 150.0, 160.0), 1e-3)  # type: ignore[arg-type]
