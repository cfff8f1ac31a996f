"""Cramer-Rao bounds of depth for several masks at equal aperture and equal light, at the level of the pupil.

Two sources: a point of known position and brightness, and a patch of unknown texture. A lens and a double helix locate
the point, but give no information about the texture: the two images of their pair are equal, or equal up to a
reflection that does not depend on depth. For a written mask, :mod:`metafab.information.fisher` computes these bounds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.core.numeric.phasor import phasor
from metafab.information.fisher import twin_information
from metafab.information.texture import PointSource, Texture
from metafab.phase.pupil import NyquistImages, Pupil, pupil_field, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.terms.helices import DoubleHelixPhase, SpiralZonesPhase
from metafab.phase.terms.profile import Term

#: Information below this share of the largest of any mask is rounding.
_ROUNDING = 1e-10


@dataclass(frozen=True)
class DepthBounds:
    """Cramer-Rao bounds of depth for several masks."""

    depth_m: FloatArray  #: Shape (n_depth,).
    masks: tuple[str, ...]  #: Names.
    #: Shape (n_mask, n_depth), standard deviation for a point source of known position and brightness.
    point_m: FloatArray
    #: Shape (n_mask, n_depth), standard deviation for a patch of unknown texture of m x m Nyquist pixels, m twice the
    #: pupil's samples a side; infinite without information.
    texture_m: FloatArray


def reference_masks(pupil: Pupil, zones: int, exponent: float) -> dict[str, ComplexArray]:
    """Pupil fields, shape (2, n), of masks for comparison, by name.

    A standard lens, the plain spiral of Shen 2023 (Eq. 2), and the double helix of Pavani and Piestun (2008).
    """
    terms: dict[str, Term] = {
        "plain spiral": SpiralZonesPhase(zones=zones, exponent=exponent, radius_um=1.0),
        "double helix": DoubleHelixPhase(radius_um=1.0, waist=0.35, modes=5),
    }
    fields = {name: np.stack([pupil_field(term, pupil, 1.0, p) for p in POLARISATIONS]) for name, term in terms.items()}
    return {"standard lens": np.ones((2, pupil.count), dtype=np.complex128), **fields}


def compare_masks(
    masks: Mapping[str, ComplexArray],
    pupil: Pupil,
    depth_m: ArrayLike,
    *,
    focus_depth_m: float,
    aperture_um: float,
    wavelength_um: float,
    source: PointSource,
    texture: Texture,
) -> DepthBounds:
    """Compute the bounds of several masks over depth.

    Args:
        masks: name -> pupil fields of x and y polarisation, shape (2, n).
        depth_m: shape (n_depth,), depths.
        source: the point, with its noise per Nyquist pixel of lambda s' / (4 R).
        texture: the texture, with its noise per Nyquist pixel.
    """
    depth = np.atleast_1d(np.asarray(depth_m, dtype=np.float64))
    radius_um = 0.5 * aperture_um
    defocus = rim_defocus_rad(depth, focus_depth_m, radius_um, wavelength_um)
    snr = texture.signal_to_noise((2 * pupil.samples, 2 * pupil.samples))
    information = np.empty((2, len(masks), depth.size))
    for row, field in enumerate(masks.values()):
        for column, value in enumerate(defocus):
            images = NyquistImages.of(pupil, pupil.on_grid(field * phasor(value * pupil.radius_squared)))
            variance = source.electrons * images.psf + source.background_e + source.read_noise_e**2
            # Pixels without light and noise would be 0 / 0.
            lit = variance > 0.0
            information[0, row, column] = ((source.electrons * images.psf_slope)[lit] ** 2 / variance[lit]).sum()
            information[1, row, column] = twin_information(fft.fft2(images.psf), fft.fft2(images.psf_slope), snr)
    information[information < _ROUNDING * information.max(axis=(1, 2), keepdims=True)] = 0.0
    with np.errstate(divide="ignore"):
        point_m, texture_m = depth**2 / rim_defocus_per_dioptre_rad(radius_um, wavelength_um) / np.sqrt(information)
    return DepthBounds(depth, tuple(masks), point_m, texture_m)
