"""Target Jones matrices of a full-Stokes lens: six states of polarisation to six places, each with a rotating lobe.

A pillar turned by an angle has a symmetric Jones matrix, and every symmetric unitary matrix is that of a lossless
pillar with two phases and an angle. The matrix exp(i psi) v* v^H sends the state v alone to a place and is symmetric,
too. The target is the sum of six such matrices, with the phases psi of six off-axis lenses: all pillars serve all
places. Three kinds of pillars side by side could send at most a ninth of a state's light to its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray, sensor_distance_um
from metafab.core.polarisation import JONES
from metafab.phase.build import profile_of
from metafab.phase.terms.carriers import path_um, without_carriers
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design


@dataclass(frozen=True)
class JonesTarget:
    """Sum of six off-axis lenses, one for each state of :data:`metafab.core.polarisation.STATES`."""

    #: Phases of the rotating lobe; the second state of each pair gets the y phase, the conjugate of x.
    helix: PhaseProfile
    places_um: FloatArray  #: Shape (6, 2), (x, y) of each state's image of the axis on the sensor plane.
    sensor_distance_um: float  #: Distance of the sensor plane from the lens.
    focus_depth_m: float  #: Depth of the object on the axis that is in focus.
    wavenumber: float  #: Vacuum wavenumber, rad/um.

    @classmethod
    def of(cls, design: Design, row_angle_deg: float) -> JonesTarget:
        """Build the target of a design with a split lens from its helix, its split angle and its sensor.

        The pairs of states stand in three rows, the first in the middle, at ``row_angle_deg`` as seen from the lens.
        The first state of a pair goes to -x and the second to +x, like x and y polarisation in Eqs. 3 and 4 of Shen
        2023.
        """
        helix, depth_m = without_carriers(profile_of(design)), design.sensor.focus_depth_m
        distance_um = sensor_distance_um(design.device.focal_length_mm, design.split_angle_deg, depth_m)
        sine_x = math.sin(math.radians(design.split_angle_deg))
        places = []
        for row in (0.0, 1.0, -1.0):
            sine_y = math.sin(math.radians(row * row_angle_deg))
            scale_um = distance_um / math.sqrt(1.0 - sine_x**2 - sine_y**2)
            places += [(-sine_x * scale_um, sine_y * scale_um), (sine_x * scale_um, sine_y * scale_um)]
        return cls(helix, np.array(places), distance_um, depth_m, 2.0 * math.pi / design.wavelength_um)

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Evaluate the entries xx, xy = yx and yy, shape (3, n_y, n_x), at x, shape (n_x,), and y from the axis."""
        helix_rad = self.helix(x_um, y_um)
        total = np.zeros((3, y_um.size, x_um.size), dtype=np.complex128)
        for index, (state, (place_x, place_y)) in enumerate(zip(JONES.conj(), self.places_um.tolist(), strict=True)):
            image_um = math.hypot(place_x, place_y, self.sensor_distance_um)
            lens_um = path_um(image_um, 1e6 * self.focus_depth_m, -place_x / image_um, -place_y / image_um, x_um, y_um)
            wave = np.exp(1j * (helix_rad[index % 2] - self.wavenumber * lens_um))
            for entry, (row, column) in enumerate(((0, 0), (0, 1), (1, 1))):
                total[entry] += state[row] * state[column] * wave
        return total

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Evaluate the lossless matrices nearest to the target: the light behind perfect pillars.

        Positions and result are those of the target itself: (n_x,) and (n_y,) give the shape (3, n_y, n_x).
        """
        return nearest_unitary(self(x_um, y_um))


def nearest_unitary(target: ComplexArray) -> ComplexArray:
    """Return the unitary matrices nearest to symmetric ones (Frobenius norm), which are symmetric, too.

    Both have the shape (3, ...), entries xx, xy = yx and yy.
    """
    matrices = np.stack([target[[0, 1]], target[[1, 2]]])
    left, _, right = np.linalg.svd(np.moveaxis(matrices, (0, 1), (-2, -1)))
    product = left @ right
    mean = 0.5 * (product[..., 0, 1] + product[..., 1, 0])
    return np.stack([product[..., 0, 0], mean, product[..., 1, 1]])
