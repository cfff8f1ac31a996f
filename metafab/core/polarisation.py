"""Six states of polarisation in three orthogonal pairs, and Stokes vectors in metafab's conventions.

With the time dependence exp(-i omega t) and light along +z, right-handed light has the Jones vector (1, -i) / sqrt 2:
its field turns clockwise for an observer who looks into the beam. The Stokes parameters are S0 = I_x + I_y,
S1 = I_x - I_y, S2 = I_(+45) - I_(-45) and S3 = I_R - I_L; with the coherency matrix rho = <E E^H>, S2 + i S3 =
2 rho_xy.
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray

#: Names of the six states; each orthogonal pair stands together.
STATES = ("x", "y", "+45", "-45", "R", "L")

#: Index of the state orthogonal to each state.
ORTHOGONAL = (1, 0, 3, 2, 5, 4)

#: Jones vectors of the states, shape (6, 2).
JONES: ComplexArray = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [1, -1j], [1, 1j]]) / np.sqrt(
    np.array([1, 1, 2, 2, 2, 2])
)[:, None].astype(np.complex128)


def stokes_of(jones: ComplexArray) -> FloatArray:
    """Return the Stokes vectors, shape (..., 4), of Jones vectors of shape (..., 2)."""
    x, y = jones[..., 0], jones[..., 1]
    coherence = 2.0 * x * y.conj()
    power_x, power_y = np.abs(x) ** 2, np.abs(y) ** 2
    return np.stack([power_x + power_y, power_x - power_y, coherence.real, coherence.imag], axis=-1)


def stokes_response(xx: ComplexArray, xy: ComplexArray, yx: ComplexArray, yy: ComplexArray) -> FloatArray:
    """Return the power that a Jones matrix transmits per unit of each Stokes parameter: power = response . S.

    Of its entries, all of one shape, ``xx`` and ``xy`` give E_x for incident x and y polarisation, ``yx`` and ``yy``
    give E_y. The response, shape (4, ...), is the first row of the Mueller matrix.
    """
    of_x, of_y = np.abs(xx) ** 2 + np.abs(yx) ** 2, np.abs(xy) ** 2 + np.abs(yy) ** 2
    coherence = xx * xy.conj() + yx * yy.conj()
    return np.stack([0.5 * (of_x + of_y), 0.5 * (of_x - of_y), coherence.real, -coherence.imag])
