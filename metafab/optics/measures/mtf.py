"""Modulation transfer function (MTF) of a PSF pair over depth, and of a standard lens of the same aperture."""

from __future__ import annotations

import math

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.point_spread import Psf
from metafab.spec import Device

#: Fewest and most samples across a standard lens.
_SAMPLES, _MOST_SAMPLES = 192, 1024
#: Further samples for each radian of rim defocus.
_SAMPLES_PER_RAD = 6.0


def modulation_transfer(psf: Psf) -> tuple[FloatArray, FloatArray]:
    """Return the MTF averaged over azimuth, of the transmitted light: frequencies and moduli.

    The frequencies are the means of rings, shape (n_frequency,), cycles per um from 0 to half the sampling rate. The
    moduli, shape (2, n_depth, n_frequency), are means of the modulus of the window's spectrum over the transmitted
    power, and 1 at frequency 0: transmitted light outside the window is a background without modulation. A pair without
    a power budget, such as a measured one, is normalised by the power in its window.
    """
    n_y, n_x = psf.psf.shape[2:]
    spectrum = np.abs(np.fft.fft2(psf.psf))
    frequency, mean = _rings(spectrum.reshape(-1, n_y, n_x), 1.0 / (n_y * psf.pixel_um), 1.0 / (n_x * psf.pixel_um))
    mean = mean.reshape(*psf.psf.shape[:2], -1)
    whole = mean[..., :1].copy()
    if psf.details.transmitted:
        whole = np.maximum(whole, np.array(psf.details.transmitted)[:, None, None] / psf.pixel_um**2)
    with np.errstate(invalid="ignore"):
        mean = mean / whole
        mean[..., 0] /= mean[..., 0]
    return frequency, mean


def lens_cut_off_per_um(imaging: Imaging) -> float:
    """Return the cut-off frequency of a lens on the axis, 2 NA / wavelength, for the aperture and focus of a design."""
    return 2.0 * _rim_sine(imaging) / imaging.wavelength_um


def lens_modulation(
    imaging: Imaging, device: Device, depth_m: float, frequency_per_um: FloatArray, focus_depth_m: float
) -> FloatArray:
    """Return the MTF, averaged over azimuth, of an ideal flat lens with the aperture and focus of a design.

    The transfer function is the autocorrelation of the pupil (Goodman, Introduction to Fourier Optics, 6.4) in
    direction cosines s towards the image. A flat lens, evenly lit at x = z s / sqrt(1 - s^2), has the pupil
    1 / (1 - s^2) there: the area of the lens per ds^2, 1 / cos^4, times the kernel of Rayleigh and Sommerfeld, cos^2.
    The defocus of an object on the axis at ``depth_m`` is non-paraxial.

    Args:
        imaging: wavelength, sensor distance, split angle (which only shortens the sensor distance).
        depth_m: object depth; ``math.inf`` is allowed.
        frequency_per_um: shape (n,), cycles per um on the sensor.
        focus_depth_m: depth of an object in focus.

    Returns:
        Shape (n,), 1 at frequency 0 and 0 beyond the cut-off (:func:`lens_cut_off_per_um`).
    """
    far, sharp = 1e-6 / depth_m, 1e-6 / focus_depth_m
    rim_um = 0.5 * device.aperture_um
    rim_rad = 0.5 * imaging.wavenumber * rim_um**2 * abs(far - sharp)
    count = min(_MOST_SAMPLES, math.ceil(_SAMPLES + _SAMPLES_PER_RAD * rim_rad))
    rim_sine = _rim_sine(imaging)
    step = 2.0 * rim_sine / count
    axis = np.asarray((np.arange(count) - 0.5 * (count - 1)) * step, dtype=np.float64)
    sine2 = axis[None, :] ** 2 + axis[:, None] ** 2
    cosine2 = np.maximum(1.0 - sine2, 1e-9)
    scale = _image_um(imaging) / np.sqrt(cosine2)
    x_um, y_um = axis[None, :] * scale, axis[:, None] * scale
    square = x_um**2 + y_um**2
    # sqrt(r^2 + z^2) - z without cancellation, infinity included.
    path = [w * square / (1.0 + np.sqrt(1.0 + w * w * square)) for w in (far, sharp)]
    lit = device.contains(x_um, y_um) & (sine2 < 1.0)
    pupil = np.where(lit, np.exp(1j * imaging.wavenumber * (path[0] - path[1])) / cosine2, 0.0)
    transfer = np.abs(np.fft.ifft2(np.abs(np.fft.fft2(pupil, (2 * count, 2 * count))) ** 2))
    lag = step / imaging.wavelength_um
    rings, mean = _rings(transfer[None], lag, lag)
    return np.asarray(np.interp(frequency_per_um, rings, mean[0] / mean[0, 0], right=0.0))


def _image_um(imaging: Imaging) -> float:
    """Distance from the lens to the image."""
    return imaging.sensor_distance_um / math.cos(math.radians(imaging.split_angle_deg))


def _rim_sine(imaging: Imaging) -> float:
    """Sine of the angle under which the half side or radius of the aperture is seen from the image."""
    return math.sin(math.atan(0.5 * imaging.aperture_um / _image_um(imaging)))


def _rings(values: FloatArray, step_y: float, step_x: float) -> tuple[FloatArray, FloatArray]:
    """Mean radius and mean value of rings about entry [0, 0] of cyclic maps (n, n_y, n_x)."""
    n_y, n_x = values.shape[1:]
    radius = np.hypot((np.fft.fftfreq(n_y) * n_y * step_y)[:, None], (np.fft.fftfreq(n_x) * n_x * step_x)[None, :])
    count = min(n_y, n_x) // 2
    ring = np.rint(radius / max(step_y, step_x)).astype(np.int64).ravel()
    pixels = np.bincount(ring)[: count + 1]
    mean = np.array([np.bincount(ring, one.ravel())[: count + 1] / pixels for one in values])
    return np.bincount(ring, radius.ravel())[: count + 1] / pixels, mean
