"""Checks before any step runs: each wavelength of a design counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.spec import Design, Light, load_design, terms
from metafab.spec.device import Optics
from metafab.steps.job import Job
from metafab.steps.preflight import PREFLIGHT, PreflightFigures, preflight, too_steep
from tests.main_job import ROOT


def announced(wavelength_nm: float, folder: Path) -> tuple[str, ...]:
    design = load_design(ROOT / "layouts" / "rgb_metalens.toml")
    light = (Light(wavelength_nm), Light(540.0))
    figures = PREFLIGHT.work(Job(replace(design, light=light), folder))
    assert isinstance(figures, PreflightFigures)
    return figures.announcements


def test_orders_that_open_at_one_of_the_wavelengths_are_announced(tmp_path: Path) -> None:
    """A period of 300 nm sends orders into fused silica below 438 nm."""
    orders = [each for each in announced(420.0, tmp_path) if "diffraction orders" in each]
    assert len(orders) == 1 and orders[0].startswith("at 420 nm, 4 diffraction orders")
    assert not [each for each in announced(460.0, tmp_path) if "diffraction orders" in each]


def test_a_wavelength_at_which_a_material_is_not_known_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="TiO2"):
        announced(3000.0, tmp_path)


def test_phases_too_steep_for_the_pillars_are_announced(tmp_path: Path) -> None:
    """Pillars 300 nm apart sample directions below asin(lambda / 600 nm): 64 degrees at 540 nm, 50 at 460 nm."""
    design = load_design(ROOT / "layouts" / "rgb_metalens.toml")
    lights = (Light(460.0), Light(540.0))
    for angle_deg, told in ((45.0, []), (55.0, ["460"]), (70.0, ["460", "540"])):
        grating = replace(design, phase=(terms.Grating(angle_deg=angle_deg),), light=lights)
        assert [each.split()[1] for each in too_steep(Job(grating, tmp_path))] == told
    # Of a lens, the places where the direction cosine along x or y exceeds 0.9: none at NA 0.83.
    fast = replace(design, device=replace(design.device, focal_length_mm=0.008), light=(), phase=(terms.Lens(),))
    assert too_steep(Job(fast, tmp_path)) == []
    faster = replace(fast, device=replace(design.device, focal_length_mm=0.004))
    steep, radius = 0.9, 3.0  # The radius is that over the focal length.
    x = (np.arange(4000) + 0.5) / 4000 * radius
    inside = x[:, None] ** 2 + x**2 < radius**2
    root = np.sqrt(1.0 + x[:, None] ** 2 + x**2)
    share = ((x / root > steep) | (x[:, None] / root > steep))[inside].mean()
    (sentence,) = too_steep(Job(faster, tmp_path))
    assert float(sentence.split(" % ")[0].split()[-1]) == pytest.approx(100.0 * share, rel=0.02)


def test_oblique_light_on_pillars_that_are_not_solved_so_is_refused_before_any_work(
    small_design: Design, tmp_path: Path
) -> None:
    design = replace(small_design, optics=Optics(oblique=True))
    PREFLIGHT.work(Job(design, tmp_path))
    cell = design.unit_cell
    round_ones = replace(design, unit_cell=replace(cell, cell=replace(cell.cell, shape="ellipse")))
    with pytest.raises(InputError, match=r"`optics\.oblique`: expected upright rectangles"):
        PREFLIGHT.work(Job(round_ones, tmp_path))


def test_arrays_are_as_steep_as_their_samples_are_from_pillar_to_pillar(tmp_path: Path) -> None:
    """Pillars 300 nm apart: neither levels nor the interpolation between samples makes a phase steeper."""
    design = load_design(ROOT / "layouts" / "rgb_metalens.toml")
    design = replace(design, device=replace(design.device, aperture_um=12.0), light=())

    def told(pitch_um: float, phase: FloatArray, angle_deg: float = 0.0) -> bool:
        np.save(tmp_path / "own.npy", np.broadcast_to(phase, (phase.size, phase.size)))
        array = terms.UserArray(file=tmp_path / "own.npy", pitch_um=pitch_um)
        both = replace(design, phase=(array, terms.Grating(angle_deg=angle_deg)))
        return bool(too_steep(Job(both, tmp_path)))

    fine_um = (np.arange(300) - 149.5) * 0.04
    turn = 2.0 * np.pi
    levels = np.floor(8.0 * fine_um / 2.0) * turn / 8.0  # a turn in 2 um, by an eighth every 250 nm
    assert not told(0.04, np.mod(levels, turn))
    outlines = np.where(np.mod(fine_um, 4.0) < 2.0, 0.0, np.pi)
    assert not told(0.04, outlines, angle_deg=26.0)  # half of the steepest
    for pitch_um in (0.1, 0.2, 0.24):
        x_um = (np.arange(round(12.0 / pitch_um) + 1) - 0.5 * round(12.0 / pitch_um)) * pitch_um
        for share, is_told in ((0.97, False), (1.03, True)):
            assert told(pitch_um, np.mod(share * np.pi / 0.3 * x_um, turn)) is is_told


def test_pixels_too_coarse_for_the_aperture_are_refused_before_any_work(tmp_path: Path) -> None:
    design = load_design(ROOT / "layouts" / "tio2_metalens.toml")
    coarse = replace(design, sensor=replace(design.sensor, pixel_um=0.5))
    with pytest.raises(InputError, match=r"`sensor\.pixel_um`: expected below 0\.44"):
        PREFLIGHT.work(Job(coarse, tmp_path))
    assert isinstance(PREFLIGHT.work(Job(design, tmp_path)), PreflightFigures)


@pytest.mark.parametrize(
    ("table", "settings", "field", "got"),
    [
        ("rules", {"max_aspect_ratio": 1.0}, "rules.max_aspect_ratio", "1"),
        ("mask", {"bias_nm": 300.0}, "rules.min_gap_nm", "100 nm"),
        ("mask", {"bias_nm": -300.0}, "rules.min_feature_nm", "100 nm"),
        ("mask", {"database_unit_nm": 3.5}, "mask.database_unit_nm", "3.5 nm"),
    ],
)
def test_rules_that_no_pillar_keeps_are_told_in_the_values_of_the_design(
    table: str, settings: dict[str, float], field: str, got: str
) -> None:
    design = load_design(ROOT / "layouts" / "helix_small.toml")
    unfit = replace(design, **{table: replace(getattr(design, table), **settings)})
    with pytest.raises(InputError) as refused:
        preflight(unfit)
    assert {(fault.field, fault.got) for fault in refused.value.faults} == {(field, got)}


def test_a_step_of_sizes_does_not_matter_to_a_single_size_nor_to_turned_pillars() -> None:
    design = load_design(ROOT / "layouts" / "helix_small.toml")
    unit = replace(design.mask, database_unit_nm=3.5)
    preflight(replace(design, mask=unit), turned=True)
    sweep = replace(design.unit_cell.sweep, width_nm=(140.0, 140.0), length_nm=(210.0, 210.0))
    preflight(replace(design, mask=unit, unit_cell=replace(design.unit_cell, sweep=sweep)))


def test_sizes_whose_step_fits_the_unit_are_refused_where_the_smallest_does_not() -> None:
    """Half of 101 nm is no whole number of nanometres; the library would be built before the mapping refuses it."""
    design = load_design(ROOT / "layouts" / "helix_small.toml")
    cell = design.unit_cell
    odd = replace(cell, sweep=replace(cell.sweep, width_nm=(101.0, 201.0), length_nm=(101.0, 201.0), size_grid_nm=2.0))
    with pytest.raises(InputError, match="such as 101 nm, got 1 nm"):
        preflight(replace(design, unit_cell=odd, mask=replace(design.mask, database_unit_nm=1.0)))


def test_the_field_of_round_pillars_cannot_be_inverted() -> None:
    design = load_design(ROOT / "layouts" / "rgb_metalens.toml")
    assert design.unit_cell.cell.shape == "circle"
    with pytest.raises(InputError, match="got pillars of shape 'circle'"):
        preflight(replace(design, mask=replace(design.mask, tone="inverted")))


def test_a_stop_smaller_than_two_pillars_is_refused() -> None:
    """0.18 millimetres, given in micrometres' place, would pass no light."""
    design = load_design(ROOT / "layouts" / "helix_small.toml")
    with pytest.raises(InputError, match=r"optics.stop_um.*got 0.18; is it in micrometres"):
        replace(design, optics=Optics(stop_um=0.18))
