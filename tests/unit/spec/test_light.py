"""Several wavelengths of one design: what is refused, and the design of each alone."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.optics import load
from metafab.spec import Design, Light
from metafab.spec.cell import Axes
from metafab.spec.device import Optics
from metafab.spec.terms import Lens
from tests.main_job import SMALL, metafab

OWN, OTHER = Light(800.0), Light(700.0)
SAMPLE_CELL = Path("unitcell_lib/tio2_532nm.toml")


def test_several_lights_are_checked(small_design: Design) -> None:
    assert replace(small_design, light=(OTHER, OWN)).light[0].weight == 1.0
    for lights in ((OWN,), (OTHER,), (OWN, OWN), (OTHER, Light(750.0))):
        with pytest.raises(
            InputError, match="two or more different wavelengths or directions, the 800 nm of the unit cell"
        ):
            replace(small_design, light=lights)
    with pytest.raises(InputError, match=r"leave out `light\.phase`"):
        replace(small_design, light=(OTHER, Light(800.0, phase=(Lens(),))))
    with pytest.raises(InputError, match=r"not available with `rules\.gap_rule"):
        replace(small_design, light=(OTHER, OWN), rules=replace(small_design.rules, gap_rule="pairs"))
    with pytest.raises(InputError, match=r"not available with `optics\.neighbours`"):
        replace(small_design, light=(OTHER, OWN), optics=Optics(neighbours=True))
    with pytest.raises(InputError, match=r"not available with `optics\.oblique`"):
        replace(small_design, light=(OTHER, OWN), optics=Optics(oblique=True))
    with pytest.raises(InputError, match=r"`optics\.oblique` needs a `scene`"):
        replace(small_design, scene=None, optics=Optics(oblique=True))
    with pytest.raises(InputError, match="phase"):
        Light(700.0, phase=())


def test_light_at_an_angle_needs_an_axis_of_the_library(small_design: Design) -> None:
    slanting = Light(800.0, angle_x_deg=-6.0)
    assert slanting.label == "800 nm, -6 deg in x-z"
    with pytest.raises(InputError, match=r"needs a `sweep\.axes\.angle_x_deg` that holds 6, got none"):
        replace(small_design, light=(OWN, slanting))
    cell = small_design.unit_cell
    swept = replace(cell, sweep=replace(cell.sweep, axes=Axes(angle_x_deg=(0.0, 8.0))), neighbours=None)
    design = replace(small_design, unit_cell=swept, light=(OWN, slanting, Light(800.0, angle_x_deg=6.0)))
    assert design.at_light(slanting).unit_cell == swept
    for light, message in (
        (Light(800.0, angle_x_deg=9.0), r"holds 9, got \[0, 8\]"),
        (Light(700.0, angle_x_deg=5.0), "`sweep.axes.wavelength_nm` that holds 700, got none"),
        (Light(800.0, angle_y_deg=5.0), "`sweep.axes.angle_y_deg`"),
        (slanting, "different wavelengths or directions"),
    ):
        with pytest.raises(InputError, match=message):
            replace(design, light=(OWN, slanting, light))


def test_a_light_has_its_wavelength_and_its_own_phase(small_design: Design) -> None:
    design = replace(small_design, light=(OWN, OTHER, Light(650.0, phase=(Lens(),))))
    first, second, third = (design.at_light(light) for light in design.light)
    assert first == small_design
    assert second.wavelength_um == pytest.approx(0.7)
    assert second.phase == small_design.phase
    assert third.phase == (Lens(),)
    assert third.light == ()


def test_a_psf_at_a_wavelength_that_the_design_does_not_serve_is_refused() -> None:
    answer = metafab("psf", "--ideal", "--design", SMALL, "--wavelength-nm", "700")
    assert answer.code == 2
    assert "`light` tables (it has none)" in answer.stderr


def test_a_psf_of_slanting_light_is_asked_for_by_its_direction(tmp_path: Path) -> None:
    """The window lies where a ray through the middle of the lens lands: it leaves glass of 1.461 at 10 degrees."""
    cell = SAMPLE_CELL.read_text().replace("[solver]", "[sweep.axes]\nangle_x_deg = [0.0, 10.0]\n\n[solver]")
    (tmp_path / "cell.toml").write_text(cell)
    lens = (
        'name = "wide"\nlibrary = "cell.toml"\n[device]\naperture_um = 20.0\nfocal_length_mm = 0.05\n'
        '[[phase]]\nterm = "lens"\n[[light]]\nwavelength_nm = 532.0\n'
        "[[light]]\nwavelength_nm = 532.0\nangle_x_deg = 10.0\n[[light]]\nwavelength_nm = 600.0\n"
        '[rules]\n[mask]\nformats = ["oas"]\n[sensor]\npixel_um = 0.25\nfocus_depth_m = 1000.0\n'
        "[verify]\ndepths_m = [1000.0]\n"
    )
    (tmp_path / "wide.toml").write_text(lens)
    ask = ("psf", "--ideal", "--design", tmp_path / "wide.toml", "--json", "-o", tmp_path / "psf.h5")
    answer = metafab(*ask, "--angle-deg", "10", "0")
    assert answer.code == 0, answer.stderr
    centre_um = load(tmp_path / "psf.h5").centre_um[0, 0]
    sine = 1.461 * math.sin(math.radians(10.0))
    assert centre_um == pytest.approx([50.0 * sine / math.sqrt(1.0 - sine**2), 0.0], rel=1e-3, abs=1e-3)
    # Another wavelength leaves an object where it stands.
    answer = metafab(*ask, "--wavelength-nm", "600", "--object-mm", "1e5", "0")
    assert answer.code == 0, answer.stderr
    assert load(tmp_path / "psf.h5").centre_um[0, 0] == pytest.approx([-5.0, 0.0], abs=0.01)
    refused = metafab(*ask, "--angle-deg", "5", "0")
    assert refused.code == 2
    assert "532 nm; 532 nm, 10 deg in x-z" in refused.stderr and "got 532 nm, 5 deg in x-z" in refused.stderr
