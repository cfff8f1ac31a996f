"""Power transmittance, amplitudes normalised to power, and Jones matrices of rotated pillars."""

from __future__ import annotations

import math

import numpy as np

from metafab.cell import pillar_cell
from metafab.cell.response import power_ratio
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.axes import incidence
from metafab.library.library import Library
from metafab.library.surface import SizeResponse
from metafab.materials import refractive_index
from metafab.spec import UnitCell


def half_space_indices(unit_cell: UnitCell) -> tuple[ComplexArray, ComplexArray]:
    """Return the indices of the incident and of the outgoing half space, shape (2,) each: x and y polarisation."""
    materials, light = unit_cell.materials, unit_cell.illumination
    substrate = np.array(refractive_index(materials.substrate, light.wavelength_nm))
    ambient = np.array(refractive_index(materials.ambient, light.wavelength_nm))
    return (substrate, ambient) if light.side == "substrate" else (ambient, substrate)


def power_ratio_of(library: Library) -> FloatArray:
    """Return the zero-order power transmittance of t = 1 at the library's angle of incidence, shape (2,), x and y."""
    return power_ratio(pillar_cell(library.unit_cell, 0.0, 0.0, **incidence(library.corner)))


def power_transmittance(library: Library) -> FloatArray:
    """Return the zero-order power transmittance of all sizes, shape (n_length, n_width, 2), for x and y."""
    return np.asarray(np.abs(library.t) ** 2 * power_ratio_of(library), dtype=np.float64)


def empty_cell_t(unit_cell: UnitCell) -> ComplexArray:
    """Return the transmission of a cell without a pillar for x and y polarisation, shape (2,).

    It is Fresnel's t and a path of one pillar height in the ambient.
    """
    n_in, n_out = half_space_indices(unit_cell)
    light = unit_cell.illumination
    n_ambient = n_out if light.side == "substrate" else n_in
    path = 2.0 * math.pi * n_ambient * unit_cell.cell.height_nm / light.wavelength_nm
    return np.asarray(2.0 * n_in / (n_in + n_out) * np.exp(1j * path), dtype=np.complex128)


def power_amplitudes(library: Library, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
    """Return t of n upright pillars of the library's grid, as square root of power: shape (n, 2), for x and y.

    A size that the library does not hold raises InputError.
    """
    return power_normalised(library.at_sizes(width_nm, length_nm), library)


def power_normalised(response: SizeResponse, library: Library) -> ComplexArray:
    """Return t sqrt(n_out / n_in) of n upright pillars, zero order: shape (n, 2), for x and y polarisation.

    At an angle of incidence the admittances of tangential E stand for the indices.
    """
    return np.stack([response.t_xx, response.t_yy], axis=-1) * np.sqrt(power_ratio_of(library))


def turned_jones(amplitudes: ComplexArray, angle_deg: FloatArray) -> ComplexArray:
    """Return the Jones matrices R(-a) diag(a_x, a_y) R(a) of pillars rotated counter-clockwise by an angle a.

    This rotates the library's lattice too, while the lattice of a mask does not rotate: an additional approximation
    beyond the local period. Amplitudes of the upright pillars have the shape (..., 2), angles in degrees (...), the
    entries xx, xy = yx and yy (..., 3).
    """
    a_x, a_y = amplitudes[..., 0], amplitudes[..., 1]
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    xx, yy = cosine**2 * a_x + sine**2 * a_y, sine**2 * a_x + cosine**2 * a_y
    return np.stack([xx, cosine * sine * (a_x - a_y), yy], axis=-1)
