"""The choice of [L, epsilon], and the budget of bandwidth."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import sensor_distance_um
from metafab.core.errors import InputError
from metafab.information.texture import Texture
from metafab.phase import Pupil, propose
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.pupil import rim_defocus_rad
from metafab.phase.studies.bandwidth import SplitImaging, bandwidth_tradeoff, smear_um_per_nm
from metafab.phase.terms.helices import spiral_field

PUPIL = Pupil(32)
DEFOCUS_RAD = rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.6, 4), 0.30, 1000.0, 0.8)


def test_proposals_turn_once_at_most_and_are_ordered_by_their_bound() -> None:
    found = propose(0.25, 0.60, aperture_um=2000.0, wavelength_um=0.8)
    assert [p.relative_error for p in found] == sorted(p.relative_error for p in found)
    for proposal in found:
        assert 0.0 < proposal.rotation_deg <= 330.0
        assert proposal.depth_m.shape == proposal.crlb_m.shape
        assert proposal.depth_m[[0, -1]] == pytest.approx([0.25, 0.60])
        if proposal.exponent == 0.5 and proposal.zones >= 4:
            span = 1.0 / 0.25 - 1.0 / 0.60
            # The plain spiral's lobe swings about the law by some degrees.
            assert proposal.rotation_deg == pytest.approx(-proposal.rotation_deg_per_dioptre * span, abs=4.0)
            assert proposal.full_turn_dioptre == pytest.approx(1.6 * proposal.zones, rel=1e-3)


def test_the_bound_scales_with_aperture_squared_over_distance() -> None:
    """Rim defocus goes with R^2 / z: the same helix, ten times the aperture, a hundred times the depths."""
    near = propose(0.25, 0.60, aperture_um=2000.0, wavelength_um=0.8, zones=[4], exponents=[0.5])[0]
    far = propose(25.0, 60.0, aperture_um=20000.0, wavelength_um=0.8, zones=[4], exponents=[0.5])[0]
    np.testing.assert_allclose(far.crlb_m, 100.0 * near.crlb_m, rtol=1e-9)


def test_more_electrons_help_and_read_noise_hurts() -> None:
    errors = [
        propose(0.25, 0.6, aperture_um=2000.0, wavelength_um=0.8, zones=[4], exponents=[0.5], texture=t)[
            0
        ].relative_error
        for t in (Texture(electrons=1e4), Texture(), Texture(read_noise_e=50.0))
    ]
    assert errors[0] < errors[1] < errors[2]


def test_ranges_that_cannot_be_served_are_refused() -> None:
    with pytest.raises(InputError, match="nearest < farthest"):
        propose(0.6, 0.25, aperture_um=2000.0, wavelength_um=0.8)
    with pytest.raises(InputError, match="allow L >= "):
        propose(0.05, 10.0, aperture_um=2000.0, wavelength_um=0.8, zones=[2, 3])


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
    assert set(result.best_fwhm_nm) <= set(result.fwhm_nm)
    # More light, less of it useful: with the photons of its width, a filter of 0.01 nm is never the best.
    assert (result.best_fwhm_nm > 0.01).all()
