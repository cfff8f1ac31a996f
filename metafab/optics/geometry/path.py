"""Path lengths from an object over the lens to the sensor, without cancellation, and the incident amplitudes.

All lengths are differences from the path through the lens centre, written such that double precision keeps 1e-9 rad at
any distance, infinity included. The inlined functions take scalars or arrays that broadcast.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric import chebyshev
from metafab.core.numeric.compiled import inlined
from metafab.optics.geometry.crystal import Crystal
from metafab.optics.geometry.imaging import Imaging, Tangent
from metafab.optics.geometry.plate import Plate

#: Ray in air: vergence (1/um), object direction (x/z, y/z) and sensor point (x, y, z) in um.
RayNumbers: TypeAlias = tuple[float, float, float, float, float, float]
#: Polarisation behind and before a birefringent substrate: row and column of its Jones matrix.
JonesEntry: TypeAlias = tuple[int, int]

#: Relative error of Jones matrices that are interpolated over the lens.
_JONES_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Ray:
    """Ray from an object point through the lens centre to a point of the sensor."""

    vergence_per_um: float  #: 1 / depth; 0 for an object at infinity.
    tangent: Tangent  #: (x/z, y/z) of the object.
    target_um: tuple[float, float, float]  #: (x, y, z) of the sensor point.
    plate: Plate | None = None  #: Substrate before the lens; None for air.
    #: Birefringent substrate, whose ordinary wave sees ``plate``; None for one that keeps the polarisation.
    crystal: Crystal | None = None
    entry: JonesEntry = (0, 0)  #: Polarisation of the pillars' light and of the object's light.

    @classmethod
    def towards_image(
        cls, imaging: Imaging, polarisation: int, depth_m: float, tangent: Tangent, entry: JonesEntry | None = None
    ) -> Ray:
        """Return the ray to the geometric image point of one polarisation (0 for x, 1 for y).

        ``entry`` is that of the Jones matrix of a birefringent substrate; by default ``polarisation`` behind and before
        it.
        """
        x, y = imaging.image_point_um(polarisation, tangent)
        entry = (polarisation, polarisation) if entry is None else entry
        plate = imaging.plates[entry[0]] if imaging.plates else None
        target_um = (x, y, imaging.sensor_distance_um)
        return cls(1e-6 / depth_m, tangent, target_um, plate, imaging.crystal, entry)

    @property
    def in_air(self) -> Ray:
        """The ray without the substrate."""
        return replace(self, plate=None, crystal=None)

    @property
    def numbers(self) -> RayNumbers:
        """Vergence, direction and target for the compiled functions; the plate is left out."""
        return (self.vergence_per_um, *self.tangent, *self.target_um)

    def path_um(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Return the path over the lens point (x, y) minus the path over the centre; the arguments broadcast."""
        path = path_um(x_um, y_um, self.numbers)
        if self.plate is not None:
            path = path + self.plate.path_change_um(x_um, y_um, self.vergence_per_um, self.tangent)
        return np.asarray(path)

    def incident_amplitude(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Return the square root of the incident flux through the lens plane, 1 at the centre; arguments broadcast."""
        amplitude = incident_amplitude(x_um, y_um, self.numbers)
        if self.plate is not None:
            amplitude = amplitude * self.plate.amplitude_ratio(x_um, y_um, self.vergence_per_um, self.tangent)
        return np.asarray(amplitude)

    def jones_factor(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Return ``entry`` of the crystal's Jones matrix over the lens; 1 without a crystal.

        The matrix is smooth: it is computed on Chebyshev points and interpolated to ascending x, shape (n_x,), and y:
        shape (n_y, n_x).
        """
        if self.crystal is None:
            return np.ones((y_um.size, x_um.size), dtype=np.complex128)
        along_x, along_y = ((float(axis[0]), float(axis[-1])) for axis in (x_um, y_um))
        count_x, count_y = (self._jones_points(span) for span in (along_x, along_y))
        x, y = np.meshgrid(chebyshev.points(along_x, count_x), chebyshev.points(along_y, count_y))
        nodes = self.crystal.jones(x, y, self.vergence_per_um, self.tangent)[self.entry]
        columns = chebyshev.interpolation(along_x, count_x, x_um)
        return np.asarray(chebyshev.interpolation(along_y, count_y, y_um) @ nodes @ columns.T)

    def _jones_points(self, span_um: tuple[float, float]) -> int:
        """Chebyshev points over a span of the lens: retardance changes by at most k h |n_e - n_o| per unit cosine."""
        assert self.crystal is not None
        crystal, cosines = self.crystal, self.vergence_per_um * (span_um[1] - span_um[0])
        birefringence = abs(crystal.n_extraordinary - crystal.n_ordinary)
        change_rad = crystal.wavenumber * crystal.substrate.thickness_um * birefringence * cosines
        return chebyshev.points_needed(change_rad, _JONES_TOLERANCE)


@inlined
def path_um(x: Any, y: Any, ray: RayNumbers) -> Any:
    """Return the path from the object over (x, y, 0) to the target, minus the path over the origin; broadcasts.

    For an object at depth 1/w in the direction t: R - R_0 = (w r^2 - 2 r.t) / (w R + w R_0). This is finite for w = 0,
    the plane wave -r.t / sqrt(1 + t^2).
    """
    return path_and_slopes(x, y, ray)[0]


@inlined
def path_and_slopes(x: Any, y: Any, ray: RayNumbers) -> tuple[Any, Any, Any]:
    """Return :func:`path_um` and its derivatives along x and y; broadcasts.

    With R the distance from the object and R' that to the target: w (R^2 - R_0^2) is ``bend``, R'^2 - R'_0^2 is
    ``fall``.
    """
    w, t_x, t_y, c_x, c_y, c_z = ray
    square = x * x + y * y
    secant2 = 1.0 + t_x * t_x + t_y * t_y
    bend = w * square - 2.0 * (x * t_x + y * t_y)
    source = np.sqrt(w * bend + secant2)
    centre2 = c_x * c_x + c_y * c_y + c_z * c_z
    fall = square - 2.0 * (x * c_x + y * c_y)
    image = np.sqrt(fall + centre2)
    path = bend / (source + math.sqrt(secant2)) + fall / (image + math.sqrt(centre2))
    return path, (w * x - t_x) / source + (x - c_x) / image, (w * y - t_y) / source + (y - c_y) / image


@inlined
def incident_amplitude(x: Any, y: Any, ray: RayNumbers) -> Any:
    """Return (R_0 / R)^(3/2), as the flux of a spherical wave through a plane falls with z / R^3; broadcasts."""
    w, t_x, t_y = ray[:3]
    secant2 = 1.0 + t_x * t_x + t_y * t_y
    bend = w * (w * (x * x + y * y) - 2.0 * (x * t_x + y * t_y))
    square = 1.0 + bend / secant2
    return 1.0 / np.sqrt(square * np.sqrt(square))


def power_at_aperture(imaging: Imaging, ray: Ray) -> float:
    """Return the integral of the squared incident amplitude over the aperture, um^2: its area for distant objects.

    The quadrature is Gauss-Legendre in r^2 with equidistant azimuths (circle), or Gauss-Legendre twice (square, and
    the signed triangles from the axis to a polygon's edges). It is exact to 1e-12 for objects further away than the
    aperture is wide.
    """
    node, weight = _gauss_legendre()
    half = 0.5 * imaging.aperture_um
    if imaging.aperture_shape == "square":
        flux = ray.incident_amplitude(half * node[None, :], half * node[:, None]) ** 2
        return float(half**2 * weight @ flux @ weight)
    if imaging.aperture_shape == "polygon":
        vertices = np.array(imaging.outline_um)
        along, outwards = 0.5 * (1.0 + node[None, :]), 0.5 * (1.0 + node[:, None])
        power = 0.0
        for start, end in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
            x, y = (outwards * (start[axis] + along * (end[axis] - start[axis])) for axis in (0, 1))
            flux = ray.incident_amplitude(x, y) ** 2 * outwards
            power += 0.25 * float((start[0] * end[1] - start[1] * end[0]) * (weight @ flux @ weight))
        return abs(power)
    return _power_in_circle(half, ray) - _power_in_circle(0.5 * imaging.inner_um, ray)


def _power_in_circle(radius_um: float, ray: Ray) -> float:
    if radius_um == 0.0:
        return 0.0
    node, weight = _gauss_legendre()
    azimuth = 2.0 * np.pi * np.arange(48) / 48
    radius = radius_um * np.sqrt(0.5 * (1.0 + node))[:, None]
    flux = ray.incident_amplitude(radius * np.cos(azimuth), radius * np.sin(azimuth)) ** 2
    return float(np.pi * radius_um**2 * 0.5 * weight @ flux.mean(axis=1))


@cache
def _gauss_legendre() -> tuple[FloatArray, FloatArray]:
    return np.polynomial.legendre.leggauss(24)
