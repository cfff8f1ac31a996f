"""Point-spread functions of the beam against their laws."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.exposure import BeamPsf, BeamTerm, beam_psf
from metafab.exposure.electrons.process import PRESETS
from metafab.spec.mask import ExposureProcess
from tests.physics.exposure.conftest import BEAM


def test_density_of_a_power_law_is_the_power_law() -> None:
    """Gaussian mixture against (1 + r^2 / g^2)^(-nu / 2) over three decades of radius."""
    gamma, exponent = 30.0, 3.4
    beam = BeamPsf.of([BeamTerm("power", 1.0, gamma, exponent)], "assumption")
    radius = np.geomspace(1.0, 3000.0, 40)
    law = (exponent - 2.0) / (2.0 * math.pi * gamma**2) * (1.0 + (radius / gamma) ** 2) ** (-0.5 * exponent)
    np.testing.assert_allclose(beam.density(radius), law, rtol=2e-3)


def test_a_blur_of_a_gaussian_is_a_wider_gaussian() -> None:
    beam = BeamPsf.of([BeamTerm("gauss", 1.0, 12.0)], "assumption").blurred(5.0)
    assert beam.range_nm[0] == pytest.approx(13.0)


def test_a_table_is_fitted() -> None:
    """The energy within any radius is kept within 5 %: rings of the table are a fifth of their radius wide."""
    radius = np.geomspace(1.0, 6e4, 60)
    beam = BeamPsf.fitted(radius, BEAM.density(radius), "table")
    assert beam.fit_error < 0.05
    assert beam.weight.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("radius", [np.linspace(10.0, 2e4, 2000), np.geomspace(1.0, 2e4, 1500)], ids=["even", "log"])
def test_a_fine_table_that_ends_at_once_is_fitted(radius: np.ndarray) -> None:
    """A disc. No ring of the even table holds 1e-3 of the energy; the stated error holds beyond the tables, too."""
    beam = BeamPsf.fitted(radius, np.ones(radius.size), "table")
    assert 0.0 < beam.fit_ratio[0] < 1.0 < beam.fit_ratio[1] < 2.5
    beyond = np.geomspace(2.1e4, 2e5, 50)[:, None]
    missed = 1.0 - (1.0 - np.exp(-((beyond / beam.range_nm) ** 2))) @ beam.weight
    assert np.abs(missed).max() < beam.fit_error < 0.25


def test_negative_weights_must_leave_a_density() -> None:
    """A ring of a Gaussian less a narrower one; more than its density on the axis is refused."""
    wide = BeamTerm("gauss", 1.0, 5000.0)
    beam = BeamPsf.of([wide, BeamTerm("gauss", -0.15, 2000.0)], "assumption")
    assert beam.density(np.zeros(1)) > 0.0
    with pytest.raises(InputError, match="nowhere negative"):
        BeamPsf.of([wide, BeamTerm("gauss", -0.5, 2000.0)], "assumption")


def test_terms_of_a_preset_are_taken_as_they_are_listed() -> None:
    """``psf.terms`` of ``metafab expose --json``, negative weights included."""
    for name in PRESETS:
        psf = beam_psf(ExposureProcess(preset=name))
        terms = [BeamTerm("gauss", float(w), float(b)) for w, b in zip(psf.weight, psf.range_nm, strict=True)]
        np.testing.assert_allclose(BeamPsf.of(terms, "assumption").weight, psf.weight, rtol=1e-12)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_normalised_and_name_their_source(name: str) -> None:
    """The energy within any radius is that of the table to 1.1 %; that of rings with 1e-3 of it to -20 and +55 %."""
    psf = beam_psf(ExposureProcess(preset=name))
    assert psf.weight.sum() == pytest.approx(1.0)
    assert psf.fit_error < 0.011
    assert 0.8 < psf.fit_ratio[0] < 1.0 < psf.fit_ratio[1] < 1.55
    assert psf.source.startswith("Monte Carlo by metafab: ")
    assert "assumed" in psf.source


def test_an_unknown_preset_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="hsq_sos_100kv"):
        beam_psf(ExposureProcess(preset="unknown"))


def test_one_function_is_asked() -> None:
    with pytest.raises(ValueError, match="one of"):
        ExposureProcess()


RADIUS_NM = np.geomspace(1.0, 6e4, 60)


def write_table(path: Path, header: str, columns: tuple[np.ndarray, np.ndarray], separator: str) -> Path:
    rows = [f"{a:.9g}{separator}{b:.9g}" for a, b in zip(*columns, strict=True)]
    path.write_text(header + "\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "separator", "unit_nm"),
    [
        ("radius_nm,density\n", ",", 1.0),
        ("CASINO v2.5.1\nRadial energy\nDistance (nm)\tEnergy (keV)\n", "\t", 1.0),
        ("# point-spread function\n# radius [um]   energy\n", "   ", 1e3),
    ],
)
def test_tables_of_other_programs_are_read(header: str, separator: str, unit_nm: float, tmp_path: Path) -> None:
    """Commas, tabs and spaces; lines of headers; the unit that the header names."""
    columns = (RADIUS_NM / unit_nm, BEAM.density(RADIUS_NM))
    path = write_table(tmp_path / "psf.txt", header, columns, separator)
    read = beam_psf(ExposureProcess(table_file=path, blur_nm=0.0))
    expected = BeamPsf.fitted(RADIUS_NM, BEAM.density(RADIUS_NM), "")
    np.testing.assert_allclose(read.range_nm, expected.range_nm, rtol=1e-6)


def test_the_first_row_behind_a_byte_order_mark_is_no_header(tmp_path: Path) -> None:
    """Spreadsheets begin a file with the mark; eight rows are the least that a fit takes."""
    rows = "".join(f"{radius:g},{math.exp(-((radius / 50.0) ** 2)):g}\n" for radius in range(10, 90, 10))
    read = []
    for encoding in ("utf-8", "utf-8-sig"):
        path = tmp_path / f"{encoding}.csv"
        path.write_text(rows, encoding=encoding)
        read.append(beam_psf(ExposureProcess(table_file=path, table_unit="nm", blur_nm=0.0)))
    np.testing.assert_array_equal(read[1].range_nm, read[0].range_nm)


def test_energies_of_rings_become_densities(tmp_path: Path) -> None:
    """Rings of one Gaussian hold 1 - exp(-r^2 / range^2) in all; fitted ranges are a factor of 1.5 apart."""
    radius = np.linspace(2.0, 200.0, 100)
    within = 1.0 - np.exp(-((np.concatenate([[0.0], radius]) / 50.0) ** 2))
    path = write_table(tmp_path / "rings.txt", "r (nm) E\n", (radius, np.diff(within)), " ")
    read = beam_psf(ExposureProcess(table_file=path, table_energy="ring", blur_nm=0.0))
    assert read.fit_error < 0.02
    half = np.log(2.0) ** 0.5 * 50.0
    share = float((read.weight * (1.0 - np.exp(-((half / read.range_nm) ** 2)))).sum())
    assert share == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("radius,density\n1,1\n2,1\n", "table_unit"),
        ("radius_nm\n1 1\nnothing\n", "line 3"),
        ("radius_nm\n1\n", "line 2"),
        ("radius_nm\n", "no row"),
        ("radius_nm,density\n1,1\n2,1\n", "at least 8 rows"),
    ],
)
def test_tables_that_cannot_be_read(text: str, named: str, tmp_path: Path) -> None:
    path = tmp_path / "psf.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=named):
        beam_psf(ExposureProcess(table_file=path))


def test_a_beam_out_of_focus_is_as_wide_as_its_cone() -> None:
    """Rms radius of an evenly filled disc of 10 mrad times 2 um, 20 nm, from its own integral."""
    process = ExposureProcess(terms=BEAM.terms, blur_nm=5.0, convergence_mrad=10.0, best_focus_um=-0.5)
    radius = np.linspace(0.0, 20.0, 2001)
    mean_square = np.trapezoid(radius**3, radius) / np.trapezoid(radius, radius)
    assert beam_psf(process, 1.5).blur_nm == pytest.approx(np.sqrt(5.0**2 + mean_square), rel=1e-6)
    assert beam_psf(process, 1.5).blur_nm == beam_psf(process, -2.5).blur_nm
    assert beam_psf(process, -0.5).blur_nm == beam_psf(process).blur_nm == 5.0


def test_keys_of_a_table_need_a_table() -> None:
    with pytest.raises(ValueError, match="belong to `table_file`"):
        ExposureProcess(preset="hsq_sos_100kv", table_unit="um")
