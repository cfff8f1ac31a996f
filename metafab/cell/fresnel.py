"""Closed forms: an interface and a film, in the planes and the basis of every other solver.

With tangential fields, s and p light differ only in the admittance of a medium, Y_s = q and Y_p = eps / q, where
q = sqrt(eps - k^2) is the wave number across the layers over k0. An interface has r = (Y1 - Y2) / (Y1 + Y2) and
t = 2 Y1 / (Y1 + Y2); a film is the Airy sum of two of them (Born and Wolf, Principles of Optics, section 1.6).
"""

from __future__ import annotations

import math

import numpy as np

from metafab.cell.halfspace import admittance
from metafab.cell.response import PillarCell
from metafab.core.conventions import ComplexArray, Side


def interface(admittance_in: complex, admittance_out: complex) -> tuple[complex, complex]:
    """(t, r) of the tangential electric field at one interface."""
    total = admittance_in + admittance_out
    return 2.0 * admittance_in / total, (admittance_in - admittance_out) / total


def film(
    admittance_in: complex, admittance_film: complex, admittance_out: complex, turn: complex
) -> tuple[complex, complex]:
    """(t, r) of the tangential electric field through a film.

    Args:
        admittance_in: of the medium that the light comes from.
        admittance_film: of the film.
        admittance_out: of the medium behind.
        turn: exp(i q k0 d), one pass through the film.

    Returns:
        t, the field where the film ends over the incident field where it begins; r, both where it begins.
    """
    t_near, r_near = interface(admittance_in, admittance_film)
    t_far, r_far = interface(admittance_film, admittance_out)
    echoes = 1.0 + r_near * r_far * turn**2
    return t_near * t_far * turn / echoes, (r_near + r_far * turn**2) / echoes


def film_jones(cell: PillarCell, n_film: complex) -> tuple[ComplexArray, ComplexArray]:
    """Jones matrices of ``cell`` with its whole layer of height ``height_nm`` filled by ``n_film``.

    Args:
        cell: half spaces, height and light; the pillar is ignored.
        n_film: index of the layer; that of the pillar for a closed film, of the ambient for an empty cell.

    Returns:
        t and r, each of shape (2, 2), of the tangential field in the basis (x, y).
    """
    if cell.is_birefringent:
        return _film_on_tensor(cell, n_film)
    jones_t, jones_r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    polar, azimuth = math.radians(cell.angle_deg), math.radians(cell.azimuth_deg)
    along = np.array([math.cos(azimuth), math.sin(azimuth)])
    across = np.array([-along[1], along[0]])
    for i in (0, 1):
        k_squared = (cell.n_in[i] * math.sin(polar)) ** 2
        eps = np.array([cell.n_in[i], n_film, cell.n_out[i]], dtype=np.complex128) ** 2
        q = np.sqrt(eps - k_squared)
        turn = complex(np.exp(2j * math.pi * q[1] * cell.height_nm / cell.wavelength_nm))
        t_s, r_s = film(q[0], q[1], q[2], turn)
        t_p, r_p = film(eps[0] / q[0], eps[1] / q[1], eps[2] / q[2], turn)
        for jones, s, p in ((jones_t, t_s, t_p), (jones_r, r_s, r_p)):
            jones[:, i] = (s * np.outer(across, across) + p * np.outer(along, along))[:, i]
    return jones_t, jones_r


def _film_on_tensor(cell: PillarCell, n_film: complex) -> tuple[ComplexArray, ComplexArray]:
    """The same between half spaces of which one is birefringent: admittances are matrices, the film's q is one."""
    k = np.array(cell.in_plane)
    far: Side = "ambient" if cell.side == "substrate" else "substrate"
    y_in, y_out = (admittance(cell.tensor(side) or (complex(cell.n_ambient),) * 3, k) for side in (cell.side, far))
    y_film = admittance((complex(n_film),) * 3, k)
    turn = np.exp(2j * math.pi * np.sqrt(complex(n_film) ** 2 - k @ k) * cell.height_nm / cell.wavelength_nm)
    back = np.linalg.solve(y_film + y_out, y_film - y_out)
    echo, one = turn**2 * back, np.eye(2)
    forward = np.linalg.solve(y_in @ (one + echo) + y_film @ (one - echo), 2.0 * y_in)
    return np.asarray(turn * (one + back) @ forward), np.asarray((one + echo) @ forward - one)
