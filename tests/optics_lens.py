"""Small lenses whose optics can be summed directly: plain lens and helix pair, ideal and with pillars."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from metafab.core.conventions import FloatArray, Polarisation
from metafab.layout.pillars import Lattice, PillarMap
from metafab.optics import Imaging, WrittenField, ideal_field
from metafab.optics.sources.source import IdealField
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Device

ANGLE_DEG = 8.0
SINE = math.sin(math.radians(ANGLE_DEG))


def imaging(*, aperture_um: float = 60.0, focal_length_mm: float = 0.3, **changes: object) -> Imaging:
    """A lens of the small design's numerical aperture, a tenth of its sites; sensor sharp at three focal lengths."""
    focus = 1.5 * focal_length_mm * 1e3 * math.cos(math.radians(ANGLE_DEG))
    return replace(
        Imaging(
            wavelength_um=0.8,
            focal_length_mm=focal_length_mm,
            split_angle_deg=ANGLE_DEG,
            sensor_distance_um=focus,
            pixel_um=1.2,
            aperture_um=aperture_um,
        ),
        **changes,
    )


def eq_3_and_4(optics: Imaging) -> object:
    """Eqs. 3 and 4, as printed."""
    f = optics.focal_length_mm * 1e3

    def term(x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        sign = 1.0 if polarisation == "x" else -1.0
        x, y = x_um[None, :], y_um[:, None]
        return -2.0 * np.pi / optics.wavelength_um * (np.sqrt(x**2 + y**2 + f**2 + 2.0 * sign * x * f * SINE) - f)

    return term


def eq_2(optics: Imaging, zones: int = 3) -> object:
    """Eq. 2 with epsilon 1/2; y is the point mirror of x."""

    def term(x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        sign = 1.0 if polarisation == "x" else -1.0
        x, y = sign * x_um[None, :], sign * y_um[:, None]
        charge = np.ceil(zones * np.clip(np.hypot(x, y) / (0.5 * optics.aperture_um), 1e-9, 1.0) ** 2)
        return np.asarray(charge * np.arctan2(y, x))

    return term


def lattice(optics: Imaging, period_nm: float = 350.0) -> Lattice:
    """Sites over the aperture, an even number a side: on the axis itself, azimuth and mirror image are undefined."""
    count = 2 * math.ceil(0.5e3 * optics.aperture_um / period_nm)
    return Lattice(period_dbu=(round(2 * period_nm), round(2 * period_nm)), shape=(count, count), database_unit_nm=0.5)


def ideal(optics: Imaging, *terms: object) -> IdealField:
    """Target phases at full transmission."""
    device = Device(
        aperture_um=optics.aperture_um, focal_length_mm=optics.focal_length_mm, aperture_shape=optics.aperture_shape
    )
    return ideal_field(PhaseProfile(terms), lattice(optics), device)


def written(optics: Imaging, *terms: object, levels: int = 12, tile_sites: int = 37) -> WrittenField:
    """The same with ``levels`` x ``levels`` phase levels at 90 % amplitude, as indices in tiles."""
    source = ideal(optics, *terms)
    x, y = source.lattice.x_um(), source.lattice.y_um()
    turns = np.round(source.profile(x, y) / (2.0 * np.pi) * levels).astype(int) % levels
    inside = np.hypot(x[None, :], y[:, None]) <= 0.5 * optics.aperture_um
    index = np.where(inside, 1 + turns[0] + levels * turns[1], 0).astype(np.uint16)
    level = np.arange(levels * levels)
    table = np.zeros((levels * levels + 1, 2), dtype=np.complex128)
    table[1:, 0] = 0.9 * np.exp(2j * np.pi * (level % levels) / levels)
    table[1:, 1] = 0.9 * np.exp(2j * np.pi * (level // levels) / levels)
    sizes = np.zeros((table.shape[0], 2), dtype=np.int32)
    return WrittenField(PillarMap.from_array(source.lattice, sizes, index, tile_sites), table)


def window_points(optics: Imaging, centre_um: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Sensor coordinates of a window's points, each of shape (count * count,)."""
    step = (np.arange(count) - count // 2) * optics.pixel_um
    x, y = np.meshgrid(centre_um[0] + step, centre_um[1] + step)
    return x.ravel(), y.ravel()
