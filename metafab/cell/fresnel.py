"""Exact t and r of an interface, a film and a birefringent half space, in the conventions of the other solvers.

With tangential fields, s and p light differ only in the admittance of a medium, Y_s = q and Y_p = eps / q, where
q = sqrt(eps - k^2) is the wave number across the layers over k0. An interface has r = (Y1 - Y2) / (Y1 + Y2) and
t = 2 Y1 / (Y1 + Y2); a film is the Airy sum of two of them (Born and Wolf, Principles of Optics, section 1.6).

In a birefringent half space with principal axes x, y and z, e = (E_x, E_y) and h = (H_y, -H_x) obey

    de/dz = i P h,  dh/dz = i Q e:    P = 1 - k k^T / eps_z,    Q = diag(eps_x, eps_y) - k' k'^T,    k' = (-k_y, k_x),

with k the wave vector in the plane over k0 and lengths in units of 1/k0. These are Berreman's four equations
(J. Opt. Soc. Am. 62, 502, 1972), in two pairs because no principal axis is oblique. The eigenvectors of P Q are the
two eigenpolarisations.
"""

from __future__ import annotations

import math

import numpy as np

from metafab.cell.pillar import PillarCell
from metafab.core.conventions import ComplexArray, FloatArray


def interface(admittance_in: complex, admittance_out: complex) -> tuple[complex, complex]:
    """(t, r) of the tangential electric field at one interface."""
    total = admittance_in + admittance_out
    return 2.0 * admittance_in / total, (admittance_in - admittance_out) / total


def film(
    admittance_in: complex, admittance_film: complex, admittance_out: complex, propagation: complex
) -> tuple[complex, complex]:
    """(t, r) of the tangential electric field through a film between two media of given admittances.

    ``propagation`` is exp(i q k0 d), one pass through the film. t is the field at the film's end over the incident
    field at its beginning; r has both fields at its beginning.
    """
    t_near, r_near = interface(admittance_in, admittance_film)
    t_far, r_far = interface(admittance_film, admittance_out)
    echoes = 1.0 + r_near * r_far * propagation**2
    return t_near * t_far * propagation / echoes, (r_near + r_far * propagation**2) / echoes


def film_jones(cell: PillarCell, n_film: complex) -> tuple[ComplexArray, ComplexArray]:
    """Jones matrices t and r of ``cell`` with its whole layer of height ``height_nm`` filled by the index ``n_film``.

    That is the pillar's for a closed film, the ambient's for an empty cell. The matrices, shape (2, 2), are those of
    the tangential field in the basis (x, y).
    """
    if cell.is_birefringent:
        return _film_on_birefringent(cell, n_film)
    jones_t, jones_r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    polar, azimuth = math.radians(cell.angle_deg), math.radians(cell.azimuth_deg)
    along = np.array([math.cos(azimuth), math.sin(azimuth)])
    across = np.array([-along[1], along[0]])
    for i in (0, 1):
        k_squared = (cell.n_in[i] * math.sin(polar)) ** 2
        eps = np.array([cell.n_in[i], n_film, cell.n_out[i]], dtype=np.complex128) ** 2
        q = np.sqrt(eps - k_squared)
        propagation = complex(np.exp(2j * math.pi * q[1] * cell.height_nm / cell.wavelength_nm))
        t_s, r_s = film(q[0], q[1], q[2], propagation)
        t_p, r_p = film(eps[0] / q[0], eps[1] / q[1], eps[2] / q[2], propagation)
        for jones, s, p in ((jones_t, t_s, t_p), (jones_r, r_s, r_p)):
            jones[:, i] = (s * np.outer(across, across) + p * np.outer(along, along))[:, i]
    return jones_t, jones_r


def admittance(index: tuple[complex, complex, complex], k: FloatArray) -> ComplexArray:
    """Admittance Y of a birefringent half space, h = Y e for outgoing light along +z: shape (2, 2).

    ``index`` holds the refractive indices along x, y and z. ``k``, shape (2,), is the in-plane wave vector over k0, not
    on a light cone, where Y has a pole.
    """
    eps = np.asarray(index, dtype=np.complex128) ** 2
    across = np.array([-k[1], k[0]])
    p = np.eye(2) - np.outer(k, k) / eps[2]
    q = np.diag(eps[:2]) - np.outer(across, across)
    beta_squared, e = np.linalg.eig(p @ q)
    beta = np.sqrt(beta_squared)
    beta = np.where(beta.imag < -1e-12 * np.abs(beta.real), -beta, beta)
    return np.asarray(q @ e / beta @ np.linalg.inv(e))


def _film_on_birefringent(cell: PillarCell, n_film: complex) -> tuple[ComplexArray, ComplexArray]:
    """:func:`film_jones` for a birefringent half space: admittances are matrices, the film has a single q."""
    k = np.array(cell.in_plane)
    isotropic = (complex(cell.n_ambient),) * 3
    y_in, y_out = (admittance(cell.tensor(side) or isotropic, k) for side in (cell.side, cell.far_side))
    y_film = admittance((complex(n_film),) * 3, k)
    turn = np.exp(2j * math.pi * np.sqrt(complex(n_film) ** 2 - k @ k) * cell.height_nm / cell.wavelength_nm)
    back = np.linalg.solve(y_film + y_out, y_film - y_out)
    echo, one = turn**2 * back, np.eye(2)
    forward = np.linalg.solve(y_in @ (one + echo) + y_film @ (one - echo), 2.0 * y_in)
    return np.asarray(turn * (one + back) @ forward), np.asarray((one + echo) @ forward - one)
