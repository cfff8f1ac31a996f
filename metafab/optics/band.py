"""PSFs in the light of a filter's band: few wavelengths, each followed to where its image lands.

A split or grating moves the image with the wavelength (3.8 um a nanometre in the paper's lens), but about its own
image point the PSF changes slowly, by defocus alone. Images are therefore computed on windows that go along,
interpolated between a few wavelengths by polynomials, and shifted and added as spectra:

    PSF^(f) = sum over n of PSF_n^(f) x mean over the band of L_n(lambda) exp(-2 pi i f . s(lambda)),

s being the image point's shift and L_n the Lagrange polynomials. The filter has a flat top. Light's paths disperse,
the pillars' amplitudes are those of the design wavelength.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.interpolate import BarycentricInterpolator

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.optics.imaging import Imaging

Tangent = tuple[float, float]
#: Images on a window of so many points a side by an :class:`Imaging` of one wavelength, and their errors.
Monochromatic = Callable[[Imaging, int], tuple[FloatArray, FloatArray]]

_MOST_WAVELENGTHS = 33
#: Pixels around what can be shifted into the window, over which images fade out.
_ROLL_OFF_PX = 8
#: What is left of the change when the number of wavelengths is doubled, for polynomials through Lobatto points.
_LEFT = 0.25


def at_wavelength(imaging: Imaging, wavelength_um: float) -> Imaging:
    """The same lens in other light: what deflects by a phase gradient does so in proportion to the wavelength."""
    ratio = wavelength_um / imaging.wavelength_um
    sine = ratio * math.sin(math.radians(imaging.split_angle_deg))
    (a, b), (c, d) = imaging.deflection
    deflection = ((ratio * a, ratio * b), (ratio * c, ratio * d))
    angle_deg = math.degrees(math.asin(sine))
    return replace(imaging, wavelength_um=wavelength_um, split_angle_deg=angle_deg, deflection=deflection)


def band_ends(imaging: Imaging, filter_fwhm_nm: float) -> tuple[Imaging, Imaging]:
    """The lens in light of the shortest and of the longest wavelength that a filter lets through."""
    half_um = 0.5e-3 * filter_fwhm_nm
    low, high = (at_wavelength(imaging, imaging.wavelength_um + end) for end in (-half_um, half_um))
    return low, high


def band_irradiance(
    monochromatic: Monochromatic,
    imaging: Imaging,
    polarisation: int,
    tangent: Tangent,
    filter_fwhm_nm: float,
    window_px: int,
    target_error: float,
) -> tuple[FloatArray, FloatArray]:
    """Irradiance in the light of a filter about the image point of its middle wavelength.

    Args:
        monochromatic: computes images of one wavelength.
        imaging: geometry in the middle of the band.
        polarisation: 0 for x, 1 for y.
        tangent: object direction.
        filter_fwhm_nm: full width of the filter, which has a flat top.
        window_px: points a side of the window.
        target_error: wavelengths are doubled until the interpolation between them keeps to it.

    Returns:
        Images, shape (n_depth, n, n), and their errors (relative L2), of the depths that ``monochromatic`` judges:
        the largest of any wavelength and the interpolation's.

    Raises:
        InputError: pixels too large for the images to be shifted by less than one.
    """
    _require_fine_pixels(imaging, polarisation, tangent)
    half_um = 0.5e-3 * filter_fwhm_nm
    middle = np.array(imaging.image_point_um(polarisation, tangent))

    def shift_um(detuning_um: float) -> FloatArray:
        there = at_wavelength(imaging, imaging.wavelength_um + detuning_um)
        return np.asarray(there.image_point_um(polarisation, tangent) - middle, dtype=np.float64)

    farthest = max(float(np.abs(shift_um(d)).max()) for d in (-half_um, half_um))
    pad = math.ceil(farthest / imaging.pixel_um) + 2 if farthest > 0.0 else 0
    side = next_fast_len(window_px + 2 * (pad + _ROLL_OFF_PX), real=True)
    fade = _fade(side)
    # Turns of the shift's phase over half the band at the highest frequency; the polynomials' degree comes on top.
    beats = farthest / imaging.pixel_um
    detuning, weight = np.polynomial.legendre.leggauss(2 * _MOST_WAVELENGTHS + math.ceil(2.0 * beats))
    shifts = np.array([shift_um(half_um * float(d)) for d in detuning])
    along_y, along_x = (
        np.exp(-2j * np.pi * np.outer(shifts[:, axis] / imaging.pixel_um, frequency))
        for axis, frequency in ((1, np.fft.fftfreq(side)), (0, np.fft.rfftfreq(side)))
    )

    known: dict[float, tuple[ComplexArray, FloatArray]] = {}

    def mixed(count: int) -> FloatArray:
        nodes = np.round(np.cos(np.pi * np.arange(count) / (count - 1)), 12) + 0.0
        for node in nodes.tolist():
            if node not in known:
                there = at_wavelength(imaging, imaging.wavelength_um + half_um * node)
                images, error = monochromatic(there, side)
                known[node] = rfft2(images * fade), error
        share = 0.5 * weight[:, None] * BarycentricInterpolator(nodes, np.eye(count))(detuning)
        mean_shifts = [(along_y * column[:, None]).T @ along_x for column in share.T]
        total = sum(known[node][0] * mean for node, mean in zip(nodes.tolist(), mean_shifts, strict=True))
        start = side // 2 - window_px // 2
        inside = slice(start, start + window_px)
        return np.asarray(irfft2(total, (side, side))[:, inside, inside])

    count = 3
    coarse = mixed(count)
    while True:
        count = 2 * count - 1
        fine = mixed(count)
        change = np.linalg.norm(fine - coarse, axis=(1, 2))
        norm = np.linalg.norm(fine, axis=(1, 2))
        left = _LEFT * float(np.max(np.divide(change, norm, out=np.zeros_like(norm), where=norm > 0.0)))
        if left <= target_error or count >= _MOST_WAVELENGTHS:
            break
        coarse = fine
    error = np.max([error for _, error in known.values()], axis=0) + left
    return fine, error


def _fade(side: int) -> FloatArray:
    """1, falling to 0 over the outermost pixels, so that shifted spectra do not ring: shape (side, side)."""
    edge = np.sin(0.5 * np.pi * (np.arange(_ROLL_OFF_PX) + 0.5) / _ROLL_OFF_PX) ** 2
    along = np.concatenate([edge, np.ones(side - 2 * _ROLL_OFF_PX), edge[::-1]])
    return np.outer(along, along)


def _require_fine_pixels(imaging: Imaging, polarisation: int, tangent: Tangent) -> None:
    x, y = imaging.image_point_um(polarisation, tangent)
    half = 0.5 * imaging.aperture_um
    ends = []
    for edge_x, edge_y, axis in ((half, 0.0, 0), (0.0, half, 1)):
        there, back = (np.array([x - s * edge_x, y - s * edge_y, imaging.sensor_distance_um]) for s in (1.0, -1.0))
        ends.append(abs(there[axis] / np.linalg.norm(there) - back[axis] / np.linalg.norm(back)))
    largest = 0.5 * imaging.wavelength_um / max(ends)
    if imaging.pixel_um > largest:
        raise InputError.single(
            "optics", "pixel_um", f"at most {largest:.3g} um, half the period of the finest fringe, to add a filter's "
            "wavelengths", f"{imaging.pixel_um:g} um", "sample finer, or leave `optics.filter_fwhm_nm` out",
        )  # fmt: skip
