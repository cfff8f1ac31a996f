"""A uniaxial crystal plate between scene and pillars: Jones matrix of each ray, by field angle and wavelength.

Transverse wave vectors kappa (over the vacuum wavenumber) are conserved. Normal components q are exact:

    ordinary:       q = sqrt(n_o^2 - kappa^2)
    extraordinary:  |k|^2 / n_e^2 + (k.c)^2 (1/n_o^2 - 1/n_e^2) = 1,   c the optic axis, k = (kappa, q)

(Yeh, Optical Waves in Layered Media, ch. 9). Electric and magnetic fields are matched at the first face (Berreman's
four components), so that its Fresnel coefficients are exact. Each wave crosses the plate once. Light that is reflected
at the pillars and again at the first face is left out: its phase pattern is that of the pillars' reflection, not of
their transmission, and it adds a haze, not an image.

The ordinary wave sees an isotropic :class:`Plate`. The extraordinary wave leaves an object in a slightly different
direction to reach the same lens point; Fermat's principle gives its path to second order of the walk-off. In a basis of
Ludwig's third kind, x and y polarisation are orthogonal for every direction: the Jones matrix of an isotropic coated
plate is the identity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.materials import refractive_index
from metafab.optics.geometry.plate import Plate
from metafab.spec.substrate import Substrate

#: Sine of the angle between wave vector and optic axis below which the two waves are taken as one.
_ALONG_AXIS = 1e-9


@dataclass(frozen=True)
class Crystal:
    """Uniaxial plate at one wavelength."""

    substrate: Substrate  #: Thickness, cut, azimuth, materials, first face.
    wavelength_um: float  #: Vacuum wavelength.

    @cached_property
    def n_ordinary(self) -> float:
        """Ordinary index."""
        return float(refractive_index(self.substrate.ordinary, 1e3 * self.wavelength_um)[0].real)

    @cached_property
    def n_extraordinary(self) -> float:
        """Extraordinary index, of light polarised along the optic axis."""
        return float(refractive_index(self.substrate.extraordinary, 1e3 * self.wavelength_um)[0].real)

    @property
    def wavenumber(self) -> float:
        """Vacuum wavenumber, rad/um."""
        return 2.0 * math.pi / self.wavelength_um

    @property
    def axis(self) -> tuple[float, float, float]:
        """Optic axis, a unit vector."""
        tilt, azimuth = math.radians(self.substrate.tilt_deg), math.radians(self.substrate.azimuth_deg)
        return math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)

    @cached_property
    def plate(self) -> Plate:
        """The plate as the ordinary wave sees it."""
        return Plate(thickness_um=self.substrate.thickness_um, index=self.n_ordinary)

    def at_wavelength(self, wavelength_um: float) -> Crystal:
        """Return the plate at another wavelength; indices and retardance disperse."""
        return replace(self, wavelength_um=wavelength_um)

    @property
    def retardance_rad(self) -> float:
        """Phase of the extraordinary minus that of the ordinary wave along the normal, rad; negative for sapphire."""
        ordinary, extraordinary = self.normal_components(np.zeros(1), np.zeros(1))
        return float(self.wavenumber * self.substrate.thickness_um * (extraordinary - ordinary)[0])

    def normal_components(self, kappa_x: FloatArray, kappa_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return q of the ordinary and of the extraordinary wave for transverse components of any shape."""
        c_x, c_y, c_z = self.axis
        o2, e2 = self.n_ordinary**2, self.n_extraordinary**2
        square, along = kappa_x**2 + kappa_y**2, kappa_x * c_x + kappa_y * c_y
        change = 1.0 / o2 - 1.0 / e2
        a = 1.0 / e2 + change * c_z**2
        half_b = change * c_z * along
        c = square / e2 + change * along**2 - 1.0
        return np.sqrt(o2 - square), (np.sqrt(half_b**2 - a * c) - half_b) / a

    def jones(
        self, x_um: FloatArray, y_um: FloatArray, vergence_per_um: float, tangent: tuple[float, float]
    ) -> ComplexArray:
        """Jones matrix from the air to the pillars at (x, y), any shape, relative to the ordinary path there.

        The matrix, shape (2, 2, ...), is indexed [pillar polarisation, incident polarisation], amplitudes per square
        root of the flux; the object has a vergence and a tangent (x/z, y/z).
        """
        thickness_um = self.substrate.thickness_um
        kappa_x, kappa_y = self.plate.direction_cosines(x_um, y_um, vergence_per_um, tangent)
        ordinary, extraordinary = self.normal_components(kappa_x, kappa_y)
        # The first order of the path is the change of q, its second order the change of direction that this causes.
        slope_x, slope_y = self._component_slopes(kappa_x, kappa_y)
        square = kappa_x**2 + kappa_y**2
        # Derivative of the ray's displacement with respect to kappa, in object depths: across 1 + radial kappa kappa^T.
        in_plate = vergence_per_um * thickness_um
        in_air = 1.0 - in_plate
        cosine = np.sqrt(1.0 - square)
        across = in_air / cosine + in_plate / ordinary
        radial = in_air / cosine**3 + in_plate / ordinary**3
        # Its inverse (Sherman and Morrison) between the walk-off slopes.
        projection = slope_x * kappa_x + slope_y * kappa_y
        steep = (slope_x**2 + slope_y**2) / across - radial * projection**2 / (across * (across + radial * square))
        bend_um = 0.5 * vergence_per_um * thickness_um**2 * steep
        return self._jones(kappa_x, kappa_y, thickness_um * (extraordinary - ordinary) + bend_um)

    def _component_slopes(self, kappa_x: FloatArray, kappa_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of q_e - q_o along kappa, by the implicit function of the extraordinary surface."""
        c_x, c_y, c_z = self.axis
        ordinary, extraordinary = self.normal_components(kappa_x, kappa_y)
        e2, change = self.n_extraordinary**2, 1.0 / self.n_ordinary**2 - 1.0 / self.n_extraordinary**2
        along = kappa_x * c_x + kappa_y * c_y + extraordinary * c_z
        normal = extraordinary / e2 + change * along * c_z
        return (
            kappa_x / ordinary - (kappa_x / e2 + change * along * c_x) / normal,
            kappa_y / ordinary - (kappa_y / e2 + change * along * c_y) / normal,
        )

    def _jones(self, kappa_x: FloatArray, kappa_y: FloatArray, path_um: FloatArray) -> ComplexArray:
        """Jones matrix for a given path of the extraordinary minus the ordinary wave."""
        modes = [self._mode(kappa_x, kappa_y, "ordinary"), self._mode(kappa_x, kappa_y, "extraordinary")]
        polarisations = np.stack([polarisation for polarisation, _ in modes], axis=-1)  # (..., 2 axes, 2 waves)
        if self.substrate.back_face == "coated":
            entering = np.swapaxes(polarisations, -1, -2)
        else:
            entering = _transmitted_waves(kappa_x, kappa_y, np.stack([fields for _, fields in modes], axis=-1))
        phases = np.stack([np.ones_like(path_um), np.exp(1j * self.wavenumber * path_um)], axis=-1)
        matrices = (polarisations * phases[..., None, :]) @ entering
        return np.moveaxis(matrices, (-2, -1), (0, 1))

    def _mode(
        self, kappa_x: FloatArray, kappa_y: FloatArray, wave: Literal["ordinary", "extraordinary"]
    ) -> tuple[FloatArray, FloatArray]:
        """One wave: its direction of D in Ludwig's basis, shape (..., 2), and (E_x, E_y, H_x, H_y) of unit flux."""
        q = self.normal_components(kappa_x, kappa_y)[wave == "extraordinary"]
        wave_vector = np.stack([kappa_x, kappa_y, q], axis=-1)
        axis = np.array(self.axis)
        across = np.cross(wave_vector, axis)
        size = np.linalg.norm(across, axis=-1, keepdims=True)
        azimuth = math.radians(self.substrate.azimuth_deg)
        any_across = np.cross(wave_vector, np.array([math.cos(azimuth), math.sin(azimuth), 0.0]))
        across = np.where(size > _ALONG_AXIS, across, any_across)
        displacement = across if wave == "ordinary" else np.cross(across, wave_vector)
        displacement = displacement / np.linalg.norm(displacement, axis=-1, keepdims=True)
        o2, e2 = self.n_ordinary**2, self.n_extraordinary**2
        electric = displacement / o2 + (displacement @ axis)[..., None] * axis * (1.0 / e2 - 1.0 / o2)
        basis = _ludwig(wave_vector / np.linalg.norm(wave_vector, axis=-1, keepdims=True))
        return np.einsum("...ij,...j->...i", basis, displacement), _tangential(electric, wave_vector)


def _ludwig(direction: FloatArray) -> FloatArray:
    """Ludwig's third basis of a unit direction with positive z, shape (..., 2, 3): x and y polarisation."""
    x, y, z = np.moveaxis(direction, -1, 0)
    rest = 1.0 / (1.0 + z)
    along_x = np.stack([1.0 - x * x * rest, -x * y * rest, -x], axis=-1)
    along_y = np.stack([-x * y * rest, 1.0 - y * y * rest, -y], axis=-1)
    return np.stack([along_x, along_y], axis=-2)


def _tangential(electric: FloatArray, wave_vector: FloatArray) -> FloatArray:
    """(E_x, E_y, H_x, H_y) of a plane wave of unit flux along +-z, shape (..., 4)."""
    magnetic = np.cross(wave_vector, electric)
    flux = electric[..., 0] * magnetic[..., 1] - electric[..., 1] * magnetic[..., 0]
    both = np.concatenate([electric[..., :2], magnetic[..., :2]], axis=-1)
    return np.asarray(both / np.sqrt(np.abs(flux))[..., None])


def _transmitted_waves(kappa_x: FloatArray, kappa_y: FloatArray, waves: FloatArray) -> FloatArray:
    """Amplitudes of both crystal waves behind a face in air, shape (..., 2 waves, 2 incident polarisations).

    ``waves``, shape (..., 4, 2), are the tangential fields of the crystal's waves.
    """
    cosine = np.sqrt(1.0 - kappa_x**2 - kappa_y**2)
    forward = np.stack([kappa_x, kappa_y, cosine], axis=-1)
    basis = _ludwig(forward)
    incident = _tangential(basis, np.broadcast_to(forward[..., None, :], basis.shape))
    mirror = np.array([1.0, 1.0, -1.0])
    reflected = _tangential(basis * mirror, np.broadcast_to((forward * mirror)[..., None, :], basis.shape))
    matrix = np.concatenate([waves, -np.swapaxes(reflected, -1, -2)], axis=-1)
    return np.asarray(np.linalg.solve(matrix, np.swapaxes(incident, -1, -2))[..., :2, :])
