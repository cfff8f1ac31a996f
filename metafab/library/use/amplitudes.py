"""Transmission amplitudes normalised to power: |a|^2 is the transmitted flux per incident flux."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.library import Library
from metafab.materials import refractive_index


def power_amplitudes(library: Library, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
    """Return t sqrt(n_out / n_in) of upright pillars, zero order.

    Args:
        library: response over width and length.
        width_nm: shape (n,), within the library's range.
        length_nm: shape (n,).

    Returns:
        Shape (n, 2), for x and y polarisation.

    Raises:
        InputError: the library does not hold a size.
    """
    cell = library.unit_cell
    wavelength_nm = cell.illumination.wavelength_nm
    substrate = refractive_index(cell.materials.substrate, wavelength_nm)
    ambient = refractive_index(cell.materials.ambient, wavelength_nm)
    n_in, n_out = (substrate, ambient) if cell.illumination.side == "substrate" else (ambient, substrate)
    response = library.at_sizes(width_nm, length_nm)
    axes = enumerate((response.t_xx, response.t_yy))
    return np.stack([t * np.sqrt(n_out[axis].real / n_in[axis].real) for axis, t in axes], axis=-1)


def turned_jones(amplitudes: ComplexArray, angle_deg: FloatArray) -> ComplexArray:
    """Return the Jones matrices R(-a) diag(a_x, a_y) R(a) of pillars turned counter-clockwise by an angle a.

    The lattice of the library's pillars would turn with them, while that of a mask does not: this is the local-period
    approximation, applied to the angle.

    Args:
        amplitudes: shape (..., 2), of the upright pillar for x and y polarisation.
        angle_deg: shape (...), degrees.

    Returns:
        Shape (..., 3), matrix entries xx, xy = yx and yy.
    """
    a_x, a_y = amplitudes[..., 0], amplitudes[..., 1]
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    xx, yy = cosine**2 * a_x + sine**2 * a_y, sine**2 * a_x + cosine**2 * a_y
    return np.stack([xx, cosine * sine * (a_x - a_y), yy], axis=-1)
