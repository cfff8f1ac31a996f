"""Target Jones matrices of a lens that sends six states of polarisation to six places, each with its rotating lobe.

A pillar turned by an angle has a symmetric Jones matrix, and every symmetric unitary matrix is that of some pillar:
two phases and an angle. The matrix that takes a state v alone to a place is exp(i psi) v* v^H, symmetric too, so the
sum over six states with the phases psi of six off-axis lenses is the target, and what is nearest to it can be built.
Unlike three kinds of pillars side by side, each of which could send at most a ninth of a state's light to its place,
the sum shares all pillars between all places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.optics import Imaging
from metafab.optics.geometry.path import Ray
from metafab.phase import PhaseProfile
from metafab.phase.build import profile_of
from metafab.phase.terms.carriers import CARRIERS
from metafab.spec import Design
from metafab.stokes.bases import JONES


@dataclass(frozen=True)
class StokesProfile:
    """Six conjugate lenses in one sum.

    Attributes:
        helix: phases of the rotating lobe; its y is the conjugate of its x.
        rays: shape (6,), from the focused object to each state's place on the sensor.
        wavenumber: rad/um.
    """

    helix: PhaseProfile
    rays: tuple[Ray, ...]
    wavenumber: float

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """The sum on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (3, n_y, n_x), entries xx, xy = yx, yy."""
        helix = self.helix(x_um, y_um)
        total = np.zeros((3, y_um.size, x_um.size), dtype=np.complex128)
        for index, (state, ray) in enumerate(zip(JONES.conj(), self.rays, strict=True)):
            path_um = ray.path_um(x_um[None, :], y_um[:, None])
            wave = np.exp(1j * (helix[index % 2] - self.wavenumber * path_um))
            entries = (state[0] * state[0], state[0] * state[1], state[1] * state[1])
            for entry, value in enumerate(entries):
                total[entry] += value * wave
        return total


def places_um(imaging: Imaging, row_angle_deg: float) -> FloatArray:
    """Where the six images of the axis lie on the sensor plane, shape (6, 2): pairs in rows, the first in the middle.

    The first of each pair goes to -x, the second to +x, as x and y polarisation do in the paper.
    """
    across = math.sin(math.radians(imaging.split_angle_deg))
    places = []
    for row in (0.0, 1.0, -1.0):
        up = math.sin(math.radians(row * row_angle_deg))
        scale = imaging.sensor_distance_um / math.sqrt(1.0 - across**2 - up**2)
        places += [(-across * scale, up * scale), (across * scale, up * scale)]
    return np.array(places)


def stokes_profile(design: Design, row_angle_deg: float) -> StokesProfile:
    """The full-Stokes sibling of a camera design: its helix, its split, its sensor, and rows of pairs."""
    imaging, whole = Imaging.of(design), profile_of(design)
    helix = PhaseProfile(tuple(term for term in whole.terms if not isinstance(term, CARRIERS)), whole.figures)
    vergence = 1e-6 / design.sensor.focus_depth_m
    rays = tuple(
        Ray(vergence, (0.0, 0.0), (float(x), float(y), imaging.sensor_distance_um))
        for x, y in places_um(imaging, row_angle_deg)
    )
    return StokesProfile(helix, rays, imaging.wavenumber)


def nearest_unitary(target: ComplexArray) -> ComplexArray:
    """The symmetric unitary matrices nearest to symmetric ones, both as entries xx, xy, yy: shape (3, ...)."""
    matrices = np.stack([target[[0, 1]], target[[1, 2]]])
    left, _, right = np.linalg.svd(np.moveaxis(matrices, (0, 1), (-2, -1)))
    product = left @ right
    mean = 0.5 * (product[..., 0, 1] + product[..., 1, 0])
    return np.stack([product[..., 0, 0], mean, product[..., 1, 1]])
