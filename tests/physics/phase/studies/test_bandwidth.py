"""Cost of the colour filter: dispersion, smear, and the trade-off between light and smear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.core.conventions import sensor_distance_um
from metafab.information.texture import Texture
from metafab.phase import Pupil, bandwidth_budget
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.pupil import rim_defocus_rad
from metafab.phase.studies.bandwidth import SplitImaging, bandwidth_tradeoff, smear_um_per_nm
from metafab.phase.terms.helices import spiral_field

PUPIL = Pupil(32)


@pytest.fixture(scope="module")
def imaging() -> SplitImaging:
    defocus = rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.34, 3), 0.30, 1000.0, 0.8)
    distance_um = sensor_distance_um(20.0, 8.0, 0.30)
    return SplitImaging(PUPIL, spiral_field(PUPIL, 4, 0.5), defocus, 2000.0, 20.0, distance_um, 0.8, Texture(), 4.0)


def test_the_budget_of_the_papers_lens(imaging: SplitImaging) -> None:
    budget = bandwidth_budget(imaging, 8.0)
    assert budget.dispersion_um_per_nm == pytest.approx(3.8, rel=0.01)
    assert budget.smear_um == pytest.approx(4.0 * budget.dispersion_um_per_nm, rel=1e-9)
    assert 0.0 < budget.kept < 1.0
    # The design's own azimuth is the first, and its own cell of the curves.
    assert budget.kept_by_azimuth[0] == pytest.approx(budget.kept, rel=1e-9)
    errors = [remedy.depth_error_factor for remedy in budget.remedies]
    assert errors == sorted(errors) and all(error < 1.0 for error in errors)
    assert any(remedy.change == "a split of 2 degrees" for remedy in budget.remedies)
    for remedy in budget.remedies:
        # At the same electrons the deviation goes with one over the root of the information.
        if not remedy.change.startswith("a filter"):
            assert remedy.depth_error_factor == pytest.approx((budget.kept / remedy.information_kept) ** 0.5, rel=1e-9)


def test_turning_mask_and_split_together_changes_nothing(imaging: SplitImaging) -> None:
    """Only the direction of the split against the mask counts: a mask turned by 90 degrees, exact on a square grid."""
    grid = np.zeros(PUPIL.inside.shape, dtype=complex)
    grid[PUPIL.inside] = imaging.mask
    turned = replace(imaging, mask=np.rot90(grid, -1)[PUPIL.inside])  # rows are y upwards: counter-clockwise
    before = imaging.filtered(4.0, [(8.0, 0.0), (8.0, 30.0)])
    after = turned.filtered(4.0, [(8.0, 90.0), (8.0, 120.0)])
    np.testing.assert_allclose(after, before, rtol=1e-6)  # one-sided Nyquist frequency of an even grid


PUPIL = Pupil(32)
DEFOCUS_RAD = rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.6, 4), 0.30, 1000.0, 0.8)


def test_the_papers_carrier_spreads_3_8_um_a_nanometre() -> None:
    distance_um = sensor_distance_um(20.0, 8.0, 0.30)
    assert smear_um_per_nm(distance_um, 8.0, 0.8) == pytest.approx(3.8, rel=0.005)
    # Against the grating equation itself, by differences.
    sine = np.sin(np.radians(8.0))
    places = [distance_um * np.tan(np.arcsin(sine * wavelength / 800.0)) for wavelength in (799.9, 800.1)]
    assert smear_um_per_nm(distance_um, 8.0, 0.8) == pytest.approx((places[1] - places[0]) / 0.2, rel=1e-6)


def test_smear_alone_multiplies_the_transfer_function_by_a_sinc() -> None:
    """With a lens of no power (infinite focal length) a flat filter is a box along the split."""
    field = spiral_field(PUPIL, 4, 0.5)
    imaging = SplitImaging(PUPIL, field, DEFOCUS_RAD, 2000.0, 1e12, 21220.0, 0.8)
    result = bandwidth_tradeoff(imaging, fwhm_nm=5.0, angle_deg=[4.0, 8.0])
    problem = BlindInformation(PUPIL, DEFOCUS_RAD, Texture())
    transfer, slope = problem.transfer(field)
    snr = Texture().signal_to_noise((64, 64))
    nyquist_um = 0.8 * 21220.0 / 4000.0
    for row in (0, 1):
        box = np.sinc(np.fft.fftfreq(64)[None, :] * result.smear_um[row, 0] / nyquist_um)
        turn = (slope * transfer.conj()).imag * box**2
        density = 4.0 * (snr * turn) ** 2 / (1.0 + 2.0 * snr * np.abs(transfer * box) ** 2)
        expected = density.sum(axis=(1, 2)).mean() / problem.of_field(field).mean()
        assert result.kept[row, 0] == pytest.approx(expected, rel=1e-6)  # Gauss-Legendre converges geometrically


def test_information_falls_with_width_and_angle_and_returns_at_one_wavelength() -> None:
    imaging = SplitImaging(PUPIL, spiral_field(PUPIL, 4, 0.5), DEFOCUS_RAD, 2000.0, 20.0, 21220.0, 0.8)
    result = bandwidth_tradeoff(imaging, fwhm_nm=[0.01, 1.0, 5.0, 10.0], angle_deg=[0.0, 4.0, 8.0])
    np.testing.assert_allclose(result.kept[:, 0], 1.0, atol=1e-4)
    assert (np.diff(result.kept, axis=0) < 0.0)[:, 1:].all()
    assert (np.diff(result.kept, axis=1) < 0.0).all()
    assert result.smear_um[2, 3] == pytest.approx(38.0, rel=0.01)
    # More light, less of it useful: with the photons of its width, a filter of 0.01 nm is never the best.
    assert (np.argmin(result.relative_error, axis=1) > 0).all()
