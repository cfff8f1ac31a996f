"""Rim defocus and paraxial images of a pupil against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.phase import Pupil
from metafab.phase.pupil import FocalPlane, rim_defocus_per_dioptre_rad, rim_defocus_rad


def test_rim_defocus_is_half_k_radius_squared_times_vergence() -> None:
    assert rim_defocus_per_dioptre_rad(1000.0, 0.8) == pytest.approx(0.5 * 2 * math.pi / 0.8e-6 * 1e-6, rel=1e-12)
    assert rim_defocus_rad(0.30, 0.30, 1000.0, 0.8) == 0.0
    # The exact excess path of a near point over the rim, less that of the point in focus; next order (R / z)^2 / 4.
    exact = 2 * math.pi / 0.8 * ((math.hypot(0.25e6, 1e3) - 0.25e6) - (math.hypot(0.30e6, 1e3) - 0.30e6))
    assert rim_defocus_rad(0.25, 0.30, 1000.0, 0.8) == pytest.approx(exact, rel=2e-5)


def test_a_clear_circular_pupil_has_the_airy_pattern() -> None:
    from scipy.special import j1

    pupil = Pupil(256)
    plane = FocalPlane(pupil, 8.0)
    psf = plane.psf(np.ones(pupil.count, dtype=complex), 0.0)[0]
    v = np.hypot(plane.axis[:, None], plane.axis[None, :])
    airy = np.where(v > 0, (2 * j1(np.maximum(v, 1e-9)) / np.maximum(v, 1e-9)) ** 2, 1.0)
    # A circle of square samples has a rim that is wrong by up to half a sample here and there: 1 / 256.
    np.testing.assert_allclose(psf, airy, atol=1.0 / 256)


def test_defocus_without_a_helix_dims_the_centre_as_a_sinc() -> None:
    pupil = Pupil(256)
    peak = FocalPlane(pupil, 0.3).psf(np.ones(pupil.count, dtype=complex), [0.0, 3.0, 5.0])[:, 1, 1]
    np.testing.assert_allclose(peak, np.sinc(np.array([0.0, 3.0, 5.0]) / (2 * math.pi)) ** 2, atol=1.0 / 256)
