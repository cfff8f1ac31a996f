"""Plain Fourier modes of a slab of pillars in vacuum: no symmetry, no stretched axes, no factorisation rules.

An independent path for what :mod:`metafab.cell.rcwa` treats strip by strip. The direct rule converges slowly, but two
cells that are alike miss by nearly the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

#: Fourier coefficient (m, n) of a pillar's indicator.
Indicator = Callable[[np.ndarray, np.ndarray], np.ndarray]


def transmitted(
    lengths_nm: tuple[float, float],
    most: tuple[int, int],
    indicator: Indicator,
    n_pillar: complex,
    height_nm: float,
    wavelength_nm: float,
) -> np.ndarray:
    """(t_xx, t_yy) with orders up to ``most`` along x and y.

    de/dz = i P h and dh/dz = i Q e over exp(i (k_x x + k_y y)), for e = (E_x, E_y), h = (H_y, -H_x).
    """
    k0 = 2.0 * math.pi / wavelength_nm
    m, n = (axis.ravel() for axis in np.meshgrid(*(np.arange(-count, count + 1) for count in most)))
    k_x, k_y = (np.diag(2.0 * np.pi * number / length / k0) for number, length in zip((m, n), lengths_nm, strict=True))
    eps = np.eye(m.size) + (complex(n_pillar) ** 2 - 1.0) * indicator(m[:, None] - m, n[:, None] - n)
    eta, unit = np.linalg.inv(eps), np.eye(m.size)
    to_e = np.block([[unit - k_x @ eta @ k_x, -k_x @ eta @ k_y], [-k_y @ eta @ k_x, unit - k_y @ eta @ k_y]])
    to_h = np.block([[eps - k_y @ k_y, k_y @ k_x], [k_x @ k_y, eps - k_x @ k_x]])
    beta_squared, modes = np.linalg.eig(to_e @ to_h)
    beta = np.sqrt(beta_squared.astype(complex))
    beta = np.where(beta.imag < 0.0, -beta, beta)
    magnetic = to_h @ modes / beta
    free = np.sqrt((1.0 - np.diag(k_x) ** 2 - np.diag(k_y) ** 2).astype(complex))
    outside = np.block([[unit - k_y @ k_y, k_y @ k_x], [k_x @ k_y, unit - k_x @ k_x]]) / np.tile(free, 2)
    decay = np.exp(1j * beta * k0 * height_nm)
    # Unknown: forward modes from the front, backward ones from the end; h = +-(outside) e in vacuum.
    incident = np.zeros((2 * m.size, 2))
    middle = int(np.flatnonzero((m == 0) & (n == 0))[0])
    incident[middle, 0] = incident[m.size + middle, 1] = 1.0
    front = np.hstack([outside @ modes + magnetic, (outside @ modes - magnetic) * decay])
    end = np.hstack([(outside @ modes - magnetic) * decay, outside @ modes + magnetic])
    sent = np.vstack([2.0 * outside @ incident, np.zeros_like(incident)])
    forward, backward = np.split(np.linalg.solve(np.vstack([front, end]), sent), 2)
    leaving = modes @ (decay[:, None] * forward + backward)
    return np.array([leaving[middle, 0], leaving[m.size + middle, 1]])
