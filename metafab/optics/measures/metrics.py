"""Figures of merit of a PSF stack: what the paper measured, and what a lens designer asks for."""

from __future__ import annotations

import numpy as np
from scipy.special import j1

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.measures.lobe import main_lobe_px
from metafab.optics.point_spread import Psf

#: Diameter of the pinhole through which the paper measured efficiencies.
PINHOLE_UM = 100.0


def pinhole_efficiency(psf: Psf, diameter_um: float = PINHOLE_UM) -> FloatArray:
    """Share of the power at the aperture that passes a pinhole about the PSF, placed where most passes.

    The paper's measure of diffraction efficiency (Methods): a pinhole of 100 um, scanned for the maximum. It is
    scanned over whole pixels. Its rim is exact: the irradiance is band-limited, so that its spectrum times that of a
    disc, R J_1(2 pi R f) / f, is the spectrum of what passes.

    Returns:
        Shape (2, n_depth).

    Raises:
        InputError: the pinhole does not fit into the window.
    """
    n_y, n_x = psf.psf.shape[2:]
    reach = int(np.ceil(0.5 * diameter_um / psf.pixel_um))
    if 2 * reach + 1 > min(n_y, n_x):
        raise InputError.single(
            "PSF stack",
            "diameter_um",
            f"a pinhole inside the window of {min(n_y, n_x) * psf.pixel_um:g} um",
            f"{diameter_um:g} um",
            "compute the stack on a larger window",
        )
    radius_um = 0.5 * diameter_um
    frequency = np.hypot(np.fft.fftfreq(n_y, psf.pixel_um)[:, None], np.fft.rfftfreq(n_x, psf.pixel_um)[None, :])
    frequency[0, 0] = 1.0
    disc = radius_um * j1(2.0 * np.pi * radius_um * frequency) / frequency
    disc[0, 0] = np.pi * radius_um**2
    passed = np.fft.irfft2(np.fft.rfft2(psf.psf) * disc, (n_y, n_x))
    # Cyclic convolution: places where the pinhole would reach over the window's edge are left out.
    inside = passed[..., reach : n_y - reach, reach : n_x - reach]
    return np.asarray(inside.max(axis=(2, 3)))


def largest_pinhole_um(psf: Psf, wanted_um: float = PINHOLE_UM) -> float:
    """``wanted_um``, or three quarters of the window where that is smaller: it must have room to be scanned."""
    return float(min(wanted_um, 0.75 * min(psf.psf.shape[2:]) * psf.pixel_um))


def main_lobe_um(psf: Psf) -> FloatArray:
    """(x, y) of each main lobe from the geometric image point, to a fraction of a pixel: shape (2, n_depth, 2)."""
    places = [[main_lobe_px(image)[:2] for image in stack] for stack in psf.psf]
    return np.asarray(places, dtype=np.float64) * psf.pixel_um


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
