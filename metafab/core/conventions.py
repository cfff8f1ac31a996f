"""The conventions of metafab, stated once; a test executes each sentence.

Time
    Fields depend on time as exp(-i omega t). A plane wave along +z is exp(+i k z), so a longer optical path
    has the larger phase, and a medium with Im(n) > 0 absorbs.
Axes
    x to the right, y up, z along the propagation of light, from the scene to the sensor. Arrays are indexed
    ``[..., y, x]``, the first row is the lowest y. Pixel centres lie on integers times the pitch. The optical
    axis passes through the centre of the pillar lattice.
Pillars
    ``width`` is along x, ``length`` along y. The Jones basis is (x, y); ``t_xy`` is the x component of the
    transmitted field for y polarised incidence. A rectangle at normal incidence has ``t_xy = t_yx = 0``.
Reference planes
    ``t`` is the zero-order electric field at the plane where the pillar ends, on the side of the outgoing
    light, over the incident electric field at the plane where the pillar begins. For light from the
    substrate the first is the pillar's free end and the second the substrate's surface; for light from the
    ambient they swap. ``r`` has both fields at the plane where the light comes in. Power transmittance is
    ``|t|^2 n_out / n_in``. All solvers share these planes.
Phases and lengths
    Phases are in radians, wrapped to (-pi, pi]. Every public length carries its unit as a suffix. ``depth_m``
    is the distance of an object from the metasurface along the axis, positive towards the scene.
PSF pair
    "Conjugate" means PSF_y(x, y; z) = PSF_x(-x, -y; z), each about its own polarisation's geometric image
    point; it follows from psi_y(x, y) = psi_x(-x, -y). The pair turns together, and so does the vector that
    translates one twin image to the other.
Sensor
    The sensor is a plane perpendicular to the axis at z = s' cos(theta), 1/s' = 1/f - 1/focus_depth, where
    both split images of an object on the axis at ``focus_depth_m`` are in focus; their centres lie at
    x = -z tan(theta) for x polarisation and x = +z tan(theta) for y polarisation (the signs of Eqs. 3 and 4
    of Shen et al., Nature Communications 14, 1035, 2023).
Orientation
    ``phi_deg`` is the angle of the vector from the geometric image point of the x polarisation to the main
    lobe of PSF_x, counter-clockwise from +x.
"""

from __future__ import annotations

import math
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Polarisation: TypeAlias = Literal["x", "y"]
Side: TypeAlias = Literal["substrate", "ambient"]
FloatArray: TypeAlias = NDArray[np.float64]
Float32Array: TypeAlias = NDArray[np.float32]
ComplexArray: TypeAlias = NDArray[np.complex128]

POLARISATIONS: tuple[Polarisation, Polarisation] = ("x", "y")


def wrap_phase(phase_rad: ArrayLike) -> FloatArray:
    """Phase in radians wrapped to (-pi, pi], of any shape; exactly -pi becomes +pi."""
    phase = np.asarray(phase_rad, dtype=np.float64)
    return np.asarray(math.pi - np.mod(math.pi - phase, 2.0 * math.pi), dtype=np.float64)


def covered_rad(phase_rad: FloatArray, within_rad: float = 0.1) -> float:
    """Part of the phase circle, rad, that phases cover: the larger of two measures; shape (n,) in (-pi, pi].

    The first is the part of the circle within ``within_rad`` of any phase. The second, for few phases, takes n phases
    in steps of 2 pi / n as the whole circle, and equal phases as nothing.
    """
    n = phase_rad.size
    if n == 0:
        return 0.0
    ordered, turn = np.sort(phase_rad), 2.0 * math.pi
    gaps = np.diff(ordered, append=ordered[:1] + turn)
    open_rad = float(np.sum(np.maximum(gaps - 2.0 * within_rad, 0.0)))
    if n > 1:
        open_rad = min(open_rad, float(np.sum(np.maximum(gaps - turn / n, 0.0))) * n / (n - 1))
    return turn - open_rad


def image_distance_mm(focal_length_mm: float, depth_m: float) -> float:
    """Image distance s' of an object at ``depth_m``: 1/s' = 1/f - 1/depth; ``math.inf`` is a valid depth.

    ValueError if the object stands within the focal length and has no real image.
    """
    vergence_per_mm = 1.0 / focal_length_mm - (0.0 if math.isinf(depth_m) else 1e-3 / depth_m)
    if vergence_per_mm <= 0.0:
        raise ValueError(
            f"`depth_m`: expected an object beyond the focal length ({focal_length_mm} mm), got {depth_m} m; "
            "nearer objects have no real image"
        )
    return 1.0 / vergence_per_mm


def sensor_distance_um(focal_length_mm: float, angle_deg: float, focus_depth_m: float) -> float:
    """Distance of the sensor plane from the metasurface, s' cos(theta), in micrometres."""
    return 1e3 * image_distance_mm(focal_length_mm, focus_depth_m) * math.cos(math.radians(angle_deg))
