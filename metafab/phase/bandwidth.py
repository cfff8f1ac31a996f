"""What the width of the colour filter costs: the split carrier is a grating, and spreads colours along x.

The carrier sends the wavelength lambda to sin(theta) lambda / lambda_0, so each channel is smeared along the split,
in opposite senses; and the lens, diffractive too, has a power in proportion to the wavelength, which turns the lobe.
Both keep the pair conjugate but wash out its phase, where the depth is. A wider filter lets in more light: the best
width balances the two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.phase.blind import BlindInformation
from metafab.phase.information import Texture
from metafab.phase.pupil import Pupil, rim_defocus_per_dioptre_rad


def smear_um_per_nm(sensor_distance_um: float, angle_deg: float, wavelength_um: float) -> float:
    """Shift of an image along the split per nanometre of wavelength (3.8 um for the paper's lens).

    The image stands at z tan(theta) with sin(theta) in proportion to the wavelength: z tan(theta) / cos^2(theta) /
    lambda.
    """
    angle = math.radians(angle_deg)
    return sensor_distance_um * math.tan(angle) / math.cos(angle) ** 2 / (1e3 * wavelength_um)


@dataclass(frozen=True)
class BandwidthTradeoff:
    """Information about depth against the filter's width and the angle of the split.

    Attributes:
        fwhm_nm: shape (n_width,), full widths of a filter with a flat top.
        angle_deg: shape (n_angle,), angles of the split.
        smear_um: shape (n_angle, n_width), spread of a point along the split.
        kept: shape (n_angle, n_width), information over that of one wavelength with the same electrons.
        relative_error: shape (n_angle, n_width), smallest standard deviation of depth with the electrons that the
            filter lets in, over that at one wavelength with the electrons of the reference width.
    """

    fwhm_nm: FloatArray
    angle_deg: FloatArray
    smear_um: FloatArray
    kept: FloatArray
    relative_error: FloatArray

    @property
    def best_fwhm_nm(self) -> FloatArray:
        """The width with the smallest error for each angle, shape (n_angle,)."""
        best: FloatArray = self.fwhm_nm[np.argmin(self.relative_error, axis=1)]
        return best


def bandwidth_tradeoff(
    pupil: Pupil,
    field: ComplexArray,
    defocus_rad: FloatArray,
    *,
    fwhm_nm: ArrayLike,
    angle_deg: ArrayLike,
    aperture_um: float,
    focal_length_mm: float,
    sensor_distance_um: float,
    wavelength_um: float,
    split_azimuth_deg: float = 0.0,
    texture: Texture | None = None,
    reference_fwhm_nm: float = 10.0,
) -> BandwidthTradeoff:
    """The cost of bandwidth for a mask, at several widths of the filter and angles of the split.

    The change of the PSF's scale with the wavelength (1 % at 8 nm) is left out.

    Args:
        pupil: samples; PSFs must fit in twice as many Nyquist pixels together with their smear.
        field: shape (n,), the mask's complex transmission for x polarisation.
        defocus_rad: shape (n_depth,), rim defocuses over which information is averaged.
        fwhm_nm: shape (n_width,), positive.
        angle_deg: shape (n_angle,).
        aperture_um: diameter.
        focal_length_mm: focal length at the design wavelength.
        sensor_distance_um: distance of the sensor plane.
        wavelength_um: design wavelength, the filter's centre.
        split_azimuth_deg: direction of the split, counter-clockwise from x.
        texture: unknown texture and noise, per Nyquist pixel, with the electrons of ``reference_fwhm_nm``.
        reference_fwhm_nm: the width at which ``texture`` has its electrons; they go with the width.
    """
    widths, angles = np.atleast_1d(np.asarray(fwhm_nm, float)), np.atleast_1d(np.asarray(angle_deg, float))
    texture = texture or Texture()
    radius_um = 0.5 * aperture_um
    # A longer wavelength is focused nearer: the power 1 / f grows by d lambda / lambda.
    power_rad = -rim_defocus_per_dioptre_rad(radius_um, wavelength_um) * 1e3 / focal_length_mm / (1e3 * wavelength_um)
    nyquist_um = wavelength_um * sensor_distance_um / (4.0 * radius_um)
    smears = np.array([smear_um_per_nm(sensor_distance_um, angle, wavelength_um) for angle in angles])
    azimuth = math.radians(split_azimuth_deg)
    frequency = np.fft.fftfreq(2 * pupil.samples)
    along = math.cos(azimuth) * frequency[None, :] + math.sin(azimuth) * frequency[:, None]
    single = BlindInformation(pupil, defocus_rad, texture)
    mono = float(single.of_field(field).mean())
    kept, error = np.empty((angles.size, widths.size)), np.empty((angles.size, widths.size))
    for column, width in enumerate(widths):
        # Enough wavelengths for the fastest beat: half a turn a Nyquist pixel of smear, and the turning of the lobe.
        beats = float(smears.max()) * width / nyquist_um + abs(power_rad) * width / math.pi
        nodes, shares = np.polynomial.legendre.leggauss(6 + math.ceil(2.0 * beats))
        parts = [
            replace(single, defocus_rad=defocus_rad + power_rad * 0.5 * width * node).transfer(field) for node in nodes
        ]
        shone = replace(texture, electrons=texture.electrons * width / reference_fwhm_nm)
        for row, smear in enumerate(smears):
            # PSF_x moves towards -x, as its image does, with growing wavelength.
            turns = [np.exp(2j * np.pi * along * smear * 0.5 * width * node / nyquist_um) for node in nodes]
            transfer, slope = (
                0.5 * sum(share * turn * part[i] for share, turn, part in zip(shares, turns, parts, strict=True))
                for i in (0, 1)
            )
            kept[row, column] = _information(transfer, slope, texture) / mono
            error[row, column] = math.sqrt(mono / _information(transfer, slope, shone))
    return BandwidthTradeoff(widths, angles, np.outer(smears, widths), kept, error)


def _information(transfer: ComplexArray, slope: ComplexArray, texture: Texture) -> float:
    """Mean over depths of the information in a conjugate pair with these transfer functions of x polarisation."""
    snr = texture.signal_to_noise((transfer.shape[1], transfer.shape[2]))
    turn = (slope * transfer.conj()).imag
    density = 4.0 * (snr * turn) ** 2 / (1.0 + 2.0 * snr * np.abs(transfer) ** 2)
    return float(density.sum() / len(transfer))
