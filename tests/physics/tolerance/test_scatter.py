"""Moved and missing pillars against closed forms, block sums that scatter against pillars that do, and the table."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.optics.direct_sum import direct_irradiance
from metafab import library
from metafab.core.conventions import FloatArray
from metafab.layout.pillars import PillarMap
from metafab.library.sweep.build import BuildNumerics
from metafab.library.sweep.corner_sampling import CornerNumerics
from metafab.optics import Imaging, PsfNumerics, WrittenField, psf, relative_l2
from metafab.optics.geometry.path import Ray
from metafab.optics.measures.metrics import peak_irradiance
from metafab.optics.propagation.image import Window
from metafab.optics.propagation.pupil import Carrier, reduce_field
from metafab.optics.sources.source import Source
from metafab.spec import UnitCell
from metafab.spec.cell import Axes
from metafab.tolerance.corners import corner_fields
from metafab.tolerance.scatter import Fault, Misplaced, Missing, Stitched
from tests import library_ridges as ridges
from tests import optics_lens as lens
from tests.faulty_masks import MovedField, ThinnedField, misplaced, stitched

OPTICS = lens.imaging()
DEPTH_M = 0.9e-3
SOURCE = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))


def _pupils(source: Source, optics: Imaging, depth_m: float, block: int) -> list[object]:
    carriers = [Carrier(p, Ray.towards_image(optics, p, depth_m, (0.0, 0.0)), block) for p in (0, 1)]
    return list(reduce_field(source, carriers, optics.wavenumber))


def _image(pupils: list[object], optics: Imaging, depth_m: float, window_px: int = 32) -> FloatArray:
    window = Window(optics, window_px, 1e-4)
    return np.array([window.irradiance([pupils[p]], p, (0.0, 0.0), [depth_m])[0][0] for p in (0, 1)])  # type: ignore[list-item]


def test_a_lens_moved_as_a_whole_is_object_and_sensor_moved_the_other_way() -> None:
    """The direct sum knows of no moved pillars; the window's edge sees them under another angle than its centre.

    That leaves k d times the change of direction over the window, 8 x 1.2 um over 450 um: 2 % of k d = 0.4 rad.
    """
    d_x, d_y = 0.05, -0.03
    moved = MovedField(SOURCE, OPTICS, lambda tile, shape: (np.full(shape, d_x), np.full(shape, d_y)), DEPTH_M)
    result = psf(moved, OPTICS, [DEPTH_M], PsfNumerics(window_px=16, target_error=1e-4))
    x, y = lens.window_points(OPTICS, result.centre_um[0, 0], 16)
    tangent = (-1e-6 * d_x / DEPTH_M, -1e-6 * d_y / DEPTH_M)
    true = direct_irradiance(SOURCE, OPTICS, DEPTH_M, tangent, x - d_x, y - d_y, 0)
    unmoved = psf(SOURCE, OPTICS, [DEPTH_M], PsfNumerics(window_px=16, target_error=1e-4)).psf[0, 0].ravel()
    error = relative_l2(result.psf[0, 0].ravel(), true)
    assert error < 0.05 * relative_l2(unmoved, true) + 1e-3


@pytest.mark.parametrize("blocks", [True, False], ids=["blocks", "pillars"])
def test_random_misplacement_costs_the_peak_a_debye_waller_factor(blocks: bool) -> None:
    """Mean amplitude of a site: exp(-k^2 s^2 p^2 / 2), p the slope of the path; the rest is spread over all angles.

    A plain lens adds its sites in phase at the focus. Over 20 000 sites the mean phasor scatters by 1 / sqrt(20 000).
    """
    plain = lens.written(OPTICS, lens.eq_3_and_4(OPTICS), levels=24)
    depth = 1.0 / (1.0 / 300.0 - 1.0 / 450.0) * 1e-6
    rms_nm = 200.0
    pupils = _pupils(plain, OPTICS, depth, 8)
    before = _image(pupils, OPTICS, depth)
    if blocks:
        moved = Misplaced(OPTICS, rms_nm)(pupils, np.random.default_rng(4))  # type: ignore[arg-type]
        after = _image(moved, OPTICS, depth)  # type: ignore[arg-type]
    else:
        after = _image(_pupils(misplaced(plain, OPTICS, depth, rms_nm, seed=4), OPTICS, depth, 8), OPTICS, depth)
    x, y = plain.lattice.x_um(), plain.lattice.y_um()
    inside = np.hypot(x[None, :], y[:, None]) <= 0.5 * OPTICS.aperture_um
    path = Ray.towards_image(OPTICS, 0, depth, (0.0, 0.0)).path_um(x[None, :], y[:, None])
    slope = np.gradient(path, 0.35)
    damped = np.exp(-0.5 * (OPTICS.wavenumber * 1e-3 * rms_nm) ** 2 * (slope[0] ** 2 + slope[1] ** 2))
    expected = float(damped[inside].mean()) ** 2
    assert expected < 0.97
    assert after[0].max() / before[0].max() == pytest.approx(expected, abs=0.01)


def test_missing_pillars_take_amplitude_and_power() -> None:
    share = 0.1
    thinned = ThinnedField(SOURCE, share, seed=1)
    before, after = (psf(s, OPTICS, [0.8e-3, 0.9e-3], PsfNumerics(target_error=1e-3)) for s in (SOURCE, thinned))
    # Of 23 000 pillars a binomial share is lost: its standard deviation is 0.002.
    assert (peak_irradiance(after) / peak_irradiance(before)).min() == pytest.approx((1.0 - share) ** 2, abs=0.02)
    light = [p.details.transmitted[0] for p in (before, after)]
    assert light[1] / light[0] == pytest.approx(1.0 - share, abs=0.008)
    # One that loses nothing passes another branch of the reduction, on amplitudes: its rounding is left.
    nothing = psf(ThinnedField(SOURCE, 0.0), OPTICS, [0.8e-3, 0.9e-3], PsfNumerics(target_error=1e-3))
    assert relative_l2(nothing.psf, before.psf) < 1e-6


def test_blocks_without_the_missing_pillars_transmit_less() -> None:
    """The Strehl ratio is per unit of transmitted power."""
    carrier = Carrier(0, Ray.towards_image(OPTICS, 0, DEPTH_M, (0.0, 0.0)), 8)
    pupils = reduce_field(SOURCE, [carrier], OPTICS.wavenumber)
    (thinned,) = Missing(0.1)(pupils, np.random.default_rng(2))
    assert thinned.transmitted(carrier.ray) == pytest.approx(0.9 * pupils[0].transmitted(carrier.ray))


@pytest.mark.parametrize(
    ("fault", "faulty"),
    [
        (Misplaced(OPTICS, 60.0), lambda seed: misplaced(SOURCE, OPTICS, DEPTH_M, 60.0, seed=seed)),
        (Missing(0.03), lambda seed: ThinnedField(SOURCE, 0.03, seed)),
        (
            Stitched(OPTICS, 60.0, 36, SOURCE.lattice),
            lambda seed: stitched(SOURCE, OPTICS, DEPTH_M, 60.0, 36, seed=seed),
        ),
    ],
    ids=["misplaced", "missing", "stitched"],
)
def test_block_sums_scatter_as_pillars_do(fault: Fault, faulty: object) -> None:
    """The mean change of both images, and how the change of one goes with that of the other, over 12 masks each.

    The rms over so few draws scatters by 1 / sqrt(24) = 0.2 of itself, less as an image has many speckles.
    """
    pupils = _pupils(SOURCE, OPTICS, DEPTH_M, fault.block_sites(8))
    nominal = _image(pupils, OPTICS, DEPTH_M)
    changes = []
    for make in (
        lambda seed: _image(fault(pupils, np.random.default_rng(seed)), OPTICS, DEPTH_M),  # type: ignore[arg-type]
        lambda seed: _image(_pupils(faulty(seed), OPTICS, DEPTH_M, fault.block_sites(8)), OPTICS, DEPTH_M),  # type: ignore[operator]
    ):
        draws = np.array([make(seed) - nominal for seed in range(12)])
        rms = np.sqrt((draws**2).mean(axis=0).sum(axis=(1, 2))) / np.linalg.norm(nominal, axis=(1, 2))
        power = draws.sum(axis=(2, 3)).mean(axis=0) / nominal.sum(axis=(1, 2))
        changes.append((rms, power))
    (blocks, block_power), (pillars, pillar_power) = changes
    assert blocks == pytest.approx(pillars, rel=0.3)
    assert block_power == pytest.approx(pillar_power, abs=0.15 * float(pillars.max()))


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


def test_blocks_of_a_stitched_mask_lie_in_one_field() -> None:
    fault = Stitched(OPTICS, 30.0, 1428, SOURCE.lattice)
    assert fault.block_sites(30) == 28
    assert fault.block_sites(1) == 1


def _two_pillars(unit_cell: UnitCell, axes: Axes | None) -> tuple[WrittenField, library.Library, np.ndarray]:
    sweep = replace(unit_cell.sweep, width_nm=(100.0, 160.0), length_nm=(100.0, 160.0), size_grid_nm=20.0)
    few = BuildNumerics(corners=CornerNumerics(sequence=2048, first_round=24))
    built = library.build(replace(unit_cell, sweep=replace(sweep, axes=axes)), solver=ridges.solve_scaled, numerics=few)
    size_dbu = np.array([(0, 0), (200, 320), (280, 240)], dtype=np.int32)
    index = np.array([[1, 2], [0, 1]], dtype=np.uint16)
    pillars = PillarMap.from_array(replace(SOURCE.lattice, shape=(2, 2)), size_dbu, index, 2)
    from metafab.optics import written_field

    return written_field(pillars, built), built, 0.5 * size_dbu[1:]


def test_corners_of_the_library_are_the_same_pillars_at_other_sizes(
    unit_cell: UnitCell,
) -> None:
    """Amplitudes of biased pillars against the closed form that the library was built from; nothing is solved."""
    axes = Axes(wavelength_nm=(790.0, 810.0), cd_bias_nm=(-5.0, 5.0))
    written, built, sizes_nm = _two_pillars(unit_cell, axes)
    corners = corner_fields(written, built, {"cd_bias_nm": 5.0})
    assert [corner.name for corner in corners] == ["cd_bias_nm -5", "cd_bias_nm +5"]
    for corner, bias_nm in zip(corners, (-5.0, 5.0), strict=True):
        assert corner.solved == 0
        # From sapphire into air, the power-normalised amplitude is t sqrt(n_air / n_sapphire).
        scale = math.sqrt(1.0 / 1.7601)
        for (width, length), got in zip(sizes_nm + bias_nm, corner.field.table[1:], strict=True):
            made = ridges.amplitude(width, length), ridges.amplitude(length, width)
            assert np.abs(got - scale * np.array(made)).max() <= 2.0 * unit_cell.sweep.target_error
        assert not corner.field.table[0].any()
