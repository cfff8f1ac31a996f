"""From recorded amplitudes to t and r in the planes of the conventions, exactly as waves run on the grid."""

from __future__ import annotations

import cmath
import math
from typing import Any

from numpy.typing import NDArray

from metafab.cell.meep.grid import Plan


def grid_wavenumber(
    n: float, wavelength_um: float, pixel_um: float, courant: float, across: tuple[float, float] = (0.0, 0.0)
) -> complex:
    """Wavenumber along z (rad/um) of a plane wave on the Yee grid; imaginary where it is evanescent.

    The sum of sin^2(k_i dx / 2) / dx^2 over the axes is n^2 sin^2(omega dt / 2) / dt^2 (Taflove and Hagness 2005,
    Eq. 4.5). With the true wavenumbers in its place, results would depend on where the monitors stand.

    Args:
        n: index of the medium.
        wavelength_um: vacuum wavelength.
        pixel_um: grid spacing.
        courant: time step over grid spacing.
        across: wavenumbers along x and y, rad/um.
    """
    total = n / courant * math.sin(math.pi * courant * pixel_um / wavelength_um)
    along = cmath.sqrt(total**2 - sum(math.sin(k * pixel_um / 2.0) ** 2 for k in across))
    return 2.0 / pixel_um * cmath.asin(along)


def amplitudes(plan: Plan, limit: NDArray[Any], incident: NDArray[Any]) -> tuple[complex, complex]:
    """(t, r) of the polarisation of ``plan``.

    Args:
        plan: where the monitors stand.
        limit: zero order of the near and the far monitor, shape (2,).
        incident: the same of the empty run, shape (2,).
    """
    job = plan.job
    k_in = grid_wavenumber(plan.n_in, job.wavelength_um, job.pixel_um, job.courant)
    k_out = grid_wavenumber(plan.n_out, job.wavelength_um, job.pixel_um, job.courant)
    arriving = complex(incident[0]) * cmath.exp(-1j * k_in * plan.near_um)
    t = complex(limit[1]) * cmath.exp(-1j * k_out * plan.far_um) / arriving
    r = (complex(limit[0]) - complex(incident[0])) * cmath.exp(1j * k_in * plan.near_um) / arriving
    return t, r
