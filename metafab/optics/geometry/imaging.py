"""Geometry of lens and sensor: image points by the grating law, finest fringes, nodes over depth and field."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from metafab.core.conventions import FloatArray, Polarisation, sensor_distance_um
from metafab.core.errors import InputError
from metafab.materials import refractive_index
from metafab.optics.geometry.crystal import Crystal
from metafab.optics.geometry.plate import Plate
from metafab.phase.slopes import mean_direction
from metafab.spec import Design
from metafab.spec.terms import Grating

#: Object direction (x/z, y/z).
Tangent: TypeAlias = tuple[float, float]
#: Object directions of a rectangular grid: x/z of shape (n_x,) and y/z of shape (n_y,), each ascending.
FieldGrid: TypeAlias = tuple[FloatArray, FloatArray]

#: Relative L2 error of cubic interpolation between depths whose rim defocus differs by one radian, a measured upper
#: bound. The error falls with the fourth power of the step.
_CUBIC_ERROR_PER_RAD4 = 4.0e-3
#: Fewest depths of a stack.
_FEWEST_NODES = 6


@dataclass(frozen=True, kw_only=True)
class Imaging:
    """Geometry of lens and sensor for the propagation."""

    wavelength_um: float  #: Vacuum wavelength; object and sensor stand in vacuum (air).
    focal_length_mm: float  #: Focal length of the split lens.
    split_angle_deg: float  #: Theta of Eqs. 3 and 4; 0 for a lens without polarisation splitting.
    sensor_distance_um: float  #: Distance of the sensor plane from the metasurface.
    pixel_um: float  #: Sampling step on the sensor.
    aperture_um: float  #: Diameter of a circle or ring, side of a square or of the square around a polygon.
    aperture_shape: Literal["circle", "square", "ring", "polygon"] = "circle"  #: Outline of the aperture.
    #: Direction cosines (x, y) that gratings and the mean slope of the user's own phases add, for x and for y
    #: polarisation.
    deflection: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    inner_um: float = 0.0  #: Diameter of a ring's hole.
    outline_um: tuple[tuple[float, float], ...] = ()  #: (x, y) of a polygon's vertices.
    plates: tuple[Plate, ...] = ()  #: Substrate between scene and pillars for x and for y polarisation; empty for air.
    #: Birefringent substrate, whose ordinary wave sees ``plates``; None for one that keeps the polarisation.
    crystal: Crystal | None = None

    @classmethod
    def of(cls, design: Design) -> Imaging:
        """Return the geometry of a design, with the sensor where an object at ``focus_depth_m`` is sharp.

        InputError if the focus depth does not exceed the focal length.
        """
        device, sensor, angle_deg = design.device, design.sensor, design.split_angle_deg
        if sensor.focus_depth_m * 1e3 <= device.focal_length_mm:
            expected = f"more than the focal length, {device.focal_length_mm * 1e-3:g} m"
            remedy = "choose a larger depth; nearer objects have no real image"
            raise InputError.single("design", "sensor.focus_depth_m", expected, f"{sensor.focus_depth_m:g} m", remedy)
        crystal = None if design.substrate is None else Crystal(design.substrate, design.wavelength_um)
        distance = sensor_distance_um(device.focal_length_mm, angle_deg, sensor.focus_depth_m)
        return cls(
            wavelength_um=design.wavelength_um,
            focal_length_mm=device.focal_length_mm,
            split_angle_deg=angle_deg,
            sensor_distance_um=distance,
            pixel_um=sensor.pixel_um,
            aperture_um=device.aperture_um,
            aperture_shape=device.aperture_shape,
            deflection=_deflections(design, distance),
            inner_um=device.inner_um,
            outline_um=device.outline_um,
            plates=_plates(design) if crystal is None else (crystal.plate, crystal.plate),
            crystal=crystal,
        )

    def aimed_at(self, centre_um: tuple[float, float], tangent: Tangent = (0.0, 0.0)) -> Imaging:
        """Return the geometry with the windows of both polarisations about ``centre_um``, (x, y) from the axis.

        They stand there for an object in the direction ``tangent``, (x/z, y/z).
        """
        x, y = _cosines(centre_um, self.sensor_distance_um)
        t_x, t_y = tangent
        secant = math.sqrt(1.0 + t_x * t_x + t_y * t_y)
        x, y = x + t_x / secant, y + t_y / secant
        split = math.sin(math.radians(self.split_angle_deg))
        return replace(self, deflection=((x + split, y), (x - split, y)))

    @property
    def wavenumber(self) -> float:
        """Vacuum wavenumber 2 pi / wavelength, rad/um."""
        return 2.0 * math.pi / self.wavelength_um

    @property
    def numerical_aperture(self) -> float:
        """Sine of half the angle that the aperture subtends at the image point of x polarised light on the axis."""
        return min(0.5 * self.wavelength_um / self.finest_fringe_um(0, (0.0, 0.0)), 1.0 - 1e-9)

    def image_point_um(self, polarisation: int, tangent: Tangent) -> tuple[float, float]:
        """Return the geometric image point (x, y), um from the axis, of an object in a direction (x/z, y/z).

        The ray through the lens centre obeys the grating law with the phase gradient of Eq. 3 or 4 of Shen 2023: its
        direction cosines are (-t_x, -t_y) / sqrt(1 + t^2) + (-+sin theta, 0) plus those of the design's gratings.
        Images are inverted: the image of an object at +x lies at -x of the on-axis image point. Polarisation 0 is x.
        InputError if the light would leave the lens at 90 degrees or more.
        """
        t_x, t_y = tangent
        secant = math.sqrt(1.0 + t_x * t_x + t_y * t_y)
        sign = -1.0 if polarisation == 0 else 1.0
        add_x, add_y = self.deflection[polarisation]
        s_x = -t_x / secant + sign * math.sin(math.radians(self.split_angle_deg)) + add_x
        s_y = -t_y / secant + add_y
        transverse = s_x * s_x + s_y * s_y
        if transverse >= 1.0:
            expected = "an object whose light leaves the lens towards the sensor"
            got = f"({t_x:g}, {t_y:g}) with a split of {self.split_angle_deg:g} degrees"
            raise InputError.single("optics", "tangent", expected, got, "choose an object nearer to the axis")
        scale = self.sensor_distance_um / math.sqrt(1.0 - transverse)
        return s_x * scale, s_y * scale

    def finest_fringe_um(self, polarisation: int, tangent: Tangent) -> float:
        """Return the smallest period of the irradiance about an image point: the fringes of opposite aperture edges.

        Sums over smaller pixels are exact integrals; pixels of half this period sample the irradiance fully.
        """
        x, y = self.image_point_um(polarisation, tangent)
        half = 0.5 * self.aperture_um
        ends = []
        for edge_x, edge_y, axis in ((half, 0.0, 0), (0.0, half, 1)):
            there, back = (np.array([x - s * edge_x, y - s * edge_y, self.sensor_distance_um]) for s in (1.0, -1.0))
            ends.append(abs(float(there[axis] / np.linalg.norm(there) - back[axis] / np.linalg.norm(back))))
        return self.wavelength_um / max(ends)


def depth_nodes(imaging: Imaging, z_min_m: float, z_max_m: float, target_error: float) -> FloatArray:
    """Return depths between which cubic interpolation in vergence keeps to ``target_error``, relative L2: shape (n,).

    They ascend, uniform in 1/z, both ends included; ``z_max_m`` may be infinite. The rim defocus k R^2 / 2 (1/z_min -
    1/z_max) sets their number. InputError if the depths are not positive and ascending.
    """
    if not 0.0 < z_min_m < z_max_m:
        expected = "0 < nearest < farthest depth"
        raise InputError.single("optics", "depths", expected, f"{z_min_m:g} and {z_max_m:g} m", "exchange them")
    near, far = 1.0 / z_min_m, 1.0 / z_max_m
    corner = math.sqrt(2.0) if imaging.aperture_shape in {"square", "polygon"} else 1.0
    rim_um = 0.5 * imaging.aperture_um * corner
    span_rad = 0.5 * imaging.wavenumber * rim_um**2 * (near - far) * 1e-6
    step_rad = (target_error / _CUBIC_ERROR_PER_RAD4) ** 0.25
    count = max(_FEWEST_NODES, math.ceil(span_rad / step_rad) + 1)
    with np.errstate(divide="ignore"):
        depths = 1.0 / np.linspace(near, far, count)
    depths[0], depths[-1] = z_min_m, z_max_m
    return np.asarray(depths)


def field_tangents(design: Design, imaging: Imaging) -> FieldGrid | None:
    """Return field points over the image of the scene, ``scene.field_px`` = (rows, columns) about the axis.

    Returns:
        (x/z, y/z) of shapes (n_x,) and (n_y,) = ``verify.field_points``; a single point lies on the axis. None for a
        design without a scene.
    """
    if design.scene is None:
        return None
    rows, columns = design.scene.field_px
    count_x, count_y = design.verify.field_points
    return _axis(columns, count_x, imaging), _axis(rows, count_y, imaging)


def field_corner(design: Design, imaging: Imaging) -> Tangent | None:
    """Return the direction (x/z, y/z) of a corner of the scene's image; None for a design without a scene."""
    if design.scene is None:
        return None
    rows, columns = design.scene.field_px
    return _reach(columns, imaging), _reach(rows, imaging)


def _plates(design: Design) -> tuple[Plate, ...]:
    """The substrate for x and y polarisation; empty if its thickness ``optics.substrate_um`` is 0."""
    if design.optics is None or design.optics.substrate_um == 0.0:
        return ()
    cell = design.unit_cell
    index = refractive_index(cell.materials.substrate, cell.illumination.wavelength_nm)
    return tuple(Plate(thickness_um=design.optics.substrate_um, index=float(n.real)) for n in index[:2])


def _cosines(place_um: tuple[float, float], distance_um: float) -> tuple[float, float]:
    """Direction cosines (x, y) from the lens centre to a place of the sensor."""
    far_um = math.hypot(*place_um, distance_um)
    return place_um[0] / far_um, place_um[1] / far_um


def _deflections(design: Design, distance_um: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Direction cosines of the window's centre, as the design states it or else of the target, for x and y light.

    InputError if the target sends the light beyond 90 degrees, or a user's array is unusable.
    """
    if design.verify.centre_um is not None:
        cosines = _cosines(design.verify.centre_um, distance_um)
        return cosines, cosines
    # The window of a camera stays at its geometric image point, from which orientations are measured.
    own = mean_direction(design) if design.split_angle_deg == 0.0 else ((0.0, 0.0), (0.0, 0.0))
    found = _deflection(design, "x", own[0]), _deflection(design, "y", own[1])
    if (sine := max(math.hypot(*cosines) for cosines in found)) >= 1.0:
        expected = "a phase whose mean slope sends light towards the sensor, at most 2 pi per wavelength"
        got = f"one of {sine:.3g} times that"
        remedy = "is the pitch in micrometres?"
        if not design.windows_follow_images:
            remedy += " `verify.centre_um` places the window by hand"
        raise InputError.single(design.name, "phase", expected, got, remedy)
    return found


def _deflection(design: Design, polarisation: Polarisation, own: tuple[float, float]) -> tuple[float, float]:
    """Direction cosines that a design's gratings add to ``own`` for light of one polarisation."""
    x, y = own
    for term in design.phase:
        if isinstance(term, Grating) and term.polarisation in {None, polarisation}:
            sine = math.sin(math.radians(term.angle_deg))
            x += sine * math.cos(math.radians(term.azimuth_deg))
            y += sine * math.sin(math.radians(term.azimuth_deg))
    return x, y


def _axis(pixels: int, count: int, imaging: Imaging) -> FloatArray:
    """``count`` directions over ``pixels`` pixels about the axis; a single one is the axis itself."""
    reach = _reach(pixels, imaging) if count > 1 else 0.0
    return np.linspace(-reach, reach, count)


def _reach(pixels: int, imaging: Imaging) -> float:
    """Tangent of the outermost direction of ``pixels`` pixels about the axis."""
    return 0.5 * pixels * imaging.pixel_um / imaging.sensor_distance_um
