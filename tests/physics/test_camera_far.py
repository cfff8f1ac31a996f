"""Five centimetres at two hundred metres, by the pupil: turn and resolution against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.phase import propose


def test_five_centimetres_tell_depth_from_100_to_300_m() -> None:
    found = propose(100.0, 300.0, aperture_um=50000.0, wavelength_um=0.8, zones=[5], exponents=[0.5])[0]
    assert found.rotation_deg_per_dioptre == pytest.approx(-225.0 / 5 * 25.0**2, rel=1e-3)
    # A plain spiral's lobe swings about the law by some degrees.
    law_deg = 225.0 / 5 * 25.0**2 * (1.0 / 100.0 - 1.0 / 300.0)
    assert found.rotation_deg == pytest.approx(law_deg, abs=4.0)
    assert (np.diff(found.phi_deg) > 0.0).all()
    assert found.focus_depth_m == pytest.approx(150.0)
    # The paper's aperture at 1/625 of the depths is the same pupil: all bounds in proportion.
    small = propose(0.16, 0.48, aperture_um=2000.0, wavelength_um=0.8, zones=[5], exponents=[0.5])[0]
    np.testing.assert_allclose(found.crlb_m, 625.0 * small.crlb_m, rtol=1e-9)
    # A radian of defocus at the rim is the scale of what can be resolved: lambda z^2 / (pi R^2) = 16 m at 200 m.
    at_200_m = float(np.interp(200.0, found.depth_m, found.crlb_m))
    radian_m = 0.8e-6 / (np.pi * 0.025**2) * 200.0**2
    assert 1e-3 * radian_m < at_200_m < 0.1 * radian_m
