"""The pupil in normalised coordinates, and the images of a pupil field near focus (paraxial).

Positions are divided by the aperture's radius R, so the rim is at u = 1. An object nearer than the focus adds the phase
W u^2 with the rim defocus ``W = (k R^2 / 2) (1/depth - 1/focus_depth)``. The focal plane is in optical units
``v = k R x' / s'`` (the first dark ring of Airy's disc is at v = 3.83). PSF values are Strehl ratios: 1 is the peak of
the same aperture without aberration. Helices are designed here; :mod:`metafab.optics` then computes their PSFs exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.numeric.phasor import phasor
from metafab.phase.terms.profile import Term

Outline: TypeAlias = Literal["circle", "square", "ring", "polygon"]


def rim_defocus_rad(
    depth_m: ArrayLike, focus_depth_m: float, aperture_radius_um: float, wavelength_um: float
) -> FloatArray:
    """Rim defocus W (rad) of objects at depths of any shape, infinity allowed; 0 at the focus, positive before it.

    The wave of a nearer point arrives more strongly curved, and a longer path has the larger phase.
    """
    vergence_per_m = 1.0 / np.asarray(depth_m, dtype=np.float64) - 1.0 / focus_depth_m
    return np.asarray(rim_defocus_per_dioptre_rad(aperture_radius_um, wavelength_um) * vergence_per_m)


def rim_defocus_per_dioptre_rad(aperture_radius_um: float, wavelength_um: float) -> float:
    """Rim defocus of one dioptre, k R^2 / 2: 3.93 rad for R = 1 mm at 800 nm."""
    return math.pi * aperture_radius_um**2 / wavelength_um * 1e-6


@dataclass(frozen=True)
class Pupil:
    """A square grid of samples over the aperture, point-symmetric about the axis; n samples lie inside."""

    samples: int = 128  #: Samples a side; centres at (2 i + 1) / samples - 1.
    #: Outline of the aperture; the half side of a square counts as its radius. Rings and polygons are replaced by the
    #: whole circle of their diameter.
    shape: Outline = "circle"

    @cached_property
    def axis(self) -> FloatArray:
        """Sample positions along either axis, shape (samples,), units of R."""
        return (2.0 * np.arange(self.samples) + 1.0) / self.samples - 1.0

    @cached_property
    def inside(self) -> NDArray[np.bool_]:
        """True for samples in the aperture, shape (samples, samples)."""
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
        """Number n of samples inside the aperture."""
        return self.x.size

    def on_grid(self, field: ComplexArray, outside: float = 0.0) -> ComplexArray:
        """Place values of the samples inside, shape (..., n), on the whole grid, shape (..., samples, samples).

        Samples outside the aperture get the value ``outside``.
        """
        grid = np.full((*field.shape[:-1], self.samples, self.samples), outside, dtype=np.complex128)
        grid[..., self.inside] = field
        return grid


def pupil_field(term: Term, pupil: Pupil, radius_um: float, polarisation: Polarisation = "x") -> ComplexArray:
    """Return exp(i psi) of a term at the n samples of a pupil of radius ``radius_um``: shape (n,)."""
    positions_um: FloatArray = radius_um * pupil.axis
    return phasor(term(positions_um, positions_um, polarisation)[pupil.inside])


@dataclass(frozen=True)
class FocalPlane:
    """Images of a pupil field on a square window of the focal plane, by a matrix Fourier transform."""

    pupil: Pupil  #: Samples of the field.
    half_width: float  #: The window reaches from -half_width to +half_width, optical units.
    step: float = 0.3  #: Distance of the samples, optical units (the Nyquist step of an intensity is pi / 2).

    @cached_property
    def axis(self) -> FloatArray:
        """Positions v along either axis, shape (n_v,), optical units; the middle one is 0."""
        half = math.ceil(self.half_width / self.step)
        return np.arange(-half, half + 1, dtype=np.float64) * self.step

    @cached_property
    def kernel(self) -> ComplexArray:
        """Matrix exp(-i v u) of the Fourier transform along one axis, shape (n_v, samples)."""
        return phasor(-np.outer(self.axis, self.pupil.axis))

    def psf(self, field: ComplexArray, defocus_rad: ArrayLike) -> FloatArray:
        """Return the PSFs (Strehl ratios), shape (n_depth, n_v, n_v), of a field, shape (n,), at some rim defocuses."""
        images = []
        for value in np.atleast_1d(np.asarray(defocus_rad, dtype=np.float64)):
            blurred = field * phasor(value * self.pupil.radius_squared) / self.pupil.count
            images.append(np.abs(self.kernel @ self.pupil.on_grid(blurred) @ self.kernel.T) ** 2)
        return np.stack(images)


@dataclass(frozen=True)
class NyquistImages:
    """Images of pupil fields on a periodic grid at the Nyquist step, and their derivatives over the rim defocus.

    The grid has m = 2 samples points a side, zero first, and PSFs of sum 1.
    """

    amplitude: ComplexArray  #: Shape (..., m, m), not normalised.
    amplitude_slope: ComplexArray  #: Shape (..., m, m), its derivative over the rim defocus, 1/rad.
    psf: FloatArray  #: Shape (..., m, m).
    psf_slope: FloatArray  #: Shape (..., m, m), its derivative over the rim defocus, 1/rad.

    @classmethod
    def of(cls, pupil: Pupil, field_grid: ComplexArray) -> NyquistImages:
        """Transform defocused pupil fields, shape (..., samples, samples), 0 outside the aperture."""
        side = (2 * pupil.samples, 2 * pupil.samples)
        amplitude = fft.fft2(field_grid, side)
        slope = fft.fft2(1j * pupil.radius_squared_grid * field_grid, side)
        scale = nyquist_scale(pupil)
        return cls(amplitude, slope, scale * np.abs(amplitude) ** 2, scale * 2.0 * (amplitude.conj() * slope).real)


def nyquist_scale(pupil: Pupil) -> float:
    """Factor that normalises the squared amplitudes of :class:`NyquistImages` to a sum of 1 (Parseval)."""
    return 1.0 / (4.0 * pupil.samples**2 * pupil.count)
