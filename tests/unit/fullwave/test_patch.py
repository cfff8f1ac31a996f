"""Square patches of a mask: planted coupling is measured, cost is foreseen, and results survive their file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import fullwave
from metafab.cell.meep import SupercellSettings
from metafab.cell.meep.supercell import Cost
from metafab.cell.supercell import Supercell, SupercellOrders
from metafab.core.errors import InputError, SolverError
from metafab.fullwave.patch import field_difference
from metafab.fullwave.written import library_responses
from metafab.layout import PillarMap
from metafab.library import Library
from metafab.library.neighbours import Neighbours
from tests.fake_meep import UncoupledPillars
from tests.unit.fullwave.conftest import QUICK


def test_a_patch_without_coupling_is_stitched_from_its_pillars(pillars: PillarMap, ramp_library: Library) -> None:
    plan = fullwave.plan_patch(pillars, ramp_library, (1.0, -2.0), 1.75, padding_sites=2, settings=QUICK)
    assert plan.supercell.shape == (9, 9)
    patch = fullwave.solve_patch(plan, ramp_library, "y", UncoupledPillars())
    assert patch.full_wave.shape == (5, 5)
    np.testing.assert_allclose(patch.x_um, plan.x_um[2:-2])
    np.testing.assert_allclose(patch.full_wave, patch.alone, atol=1e-12)
    assert patch.coupling.relative_l2 < 1e-12
    # The fake's pillars are not the library's: the difference is all the grid's.
    assert patch.grid.relative_l2 == pytest.approx(patch.against_library.relative_l2)
    assert patch.against_library.relative_l2 > 0.1


def test_planted_coupling_of_a_patch_is_found(pillars: PillarMap, ramp_library: Library) -> None:
    plan = fullwave.plan_patch(pillars, ramp_library, (1.0, -2.0), 1.75, padding_sites=2, settings=QUICK)
    patch = fullwave.solve_patch(plan, ramp_library, "x", UncoupledPillars({(0, 0): 0.1}))
    np.testing.assert_allclose(patch.full_wave - patch.alone, 0.1, atol=1e-12)
    scale = np.sqrt(np.mean(np.abs(patch.alone) ** 2))
    assert patch.coupling.relative_l2 == pytest.approx(0.1 / scale)


def test_a_model_of_neighbours_is_judged_by_the_coupling_alone(
    pillars: PillarMap, ramp_library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model that predicts the planted coupling has no error, whatever the error of the grid."""

    def solved(library: Library, supercell: Supercell) -> SupercellOrders:
        order = supercell.propagating_orders("x")
        t = np.zeros((len(order), 2, 2), dtype=np.complex128)
        for axis, responses in enumerate(library_responses(supercell, library)):
            t[:, axis, axis] = supercell.local_period(order, responses)
        t[np.all(order == 0, axis=1)] += 0.1
        return SupercellOrders(supercell, order, t, error=0.0, seconds=0.0)

    monkeypatch.setattr("metafab.fullwave.patch.solve_by_model", solved)
    known = replace(ramp_library, neighbours=Neighbours((), ()))
    plan = fullwave.plan_patch(pillars, known, (1.0, -2.0), 1.75, padding_sites=2, settings=QUICK)
    right = fullwave.solve_patch(plan, known, "x", UncoupledPillars({(0, 0): 0.1})).model
    patch = fullwave.solve_patch(plan, known, "x", UncoupledPillars())
    assert right is not None
    assert right.relative_l2 < 1e-12
    assert patch.model is not None
    scale = np.sqrt(np.mean(np.abs(patch.library) ** 2))
    assert patch.model.relative_l2 == pytest.approx(0.1 / scale)
    assert fullwave.solve_patch(plan, ramp_library, "x", UncoupledPillars()).model is None


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
    turn = field_difference(turned, field)
    assert (turn.amplitude_rms, turn.phase_rms_rad) == pytest.approx((0.0, 0.0), abs=1e-7)
    assert turn.phase_offset_rad == pytest.approx(0.7, abs=1e-7)
    stretch = field_difference(1.1 * field, field)
    assert (stretch.phase_rms_rad, stretch.phase_offset_rad) == pytest.approx((0.0, 0.0), abs=1e-7)
    assert stretch.amplitude_rms == pytest.approx(0.1)
    assert stretch.relative_l2 == pytest.approx(0.1)
    jitter = rng.normal(scale=0.05, size=field.shape)
    assert field_difference(field * np.exp(1j * jitter), field).phase_rms_rad == pytest.approx(0.05, rel=0.1)


def test_a_larger_or_finer_patch_is_foreseen_to_take_more(pillars: PillarMap, ramp_library: Library) -> None:

    def cost(size_um: float, pixels: int) -> Cost:
        settings = SupercellSettings(pixels)
        return fullwave.plan_patch(pillars, ramp_library, (0.0, 0.0), size_um, settings=settings).cost

    small, large, fine = cost(1.05, 8), cost(2.1, 8), cost(1.05, 16)
    assert large.pixels == pytest.approx(small.pixels * (12 / 9) ** 2, rel=1e-6)
    assert large.bytes > small.bytes
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
    assert back.model is None
    fullwave.save_patch(replace(patch, neighbours=1.1 * patch.library), path, inputs_sha256="abc")
    assert fullwave.load_patch(path).model == replace(patch, neighbours=1.1 * patch.library).model
    for name in ("x_um", "y_um", "full_wave", "library", "alone"):
        np.testing.assert_array_equal(getattr(back, name), getattr(patch, name))
    assert (back.against_library, back.coupling, back.grid) == (patch.against_library, patch.coupling, patch.grid)
    assert (back.polarisation, back.padding_sites, back.pixels_per_period) == ("y", 1, 8)
    with pytest.raises(InputError, match="no file at that path"):
        fullwave.load_patch(tmp_path / "none.h5")
