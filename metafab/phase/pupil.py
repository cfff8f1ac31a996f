"""The pupil in normalised coordinates, and what a phase in it does to the focal plane.

Positions are divided by the aperture's radius R, so that the rim is at u = 1. An object nearer than the focus
adds the phase W u^2 with the rim defocus ``W = (k R^2 / 2) (1/depth - 1/focus_depth)``; the focal plane is in
optical units ``v = k R x' / s'`` (the Airy disc's first dark ring is at v = 3.83). A PSF value is a Strehl
ratio: 1 is the peak of the same aperture without aberration. Paraxial: for the design of a helix, whose PSF
the optics room then computes exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metafab.core.conventions import ComplexArray, FloatArray

Outline: TypeAlias = Literal["circle", "square", "ring", "polygon"]


def rim_defocus_rad(
    depth_m: ArrayLike, focus_depth_m: float, aperture_radius_um: float, wavelength_um: float
) -> FloatArray:
    """Rim defocus W of an object at ``depth_m`` (any shape, m; ``inf`` allowed), radians; 0 at the focus.

    Positive for objects nearer than the focus: a nearer point's wave arrives more strongly curved, and a longer
    path has the larger phase.
    """
    vergence_per_m = 1.0 / np.asarray(depth_m, dtype=np.float64) - 1.0 / focus_depth_m
    return np.asarray(rim_defocus_per_dioptre_rad(aperture_radius_um, wavelength_um) * vergence_per_m)


def rim_defocus_per_dioptre_rad(aperture_radius_um: float, wavelength_um: float) -> float:
    """Rim defocus of one dioptre, k R^2 / 2: 3.93 rad for R = 1 mm at 800 nm."""
    return math.pi * aperture_radius_um**2 / wavelength_um * 1e-6


def phasor(phase_rad: FloatArray) -> ComplexArray:
    """exp(i phase), any shape."""
    return np.asarray(np.exp(1j * phase_rad), dtype=np.complex128)


@dataclass(frozen=True)
class Pupil:
    """A square grid of samples over the aperture, point-symmetric about the axis.

    Attributes:
        samples: samples a side; centres at (2 i + 1) / samples - 1.
        shape: outline of the aperture; a square's half side counts as its radius. Of rings and polygons the whole
            circle of that diameter is taken.
    """

    samples: int = 128
    shape: Outline = "circle"

    @cached_property
    def axis(self) -> FloatArray:
        """Sample positions along either axis, shape (samples,), units of R."""
        return (2.0 * np.arange(self.samples) + 1.0) / self.samples - 1.0

    @cached_property
    def inside(self) -> NDArray[np.bool_]:
        """Which samples lie in the aperture, shape (samples, samples)."""
        if self.shape == "square":
            return np.ones((self.samples, self.samples), dtype=np.bool_)
        return self.radius_squared_grid <= 1.0

    @cached_property
    def radius_squared_grid(self) -> FloatArray:
        """u^2 on the whole grid, shape (samples, samples)."""
        return np.asarray(self.axis[:, None] ** 2 + self.axis[None, :] ** 2)

    @cached_property
    def x(self) -> FloatArray:
        """Positions x of the samples inside, shape (n,), units of R."""
        return np.broadcast_to(self.axis[None, :], self.inside.shape)[self.inside]

    @cached_property
    def y(self) -> FloatArray:
        """Positions y of the samples inside, shape (n,), units of R."""
        return np.broadcast_to(self.axis[:, None], self.inside.shape)[self.inside]

    @cached_property
    def radius_squared(self) -> FloatArray:
        """u^2 of the samples inside, shape (n,)."""
        return self.radius_squared_grid[self.inside]

    @property
    def count(self) -> int:
        """Samples inside the aperture."""
        return self.x.size


@dataclass(frozen=True)
class FocalPlane:
    """Images of a pupil field on a square window of the focal plane, by a matrix Fourier transform.

    Attributes:
        pupil: where the field is sampled.
        half_width: the window reaches from -half_width to +half_width in optical units.
        step: distance of the samples in optical units (an intensity is band-limited: pi / 2 is Nyquist).
    """

    pupil: Pupil
    half_width: float
    step: float = 0.3

    @cached_property
    def axis(self) -> FloatArray:
        """Positions v along either axis, shape (n_v,); the middle one is 0."""
        half = math.ceil(self.half_width / self.step)
        return np.arange(-half, half + 1, dtype=np.float64) * self.step

    @cached_property
    def _kernel(self) -> ComplexArray:
        return phasor(-np.outer(self.axis, self.pupil.axis))

    def amplitude(self, field: ComplexArray, defocus_rad: float) -> ComplexArray:
        """Amplitude on the window, shape (n_v, n_v), of a pupil field, shape (n,), at a rim defocus."""
        grid = np.zeros(self.pupil.inside.shape, dtype=np.complex128)
        grid[self.pupil.inside] = field * phasor(defocus_rad * self.pupil.radius_squared) / self.pupil.count
        return np.asarray(self._kernel @ grid @ self._kernel.T)

    def psf(self, field: ComplexArray, defocus_rad: ArrayLike) -> FloatArray:
        """Strehl ratios, shape (n_depth, n_v, n_v), at rim defocuses of shape (n_depth,)."""
        defocus = np.atleast_1d(np.asarray(defocus_rad, dtype=np.float64))
        return np.stack([np.abs(self.amplitude(field, value)) ** 2 for value in defocus])
