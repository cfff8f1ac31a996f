"""Figures of merit of a PSF stack: main lobe, efficiency through a pinhole, rotation, depth of field."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.special import j1

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.point_spread import Psf

#: Diameter of the pinhole in the efficiency measurement of Shen 2023 (Methods).
PINHOLE_UM = 100.0
#: Pixels on either side of the brightest one for the spline, and Newton steps to its maximum.
_REACH_PX, _NEWTON_STEPS = 6, 12


def main_lobe_px(psf: FloatArray) -> tuple[float, float, float]:
    """Return the position and height of the highest maximum, by a quintic spline through the pixels around it.

    The irradiance, shape (n_y, n_x), is sampled at or above its Nyquist rate. The position is (x, y) in pixels from the
    centre pixel ``[n_y // 2, n_x // 2]``.
    """
    n_y, n_x = psf.shape
    row, column = divmod(int(np.argmax(psf)), n_x)
    rows = np.arange(max(0, row - _REACH_PX), min(n_y, row + _REACH_PX + 1))
    columns = np.arange(max(0, column - _REACH_PX), min(n_x, column + _REACH_PX + 1))
    degree = min(5, rows.size - 1, columns.size - 1)
    if degree < 3:
        return float(column - n_x // 2), float(row - n_y // 2), float(psf[row, column])
    spline = RectBivariateSpline(rows, columns, psf[np.ix_(rows, columns)], kx=degree, ky=degree)

    def value(y: float, x: float, dy: int = 0, dx: int = 0) -> float:
        return float(spline([y], [x], dx=dy, dy=dx, grid=False)[0])

    y, x = float(row), float(column)
    for _ in range(_NEWTON_STEPS):
        slope = np.array([value(y, x, 1, 0), value(y, x, 0, 1)])
        mixed = value(y, x, 1, 1)
        hessian = np.array([[value(y, x, 2, 0), mixed], [mixed, value(y, x, 0, 2)]])
        if np.linalg.det(hessian) <= 0.0 or hessian[0, 0] >= 0.0:
            break
        step = np.clip(np.linalg.solve(hessian, slope), -0.5, 0.5)
        y = min(max(y - step[0], row - 1.0, rows[0]), row + 1.0, rows[-1])
        x = min(max(x - step[1], column - 1.0, columns[0]), column + 1.0, columns[-1])
        if np.abs(step).max() < 1e-9:
            break
    return x - n_x // 2, y - n_y // 2, value(y, x)


def orientation_deg(psf: FloatArray) -> FloatArray:
    """Return ``phi_deg`` of n images, shape (n, n_y, n_x): shape (n,), in (-180, 180]; NaN for a dark image.

    It is the angle of the main lobe about the centre pixel, counter-clockwise from +x. It is meaningless for a lobe at
    the centre, as of an ordinary lens.
    """
    places = [main_lobe_px(image) if image.any() else (math.nan, math.nan, 0.0) for image in psf]
    return np.array([math.degrees(math.atan2(y, x)) for x, y, _ in places])


def pinhole_efficiency(psf: Psf, diameter_um: float = PINHOLE_UM) -> FloatArray:
    """Return the share of the power at the aperture that passes a pinhole scanned for the maximum, shape (2, n_depth).

    This is the measure of diffraction efficiency in Shen 2023 (Methods). The pinhole is scanned over whole pixels. Its
    rim is exact: the irradiance is band-limited, so that the spectrum of the transmitted power is the spectrum of the
    irradiance times that of a disc, R J_1(2 pi R f) / f. InputError if the pinhole does not fit into the window.
    """
    n_y, n_x = psf.psf.shape[2:]
    reach = int(np.ceil(0.5 * diameter_um / psf.pixel_um))
    if 2 * reach + 1 > min(n_y, n_x):
        expected, got = f"a pinhole inside the window of {min(n_y, n_x) * psf.pixel_um:g} um", f"{diameter_um:g} um"
        raise InputError.single("PSF stack", "diameter_um", expected, got, "compute the stack on a larger window")
    radius_um = 0.5 * diameter_um
    frequency = np.hypot(np.fft.fftfreq(n_y, psf.pixel_um)[:, None], np.fft.rfftfreq(n_x, psf.pixel_um)[None, :])
    frequency[0, 0] = 1.0
    disc = radius_um * j1(2.0 * np.pi * radius_um * frequency) / frequency
    disc[0, 0] = np.pi * radius_um**2
    passed = np.fft.irfft2(np.fft.rfft2(psf.psf) * disc, (n_y, n_x))
    # Cyclic convolution: positions at which the pinhole crosses the edge of the window are left out.
    inside = passed[..., reach : n_y - reach, reach : n_x - reach]
    return np.asarray(inside.max(axis=(2, 3)))


def frame_efficiency(psf: Psf, width_um: float, height_um: float) -> FloatArray:
    """Return the share of the power at the aperture in a rectangle about the window's centre, shape (2, n_depth).

    Pixels on its rim count by their area inside. NaN if the window does not hold the rectangle.
    """
    inside = []
    for count, side_um in zip(psf.psf.shape[2:], (height_um, width_um), strict=True):
        side_px = side_um / psf.pixel_um
        if side_px > count - 1:
            return np.full(psf.psf.shape[:2], math.nan)
        inside.append(np.clip(0.5 * side_px - np.abs(np.arange(count) - count // 2) + 0.5, 0.0, 1.0))
    return np.asarray(np.einsum("pdyx,y,x->pd", psf.psf, *inside) * psf.pixel_um**2)


def largest_pinhole_um(psf: Psf, wanted_um: float = PINHOLE_UM) -> float:
    """Return ``wanted_um``, but at most three quarters of the window, which leaves room for the scan."""
    return float(min(wanted_um, 0.75 * min(psf.psf.shape[2:]) * psf.pixel_um))


def peak_on_edge(psf: Psf) -> bool:
    """Return whether the brightest pixel of a polarisation lies on the edge of its window, at the middle depth.

    The image then continues outside, and figures are those of a part of it.
    """
    middle = psf.psf[:, psf.depth_m.size // 2]
    inner = middle[:, 1:-1, 1:-1].max(axis=(1, 2), initial=0.0)
    return bool(np.any(middle.max(axis=(1, 2)) > inner))


def main_lobe_um(psf: Psf) -> FloatArray:
    """Return (x, y) of each main lobe from the geometric image point, shape (2, n_depth, 2)."""
    places = [[main_lobe_px(image)[:2] for image in stack] for stack in psf.psf]
    return np.asarray(places, dtype=np.float64) * psf.pixel_um


def peak_irradiance(psf: Psf) -> FloatArray:
    """Return the height of the main lobe, 1/um^2 per unit power, shape (2, n_depth)."""
    return np.array([[main_lobe_px(image)[2] for image in stack] for stack in psf.psf])


def relative_peak(psf: Psf, ideal: Psf) -> FloatArray:
    """Return the Strehl ratio, the peak over that of the target phases, shape (2, n_depth).

    InputError if the two stacks have different depths.
    """
    if psf.depth_m.shape != ideal.depth_m.shape or not np.allclose(psf.depth_m, ideal.depth_m):
        raise InputError.single("PSF stack", "ideal", f"depths {psf.depth_m}", f"{ideal.depth_m}", "compute both alike")
    return np.asarray(peak_irradiance(psf) / peak_irradiance(ideal))


def rotation_deg(psf: Psf) -> float:
    """Return the rotation of the main lobe of PSF_x from the first to the last depth, counter-clockwise, unwrapped.

    Neighbouring depths must differ by less than half a turn.
    """
    turn = np.unwrap(psf.phi_deg, period=360.0)
    return float(turn[-1] - turn[0])


def depth_of_field_dioptre(psf: Psf) -> FloatArray:
    """Return the span of vergence about the brightest depth over which the peak exceeds 80 % of the highest.

    Its shape is (2,). Peaks are linear between depths. If the span reaches an end of the stack, the value is a lower
    bound.
    """
    peaks, vergence = peak_irradiance(psf), 1.0 / psf.depth_m
    spans = []
    for curve in peaks:
        best, level = int(np.argmax(curve)), 0.8 * float(curve.max())
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
