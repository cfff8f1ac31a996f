"""A birefringent half space whose principal axes are x, y and z: the admittance of its plane waves, in closed form.

With k = (k_x, k_y) the wave vector in the plane over k0, fields e = (E_x, E_y) and h = (H_y, -H_x) of a medium with
permittivities (eps_x, eps_y, eps_z) obey

    de/dz = i P h,  dh/dz = i Q e:    P = 1 - k k^T / eps_z,    Q = diag(eps_x, eps_y) - k' k'^T,    k' = (-k_y, k_x),

in units of 1/k0: Berreman's four equations (J. Opt. Soc. Am. 62, 502, 1972), in two pairs because no principal axis is
oblique. The eigenvectors of P Q are the two waves that leave.
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray


def admittance(index: tuple[complex, complex, complex], k: FloatArray) -> ComplexArray:
    """Y of h = Y e for light that leaves along +z, shape (2, 2).

    Args:
        index: along x, y and z.
        k: shape (2,), wave vector in the plane over k0; not at the edge of a cone of light, where Y has a pole.
    """
    eps = np.asarray(index, dtype=np.complex128) ** 2
    across = np.array([-k[1], k[0]])
    p = np.eye(2) - np.outer(k, k) / eps[2]
    q = np.diag(eps[:2]) - np.outer(across, across)
    beta_squared, e = np.linalg.eig(p @ q)
    beta = np.sqrt(beta_squared)
    beta = np.where(beta.imag < -1e-12 * np.abs(beta.real), -beta, beta)
    return np.asarray(q @ e / beta @ np.linalg.inv(e))
