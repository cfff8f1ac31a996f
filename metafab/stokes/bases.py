"""Six states of polarisation in three orthogonal pairs, and what a Stokes vector is in the house's conventions.

Fields go with exp(-i omega t) and light travels along +z. Light is right-handed where its field turns clockwise for who
looks into the beam: R = (1, -i) / sqrt 2 in the basis (x, y). The Stokes vector is S0 = I_x + I_y, S1 = I_x - I_y,
S2 = I_(+45) - I_(-45), S3 = I_R - I_L; with the coherency rho = <E E^H>, S2 + i S3 = 2 rho_xy.
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray

#: Names of the six states, orthogonal ones beside each other.
STATES = ("x", "y", "+45", "-45", "R", "L")

#: Jones vectors of the states, shape (6, 2).
JONES: ComplexArray = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [1, -1j], [1, 1j]]) / np.sqrt(
    np.array([1, 1, 2, 2, 2, 2])
)[:, None].astype(np.complex128)


def stokes_of(jones: ComplexArray) -> FloatArray:
    """Stokes vectors, shape (..., 4), of Jones vectors of shape (..., 2)."""
    x, y = jones[..., 0], jones[..., 1]
    cross = 2.0 * x * y.conj()
    power = np.abs(x) ** 2, np.abs(y) ** 2
    return np.stack([power[0] + power[1], power[0] - power[1], cross.real, cross.imag], axis=-1)


def response_of(xx: ComplexArray, xy: ComplexArray, yx: ComplexArray, yy: ComplexArray) -> FloatArray:
    """What a Jones matrix makes of each Stokes parameter: power out = response . S.

    Args:
        xx: E_x behind x polarised light, any shape.
        xy: E_x behind y polarised light.
        yx: E_y behind x polarised light.
        yy: E_y behind y polarised light.

    Returns:
        Shape (4, ...).
    """
    of_x, of_y = np.abs(xx) ** 2 + np.abs(yx) ** 2, np.abs(xy) ** 2 + np.abs(yy) ** 2
    cross = xx * xy.conj() + yx * yy.conj()
    return np.stack([0.5 * (of_x + of_y), 0.5 * (of_x - of_y), cross.real, -cross.imag])
