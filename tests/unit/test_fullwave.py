"""Pieces of a written mask for full-wave solvers: what is cut out, what is compared, what is kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import fullwave
from metafab.cell.meep import SupercellSettings
from metafab.cell.rcwa.row import RowNumerics
from metafab.core.errors import InputError, SolverError
from metafab.fullwave.coupling import CouplingRow
from metafab.fullwave.patch import differences
from metafab.fullwave.written import library_responses, sizes_at
from metafab.layout import Lattice, PillarMap
from metafab.library import Library
from tests.fake_meep import UncoupledPillars, response

#: Sites along x repeat after 7, so that a local period is known; along y all are alike.
PERIOD_SITES = 7
LATTICE = Lattice((700, 700), (60, 80), 0.5)
QUICK = SupercellSettings(pixels_per_period=8, decay=1e-2)


@pytest.fixture(scope="module")
def pillars() -> PillarMap:
    """Widths that rise by 20 nm from site to site over each period; lengths fall by 10 nm."""
    step = np.arange(PERIOD_SITES)
    sizes = np.concatenate([[[0, 0]], 2 * np.stack([110 + 20 * step, 200 - 10 * step], axis=-1)])
    index = np.tile((np.arange(80) % PERIOD_SITES + 1).astype(np.uint16), (60, 1))
    return PillarMap.from_array(LATTICE, sizes.astype(np.int32), index, 16)


@pytest.fixture(scope="module")
def ramp_library(smooth_library: Library) -> Library:
    """x light sees a phase that rises by a seventh of a turn with every 20 nm of width; y light one that falls."""
    phase = 2.0 * np.pi * (smooth_library.width_nm - 110.0) / 20.0 / PERIOD_SITES
    t_xx = np.broadcast_to(0.9 * np.exp(1j * phase), smooth_library.t_xx.shape)
    return replace(smooth_library, t_xx=t_xx, t_yy=t_xx.conj())


def test_a_block_holds_the_pillars_of_its_sites_across_tiles(pillars: PillarMap) -> None:
    whole = pillars.size_nm()[pillars.to_array()]
    np.testing.assert_array_equal(sizes_at(pillars, 10, 13, (9, 24)), whole[10:19, 13:37])


def test_beyond_the_lens_there_are_no_pillars(pillars: PillarMap) -> None:
    block = sizes_at(pillars, -2, 75, (5, 8))
    assert np.all(block[:2] == 0.0)
    assert np.all(block[:, 5:] == 0.0)
    assert np.all(block[2:, :5] > 0.0)


def test_a_place_is_the_middle_of_its_block(pillars: PillarMap, ramp_library: Library) -> None:
    supercell, x_um, y_um = fullwave.supercell_at(pillars, ramp_library, 2.0, -4.0, (3, 5))
    assert supercell.shape == (3, 5)
    assert abs(x_um[2] - 2.0) <= 0.175
    assert abs(y_um[1] + 4.0) <= 0.175
    column = int(np.argmin(np.abs(LATTICE.x_um() - x_um[0])))
    np.testing.assert_allclose(LATTICE.x_um()[column : column + 5], x_um, atol=1e-12)
    row = int(np.argmin(np.abs(LATTICE.y_um() - y_um[0])))
    np.testing.assert_array_equal(supercell.size_nm, sizes_at(pillars, row, column, (3, 5)))
    assert supercell.cell.n_pillar.real == pytest.approx(3.6941)
    with pytest.raises(InputError, match="x_um"):
        fullwave.supercell_at(pillars, ramp_library, 20.0, 0.0, (3, 3))


def test_responses_are_the_librarys_and_dark_where_no_pillar_stands(pillars: PillarMap, ramp_library: Library) -> None:
    supercell = fullwave.supercell_at(pillars, ramp_library, 13.9, 0.0, (2, 9))[0]
    responses = library_responses(supercell, ramp_library)
    gaps = np.all(supercell.size_nm == 0.0, axis=-1)
    assert gaps.any() and not gaps.all()
    assert np.all(responses[:, gaps] == 0.0)
    stored = ramp_library.at_sizes(*supercell.size_nm[~gaps].T)
    np.testing.assert_array_equal(responses[:, ~gaps], [stored.t_xx, stored.t_yy])


@pytest.mark.parametrize("sites", [3.0, 7.0, 12.4, 24.6])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_ramp_tells_its_period_and_direction(sites: float, sign: int) -> None:
    ramp = np.exp(2j * np.pi * sign * np.arange(64) / sites)
    assert fullwave.local_period_sites(ramp) == (round(sites), sign)
    # An amplitude that varies with the same period, as resonant pillars make it, does not mislead it.
    assert fullwave.local_period_sites(ramp * (1.0 + 0.4 * np.cos(2 * np.pi * np.arange(64) / sites)))[1] == sign


@pytest.mark.parametrize("sites", [np.inf, 90.0])
def test_a_phase_that_hardly_changes_has_no_local_period(sites: float) -> None:
    with pytest.raises(InputError, match="local period"):
        fullwave.local_period_sites(np.exp(2j * np.pi * np.arange(64) / sites))


def test_pillars_that_do_not_couple_are_found_not_to(pillars: PillarMap, ramp_library: Library) -> None:
    pool = UncoupledPillars()
    found = fullwave.measure_coupling(
        pillars, ramp_library, [(0.0, 0.0), (3.0, 2.0)], "mask", solvers=("meep",), meep=QUICK, pool=pool
    )
    assert [(row.x_um, row.polarisation, row.sites, row.order) for row in found.rows] == [
        (0.0, "x", 7, 1), (0.0, "y", 7, -1), (3.0, "x", 7, 1), (3.0, "y", 7, -1)
    ]  # fmt: skip
    for row in found.rows:
        assert row.coupling_error < 1e-12
        assert row.efficiency == pytest.approx(row.local_period_efficiency)
        assert row.angle_deg == pytest.approx(np.degrees(np.arcsin(0.8 / (7 * 0.35))))
    assert found.efficiency_ratio == pytest.approx(1.0)


def test_planted_coupling_is_found(pillars: PillarMap, ramp_library: Library) -> None:
    pool = UncoupledPillars({(1, 0): 0.03, (-2, 0): 0.04j})
    found = fullwave.measure_coupling(
        pillars, ramp_library, [(0.0, 0.0)], "mask", solvers=("meep",), polarisations=("x",), meep=QUICK, pool=pool
    )
    row = found.rows[0]
    assert row.wanted_error == pytest.approx(0.03)
    sizes = np.stack([110.0 + 20.0 * np.arange(7), 200.0 - 10.0 * np.arange(7)], axis=-1)
    own = np.array([response(*size) for size in sizes])
    # All seven orders propagate but the outermost two: 7 x 350 nm are 3.06 wavelengths.
    assert row.coupling_error == pytest.approx(0.05 / np.sqrt(np.mean(np.abs(own) ** 2)), rel=1e-3)
    assert found.coupling_error == row.coupling_error


def test_rows_along_y_are_the_same_rows_turned(pillars: PillarMap, ramp_library: Library) -> None:
    """The turned mask under turned light, by RCWA: the same figures."""
    numerics = RowNumerics((1, 2), (2, 3))
    turned = PillarMap.from_array(
        Lattice((700, 700), (80, 60), 0.5),
        np.ascontiguousarray(pillars.size_dbu[:, ::-1]),
        np.ascontiguousarray(pillars.to_array().T),
        16,
    )
    swapped = replace(
        ramp_library,
        width_nm=ramp_library.length_nm,
        length_nm=ramp_library.width_nm,
        t_xx=ramp_library.t_yy.transpose(0, 2, 1),
        t_yy=ramp_library.t_xx.transpose(0, 2, 1),
    )
    along_x = fullwave.measure_coupling(
        pillars, ramp_library, [(0.0, 0.0)], "", polarisations=("x",), rcwa=numerics
    ).rows[0]
    along_y = fullwave.measure_coupling(
        turned, swapped, [(0.0, 0.0)], "", axis="y", polarisations=("y",), rcwa=numerics
    ).rows[0]
    assert (along_y.sites, along_y.order) == (along_x.sites, along_x.order)
    assert along_y.efficiency == pytest.approx(along_x.efficiency, rel=1e-9)
    assert along_y.coupling_error == pytest.approx(along_x.coupling_error, rel=1e-9)
    assert along_x.coupling_error > 1e-3


def test_what_was_measured_is_kept(tmp_path: Path) -> None:
    row = CouplingRow(600.0, 0.0, "x", "y", "rcwa", 21, 1, 6.2, 0.8, 0.9, 0.03, 0.12, 0.01, 2.0)
    kept = fullwave.Coupling("abc", (row, replace(row, polarisation="x", coupling_error=0.16, efficiency=0.7)))
    path = tmp_path / "coupling.json"
    fullwave.save_coupling(kept, path)
    assert fullwave.load_coupling(path) == kept
    assert json.loads(path.read_text())["coupling_error"] == pytest.approx(np.sqrt((0.12**2 + 0.16**2) / 2.0))
    assert kept.efficiency_ratio == pytest.approx(1.5 / 1.8)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"kind": "metafab coupling", "format_version": 99, "rows": []}'])
def test_what_is_no_record_is_none(tmp_path: Path, text: str) -> None:
    path = tmp_path / "coupling.json"
    assert fullwave.load_coupling(path) is None
    path.write_text(text)
    assert fullwave.load_coupling(path) is None


def test_a_patch_without_coupling_is_stitched_from_its_pillars(pillars: PillarMap, ramp_library: Library) -> None:
    plan = fullwave.plan_patch(pillars, ramp_library, (1.0, -2.0), 1.75, padding_sites=2, settings=QUICK)
    assert plan.supercell.shape == (9, 9)
    patch = fullwave.solve_patch(plan, ramp_library, "y", UncoupledPillars())
    assert patch.full_wave.shape == (5, 5)
    np.testing.assert_allclose(patch.x_um, plan.x_um[2:-2])
    np.testing.assert_allclose(patch.full_wave, patch.alone, atol=1e-12)
    figures = patch.figures()
    assert figures["coupling_relative_l2"] < 1e-12
    # The fake's pillars are not the library's: the difference is all the grid's.
    assert figures["grid_relative_l2"] == pytest.approx(figures["relative_l2"])
    assert figures["relative_l2"] > 0.1


def test_planted_coupling_of_a_patch_is_found(pillars: PillarMap, ramp_library: Library) -> None:
    plan = fullwave.plan_patch(pillars, ramp_library, (1.0, -2.0), 1.75, padding_sites=2, settings=QUICK)
    patch = fullwave.solve_patch(plan, ramp_library, "x", UncoupledPillars({(0, 0): 0.1}))
    np.testing.assert_allclose(patch.full_wave - patch.alone, 0.1, atol=1e-12)
    scale = np.sqrt(np.mean(np.abs(patch.alone) ** 2))
    assert patch.figures()["coupling_relative_l2"] == pytest.approx(0.1 / scale)


def test_a_patch_that_does_not_settle_has_no_field(pillars: PillarMap, ramp_library: Library) -> None:
    plan = fullwave.plan_patch(pillars, ramp_library, (1.0, -2.0), 1.05, padding_sites=0, settings=QUICK)
    with pytest.raises(SolverError, match="longest_periods"):
        fullwave.solve_patch(plan, ramp_library, "x", UncoupledPillars(tail=np.inf))


def test_waves_that_do_not_travel_are_left_out_of_both_fields(pillars: PillarMap, ramp_library: Library) -> None:
    """Sites of 350 nm under 800 nm: about two thirds of a block's orders travel."""
    plan = fullwave.plan_patch(pillars, ramp_library, (0.0, 0.0), 2.45, padding_sites=0, settings=QUICK)
    patch = fullwave.solve_patch(plan, ramp_library, "x", UncoupledPillars())
    stored = library_responses(plan.supercell, ramp_library)[0]
    # This library is one wave, order +1 of the block: it is all there.
    np.testing.assert_allclose(patch.library, stored, atol=1e-12)
    spectrum = np.fft.fft2(patch.full_wave)
    m, n = np.meshgrid(np.fft.fftfreq(7) / 0.35, np.fft.fftfreq(7) / 0.35)
    assert np.abs(spectrum[np.hypot(m, n) >= 1.0 / 0.8]).max() < 1e-10
    assert np.abs(spectrum[np.hypot(m, n) < 1.0 / 0.8]).max() > 1.0


def test_differences_of_fields_are_what_they_say() -> None:
    rng = np.random.default_rng(3)
    field = rng.normal(size=(40, 40)) + 1j * rng.normal(size=(40, 40))
    turned = field * np.exp(0.7j)
    assert differences(turned, field)[:3] == pytest.approx((0.0, 0.0, 0.7), abs=1e-7)
    amplitude, phase, offset, relative = differences(1.1 * field, field)
    assert (phase, offset) == pytest.approx((0.0, 0.0), abs=1e-7)
    assert amplitude == pytest.approx(0.1)
    assert relative == pytest.approx(0.1)
    jitter = rng.normal(scale=0.05, size=field.shape)
    assert differences(field * np.exp(1j * jitter), field)[1] == pytest.approx(0.05, rel=0.1)


def test_a_larger_or_finer_patch_is_foreseen_to_take_more(pillars: PillarMap, ramp_library: Library) -> None:
    small, large, fine = (
        fullwave.plan_patch(pillars, ramp_library, (0.0, 0.0), size, settings=SupercellSettings(pixels))
        for size, pixels in ((1.05, 8), (2.1, 8), (1.05, 16))
    )
    assert large.pixels == pytest.approx(small.pixels * (12 / 9) ** 2, rel=1e-6)
    assert large.memory_mb > small.memory_mb
    # Eight times the pixels (absorbers are counted in wavelengths), twice the steps.
    assert 10.0 < fine.seconds / small.seconds < 20.0


@pytest.mark.parametrize(("at_um", "size_um", "field"), [((0.0, 0.0), 0.1, "size_um"), ((0.0, 99.0), 1.0, "y_um")])
def test_patches_that_are_none_are_refused(
    pillars: PillarMap, ramp_library: Library, at_um: tuple[float, float], size_um: float, field: str
) -> None:
    with pytest.raises(InputError, match=field):
        fullwave.plan_patch(pillars, ramp_library, at_um, size_um)


def test_a_place_without_pillars_is_refused(pillars: PillarMap, ramp_library: Library) -> None:
    bare = replace(pillars, tiles=lambda: iter(()))
    with pytest.raises(InputError, match="pillars"):
        fullwave.plan_patch(bare, ramp_library, (0.0, 0.0), 1.0)


def test_a_patch_survives_its_file(pillars: PillarMap, ramp_library: Library, tmp_path: Path) -> None:
    plan = fullwave.plan_patch(pillars, ramp_library, (1.0, -2.0), 1.75, padding_sites=1, settings=QUICK)
    patch = fullwave.solve_patch(plan, ramp_library, "y", UncoupledPillars({(0, 1): 0.1j}))
    path = tmp_path / "patch.h5"
    fullwave.save_patch(patch, path, inputs_sha256="abc")
    back = fullwave.load_patch(path)
    for name in ("x_um", "y_um", "full_wave", "library", "alone"):
        np.testing.assert_array_equal(getattr(back, name), getattr(patch, name))
    assert back.figures() == patch.figures()
    assert (back.polarisation, back.padding_sites, back.pixels_per_period) == ("y", 1, 8)
    with pytest.raises(InputError, match="nothing at that path"):
        fullwave.load_patch(tmp_path / "none.h5")
