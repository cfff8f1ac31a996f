"""PSFs over the band of a filter, from a few wavelengths whose windows follow the image point.

A split or grating moves the image with the wavelength (3.8 um per nanometre in the lens of Shen 2023). About its image
point the PSF changes slowly, by defocus alone. Images are therefore computed on windows about each wavelength's image
point, interpolated between a few wavelengths by polynomials, and shifted and added as spectra:

    PSF^(f) = sum over n of PSF_n^(f) x mean over the band of L_n(lambda) exp(-2 pi i f . s(lambda)),

where s is the shift of the image point and L_n are the Lagrange polynomials. The filter has a flat top. Optical paths
disperse; the pillars' amplitudes are those of the design wavelength.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.optics.geometry.imaging import Imaging, Tangent

#: Images at the wavelength of an :class:`Imaging`, on a window of a number of points along a side, and their errors,
#: which are estimated if the last argument is true.
Monochromatic = Callable[[Imaging, int, bool], tuple[FloatArray, FloatArray]]

#: Fewest and most wavelengths of a band.
_FEWEST_WAVELENGTHS = 4
_MOST_WAVELENGTHS = 33
#: Wavelengths whose own error is estimated: the band ends, between which it changes by a few per cent.
_JUDGED_WAVELENGTHS = 2
#: Pixels over which images fade out, beyond the region that can be shifted into the window.
_ROLL_OFF_PX = 8


def at_wavelength(imaging: Imaging, wavelength_um: float) -> Imaging:
    """Return the lens at another wavelength; deflection by a phase gradient is proportional to the wavelength."""
    ratio = wavelength_um / imaging.wavelength_um
    sine = ratio * math.sin(math.radians(imaging.split_angle_deg))
    (a, b), (c, d) = imaging.deflection
    deflection = ((ratio * a, ratio * b), (ratio * c, ratio * d))
    angle_deg = math.degrees(math.asin(sine))
    there = replace(imaging, wavelength_um=wavelength_um, split_angle_deg=angle_deg, deflection=deflection)
    if imaging.crystal is None:
        return there
    crystal = imaging.crystal.at_wavelength(wavelength_um)
    return replace(there, crystal=crystal, plates=(crystal.plate, crystal.plate))


def band_ends(imaging: Imaging, filter_fwhm_nm: float) -> tuple[Imaging, Imaging]:
    """Return the lens at the shortest and at the longest wavelength of a filter."""
    half_um = 0.5e-3 * filter_fwhm_nm
    low, high = (at_wavelength(imaging, imaging.wavelength_um + end) for end in (-half_um, half_um))
    return low, high


def padded_px(imaging: Imaging, tangent: Tangent, filter_fwhm_nm: float, window_px: int) -> int:
    """Return the side of the single-wavelength windows that, once shifted, fill one of ``window_px`` points."""
    ends = band_ends(imaging, filter_fwhm_nm)
    farthest_um = max(
        float(np.abs(np.subtract(end.image_point_um(p, tangent), imaging.image_point_um(p, tangent))).max())
        for end in ends
        for p in (0, 1)
    )
    pad = math.ceil(farthest_um / imaging.pixel_um) + 2 if farthest_um > 0.0 else 0
    return int(next_fast_len(window_px + 2 * (pad + _ROLL_OFF_PX), real=True))


def band_irradiance(
    monochromatic: Monochromatic,
    imaging: Imaging,
    polarisation: int,
    tangent: Tangent,
    filter_fwhm_nm: float,
    window_px: int,
    target_error: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the irradiance over the band of a filter about the image point of the middle wavelength, and its errors.

    Wavelengths are added one by one in Leja order until the relative L2 error is ``target_error``. The remaining
    interpolation error is extrapolated as a geometric series from the last changes of the sum. ``imaging`` is that of
    the middle of the band, ``filter_fwhm_nm`` the full width of a flat top, ``polarisation`` 0 for x and 1 for y.

    Images have shape (n_depth, n, n), n = ``window_px``; the errors are of the depths that ``monochromatic`` judges:
    the largest of the judged wavelengths plus that of the interpolation. InputError for pixels too coarse for shifts by
    a fraction of a pixel.
    """
    _require_fine_pixels(imaging, polarisation, tangent)
    half_um = 0.5e-3 * filter_fwhm_nm
    middle = np.array(imaging.image_point_um(polarisation, tangent))
    side = padded_px(imaging, tangent, filter_fwhm_nm, window_px)
    fade, start = _fade(side), side // 2 - window_px // 2
    inside = slice(start, start + window_px)

    def shift_px(detuning: float) -> FloatArray:
        there = at_wavelength(imaging, imaging.wavelength_um + half_um * detuning)
        return np.asarray((there.image_point_um(polarisation, tangent) - middle) / imaging.pixel_um, dtype=np.float64)

    # Periods of the shift's phase over half the band at the highest frequency; the polynomial degree comes on top.
    beats = max(float(np.abs(shift_px(end)).max()) for end in (-1.0, 1.0))
    spectra: list[ComplexArray] = []
    errors: list[FloatArray] = []

    def interpolated() -> FloatArray:
        """The band's images by interpolation between the wavelengths so far."""
        nodes = _leja_points()[: len(spectra)]
        detuning, weight = np.polynomial.legendre.leggauss(len(spectra) + math.ceil(2.0 * beats) + 8)
        shifts = np.array([shift_px(float(d)) for d in detuning])
        along_y = np.exp(-2j * np.pi * np.outer(shifts[:, 1], np.fft.fftfreq(side)))
        along_x = np.exp(-2j * np.pi * np.outer(shifts[:, 0], np.fft.rfftfreq(side)))
        total = np.zeros_like(spectra[0])
        for image, share in zip(spectra, 0.5 * weight * _lagrange(nodes, detuning), strict=True):
            total += image * ((along_y * share[:, None]).T @ along_x)
        return np.asarray(irfft2(total, (side, side))[:, inside, inside])

    before, changes, remaining = np.zeros(()), [1.0], math.inf
    for count, node in enumerate(_leja_points().tolist(), start=1):
        there = at_wavelength(imaging, imaging.wavelength_um + half_um * node)
        images, error = monochromatic(there, side, count <= _JUDGED_WAVELENGTHS)
        spectra.append(rfft2(images * fade))
        errors += [error] if count <= _JUDGED_WAVELENGTHS else []
        fine = interpolated()
        changes.append(_largest_change(fine, before))
        remaining = _extrapolated_change(changes)
        if count >= _FEWEST_WAVELENGTHS and remaining <= target_error:
            break
        before = fine
    return fine, np.max(errors, axis=0) + remaining


def _extrapolated_change(changes: list[float]) -> float:
    """Sum of the geometric series that continues the changes.

    Its first term is the larger of the last two changes, as one may be small by chance. Its ratio is the larger of the
    last two, which alternate between odd and even counts, and at least a quarter.
    """
    ratios = [after / before if before > 0.0 else 0.0 for before, after in pairwise(changes[-3:])]
    ratio = min(max(0.25, *ratios), 0.9)
    return max(changes[-1], ratio * changes[-2]) * ratio / (1.0 - ratio)


def _largest_change(fine: FloatArray, before: FloatArray) -> float:
    """Largest relative L2 difference of any image; 0 where both are dark."""
    change, norm = (np.linalg.norm(part, axis=(1, 2)) for part in (fine - before, fine))
    return float(np.max(np.divide(change, norm, out=np.zeros_like(norm), where=norm > 0.0)))


@cache
def _leja_points() -> FloatArray:
    """Leja points on -1..1: each maximises the product of its distances to all earlier points.

    Interpolation at the first n of them is nearly as good as at n Chebyshev points, for every n.
    """
    grid = np.linspace(-1.0, 1.0, 2001)
    chosen = [-1.0, 1.0]
    distances = np.abs((grid - chosen[0]) * (grid - chosen[1]))
    while len(chosen) < _MOST_WAVELENGTHS:
        chosen.append(round(float(grid[np.argmax(distances)]), 12))
        distances *= np.abs(grid - chosen[-1])
    return np.array(chosen)


def _lagrange(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """Lagrange polynomials of the nodes at ``at``, shape (n_nodes, n)."""
    polynomials = []
    for index, node in enumerate(nodes):
        others = np.delete(nodes, index)[:, None]
        polynomials.append(np.prod((at - others) / (node - others), axis=0))
    return np.array(polynomials)


def _fade(side: int) -> FloatArray:
    """Taper, shape (side, side), that falls to 0 over the outermost pixels, against ringing of shifted spectra."""
    edge = np.sin(0.5 * np.pi * (np.arange(_ROLL_OFF_PX) + 0.5) / _ROLL_OFF_PX) ** 2
    along = np.concatenate([edge, np.ones(side - 2 * _ROLL_OFF_PX), edge[::-1]])
    return np.outer(along, along)


def _require_fine_pixels(imaging: Imaging, polarisation: int, tangent: Tangent) -> None:
    largest = 0.5 * imaging.finest_fringe_um(polarisation, tangent)
    if imaging.pixel_um > largest:
        expected = f"at most {largest:.3g} um, half the period of the finest fringe, to add the wavelengths of a filter"
        remedy = "sample finer, or leave `optics.filter_fwhm_nm` out"
        raise InputError.single("optics", "pixel_um", expected, f"{imaging.pixel_um:g} um", remedy)
