"""The PSF pair over depth: what the optics room hands to the camera and the decoder."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class PsfField:
    """How the pair changes over the field of view (x and y channels change in opposite senses).

    Attributes:
        tangent_x: shape (n_field_x,), object directions x/z, ascending.
        tangent_y: shape (n_field_y,), object directions y/z, ascending.
        psf: shape (2, n_depth, n_field_y, n_field_x, n_y, n_x), as :attr:`Psf.psf`.
        centre_um: shape (2, n_depth, n_field_y, n_field_x, 2), as :attr:`Psf.centre_um`.
    """

    tangent_x: FloatArray
    tangent_y: FloatArray
    psf: NDArray[np.float32]
    centre_um: FloatArray


@dataclass(frozen=True)
class Psf:
    """Point-spread functions of both polarisations over depth, for an object on the axis (or one direction).

    Attributes:
        depth_m: shape (n_depth,), ascending.
        pixel_um: sampling step on the sensor plane.
        psf: shape (2, n_depth, n_y, n_x), irradiance at pixel centres, 1/um^2 per unit power of that
            polarisation that reaches the aperture.
        centre_um: shape (2, n_depth, 2), (x, y) on the sensor of the centre pixel ``[n_y // 2, n_x // 2]``: the
            geometric image point, rounded to nothing.
        phi_deg: shape (n_depth,), orientation of the main lobe of PSF_x (conventions).
        error: shape (n_depth,), relative L2 error of the irradiance (propagation; the library's comes on top).
        efficiency: shape (2, n_depth), share of the power at the aperture that falls into the window.
        extinction_ratio: shape (n_depth,), wanted over unwanted polarisation's power in x's window.
        sensor_distance_um: distance of the sensor plane.
        field: the pair over the field of view, where it was asked for.
        details: figures of the computing (block size, seconds, ...).
    """

    depth_m: FloatArray
    pixel_um: float
    psf: FloatArray
    centre_um: FloatArray
    phi_deg: FloatArray
    error: FloatArray
    efficiency: FloatArray
    extinction_ratio: FloatArray
    sensor_distance_um: float
    field: PsfField | None = None
    details: dict[str, float | str] = dataclasses.field(default_factory=dict)
