"""Figures of merit of a PSF stack: what the paper measured, and what a lens designer asks for."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.lobe import main_lobe_px
from metafab.optics.point_spread import Psf


def pinhole_efficiency(psf: Psf, diameter_um: float = 100.0) -> FloatArray:
    """Share of the power at the aperture that passes a pinhole about the PSF, placed where most passes.

    The paper's measure of diffraction efficiency (Methods): a pinhole of 100 um, scanned for the maximum. It is
    scanned over whole pixels; a pixel counts by its centre.

    Returns:
        Shape (2, n_depth).

    Raises:
        InputError: the pinhole does not fit into the window.
    """
    n = min(psf.psf.shape[2:])
    reach = int(np.ceil(0.5 * diameter_um / psf.pixel_um))
    if 2 * reach + 1 > n:
        raise InputError.single(
            "PSF stack",
            "diameter_um",
            f"a pinhole inside the window of {n * psf.pixel_um:g} um",
            f"{diameter_um:g} um",
            "compute the stack on a larger window",
        )
    step = np.arange(-reach, reach + 1) * psf.pixel_um
    disc = (np.hypot(step[None, :], step[:, None]) <= 0.5 * diameter_um).astype(np.float64)
    spectrum = np.fft.rfft2(psf.psf) * np.fft.rfft2(disc, psf.psf.shape[2:])
    # Cyclic convolution: places where the pinhole would reach over the window's edge are left out.
    passed = np.fft.irfft2(spectrum, psf.psf.shape[2:])[..., 2 * reach :, 2 * reach :]
    return np.asarray(passed.max(axis=(2, 3)) * psf.pixel_um**2)


def peak_irradiance(psf: Psf) -> FloatArray:
    """Height of the main lobe, 1/um^2 per unit power, shape (2, n_depth)."""
    return np.array([[main_lobe_px(image)[2] for image in stack] for stack in psf.psf])


def relative_peak(psf: Psf, ideal: Psf) -> FloatArray:
    """Peak against that of the target phases at the same depths (a Strehl ratio), shape (2, n_depth).

    Raises:
        InputError: the two stacks stand at different depths.
    """
    if psf.depth_m.shape != ideal.depth_m.shape or not np.allclose(psf.depth_m, ideal.depth_m):
        raise InputError.single("PSF stack", "ideal", f"depths {psf.depth_m}", f"{ideal.depth_m}", "compute both alike")
    return np.asarray(peak_irradiance(psf) / peak_irradiance(ideal))


def rotation_deg(psf: Psf) -> float:
    """Turn of PSF_x's main lobe from the first to the last depth, counter-clockwise positive, whole turns counted.

    Neighbouring depths must differ by less than half a turn.
    """
    turn = np.unwrap(psf.phi_deg, period=360.0)
    return float(turn[-1] - turn[0])


def modulation_transfer(psf: Psf) -> tuple[FloatArray, FloatArray]:
    """MTF averaged over azimuth.

    Returns:
        Mean frequency of each ring, shape (n_frequency,), cycles per um from 0 to half the sampling rate; and the
        mean modulus of the PSF's spectrum over its value at 0, shape (2, n_depth, n_frequency).
    """
    n_y, n_x = psf.psf.shape[2:]
    spectrum = np.abs(np.fft.fft2(psf.psf))
    radial = np.hypot(np.fft.fftfreq(n_y)[:, None], np.fft.fftfreq(n_x)[None, :])
    count = min(n_y, n_x) // 2
    ring = np.rint(radial * 2 * count).astype(np.int64)
    pixels = np.bincount(ring.ravel())[: count + 1]
    flat = spectrum.reshape(*spectrum.shape[:2], -1)
    mean = np.array([[np.bincount(ring.ravel(), image)[: count + 1] / pixels for image in stack] for stack in flat])
    with np.errstate(invalid="ignore"):
        frequency = np.bincount(ring.ravel(), radial.ravel())[: count + 1] / (pixels * psf.pixel_um)
        return frequency, mean / mean[:, :, :1]


def depth_of_field_dioptre(psf: Psf, share: float = 0.8) -> FloatArray:
    """Span of vergence about the brightest depth over which the peak stays above ``share`` of the highest.

    Linear between depths; a span that reaches an end of the stack is at least what is given.

    Returns:
        Shape (2,), dioptre.
    """
    peaks, vergence = peak_irradiance(psf), 1.0 / psf.depth_m
    spans = []
    for curve in peaks:
        best, level = int(np.argmax(curve)), share * float(curve.max())
        ends = [_crossing(vergence[best::step], curve[best::step], level) for step in (1, -1)]
        spans.append(abs(ends[0] - ends[1]))
    return np.array(spans)


def _crossing(vergence: FloatArray, curve: FloatArray, level: float) -> float:
    below = np.flatnonzero(curve < level)
    if below.size == 0:
        return float(vergence[-1])
    i = int(below[0])
    part = (curve[i - 1] - level) / (curve[i - 1] - curve[i])
    return float(vergence[i - 1] + part * (vergence[i] - vergence[i - 1]))
