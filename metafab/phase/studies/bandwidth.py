"""Loss of depth information behind a colour filter: the split carrier is a grating, which disperses along x.

The carrier deflects the wavelength lambda to sin(theta) lambda / lambda_0, which smears the images of the two
polarisations along the split in opposite directions. The lens is diffractive too: its power is proportional to the
wavelength, which rotates the lobe. The transfer functions of the pair stay conjugate, but their phase, which carries
the depth, averages out. A wider filter passes more light; the best width balances the two effects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.figures import Remedy
from metafab.information.fisher import conjugate_information
from metafab.information.texture import Texture
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.pupil import Pupil, rim_defocus_per_dioptre_rad

#: Compared widths of the filter relative to the chosen one, and angles of the split relative to the design's.
_WIDTHS = np.geomspace(1.0 / 16.0, 2.0, 11)
_ANGLES = np.array([0.25, 0.5, 1.0])
_AZIMUTH_STEP_DEG = 30.0


def smear_um_per_nm(sensor_distance_um: float, angle_deg: float, wavelength_um: float) -> float:
    """Shift of an image along the split per nanometre of wavelength (3.8 um for the lens of Shen 2023).

    The image is at z tan(theta) with sin(theta) proportional to lambda: the derivative is z tan(theta) / cos^2(theta) /
    lambda.
    """
    angle = math.radians(angle_deg)
    return sensor_distance_um * math.tan(angle) / math.cos(angle) ** 2 / (1e3 * wavelength_um)


@dataclass(frozen=True)
class BandwidthTradeoff:
    """Information about depth against the width of the filter and the angle of the split."""

    fwhm_nm: FloatArray  #: Shape (n_width,), full widths of a filter with a flat top.
    angle_deg: FloatArray  #: Shape (n_angle,), angles of the split.
    smear_um: FloatArray  #: Shape (n_angle, n_width), spread of a point along the split.
    kept: FloatArray  #: Shape (n_angle, n_width), information over that at one wavelength with equal electrons.
    #: Shape (n_angle, n_width), Cramer-Rao bound of depth with the electrons that the filter passes, over that at one
    #: wavelength with the electrons of the reference width.
    relative_error: FloatArray


@dataclass(frozen=True)
class SplitImaging:
    """A mask behind a split lens, over a range of depths, with unknown texture."""

    pupil: Pupil  #: Samples; PSFs and their smear must fit in twice as many Nyquist pixels a side.
    mask: ComplexArray  #: Shape (n,), complex transmission for x polarisation; y is the point mirror.
    defocus_rad: FloatArray  #: Shape (n_depth,), rim defocuses over which information is averaged.
    aperture_um: float  #: Diameter.
    focal_length_mm: float  #: Focal length at the design wavelength.
    sensor_distance_um: float  #: Distance of the sensor plane.
    wavelength_um: float  #: Design wavelength, the centre of the filter.
    #: Unknown texture and noise per Nyquist pixel, with the electrons of ``reference_fwhm_nm``.
    texture: Texture = field(default_factory=Texture)
    #: Width at which ``texture`` has its electrons; they are proportional to the width.
    reference_fwhm_nm: float = 10.0

    @cached_property
    def one_wavelength(self) -> float:
        """Mean information over the depths without bandwidth, with the electrons of the reference width, 1/rad^2."""
        return float(self._blind.of_field(self.mask).mean())

    @cached_property
    def _blind(self) -> BlindInformation:
        return BlindInformation(self.pupil, self.defocus_rad, self.texture)

    @property
    def nyquist_um(self) -> float:
        """Step of the grid on the sensor, lambda s' / (4 R)."""
        return self.wavelength_um * self.sensor_distance_um / (2.0 * self.aperture_um)

    def filtered(self, fwhm_nm: float, splits: Sequence[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
        """Mean information behind a filter with a flat top, for several splits (angle, azimuth), degrees.

        Light of x polarisation goes to azimuth + 180. The information is that with the electrons of the reference
        width, and that with those of ``fwhm_nm``; each has the shape (n_split,), 1/rad^2.
        """
        smears = [smear_um_per_nm(self.sensor_distance_um, angle, self.wavelength_um) for angle, _ in splits]
        # A longer wavelength has a shorter focal length: the power 1 / f grows by d lambda / lambda.
        per_dioptre = rim_defocus_per_dioptre_rad(0.5 * self.aperture_um, self.wavelength_um)
        power_rad = -per_dioptre * 1e3 / self.focal_length_mm / (1e3 * self.wavelength_um)
        # Quadrature nodes from the largest phase range: half a cycle per Nyquist pixel of smear, plus the defocus.
        beats = max(smears) * fwhm_nm / self.nyquist_um + abs(power_rad) * fwhm_nm / math.pi
        nodes, shares = np.polynomial.legendre.leggauss(6 + math.ceil(2.0 * beats))
        frequency = np.fft.fftfreq(2 * self.pupil.samples)
        transfer = np.zeros((len(splits), self.defocus_rad.size, frequency.size, frequency.size), dtype=np.complex128)
        slope = np.zeros_like(transfer)
        for node, share in zip(nodes, shares, strict=True):
            detuning_nm = 0.5 * fwhm_nm * float(node)
            blind = replace(self._blind, defocus_rad=self.defocus_rad + power_rad * detuning_nm)
            at_wavelength, slope_at_wavelength = blind.transfer(self.mask)
            for row, (smear, (_, azimuth_deg)) in enumerate(zip(smears, splits, strict=True)):
                # With growing wavelength PSF_x moves towards -x, as its image does.
                shift = 2j * np.pi * smear * detuning_nm / self.nyquist_um
                azimuth = math.radians(azimuth_deg)
                along_y, along_x = (np.exp(shift * part * frequency) for part in (math.sin(azimuth), math.cos(azimuth)))
                phasor = np.outer(along_y, along_x)
                transfer[row] += 0.5 * share * phasor * at_wavelength
                slope[row] += 0.5 * share * phasor * slope_at_wavelength
        return self._mean(transfer, slope, 1.0), self._mean(transfer, slope, fwhm_nm / self.reference_fwhm_nm)

    def _mean(self, transfer: ComplexArray, slope: ComplexArray, light: float) -> FloatArray:
        """Mean information over the depths at a relative light, shape (n_split,)."""
        texture = replace(self.texture, electrons=self.texture.electrons * light)
        signal_to_noise = texture.signal_to_noise((transfer.shape[-2], transfer.shape[-1]))
        return np.asarray(conjugate_information(transfer, slope, signal_to_noise).mean(axis=-1))


def bandwidth_tradeoff(imaging: SplitImaging, *, fwhm_nm: ArrayLike, angle_deg: ArrayLike) -> BandwidthTradeoff:
    """Compute the information for n_width widths of the filter and n_angle angles of the split, shapes (n,) each.

    The change of the PSF's scale with the wavelength (1 % at 8 nm) is left out.
    """
    widths, angles = np.atleast_1d(np.asarray(fwhm_nm, float)), np.atleast_1d(np.asarray(angle_deg, float))
    splits = [(float(angle), 0.0) for angle in angles]
    information = np.array([imaging.filtered(float(width), splits) for width in widths])  # (width, light, angle)
    smears = [smear_um_per_nm(imaging.sensor_distance_um, angle, imaging.wavelength_um) for angle in angles]
    kept = information[:, 0].T / imaging.one_wavelength
    error = np.sqrt(imaging.one_wavelength / information[:, 1].T)
    return BandwidthTradeoff(widths, angles, np.outer(smears, widths), kept, error)


@dataclass(frozen=True)
class BandwidthBudget:
    """Cost of the colour filter of a design, and remedies."""

    fwhm_nm: float  #: Full width of the filter.
    angle_deg: float  #: Angle of the split.
    dispersion_um_per_nm: float  #: Shift of an image along the split per nanometre.
    smear_um: float  #: Spread of a point along the split.
    kept: float  #: Information over that at one wavelength with equal electrons.
    #: Effective changes, the most effective first. Another diffraction order of the carrier is no remedy: at a given
    #: angle every order has the dispersion tan(theta) / lambda of the grating equation.
    remedies: tuple[Remedy, ...]
    #: Widths against angles; errors are relative to those at one wavelength with the electrons of the chosen filter.
    tradeoff: BandwidthTradeoff
    #: Shape (n_azimuth,), directions of the split relative to the mask; 180 swaps the polarisations.
    azimuth_deg: FloatArray
    kept_by_azimuth: FloatArray  #: Shape (n_azimuth,), information kept at the chosen width and angle.

    @property
    def depth_error_factor(self) -> float:
        """Cramer-Rao bound of depth over that at one wavelength; infinite without information."""
        return math.inf if self.kept == 0.0 else self.kept**-0.5


def bandwidth_budget(imaging: SplitImaging, angle_deg: float) -> BandwidthBudget:
    """Compute the cost of the filter of ``reference_fwhm_nm`` for a split by ``angle_deg``, and its remedies."""
    width = imaging.reference_fwhm_nm
    widths = np.unique(np.append(_WIDTHS * width, width))
    tradeoff = bandwidth_tradeoff(imaging, fwhm_nm=widths, angle_deg=angle_deg * _ANGLES)
    chosen, best = int(np.searchsorted(widths, width)), int(np.argmin(tradeoff.relative_error[-1]))
    kept = float(tradeoff.kept[-1, chosen])
    azimuth = np.arange(0.0, 360.0, _AZIMUTH_STEP_DEG)
    by_azimuth = imaging.filtered(width, [(angle_deg, float(a)) for a in azimuth])[0] / imaging.one_wavelength
    best_azimuth = int(np.argmax(by_azimuth))

    def remedy(change: str, row: int, column: int) -> Remedy:
        error = tradeoff.relative_error
        return Remedy(change, float(tradeoff.kept[row, column]), float(error[row, column] / error[-1, chosen]))

    rotation = f"the split turned by {azimuth[best_azimuth]:.0f} degrees against the mask"
    remedies = [
        remedy(f"a filter of {widths[best]:.3g} nm", -1, best),
        *(remedy(f"a split of {a:.3g} degrees", row, chosen) for row, a in enumerate(tradeoff.angle_deg[:-1])),
        Remedy(rotation, float(by_azimuth[best_azimuth]), math.sqrt(kept / float(by_azimuth[best_azimuth]))),
    ]
    effective = [item for item in remedies if item.depth_error_factor < 1.0]
    return BandwidthBudget(
        fwhm_nm=width,
        angle_deg=angle_deg,
        dispersion_um_per_nm=smear_um_per_nm(imaging.sensor_distance_um, angle_deg, imaging.wavelength_um),
        smear_um=float(tradeoff.smear_um[-1, chosen]),
        kept=kept,
        remedies=tuple(sorted(effective, key=lambda item: item.depth_error_factor)),
        tradeoff=tradeoff,
        azimuth_deg=azimuth,
        kept_by_azimuth=by_azimuth,
    )
