"""The choice of [L, epsilon] for a range of depths."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.information.texture import Texture
from metafab.phase import propose


def test_proposals_turn_once_at_most_and_are_ordered_by_their_bound() -> None:
    proposals = propose(0.25, 0.60, aperture_um=2000.0, wavelength_um=0.8)
    assert [p.relative_error for p in proposals] == sorted(p.relative_error for p in proposals)
    for proposal in proposals:
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
    with pytest.raises(InputError) as refused:
        propose(0.25, 0.6, aperture_um=-500.0, wavelength_um=0.0)
    assert [fault.field for fault in refused.value.faults] == ["aperture_um", "wavelength_um"]
