"""Moved and missing pillars against what optics says of them in closed form, and the corner table's figures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab import library
from metafab.layout.pillars import PillarMap
from metafab.optics import direct_irradiance, psf, relative_l2
from metafab.optics.fabrication import (
    MovedField,
    ThinnedField,
    library_corners,
    misplaced,
    stitched,
    tolerance,
    tolerance_row,
)
from metafab.optics.path import Ray
from metafab.spec import UnitCell
from metafab.spec.cell import Axes
from tests import library_ridges as ridges
from tests import optics_lens as lens

OPTICS = lens.imaging()
DEPTH_M = 0.9e-3
SOURCE = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))


def test_a_lens_moved_as_a_whole_is_object_and_sensor_moved_the_other_way() -> None:
    """The direct sum knows of no moved pillars; the window's edge sees them under another angle than its centre.

    That leaves k d times the change of direction over the window, 8 x 1.2 um over 450 um: 2 % of k d = 0.4 rad.
    """
    d_x, d_y = 0.05, -0.03
    moved = MovedField(SOURCE, OPTICS, lambda tile, shape: (np.full(shape, d_x), np.full(shape, d_y)), DEPTH_M)
    result = psf(moved, OPTICS, [DEPTH_M], window_px=16, target_error=1e-4)
    x, y = lens.window_points(OPTICS, result.centre_um[0, 0], 16)
    tangent = (-1e-6 * d_x / DEPTH_M, -1e-6 * d_y / DEPTH_M)
    true = direct_irradiance(SOURCE, OPTICS, DEPTH_M, tangent, x - d_x, y - d_y, 0)
    unmoved = psf(SOURCE, OPTICS, [DEPTH_M], window_px=16, target_error=1e-4).psf[0, 0].ravel()
    error = relative_l2(result.psf[0, 0].ravel(), true)
    assert error < 0.05 * relative_l2(unmoved, true) + 1e-3


def test_random_misplacement_costs_the_peak_a_debye_waller_factor() -> None:
    """Mean amplitude of a site: exp(-k^2 s^2 p^2 / 2), p the slope of the path; the rest is spread over all angles.

    A plain lens adds its sites in phase at the focus. Over 20 000 sites the mean phasor scatters by 1 / sqrt(20 000).
    """
    plain = lens.written(OPTICS, lens.eq_3_and_4(OPTICS), levels=24)
    depth = 1.0 / (1.0 / 300.0 - 1.0 / 450.0) * 1e-6
    rms_nm = 200.0
    row = tolerance(plain, {"moved": misplaced(plain, OPTICS, depth, rms_nm, seed=4)}, OPTICS, [depth])[0]
    x, y = plain.lattice.x_um(), plain.lattice.y_um()
    inside = np.hypot(x[None, :], y[:, None]) <= 0.5 * OPTICS.aperture_um
    path = Ray.towards_image(OPTICS, 0, depth, (0.0, 0.0)).path_um(x[None, :], y[:, None])
    slope = np.gradient(path, 0.35)
    damped = np.exp(-0.5 * (OPTICS.wavenumber * 1e-3 * rms_nm) ** 2 * (slope[0] ** 2 + slope[1] ** 2))
    expected = float(damped[inside].mean()) ** 2
    assert expected < 0.97
    assert row.peak_ratio == pytest.approx(expected, abs=0.01)
    assert math.isnan(row.depth_error_m)


def test_missing_pillars_take_amplitude_and_power() -> None:
    share = 0.1
    thinned = ThinnedField(SOURCE, share, seed=1)
    rows = tolerance(SOURCE, {"missing": thinned, "none": ThinnedField(SOURCE, 0.0)}, OPTICS, [0.8e-3, 0.9e-3])
    assert rows[0].corner == "missing"
    # Of 23 000 pillars a binomial share is lost: its standard deviation is 0.002.
    assert rows[0].peak_ratio == pytest.approx((1.0 - share) ** 2, abs=0.02)
    before, after = (psf(s, OPTICS, [DEPTH_M], window_px=16).details["transmitted_x"] for s in (SOURCE, thinned))
    assert after / before == pytest.approx(1.0 - share, abs=0.008)
    # The ones that lose nothing pass another branch of the reduction, on amplitudes: its rounding is left.
    assert rows[1].change < 1e-6 and rows[1].peak_ratio == pytest.approx(1.0, abs=1e-6)
    assert abs(rows[1].turn_deg) < 1e-3 and abs(rows[1].depth_error_m) < 1e-9


def test_write_fields_move_as_one_and_draws_are_repeatable() -> None:
    """A field larger than the lens moves it as a whole; small ones differ; tiles and repeats change nothing."""
    whole = stitched(SOURCE, OPTICS, DEPTH_M, 30.0, 1000, seed=2)
    tile = next(whole.tiles())
    d_x, d_y = whole.offsets_um(tile, (3, 4))
    assert np.ptp(d_x) == 0.0 and np.ptp(d_y) == 0.0
    small = stitched(SOURCE, OPTICS, DEPTH_M, 30.0, 5, seed=2)
    far = replace(tile, row=7, column=13)
    assert small.offsets_um(far, (10, 10))[0][3, 2] == small.offsets_um(tile, (20, 20))[0][10, 15]
    once, twice = ([t.amplitudes for t in misplaced(SOURCE, OPTICS, DEPTH_M, 20.0).tiles()] for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(once, twice, strict=True))


def test_a_turn_is_read_as_depth() -> None:
    """Depth error = turn over the nominal turn per metre, at each depth; the mask itself has none."""
    depths = [0.84e-3, 0.88e-3, 0.92e-3]
    row = tolerance(SOURCE, {"itself": SOURCE}, OPTICS, depths)[0]
    assert (row.change, row.turn_deg, row.depth_error_m, row.peak_ratio, row.efficiency_change) == (0, 0, 0, 1, 0)
    nominal = psf(SOURCE, OPTICS, depths, target_error=1e-3)
    turned = replace(nominal, phi_deg=nominal.phi_deg + np.array([0.5, -2.0, 1.0]))
    slope = np.gradient(np.unwrap(nominal.phi_deg, period=360.0), nominal.depth_m)
    assert tolerance_row("turned", nominal, turned).turn_deg == pytest.approx(-2.0)
    worst = max(np.array([0.5, -2.0, 1.0]) / slope, key=abs)
    assert tolerance_row("turned", nominal, turned).depth_error_m == pytest.approx(worst)


def test_corners_of_the_library_are_the_same_pillars_at_other_sizes(
    unit_cell: UnitCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Amplitudes of biased pillars against the closed form that the library was built from; nothing without axes."""
    monkeypatch.setattr("metafab.library.corner_rounds.FIRST_ROUND", 24)
    monkeypatch.setattr("metafab.library.corner_rounds.SEQUENCE", 2048)
    sweep = replace(unit_cell.sweep, width_nm=(100.0, 160.0), length_nm=(100.0, 160.0), size_grid_nm=20.0)
    axes = Axes(wavelength_nm=(790.0, 810.0), cd_bias_nm=(-5.0, 5.0))
    cell = replace(unit_cell, sweep=replace(sweep, axes=axes))
    size_dbu = np.array([(0, 0), (200, 320), (280, 240)], dtype=np.int32)
    index = np.array([[1, 2], [0, 1]], dtype=np.uint16)
    pillars = PillarMap.from_array(replace(SOURCE.lattice, shape=(2, 2)), size_dbu, index, 2)
    corners = library_corners(pillars, library.build(cell, solver=ridges.solve_scaled))
    assert list(corners) == ["cd_bias_nm -5", "cd_bias_nm 5"]
    for name, bias_nm in zip(corners, (-5.0, 5.0), strict=True):
        table = corners[name].table
        # From sapphire into air, the power-normalised amplitude is t sqrt(n_air / n_sapphire).
        scale = math.sqrt(1.0 / 1.7601)
        for (width, length), got in zip(0.5 * size_dbu[1:] + bias_nm, table[1:], strict=True):
            made = ridges.amplitude(width, length), ridges.amplitude(length, width)
            assert np.abs(got - scale * np.array(made)).max() <= 2.0 * cell.sweep.target_error
        assert not table[0].any()
    plain = library.build(replace(cell, sweep=sweep), solver=ridges.solve_scaled)
    assert library_corners(pillars, plain) == {}
