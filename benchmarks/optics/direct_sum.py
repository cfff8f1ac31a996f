"""Direct Rayleigh-Sommerfeld sum over every site: the slow, exact reference of the optics room.

Distances are computed directly, without differences, blocks or expansions, so that the sum checks carrier, blocks,
low-rank kernel and normalisation of the fast propagation at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import kept_threads, spread
from metafab.layout import Lattice
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.plate import Plate
from metafab.optics.sources.source import FieldTile, Source


@dataclass(frozen=True)
class Sites:
    """Amplitudes of a square of sites, for the propagator."""

    lattice: Lattice
    amplitude: ComplexArray

    def tiles(self) -> Iterator[FieldTile]:
        """Yield one tile with all sites."""
        yield FieldTile(0, 0, amplitudes=np.stack([self.amplitude, self.amplitude]))


def direct_irradiance(
    source: Source,
    imaging: Imaging,
    depth_m: float | Sequence[float],
    tangent: tuple[float, float],
    x_um: FloatArray,
    y_um: FloatArray,
    polarisation: int,
) -> FloatArray:
    """Return the irradiance at points of the sensor, 1/um^2 per unit power of one polarisation at the aperture.

    Args:
        source: amplitudes of the sites.
        imaging: wavelength, sensor distance and aperture.
        depth_m: finite object depth, or several, which share the paths from lens to sensor.
        tangent: object direction.
        x_um: shape (n,), sensor points.
        y_um: shape (n,), sensor points.
        polarisation: 0 for x, 1 for y.

    Returns:
        Shape (n,), or (n_depth, n) for several depths. Each site is a point source of amplitude times cell area.
    """
    depth_um = 1e6 * np.atleast_1d(np.asarray(depth_m, dtype=np.float64))
    objects = [(tangent[0] * z, tangent[1] * z, z) for z in depth_um.tolist()]
    u, v = (np.asarray(axis, dtype=np.float64) for axis in (x_um, y_um))
    field = np.zeros((depth_um.size, u.size), dtype=np.complex128)
    site_x, site_y = source.lattice.x_um(), source.lattice.y_um()
    plate = imaging.plates[polarisation] if imaging.plates else None
    for tile in source.tiles():
        amplitude = tile.amplitude(polarisation)
        n_y, n_x = amplitude.shape
        x, y = site_x[tile.column : tile.column + n_x], site_y[tile.row : tile.row + n_y]
        lit = np.array([amplitude * incident_wave(*point, x, y, imaging.wavenumber, plate) for point in objects])
        with kept_threads():
            place = (imaging.sensor_distance_um, imaging.wavenumber)
            spread(_accumulate, u.size, field, u, v, lit, x, y, *place)
    incident = np.array([_incident_power(imaging, *point, plate) for point in objects])
    irradiance = np.asarray(np.abs(field * source.lattice.cell_um2) ** 2 / incident[:, None])
    return irradiance[0] if np.ndim(depth_m) == 0 else irradiance


def incident_wave(
    object_x: float,
    object_y: float,
    depth_um: float,
    x_um: FloatArray,
    y_um: FloatArray,
    wavenumber: float,
    plate: Plate | None = None,
) -> ComplexArray:
    """Return a spherical wave in the lens plane, shape (n_y, n_x), whose modulus is the root of its flux z / R^3.

    Behind a plate, the ray is found by bisection. The optical path is the sum of its two lengths, and the flux is that
    of a cone of rays through the ring where it arrives.
    """
    across = np.hypot(x_um[None, :] - object_x, y_um[:, None] - object_y)
    if plate is not None:
        path, flux = _through_plate(across, depth_um, plate)
        return np.asarray(np.sqrt(flux) * np.exp(1j * wavenumber * path))
    distance = np.hypot(across, depth_um)
    return np.asarray(np.sqrt(depth_um / distance) / distance * np.exp(1j * wavenumber * distance))


def _through_plate(across_um: FloatArray, depth_um: float, plate: Plate) -> tuple[FloatArray, FloatArray]:
    """Optical path and flux (1/um^2, for unit power per solid angle) at a lateral distance ``across_um``."""
    air, inside, n = depth_um - plate.thickness_um, plate.thickness_um, plate.index

    def arrival(sine: FloatArray) -> FloatArray:
        return np.asarray(air * sine / np.sqrt(1.0 - sine**2) + inside * sine / np.sqrt(n**2 - sine**2))

    low, high = np.zeros_like(across_um), np.full_like(across_um, 1.0 - 1e-12)
    for _ in range(60):
        middle = 0.5 * (low + high)
        beyond = arrival(middle) > across_um
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    sine = 0.5 * (low + high)
    cosine = np.sqrt(1.0 - sine**2)
    path = air / cosine + n * inside / np.sqrt(1.0 - (sine / n) ** 2)
    # Solid angle sin d(angle) = s ds / cos over the area r dr of the ring; r / s is finite on the axis.
    spread = air / cosine + inside / np.sqrt(n**2 - sine**2)
    growth = air / cosine**3 + inside * n**2 / (n**2 - sine**2) ** 1.5
    return path, 1.0 / (cosine * spread * growth)


def _incident_power(imaging: Imaging, object_x: float, object_y: float, depth_um: float, plate: Plate | None) -> float:
    """Flux through the aperture by the midpoint rule, on polar (circle, ring) or Cartesian cells.

    Cells of a polygon are counted by their centres, with an error of about 1e-3 at the rim.
    """
    half = 0.5 * imaging.aperture_um
    if imaging.aperture_shape in {"square", "polygon"}:
        u = half * (2.0 * (np.arange(600) + 0.5) / 600 - 1.0)
        x, y, area = u[None, :], u[:, None], (2.0 * half / 600) ** 2 * np.ones((600, 600))
        if imaging.outline_um:
            area *= shapely.contains_xy(shapely.Polygon(imaging.outline_um), *np.meshgrid(u, u))
    else:
        hole = 0.5 * imaging.inner_um
        radius = hole + (half - hole) * (np.arange(600)[:, None] + 0.5) / 600
        azimuth = 2.0 * np.pi * np.arange(90) / 90
        x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
        area = radius * ((half - hole) / 600) * (2.0 * np.pi / 90) * np.ones_like(x)
    across = np.hypot(x - object_x, y - object_y)
    if plate is not None:
        return float(np.sum(_through_plate(across, depth_um, plate)[1] * area))
    return float(np.sum(depth_um / np.hypot(across, depth_um) ** 3 * area))


@compiled
def _accumulate(
    first: int,
    behind: int,
    field: ComplexArray,
    x_um: FloatArray,
    y_um: FloatArray,
    lit: ComplexArray,
    site_x: FloatArray,
    site_y: FloatArray,
    sensor_um: float,
    wavenumber: float,
) -> None:
    """Add h(R) a to ``field``, shape (n_depth, n_point), with h = (z / R) (1/R - ik) exp(ikR) / (2 pi R)."""
    for point in range(first, behind):
        total = np.zeros(lit.shape[0], dtype=np.complex128)
        for row in range(site_y.size):
            for column in range(site_x.size):
                if lit[0, row, column] == 0.0:
                    continue
                ex, ey = x_um[point] - site_x[column], y_um[point] - site_y[row]
                image = math.sqrt(ex * ex + ey * ey + sensor_um * sensor_um)
                phase = wavenumber * image
                wave = math.cos(phase) + 1j * math.sin(phase)
                kernel = wave * (sensor_um / (2.0 * math.pi * image * image) * (1.0 / image - 1j * wavenumber))
                for depth in range(lit.shape[0]):
                    total[depth] += lit[depth, row, column] * kernel
        for depth in range(lit.shape[0]):
            field[depth, point] += total[depth]
