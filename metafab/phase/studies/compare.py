"""What masks tell about depth at equal aperture and equal light: Cramer-Rao bounds at the level of the pupil.

Two questions, as in the optics room, which answers them for a written mask: a point source whose place and
brightness are known, and a piece of unknown texture. A lens and a double helix answer the first; they say nothing
about the second, because the two images of the pair are the same, or turn into each other by nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.information.twin_images import PointSource, Texture, twin_information
from metafab.phase.pupil import Pupil, phasor, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.terms.helices import DoubleHelixPhase, SpiralZonesPhase
from metafab.phase.terms.profile import Term

#: Below this share of the largest information of any mask, nothing but rounding is left.
_ROUNDING = 1e-10


@dataclass(frozen=True)
class DepthBounds:
    """Smallest standard deviations of depth that any estimate can reach, for several masks.

    Attributes:
        depth_m: shape (n_depth,).
        masks: names.
        point_m: shape (n_mask, n_depth), for a point source of known place and brightness.
        texture_m: shape (n_mask, n_depth), for a piece of unknown texture as large as the window of twice the
            pupil's samples in Nyquist pixels; infinite where a mask says nothing.
    """

    depth_m: FloatArray
    masks: tuple[str, ...]
    point_m: FloatArray
    texture_m: FloatArray


def reference_masks(pupil: Pupil, zones: int, exponent: float) -> dict[str, ComplexArray]:
    """The masks that a helix is compared with, as fields of shape (2, n) for x and y polarisation.

    A standard lens, the plain spiral of Eq. 2, and the double helix of Pavani and Piestun (2008).
    """
    terms: dict[str, Term] = {
        "plain spiral": SpiralZonesPhase(zones, exponent, 1.0),
        "double helix": DoubleHelixPhase(1.0, 0.35, 5),
    }
    fields = {
        name: np.stack([phasor(term(pupil.axis, pupil.axis, p)[pupil.inside]) for p in POLARISATIONS])
        for name, term in terms.items()
    }
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
    """Bounds of several masks over depth.

    Args:
        masks: name -> pupil fields of x and y polarisation, shape (2, n).
        pupil: where they are sampled.
        depth_m: shape (n_depth,), depths.
        focus_depth_m: depth that is in focus.
        aperture_um: diameter.
        wavelength_um: vacuum wavelength.
        source: the point, with its noise per Nyquist pixel of lambda s' / (4 R).
        texture: the texture, with its noise per Nyquist pixel.
    """
    depth = np.atleast_1d(np.asarray(depth_m, dtype=np.float64))
    radius_um = 0.5 * aperture_um
    defocus = rim_defocus_rad(depth, focus_depth_m, radius_um, wavelength_um)
    snr = texture.signal_to_noise((2 * pupil.samples, 2 * pupil.samples))
    told = np.empty((2, len(masks), depth.size))
    for row, field in enumerate(masks.values()):
        for column, value in enumerate(defocus):
            psf, slope = _pair(pupil, field, float(value))
            variance = source.electrons * psf + source.background_e + source.read_noise_e**2
            # Where there is neither light nor noise, nothing changes either: 0 / 0 tells nothing.
            told[0, row, column] = ((source.electrons * slope)[variance > 0.0] ** 2 / variance[variance > 0.0]).sum()
            told[1, row, column] = twin_information(fft.fft2(psf), fft.fft2(slope), snr)
    told[told < _ROUNDING * told.max(axis=(1, 2), keepdims=True)] = 0.0
    with np.errstate(divide="ignore"):
        point_m, texture_m = depth**2 / rim_defocus_per_dioptre_rad(radius_um, wavelength_um) / np.sqrt(told)
    return DepthBounds(depth, tuple(masks), point_m, texture_m)


def _pair(pupil: Pupil, field: ComplexArray, defocus_rad: float) -> tuple[FloatArray, FloatArray]:
    """PSFs of sum 1 on Nyquist pixels, and their derivatives over the rim defocus, shape (2, 2 samples, 2 samples)."""
    side = (2 * pupil.samples, 2 * pupil.samples)
    grid = np.zeros((2, *pupil.inside.shape), dtype=np.complex128)
    grid[:, pupil.inside] = field * phasor(defocus_rad * pupil.radius_squared)
    amplitude = fft.fft2(grid, side)
    amplitude_slope = fft.fft2(1j * pupil.radius_squared_grid * grid, side)
    scale = 1.0 / (4.0 * pupil.samples**2 * pupil.count)
    return scale * np.abs(amplitude) ** 2, scale * 2.0 * (amplitude.conj() * amplitude_slope).real
