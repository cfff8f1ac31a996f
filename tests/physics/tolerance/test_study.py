"""Corners from few solved cells against all cells solved, and the table: depths read by a decoder, workers, files."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library
from metafab.cell.rcwa import zero_order
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import open_executor
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.axes import corner_cell
from metafab.library.library import Library
from metafab.library.use.any_size import solved_amplitudes
from metafab.optics import PsfNumerics, WrittenField, ideal_field, psf, relative_l2, written_field
from metafab.optics.measures.focus import LensFocus, PerfectLens, focus
from metafab.spec import Device, UnitCell
from metafab.spec.design import Tolerances
from metafab.tolerance import ToleranceTable, corner_fields, load_tolerance, save_tolerance, tolerance_table
from metafab.tolerance.corners import SLICE_CHECKS, MaskSizes, slice_error
from metafab.tolerance.mask_light import Light, MaskOptics, PsfConditions
from metafab.tolerance.reference import DepthDecoder, Reference
from metafab.tolerance.scatter import Stitched
from metafab.tolerance.study import require_block_memory
from tests import optics_lens as lens

OPTICS = lens.imaging()
DEPTHS_M = (0.84e-3, 0.88e-3, 0.92e-3)


@pytest.fixture(scope="module")
def small_library(unit_cell: UnitCell) -> Library:
    """49 sizes of the paper's cell, away from its sharpest resonances."""
    sweep = replace(
        unit_cell.sweep, width_nm=(100.0, 160.0), length_nm=(100.0, 160.0), size_grid_nm=10.0, target_error=1e-2
    )
    return library.build(replace(unit_cell, sweep=sweep))


@pytest.fixture(scope="module")
def written(small_library: Library) -> WrittenField:
    """A helix pair of these sizes: each site takes the size whose t_xx and t_yy suit it best."""
    width, length = (a.ravel() for a in np.meshgrid(small_library.width_nm, small_library.length_nm))
    sizes = np.concatenate([[(0, 0)], np.stack([2 * width, 2 * length], axis=1).round().astype(int)]).astype(np.int32)
    source = lens.ideal(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    lattice: Lattice = source.lattice
    x, y = lattice.x_um(), lattice.y_um()
    wanted = np.exp(-1j * source.profile(x, y))
    t = np.stack([small_library.t_xx[0].ravel(), small_library.t_yy[0].ravel()])
    overlap = np.stack([(wanted * t[:, k, None, None]).real.sum(axis=0) for k in range(width.size)])
    inside = np.hypot(x[None, :], y[:, None]) <= 0.5 * OPTICS.aperture_um
    index = np.where(inside, 1 + overlap.argmax(axis=0), 0).astype(np.uint16)
    return written_field(PillarMap.from_array(lattice, sizes, index, 50), small_library)


@pytest.mark.parametrize(
    ("axis", "deviation", "bound"),
    # So coarse a library knows little between its sizes, and says so.
    [("height_nm", 10.0, 0.1), ("pillar_n_shift", 0.0135, 0.1), ("cd_bias_nm", 6.0, 1.0)],
)
def test_few_cells_tell_all(
    written: WrittenField, small_library: Library, axis: str, deviation: float, bound: float
) -> None:
    """Against each size solved one by one; the stated error is of the size of the true one.

    The mask has fewer sizes than a sample: all are solved but those that a bias leaves within the sweep. The fit to a
    sample is tested in ``test_corner_fit.py``.
    """
    unit_cell = small_library.unit_cell
    corner = corner_fields(written, small_library, {axis: deviation})[1]
    counts = np.bincount(written.pillars.to_array().ravel(), minlength=len(written.table))
    used = np.flatnonzero(counts[1:]) + 1
    assert corner.solved < 2 * used.size
    value = unit_cell.nominal(axis) + deviation
    true = np.array(
        [
            np.diagonal(zero_order(corner_cell(unit_cell, float(w), float(h), {axis: value}), 5).t)
            for w, h in written.pillars.size_nm()[used]
        ]
    ) * math.sqrt(1.0 / 1.7601)
    weight = counts[used][:, None]
    power = np.sum(weight * np.abs(true) ** 2)
    missed = math.sqrt(np.sum(weight * np.abs(corner.field.table[used] - true) ** 2) / power)
    assert missed < 3.0 * corner.error + 3e-3
    assert corner.error < bound * corner.change + 3e-3


def test_sloped_walls_of_circles_leave_the_other_corners_to_spectral_elements(unit_cell: UnitCell) -> None:
    """Sloped circles have RCWA alone; solved with them, upright ones of silicon were off by up to 1.3.

    One bar counts the cells of both solvers.
    """
    sweep = replace(
        unit_cell.sweep, width_nm=(100.0, 180.0), length_nm=(100.0, 180.0), size_grid_nm=40.0, target_error=2e-2
    )
    circles = library.build(replace(unit_cell, cell=replace(unit_cell.cell, shape="circle"), sweep=sweep))
    sizes = np.array([(0, 0), (200, 200), (280, 280), (360, 360)], dtype=np.int32)
    index = np.array([[1, 2], [3, 1]], dtype=np.uint16)
    mask = written_field(
        PillarMap.from_array(Lattice(period_dbu=(700, 700), shape=(2, 2), database_unit_nm=0.5), sizes, index, 50),
        circles,
    )
    upright = corner_fields(mask, circles, {"height_nm": 10.0})
    reported: list[tuple[float, float]] = []
    *among, narrow, wide = corner_fields(
        mask,
        circles,
        {"height_nm": 10.0, "sidewall_angle_deg": 1.0},
        progress=lambda step, done, total: reported.append((done, total)),
    )
    assert [done for done, _ in reported] == list(range(1, len(reported) + 1))
    assert {total for _, total in reported} == {len(reported)}
    for one, other in zip(upright, among, strict=True):
        assert np.array_equal(one.field.table, other.field.table)
        assert one.error == 1e-3
    assert min(narrow.error, wide.error) > 1e-3


def test_corners_of_slanting_light_are_solved_in_it(small_library: Library) -> None:
    """Two sizes, each other's mirror images: with all sizes solved, the field changes as the solved amplitudes do."""
    slanting = replace(small_library, corner={"angle_x_deg": 20.0})
    sizes = np.array([[0, 0], [240, 300], [300, 240]], dtype=np.int32)
    index = np.array([[1, 2], [2, 1]], dtype=np.uint16)
    pillars = PillarMap.from_array(Lattice(period_dbu=(700, 700), shape=(2, 2), database_unit_nm=0.5), sizes, index, 50)
    taller = corner_fields(written_field(pillars, slanting), slanting, {"height_nm": 10.0})[1]
    tasks = [
        (corner_cell(small_library.unit_cell, *size, {"angle_x_deg": 20.0, **corner}), 8)
        for corner in ({}, {"height_nm": small_library.unit_cell.cell.height_nm + 10.0})
        for size in ((120.0, 150.0), (150.0, 120.0))
    ]
    before, after = solved_amplitudes(tasks).reshape(2, 2, 2)
    own = written_field(pillars, slanting).table
    np.testing.assert_allclose(taller.field.table[1:] / own[1:], after / before, rtol=1e-12)
    assert np.abs(after[0, 0] / before[0, 0] - after[1, 1] / before[1, 1]) > 1e-3


@pytest.fixture(scope="module")
def table(written: WrittenField, small_library: Library) -> ToleranceTable:
    asked = Tolerances(cd_bias_nm=4.0, sidewall_deg=0.0, stitching_nm=20.0, draws=6)
    return tolerance_table(
        written, small_library, asked, PsfConditions(OPTICS, DEPTHS_M, PsfNumerics(window_px=48)), 50
    )


def test_the_mask_itself_changes_nothing(table: ToleranceTable) -> None:
    own = table.nominal
    assert (own.change, own.peak_ratio, own.efficiency_change, own.turn_deg, own.depth_error_m) == (0, 1, 0, 0, 0)
    assert table.error <= 1e-3


def test_every_corner_has_its_row(table: ToleranceTable) -> None:
    assert [row.corner for row in table.rows] == [
        "cd_bias_nm -4", "cd_bias_nm +4", "height_nm -10", "height_nm +10", "pillar_n_shift -0.0135",
        "pillar_n_shift +0.0135", "misplacement 10 nm rms", "stitching 20 nm rms", "missing 1 per mille",
    ]  # fmt: skip
    rows = {row.corner: row for row in table.rows}
    assert rows["cd_bias_nm +4"].change > 3.0 * rows["pillar_n_shift +0.0135"].change
    assert rows["missing 1 per mille"].efficiency_change < 0.01
    assert all(row.draws == (6 if "rms" in row.corner or "per" in row.corner else 0) for row in table.rows)
    assert all(0.0 < row.relative_error < 0.5 for row in table.rows if not row.corner.startswith("cd_bias"))
    assert all(math.isfinite(row.depth_error_m) for row in table.rows)


def test_a_depth_is_what_the_twins_agree_on(written: WrittenField) -> None:
    """A mask whose PSFs are those of another depth: the decoder that knows the nominal ones says that depth."""
    numerics = PsfNumerics(window_px=48, target_error=1e-3)
    optics, pupils, _ = MaskOptics.of(written, PsfConditions(OPTICS, DEPTHS_M, numerics))
    there = [0.85e-3, 0.9e-3, 0.91e-3]
    pair = psf(written, OPTICS, there, numerics).psf
    assert DepthDecoder.of(optics, pupils).depth_m(pair) == pytest.approx(there, rel=1e-3)


def test_slices_of_a_sloped_wall_err_by_no_more_than_is_said(written: WrittenField, small_library: Library) -> None:
    """Against walls of four times the slices, whose error is an eighth or less."""
    sizes = MaskSizes.of(written, small_library)
    sample = sizes.size_nm[sizes.sample[:SLICE_CHECKS]]
    for slope in (-2.0, 2.0):
        at = {"sidewall_angle_deg": small_library.unit_cell.nominal("sidewall_angle_deg") + slope}
        cells = [corner_cell(small_library.unit_cell, float(w), float(h), at) for w, h in sample]
        coarse, fine, finest = (solved_amplitudes([(cell, slices) for cell in cells]) for slices in (4, 8, 32))
        before = np.ones_like(fine)
        stated = slice_error(before, fine, coarse)
        true = float(np.linalg.norm(fine - finest) / np.linalg.norm(before))
        assert true <= stated < 5.0 * true


@pytest.mark.slow
def test_workers_change_nothing(written: WrittenField, small_library: Library) -> None:
    asked = {"height_nm": 10.0}
    here = corner_fields(written, small_library, asked)
    with open_executor(2) as executor:
        there = corner_fields(written, small_library, asked, executor=executor)
    assert all(np.array_equal(a.field.table, b.field.table) for a, b in zip(here, there, strict=True))


def test_one_field_is_not_stitched(written: WrittenField, small_library: Library) -> None:
    none = Tolerances(cd_bias_nm=0.0, height_nm=0.0, sidewall_deg=0.0, pillar_n=0.0, missing_share=0.0, draws=2)
    conditions = PsfConditions(OPTICS, DEPTHS_M[:1], PsfNumerics(window_px=32))
    table = tolerance_table(written, small_library, none, conditions, 5000)
    assert [row.corner for row in table.rows] == ["misplacement 10 nm rms"]


def test_write_fields_that_no_block_divides_are_refused(written: WrittenField) -> None:
    """A prime number of sites leaves blocks of one site, as many as pillars: more than this small memory holds."""
    rows, columns = written.lattice.shape
    stitched = [Stitched(OPTICS, 30.0, sites, written.lattice) for sites in (80, 83)]
    require_block_memory(stitched[:1], written, 16, most_blocks=rows * columns - 1)
    with pytest.raises(InputError, match=r"`mask\.write_field_um`.* blocks of 1 sites"):
        require_block_memory(stitched, written, 16, most_blocks=rows * columns - 1)


def test_the_table_comes_back_from_its_file(table: ToleranceTable, tmp_path: Path) -> None:
    path = tmp_path / "tolerance.json"
    blind = replace(table, rows=(replace(table.rows[0], depth_error_m=math.nan), *table.rows[1:]))
    save_tolerance(blind, path, mask_sha256="0123")
    found = load_tolerance(path)
    assert found is not None and found[1] == "0123"
    assert repr(found[0].rows[1:]) == repr(table.rows[1:]) and math.isnan(found[0].rows[0].depth_error_m)
    assert repr(found[0].nominal) == repr(table.nominal)
    path.write_text('{"kind": "something else"}', encoding="utf-8")
    assert load_tolerance(path) is None and load_tolerance(tmp_path / "none.json") is None


def _light(pair: FloatArray) -> Light:
    return Light(pair, np.full(pair.shape[1], 1e-3), 1.0)


def test_draws_keep_the_sign_of_what_they_lose_and_say_what_they_cannot_tell() -> None:
    """Missing pillars only lose light: two draws that lose 0.02 and 0.04 lose 0.03; below the error, rows say so."""
    pair = np.ones((2, 1, 8, 8)) / 64.0
    decoder = DepthDecoder(np.linspace(0.9e-3, 0.8e-3, 5), np.ones((2, 5, 8, 5)) + 0j)
    reference = Reference(_light(pair), (0.85e-3,), decoder, np.array([0.85e-3]), 0.03)
    row = reference.row("missing", [_light(0.98 * pair), _light(0.96 * pair)], 0.1)
    assert row.efficiency_change == pytest.approx(-0.03)
    assert row.change == pytest.approx(math.sqrt((0.02**2 + 0.04**2) / 2.0)) and not row.below_error
    assert reference.row("missing", [_light(0.98 * pair)], 0.1).below_error


def test_an_infinite_number_comes_back_from_the_file(table: ToleranceTable, tmp_path: Path) -> None:
    far = replace(table, depth_m=np.array([1.0, math.inf]), nominal=replace(table.nominal, extinction_ratio=math.inf))
    save_tolerance(far, tmp_path / "tolerance.json", mask_sha256="0123")
    found = load_tolerance(tmp_path / "tolerance.json")
    assert found is not None
    assert repr(found[0].nominal) == repr(far.nominal) and found[0].depth_m.tolist() == [1.0, math.inf]


def test_a_table_reaches_to_infinity(written: WrittenField, small_library: Library) -> None:
    """The depth error is of the finite depths."""
    none = {"cd_bias_nm": 0.0, "height_nm": 0.0, "sidewall_deg": 0.0, "pillar_n": 0.0, "misplacement_nm": 0.0}
    asked = Tolerances(**none, stitching_nm=0.0, missing_share=1e-3, draws=2)
    conditions = PsfConditions(OPTICS, (0.84e-3, 0.9e-3, math.inf), PsfNumerics(window_px=48))
    found = tolerance_table(written, small_library, asked, conditions, 5000)
    assert math.isfinite(found.rows[0].change) and found.depth_m[-1] == math.inf


def test_a_filter_smears_the_light_of_the_table(written: WrittenField) -> None:
    """The table compares the pair that :func:`psf` gives behind the same filter, not that of one wavelength."""
    one_wavelength = PsfNumerics(window_px=16, target_error=1e-3)
    filtered = replace(one_wavelength, filter_fwhm_nm=30.0)
    optics, pupils, _ = MaskOptics.of(written, PsfConditions(OPTICS, (0.88e-3,), filtered))
    one, band = (psf(written, OPTICS, [0.88e-3], numerics) for numerics in (one_wavelength, filtered))
    light = optics.light(pupils)
    assert relative_l2(light.pair, band.psf) < 2.0 * filtered.target_error
    assert relative_l2(light.pair, one.psf) > 10.0 * filtered.target_error


def test_one_window_has_neither_extinction_nor_depth_nor_turn(written: WrittenField) -> None:
    """A lens on its axis: noise used to stand in these columns."""
    alone = lens.imaging(split_angle_deg=0.0)
    device = Device(aperture_um=alone.aperture_um, focal_length_mm=alone.focal_length_mm)
    perfect = ideal_field(PerfectLens(alone, DEPTHS_M[1]), written.lattice, device)
    optics, pupils, error = MaskOptics.of(perfect, PsfConditions(alone, DEPTHS_M, PsfNumerics(window_px=48)))
    reference = Reference.of(optics, pupils, error)
    row = reference.row("nominal", [reference.nominal], 0.0)
    assert all(math.isnan(value) for value in (row.extinction_ratio, row.depth_error_m, row.turn_deg))
    assert (row.change, row.peak_ratio) == (0.0, 1.0)
    assert all(math.isnan(value) for value in (row.fwhm_x_um, row.fwhm_y_um, row.strehl))


def test_the_focus_of_a_lens_at_a_corner_is_that_of_its_own_measurement(written: WrittenField) -> None:
    """Block sums of the table against whole stacks: spherical aberration of a quarter of a wave at the rim, and x only.

    Both are computed to 1e-3.
    """
    alone, lattice = lens.imaging(split_angle_deg=0.0), written.lattice
    device = Device(aperture_um=alone.aperture_um, focal_length_mm=alone.focal_length_mm)
    perfect = ideal_field(PerfectLens(alone, DEPTHS_M[1]), lattice, device)
    aberrated = ideal_field(_Aberrated(alone, DEPTHS_M[1]), lattice, device)
    for polarisations in ((0, 1), (0,)):
        of = LensFocus(perfect, DEPTHS_M[1], polarisations)
        conditions = PsfConditions(alone, DEPTHS_M, PsfNumerics(window_px=48), lens=of)
        optics, pupils, error = MaskOptics.of(perfect, conditions)
        reference = Reference.of(optics, pupils, error)
        nominal = reference.row("nominal", [reference.nominal], 0.0)
        row = reference.row("aberrated", [optics.light(optics.sums(aberrated))], 0.0)
        true = focus(aberrated, of, alone)
        assert nominal.strehl == pytest.approx(1.0, abs=1e-6)
        assert true.strehl < 0.9
        assert row.strehl == pytest.approx(true.strehl, abs=2e-3)
        assert row.fwhm_x_um == pytest.approx(true.fwhm_x_um, rel=2e-3)
        assert row.fwhm_y_um == pytest.approx(true.fwhm_y_um, rel=2e-3)


class _Aberrated(PerfectLens):
    """A perfect lens with pi/2 (r / R)^4 of phase."""

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        r_squared = (x_um[None, :] ** 2 + y_um[:, None] ** 2) / (0.5 * self.imaging.aperture_um) ** 2
        return np.asarray(super().transmission(x_um, y_um) * np.exp(0.5j * math.pi * r_squared**2))


def test_slopes_of_rings_are_refused_by_their_key(written: WrittenField, small_library: Library) -> None:
    """Before any cell is solved; a solver's message without key or way out used to end the table."""
    cell = replace(small_library.unit_cell.cell, shape="ring", wall_nm=40.0)
    rings = replace(small_library, unit_cell=replace(small_library.unit_cell, cell=cell))
    with pytest.raises(InputError, match=r'sidewall_deg.*expected 0 for cells of the shape "ring"'):
        tolerance_table(written, rings, Tolerances(sidewall_deg=1.0), PsfConditions(OPTICS, DEPTHS_M), 50)


def test_what_would_leave_the_mask_as_it_is_is_refused(written: WrittenField, small_library: Library) -> None:
    """A misspelt axis gave the corners of the nominal mask."""
    with pytest.raises(InputError, match=r"`hieght_nm`: expected an axis: .*; did you mean `height_nm`\?"):
        corner_fields(written, small_library, {"hieght_nm": 10.0})
    conditions = PsfConditions(OPTICS, DEPTHS_M)
    with pytest.raises(InputError, match="`field_sites`: expected at least 1 site, got 0"):
        tolerance_table(written, small_library, Tolerances(), conditions, 0)
    with pytest.raises(InputError, match="`conditions`: expected PsfConditions, got Imaging"):
        tolerance_table(written, small_library, Tolerances(), OPTICS, 50)  # type: ignore[arg-type]
