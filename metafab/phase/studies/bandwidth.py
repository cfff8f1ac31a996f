"""What the width of the colour filter costs: the split carrier is a grating, and spreads colours along x.

The carrier sends the wavelength lambda to sin(theta) lambda / lambda_0, so each channel is smeared along the split,
in opposite senses; and the lens, diffractive too, has a power in proportion to the wavelength, which turns the lobe.
Both keep the pair conjugate but wash out its phase, where the depth is. A wider filter lets in more light: the best
width balances the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.information.twin_images import Texture
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.pupil import Pupil, rim_defocus_per_dioptre_rad

#: Widths of the filter that are compared, over the chosen one; and angles of the split, over the design's.
_WIDTHS = np.geomspace(1.0 / 16.0, 2.0, 11)
_ANGLES = np.array([0.25, 0.5, 1.0])
_AZIMUTH_STEP_DEG = 30.0


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


@dataclass(frozen=True)
class SplitImaging:
    """What the filter acts on: a mask behind a split lens, over a range of depths, with unknown texture.

    Attributes:
        pupil: samples; PSFs must fit in twice as many Nyquist pixels together with their smear.
        mask: shape (n,), its complex transmission for x polarisation; y is the point mirror.
        defocus_rad: shape (n_depth,), rim defocuses over which information is averaged.
        aperture_um: diameter.
        focal_length_mm: focal length at the design wavelength.
        sensor_distance_um: distance of the sensor plane.
        wavelength_um: design wavelength, the filter's centre.
        texture: unknown texture and noise, per Nyquist pixel, with the electrons of ``reference_fwhm_nm``.
        reference_fwhm_nm: the width at which ``texture`` has its electrons; they go with the width.
    """

    pupil: Pupil
    mask: ComplexArray
    defocus_rad: FloatArray
    aperture_um: float
    focal_length_mm: float
    sensor_distance_um: float
    wavelength_um: float
    texture: Texture = field(default_factory=Texture)
    reference_fwhm_nm: float = 10.0

    @cached_property
    def one_wavelength(self) -> float:
        """Mean information over the depths without any bandwidth, with the electrons of the reference width."""
        return float(self._blind.of_field(self.mask).mean())

    @cached_property
    def _blind(self) -> BlindInformation:
        return BlindInformation(self.pupil, self.defocus_rad, self.texture)

    @property
    def nyquist_um(self) -> float:
        """Step of the grid on the sensor, lambda s' / (4 R)."""
        return self.wavelength_um * self.sensor_distance_um / (2.0 * self.aperture_um)

    def filtered(self, fwhm_nm: float, splits: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        """Mean information behind a filter with a flat top, for several splits.

        Args:
            fwhm_nm: full width.
            splits: angle of the split and its azimuth (x polarisation goes to azimuth + 180), degrees.

        Returns:
            For each split the information with the electrons of the reference width, and with those of this one.
        """
        smears = [smear_um_per_nm(self.sensor_distance_um, angle, self.wavelength_um) for angle, _ in splits]
        # A longer wavelength is focused nearer: the power 1 / f grows by d lambda / lambda.
        per_dioptre = rim_defocus_per_dioptre_rad(0.5 * self.aperture_um, self.wavelength_um)
        power_rad = -per_dioptre * 1e3 / self.focal_length_mm / (1e3 * self.wavelength_um)
        # Enough wavelengths for the fastest beat: half a turn a Nyquist pixel of smear, and the turning of the lobe.
        beats = max(smears) * fwhm_nm / self.nyquist_um + abs(power_rad) * fwhm_nm / math.pi
        nodes, shares = np.polynomial.legendre.leggauss(6 + math.ceil(2.0 * beats))
        frequency = np.fft.fftfreq(2 * self.pupil.samples)
        transfer = np.zeros((len(splits), self.defocus_rad.size, frequency.size, frequency.size), dtype=np.complex128)
        slope = np.zeros_like(transfer)
        for node, share in zip(nodes, shares, strict=True):
            detuning_nm = 0.5 * fwhm_nm * float(node)
            blind = replace(self._blind, defocus_rad=self.defocus_rad + power_rad * detuning_nm)
            parts = blind.transfer(self.mask)
            for row, (smear, (_, azimuth_deg)) in enumerate(zip(smears, splits, strict=True)):
                # PSF_x moves towards -x, as its image does, with growing wavelength.
                shift = 2j * np.pi * smear * detuning_nm / self.nyquist_um
                azimuth = math.radians(azimuth_deg)
                turn = np.outer(
                    np.exp(shift * math.sin(azimuth) * frequency), np.exp(shift * math.cos(azimuth) * frequency)
                )
                transfer[row] += 0.5 * share * turn * parts[0]
                slope[row] += 0.5 * share * turn * parts[1]
        electrons = self.texture.electrons * fwhm_nm / self.reference_fwhm_nm
        shone = replace(self.texture, electrons=electrons)
        return [
            (_information(one, its, self.texture), _information(one, its, shone))
            for one, its in zip(transfer, slope, strict=True)
        ]


def bandwidth_tradeoff(
    imaging: SplitImaging, *, fwhm_nm: ArrayLike, angle_deg: ArrayLike, split_azimuth_deg: float = 0.0
) -> BandwidthTradeoff:
    """The cost of bandwidth for a mask, at several widths of the filter and angles of the split.

    The change of the PSF's scale with the wavelength (1 % at 8 nm) is left out.

    Args:
        imaging: mask, lens, depths and texture.
        fwhm_nm: shape (n_width,), positive.
        angle_deg: shape (n_angle,).
        split_azimuth_deg: direction of the split, counter-clockwise from x.
    """
    widths, angles = np.atleast_1d(np.asarray(fwhm_nm, float)), np.atleast_1d(np.asarray(angle_deg, float))
    splits = [(float(angle), split_azimuth_deg) for angle in angles]
    told = np.array([imaging.filtered(float(width), splits) for width in widths])  # (width, angle, electrons)
    smears = [smear_um_per_nm(imaging.sensor_distance_um, angle, imaging.wavelength_um) for angle in angles]
    kept, shone = told[:, :, 0].T / imaging.one_wavelength, told[:, :, 1].T
    return BandwidthTradeoff(widths, angles, np.outer(smears, widths), kept, np.sqrt(imaging.one_wavelength / shone))


@dataclass(frozen=True)
class Remedy:
    """A change against the cost of a filter.

    Attributes:
        change: what to do.
        kept: information over that of one wavelength with the same electrons.
        relative_error: smallest standard deviation of depth over that of the design as it is, with the electrons
            that the change lets through.
    """

    change: str
    kept: float
    relative_error: float


@dataclass(frozen=True)
class BandwidthBudget:
    """What a filter costs a design, and what helps.

    Attributes:
        fwhm_nm: full width of the filter.
        angle_deg: angle of the split.
        dispersion_um_per_nm: shift of an image along the split per nanometre.
        smear_um: spread of a point along the split.
        kept: information over that of one wavelength with the same electrons.
        remedies: what helps, the most helpful first. The diffraction order of the carrier is not among them: at the
            same angle every order has the dispersion tan(theta) / lambda of the grating equation.
        tradeoff: widths against angles; errors are over those of one wavelength with the chosen filter's electrons.
        azimuth_deg: shape (n_azimuth,), directions of the split against the mask; 180 swaps the polarisations.
        kept_by_azimuth: shape (n_azimuth,), at the chosen width and angle.
    """

    fwhm_nm: float
    angle_deg: float
    dispersion_um_per_nm: float
    smear_um: float
    kept: float
    remedies: tuple[Remedy, ...]
    tradeoff: BandwidthTradeoff
    azimuth_deg: FloatArray
    kept_by_azimuth: FloatArray


def bandwidth_budget(imaging: SplitImaging, angle_deg: float) -> BandwidthBudget:
    """The cost of the filter of ``reference_fwhm_nm`` for a split by ``angle_deg``, and what lowers it."""
    width = imaging.reference_fwhm_nm
    widths = np.unique(np.append(_WIDTHS * width, width))
    tradeoff = bandwidth_tradeoff(imaging, fwhm_nm=widths, angle_deg=angle_deg * _ANGLES)
    chosen = int(np.searchsorted(widths, width))
    kept, error = float(tradeoff.kept[-1, chosen]), float(tradeoff.relative_error[-1, chosen])
    azimuth = np.arange(0.0, 360.0, _AZIMUTH_STEP_DEG)
    told = imaging.filtered(width, [(angle_deg, float(a)) for a in azimuth])
    by_azimuth = np.array([information for information, _ in told]) / imaging.one_wavelength
    best, turned = int(np.argmin(tradeoff.relative_error[-1])), int(np.argmax(by_azimuth))
    remedies = [
        Remedy(
            f"a filter of {widths[best]:.3g} nm",
            float(tradeoff.kept[-1, best]),
            float(tradeoff.relative_error[-1, best]) / error,
        ),
        *(
            Remedy(
                f"a split of {angle:.3g} degrees",
                float(tradeoff.kept[row, chosen]),
                float(tradeoff.relative_error[row, chosen]) / error,
            )
            for row, angle in enumerate(tradeoff.angle_deg[:-1])
        ),
        Remedy(
            f"the split turned by {azimuth[turned]:.0f} degrees against the mask",
            float(by_azimuth[turned]),
            math.sqrt(kept / float(by_azimuth[turned])),
        ),
    ]
    return BandwidthBudget(
        width,
        angle_deg,
        smear_um_per_nm(imaging.sensor_distance_um, angle_deg, imaging.wavelength_um),
        float(tradeoff.smear_um[-1, chosen]),
        kept,
        tuple(sorted((r for r in remedies if r.relative_error < 1.0), key=lambda r: r.relative_error)),
        tradeoff,
        azimuth,
        by_azimuth,
    )


def _information(transfer: ComplexArray, slope: ComplexArray, texture: Texture) -> float:
    """Mean over depths of the information in a conjugate pair with these transfer functions of x polarisation."""
    snr = texture.signal_to_noise((transfer.shape[1], transfer.shape[2]))
    turn = (slope * transfer.conj()).imag
    density = 4.0 * (snr * turn) ** 2 / (1.0 + 2.0 * snr * np.abs(transfer) ** 2)
    return float(density.sum() / len(transfer))
