"""A conjugate helix pair by a small pupil transform of Eq. 2: fast, and independent of the optics room."""

from __future__ import annotations

import math

import numpy as np

from metafab.core.conventions import FloatArray, sensor_distance_um
from metafab.optics.geometry.aperture import sub_apertures_um
from metafab.optics.point_spread import Psf, PsfField

WAVELENGTH_UM = 0.8
FOCAL_LENGTH_MM = 1.0
RADIUS_UM = 100.0
ANGLE_DEG = 8.0
FOCUS_DEPTH_M = 0.003
PIXEL_UM = 2.4


def circle_um(diameter_um: float) -> FloatArray:
    """Points of equal power of a uniformly lit circle, shape (n, 2)."""
    axis: FloatArray = np.linspace(-0.5, 0.5, 255) * diameter_um
    lit = axis[:, None] ** 2 + axis**2 <= (0.5 * diameter_um) ** 2
    return sub_apertures_um(axis, axis, lit.astype(np.float64))


def helix_psf(
    depth_m: FloatArray, *, window_px: int = 48, zones: int = 4, tangents: tuple[FloatArray, FloatArray] | None = None
) -> Psf:
    """The pair of the small design's lens (not optimised), ideal and scalar.

    With ``tangents`` (along x and y) it varies over the field: the chief ray of each split lens gives the
    geometric image, and the two channels' focus drifts in opposite senses along x, as the real lens' does.
    """
    distance_um = sensor_distance_um(FOCAL_LENGTH_MM, ANGLE_DEG, FOCUS_DEPTH_M)
    axis = np.zeros(1)
    on_axis, centre_um = _over_field(depth_m, axis, axis, window_px, zones, distance_um)
    field = None
    if tangents is not None:
        varied, centres = _over_field(depth_m, *tangents, window_px, zones, distance_um)
        field = PsfField(tangents[0], tangents[1], varied.astype(np.float32), centres)
    psf = on_axis[:, :, 0, 0]
    efficiency = psf.sum(axis=(-2, -1)) * PIXEL_UM**2
    phi_deg = np.array([_orientation_deg(one) for one in psf[0]])
    nothing = np.zeros(depth_m.size)
    return Psf(
        depth_m,
        PIXEL_UM,
        psf,
        centre_um[:, :, 0, 0],
        phi_deg,
        nothing,
        efficiency,
        nothing + 1e3,
        distance_um,
        field,
        aperture_um=circle_um(2.0 * RADIUS_UM),
    )


def _over_field(
    depth_m: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray, window_px: int, zones: int, distance_um: float
) -> tuple[FloatArray, FloatArray]:
    psf = np.empty((2, depth_m.size, tangent_y.size, tangent_x.size, window_px, window_px))
    centre = np.empty((2, depth_m.size, tangent_y.size, tangent_x.size, 2))
    # 0.3 dioptre a degree for f = 20 mm, and in proportion to 1/f.
    drift_per_m = 6.0 * math.degrees(1.0)
    for polarisation, sign in enumerate((-1.0, 1.0)):
        for row, column in np.ndindex(tangent_y.size, tangent_x.size):
            tx, ty = tangent_x[column], tangent_y[row]
            slope = sign * math.sin(math.radians(ANGLE_DEG)) - tx / math.hypot(1.0, tx, ty)
            rise = -ty / math.hypot(1.0, tx, ty)
            along = math.sqrt(1.0 - slope**2 - rise**2)
            centre[polarisation, :, row, column] = distance_um * slope / along, distance_um * rise / along
            for index, depth in enumerate(depth_m):
                vergence = 1.0 / depth - 1.0 / FOCUS_DEPTH_M - sign * drift_per_m * tx
                psf[polarisation, index, row, column] = _pair_member(
                    vergence, zones, window_px, distance_um, mirrored=polarisation == 1
                )
    return psf, centre


def _pair_member(
    vergence_per_m: float, zones: int, window_px: int, distance_um: float, *, mirrored: bool
) -> FloatArray:
    count = 3 * window_px
    step_um = WAVELENGTH_UM * distance_um / (count * PIXEL_UM)
    u = (np.arange(count) - count // 2) * step_um / RADIUS_UM
    x, y = np.meshgrid(u, u)
    radius = np.hypot(x, y)
    azimuth = np.arctan2(-y, -x) if mirrored else np.arctan2(y, x)
    spiral = np.ceil(zones * np.clip(radius, 1e-9, 1.0) ** 2) * azimuth
    defocus = math.pi / WAVELENGTH_UM * (RADIUS_UM * radius) ** 2 * vergence_per_m * 1e-6
    pupil = np.where(radius <= 1.0, np.exp(1j * (spiral + defocus)), 0.0)
    far = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(pupil)))
    irradiance = np.abs(far) ** 2
    irradiance /= irradiance.sum() * PIXEL_UM**2
    start = count // 2 - window_px // 2
    return irradiance[start : start + window_px, start : start + window_px]


def _orientation_deg(psf: FloatArray) -> float:
    row, column = np.unravel_index(np.argmax(psf), psf.shape)
    return math.degrees(math.atan2(row - psf.shape[0] // 2, column - psf.shape[1] // 2))
