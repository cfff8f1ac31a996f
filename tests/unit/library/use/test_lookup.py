"""The mapping table: it holds the best size for every pair of phases, exactly, and refuses what a mask cannot hold."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from metafab.core.conventions import wrap_phase
from metafab.core.errors import InputError
from metafab.library import Library, SizeTable, build_size_table
from metafab.library.use.amplitudes import empty_cell_t
from metafab.library.use.lookup import global_offsets, phase_slope_per_nm

CELLS = 64


@pytest.fixture(scope="module")
def table(smooth_library: Library) -> SizeTable:
    return build_size_table(smooth_library, database_unit_nm=0.5, cells=CELLS)


def overlap_of(t: np.ndarray, phase_x: np.ndarray, phase_y: np.ndarray) -> np.ndarray:
    return (t[..., 0] * np.exp(-1j * phase_x)).real + (t[..., 1] * np.exp(-1j * phase_y)).real


def test_every_cell_holds_the_best_of_all_sizes(table: SizeTable) -> None:
    """Brute force over all 5776 sizes at 200 cells; ties may name another size, never a smaller overlap."""
    rng = np.random.default_rng(3)
    for row, column in rng.integers(0, CELLS, (200, 2)):
        phases = 2.0 * math.pi * np.array([column, row]) / CELLS
        best = overlap_of(table.t[1:], *phases).max()
        held = overlap_of(table.t[table.size_index[row, column]], *phases)
        assert held == pytest.approx(best, abs=1e-12)
        assert table.overlap[row, column] == pytest.approx(best, abs=1e-12)


@settings(max_examples=50, deadline=None)
@given(phase_x=st.floats(-50.0, 50.0), phase_y=st.floats(-50.0, 50.0))
def test_a_lookup_loses_no_more_than_a_cell_can(table: SizeTable, phase_x: float, phase_y: float) -> None:
    """Between cell centres, each of the two overlaps compared moves by at most |t| delta for each phase."""
    index = table.sizes_for(phase_x, phase_y)
    best = overlap_of(table.t[1:], np.float64(phase_x), np.float64(phase_y)).max()
    half_cell = math.pi / CELLS
    loss_bound = 2.0 * 2.0 * np.abs(table.t).max() * half_cell
    loss = best - overlap_of(table.t[index], np.float64(phase_x), np.float64(phase_y))
    assert -1e-12 <= loss <= loss_bound


def test_the_loss_of_the_default_table_is_negligible(smooth_library: Library) -> None:
    """At 512 cells the mean overlap of random targets is within 1e-4 of an exhaustive search."""
    table = build_size_table(smooth_library, database_unit_nm=0.5)
    phases = np.random.default_rng(4).uniform(-math.pi, math.pi, (2, 300))
    best = overlap_of(table.t[1:, None], *phases).max(axis=0)
    held = overlap_of(table.t[table.sizes_for(*phases)], *phases)
    assert np.mean(best - held) < 1e-4


def test_sizes_are_even_whole_units_and_zero_is_no_pillar(table: SizeTable, smooth_library: Library) -> None:
    assert table.size_dbu.dtype == np.int32
    assert tuple(table.size_dbu[0]) == (0, 0)
    assert not np.any(table.size_dbu % 2)
    assert table.size_dbu.shape == (smooth_library.t_xx.size + 1, 2)
    assert np.allclose(table.t[0], empty_cell_t(smooth_library.unit_cell))
    sizes_nm = table.size_dbu[1:] * 0.5
    response = smooth_library.at_sizes(sizes_nm[:, 0], sizes_nm[:, 1])
    assert np.array_equal(table.t[1:], np.stack([response.t_xx, response.t_yy], axis=-1))


def test_rules_leave_only_what_they_allow(smooth_library: Library) -> None:
    table = build_size_table(
        smooth_library, database_unit_nm=0.5, max_width_nm=240.0, max_length_nm=230.0, min_feature_nm=120.0, cells=16
    )
    sizes_nm = table.size_dbu[1:] * 0.5
    assert sizes_nm[:, 0].max() == 240.0
    assert sizes_nm[:, 1].max() == 230.0
    assert sizes_nm.min() == 120.0
    assert table.size_index.min() >= 1


def test_poorly_known_sizes_can_be_left_out(smooth_library: Library) -> None:
    error = smooth_library.error.copy()
    error[0, 10:20, :] = 0.1
    table = build_size_table(replace(smooth_library, error=error), database_unit_nm=0.5, cells=16, max_error=0.05)
    assert table.error.max() <= 0.05
    assert table.size_dbu.shape[0] == smooth_library.t_xx.size - 10 * smooth_library.width_nm.size + 1


def test_inexact_sizes_are_refused(smooth_library: Library) -> None:
    """102 nm is no even number of 4 nm units, 104 nm no even number of 3 nm units."""
    with pytest.raises(InputError, match=r"`mask\.database_unit_nm`: .* 4 nm; .*nothing is rounded silently"):
        build_size_table(smooth_library, database_unit_nm=4.0, cells=16)


@pytest.mark.parametrize("unit_nm", [0.0, -0.5, float("nan")])
def test_a_unit_is_a_length(smooth_library: Library, unit_nm: float) -> None:
    """-0.5 nm gave a table of negative sizes."""
    with pytest.raises(InputError, match=r"`mask\.database_unit_nm`: expected a length above 0"):
        build_size_table(smooth_library, database_unit_nm=unit_nm, cells=16)


def test_rules_that_leave_nothing_are_refused(smooth_library: Library) -> None:
    with pytest.raises(InputError, match="relax the rules"):
        build_size_table(smooth_library, database_unit_nm=0.5, max_width_nm=90.0)


def test_a_table_needs_a_power_of_two(smooth_library: Library) -> None:
    with pytest.raises(ValueError, match="power of two"):
        build_size_table(smooth_library, database_unit_nm=0.5, cells=100)


def test_phase_slope_of_the_closed_form(smooth_library: Library) -> None:
    """Both phases of the fixture rise by 2.6 pi while both sides grow by 150 nm: 0.0545 rad per nm of bias.

    Second differences at 2 nm leave a relative error of (k h)^2 / 6 = 1e-3 inside and twice that at the edges.
    """
    slope = phase_slope_per_nm(smooth_library)
    assert np.allclose(slope, 2.6 * math.pi / 150.0, rtol=5e-3)


def _without(library: Library, missing: np.ndarray) -> Library:
    """A library without the amplitudes of some sizes, shape (n_length, n_width)."""
    t_xx, t_yy = (np.where(missing, np.nan, t) for t in (library.t_xx, library.t_yy))
    error = np.where(missing, np.nan, np.broadcast_to(library.error, library.t_xx.shape))
    return replace(library, t_xx=t_xx, t_yy=t_yy, error=error)


@pytest.mark.parametrize("widths", [slice(None), slice(0, 40)])
def test_phase_slope_beside_sizes_without_amplitude(smooth_library: Library, widths: slice) -> None:
    """A sweep without its largest pillars, as wide as long or not, and a hole in it."""
    fewer = replace(
        smooth_library,
        width_nm=smooth_library.width_nm[widths],
        t_xx=smooth_library.t_xx[..., widths],
        t_yy=smooth_library.t_yy[..., widths],
        error=np.zeros_like(smooth_library.t_xx[..., widths].real),
    )
    missing = (fewer.width_nm > 150.0) & (fewer.length_nm[:, None] > 200.0)
    missing[20, 20] = True
    slope = phase_slope_per_nm(_without(fewer, missing))
    assert np.allclose(slope[~missing], 2.6 * math.pi / 150.0, rtol=0.05)


def test_phase_slope_of_squares_alone(smooth_library: Library) -> None:
    on_diagonal = np.eye(smooth_library.width_nm.size, dtype=bool)
    slope = phase_slope_per_nm(_without(smooth_library, ~on_diagonal))
    assert np.allclose(slope[on_diagonal], 2.6 * math.pi / 150.0, rtol=5e-3)


def test_a_cd_bias_moves_the_choice_to_calm_sizes(smooth_library: Library) -> None:
    """A ridge of steep phase is chosen for its phases nominally, and avoided under a bias."""
    steep = np.abs(np.arange(smooth_library.width_nm.size) - 40) < 4
    wobble = np.where(steep, np.arange(smooth_library.width_nm.size) * 1.3, 0.0)
    library = replace(smooth_library, t_xx=smooth_library.t_xx * np.exp(1j * wobble)[None, None, :])
    slope = np.abs(phase_slope_per_nm(library)).max(axis=-1)

    def mean_slope(cd_sigma_nm: float) -> float:
        table = build_size_table(library, database_unit_nm=0.5, cells=64, cd_sigma_nm=cd_sigma_nm)
        size_nm = 0.5 * table.size_dbu[table.size_index].astype(float)
        column = np.searchsorted(library.width_nm, size_nm[..., 0] - 0.1)
        row = np.searchsorted(library.length_nm, size_nm[..., 1] - 0.1)
        return float(slope[row, column].mean())

    assert mean_slope(5.0) < 0.8 * mean_slope(0.0)


def test_isotropic_sizes_are_as_wide_as_long_or_crosses_of_a_square_cell(smooth_library: Library) -> None:
    table = build_size_table(smooth_library, database_unit_nm=0.5, cells=16, isotropic=True)
    assert np.all(table.size_dbu[:, 0] == table.size_dbu[:, 1])
    assert len(table.size_dbu) == 1 + smooth_library.width_nm.size
    np.testing.assert_allclose(table.t[:, 0], table.t[:, 1])
    cell = smooth_library.unit_cell
    cross = replace(smooth_library, unit_cell=replace(cell, cell=replace(cell.cell, shape="cross")))
    assert len(build_size_table(cross, database_unit_nm=0.5, cells=16, isotropic=True).size_dbu) > len(table.size_dbu)
    oblong = replace(smooth_library, unit_cell=replace(cell, cell=replace(cell.cell, period_nm=(350.0, 400.0))))
    with pytest.raises(InputError, match="different responses along x and y"):
        build_size_table(oblong, database_unit_nm=0.5, cells=16, isotropic=True)


def test_global_offsets_find_the_best_place_of_all(table: SizeTable) -> None:
    """Against trying every offset by brute force, for targets bunched around (1.0, -2.0)."""
    rng = np.random.default_rng(7)
    phases = rng.normal([[1.0], [-2.0]], 0.4, (2, 4000))
    histogram = table.histogram(*phases)
    assert histogram.sum() == 4000
    total = np.array(
        [
            [np.sum(histogram * np.roll(table.overlap, (-i, -j), axis=(0, 1))) for j in range(CELLS)]
            for i in range(CELLS)
        ]
    )
    c_x, c_y = global_offsets(table, histogram)
    reached = np.sum(table.overlap[table.nearest_cell(phases[1] + c_y), table.nearest_cell(phases[0] + c_x)])
    assert reached == pytest.approx(total.max(), rel=2e-3)  # targets on a cell's edge may round the other way
    c_x, c_y = global_offsets(table, histogram, keep_retardance=True)
    assert c_x == c_y
    reached = np.sum(table.overlap[table.nearest_cell(phases[1] + c_y), table.nearest_cell(phases[0] + c_x)])
    assert reached == pytest.approx(np.diagonal(total).max(), rel=2e-3)


def test_even_targets_leave_the_offsets_alone(table: SizeTable) -> None:
    assert global_offsets(table, np.ones((CELLS, CELLS), dtype=np.int64)) == (0.0, 0.0)


def test_chosen_sizes_are_near_their_targets(table: SizeTable) -> None:
    phases = np.random.default_rng(5).uniform(-10.0, 10.0, (2, 50, 40))
    error = wrap_phase(np.moveaxis(np.angle(table.t)[table.sizes_for(*phases)], -1, 0) - phases)
    # The fixture covers the torus, so a target is reached to within the size grid and a cell of 64.
    assert np.sqrt(np.mean(error**2)) < 0.2


@given(
    arrays(np.float64, (5, 7), elements=st.floats(-1e5, 1e5)),
    arrays(np.float64, 7, elements=st.floats(-10.0, 10.0)),
)
def test_compiled_and_vectorised_look_up_agree(table: SizeTable, phase_x: np.ndarray, phase_y: np.ndarray) -> None:
    """Also with shapes that broadcast; the compiled form must not differ in a single cell."""
    vectorised = table.size_index[table.nearest_cell(phase_y), table.nearest_cell(phase_x)]
    assert np.array_equal(table.sizes_for(phase_x, phase_y), vectorised)


def test_sizes_beyond_the_target_error_are_taken_only_where_no_other_serves(smooth_library: Library) -> None:
    plain = build_size_table(smooth_library, database_unit_nm=0.5, cells=CELLS)
    favourites = np.bincount(plain.size_index.ravel(), minlength=len(plain.size_dbu)).argsort()[-5:]
    row, column = np.divmod(favourites - 1, smooth_library.width_nm.size)
    error = np.array(np.broadcast_to(smooth_library.error, smooth_library.t_xx.shape))
    error[0, row, column] = 4.19
    doubtful = replace(smooth_library, error=error)
    table = build_size_table(doubtful, database_unit_nm=0.5, cells=CELLS)
    assert not np.isin(table.size_index, favourites).any()
    assert np.array_equal(table.t, plain.t)  # what they do is not changed, only how they are preferred
    (sentence,) = doubtful.warnings()
    assert "5 of 5776 sizes are beyond the target error" in sentence
    assert smooth_library.warnings() == []
    assert "A layout uses other sizes where it can" in sentence
    # Where nothing else is left they serve.
    everywhere = replace(smooth_library, error=np.full_like(error, 4.19))
    assert "No size is within it, so a layout uses them all" in everywhere.warnings()[0]
    assert build_size_table(everywhere, database_unit_nm=0.5, cells=CELLS).size_index.min() >= 1
