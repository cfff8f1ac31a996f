"""Zernike polynomials against tables."""

from __future__ import annotations

import numpy as np

from metafab.phase import (
    ZernikePhase,
)

X_UM = np.linspace(-90.0, 80.0, 23)
Y_UM = np.linspace(-70.0, 95.0, 17)
RADIUS_UM = 100.0


def test_zernike_polynomials_are_those_of_the_tables() -> None:
    x, y = X_UM[None, :] / RADIUS_UM, Y_UM[:, None] / RADIUS_UM
    u2 = x**2 + y**2
    for (degree, order), expected in {
        (1, 1): x + 0 * y,
        (1, -1): y + 0 * x,
        (2, 0): 2 * u2 - 1,
        (2, -2): 2 * x * y,
        (3, 1): (3 * u2 - 2) * x,
        (4, 0): 6 * u2**2 - 6 * u2 + 1,
        (4, 2): (4 * u2 - 3) * (x**2 - y**2),
    }.items():
        phase = ZernikePhase(degree, order, 0.7, RADIUS_UM)(X_UM, Y_UM, "x")
        np.testing.assert_allclose(phase, 0.7 * expected, atol=1e-13)
