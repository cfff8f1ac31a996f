"""PSFs of helix terms."""

from __future__ import annotations

import numpy as np

from metafab.phase import DoubleHelixPhase, Pupil
from metafab.phase.pupil import FocalPlane, pupil_field

COARSE = Pupil(64)


def test_a_double_helix_has_two_equal_lobes_that_turn() -> None:
    plane = FocalPlane(COARSE, 14.0)
    field = pupil_field(DoubleHelixPhase(radius_um=1.0, waist=0.35, modes=5), COARSE, 1.0)
    psf = plane.psf(field, np.linspace(-7.0, 7.0, 15))
    np.testing.assert_allclose(psf, psf[:, ::-1, ::-1], atol=1e-12)
    v = plane.axis
    # Orientation of the long axis from second moments of the squared intensity, which the lobes dominate.
    weight = psf**2
    xx, yy = (weight * v[None, None, :] ** 2).sum((1, 2)), (weight * v[None, :, None] ** 2).sum((1, 2))
    xy = (weight * v[None, None, :] * v[None, :, None]).sum((1, 2))
    turn_deg = np.degrees(np.unwrap(np.arctan2(2.0 * xy, xx - yy)) / 2.0)
    assert (np.diff(turn_deg) < 0.0).all()
    assert turn_deg[0] - turn_deg[-1] > 120.0
