"""Devices of one's own, from unit cell to the light of the written mask: a metalens of circles, a splitter, a hologram.

Their libraries are coarser than those of the samples, which take minutes; the figures tested do not depend on them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from metafab.fullwave import repeats
from metafab.optics import load
from metafab.optics.geometry.polarisation import FocusIntegrals
from metafab.phase import profile_of
from metafab.run import run
from metafab.spec import Design, load_design, write_new
from metafab.spec.terms import Picture
from metafab.steps import RESULT_STEPS
from metafab.steps.job import Job
from metafab.steps.optics import mask_source
from tests.main_job import ROOT


def _small(design: Design, folder: Path, *, step_nm: float, sizes_nm: tuple[float, float], **device: float) -> Design:
    """The design with a coarse library of its own."""
    cell = design.unit_cell
    sweep = replace(cell.sweep, width_nm=sizes_nm, length_nm=sizes_nm, size_grid_nm=step_nm, target_error=0.1)
    return replace(
        design,
        library=folder / "cell.toml",
        unit_cell=replace(cell, sweep=sweep),
        device=replace(design.device, **device),
        mask=replace(design.mask, formats=("oas",)),
    )


@pytest.mark.slow
def test_a_metalens_of_circles_focuses_at_the_vectorial_limit(tmp_path: Path) -> None:
    design = load_design(ROOT / "layouts" / "tio2_metalens.toml")
    # A third of the aperture at the same NA.
    device = {"aperture_um": 33.0, "focal_length_mm": 0.0666667 * 0.33}
    small = _small(design, tmp_path, step_nm=10.0, sizes_nm=(70.0, 240.0), **device)
    merit = run(small, tmp_path / "run").merit
    assert merit is not None
    assert merit.focus is not None
    radius = np.linspace(0.0, 1.0, 1001)
    field = FocusIntegrals.at(radius, 0.6)
    curve = field.i_0**2 + field.i_2**2 + 0.5 * field.i_1**2
    below = int(np.flatnonzero(curve < 0.5 * curve[0])[0])
    limit_um = 2.0 * 0.532 * float(np.interp(0.5 * curve[0], curve[[below, below - 1]], radius[[below, below - 1]]))
    assert [merit.fwhm_x_um, merit.fwhm_y_um, merit.fwhm_limit_um] == pytest.approx([limit_um] * 3, rel=0.01)
    assert merit.strehl is not None
    assert 0.8 < merit.strehl <= 1.001
    assert merit.relative_peak_x is not None and merit.relative_peak_x[0] < merit.strehl
    # Circles: both polarisations alike.
    (x_x, x_y), (y_x, y_y) = merit.focus.fwhm_polarised_um
    assert (x_x, x_y) == pytest.approx((y_y, y_x), rel=2e-3)
    assert all(math.isnan(ratio) for ratio in merit.extinction_ratio)
    # Per transmitted power, no lens transfers more than its limit; rings of the spectrum err by 2e-3.
    assert (merit.modulation.pair_x - merit.modulation.lens).max() < 5e-3
    # A window beside the focus has no peak and no modulation to compare.
    aside = replace(small, verify=replace(small.verify, centre_um=(60.0, 0.0)))
    missed = run(aside, tmp_path / "run").merit
    assert missed is not None
    assert missed.relative_peak_x is None and missed.relative_peak_y is None
    assert np.isnan(missed.modulation.pair_x).all() and np.isfinite(missed.modulation.lens).all()


@pytest.mark.slow
def test_a_splitter_by_a_phase_file_deflects_as_its_file_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    design = load_design(ROOT / "layouts" / "silicon_splitter.toml")
    monkeypatch.setattr(repeats, "_WINDOWS", 1)
    small = _small(design, tmp_path, step_nm=40.0, sizes_nm=(100.0, 580.0))
    summary = run(small, tmp_path / "run")
    assert summary.psf is not None
    assert summary.psf.light_at_um is None
    psf = load(tmp_path / "run" / "psf.h5")
    job = Job(small, tmp_path / "run")
    source = mask_source(job, tmp_path / "run" / "layout.oas")
    (field,), x_um = list(source.tiles()), source.lattice.x_um()
    sines = np.sin(np.radians(np.linspace(5.0, 15.0, 5001)))
    for p, angle_deg in ((0, 10.0), (1, -10.0)):
        # Far field along x: the direction of its maximum.
        line = field.amplitude(p).sum(axis=0)
        far = np.abs(np.exp(-2j * np.pi / 1.55 * np.outer(math.copysign(1.0, angle_deg) * sines, x_um)) @ line)
        found_deg = math.degrees(math.asin(sines[int(np.argmax(far))]))
        # The beam of 60 um is 1.5 degrees wide. Errors of phase and transmission of the 169 sizes move its maximum by
        # 0.0185 degrees at most, those of 81 sizes by 0.047.
        assert found_deg == pytest.approx(abs(angle_deg), abs=0.02)
        # The window stands where the file's mean slope sends the light.
        place_um = psf.sensor_distance_um * math.tan(math.radians(angle_deg))
        assert psf.centre_um[p, 0] == pytest.approx([place_um, 0.0], abs=0.02)
    assert min(summary.psf.extinction_ratio) > 10.0
    # The first row of 13 pillars by the solver of rows at polynomial order 4, apart from the run; the library says 0.92
    # and 0.91. Means over windows are tested in tests/unit/fullwave/test_repeats.py.
    assert summary.orders is not None and summary.orders.sites == (13, 1) and summary.orders.windows == 1
    for light, expected in (("x", 0.8480), ("y", 0.8759)):
        found, error, by_library = summary.orders.wanted(light)
        assert found == pytest.approx(expected, abs=0.01)
        assert by_library > found + 0.02
        assert error < 0.03


def test_a_hologram_of_ones_own_picture(tmp_path: Path) -> None:
    rows = np.zeros((60, 60))
    rows[10:50, 25:35] = rows[10:20, 15:45] = 255.0
    Image.fromarray(rows.astype(np.uint8)).save(tmp_path / "letter.png")
    design = load_design(write_new("own", "hologram", tmp_path)[0])
    terms = [
        replace(term, file=tmp_path / "letter.png") if isinstance(term, Picture) else term for term in design.phase
    ]

    figures = profile_of(replace(design, phase=tuple(terms))).figures
    assert figures.hologram_efficiency is not None
    assert figures.hologram_correlation is not None
    assert figures.hologram_efficiency > 0.75
    assert figures.hologram_correlation > 0.8


@pytest.mark.slow
def test_a_lens_for_three_colours_focuses_all_of_them(tmp_path: Path) -> None:
    """The sample as it is. Lenses of these pillars for one colour have at least 0.94 there, at most 0.28 elsewhere.

    Its libraries stand beside their unit cell, where the page on several wavelengths builds them too.
    """
    design = load_design(ROOT / "layouts" / "rgb_metalens.toml")
    summary = run(design, tmp_path / "run", steps=RESULT_STEPS)
    assert summary.layout is not None and summary.layout.lights is not None and summary.lights is not None
    built = {path.name for path in design.library.parent.glob("tio2_circles_rgb*.h5")}
    assert built >= {"tio2_circles_rgb.h5", "tio2_circles_rgb_460nm.h5", "tio2_circles_rgb_640nm.h5"}
    mapped = [light.figures.efficiency for light in summary.layout.lights]
    assert mapped == pytest.approx([0.671, 0.850, 0.591], abs=0.01)
    for light, efficiency, wavelength_nm in zip(summary.lights.lights, mapped, (460.0, 540.0, 640.0), strict=True):
        assert light.wavelength_nm == wavelength_nm
        assert light.focus is not None
        assert light.focus.fwhm_x_um == pytest.approx(light.focus.fwhm_limit_um, rel=0.04)
        assert light.focus.fwhm_limit_um == pytest.approx(0.514 * 1e-3 * wavelength_nm / 0.2, rel=0.01)
        # The focus of the file read back holds what the mapping promises; circles serve both polarisations alike.
        assert light.focus.strehl * light.pair.transmitted_x == pytest.approx(efficiency, rel=0.08)
        assert light.pair.efficiency_x == pytest.approx(light.pair.efficiency_y, rel=1e-6)
        assert (tmp_path / "run" / light.file).is_file()
    again = run(design, tmp_path / "run", steps=RESULT_STEPS)
    assert {step.step for step in again.skipped} >= {"library", "layout", "psf", "lights"}
